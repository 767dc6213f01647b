"""Whatever is on disk: a capture opens and every frame is read, or one line says why not. No
traceback, no hang, no code run.
"""

import io
import os
import pickle
import resource
import shutil
import signal
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from random import Random

import cv2
import h5py
import numpy as np
import pytest

from ggvs_eval.datasets import DATASETS
from helpers.captures import make_image
from helpers.fuzz import CAPTURES, damaged, random_edit, read_everything

pytestmark = pytest.mark.fuzz

LONGEST_S = 20
MOST_BYTES = 1 << 30


EXAMPLES = 12  # of damage to each layout


@pytest.fixture(scope="module")
def intact(tmp_path_factory) -> dict[str, Path]:
    """A valid capture of every layout; nobody changes them."""
    folder = tmp_path_factory.mktemp("intact")
    return {name: write(folder / name.replace(".", "_")) for name, write in CAPTURES.items()}


class HangError(BaseException):
    """No reader takes this for what a damaged file makes it stumble over, as it would an
    `OSError`.
    """


@contextmanager
def wall_clock() -> Iterator[None]:
    """Whatever takes longer than a damaged file may take ends with an error."""

    def stop(*_: object) -> None:
        raise HangError(f"reading took over {LONGEST_S} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(LONGEST_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def test_every_layout_is_fuzzed():
    """A new layout needs a line here."""
    assert set(CAPTURES) == set(DATASETS)


@pytest.mark.parametrize("layout", CAPTURES)
def test_intact_captures_are_read(intact, layout):
    """What is damaged below is valid before."""
    assert read_everything(intact[layout]) == layout


@pytest.mark.parametrize("layout", CAPTURES)
def test_one_damaged_file(intact, layout, tmp_path):
    """Flipped, cut, replaced, inserted and repeated bytes in any file of any layout: success or one
    line.
    """
    files = sorted(
        file.relative_to(intact[layout]) for file in intact[layout].rglob("*") if file.is_file()
    )
    # there is the trouble; the others outnumber them
    headers = [file for file in files if file.suffix not in (".png", ".mp4")]
    pictures = [file for file in files if file not in headers]
    copy = Path(shutil.copytree(intact[layout], tmp_path / "copy"))
    random = Random(layout)
    for _ in range(EXAMPLES):
        file = random.choice(random.choice((headers, headers, pictures or headers)))
        content = (intact[layout] / file).read_bytes()
        (copy / file).write_bytes(damaged(content, random_edit(random)))
        with wall_clock():
            read_everything(copy)
        (copy / file).write_bytes(content)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (b"VideoHandler", b"\x9dideoHandler", "dynerf"),
        (
            b"avc1",
            b"zzzz",
            "cam01.mp4: wanted a video in a known code such as H.264, got an unknown one",
        ),
    ],
)
def test_damaged_tags_of_a_video(intact, tmp_path, old, new, expected):
    """Tags that are no text do not matter; a code that nobody knows does."""
    copy = Path(shutil.copytree(intact["dynerf"], tmp_path / "copy"))
    content = (copy / "cam01.mp4").read_bytes()
    assert old in content
    (copy / "cam01.mp4").write_bytes(content.replace(old, new))
    assert expected in read_everything(copy)


class Trap:
    """Unpickling it leaves a mark."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self):
        return os.mkdir, (str(self.mark),)


def npy_header(shape: str, dtype: str = "<f8") -> bytes:
    """An array file that claims this shape and holds 64 bytes."""
    header = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + bytes(64)


def png(width: int, height: int, *chunks: tuple[bytes, bytes]) -> bytes:
    """An image file that claims this size and holds next to nothing."""
    parts = [(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)), *chunks]
    parts += [(b"IDAT", zlib.compress(bytes(1000))), (b"IEND", b"")]
    body = b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in parts
    )
    return b"\x89PNG\r\n\x1a\n" + body


def bomb() -> bytes:
    """A chunk of 64 MB in some hundred kB."""
    return b"k\0\0" + zlib.compress(bytes(1 << 26), 1)


def endless_png() -> bytes:
    """An image whose data claim to go on for 4 GB."""
    content = png(64, 48)
    at = content.index(b"IDAT") - 4
    return content[:at] + b"\xff\xff\xff\0" + content[at + 4 :]


def jpeg(width: int, height: int) -> bytes:
    """A true image whose header claims another size."""
    content = bytearray(cv2.imencode(".jpg", make_image(0, 0))[1].tobytes())
    at = content.index(b"\xff\xc0") + 5
    content[at : at + 4] = struct.pack(">HH", height, width)
    return bytes(content)


def h5(fill: Callable[[h5py.File], object]) -> bytes:
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        fill(file)
    return buffer.getvalue()


def npz() -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, poses=np.zeros((2, 17)))
    return buffer.getvalue()


def object_array(mark: Path) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, np.array([[Trap(mark)] * 17] * 2), allow_pickle=True)
    return buffer.getvalue()


YAML_HEAD = b"%YAML:1.0\n---\n"
ANCHORS = b"".join(
    b"a%d: &a%d [%s]\n" % (i, i, b",".join([b"*a%d" % (i - 1)] * 9) if i else b"x")
    for i in range(12)
)
NAMES_YAML = b'names:\n   - "00"\n   - "01"\n   - "02"\n'


def hostile_files(mark: Path) -> dict[str, tuple[str, str, bytes | Callable[[], bytes]]]:
    """What only malice writes: name -> layout, file, content."""
    shell = f"!!python/object/apply:os.mkdir ['{mark}']".encode()
    matrix = b"K_00: !!opencv-matrix\n   rows: %b\n   cols: 3\n   dt: %b\n   data: [ 1., 2. ]\n"
    poses = ("dynerf", "poses_bounds.npy")
    hull = ("enerf-outdoor", "vhull/000000.npy")
    intri = ("enerf-outdoor", "intri.yml")
    picture = ("nerfstudio", "images/cam00.png")
    stored = ("d3dmv", "scene000.h5")
    names = ("nerfstudio", "transforms.json")
    model = "sparse/0/"
    return {
        "npy of 10^12 rows": (*poses, npy_header("(1000000000000, 17)")),
        "npy beyond 64 bits": (*poses, npy_header(f"({2**70}, 17)")),
        "npy of negative size": (*poses, npy_header("(-1, 17)")),
        "npy of overflowing size": (*poses, npy_header(f"({2**62}, {2**62})")),
        "npy nested deeply": (*poses, npy_header("(" * 5000)),
        "npy broken header": (*poses, npy_header("(2, 17), 'x': [")),
        "npy indented header": (*poses, npy_header("(2,\n    17)\n  )")),
        "npy odd type": (*poses, npy_header("(2, 17)", "M8[7Y]")),
        "npy void type": (*poses, npy_header("(2, 17)", "V99999999999")),
        "npy of objects": (*poses, object_array(mark)),
        "pickle as npy": (*poses, pickle.dumps(Trap(mark))),
        "npz as npy": (*poses, npz()),
        "broken zip as npy": (*poses, npz()[:-20]),
        "hull of objects": (*hull, object_array(mark)),
        "hull of 10^12 rows": (*hull, npy_header("(1000000000000, 3)")),
        "pickle as hull": (*hull, pickle.dumps(Trap(mark))),
        "png 60000 x 60000": (*picture, png(60000, 60000)),
        "png 12000 x 12000": (*picture, png(12000, 12000)),
        "png 2^31 wide": (*picture, png(2**31 - 1, 2)),
        "png with a chunk of 4 GB": (*picture, endless_png()),
        "png with a text bomb": (*picture, lambda: png(64, 48, (b"zTXt", bomb()))),
        "png with a profile bomb": (*picture, lambda: png(64, 48, (b"iCCP", bomb()))),
        "jpeg 60000 x 60000": (*picture, jpeg(60000, 60000)),
        "background 60000 x 60000": ("enerf-outdoor", "bkgd/00.png", png(60000, 60000)),
        "depth 60000 x 60000": ("rgbd", "depth/0.png", png(60000, 60000)),
        "script as picture": (
            *picture,
            b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 64 48\n(x) run\n",
        ),
        "2^60 cameras": ("colmap", f"{model}cameras.bin", struct.pack("<Q", 1 << 60) + bytes(200)),
        "endless name": ("colmap", f"{model}images.bin", struct.pack("<Q", 1) + b"x" * 5000),
        "yaml of 2^31 rows": (*intri, YAML_HEAD + NAMES_YAML + matrix % (b"2000000000", b"d")),
        "yaml of a wrong type": (*intri, YAML_HEAD + NAMES_YAML + matrix % (b"3", b"99999999999d")),
        "yaml tag": (*intri, YAML_HEAD + b"names: " + shell + b"\n"),
        "yaml tag in a matrix": (*intri, YAML_HEAD + NAMES_YAML + b"K_00: " + shell + b"\n"),
        "yaml anchors": (*intri, YAML_HEAD + ANCHORS + b"names: *a11\n"),
        "yaml nested deeply": (*intri, YAML_HEAD + b"names: " + b"[" * 1_000_000),
        "yaml maps nested deeply": (*intri, YAML_HEAD + b"names: " + b"{a: " * 500_000),
        "yaml of another version": (
            *intri,
            b"%YAML 1.2\n---\nK_\0: !!opencv-matrix\n" + NAMES_YAML,
        ),
        "xml as yaml": (*intri, b'<?xml version="1.0"?>\n<opencv_storage>' + b"<a>" * 200_000),
        "json as yaml": (*intri, b'{"a":' * 200_000),
        "a million names": (
            *intri,
            YAML_HEAD + b"names:\n" + b"".join(b"  - c%d\n" % i for i in range(100_000)),
        ),
        "json nested deeply": (*names, b'{"frames": ' + b"[" * 1_000_000),
        "json of a huge number": (
            *names,
            b'{"frames": [{"file_path": "a.png", "w": 1e400}], "w": ' + b"9" * 100_000 + b"}",
        ),
        "json of NaN": (
            *names,
            b'{"w": NaN, "frames": [{"file_path": "a.png", "transform_matrix": [[NaN]]}]}',
        ),
        "json of half a sign": (
            *names,
            b'{"frames": [{"file_path": "\\ud800.png", "transform_matrix": 3}]}',
        ),
        "models nested deeply": ("spaces", "models.json", b"[" * 1_000_000),
        "toml nested deeply": ("capture.toml", "capture.toml", b"a = " + b"[" * 100_000),
        "toml tables nested deeply": ("capture.toml", "capture.toml", b"a = " + b"{a=" * 50_000),
        "toml of a huge number": (
            "capture.toml",
            "capture.toml",
            b"fps = " + b"9" * 4000 + b"\ncamera = []",
        ),
        "units of a huge number": (
            "capture.toml",
            "units.toml",
            b"units_per_metre = " + b"9" * 4000,
        ),
        "h5 link to another file": (
            *stored,
            h5(lambda file: file.update({"rgb": h5py.ExternalLink("/etc/passwd", "/rgb")})),
        ),
        "h5 link to itself": (
            *stored,
            h5(lambda file: file.update({"rgb": h5py.SoftLink("/rgb")})),
        ),
        "h5 of objects": (
            *stored,
            h5(lambda file: file.create_dataset("rgb", data=["x"] * 3, dtype=h5py.string_dtype())),
        ),
        "h5 of a wrong rank": (
            *stored,
            h5(lambda file: file.create_dataset("rgb", data=np.zeros(5, np.uint8))),
        ),
        "h5 of 10^15 bytes": (
            *stored,
            h5(lambda file: file.create_dataset("rgb", (2, 10**9, 480, 640, 3), "u1", chunks=True)),
        ),
        "ply of 10^12 points": (
            "enerf-outdoor",
            "background.ply",
            b"ply\nformat binary_little_endian 1.0\nelement vertex 1000000000000\nproperty float "
            b"x\nend_header\n",
        ),
        "text of numbers": ("rgbd", "pose/0.txt", b"1 " * 2_000_000),
    }


@contextmanager
def little_memory() -> Iterator[None]:
    """Whatever takes more than a damaged file may take fails."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + MOST_BYTES, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


@pytest.mark.parametrize("name", hostile_files(Path("mark")))
def test_hostile_files_give_one_line(intact, name, tmp_path):
    """Bombs, claims beyond all measure, pickles and tags are refused in one line, soon, without
    memory, and nothing is run.
    """
    layout, file, content = hostile_files(tmp_path / "mark")[name]
    folder = Path(shutil.copytree(intact[layout], tmp_path / "hostile"))
    (folder / file).write_bytes(content() if callable(content) else content)
    with wall_clock(), little_memory():
        message = read_everything(folder)
    assert message not in DATASETS
    assert Path(file).name in message or "sparse/0: damaged COLMAP model" in message
    assert not (tmp_path / "mark").exists()
