"""Measured depth takes the place of stereo where a capture has it, or fills its gaps."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from ggvs_eval import plugins
from ggvs_eval.capture import Extras, GivenDepth
from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.depth_store import DepthStore
from ggvs_eval.errors import AbsentPartError, GgvsWarning, ProtocolError
from ggvs_eval.pipelines.methods.network_options import AS_SHIPPED
from ggvs_eval.pipelines.offline.depth import consistency
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.pipelines.offline.depth.consistency import LEAST_CONFIDENCE
from ggvs_eval.pipelines.offline.depth.fill_store import (
    depth_job,
    plan_depth,
    plan_rig_depth,
    prepare_depth,
)
from ggvs_eval.pipelines.run.prepare import prepare_run
from ggvs_eval.pipelines.run.run_plan import RunRequest, plan_run
from ggvs_eval.protocol import Frames, Protocol, Synthesis, Views
from helpers.refusals import refused
from helpers.stereo_scenes import PLANE, plane_depth, write_capture


class PlaneSensor:
    """Measures the plane before a camera, which comes nearer from frame to frame, with a millimetre
    of noise.
    """

    n_frames = 3
    digest = "plane"

    def __init__(self, camera):
        self.camera = camera

    def depths(self, start, stop):
        """Depth of some frames."""
        for frame in range(start, stop):
            noise = np.random.default_rng(frame).normal(
                0, 1e-3, (self.camera.height, self.camera.width)
            )
            yield (plane_depth(self.camera, PLANE - [0, 0, 0.2 * frame]) + noise).astype(np.float32)


HOLE = np.s_[20:44, 30:60]


class HoledSensor(PlaneSensor):
    """Measures nothing in a part of every image."""

    digest = "holed"

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
    """Sources with measured depth get jobs without partners, the others stereo; "no" is stereo for
    all, "fill" for all too.
    """
    jobs = plan_depth(sensed_plane, [sensed_plane.camera("cam02")], 4, DepthOptions())["cam02"]
    assert {name for name, job in jobs.items() if not job.partner_names} == {"cam00", "cam01"}
    by_stereo = plan_depth(
        sensed_plane, [sensed_plane.camera("cam02")], 4, DepthRunOptions(sensor="no").options()
    )["cam02"]
    assert all(job.partner_names for job in by_stereo.values())
    filled = plan_depth(
        sensed_plane, [sensed_plane.camera("cam02")], 4, DepthRunOptions(sensor="fill").options()
    )["cam02"]
    assert [filled[name].partner_names for name in filled] == [
        by_stereo[name].partner_names for name in filled
    ]
    assert {
        name for name in filled if filled[name].unchecked.spec != by_stereo[name].unchecked.spec
    } == {"cam00", "cam01"}


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
    """Held against another source, a sensor's hole is filled, under a key that knows how; stereo's
    key does not.
    """
    monkeypatch.setattr(consistency, "FILL_SUPPORT", 0)
    store, options = DepthStore(tmp_path), DepthOptions()
    holed = with_sensors(sensed_plane, HoledSensor)
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
    """Cameras with a sensor ignore --matcher, which is said with the way to use it; the default is
    silent.
    """
    protocol = Protocol(
        "sensed", "plane", Views(("cam02",), "by hand"), Frames(0, 1), Synthesis(k=2)
    )
    request = RunRequest(
        tmp_path / "run",
        sensed_plane,
        protocol,
        ("ours-geometric",),
        DepthRunOptions("live", sensor="alone"),
        AS_SHIPPED,
    )
    with pytest.warns(
        GgvsWarning,
        match="--matcher live has no effect on 2 cameras whose depth is measured or given; use it "
        "with --sensor fill",
    ):
        plan_run(request)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plan_run(replace(request, root=tmp_path / "usual", depth=DepthRunOptions()))
        plan_run(
            replace(request, root=tmp_path / "stereo", depth=DepthRunOptions("live", sensor="no"))
        )
        plan_run(
            replace(request, root=tmp_path / "both", depth=DepthRunOptions("live", sensor="fill"))
        )


class FarSensor(HoledSensor):
    """Measures a twentieth too far."""

    digest = "far"

    def depths(self, start, stop):
        """Depth of some frames."""
        yield from (depth * np.float32(1.05) for depth in super().depths(start, stop))


def with_sensors(capture, kind):
    """The capture with sensors of another kind in the places of its own."""
    return replace(
        capture,
        extras=tuple(
            replace(each, depth=each.depth and kind(each.depth.camera)) for each in capture.extras
        ),
    )


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "chosen"), [(PlaneSensor, "alone"), (FarSensor, "fill")])
def test_the_better_depth_is_used(sensed_plane, tmp_path, kind, chosen):
    """A sensor that explains other cameras' pictures better than stereo is used alone, else in its
    gaps; the folder keeps it.
    """
    protocol = Protocol(
        "sensed", "plane", Views(("cam02",), "by hand"), Frames(0, 1), Synthesis(k=3)
    )
    request = RunRequest(
        tmp_path / "run",
        with_sensors(sensed_plane, kind),
        protocol,
        ("ours-geometric",),
        None,
        AS_SHIPPED,
    )
    plan = plan_run(request)
    sensor, stereo = plan.depth.compared["unexplained"]
    assert plan.depth.choice.sensor == chosen, (sensor, stereo)
    assert (stereo < sensor) == (chosen == "fill")

    again = plan_run(replace(prepare_run(plan).request, depth=DepthRunOptions()))

    assert (again.depth.choice, again.depth.compared, again.original.notes) == (
        plan.depth.choice,
        plan.depth.compared,
        plan.original.notes,
    )
    assert f"stereo's {stereo:.1f}" in plan.original.notes[-1]
    with pytest.raises(ProtocolError, match="holds a run whose depth is found by"):
        plan_run(replace(request, depth=DepthRunOptions(sensor="no")))


def test_given_depth_is_used_as_it_is(sensed_plane, tmp_path):
    """What a user gives is not replaced by stereo, however wrong it is."""
    protocol = Protocol(
        "sensed", "plane", Views(("cam02",), "by hand"), Frames(0, 1), Synthesis(k=3)
    )
    given = replace(with_sensors(sensed_plane, FarSensor), given_depth=GivenDepth("maps"))
    plan = plan_run(
        RunRequest(tmp_path / "run", given, protocol, ("ours-geometric",), None, AS_SHIPPED)
    )
    assert (plan.depth.choice.sensor, plan.depth.compared) == ("alone", {})


def test_a_sensor_fills_what_stereo_does_not_find(sensed_plane, tmp_path):
    """What stereo finds stays; elsewhere the sensor's depth stands, of little confidence, after the
    check as well.
    """
    store, options = DepthStore(tmp_path), DepthRunOptions(sensor="fill").options()
    jobs = [plan_depth(sensed_plane, [sensed_plane.camera("cam02")], 4, each)["cam02"]["cam00"]
            for each in (options, DepthRunOptions(sensor="no").options())]  # fmt: skip
    for job, each in zip(jobs, (options, DepthRunOptions(sensor="no").options()), strict=True):
        prepare_depth(sensed_plane, [job], range(1), store, each, workers=1)

    both, stereo = (store.read(job.key, 0) for job in jobs)

    found = stereo.confidence > LEAST_CONFIDENCE
    assert 0.5 < found.mean() < 1
    np.testing.assert_array_equal(both.depth[found], stereo.depth[found])
    truth = plane_depth(sensed_plane.camera("cam00"), PLANE)
    errors = [np.abs(each.depth / truth - 1)[~found].max() for each in (both, stereo)]
    assert errors[0] < 0.005 < errors[1]
    assert (both.confidence[~found] < LEAST_CONFIDENCE).all()


@pytest.mark.slow
def test_a_run_without_depth_leaves_the_choice_to_the_first_with_it(sensed_plane, tmp_path):
    """View interpolation wants no depth; the folder keeps what is chosen once a method does."""
    protocol = Protocol(
        "sensed", "plane", Views(("cam02",), "by hand"), Frames(0, 1), Synthesis(k=2)
    )
    request = RunRequest(
        tmp_path / "run",
        with_sensors(sensed_plane, FarSensor),
        protocol,
        ("interpolation",),
        None,
        AS_SHIPPED,
    )
    assert prepare_run(plan_run(request)).depth.choice.sensor == "compare"
    prepare_run(plan_run(replace(request, labels=("ours-geometric",))))
    again = plan_run(request)
    assert again.depth.choice.sensor == "fill"
    assert again.depth.compared


def test_a_capture_with_sensors_wants_what_filters_their_depth(sensed_plane, monkeypatch):
    """Where that is not installed it is refused in a line, and matched for a user who wants no
    sensor.
    """
    part = "ggvs_eval.pipelines.offline.sensor"
    monkeypatch.setattr(
        plugins, "missing_part", lambda module: part if module.startswith(part) else None
    )

    with refused(AbsentPartError, f"sensor depth is part of {part}", "omit it"):
        plan_rig_depth(sensed_plane, DepthOptions())
    assert len(plan_rig_depth(sensed_plane, DepthOptions(sensor=False))) == 5
