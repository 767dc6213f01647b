"""Clouds in ``.ply`` files: the field's layout, and everything that such a file can have wrong."""

from pathlib import Path
from random import Random

import numpy as np
import pytest
import torch

from ggvs_eval.errors import RenderError
from ggvs_eval.gaussians import read_ply, write_ply
from ggvs_eval.gaussians.cloud import AntialiasedCloud
from ggvs_eval.gaussians.ply import header_notes
from helpers.fuzz import damaged, random_edit
from helpers.gaussian_clouds import random_cloud
from helpers.refusals import refused


@pytest.fixture
def cloud_file(tmp_path) -> Path:
    """A cloud of 5 Gaussians of degree 1."""
    write_ply(tmp_path / "cloud.ply", random_cloud(5, degree=1, dtype=torch.float32))
    return tmp_path / "cloud.ply"


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_round_trip(degree, tmp_path):
    """What is read is what was written, bit by bit."""
    cloud = random_cloud(7, degree, dtype=torch.float32)
    write_ply(tmp_path / "cloud.ply", cloud)
    read = read_ply(tmp_path / "cloud.ply")

    assert all(
        torch.equal(read.parameters()[name], tensor) for name, tensor in cloud.parameters().items()
    )
    write_ply(tmp_path / "nothing.ply", random_cloud(0, degree, dtype=torch.float32))
    assert len(read_ply(tmp_path / "nothing.ply")) == 0


def test_layout_is_that_of_the_field(tmp_path):
    """62 floats a row, in the order of 3D Gaussian splatting's files; trimesh reads the same
    columns by its own parser.
    """
    import trimesh

    cloud = random_cloud(4, degree=3, dtype=torch.float32)
    write_ply(tmp_path / "cloud.ply", cloud)
    header = (
        (tmp_path / "cloud.ply").read_bytes().partition(b"end_header\n")[0].decode().splitlines()
    )
    names = [line.split()[-1] for line in header if line.startswith("property float")]
    data = trimesh.load(tmp_path / "cloud.ply").metadata["_ply_raw"]["vertex"]["data"]

    assert names[:9] == ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    assert names[9:54] == [f"f_rest_{n}" for n in range(45)]
    assert names[54:] == [
        "opacity",
        "scale_0",
        "scale_1",
        "scale_2",
        "rot_0",
        "rot_1",
        "rot_2",
        "rot_3",
    ]
    # channel-major: 15 of red, then green's third
    np.testing.assert_array_equal(np.ravel(data["f_rest_17"]), cloud.sh[:, 3, 1])
    np.testing.assert_array_equal(np.ravel(data["rot_0"]), cloud.quaternions[:, 0])


def test_other_orders_and_kinds_of_numbers(tmp_path):
    """Doubles, big-endian, other properties among them in another order, comments, elements behind:
    as other programs write.
    """
    names = [f"rot_{n}" for n in (3, 2, 1, 0)] + [f"f_dc_{n}" for n in (2, 1, 0)]
    names += ["opacity", *(f"scale_{n}" for n in (2, 1, 0)), *"zyx"]
    table = np.zeros(2, [(name, ">f8") for name in names] + [("label", ">i2")])
    table["x"], table["rot_0"], table["opacity"], table["label"] = (1.5, 2.5), 1.0, 0.25, 7
    properties = "".join(f"property double {name}\n" for name in names)
    header = (
        f"ply\nformat binary_big_endian 1.0\ncomment by hand\nelement vertex "
        f"2\n{properties}property short label\n"
    )
    file = tmp_path / "other.ply"
    file.write_bytes(
        header.encode()
        + b"element face 0\nproperty list uchar int i\nend_header\n"
        + table.tobytes()
    )

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
        (b"ply\n", b"obj\n", "wanted a .ply file, got another first line"),
        (
            b"binary_little_endian",
            b"ascii",
            "wanted a binary .ply, its second line says 'format ascii 1.0'",
        ),
        (
            b"element vertex 5",
            b"element face 5",
            "wanted `element vertex N` with its Gaussians first, got 'element face 5'",
        ),
        (b"element vertex 5", b"element vertex -5", "got 'element vertex -5'"),
        (
            b"element vertex 5",
            b"element vertex 6",
            r"says 6 Gaussians in 624 bytes, the file has 520 for them",
        ),
        (b"element vertex 5", b"element vertex 99999999999999", "says 99999999999999 Gaussians"),
        (b"element vertex 5", b"element vertex " + 40 * b"9", "wanted `element vertex N`"),
        (
            b"property float opacity",
            b"property list uchar float opacity",
            "wanted properties of one number each",
        ),
        (
            b"property float opacity",
            b"property float capacity",
            "wanted a cloud of Gaussians with opacity, got x",
        ),
        (b"property float opacity", b"property float x", "wanted each property once in the header"),
        (
            b"property float f_rest_8",
            b"property float f_rest_9",
            "wanted f_rest_0 to f_rest_N of 0, 9, 24, 45, 72 in all, got 9",
        ),
        (
            b"end_header",
            b"and_header",
            "the header of this .ply has no end_header in its first 64 kB",
        ),
    ],
)
def test_broken_headers(cloud_file, before, after, message):
    damage(cloud_file, before, after)
    with pytest.raises(RenderError, match=message):
        read_ply(cloud_file)


def test_broken_contents(cloud_file, tmp_path):
    """Cut short, NaN, a folder, nothing there: one line each, with the file."""
    content = cloud_file.read_bytes()
    cloud_file.write_bytes(content[:-1])
    with refused(RenderError, "cloud.ply", "5 Gaussians", "519"):
        read_ply(cloud_file)
    cloud_file.write_bytes(content[:-4] + np.float32(np.nan).tobytes())
    with refused(RenderError, "1 of 5", "rot_0", "number 4"):
        read_ply(cloud_file)
    with refused(RenderError, "folder"):
        read_ply(tmp_path)
    with refused(RenderError, "no such file"):
        read_ply(tmp_path / "absent.ply")


@pytest.mark.fuzz
def test_damaged_files_are_read_or_refused_in_one_line(cloud_file):
    """400 files with bytes flipped, cut, inserted, repeated: a finite cloud, or a message of one
    line that names the file.
    """
    content, refusals = cloud_file.read_bytes(), []
    for seed in range(400):
        cloud_file.write_bytes(damaged(content, random_edit(Random(seed))))
        try:
            cloud = read_ply(cloud_file)
        except RenderError as error:
            refusals.append(str(error))
        else:
            assert all(tensor.isfinite().all() for tensor in cloud.parameters().values())
    assert 50 < len(refusals) < 400
    assert all("cloud.ply" in message and "\n" not in message for message in refusals)


ENDS, CONSTANT = ("min", "max"), 0.28209479177387814  # bounds of a chunk; the constant harmonic


def packed(parts: np.ndarray, bits: tuple[int, ...]) -> np.ndarray:
    """Numbers in [0, 1] in one word each row, the first in the highest bits."""
    words = np.zeros(len(parts), np.uint32)
    for column, n in zip(parts.T, bits, strict=True):
        words = (words << n) | np.rint(np.clip(column, 0, 1) * ((1 << n) - 1)).astype(np.uint32)
    return words


def write_compressed(path: Path, cloud, colour_bounds: bool) -> None:
    """The cloud as SuperSplat compresses it, in chunks of 256."""
    means, scales, turns, logits, sh = (
        tensor.numpy().astype(np.float64) for tensor in cloud.parameters().values()
    )
    turns = turns / np.linalg.norm(turns, axis=1, keepdims=True)
    colours = sh[:, 0] * CONSTANT + 0.5
    chunks, vertices = [], []
    for start in range(0, len(means), 256):
        rows = slice(start, start + 256)
        bounded = [means[rows], scales[rows], *([colours[rows]] if colour_bounds else [])]
        ends = [(each.min(axis=0), each.max(axis=0)) for each in bounded]
        chunks.append(np.concatenate([value for low, high in ends for value in (low, high)]))
        steps = [
            (each - low) / np.maximum(high - low, 1e-9)
            for each, (low, high) in zip(bounded, ends, strict=True)
        ]
        largest = np.abs(turns[rows]).argmax(axis=1)
        signs = np.sign(turns[rows][np.arange(len(largest)), largest])[:, None]
        others = np.stack(
            [np.delete(turn, part) for turn, part in zip(signs * turns[rows], largest, strict=True)]
        )
        words = packed(others / np.sqrt(2) + 0.5, (10, 10, 10)) | largest.astype(
            np.uint32
        ) << np.uint32(30)
        rgba = np.column_stack(
            [steps[2] if colour_bounds else colours[rows], 1 / (1 + np.exp(-logits[rows]))]
        )
        vertices.append(
            np.column_stack(
                [
                    packed(steps[0], (11, 10, 11)),
                    words,
                    packed(steps[1], (11, 10, 11)),
                    packed(rgba, (8,) * 4),
                ]
            )
        )
    rest = sh[:, 1:].transpose(0, 2, 1).reshape(len(means), -1)
    kinds = ["", "scale_", ""][: 3 if colour_bounds else 2]
    axes = ["xyz", "xyz", "rgb"]
    names = [
        f"{end}_{kind}{axis}"
        for kind, letters in zip(kinds, axes, strict=False)
        for end in ENDS
        for axis in letters
    ]
    header = f"ply\nformat binary_little_endian 1.0\nelement chunk {len(chunks)}\n"
    header += "".join(f"property float {name}\n" for name in names)
    header += f"element vertex {len(means)}\n"
    header += "".join(
        f"property uint packed_{n}\n" for n in ("position", "rotation", "scale", "color")
    )
    header += f"element sh {len(means)}\n" + "".join(
        f"property uchar f_rest_{n}\n" for n in range(rest.shape[1])
    )
    content = np.float32(chunks).tobytes() + np.concatenate(vertices).astype("<u4").tobytes()
    content += np.clip((rest / 8 + 0.5) * 256, 0, 255).astype(np.uint8).tobytes()
    path.write_bytes(header.encode() + b"end_header\n" + content)


@pytest.mark.parametrize("colour_bounds", [True, False])
def test_compressed_clouds_are_read(tmp_path, colour_bounds):
    """Within the steps of their bits, of more Gaussians than a chunk holds; those of gsplat and of
    older SuperSplat alike.
    """
    cloud = random_cloud(300, degree=1, dtype=torch.float32)
    write_compressed(tmp_path / "cloud.compressed.ply", cloud, colour_bounds)
    read = read_ply(tmp_path / "cloud.compressed.ply")

    span = float((cloud.means.amax(0) - cloud.means.amin(0)).max())
    assert (read.means - cloud.means).abs().max() < span / 1023
    span = float((cloud.log_scales.amax(0) - cloud.log_scales.amin(0)).max())
    assert (read.log_scales - cloud.log_scales).abs().max() < max(span / 1023, 1e-6)
    turns = torch.nn.functional.normalize(cloud.quaternions, dim=1)
    assert ((turns * read.quaternions).sum(1).abs() > 1 - 1e-5).all()
    assert (read.opacity_logits.sigmoid() - cloud.opacity_logits.sigmoid()).abs().max() < 1 / 255
    assert (read.sh[:, 1:] - cloud.sh[:, 1:].clamp(-4, 4)).abs().max() <= 8 / 256
    shown = cloud.sh[:, 0] * CONSTANT + 0.5
    shown = shown if colour_bounds else shown.clamp(0, 1)
    span = float((shown.amax(0) - shown.amin(0)).max())
    assert (read.sh[:, 0] * CONSTANT + 0.5 - shown).abs().max() < max(span, 1) / 255


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        (
            b"element chunk 2",
            b"element chunk 3",
            "wanted 2 chunks, .* of 300 compressed Gaussians, got 3",
        ),
        (b"min_y", b"mix_y", "no min_y"),
        (b"packed_scale", b"picked_scale", "no packed_scale"),
        (b"element sh 300", b"element sh 301", "harmonics of 300 compressed"),
        (b"element chunk 2", b"element chunk 2000000", "wanted 2 chunks"),
    ],
)
def test_broken_compressed_clouds(tmp_path, before, after, message):
    """What does not fit together is refused in one line."""
    file = tmp_path / "cloud.compressed.ply"
    write_compressed(file, random_cloud(300, degree=1, dtype=torch.float32), True)
    damage(file, before, after)
    with pytest.raises(RenderError, match=message):
        read_ply(file)


@pytest.mark.parametrize(
    ("names", "kind"),
    [
        (("trbf_center", "trbf_scale", "motion_0", "omega_0"), "Spacetime Gaussians"),
        (("t", "scale_t", "rot_r_0"), "Gaussians in time"),
        (("filter_3D",), "Mip-Splatting"),
        (("f_offset_0", "f_anchor_feat_0"), "Scaffold-GS"),
    ],
)
def test_gaussians_that_are_drawn_otherwise_are_refused(cloud_file, names, kind):
    """Properties of other methods are named, and what to do; still Gaussians are not made
    of them.
    """
    content = cloud_file.read_bytes().replace(
        b"end_header", b"".join(b"property float %s\n" % n.encode() for n in names) + b"end_header"
    )
    cloud_file.write_bytes(content + bytes(5 * 4 * len(names)))
    with pytest.raises(
        RenderError, match=rf"{names[0]}.* are of {kind}.*ggvs-eval score --renders"
    ):
        read_ply(cloud_file)


@pytest.mark.parametrize(
    ("comment", "is_antialiased"),
    [
        ("SplatRenderMode: mip", True),
        ("antialiased true", True),
        ("SplatRenderMode: default", False),
        ("antialiased: false", False),
    ],
)
def test_comments_say_how_a_cloud_is_drawn(cloud_file, comment, is_antialiased):
    """The exporters of gsplat and brush write the mode of the training into the header; it is
    applied, noted, and kept.
    """
    damage(cloud_file, b"element vertex", f"comment {comment}\nelement vertex".encode())
    cloud = read_ply(cloud_file)

    assert isinstance(cloud, AntialiasedCloud) == is_antialiased
    assert any("drawn antialiased" in note for note in header_notes(cloud_file)) == is_antialiased
    write_ply(cloud_file, cloud)
    assert isinstance(read_ply(cloud_file), AntialiasedCloud) == is_antialiased


def test_what_other_exporters_write_is_named(cloud_file):
    """Clouds of nerfstudio are in a world of their own; those of two scales are surfels."""
    damage(cloud_file, b"element vertex", b"comment Generated by Nerfstudio 1.1.5\nelement vertex")
    assert "dataparser_transforms.json" in header_notes(cloud_file)[0]
    damage(cloud_file, b"property float scale_2", b"property float extra_2")
    with refused(RenderError, "2D Gaussian Splatting", "score --renders"):
        read_ply(cloud_file)


def test_other_properties_are_named(cloud_file, tmp_path):
    """Normals go without saying; what nobody knows here is told."""
    assert header_notes(cloud_file) == []
    damage(cloud_file, b"property float nx", b"property float sh_bins")
    assert header_notes(cloud_file) == ["sh_bins of its Gaussians are unknown and ignored"]
    assert len(read_ply(cloud_file)) == 5
    (tmp_path / "cloud.spz").write_bytes(b"\x1f\x8b")
    with refused(RenderError, "cloud.spz", ".ply", "convert it"):
        read_ply(tmp_path / "cloud.spz")
