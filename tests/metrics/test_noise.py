"""Noise of a captured view: measured strength, grain and hold against known ones, and realisations
that have them too.
"""

import cv2
import numpy as np
import pytest

from ggvs_eval.errors import MetricError
from ggvs_eval.files.images import round_levels
from ggvs_eval.metrics.noise.estimate import LONG_LAG, estimate_noise
from helpers.noise_scenes import clean_video, noisy, panned_video, shot_noise
from helpers.refusals import refused

FRAMES = LONG_LAG + 6
STILL = np.s_[:, :48]  # rows the face never reaches


def grainy(clean, seed, grain_px=0.0, kept=0.0, sigma=3.0):
    """A recording whose noise is smoothed in space and whose every value keeps a share from the
    frame before.
    """
    random = np.random.default_rng(seed)
    fresh = [random.normal(size=frame.shape) for frame in clean]
    fields = [cv2.GaussianBlur(field, (0, 0), grain_px) for field in fresh] if grain_px else fresh
    for t in range(1, len(fields)):
        fields[t] = kept * fields[t - 1] + np.sqrt(1 - kept**2) * fields[t]
    noise = np.stack(fields)
    return round_levels(clean + sigma * noise / noise.std()), noise / noise.std()


@pytest.mark.slow
def test_strength_of_white_noise_is_found():
    """Noise of 0.6 to 4 grey levels is found within 10 % at every brightness, beside a face that
    moves, and is white.
    """
    clean = clean_video(FRAMES)
    for sigma in (0.6, 1.3, 4.0):
        noise = estimate_noise(noisy(clean, sigma, seed=1))
        assert noise.sigma_255 == pytest.approx(np.full((8, 3), sigma), rel=0.1)
        assert abs(noise.spatial_correlation) < 0.05
        assert abs(np.average(noise.octave_held, weights=noise.octave_variance)) < 0.1
        assert 0.75 < noise.static_share < 0.95


def test_strength_follows_brightness():
    """Noise that rises from 1 to 2.2 grey levels with brightness is found within 10 % at the
    brightness it belongs to.

    Brighter blue than 170 is rare in this scene and unknown to the estimate.
    """
    noise = estimate_noise(noisy(clean_video(FRAMES), shot_noise, seed=1))
    grey = np.repeat(np.array([48.0, 96.0, 144.0])[:, None, None], 3, axis=2)
    assert noise.sigma_at(grey) == pytest.approx(shot_noise(grey), rel=0.1)


@pytest.mark.slow
def test_grain_of_smoothed_noise_is_found_and_drawn():
    """Noise smoothed over 1.2 pixels has its neighbours' correlation found; drawn noise has its
    strength alone and in squares.
    """
    clean = clean_video(FRAMES)
    frames, field = grainy(clean, seed=1, grain_px=1.2)
    noise = estimate_noise(frames)
    correlation = np.mean(field[..., 1:, :] * field[..., :-1, :])
    assert correlation > 0.7
    assert noise.spatial_correlation == pytest.approx(correlation, abs=0.1)
    drawn = np.stack(list(noise.sample_video(clean, np.random.default_rng(3)))) - clean.astype(
        float
    )
    recorded = frames - clean.astype(float)
    for size in (1, 4, 8):
        squares = [
            cv2.blur(video[STILL].transpose(1, 2, 0, 3).reshape(48, 304, -1), (size, size))
            for video in (drawn, recorded)
        ]
        assert squares[0].std() == pytest.approx(squares[1].std(), rel=0.1)


@pytest.mark.slow
def test_noise_that_is_held_over_frames_is_found_and_drawn():
    """Noise that keeps 0.7 from frame to frame has this found, with its full strength; drawn noise
    changes as little.
    """
    clean = clean_video(FRAMES)
    frames, _ = grainy(clean, seed=1, kept=0.7)
    noise = estimate_noise(frames)
    assert np.average(noise.octave_held, weights=noise.octave_variance) == pytest.approx(
        0.7, abs=0.05
    )
    assert noise.sigma_255 == pytest.approx(np.full((8, 3), 3.0), rel=0.1)
    drawn = np.stack(list(noise.sample_video(clean, np.random.default_rng(3))))
    changes = [np.diff(video[STILL].astype(float), axis=0).std() for video in (drawn, frames)]
    assert changes[0] == pytest.approx(changes[1], rel=0.05)


def test_a_video_without_noise_has_none():
    """Frames without noise give strength 0, and a drawn recording is the clean frame; so does a
    constant video of odd size.
    """
    clean = clean_video(8)
    noise = estimate_noise(clean)
    assert noise.sigma_255.max() < 0.1
    assert np.array_equal(noise.sample(clean[3], np.random.default_rng(1)), clean[3])
    assert estimate_noise(np.full((3, 97, 131, 3), 80, np.uint8)).sigma_255.max() == 0


def test_equal_seeds_draw_equal_bits():
    """A recording is a function of model, frames and seed; another seed gives another recording."""
    clean = clean_video(4)[:, :97, :131]
    noise = estimate_noise(noisy(clean, 2.0, seed=1))
    first, again, other = (
        np.stack(list(noise.sample_video(clean, np.random.default_rng(seed)))) for seed in (1, 1, 2)
    )
    assert first.dtype == np.uint8
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_what_has_no_still_content_is_refused():
    """One frame, a moving camera, and frames that are not 8-bit RGB of one size are refused with
    what came.
    """
    with pytest.raises(MetricError, match="1 frame; needs 2"):
        estimate_noise(clean_video(1))
    with refused(MetricError, "5%", "be static", "got"):
        estimate_noise(panned_video())
    with refused(MetricError, "(240, 304, 3) before", "(239, 304, 3) now"):
        estimate_noise([clean_video(2)[0], clean_video(2)[1, 1:]])
    with refused(MetricError, "(240, 304, 3) float64"):
        estimate_noise(clean_video(2) / 255)
    with refused(MetricError, "at least 16"):
        estimate_noise(clean_video(2)[:, :15])
