"""Samples of captures: ScanNet's rule, measured depth, rigs, what is kept on disk, and what must
not be learned from.
"""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from ggvs_eval.contrib.training.samples.capture_source import (
    CapturePlan,
    CaptureSource,
    capture_sources,
    draw_views,
    overlap,
    possible_targets,
    within_rule,
)
from ggvs_eval.contrib.training.samples.sample_kinds import BlendKind
from ggvs_eval.contrib.training.samples.samples import SampleMaker, SamplePool, make_samples
from ggvs_eval.datasets import open_capture
from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.errors import TrainingError
from ggvs_eval.metrics.image.psnr import psnr
from helpers.refusals import refused
from helpers.stereo_scenes import HEIGHT, WIDTH, look_from, plane_depth, see_plane, write_capture

NUMBERS = [*range(10, 20), *range(22, 40), *range(43, 46)]
PLAN = CapturePlan(targets=3, views=3, span=12, gap=2, width=WIDTH, height=HEIGHT)
RIG_PLAN = CapturePlan(targets=5, views=2, instants=2, width=160, height=90)


@pytest.fixture(scope="module")
def sequence(tmp_path_factory):
    """A camera carried before a slanted plane, with a depth sensor, as ScanNet exports it, with
    gaps in its numbers.
    """
    folder = tmp_path_factory.mktemp("rgbd") / "scene0000_00"
    for name in ("color", "depth", "pose", "intrinsic"):
        (folder / name).mkdir(parents=True)
    for number in NUMBERS:
        camera = look_from(0.04 * (number - 25), 0.1 * np.sin(number), f"{number}")
        cv2.imwrite(str(folder / "color" / f"{number}.png"), see_plane(camera))
        noise = np.random.default_rng(number).normal(0, 0.003, (HEIGHT, WIDTH))
        depth_mm = np.rint(1000 * (plane_depth(camera) + noise)).astype(np.uint16)
        cv2.imwrite(str(folder / "depth" / f"{number}.png"), depth_mm)
        np.savetxt(folder / "pose" / f"{number}.txt", np.linalg.inv(camera.world_to_camera))
    for name in ("color", "depth"):
        K = np.eye(4)
        K[:3, :3] = camera.K
        np.savetxt(folder / "intrinsic" / f"intrinsic_{name}.txt", K)
    return open_capture(folder)


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """Five cameras before a plane that comes nearer, three instants."""
    return write_capture(tmp_path_factory.mktemp("rig"))


def test_sources_obey_the_rule(sequence):
    """Always K different frames within 12 of the target by number, none within 2 of it, nearest
    first; missing numbers count.
    """
    for number in range(40):
        target, sources = draw_views(sequence, PLAN, "scene", number)
        apart = [abs(int(source.name) - int(target.name)) for source in sources]
        assert len({source.name for source in sources}) == 3
        assert all(2 < frames <= 12 for frames in apart)
        distances = [np.linalg.norm(source.centre - target.centre) for source in sources]
        assert distances == sorted(distances)
    names = [int(camera.name) for camera in within_rule(sequence, sequence.camera("000019"), PLAN)]
    assert names == [*range(10, 17), *range(22, 32)]


def test_every_frame_has_its_turn(sequence):
    """No target comes twice before all have been one; each that has K sources is one; more samples
    change none.
    """
    possible = possible_targets(sequence, PLAN)
    drawn = [draw_views(sequence, PLAN, "scene", number)[0].name for number in range(len(possible))]
    assert sorted(drawn) == sorted(camera.name for camera in possible)
    assert drawn != sorted(drawn)
    more = replace(PLAN, targets=99)
    assert [draw_views(sequence, more, "scene", n)[1] for n in range(9)] == [
        draw_views(sequence, PLAN, "scene", n)[1] for n in range(9)
    ]


@pytest.mark.slow
def test_all_that_is_allowed_is_drawn(sequence):
    """Over many samples every distance that the rule allows occurs, before and after, about equally
    often: not the nearest.
    """
    drawn = [draw_views(sequence, PLAN, "scene", number) for number in range(200)]
    apart = [int(source.name) - int(target.name) for target, sources in drawn for source in sources]
    counts = {frames: apart.count(frames) for frames in {*apart}}
    assert counts.keys() == {*range(-12, -2), *range(3, 13)}
    assert max(counts.values()) < 4 * min(counts.values())


def test_frames_that_look_elsewhere_are_not_drawn(sequence):
    """Where every second frame looks backwards, sources are of the others; else those that see
    most.
    """
    backwards = np.diag([-1.0, 1.0, -1.0, 1.0])

    def turned(looks_away):
        return replace(
            sequence,
            cameras=tuple(
                replace(camera, world_to_camera=backwards @ camera.world_to_camera)
                if looks_away(int(camera.name))
                else camera
                for camera in sequence.cameras
            ),
        )

    half = turned(lambda number: number % 2 == 0)
    for number in range(20):
        target, sources = draw_views(half, PLAN, "scene", number)
        assert {int(source.name) % 2 for source in sources} == {int(target.name) % 2}
    few = turned(lambda number: number not in (25, 30))
    for number in range(40):
        target, sources = draw_views(few, PLAN, "scene", number)
        if target.name == "000025":
            assert "000030" in [source.name for source in sources]


def test_overlap_is_the_share_of_the_view():
    """All of its own view, none of one that looks backwards, half of one whose image is the left
    half.
    """
    camera = look_from(0.0, 0.0, "1")
    assert overlap(camera, camera) == 1
    assert overlap(camera, replace(camera, world_to_camera=np.diag([-1.0, 1.0, -1.0, 1.0]))) == 0
    assert overlap(camera, camera.cropped(0, 0, WIDTH // 2, HEIGHT)) == 0.5


def test_a_sample_has_the_sensor_s_depth(sequence):
    """Fused to the plane, unless the sensor is not wanted; truth is the target's frame."""
    target, sources = draw_views(sequence, PLAN, "scene", 4)
    sample = BlendKind().make(SampleMaker(sequence, DepthRunOptions().options()), target, sources)
    exact, fused = plane_depth(target), sample.views.fused_depth
    known = fused > 0
    assert known.mean() > 0.7
    assert np.median(np.abs(fused / exact - 1)[known]) < 0.002
    assert np.quantile(np.abs(fused / exact - 1)[known], 0.9) < 0.01
    np.testing.assert_array_equal(sample.truth, sequence.frame(target.name, 0))
    inside = (slice(15, -15), slice(15, -15))
    assert psnr(sample.geometric[inside], sample.truth[inside]) > 25
    stereo = BlendKind().make(
        SampleMaker(sequence, DepthRunOptions(sensor="no").options()), target, sources
    )
    assert not np.array_equal(stereo.views.depths, sample.views.depths)


@pytest.mark.slow
def test_samples_are_kept_and_read(sequence, rig, tmp_path):
    """One file per capture and target; what is there stays; equal plans give equal bytes of pixels,
    whatever the workers.
    """
    samples = SamplePool(tmp_path, BlendKind(), [CaptureSource(sequence, PLAN)])
    assert len(samples) == 3
    samples.prepare(1)
    files = {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*.npz")}
    assert len(files) == 3
    SamplePool(tmp_path, BlendKind(), [CaptureSource(sequence, PLAN)]).prepare(1)
    assert {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*.npz")} == files
    sample = samples.read(1)
    assert len(sample.views.sources) == 3
    assert sample.truth.shape == (HEIGHT, WIDTH, 3)
    target, sources = draw_views(sequence, PLAN, samples.sources[0].name, 1)
    direct = BlendKind().make(
        SampleMaker(sequence, DepthRunOptions(PLAN.matcher).options()), target, sources
    )
    np.testing.assert_array_equal(sample.views.fused_depth, direct.views.fused_depth)
    np.testing.assert_array_equal(sample.geometric, direct.geometric)
    assert str(tmp_path) not in repr(samples)
    assert str(sequence.path) not in repr(samples)


def test_a_rig_s_samples_take_turns_at_its_instants(rig, tmp_path):
    """Even numbers show one instant, odd ones another; targets are not among their sources; sizes
    cover the plan's.
    """
    source = CaptureSource(rig, RIG_PLAN)
    samples, capture = SamplePool(tmp_path, BlendKind(), [source]), source.capture
    assert source.groups() == [[0, 2, 4], [1, 3]]
    assert capture.cameras[0].size == (160, 120)
    for numbers, frame in (([0, 2], 0), ([1], 2)):
        make_samples(
            source,
            samples.kind,
            capture,
            {number: samples.path(source, number) for number in numbers},
        )
        for number in numbers:
            sample = samples.read(number)
            np.testing.assert_array_equal(
                sample.truth, capture.frame(sample.views.target.name, frame)
            )
            assert sample.views.target.name not in [source.name for source in sample.views.sources]
            assert len(sample.views.sources) == 2
    with refused(TrainingError, "got none"):
        samples.read(3)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"width": 400}, "wanted images of at least 400 x 150, got 200 x 150 of"),
        (
            {"views": 40},
            "wanted a target with 40 other cameras numbered 3..12 from it, got 31 cameras",
        ),
        ({"instants": 2}, "wanted 2 instants, the capture has 1 frames"),
    ],
)
def test_captures_that_do_not_fit_are_refused(sequence, changes, words):
    """Too small, too few frames within the rule, too few instants: one line that names the
    capture.
    """
    with pytest.raises(TrainingError, match=words) as caught:
        CaptureSource(sequence, replace(PLAN, **changes))
    assert str(sequence.path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_plans_without_samples_are_refused():
    """No views, or a gap as wide as the span; the paper's rule is the default."""
    assert (CapturePlan().span, CapturePlan().gap, CapturePlan().views) == (30, 4, 4)
    for changes in ({"views": 0}, {"gap": 30}, {"gap": -1}, {"targets": 0}):
        with pytest.raises(TrainingError, match="0 <= gap < span"):
            CapturePlan(**changes)


def test_each_capture_once(sequence, rig):
    """The same capture twice is refused, and named."""
    with pytest.raises(TrainingError, match="wanted each once") as caught:
        capture_sources([sequence, sequence], PLAN)
    assert str(sequence.path) in str(caught.value)
    assert len(capture_sources([rig], RIG_PLAN)) == 1


def test_the_demo_capture_is_never_learned_from(rig, tmp_path):
    """A capture whose note gives the seed of a test room, or none, is refused; training and
    validation rooms are not.
    """
    noted = replace(rig, path=tmp_path)
    for options, words in (({"seed": 0}, "seed 0"), ({"seed": 100}, "seed 100"), ({}, "seed")):
        (tmp_path / "demo.json").write_text(json.dumps({"options": options}))
        with refused(TrainingError, words):
            CaptureSource(noted, RIG_PLAN)
    for seed in (101, 1000):
        (tmp_path / "demo.json").write_text(json.dumps({"options": {"seed": seed}}))
        assert CaptureSource(noted, RIG_PLAN).count == 5
