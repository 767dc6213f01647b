"""Clouds in ``.ply`` files: the field's layout, and everything that such a file can have wrong."""

from pathlib import Path
from random import Random

import numpy as np
import pytest
import torch

from ggvs_eval.errors import RenderError
from ggvs_eval.gaussians import read_ply, write_ply
from helpers.fuzz import damaged, random_edit
from helpers.gaussian_clouds import random_cloud


@pytest.fixture
def written(tmp_path) -> Path:
    """A cloud of 5 Gaussians of degree 1."""
    write_ply(tmp_path / "cloud.ply", random_cloud(5, degree=1, dtype=torch.float32))
    return tmp_path / "cloud.ply"


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_round_trip(degree, tmp_path):
    """What is read is what was written, bit by bit."""
    cloud = random_cloud(7, degree, dtype=torch.float32)
    write_ply(tmp_path / "cloud.ply", cloud)
    read = read_ply(tmp_path / "cloud.ply")

    assert all(torch.equal(read.parameters()[name], tensor) for name, tensor in cloud.parameters().items())
    write_ply(tmp_path / "nothing.ply", random_cloud(0, degree, dtype=torch.float32))
    assert len(read_ply(tmp_path / "nothing.ply")) == 0


def test_layout_is_that_of_the_field(tmp_path):
    """62 floats a row, in the order of 3D Gaussian splatting's files; trimesh reads the same columns by its own parser."""
    import trimesh

    cloud = random_cloud(4, degree=3, dtype=torch.float32)
    write_ply(tmp_path / "cloud.ply", cloud)
    header = (tmp_path / "cloud.ply").read_bytes().partition(b"end_header\n")[0].decode().splitlines()
    names = [line.split()[-1] for line in header if line.startswith("property float")]
    data = trimesh.load(tmp_path / "cloud.ply").metadata["_ply_raw"]["vertex"]["data"]

    assert names[:9] == ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    assert names[9:54] == [f"f_rest_{n}" for n in range(45)]
    assert names[54:] == ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    np.testing.assert_array_equal(np.ravel(data["f_rest_17"]), cloud.sh[:, 3, 1])  # channel-major: 15 of red, then green's third
    np.testing.assert_array_equal(np.ravel(data["rot_0"]), cloud.quaternions[:, 0])


def test_other_orders_and_kinds_of_numbers(tmp_path):
    """Doubles, big-endian, other properties among them in another order, comments, elements behind: as other programs write."""
    names = [
        *(f"rot_{n}" for n in (3, 2, 1, 0)),
        "f_dc_2",
        "f_dc_1",
        "f_dc_0",
        "opacity",
        *(f"scale_{n}" for n in (2, 1, 0)),
        *"zyx",
    ]
    table = np.zeros(2, [(name, ">f8") for name in names] + [("label", ">i2")])
    table["x"], table["rot_0"], table["opacity"], table["label"] = (1.5, 2.5), 1.0, 0.25, 7
    properties = "".join(f"property double {name}\n" for name in names)
    header = f"ply\nformat binary_big_endian 1.0\ncomment by hand\nelement vertex 2\n{properties}property short label\n"
    file = tmp_path / "other.ply"
    file.write_bytes(header.encode() + b"element face 0\nproperty list uchar int i\nend_header\n" + table.tobytes())

    cloud = read_ply(file)
    assert cloud.means.tolist() == [[1.5, 0, 0], [2.5, 0, 0]]
    assert cloud.quaternions.tolist() == [[1, 0, 0, 0]] * 2
    assert (cloud.degree, cloud.opacity_logits.tolist()) == (0, [0.25, 0.25])


def damage(file: Path, before: bytes, after: bytes) -> None:
    content = file.read_bytes()
    assert before in content
    file.write_bytes(content.replace(before, after, 1))


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        (b"ply\n", b"obj\n", "wanted a .ply file, its first line is none"),
        (b"binary_little_endian", b"ascii", "wanted a binary .ply, its second line says 'format ascii 1.0'"),
        (b"element vertex 5", b"element face 5", "wanted `element vertex N` with its Gaussians first, got 'element face 5'"),
        (b"element vertex 5", b"element vertex -5", "got 'element vertex -5'"),
        (b"element vertex 5", b"element vertex 6", r"says 6 Gaussians of 104 bytes, the file has 520 bytes for them"),
        (b"element vertex 5", b"element vertex 99999999999999", "says 99999999999999 Gaussians"),
        (b"element vertex 5", b"element vertex " + 40 * b"9", "wanted `element vertex N`"),
        (b"property float opacity", b"property list uchar float opacity", "wanted properties of one number each"),
        (
            b"property float opacity",
            b"property float capacity",
            "it lacks opacity, its properties are x, y, z",
        ),
        (b"property float opacity", b"property float x", "a property stands twice"),
        (b"property float f_rest_8", b"property float f_rest_9", "wanted f_rest_0 to f_rest_N of 0, 9, 24, 45, 72 in all, got 9"),
        (b"end_header", b"and_header", "the header of this .ply has no end_header in its first 64 kB"),
    ],
)
def test_broken_headers(written, before, after, message):
    damage(written, before, after)
    with pytest.raises(RenderError, match=message):
        read_ply(written)


def test_broken_contents(written, tmp_path):
    """Cut short, NaN, a folder, nothing there: one line each, with the file."""
    content = written.read_bytes()
    written.write_bytes(content[:-1])
    with pytest.raises(RenderError, match=r"cloud\.ply: its header says 5 Gaussians of 104 bytes, the file has 519 bytes"):
        read_ply(written)
    written.write_bytes(content[:-4] + np.float32(np.nan).tobytes())
    with pytest.raises(RenderError, match=r"1 of 5 Gaussians have a rot_0\.\. that is not finite, first number 4; the fit"):
        read_ply(written)
    with pytest.raises(RenderError, match="it cannot be read: a folder instead of a regular file"):
        read_ply(tmp_path)
    with pytest.raises(RenderError, match="it cannot be read: no such file"):
        read_ply(tmp_path / "absent.ply")


@pytest.mark.fuzz
def test_damaged_files_are_read_or_refused_in_one_line(written):
    """400 files with bytes flipped, cut, inserted, repeated: a finite cloud, or a message of one line that names the file."""
    content, refusals = written.read_bytes(), []
    for seed in range(400):
        written.write_bytes(damaged(content, random_edit(Random(seed))))
        try:
            cloud = read_ply(written)
        except RenderError as error:
            refusals.append(str(error))
        else:
            assert all(tensor.isfinite().all() for tensor in cloud.parameters().values())
    assert 50 < len(refusals) < 400
    assert all("cloud.ply" in message and "\n" not in message for message in refusals)
