"""COLMAP's dense workspace: its own reader and its own fusion are the reference."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ggvs_eval.camera import Camera
from ggvs_eval.datasets import open_capture
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.errors import DepthError
from ggvs_eval.files.images import read_image
from ggvs_eval.pipelines.offline.export.dense_workspace import (
    read_array,
    write_array,
    write_dense_workspace,
)
from helpers.refusals import refused
from helpers.stereo_scenes import PLANE, look_from, plane_depth, see_plane

PLACES = [(0, 0), (0.4, 0), (-0.4, 0), (0, 0.4)]
READ = """
import json, sys
import numpy as np, pycolmap
from pathlib import Path
folder, out = Path(sys.argv[1]), Path(sys.argv[2])
model = pycolmap.Reconstruction(str(folder / "sparse"))
described = {"points": [point.xyz.tolist() for point in model.points3D.values()]}
for image in model.images.values():
    described[image.name] = {
        "K": image.camera.calibration_matrix().tolist(),
        "size": [image.camera.width, image.camera.height],
        "pose": image.cam_from_world().matrix().tolist(),
        "sights": [[*p.xy.tolist(), *model.points3D[p.point3D_id].xyz.tolist()] for p in image.points2D if p.has_point3D()],
    }
    for kind, reader in (("depth", pycolmap.DepthMap()), ("normal", pycolmap.NormalMap())):
        reader.read(str(folder / "stereo" / f"{kind}_maps" / f"{image.name}.geometric.bin"))
        values = reader.to_array()  # of normals its memory as it is: three planes, whatever its shape says
        np.save(out / f"{image.name}.{kind}.npy", values.reshape(-1, *values.shape[:2]))
(out / "model.json").write_text(json.dumps(described))
"""  # noqa: E501


def rig() -> list[Camera]:
    return [look_from(x, y, f"cam{index:02d}", 0.05) for index, (x, y) in enumerate(PLACES)]


def depth_maps() -> list[DepthMap]:
    """Exact depth of the plane; a corner is empty, and a corner is filled in with nonsense."""
    maps = []
    for camera in rig():
        depth = plane_depth(camera).astype(np.float32)
        confidence = np.full(depth.shape, 0.9, np.float32)
        depth[:20, :20], confidence[:20, :20] = 0, 0
        depth[-20:, -20:], confidence[-20:, -20:] = 4.5, 0.02
        maps.append(DepthMap(depth, confidence))
    return maps


@pytest.fixture(scope="module")
def workspace(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("dense") / "new" / "workspace"
    partners = {"cam00": ("cam02", "cam01", "elsewhere"), "cam01": ("cam00",), "cam03": ()}
    return write_dense_workspace(
        rig(), [see_plane(camera) for camera in rig()], depth_maps(), partners, folder
    )


@pytest.fixture(scope="module")
def by_colmap(workspace, tmp_path_factory) -> Path:
    """What COLMAP makes of the workspace, in a process of its own: in ours pycolmap would break the
    writing of PNG files.
    """
    out = tmp_path_factory.mktemp("colmap")
    subprocess.run(
        [sys.executable, "-c", READ, str(workspace), str(out)],
        check=True,
        timeout=120,
        capture_output=True,
    )
    return out


def test_workspace_is_whole(workspace):
    """Images, model, maps and lists lie where COLMAP looks for them, and nothing else does."""
    names = [f"cam{index:02d}.png" for index in range(4)]
    maps = [
        f"stereo/{kind}_maps/{name}.geometric.bin" for kind in ("depth", "normal") for name in names
    ]
    model = [f"sparse/{name}.txt" for name in ("cameras", "images", "points3D")]
    wanted = {
        *(f"images/{name}" for name in names),
        *maps,
        *model,
        "stereo/patch-match.cfg",
        "stereo/fusion.cfg",
    }
    assert {
        str(file.relative_to(workspace)) for file in workspace.rglob("*") if file.is_file()
    } == wanted
    assert (workspace / "stereo" / "consistency_graphs").is_dir()
    assert [folder.name for folder in workspace.parent.iterdir()] == ["workspace"]
    assert (read_image(workspace / "images" / "cam01.png") == see_plane(rig()[1])).all()


def test_lists_name_partners(workspace):
    """The partners of the depth are the sources of patch matching where they are exported; COLMAP
    chooses where none is.
    """
    lines = (workspace / "stereo" / "patch-match.cfg").read_text().splitlines()
    assert lines == [
        *("cam00.png", "cam02.png, cam01.png"),
        *("cam01.png", "cam00.png"),
        *("cam02.png", "__auto__, 20"),
        *("cam03.png", "__auto__, 20"),
    ]
    assert (workspace / "stereo" / "fusion.cfg").read_text().split() == [
        f"cam{index:02d}.png" for index in range(4)
    ]


def test_depth_is_written_as_it_is(workspace):
    """Bytes after the header are little-endian rows of depth, equal to the last bit; filled pixels
    are unknown.
    """
    for camera, depth_map in zip(rig(), depth_maps(), strict=True):
        content = (
            workspace / "stereo" / "depth_maps" / f"{camera.name}.png.geometric.bin"
        ).read_bytes()
        header = f"{camera.width}&{camera.height}&1&".encode()
        assert content.startswith(header)
        found = np.frombuffer(content[len(header) :], "<f4").reshape(camera.height, camera.width)
        assert (found == np.where(depth_map.confidence > 0.5, depth_map.depth, 0)).all()


@pytest.mark.slow
def test_colmap_reads_the_maps(by_colmap):
    """COLMAP's own readers find our depth to the last bit, and the normal of the plane, towards the
    camera.
    """
    normal = np.array([PLANE[0], PLANE[1], -1.0]) / np.linalg.norm([PLANE[0], PLANE[1], 1.0])
    for camera, depth_map in zip(rig(), depth_maps(), strict=True):
        depth, normals = (
            np.moveaxis(np.load(by_colmap / f"{camera.name}.png.{kind}.npy"), 0, -1)
            for kind in ("depth", "normal")
        )
        known = depth_map.confidence > 0.5
        assert (depth[..., 0] == np.where(known, depth_map.depth, 0)).all()
        assert np.abs(normals @ camera.rotation - normal)[known].max() < 1e-3
        assert not normals[~known].any()


@pytest.mark.slow
def test_colmap_reads_the_cameras(by_colmap):
    """COLMAP's model has our cameras, and its points lie on the plane and where it says that each
    camera sees them.
    """
    model = json.loads((by_colmap / "model.json").read_text())
    points = np.array(model["points"])
    assert len(points) > 1000
    assert np.abs(points @ [-PLANE[0], -PLANE[1], 1.0] - PLANE[2]).max() < 1e-5
    for camera in rig():
        found = model[f"{camera.name}.png"]
        sights = np.array(found["sights"])
        assert found["size"] == [camera.width, camera.height]
        assert np.allclose(found["K"], camera.K)
        assert np.allclose(found["pose"], camera.world_to_camera[:3])
        assert np.abs(camera.project(sights[:, 2:])[0] - sights[:, :2]).max() < 1e-6


def test_the_sparse_model_is_a_capture(workspace, tmp_path):
    """Our own reader opens the exported images and model."""
    capture = open_capture(workspace, "colmap")
    assert capture.camera_names == tuple(f"cam{index:02d}" for index in range(4))
    for camera in rig():
        assert np.allclose(capture.camera(camera.name).world_to_camera, camera.world_to_camera)


def test_points_come_from_what_two_cameras_see(tmp_path):
    """A depth map that no other agrees with gives no point."""
    maps = depth_maps()
    maps[3] = DepthMap(maps[3].depth * 1.2, maps[3].confidence)
    images = [see_plane(camera) for camera in rig()]
    folder = write_dense_workspace(
        rig(), images, maps, {}, tmp_path / "workspace", points_per_camera=200
    )
    lines = (folder / "sparse" / "points3D.txt").read_text().splitlines()
    tracks = [line.split()[8::2] for line in lines]
    assert 300 < len(tracks) <= 600
    assert all("4" not in track and len(track) >= 2 for track in tracks)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    st.tuples(*[st.integers(1, 7)] * 3).flatmap(
        lambda shape: arrays(np.float32, shape, elements=st.floats(0, 1e6, width=32))
    )
)
def test_any_array_comes_back(tmp_path_factory, array):
    """What is written is read again, whatever its size and number of channels."""
    path = tmp_path_factory.mktemp("array") / "map.bin"
    write_array(path, array)
    assert (read_array(path) == (array[..., 0] if array.shape[2] == 1 else array)).all()
    assert [file.name for file in path.parent.iterdir()] == ["map.bin"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "begins with width&height&channels&, got b''"),
        (b"4&3&", "begins with width&height&channels&"),
        (b"-4&3&1&" + bytes(48), "begins with width&height&channels&"),
        (
            b"4&3&1&" + bytes(47),
            "wanted 4 x 3 x 1 numbers in 48 bytes, got 47; the file is cut short",
        ),
        (b"4&3&1&" + bytes(49), "in 48 bytes, got 49"),
        (b"0&3&1&", "wanted 0 x 3 x 1 numbers"),
        (b"999999999&999999999&9&" + bytes(8), "got 8"),
    ],
)
def test_malformed_maps_are_refused(tmp_path, content, message):
    """A damaged map is refused by name, without believing its header."""
    path = tmp_path / "cam00.png.geometric.bin"
    path.write_bytes(content)
    with pytest.raises(DepthError) as caught:
        read_array(path)
    assert str(path) in str(caught.value)
    assert message in str(caught.value)
    with pytest.raises(DepthError, match="export the workspace again"):
        read_array(tmp_path / "none.bin")


def test_what_cannot_be_exported(tmp_path):
    """Folders that hold something, names that COLMAP's files cannot hold and sizes that do not fit
    are refused, unwritten.
    """
    cameras, maps = rig(), depth_maps()
    images = [see_plane(camera) for camera in cameras]
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "thesis.tex").write_text("x")
    with refused(DepthError, "taken: ", "empty"):
        write_dense_workspace(cameras, images, maps, {}, tmp_path / "taken")
    named = [look_from(0, 0, "left camera"), *cameras[1:]]
    with refused(DepthError, "'left camera'", "blanks"):
        write_dense_workspace(named, images, maps, {}, tmp_path / "out")
    with refused(DepthError, "camera cam00", "(150, 200, 3)", "uint8 (150, 100, 3)"):
        write_dense_workspace(cameras, [images[0][:, ::2], *images[1:]], maps, {}, tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]
