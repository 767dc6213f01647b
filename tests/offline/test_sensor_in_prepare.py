"""Measured depth takes the place of stereo where a capture has it."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from ggvs_eval.capture import Extras
from ggvs_eval.depth_store import DepthStore
from ggvs_eval.errors import GgvsWarning
from ggvs_eval.pipelines.methods.network_options import AS_SHIPPED
from ggvs_eval.pipelines.offline.depth import consistency
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.pipelines.offline.depth.depth_choice import DepthRunOptions
from ggvs_eval.pipelines.offline.depth.fill_store import depth_job, plan_depth, prepare_depth
from ggvs_eval.pipelines.run.run_plan import RunRequest, plan_run
from ggvs_eval.protocol import Frames, Protocol, Synthesis, Views
from helpers.stereo_scenes import PLANE, plane_depth, write_capture

pytestmark = pytest.mark.slow


class PlaneSensor:
    """Measures the plane before a camera, which comes nearer from frame to frame, with a millimetre of noise."""

    n_frames = 3
    digest = "plane"

    def __init__(self, camera):
        self.camera = camera

    def depths(self, start, stop):
        """Depth of some frames."""
        for frame in range(start, stop):
            noise = np.random.default_rng(frame).normal(0, 1e-3, (self.camera.height, self.camera.width))
            yield (plane_depth(self.camera, PLANE - [0, 0, 0.2 * frame]) + noise).astype(np.float32)


HOLE = np.s_[20:44, 30:60]


class HoledSensor(PlaneSensor):
    """Measures nothing in a part of every image."""

    def depths(self, start, stop):
        """Depth of some frames."""
        for depth in super().depths(start, stop):
            depth[HOLE] = 0
            yield depth


@pytest.fixture(scope="module")
def sensed_plane(tmp_path_factory):
    """Five cameras before a plane, the first two with a depth sensor beside them."""
    stereo = write_capture(tmp_path_factory.mktemp("capture"))
    sensors = [Extras(depth=PlaneSensor(camera)) for camera in stereo.cameras[:2]]
    return replace(stereo, extras=(*sensors, *(Extras() for _ in stereo.cameras[2:])))


def test_cameras_with_a_sensor_need_no_partners(sensed_plane):
    """Sources with measured depth get jobs without partners, the others stereo; --no-sensor is stereo for all."""
    jobs = plan_depth(sensed_plane, [sensed_plane.camera("cam02")], 4, DepthOptions())["cam02"]
    assert {name for name, job in jobs.items() if not job.partner_names} == {"cam00", "cam01"}
    by_stereo = plan_depth(sensed_plane, [sensed_plane.camera("cam02")], 4, DepthRunOptions(sensor=False).options())["cam02"]
    assert all(job.partner_names for job in by_stereo.values())


def test_measured_depth_reaches_the_store(sensed_plane, tmp_path):
    """What is stored is the sensor's depth of that very frame, filtered, under a key of its own."""
    store, options = DepthStore(tmp_path), DepthOptions()
    job = depth_job(sensed_plane, "cam01", (), options)
    prepare_depth(sensed_plane, [job], range(3), store, options, workers=1)
    key = job.key
    for frame in range(3):
        truth = plane_depth(sensed_plane.camera("cam01"), PLANE - [0, 0, 0.2 * frame])
        assert np.median(np.abs(store.read(key, frame).depth / truth - 1)) < 1e-3
    stereo = depth_job(sensed_plane, "cam01", ("cam00",), options).spec
    assert DepthStore.key(stereo) != key
    assert job.spec["options"]["algorithm"].startswith("sensor-filter")


def test_holes_of_measured_depth_are_filled_by_colour(sensed_plane, tmp_path, monkeypatch):
    """Held against another source, a sensor's hole is filled, under a key that knows how; stereo's key does not."""
    monkeypatch.setattr(consistency, "FILL_SUPPORT", 0)
    store, options = DepthStore(tmp_path), DepthOptions()
    extras = tuple(replace(each, depth=each.depth and HoledSensor(each.depth.camera)) for each in sensed_plane.extras)
    holed = replace(sensed_plane, extras=extras)
    jobs = plan_depth(holed, [sensed_plane.camera("cam02")], 4, options)["cam02"]
    prepare_depth(holed, [jobs["cam00"]], range(1), store, options, workers=1)

    depth_map = store.read(jobs["cam00"].key, 0)

    truth = plane_depth(sensed_plane.camera("cam00"), PLANE)
    assert (depth_map.depth > 0).all()
    assert (depth_map.confidence[HOLE] < 0.03).all()
    assert np.median(np.abs(depth_map.depth / truth - 1)[HOLE]) < 0.02
    described = {name: job.spec["check"] for name, job in jobs.items()}
    assert ["fill" in described[name] for name in ("cam00", "cam03")] == [True, False]


def test_a_matcher_without_effect_says_so(sensed_plane, tmp_path):
    """Cameras with a sensor ignore --matcher, which is said with the way to use it; the default is silent."""
    protocol = Protocol("sensed", "plane", Views(("cam02",), "by hand"), Frames(0, 1), Synthesis(k=2))
    request = RunRequest(tmp_path / "run", sensed_plane, protocol, ("ours-geometric",), DepthRunOptions("live"), AS_SHIPPED)
    with pytest.warns(
        GgvsWarning, match="--matcher live has no effect on 2 cameras whose depth is measured or given; use it with --no-sensor"
    ):
        plan_run(request)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plan_run(replace(request, root=tmp_path / "usual", depth=DepthRunOptions()))
        plan_run(replace(request, root=tmp_path / "stereo", depth=DepthRunOptions("live", sensor=False)))
