"""Sequences of Gaussians as ``.glb``: what is read back, the rules of glTF, what an outside reader
finds, and refusals.
"""

import gc
import json
import struct
import weakref
from dataclasses import replace
from pathlib import Path
from random import Random

import numpy as np
import pytest
import torch

from ggvs_eval.contrib.export import gltf
from ggvs_eval.contrib.export.gltf import write_glb
from ggvs_eval.contrib.export.gltf_reading import glb_frames, read_glb
from ggvs_eval.errors import RenderError
from ggvs_eval.gaussians import GaussianCloud, read_ply, render_gaussians, write_ply
from helpers.fuzz import damaged, random_edit
from helpers.gaussian_clouds import random_cloud, view_of
from helpers.refusals import refused

DEGREES = {0: 3, 2: 1, 3: 0, 7: 2}  # frame -> degree of its cloud; frames are missing among them
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}


def clouds(degrees=DEGREES) -> dict[int, GaussianCloud]:
    """A cloud per frame, each of another size."""
    return {
        frame: random_cloud(5 + frame, degree, seed=frame, dtype=torch.float32)
        for frame, degree in degrees.items()
    }


@pytest.fixture
def sequence(tmp_path) -> Path:
    """A file of four instants."""
    write_glb(
        tmp_path / "sequence.glb", list(DEGREES), clouds().__getitem__, fps=10, up=(0.1, -0.9, 0.2)
    )
    return tmp_path / "sequence.glb"


def parts(file: Path) -> tuple[dict, bytes]:
    """Document and binary chunk, by the container's own counts; both end on whole words and fill
    the file.
    """
    content = file.read_bytes()
    magic, version, total, length, kind = struct.unpack_from("<4sII I4s", content)
    n_bytes, binary_kind = struct.unpack_from("<I4s", content, 20 + length)
    assert (magic, version, total, kind, binary_kind) == (
        b"glTF",
        2,
        len(content),
        b"JSON",
        b"BIN\0",
    )
    assert 28 + length + n_bytes == len(content)
    assert length % 4 == n_bytes % 4 == 0
    return json.loads(content[20 : 20 + length]), content[28 + length :]


def rewritten(file: Path, document: dict, binary: bytes) -> Path:
    """The same container with another document."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sII I4s", b"glTF", 2, 28 + len(text) + len(binary), len(text), b"JSON")
    file.write_bytes(head + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary)
    return file


def accessor_values(document: dict, binary: bytes, number: int) -> np.ndarray:
    """Values of an accessor, by the counts of the document alone."""
    accessor = document["accessors"][number]
    view = document["bufferViews"][accessor["bufferView"]]
    content = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
    return np.frombuffer(content, "<f4").reshape(accessor["count"], WIDTHS[accessor["type"]])


def same(read: GaussianCloud, cloud: GaussianCloud) -> None:
    """Equal to float32 in what is drawn: an opacity near 1 has no more digits than its float."""
    torch.testing.assert_close(read.means, cloud.means, rtol=0, atol=0)
    torch.testing.assert_close(read.sh, cloud.sh, rtol=0, atol=0)
    torch.testing.assert_close(read.log_scales, cloud.log_scales, rtol=3e-7, atol=2e-7)
    torch.testing.assert_close(
        read.quaternions, torch.nn.functional.normalize(cloud.quaternions), rtol=0, atol=2e-7
    )
    torch.testing.assert_close(
        read.opacity_logits.sigmoid(), cloud.opacity_logits.sigmoid(), rtol=3e-7, atol=6e-8
    )


def test_what_is_written_is_read(sequence, tmp_path):
    """Any number of Gaussians, degree and frame; opacities from the least to the most, scales of
    all sizes.
    """
    assert list(glb_frames(sequence)) == list(DEGREES)
    for frame, mesh in glb_frames(sequence).items():
        same(read_glb(sequence, mesh), clouds()[frame])
    cloud = random_cloud(9, 0, dtype=torch.float32)
    far = replace(
        cloud,
        opacity_logits=30 * cloud.opacity_logits,
        log_scales=(30 * cloud.log_scales).clamp(-60, 60),
    )
    write_glb(tmp_path / "far.glb", [10_000], lambda _: far)
    same(read_glb(tmp_path / "far.glb", glb_frames(tmp_path / "far.glb")[10_000]), far)


def test_pictures_are_those_of_the_ply(sequence, tmp_path):
    """Our splat draws the same from both files; positions, axes, colours from this side and opacity
    went through both.
    """
    for frame, mesh in glb_frames(sequence).items():
        write_ply(tmp_path / "cloud.ply", clouds()[frame])
        pictures = [
            render_gaussians(cloud, view_of(80, 60))
            for cloud in (read_ply(tmp_path / "cloud.ply"), read_glb(sequence, mesh))
        ]
        torch.testing.assert_close(pictures[1].image, pictures[0].image, rtol=0, atol=2e-6)
        assert pictures[0].image.max() > 0.1


def test_rules_of_gltf(sequence):
    """Alignment, bounds, counts and targets as glTF 2.0 wants them (3.6.2), every view used once
    and none beyond the other.
    """
    document, binary = parts(sequence)
    views, accessors = document["bufferViews"], document["accessors"]

    assert document["asset"]["version"] == "2.0"
    assert document["buffers"] == [{"byteLength": len(binary)}]
    assert [view["byteOffset"] for view in views] == list(
        np.cumsum([0, *(view["byteLength"] for view in views)])[:-1]
    )
    assert views[-1]["byteOffset"] + views[-1]["byteLength"] == len(binary)
    assert sorted(accessor["bufferView"] for accessor in accessors) == list(range(len(views)))
    for accessor in accessors:
        view = views[accessor["bufferView"]]
        assert accessor["componentType"] == 5126
        assert view["byteOffset"] % 4 == 0
        assert accessor["count"] * WIDTHS[accessor["type"]] * 4 == view["byteLength"]
    assert set().union(*({*node} for node in document["nodes"])) == {
        "name",
        "children",
        "rotation",
        "mesh",
        "extras",
        "scale",
    }
    for mesh in document["meshes"]:
        (primitive,) = mesh["primitives"]
        numbers = primitive["attributes"]
        assert primitive["mode"] == 0
        assert len({accessors[number]["count"] for number in numbers.values()}) == 1
        assert all(
            views[accessors[number]["bufferView"]]["target"] == 34962 for number in numbers.values()
        )
        positions = accessor_values(document, binary, numbers["POSITION"])
        assert accessors[numbers["POSITION"]]["min"] == positions.min(axis=0).tolist()
        assert accessors[numbers["POSITION"]]["max"] == positions.max(axis=0).tolist()


def test_attributes_are_those_of_the_extension(sequence):
    """Names, kernel and colour space of KHR_gaussian_splatting; unit quaternions with w last,
    opacities, linear scales.
    """
    document, binary = parts(sequence)
    cloud = clouds()[0]
    primitive = document["meshes"][0]["primitives"][0]
    values = {
        name: accessor_values(document, binary, number)
        for name, number in primitive["attributes"].items()
    }
    of = "KHR_gaussian_splatting:"
    terms = [
        f"{of}SH_DEGREE_{degree}_COEF_{n}"
        for degree, count in enumerate((1, 3, 5, 7))
        for n in range(count)
    ]

    assert document["extensionsUsed"] == ["KHR_gaussian_splatting"]
    assert primitive["extensions"]["KHR_gaussian_splatting"] == {
        "kernel": "ellipse",
        "colorSpace": "srgb_rec709_display",
        "projection": "perspective",
        "sortingMethod": "cameraDistance",
    }
    assert set(values) == {
        "POSITION",
        "COLOR_0",
        *(of + name for name in ("ROTATION", "SCALE", "OPACITY")),
        *terms,
    }
    np.testing.assert_allclose(np.linalg.norm(values[of + "ROTATION"], axis=1), 1, atol=2e-7)
    w_first = cloud.quaternions / cloud.quaternions.norm(dim=1, keepdim=True)
    np.testing.assert_allclose(values[of + "ROTATION"][:, 3], w_first[:, 0], atol=2e-7)
    np.testing.assert_allclose(values[of + "SCALE"], cloud.log_scales.exp(), rtol=1e-6)
    np.testing.assert_allclose(
        values[of + "OPACITY"][:, 0], cloud.opacity_logits.sigmoid(), rtol=1e-6
    )
    for n, term in enumerate(terms):
        np.testing.assert_array_equal(values[term], cloud.sh[:, n])


def test_one_instant_is_shown_at_any_time(sequence):
    """The animation scales one node to 1 and the others to 0, from its frame to the next one that
    there is.
    """
    document, binary = parts(sequence)
    (animation,) = document["animations"]
    scales = {}
    for channel in animation["channels"]:
        sampler = animation["samplers"][channel["sampler"]]
        times, values = (
            accessor_values(document, binary, sampler[end]) for end in ("input", "output")
        )
        bounds = document["accessors"][sampler["input"]]
        assert channel["target"]["path"] == "scale"
        assert sampler["interpolation"] == "STEP"
        assert times[0] == 0
        assert (np.diff(times[:, 0]) > 0).all()
        assert (bounds["min"], bounds["max"]) == ([times[0, 0]], [times[-1, 0]])
        scales[channel["target"]["node"]] = times[:, 0], values
    last_s = max(times[-1] for times, _ in scales.values())

    assert last_s == np.float32(0.8)  # frame 7 at 10 frames per second, and a frame more
    shown = []
    for time in np.concatenate([np.arange(0, 0.8, 0.01, np.float32), [last_s]]):
        at = {
            node: values[np.searchsorted(times, time, side="right") - 1]
            for node, (times, values) in scales.items()
        }
        (node,) = [node for node, scale in at.items() if scale.tolist() == [1, 1, 1]]
        assert all(scale.tolist() == [0, 0, 0] for other, scale in at.items() if other != node)
        shown.append(document["nodes"][node]["extras"]["frame"])
    assert [shown[n] for n in (0, 15, 19, 21, 29, 31, 69, 71, -1)] == [0, 0, 0, 2, 2, 3, 3, 7, 7]
    still = [node.get("scale", [1, 1, 1]) for node in document["nodes"][1:]]  # where nothing plays
    assert still == [[1, 1, 1], [0, 0, 0], [0, 0, 0], [0, 0, 0]]


def test_up_becomes_y(tmp_path):
    """The root turns the given direction to +Y, also the opposite one; what is read back stands
    where it stood.
    """
    cloud = random_cloud(3, 1, dtype=torch.float32)
    for up in ((0, 1, 0), (0, -1, 0), (0, 0, 2), (0.3, -0.8, 0.1)):
        write_glb(tmp_path / "up.glb", [0], lambda _: cloud, up=up)
        x, y, z, w = parts(tmp_path / "up.glb")[0]["nodes"][0]["rotation"]
        turn, unit = np.array([x, y, z]), np.array(up) / np.linalg.norm(up)
        np.testing.assert_allclose(
            unit + 2 * np.cross(turn, np.cross(turn, unit) + w * unit), (0, 1, 0), atol=1e-12
        )
        same(read_glb(tmp_path / "up.glb", 0), cloud)
    assert "animations" not in parts(tmp_path / "up.glb")[0]


def test_an_outside_reader_finds_the_points(sequence):
    """trimesh, which does not know the extension, sees the positions and the colours of the
    fallback, the first instant at 1.
    """
    import trimesh

    scene = trimesh.load(sequence)
    document, _ = parts(sequence)
    for frame, mesh in zip(DEGREES, document["meshes"], strict=True):
        points, cloud = scene.geometry[mesh["name"]], clouds()[frame]
        np.testing.assert_array_equal(points.vertices, cloud.means)
        display = (cloud.sh[:, 0].double() * 0.28209479177387814 + 0.5).clip(0, 1).numpy()
        linear = np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4)
        expected = 255 * np.column_stack([linear, cloud.opacity_logits.double().sigmoid()])
        np.testing.assert_allclose(points.colors, expected, atol=1)


def test_fewer_harmonics(tmp_path):
    """Lower degrees are kept as they are; a cloud that has no more is left alone."""
    write_glb(tmp_path / "flat.glb", list(DEGREES), clouds().__getitem__, degree=1)
    for frame, mesh in glb_frames(tmp_path / "flat.glb").items():
        same(
            read_glb(tmp_path / "flat.glb", mesh),
            replace(clouds()[frame], sh=clouds()[frame].sh[:, :4]),
        )


@pytest.mark.slow
def test_one_cloud_is_in_memory_at_a_time(tmp_path):
    """When the next one is asked for, the one before is gone."""
    alive = []

    def cloud(frame: int) -> GaussianCloud:
        gc.collect()
        assert [each() for each in alive] == [None] * len(alive)
        made = random_cloud(4, dtype=torch.float32)
        alive.append(weakref.ref(made.sh))
        return made

    write_glb(tmp_path / "long.glb", range(5), cloud)
    assert len(alive) == 5


def test_what_cannot_be_written(tmp_path, monkeypatch):
    """More than the container counts, degree 4, no Gaussian, a size beyond floats, no direction:
    one line, and no file.
    """
    file = tmp_path / "no.glb"
    cloud = random_cloud(6, dtype=torch.float32)
    with refused(RenderError, "no.glb: frame 3", "degree 0 to 3", "got 4"):
        write_glb(file, [3], lambda _: random_cloud(2, 4, dtype=torch.float32))
    with refused(RenderError, "frame 0", "got an empty cloud"):
        write_glb(file, [0], lambda _: random_cloud(0, dtype=torch.float32))
    with refused(RenderError, "frame 0", "KHR_gaussian_splatting:SCALE"):
        write_glb(file, [0], lambda _: replace(cloud, log_scales=cloud.log_scales + 100))
    with refused(RenderError, "up", "0 0 0"):
        write_glb(file, [0], lambda _: cloud, up=(0, 0, 0))
    monkeypatch.setattr(gltf, "MOST_BYTES", 4 * len(cloud) * 4 * (59 + 4))
    with refused(
        RenderError, "no.glb", "wanted 9 instants, of which 4 fit", "--frames 4", "--degree 0"
    ):
        write_glb(file, range(9), lambda _: cloud)
    with refused(RenderError, "of which 3 fit"):  # the document no longer fits behind the fourth
        write_glb(file, range(4), lambda _: cloud)
    assert list(tmp_path.iterdir()) == []


def test_files_of_others(sequence, tmp_path):
    """One mesh without a frame number is frame 0; bytes and shorts in steps, in rows that are
    further apart, are numbers too.
    """
    turns = np.array([[0, 0, 127, 0], [-127, 0, 0, 0]], "i1")
    opacity = np.array([[255, 0, 0, 0], [51, 0, 0, 0]], "u1")
    floats = np.arange(6, dtype="<f4").reshape(2, 3)
    of = "KHR_gaussian_splatting:"
    names = {
        "POSITION": 0,
        of + "ROTATION": 1,
        of + "SCALE": 0,
        of + "OPACITY": 2,
        of + "SH_DEGREE_0_COEF_0": 0,
    }
    extensions = {
        "KHR_gaussian_splatting": {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
    }
    document = {
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": names, "extensions": extensions}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 2, "type": "VEC3"},
            {
                "bufferView": 1,
                "componentType": 5120,
                "count": 2,
                "type": "VEC4",
                "normalized": True,
            },
            {
                "bufferView": 2,
                "componentType": 5121,
                "count": 2,
                "type": "SCALAR",
                "normalized": True,
            },
        ],
        "bufferViews": [
            {"byteLength": 24},
            {"byteOffset": 24, "byteLength": 8},
            {"byteOffset": 32, "byteLength": 8, "byteStride": 4},
        ],
    }
    binary = floats.tobytes() + turns.tobytes() + opacity.tobytes()
    file = rewritten(tmp_path / "others.glb", document, binary)
    cloud = read_glb(file, glb_frames(file)[0])

    assert cloud.quaternions.tolist() == [[0, 0, 0, 1], [0, -1, 0, 0]]
    torch.testing.assert_close(cloud.opacity_logits.sigmoid(), torch.tensor([1.0, 0.2]))
    torch.testing.assert_close(cloud.log_scales.exp(), cloud.means)

    document["nodes"] = [{"mesh": 0, "translation": [1, 0, 0]}]
    with refused(RenderError, "others.glb", "nodes that move"):
        glb_frames(rewritten(file, document, binary))
    document["nodes"] = [{"mesh": 0}, {"mesh": 0}]
    with refused(RenderError, "others.glb", "2 meshes", "frame number"):
        glb_frames(rewritten(file, document, binary))
    for change in (
        {"colorSpace": "lin_rec709_display"},
        {"kernel": "box"},
        {"extensions": {"KHR_gaussian_splatting_compression": {}}},
    ):
        extensions["KHR_gaussian_splatting"] = {
            "kernel": "ellipse",
            "colorSpace": "srgb_rec709_display",
        } | change
        with refused(RenderError, "others.glb", next(iter(change)), "convert it"):
            read_glb(rewritten(file, document, binary), 0)


def test_damaged_files_are_refused(sequence):
    """Cut short, absent, no .glb, an attribute less, rows beyond the data: one line that names the
    file.
    """
    document, binary = parts(sequence)
    content = sequence.read_bytes()
    for length in (0, 10, 24, 5000, len(content) - 4):
        sequence.write_bytes(content[:length])
        with refused(RenderError, "sequence.glb"):
            glb_frames(sequence)
    sequence.write_bytes(b"ply\n" + content[4:])
    with refused(RenderError, "sequence.glb", "KHR_gaussian_splatting"):
        glb_frames(sequence)
    with refused(RenderError, "absent.glb", "no such file"):
        glb_frames(sequence.with_name("absent.glb"))
    lacking = json.loads(json.dumps(document))
    del lacking["meshes"][0]["primitives"][0]["attributes"][
        "KHR_gaussian_splatting:SH_DEGREE_2_COEF_4"
    ]
    with refused(RenderError, "sequence.glb", "15 coefficients"):
        read_glb(rewritten(sequence, lacking, binary), 0)
    document["accessors"][0]["count"] = 10**12
    with refused(RenderError, "sequence.glb", "accessor 0"):
        read_glb(rewritten(sequence, document, binary), 0)


@pytest.mark.fuzz
def test_files_damaged_by_chance(sequence):
    """400 files with bytes flipped, cut, inserted, repeated: finite clouds, or a message of one
    line that names the file.
    """
    content, refusals = sequence.read_bytes(), []
    for seed in range(400):
        sequence.write_bytes(damaged(content, random_edit(Random(seed))))
        try:
            clouds = [read_glb(sequence, mesh) for mesh in glb_frames(sequence).values()]
        except RenderError as error:
            refusals.append(str(error))
        else:
            assert all(
                tensor.isfinite().all()
                for cloud in clouds
                for tensor in cloud.parameters().values()
            )
    assert 50 < len(refusals) < 400
    assert all("sequence.glb" in message and "\n" not in message for message in refusals)
