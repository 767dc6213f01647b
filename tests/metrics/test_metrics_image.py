"""PSNR, SSIM, L1 and colour-corrected PSNR against scikit-image, kornia, a slow twin, recorded
values, and their laws.
"""

import numpy as np
import pytest
from skimage import data
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.colour_moments import ColourMoments
from ggvs_eval.metrics.image.corrected import (
    apply_colour_map,
    fit_colour_map,
    psnr_colour_corrected,
    unit_range,
)
from ggvs_eval.metrics.image.l1 import l1
from ggvs_eval.metrics.image.psnr import psnr
from ggvs_eval.metrics.image.ssim import ssim
from helpers.photographs import noisy_pair
from helpers.refusals import refused

SKIMAGE = {
    "gaussian_weights": True,
    "sigma": 1.5,
    "use_sample_covariance": False,
    "channel_axis": 2,
}


# Widths and heights on both sides of a tile of the kernel (64 RGB pixels, 128 rows) and of the
# window (11).
@pytest.mark.parametrize("shape", [(11, 11), (12, 75), (37, 74), (139, 53), (150, 211)])
def test_ssim_equals_scikit_image(shape):
    """SSIM equals scikit-image's Gaussian variant within 2e-6, for 8-bit and float frames of any
    size.
    """
    rendered, truth = noisy_pair(*shape)
    wanted = structural_similarity(rendered / 255, truth / 255, data_range=1, **SKIMAGE)
    assert ssim(rendered, truth) == pytest.approx(wanted, abs=2e-6)
    assert ssim(rendered / 255, truth / 255) == pytest.approx(wanted, abs=2e-6)


def test_ssim_takes_views_of_larger_frames():
    """A crop, a mirrored and a channel-swapped view score as their copies do."""
    rendered, truth = noisy_pair(60, 70)
    for view in (np.s_[5:50, 3:60], np.s_[:, ::-1], np.s_[..., ::-1]):
        assert ssim(rendered[view], truth[view]) == ssim(rendered[view].copy(), truth[view].copy())


def test_psnr_and_l1_equal_scikit_image_and_numpy():
    """PSNR equals scikit-image's and L1 the plain mean of absolute differences, for 8-bit and float
    frames alike.
    """
    rendered, truth = noisy_pair(61, 83)
    wanted = np.abs(rendered.astype(float) - truth).mean()
    assert psnr(rendered, truth) == pytest.approx(
        peak_signal_noise_ratio(truth, rendered), abs=1e-9
    )
    assert psnr(rendered / 255, truth / 255) == pytest.approx(psnr(rendered, truth), abs=1e-9)
    assert l1(rendered, truth) == pytest.approx(wanted, abs=1e-9)
    assert l1(rendered / 255, truth / 255) == pytest.approx(wanted, abs=1e-9)


def test_known_offsets_have_closed_forms():
    """A frame that is 10 grey levels off everywhere has L1 10 and PSNR 20 log10(25.5)."""
    truth = np.full((20, 30, 3), 100, np.uint8)
    assert l1(truth + 10, truth) == 10.0
    assert psnr(truth + 10, truth) == pytest.approx(20 * np.log10(25.5))


def test_identical_frames_have_finite_best_scores():
    """Equal frames score PSNR 100 dB, SSIM exactly 1 and L1 0, whatever they show."""
    for truth in (
        data.astronaut(),
        np.zeros((16, 16, 3), np.uint8),
        np.full((16, 16, 3), 255, np.uint8),
    ):
        assert psnr(truth, truth) == 100.0
        assert ssim(truth, truth) == 1.0
        assert l1(truth, truth) == 0.0


def test_psnr_never_exceeds_its_ceiling():
    """One grey level in one value of a megapixel frame (above 100 dB) scores the ceiling,
    not more.
    """
    truth = np.zeros((1000, 1000, 3), np.uint8)
    rendered = truth.copy()
    rendered[3, 4, 1] = 1
    assert psnr(rendered, truth) == 100.0


@pytest.mark.parametrize("metric", [psnr, ssim, l1, psnr_colour_corrected])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite_are_refused(metric, value):
    """One pixel of NaN or infinity in a frame of floats is an error, not a score."""
    rendered, truth = (frame / 255 for frame in noisy_pair(20, 30))
    rendered[7, 9, 1] = value
    with refused(MetricError, "not finite"):
        metric(rendered, truth)


def test_colour_correction_removes_an_affine_colour_change_and_nothing_else():
    """An affine colour change alone costs nothing after correction; noise on top of it costs what
    it costs without it.
    """
    rendered, truth = (frame / 255 for frame in noisy_pair(90, 120))
    change = np.array([[0.7, 0.1, 0.0], [0.05, 0.8, 0.1], [0.0, 0.1, 0.6]])
    assert psnr_colour_corrected(truth @ change.T + 0.04, truth) > 90
    both = psnr_colour_corrected(rendered @ change.T + 0.04, truth)
    assert both == pytest.approx(psnr_colour_corrected(rendered, truth), abs=1e-3)


def test_colour_map_is_the_least_squares_fit():
    """The map equals numpy's least squares over all pixels of all frames."""
    rendered, truth = (np.stack([frame, frame[::-1] // 2]) for frame in noisy_pair(40, 50))
    design = np.concatenate(
        [rendered.reshape(-1, 3) / 255, np.ones((rendered.size // 3, 1))], axis=1
    )
    wanted = np.linalg.lstsq(design, truth.reshape(-1, 3) / 255, rcond=None)[0].T
    np.testing.assert_allclose(fit_colour_map(rendered, truth), wanted, atol=1e-9)


def test_colour_correction_of_flat_frames_is_defined():
    """A frame of one colour, whose map is not unique, is mapped onto the mean colour of the
    truth.
    """
    rendered, truth = noisy_pair(30, 30)
    flat, mean = (
        np.full_like(rendered, 90),
        np.broadcast_to(truth.mean(axis=(0, 1)) / 255, truth.shape),
    )
    assert psnr_colour_corrected(flat, truth) == pytest.approx(psnr(mean, truth / 255), abs=1e-3)


def test_one_map_serves_a_whole_view():
    """A stack is corrected by one map, so exposure flicker stays visible that frame-by-frame
    correction would hide.
    """
    _, truth = noisy_pair(40, 40)
    view, flicker = np.stack([truth, truth]), np.stack([truth, truth // 2])
    alone = np.mean([psnr_colour_corrected(frame, truth) for frame in flicker])
    assert psnr_colour_corrected(flicker, view) < alone - 10


def test_moments_streamed_frame_by_frame_give_the_map_of_the_stack():
    """Frames added one by one give the map that numpy fits to all of them, whatever their order,
    8-bit or float.
    """
    views = [noisy_pair(70, 50, strength, seed=3) for strength in (5, 20, 60)]
    design = np.concatenate([rendered.reshape(-1, 3) for rendered, _ in views]) / 255
    target = np.concatenate([truth.reshape(-1, 3) for _, truth in views]) / 255
    wanted = np.linalg.lstsq(
        np.concatenate([design, np.ones((len(design), 1))], axis=1), target, rcond=None
    )[0].T
    for pairs in (views, views[::-1], [(rendered / 255, truth / 255) for rendered, truth in views]):
        moments = ColourMoments()
        for rendered, truth in pairs:
            moments.add(rendered, truth)
        np.testing.assert_allclose(moments.map(), wanted, atol=1e-9)


def test_corrected_colours_stay_between_black_and_white():
    """A map that overshoots is clipped, in 8-bit and float frames alike, and the identity changes
    nothing.
    """
    frame, _ = noisy_pair(12, 14)
    identity = np.eye(3, 4)
    np.testing.assert_array_equal(apply_colour_map(identity, frame), unit_range(frame))
    np.testing.assert_array_equal(apply_colour_map(identity, unit_range(frame)), unit_range(frame))
    bright = apply_colour_map(3 * identity, frame)
    assert (bright.min() >= 0, bright.max()) == (True, 1.0)


def test_moments_of_nothing_and_of_frames_that_do_not_fit_are_refused():
    """A map wants pixels, and pairs of one size."""
    moments = ColourMoments()
    with refused(MetricError, "no pixels"):
        moments.map()
    with refused(MetricError, "(20, 31, 3)"):
        moments.add(np.zeros((20, 31, 3), np.uint8), np.zeros((20, 30, 3), np.uint8))
    with refused(MetricError, "RGB", "(frames, height, width, 3)"):
        fit_colour_map(np.zeros((20, 30, 3), np.uint8), np.zeros((20, 30, 3), np.uint8))


@pytest.mark.parametrize("metric", [psnr, ssim, l1, psnr_colour_corrected])
@pytest.mark.parametrize(
    ("rendered", "message"),
    [
        (np.zeros((20, 31, 3), np.uint8), r"rendered is \(20, 31, 3\), truth is \(20, 30, 3\)"),
        (np.zeros((20, 30, 3), np.float32), "rendered is float32, truth is uint8"),
        (
            np.zeros((20, 30, 3), np.int16),
            "rendered: wanted uint8 in 0..255 or float in .0, 1., got int16",
        ),
    ],
)
def test_frames_that_do_not_fit_are_refused(metric, rendered, message):
    """Different shapes, kinds, or integers that are no 8-bit image are refused with both values
    named.
    """
    with pytest.raises(MetricError, match=message):
        metric(rendered, np.zeros((20, 30, 3), np.uint8))


def test_grey_and_tiny_frames_are_refused():
    """A grey frame is refused by every metric, a frame below the window by SSIM."""
    grey = np.zeros((20, 30), np.uint8)
    with refused(MetricError, "(height, width, 3)", "(20, 30)"):
        psnr(grey, grey)
    small = np.zeros((10, 30, 3), np.uint8)
    with refused(MetricError, "SSIM", "11 x 11", "10 x 30"):
        ssim(small, small)
