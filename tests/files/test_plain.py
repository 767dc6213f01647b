"""What is no regular file, or larger than it can be, is refused before it is read."""

import os
import stat
from pathlib import Path

import pytest

from ggvs_eval.errors import CaptureError
from ggvs_eval.files.digest import digest_files
from ggvs_eval.files.images import read_image
from ggvs_eval.files.plain import NotPlainError, check_plain, read_plain, read_plain_text
from ggvs_eval.files.toml_tables import load_toml
from helpers.fuzz import make_endless
from helpers.refusals import refused


def make_socket(path: Path) -> None:
    # a server's path may have 107 bytes at most, that of a temporary folder has more
    os.mknod(path, 0o600 | stat.S_IFSOCK)


@pytest.mark.parametrize(
    ("make", "kind"),
    [
        (os.mkfifo, "a pipe instead of a regular file"),
        (Path.mkdir, "a folder instead of a regular file"),
        (make_socket, "a socket instead of a regular file"),
        (lambda path: path.symlink_to("/dev/zero"), "a device instead of a regular file"),
        (make_endless, "8590 MB, above the limit of 1 MB"),
    ],
)
def test_what_is_no_plain_file_is_refused_at_once(make, kind, tmp_path):
    """By whatever reads whole files; nobody waits for a writer, and nothing is taken into
    memory.
    """
    file = tmp_path / "file.png"
    make(file)

    with pytest.raises(NotPlainError, match=kind) as caught:
        read_plain(file, 1_000_000)
    with pytest.raises(CaptureError, match=r"file.png: wanted a picture, got (a|8590)"):
        read_image(file)
    with refused(CaptureError, "file.png: ", "wanted a file"):
        digest_files([file])

    assert caught.value.filename == str(file)


def test_a_file_of_holes_is_refused_before_it_is_hashed(tmp_path):
    """Also where files of its kind may have any size: 8 GiB of zeros were read for minutes."""
    make_endless(tmp_path / "cam00.npy")

    with refused(CaptureError, "cam00.npy: wanted a file", "0 MB are on the disk"):
        digest_files([tmp_path / "cam00.npy"])


def test_a_file_that_grows_without_a_size_is_refused():
    """Files below /proc say that they are empty."""
    with pytest.raises(NotPlainError, match="more than the limit of 0 MB"):
        read_plain(Path("/proc/self/status"), 100)


def test_plain_files_are_read(tmp_path):
    """Whole, through links, with line ends as Python reads them; just at the limit too."""
    (tmp_path / "a").write_bytes("Größe\r\n1\r2\n".encode())
    (tmp_path / "b").symlink_to("a")

    assert check_plain(tmp_path / "b") == (tmp_path / "a").stat().st_size
    assert (
        read_plain_text(tmp_path / "b", 13)
        == (tmp_path / "a").read_text(encoding="utf-8")
        == "Größe\n1\n2\n"
    )


@pytest.mark.parametrize("key", ["a." * 30_000 + "b", "a . " * 30_000 + "b", '"a".' * 30_000 + "b"])
def test_keys_of_many_parts_are_refused_at_once(key):
    """TOML's parser would be at them for hours; numbers, versions and names with some dots pass."""
    with pytest.raises(ValueError, match="a key of more than 64 parts"):
        load_toml(f"{key} = 1\n")

    assert load_toml("a.b.c = [1.0, 2.5]\nd = '1.2.3'\n" + "e = " + "9" * 1000) == {
        "a": {"b": {"c": [1.0, 2.5]}},
        "d": "1.2.3",
        "e": int("9" * 1000),
    }
