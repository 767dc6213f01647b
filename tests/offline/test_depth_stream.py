"""Depth over time: only what changes is computed again, keyframes make it restartable, the default
forgets everything.
"""

import re

import numpy as np
import pytest

from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.depth_store import DepthStore
from ggvs_eval.errors import DepthError, WeightsError
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthEstimator, DepthOptions
from ggvs_eval.pipelines.offline.depth.depth_choice import (
    FORMS,
    KEYFRAME_EVERY,
    MATCHERS,
    find_matcher,
)
from ggvs_eval.pipelines.offline.depth.depth_stream import DepthStream
from ggvs_eval.pipelines.offline.depth.fill_store import depth_job, prepare_depth
from ggvs_eval.pipelines.offline.plane_sweep.plane_sweep import PlaneSweep
from ggvs_eval.pipelines.offline.stereo.sgbm import SgbmMatcher
from helpers.refusals import refused
from helpers.stereo_scenes import look_from, paint, plane_depth, random_texture, write_capture

CAMERA = look_from(0, 0, "camera").resized(600, 450)
ROW = [look_from(0.5 * index, 0, f"row{index:+d}").resized(600, 450) for index in (-1, 1)]
CARD_DEPTH = 4.8
REUSE = DepthOptions(matcher=SgbmMatcher(levels=2), keyframe_every=4)


def see(camera, card_x, noise_seed=None):
    """Image and depth of a slanted wall with a card before it whose middle is at `card_x`; sensor
    noise of sigma 1.5 on top.
    """
    wall = plane_depth(camera)
    points = camera.unproject(camera.pixel_centres(), np.full(wall.shape, CARD_DEPTH))
    card = (np.abs(points[..., 0] - card_x) < 0.35) & (np.abs(points[..., 1]) < 0.35)
    depth = np.where(card, CARD_DEPTH, wall)
    moving = camera.unproject(camera.pixel_centres(), depth) - [card_x, 0, 0]
    on_card = paint(look_from(0, 0, "texture"), np.full((150, 200), CARD_DEPTH), random_texture(5))
    image = paint(camera, wall, random_texture())
    columns, rows = ((moving[..., axis] + 0.5) * 120 for axis in (0, 1))
    texels = on_card[np.clip(rows, 0, 149).astype(int), np.clip(columns, 0, 199).astype(int)]
    image = np.where(card[..., None], texels, image)
    if noise_seed is not None:
        noise = np.random.default_rng([noise_seed, len(camera.name) + ord(camera.name[-2])]).normal(
            0, 1.5, image.shape
        )
        image = np.clip(np.rint(image + noise), 0, 255)
    return image.astype(np.uint8), depth


def step(stream, frame, card_x, noise_seed=None):
    """Depth of one instant of that scene."""
    images = [see(camera, card_x, noise_seed)[0] for camera in (CAMERA, *ROW)]
    return stream.step(frame, images[0], images[1:])


@pytest.mark.slow
def test_what_stands_still_keeps_its_depth():
    """With sensor noise alone nothing is computed again: the depth of the keyframe comes back, bit
    for bit.
    """
    stream = DepthStream(CAMERA, ROW, REUSE)
    first, second = step(stream, 0, 0.0, noise_seed=1), step(stream, 1, 0.0, noise_seed=2)
    assert np.array_equal(first.depth, second.depth)


@pytest.mark.slow
def test_what_moves_is_computed_again():
    """Depth is new where the card is and was, right there, and untouched far from it."""
    stream = DepthStream(CAMERA, ROW, REUSE)
    first, second = step(stream, 0, -0.4), step(stream, 1, 0.2)
    _, truth = see(CAMERA, 0.2)
    card = truth == CARD_DEPTH
    assert np.median(np.abs(second.depth / truth - 1)[card]) < 0.02
    uncovered = (see(CAMERA, -0.4)[1] == CARD_DEPTH) & ~card
    assert np.median(np.abs(second.depth / truth - 1)[uncovered]) < 0.02
    assert np.array_equal(first.depth[:, 500:], second.depth[:, 500:])
    assert (first.depth != second.depth).mean() > 0.05


@pytest.mark.slow
def test_keyframes_are_computed_from_nothing():
    """At a keyframe the stream says what a fresh estimator says, whatever came before."""
    stream = DepthStream(CAMERA, ROW, REUSE)
    for frame, card_x in enumerate((-0.4, -0.2, 0.0, 0.2)):
        step(stream, frame, card_x)
    images = [see(camera, 0.4)[0] for camera in (CAMERA, *ROW)]
    fresh = DepthEstimator(CAMERA, ROW, REUSE).estimate(images[0], images[1:])
    assert np.array_equal(step(stream, 4, 0.4).depth, fresh.depth)


@pytest.mark.slow
def test_a_lost_instant_comes_back_with_equal_bits(tmp_path):
    """Depth between keyframes that was lost is computed again from its keyframe: the same bits, and
    nothing else is touched.
    """
    capture = write_capture(tmp_path / "capture", n_frames=6)
    job = depth_job(capture, "cam00", ("cam01", "cam02"), REUSE)
    store, key = DepthStore(tmp_path / "store"), job.key
    prepare_depth(capture, [job], range(6), store, REUSE, workers=1)
    whole = [store.read(key, frame).depth for frame in range(6)]
    for frame in (2, 5):
        store.path(key, frame).unlink()
    untouched = store.path(key, 3).stat().st_mtime_ns
    prepare_depth(capture, [job], range(2, 6), store, REUSE, workers=1)
    assert all(np.array_equal(store.read(key, frame).depth, whole[frame]) for frame in range(6))
    assert store.path(key, 3).stat().st_mtime_ns == untouched


def test_the_choice_of_the_command_line():
    """Names become matchers with all their parameters; a record reads back as the choice it was
    written from.
    """
    assert isinstance(DepthRunOptions().options().matcher, SgbmMatcher)
    assert isinstance(DepthRunOptions("sweep").options().matcher, PlaneSweep)
    reused = DepthRunOptions("sgbm", reuse_static=True)
    assert reused.options().keyframe_every == KEYFRAME_EVERY
    assert DepthRunOptions.from_record(reused.record()) == reused


def test_unknown_matchers_and_weights_are_refused(tmp_path):
    """A misspelt matcher names its neighbour, absent weights their file, weights for another
    matcher the reason.
    """
    with pytest.raises(
        DepthError,
        match=re.escape(
            f"wanted a matcher, got 'sgmb'; known are {', '.join((*MATCHERS, *FORMS))}; did you "
            f"mean sgbm"
        ),
    ):
        find_matcher("sgmb")
    with refused(WeightsError, "nowhere.pth"):
        find_matcher(f"raft:{tmp_path / 'nowhere.pth'}")
    with refused(DepthError, "--stereo-weights", "raft:other.pth"):
        DepthRunOptions("raft:other.pth", tmp_path / "weights.pth").options()
    with refused(DepthError, "--stereo-weights", "sweep"):
        DepthRunOptions("sweep", tmp_path / "weights.pth").options()


@pytest.mark.slow
@pytest.mark.parametrize("left", [20, 560])
def test_a_window_too_narrow_for_its_disparities_is_no_error(left):
    """On a wide baseline what changes at a border is not rectified alone: the whole image is
    computed again, by new depth.
    """
    camera = look_from(0, 0, "camera").resized(600, 450)
    partners = [look_from(x, 0, f"x{x:+d}").resized(600, 450) for x in (-1, 1)]
    images = [see(each, 0.0)[0] for each in (camera, *partners)]
    stream = DepthStream(camera, partners, REUSE)
    stream.step(0, images[0], images[1:])
    changed = images[0].copy()
    changed[200:220, left : left + 30] = 255 - changed[200:220, left : left + 30]
    again = stream.step(1, changed, images[1:])
    fresh = DepthEstimator(camera, partners, REUSE).estimate(changed, images[1:])
    np.testing.assert_array_equal(again.depth > 0, fresh.depth > 0)
