"""The choice of sources goes through a whole run: the same for all methods, and along the path with
shares that follow it.
"""

from dataclasses import replace

import numpy as np
import pytest

from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.errors import CameraError
from ggvs_eval.geometry.source_views import choose_sources
from ggvs_eval.pipelines.play.synthesizer import OnlineSynthesizer
from ggvs_eval.pipelines.run.evaluate import measure
from ggvs_eval.pipelines.run.run_plan import RunRequest, plan_run
from ggvs_eval.pipelines.run.suggest_protocol import suggest_protocol
from ggvs_eval.protocol import CameraPath, Frames, Measurement, Protocol, Synthesis, Views
from ggvs_eval.results import Results
from ggvs_eval.run_folder import RunFolder, read_json
from helpers.refusals import refused
from helpers.scenes import camera_at, look
from helpers.stereo_scenes import write_capture

LABELS = ("no-blending", "distance-based")


@pytest.fixture(scope="module")
def plane_capture(tmp_path_factory):
    """Five cameras before a plane."""
    return write_capture(tmp_path_factory.mktemp("plane"))


def chosen_protocol(sources: str) -> Protocol:
    """One view over two frames, and a path of six poses."""
    views, synthesis = Views(("cam00",), "by hand"), Synthesis(k=2, sources=sources)
    measurement = Measurement(metrics=("PSNR", "reprojection"), ceilings=False)
    return Protocol(
        "tiny", "plane", views, Frames(0, 2), synthesis, measurement, CameraPath(poses=6)
    )


@pytest.mark.slow
def test_a_run_takes_the_chosen_sources(plane_capture, tmp_path):
    """Views and path are synthesised from what `choose_sources` gives; the record of the path says
    so; scores come out.
    """
    protocol = chosen_protocol("coverage")
    planned = plan_run(
        RunRequest(tmp_path, plane_capture, protocol, LABELS, DepthRunOptions("sgbm"))
    )
    measure(planned, 1)
    for view in planned.plans.values():
        chosen = choose_sources(view.target, plane_capture.cameras, 2, "coverage")
        assert [*view.depth_keys] == [*view.shares] == [each.camera.name for each in chosen]
        assert set(view.shares.values()) == {1.0}  # it stands still
    for pose, recorded in zip(
        planned.path, read_json(RunFolder(tmp_path).path_record)["sources"], strict=True
    ):
        chosen = choose_sources(pose.target, plane_capture.cameras, 2, "coverage")
        assert pose.shares == {each.camera.name: each.share for each in chosen}
        assert recorded == [*pose.shares]
    assert not Results.read(tmp_path).per_view("PSNR").isna().any(axis=None)


def test_shares_are_part_of_what_a_rendering_depends_on(plane_capture, tmp_path):
    """Other shares along the path, another job; equal ones, the same."""
    planned = plan_run(RunRequest(tmp_path, plane_capture, chosen_protocol("nearest"), LABELS[:1]))
    halved = tuple(replace(pose, shares=dict.fromkeys(pose.shares, 0.5)) for pose in planned.path)
    path, view = planned.renders  # the longer one first
    other_path, same_view = replace(planned, path=halved).renders
    assert same_view.sha256 == view.sha256
    assert other_path.sha256 != path.sha256


@pytest.mark.parametrize("sources", ["nearest", "coverage"])
def test_a_live_method_is_told_the_shares(sources):
    """Each step's views carry the share of their choice; near an exchange one of them has hardly
    any.
    """
    rig, told = [camera_at(x) for x in (-0.45, -0.15, 0.15, 0.45)], []

    class Watching:
        def step(self, instant):
            told.append({view.camera.name: view.share for view in instant.sources})
            return None

    live = OnlineSynthesizer(rig, 2, 2.5, Watching, sources=sources)
    looks = {camera.name: look(camera) for camera in rig}
    images, depths = ({name: each[index] for name, each in looks.items()} for index in (0, 1))
    targets = [camera_at(x, name="virtual") for x in (-0.33, 0.0, -0.14)]
    for target in targets:
        live.step(images, depths, target)
        chosen = choose_sources(target, rig, 2, sources)
        assert told[-1] == {each.camera.name: each.share for each in chosen}
        assert [camera.name for camera in live.sources(target)] == [*told[-1]]
    assert min(min(shares.values()) for shares in told) < 1
    with refused(CameraError, "nearest, coverage", "'covrage'"):
        OnlineSynthesizer(rig, 1, sources="covrage")  # type: ignore[arg-type]


def test_a_hand_held_sequence_is_suggested_coverage(plane_capture):
    """Nearest places of a camera that was carried may look elsewhere; a rig keeps the paper's
    choice.
    """
    assert suggest_protocol(replace(plane_capture, layout="rgbd")).synthesis.sources == "coverage"
    assert suggest_protocol(plane_capture).synthesis.sources == "nearest"


def test_all_views_that_no_source_shows_are_in_one_message(plane_capture, tmp_path):
    """The first with its reason, the others by their names."""
    backwards = np.diag([-1.0, 1.0, -1.0, 1.0])
    cameras = [
        camera
        if camera.name in ("cam00", "cam01")
        else replace(camera, world_to_camera=backwards @ camera.world_to_camera)
        for camera in plane_capture.cameras
    ]
    protocol = replace(
        chosen_protocol("nearest"),
        views=Views(("cam00", "cam01"), "by hand"),
        path=CameraPath(poses=0),
    )
    with refused(CameraError, "camera cam00: ", "the same holds for cam01", "enerf"):
        plan_run(
            RunRequest(tmp_path, replace(plane_capture, cameras=tuple(cameras)), protocol, LABELS)
        )
