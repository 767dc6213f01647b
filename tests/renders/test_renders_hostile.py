"""Archives and arrays whose author is an enemy: refused in one line, nothing written outside,
nothing run.
"""

import io
import os
import stat
import struct
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.errors import RenderError
from ggvs_eval.files.archive import Limits, unpack
from ggvs_eval.pipelines.run.import_renders import import_renders
from helpers.render_folders import VIEWS, make_run, stack

pytestmark = pytest.mark.fuzz

LIMITS = Limits(n_files=20, n_bytes=100_000)
Writer = Callable[[Path], None]


def zipped(
    *members: tuple[str | zipfile.ZipInfo, bytes], method: int = zipfile.ZIP_DEFLATED
) -> Writer:
    def write(path: Path) -> None:
        with zipfile.ZipFile(path, "w", method) as packed:
            for name, content in members:
                packed.writestr(name, content, method)

    return write


def tarred(*members: tuple[tarfile.TarInfo, bytes], mode: str = "w:gz") -> Writer:
    def write(path: Path) -> None:
        with tarfile.open(path, mode) as tar:
            for info, content in members:
                tar.addfile(info, io.BytesIO(content))

    return write


def special(name: str, kind: bytes, target: str = "", n_bytes: int = 0) -> tarfile.TarInfo:
    info = tarfile.TarInfo(name)
    info.type, info.linkname, info.size = kind, target, n_bytes
    return info


def zip_link(name: str) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo(name)
    info.external_attr = (stat.S_IFLNK | 0o777) << 16
    return info


def lying_zip(path: Path) -> None:
    """Every header says 10 bytes, 1 MB comes out."""
    zipped(("a.png", b"\0" * 1_000_000))(path)
    path.write_bytes(path.read_bytes().replace(struct.pack("<L", 1_000_000), struct.pack("<L", 10)))


def long_header(path: Path) -> None:
    """A tar whose extended header claims 2 GiB, which would be read into memory at once."""
    header = special("a", tarfile.XHDTYPE, n_bytes=2 << 30)
    path.write_bytes(header.tobuf(tarfile.USTAR_FORMAT) + b"\0" * 4096)


def cut(write: Writer, keep: float) -> Writer:
    def write_cut(path: Path) -> None:
        write(path)
        path.write_bytes(path.read_bytes()[: int(keep * path.stat().st_size)])

    return write_cut


def encrypted(path: Path) -> None:
    """The flag of encryption in both headers."""
    zipped(("a.png", b"x"))(path)
    content = bytearray(path.read_bytes())
    content[content.index(b"PK\x03\x04") + 6] |= 1
    content[content.index(b"PK\x01\x02") + 8] |= 1
    path.write_bytes(content)


file = tarfile.TarInfo
OUTSIDE = "which leads outside of it"
PLAIN = "only plain files are unpacked"
TOO_MUCH = "holds more than 20 files or 0 MB"
HOSTILE: dict[str, tuple[str, Writer, str]] = {
    "zip with ..": (".zip", zipped(("ok/a.png", b"x"), ("../evil", b"x")), OUTSIDE),
    "zip with .. inside": (".zip", zipped(("a/../../evil", b"x")), OUTSIDE),
    "zip with an absolute path": (".zip", zipped(("/tmp/ggvs-eval-hostile-test", b"x")), OUTSIDE),
    "zip with backslashes": (".zip", zipped(("..\\evil", b"x")), OUTSIDE),
    "zip with a drive": (".zip", zipped(("C:evil", b"x")), OUTSIDE),
    "zip with a link": (".zip", zipped((zip_link("a"), b"/etc"), ("a/passwd", b"x")), PLAIN),
    "zip with one name twice": (
        ".zip",
        zipped(("a.png", b"x"), ("./a.png", b"y")),
        "holds 'a.png' twice",
    ),
    "zip with a file as folder": (".zip", zipped(("a", b"x"), ("a/b", b"y")), "cannot be unpacked"),
    "zip bomb": (".zip", zipped(("a.png", b"\0" * 200_000)), TOO_MUCH),
    "zip bomb in parts": (".zip", zipped(*((f"{i}", b"\0" * 9_000) for i in range(15))), TOO_MUCH),
    "zip that lies": (".zip", lying_zip, "cannot be unpacked"),
    "zip of too many files": (".zip", zipped(*((f"{i}", b"") for i in range(30))), TOO_MUCH),
    "zip by lzma": (".zip", zipped(("a.png", b"x"), method=zipfile.ZIP_LZMA), PLAIN),
    "zip with a password": (".zip", encrypted, "which is encrypted"),
    "half a zip": (".zip", cut(zipped(("a.png", b"x" * 50)), 0.5), "cannot be unpacked"),
    "no zip": (".zip", lambda path: path.write_text("hello") and None, "cannot be unpacked"),
    "tar with ..": (".tar.gz", tarred((file("../evil"), b"")), OUTSIDE),
    "tar with an absolute path": (
        ".tar.gz",
        tarred((file("/tmp/ggvs-eval-hostile-test"), b"")),
        OUTSIDE,
    ),
    "tar with a link": (
        ".tar.gz",
        tarred((special("a", tarfile.SYMTYPE, "/etc"), b""), (file("a/evil"), b"")),
        PLAIN,
    ),
    "tar with a hard link": (
        ".tgz",
        tarred((special("a", tarfile.LNKTYPE, "/etc/passwd"), b"")),
        PLAIN,
    ),
    "tar with a device": (".tar.gz", tarred((special("a", tarfile.CHRTYPE), b"")), PLAIN),
    "tar with a pipe": (".tar", tarred((special("a", tarfile.FIFOTYPE), b""), mode="w"), PLAIN),
    "tar with one name twice": (
        ".tar.gz",
        tarred((file("a"), b""), (file("a"), b"")),
        "holds 'a' twice",
    ),
    "tar bomb": (
        ".tar.gz",
        tarred((special("a", tarfile.REGTYPE, n_bytes=200_000), b"\0" * 200_000)),
        TOO_MUCH,
    ),
    "tar that claims a terabyte": (
        ".tar",
        lambda p: p.write_bytes(special("a", tarfile.REGTYPE, "", 1 << 40).tobuf()) and None,
        TOO_MUCH,
    ),
    "tar with a long header": (".tar", long_header, TOO_MUCH),
    "tar of too many files": (
        ".tar.gz",
        tarred(*((file(f"{i}"), b"") for i in range(30))),
        TOO_MUCH,
    ),
    "half a tar.gz": (
        ".tar.gz",
        cut(tarred((special("a", tarfile.REGTYPE, n_bytes=5000), os.urandom(5000))), 0.5),
        "cannot be unpacked",
    ),
    "no tar": (".tar.gz", lambda path: path.write_text("hello") and None, "cannot be unpacked"),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_a_hostile_archive_is_refused(case, tmp_path):
    """Whatever leads outside, is no plain file, comes twice or grows is refused, and nothing lies
    outside the folder.
    """
    suffix, write, message = HOSTILE[case]
    archive, folder = tmp_path / f"theirs{suffix}", tmp_path / "deep" / "folder"
    write(archive)

    with pytest.raises(RenderError) as caught:
        unpack(archive, folder, LIMITS, RenderError)

    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert sum(item.stat().st_size for item in folder.rglob("*")) <= LIMITS.n_bytes
    assert sorted(item.name for item in tmp_path.rglob("*") if folder not in item.parents) == [
        "deep",
        "folder",
        archive.name,
    ]
    assert not Path("/tmp/ggvs-eval-hostile-test").exists()


def test_a_refused_archive_leaves_nothing_in_the_run(tmp_path):
    """Not even what was unpacked before the hostile entry."""
    run = make_run(tmp_path / "run")
    zipped(("cam00/0002.png", b"x"), ("../evil", b"x"))(tmp_path / "theirs.zip")

    with pytest.raises(RenderError, match="leads outside"):
        import_renders(run, "mine", tmp_path / "theirs.zip")

    assert list((run.root / "renders").iterdir()) == []


def test_what_fits_the_limits_is_unpacked(tmp_path):
    """An archive just within the limits comes out whole, its single folder being what is given
    back.
    """
    zipped(*((f"top/{i}.bin", bytes([i]) * 5000) for i in range(20)))(tmp_path / "theirs.zip")

    root = unpack(tmp_path / "theirs.zip", tmp_path / "folder", LIMITS, RenderError)

    assert root == tmp_path / "folder" / "top"
    assert [(root / f"{i}.bin").read_bytes() for i in range(20)] == [
        bytes([i]) * 5000 for i in range(20)
    ]


class Trap:
    """Unpickling it leaves a file behind."""

    def __init__(self, marker: Path) -> None:
        self.marker = str(marker)

    def __reduce__(self) -> tuple[Callable[..., object], tuple[str, str]]:
        return open, (self.marker, "w")


def write_trap(folder: Path, form: str, marker: Path) -> Path:
    folder.mkdir()
    trapped = np.array([[Trap(marker)]], dtype=object)
    for view in VIEWS:
        if form == "npz":
            np.savez(folder / f"{view}.npz", frames=trapped)
        elif form == "npy":
            np.save(folder / f"{view}.npy", trapped, allow_pickle=True)
        else:
            trapped.dump(folder / f"{view}.npy")
    return folder


@pytest.mark.parametrize("form", ["npy", "npz", "bare pickle"])
def test_nothing_is_unpickled(form, tmp_path):
    """An array of objects, or a pickle called .npy, is refused unread; what it would run does not
    run.
    """
    marker = tmp_path / "marker"

    with pytest.raises(RenderError, match=r"wanted (an array of )?numbers"):
        import_renders(
            make_run(tmp_path / "run"), "mine", write_trap(tmp_path / "theirs", form, marker)
        )

    assert not marker.exists()


@pytest.mark.parametrize("suffix", [".npy", ".npz"])
def test_a_cut_array_is_refused(suffix, tmp_path):
    """A header that claims more than the file holds is an error of one line."""
    run, folder = make_run(tmp_path / "run"), tmp_path / "theirs"
    folder.mkdir()
    for view in VIEWS:
        np.save(folder / f"{view}.npy", stack(view))
        cut_file = (folder / f"{view}.npy").read_bytes()[:-500]
        (folder / f"{view}.npy").write_bytes(cut_file)
        if suffix == ".npz":
            zipped(("frames.npy", cut_file))(folder / f"{view}.npz")
            (folder / f"{view}.npy").unlink()

    with pytest.raises(RenderError, match=r"(wanted an array of numbers|the file ends in frame 2)"):
        import_renders(run, "mine", folder)
