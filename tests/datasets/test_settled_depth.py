"""Near and far of captures that do not give them: by depth_range.toml, measured on the pictures, or
guessed; none is refused.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.capture import Capture
from ggvs_eval.datasets import open_capture
from ggvs_eval.depth_store import DepthStore
from ggvs_eval.errors import DepthError
from ggvs_eval.files.images import write_image
from ggvs_eval.pipelines.offline.calibration.known_cameras import read_known
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.pipelines.offline.depth.fill_store import (
    DepthPartners,
    plan_depth,
    plan_rig_depth,
    prepare_depth,
)
from ggvs_eval.pipelines.run.run_plan import RunRequest, plan_run
from ggvs_eval.pipelines.run.suggest_protocol import suggest_protocol
from helpers.captures import NAMES, make_image, make_rig, write_colmap, write_dynerf
from helpers.community_layouts import write_immersive, write_panoptic, write_technicolor
from helpers.refusals import refused
from helpers.small_layouts import (
    camera_toml,
    write_capture_toml,
    write_easymocap,
    write_multipleview,
    write_nerfstudio,
)
from helpers.textured_rigs import dome_rig, see_dome, see_straight, straight_rig, write_rig

LAYOUTS = (
    write_capture_toml,
    write_colmap,
    write_dynerf,
    write_easymocap,
    write_immersive,
    write_multipleview,
    write_nerfstudio,
    write_panoptic,
    write_technicolor,
)


@pytest.fixture(scope="module")
def straight(tmp_path_factory) -> Path:
    rig = straight_rig()
    return write_rig(
        tmp_path_factory.mktemp("straight") / "rig", rig, [see_straight(camera) for camera in rig]
    )


@pytest.fixture(scope="module")
def dome(tmp_path_factory) -> Path:
    rig = dome_rig()
    return write_rig(
        tmp_path_factory.mktemp("dome") / "rig", rig, [see_dome(camera) for camera in rig]
    )


def planned(capture: Capture, root: Path, labels: tuple[str, ...] = ("ours",)):
    protocol = suggest_protocol(capture).shortened(None, 0)
    return plan_run(RunRequest(root, capture, protocol, labels))


def test_a_straight_rig_is_measured_and_planned(straight, tmp_path):
    """Axes that meet where nothing is give a guess that is wrong by far; matches give the range,
    which a note tells.
    """
    capture = open_capture(straight)
    for camera in capture.cameras:
        assert camera.range_origin == "measured"
        assert 6 < camera.near < 12
        assert 30 < camera.far < 60
    assert "measured on matched points" in capture.notes[-1]
    # the scene's depth, not the middle of a guess
    assert capture.units_per_metre == pytest.approx(30 / 2, rel=0.35)
    assert len(planned(capture, tmp_path).plans) == 2


@pytest.mark.slow
def test_a_dome_is_measured_and_planned(dome, tmp_path):
    """The ball and the far wall lie within each camera's range, and every view has depth."""
    capture = open_capture(dome)
    assert all(1.2 < camera.near < 2.05 and 6.3 < camera.far < 9 for camera in capture.cameras)
    plan = planned(capture, tmp_path)
    assert all(job.partner_names for job in plan.view_jobs)


@pytest.mark.parametrize("write", LAYOUTS)
def test_depth_range_toml_counts_in_every_layout(tmp_path, write):
    """The file beside the capture is the range of all its cameras, whatever the layout says or does
    not.
    """
    folder = write(tmp_path / "scene")
    (folder / "depth_range.toml").write_text("near = 0.9\nfar = 35.0\n")
    capture = open_capture(folder)
    assert {(camera.near, camera.far, camera.range_origin) for camera in capture.cameras} == {
        (0.9, 35.0, "given")
    }
    assert "depth range 0.9 .. 35, by depth_range.toml" in capture.notes


def test_known_poses_want_no_points(tmp_path):
    """A model of known poses before triangulation opens, and `calibrate` reads its poses; one
    without points3D too.
    """
    folder = write_colmap(tmp_path / "scene")
    model = folder / "sparse" / "0"
    lines = model.joinpath("images.txt").read_text().splitlines()
    model.joinpath("images.txt").write_text(
        "\n".join(line if index % 2 == 0 else "" for index, line in enumerate(lines)) + "\n"
    )
    model.joinpath("points3D.txt").write_text("")
    for _ in range(2):
        capture = open_capture(folder)
        assert capture.cameras[0].range_origin == "guessed"
        assert "guessed from the viewing directions" in capture.notes[-1]
        assert "depth_range.toml" in capture.notes[-1]
        known = read_known(folder)
        for camera in make_rig():
            np.testing.assert_allclose(
                known[camera.name].world_to_camera, camera.world_to_camera, atol=1e-9
            )
        model.joinpath("points3D.txt").unlink(missing_ok=True)


def test_a_view_without_points_takes_a_guess_alone(tmp_path):
    """One registered image that sees no point costs nobody else his range."""
    folder = write_colmap(tmp_path / "scene")
    images = folder / "sparse" / "0" / "images.txt"
    lines = images.read_text().splitlines()
    images.write_text("\n".join([*lines[:1], "", *lines[2:]]) + "\n")
    points = images.with_name("points3D.txt")
    points.write_text(
        "".join(
            " ".join(line.split()[:8] + line.split()[10:]) + "\n"
            for line in points.read_text().splitlines()
        )
    )
    origins = {camera.name: camera.range_origin for camera in open_capture(folder).cameras}
    assert origins == {NAMES[0]: "guessed", **dict.fromkeys(NAMES[1:], "given")}


@pytest.mark.parametrize("rig", [straight_rig(), dome_rig()], ids=["straight", "dome"])
def test_a_guess_refuses_no_camera(tmp_path, rig):
    """Where pictures show nothing to match, the guess stays, and every camera keeps its
    partners.
    """
    folder = write_rig(tmp_path / "rig", rig, [np.full((180, 240, 3), 99, np.uint8) for _ in rig])
    capture = open_capture(folder)
    assert {camera.range_origin for camera in capture.cameras} == {"guessed"}
    partners = DepthPartners(capture, DepthOptions())
    assert all(partners.of(camera) for camera in capture.cameras)
    assert partners.describe_unmatched() == ""


def rig_with_two_turned_away(folder: Path) -> Capture:
    """Five cameras before the wall, and two among them that look back and up."""
    rig = straight_rig()
    back, up = (
        np.diag([-1.0, 1.0, -1.0, 1.0]),
        np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]]),
    )
    turned = [
        replace(camera, name=f"odd{index}", world_to_camera=turn @ camera.world_to_camera)
        for index, (camera, turn) in enumerate(((rig[1], back), (rig[3], up)))
    ]
    cameras = [replace(camera, near=8.0, far=40.0) for camera in (*rig, *turned)]
    for camera in cameras:
        write_image(folder / "images" / f"{camera.name}.png", make_image(1, 1, 240, 180))
    near_far = "near = 8.0\nfar = 40.0"
    text = "".join(camera_toml(camera, f"images/{camera.name}.png", near_far) for camera in cameras)
    (folder / "capture.toml").write_text(text)
    return open_capture(folder)


def test_a_camera_without_depth_costs_that_camera(tmp_path):
    """Cameras that nothing can be matched with are no sources, all named in one line; the run goes
    on with the others.
    """
    capture = rig_with_two_turned_away(tmp_path)
    target = capture.camera("cam02")
    partners = DepthPartners(capture, DepthOptions())
    assert [each.camera.name for each in partners.sources(target, 4)] == [
        "cam01",
        "cam03",
        "cam00",
        "cam04",
    ]
    told = partners.describe_unmatched()
    assert "no depth of odd0, odd1: wanted a partner" in told
    assert "8 .. 40 deep (given)" in told
    assert "\n" not in told
    assert [job.camera_name for job in plan_rig_depth(capture, DepthOptions())] == [
        f"cam{i:02d}" for i in range(5)
    ]


def test_too_few_cameras_with_depth_are_filled_up(tmp_path):
    """Where K cannot be met otherwise, a source without depth stays: its map is empty, and no depth
    is held against it.
    """
    capture = rig_with_two_turned_away(tmp_path / "scene")
    jobs = plan_depth(capture, [capture.camera("cam02")], 6, DepthOptions())["cam02"]
    assert not jobs["odd0"].partner_names
    assert jobs["cam01"].partner_names
    assert all(not each.camera_name.startswith("odd") for each in jobs["cam01"].checked_with)
    store = DepthStore(tmp_path / "depth")
    prepare_depth(capture, [jobs["odd0"]], range(1), store, DepthOptions(), 1)
    assert not store.read(jobs["odd0"].key, 0).depth.any()


def test_methods_that_need_no_depth_run_always(tmp_path):
    """A rig none of whose cameras can be matched is refused in one line for ours, and planned for
    IBRNet.
    """
    rig = [replace(camera, near=8.0, far=40.0) for camera in straight_rig(3)]
    turns = (-1.2, 0.0, 1.2)
    for camera, turn in zip(rig, turns, strict=True):
        cosine, sine = np.cos(turn), np.sin(turn)
        pose = np.eye(4)
        pose[:3, :3] = [[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]]
        object.__setattr__(camera, "world_to_camera", pose @ camera.world_to_camera)
        write_image(tmp_path / "images" / f"{camera.name}.png", make_image(1, 1, 240, 180))
    text = "".join(
        camera_toml(camera, f"images/{camera.name}.png", "near = 8.0\nfar = 40.0") for camera in rig
    )
    (tmp_path / "capture.toml").write_text(text)
    capture = open_capture(tmp_path)
    assert planned(capture, tmp_path / "run", ("ibrnet",)).plans["cam01"].depth_keys.keys() == {
        "cam00",
        "cam02",
    }
    with refused(DepthError, "cam00, cam01, cam02", "none of 2"):
        plan_rig_depth(capture, DepthOptions())
