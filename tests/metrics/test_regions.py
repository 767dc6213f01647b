"""Metrics inside a mask: the plain metric where the mask is everything, blind to what lies outside,
and no trap of blackening.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.image.l1 import l1, masked_l1
from ggvs_eval.metrics.image.psnr import masked_psnr, psnr
from ggvs_eval.metrics.image.regions import moving_mask
from ggvs_eval.metrics.image.ssim import masked_ssim, ssim, ssim_variant
from helpers.photographs import noisy_pair
from helpers.refusals import refused

MASKED = {masked_psnr: psnr, masked_l1: l1, masked_ssim: ssim}


def square(shape, rows, columns):
    mask = np.zeros(shape[:2], bool)
    mask[rows, columns] = True
    return mask


@pytest.mark.parametrize("masked", MASKED)
def test_full_mask_gives_the_plain_metric(masked):
    """With everything inside, 8-bit and float frames score what the plain metric gives."""
    rendered, truth = noisy_pair()
    everything = np.ones(truth.shape[:2], bool)
    assert masked(rendered, truth, everything) == pytest.approx(
        MASKED[masked](rendered, truth), abs=1e-6
    )
    assert masked(rendered / 255, truth / 255, everything) == pytest.approx(
        MASKED[masked](rendered, truth), abs=1e-6
    )


@pytest.mark.parametrize("masked", MASKED)
def test_rectangle_scores_as_its_crop(masked):
    """A rectangular mask gives what the plain metric gives for the pixels cut out."""
    rendered, truth = noisy_pair()
    inside = np.s_[13:60, 25:71]
    wanted = MASKED[masked](rendered[inside], truth[inside])
    assert masked(rendered, truth, square(truth.shape, *inside)) == pytest.approx(wanted, abs=1e-6)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), share=st.floats(0.02, 0.5))
def test_outside_has_no_influence_on_a_single_bit(seed, share):
    """Whatever is put outside a ragged mask, each masked metric returns the same bits."""
    rng = np.random.default_rng(seed)
    rendered, truth = noisy_pair()
    mask = rng.random(truth.shape[:2]) < share
    top, left = rng.integers(0, 60, 2)
    mask[top : top + 20, left : left + 25] = True
    other_rendered, other_truth = (
        np.where(mask[..., None], image, rng.integers(0, 256, image.shape)).astype(np.uint8)
        for image in (rendered, truth)
    )
    for masked in MASKED:
        assert masked(other_rendered, other_truth, mask) == masked(rendered, truth, mask)


def test_values_that_are_not_finite_count_inside_only():
    """NaN outside the mask changes nothing; inside it is an error."""
    rendered, truth = (frame / 255 for frame in noisy_pair())
    mask = square(truth.shape, slice(20, 50), slice(30, 60))
    outside, inside = rendered.copy(), rendered.copy()
    outside[5, 5], inside[30, 40] = np.nan, np.nan
    for masked in MASKED:
        assert masked(outside, truth, mask) == masked(rendered, truth, mask)
        with pytest.raises(MetricError, match="not finite"):
            masked(inside, truth, mask)


def test_blackening_the_outside_is_a_trap_that_ours_does_not_fall_into():
    """At 5 % coverage the mean over a blackened image says 0.99 where the region scores
    below 0.9.
    """
    rendered, truth = noisy_pair(200, 240, strength=12)
    side = int(np.sqrt(0.05 * truth.shape[0] * truth.shape[1]))
    inside = np.s_[90 : 90 + side, 20 : 20 + side]
    mask = square(truth.shape, *inside)
    blackened = ssim(rendered * mask[..., None], truth * mask[..., None])
    honest = masked_ssim(rendered, truth, mask)
    assert honest == pytest.approx(ssim(rendered[inside], truth[inside]), abs=1e-6)
    assert honest < 0.9 < 0.98 < blackened


def test_each_variant_counts_the_windows_inside():
    """Within a mask each variant is what it is of the cropped pictures."""
    rendered, truth = noisy_pair()
    inside = np.s_[13:60, 25:71]
    mask = square(truth.shape, *inside)
    crop = rendered[inside], truth[inside]
    assert masked_ssim(rendered, truth, mask, "uniform7") == pytest.approx(
        ssim_variant(*crop, "uniform7"), abs=1e-6
    )
    assert masked_ssim(rendered, truth, mask, "gaussian-zero") == pytest.approx(
        ssim(*crop), abs=1e-6
    )


def test_zero_padded_windows_over_the_border_are_not_inside():
    """Even with everything inside, a window that reaches into the padding does not count."""
    rendered, truth = noisy_pair()
    everything = np.ones(truth.shape[:2], bool)
    assert masked_ssim(rendered, truth, everything, "gaussian-zero") == pytest.approx(
        ssim(rendered, truth), abs=1e-6
    )


def test_regions_too_small_to_measure_are_refused():
    """63 pixels, an empty mask, and a region into which no window fits have no score but a
    reason.
    """
    rendered, truth = noisy_pair()
    few = square(truth.shape, slice(0, 7), slice(0, 9))
    for masked in (masked_psnr, masked_l1):
        with refused(MetricError, "63 pixels", "needs 64"):
            masked(rendered, truth, few)
        with refused(MetricError, "0 pixels"):
            masked(rendered, truth, np.zeros(truth.shape[:2], bool))
    with refused(MetricError, "11 x 11", "region"):
        masked_ssim(rendered, truth, square(truth.shape, slice(5, 15), slice(0, 110)))
    ring = square(truth.shape, slice(20, 50), slice(20, 50)) & ~square(
        truth.shape, slice(30, 40), slice(30, 40)
    )
    with refused(MetricError, "11 x 11"):
        masked_ssim(rendered, truth, ring)
    with refused(MetricError, "11 x 11"):
        masked_ssim(rendered, truth, np.zeros(truth.shape[:2], bool))
    assert masked_ssim(
        rendered, truth, square(truth.shape, slice(5, 16), slice(3, 14))
    ) == pytest.approx(ssim(rendered[5:16, 3:14], truth[5:16, 3:14]), abs=1e-4)


@pytest.mark.parametrize("masked", MASKED)
def test_masks_that_do_not_fit_are_refused(masked):
    """A mask of another size or of numbers is refused; so are frames that do not fit each other."""
    rendered, truth = noisy_pair()
    with refused(MetricError, "(90, 110) bool", "(89, 110) bool"):
        masked(rendered, truth, np.ones((89, 110), bool))
    with refused(MetricError, "(90, 110) bool", "(90, 110) uint8"):
        masked(rendered, truth, np.ones((90, 110), np.uint8))
    with refused(MetricError, "(89, 110, 3)"):
        masked(rendered[1:], truth, np.ones((90, 110), bool))


def test_moving_square_is_found_where_it_was_and_is():
    """A square that moves 20 pixels is marked at both places, within the 12 pixels of the reduced
    mask, and nothing else is.
    """
    truth = np.full((160, 240, 3), 90, np.uint8)
    before, now = truth.copy(), truth.copy()
    before[60:100, 40:80], now[60:100, 60:100] = 200, 200
    moving = moving_mask(now, before)
    changed = np.any(now != before, axis=2)
    assert moving[changed].all()
    reach = square(moving.shape, slice(60 - 12, 100 + 12), slice(40 - 12, 100 + 12))
    assert not moving[~reach].any()


def test_still_frames_and_sensor_noise_do_not_move():
    """A frame against itself and against another noisy recording of the same scene moves nowhere; a
    cut moves everywhere.
    """
    rendered, truth = noisy_pair(strength=3)
    assert not moving_mask(truth, truth).any()
    assert not moving_mask(rendered, truth).any()
    assert moving_mask(np.full_like(truth, 250), np.full_like(truth, 5)).all()


def test_motion_is_told_by_8_bit_frames_of_one_size():
    """Another size or floats are refused in one line."""
    _, truth = noisy_pair()
    with refused(MetricError, "(90, 110, 3)", "(89, 110, 3)"):
        moving_mask(truth, truth[1:])
    with refused(MetricError, "uint8 in 0..255", "float64"):
        moving_mask(truth / 255, truth / 255)
