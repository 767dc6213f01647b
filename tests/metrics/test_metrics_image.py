"""PSNR, SSIM, L1 and colour-corrected PSNR against scikit-image, kornia, a slow twin, recorded values, and their laws."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage
from skimage import data
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.image.corrected import ColourMoments, apply_colour_map, fit_colour_map, psnr_colour_corrected, unit_range
from ggvs_eval.metrics.image.l1 import l1
from ggvs_eval.metrics.image.psnr import psnr
from ggvs_eval.metrics.image.ssim import ssim, ssim_per_channel
from helpers.places import DATA_FOLDER
from helpers.refusals import refused

DATA = DATA_FOLDER
SKIMAGE = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False, "channel_axis": 2}


def noisy_pair(height, width, strength=12.0, seed=0):
    """A crop of a photograph and the same with Gaussian noise, both uint8."""
    truth = np.ascontiguousarray(data.astronaut()[50 : 50 + height, 60 : 60 + width])
    noise = np.random.default_rng(seed).normal(0, strength, truth.shape)
    return np.rint(np.clip(truth + noise, 0, 255)).astype(np.uint8), truth


def slow_ssim(rendered, truth):
    """The definition of the kernel: Wang's formula in float64, five separable filters, valid positions, (3,)."""
    x, y = (image.astype(np.float64) / 255 for image in (rendered, truth))
    taps = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)

    def blur(image):
        for axis in (0, 1):
            image = ndimage.correlate1d(image, taps / taps.sum(), axis=axis)
        return image[5:-5, 5:-5]

    mean_x, mean_y = blur(x), blur(y)
    variances = blur(x * x) - mean_x**2 + blur(y * y) - mean_y**2
    covariance = blur(x * y) - mean_x * mean_y
    luminance = (2 * mean_x * mean_y + 0.01**2) / (mean_x**2 + mean_y**2 + 0.01**2)
    return (luminance * (2 * covariance + 0.03**2) / (variances + 0.03**2)).mean(axis=(0, 1))


# Widths and heights on both sides of a tile of the kernel (64 RGB pixels, 128 rows) and of the window (11).
@pytest.mark.parametrize("shape", [(11, 11), (12, 75), (37, 74), (139, 53), (150, 211)])
def test_ssim_equals_scikit_image(shape):
    """SSIM equals scikit-image's Gaussian variant within 1e-6, for 8-bit and float frames of any size."""
    rendered, truth = noisy_pair(*shape)
    wanted = structural_similarity(rendered / 255, truth / 255, data_range=1, **SKIMAGE)
    assert ssim(rendered, truth) == pytest.approx(wanted, abs=1e-6)
    assert ssim(rendered / 255, truth / 255) == pytest.approx(wanted, abs=1e-6)


def test_ssim_equals_its_slow_twin_per_channel():
    """Each channel's mean equals the float64 formula, also where a bright flat frame leaves float32 little room."""
    rendered, truth = noisy_pair(140, 90)
    for pair in ((rendered, truth), (rendered // 16 + 235, truth // 16 + 235), (np.full_like(truth, 254), truth // 64 + 252)):
        np.testing.assert_allclose(ssim_per_channel(*pair), slow_ssim(*pair), atol=1e-6)


@pytest.mark.parametrize("shape", [(11, 11), (37, 75), (80, 100)])
def test_ssim_and_psnr_equal_kornia(shape):
    """SSIM equals the mean of kornia's valid-window map, and PSNR kornia's, within its float32 accuracy."""
    import torch
    from kornia.metrics import psnr as kornia_psnr
    from kornia.metrics import ssim as kornia_ssim

    pair = noisy_pair(*shape)
    tensors = [torch.from_numpy(image).permute(2, 0, 1)[None].float() / 255 for image in pair]
    assert ssim(*pair) == pytest.approx(float(kornia_ssim(*tensors, window_size=11, padding="valid").mean()), abs=2e-5)
    assert psnr(*pair) == pytest.approx(float(kornia_psnr(*tensors, max_val=1.0)), abs=1e-5)


def test_ssim_and_psnr_equal_recorded_values():
    """SSIM of recorded float images equals the recorded values of the valid 11 x 11 window, PSNR that of a recorded clip."""
    images, wanted = np.load(DATA / "ssim_tcc_inputs.npz"), json.loads((DATA / "ssim_tcc_oracles.json").read_text())
    assert ssim(images["b"], images["a"]) == pytest.approx(wanted["noise.05"]["valid_11x11_gauss"], abs=1e-6)
    assert ssim(images["c"], images["a"]) == pytest.approx(wanted["blur1.5"]["valid_11x11_gauss"], abs=1e-6)
    clip = [psnr(*frames) for frames in zip(images["rendered_video"], images["gt_video"], strict=True)]
    assert np.mean(clip) == pytest.approx(wanted["psnr_per_frame_mean"], abs=1e-5)


def test_ssim_takes_views_of_larger_frames():
    """A crop, a mirrored and a channel-swapped view score as their copies do."""
    rendered, truth = noisy_pair(60, 70)
    for view in (np.s_[5:50, 3:60], np.s_[:, ::-1], np.s_[..., ::-1]):
        assert ssim(rendered[view], truth[view]) == ssim(rendered[view].copy(), truth[view].copy())


def test_psnr_and_l1_equal_scikit_image_and_numpy():
    """PSNR equals scikit-image's and L1 the plain mean of absolute differences, for 8-bit and float frames alike."""
    rendered, truth = noisy_pair(61, 83)
    wanted = np.abs(rendered.astype(float) - truth).mean()
    assert psnr(rendered, truth) == pytest.approx(peak_signal_noise_ratio(truth, rendered), abs=1e-9)
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
    for truth in (data.astronaut(), np.zeros((16, 16, 3), np.uint8), np.full((16, 16, 3), 255, np.uint8)):
        assert psnr(truth, truth) == 100.0
        assert ssim(truth, truth) == 1.0
        assert l1(truth, truth) == 0.0


def test_psnr_never_exceeds_its_ceiling():
    """One grey level in one value of a megapixel frame (above 100 dB) scores the ceiling, not more."""
    truth = np.zeros((1000, 1000, 3), np.uint8)
    rendered = truth.copy()
    rendered[3, 4, 1] = 1
    assert psnr(rendered, truth) == 100.0


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), strength=st.floats(0.5, 80), height=st.integers(11, 40), width=st.integers(11, 40))
def test_laws_of_two_frames(seed, strength, height, width):
    """PSNR, SSIM and L1 do not care which frame is the truth, SSIM is at most 1, and PSNR <= 20 log10(255 / L1)."""
    rendered, truth = noisy_pair(height, width, strength, seed)
    for metric in (psnr, ssim, l1):
        assert metric(rendered, truth) == metric(truth, rendered)
    assert ssim(rendered, truth) <= 1.0
    if (error := l1(rendered, truth)) > 0:
        assert psnr(rendered, truth) <= 20 * np.log10(255 / error) + 1e-9


@settings(max_examples=80, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    height=st.integers(1, 30),
    width=st.integers(1, 30),
    levels=st.sampled_from([1, 2, 256]),
    kind=st.sampled_from([np.uint8, np.float16, np.float32, np.float64]),
)
def test_frames_of_any_size_and_content_have_a_finite_score_or_a_reason(seed, height, width, levels, kind):
    """From one pixel up, flat or noisy, 8-bit or any float: PSNR, L1 and PSNR_cc are finite; SSIM too, or says why not."""
    rng = np.random.default_rng(seed)
    rendered, truth = (rng.integers(0, levels, (height, width, 3)).astype(np.uint8) for _ in range(2))
    if kind != np.uint8:
        rendered, truth = (rendered / 255).astype(kind), (truth / 255).astype(kind)
    assert 0 <= psnr(rendered, truth) <= 100
    assert 0 <= l1(rendered, truth) <= 255
    assert 0 <= psnr_colour_corrected(rendered, truth) <= 100
    if min(height, width) < 11:
        with refused(MetricError, "SSIM", "11 x 11"):
            ssim(rendered, truth)
    else:
        assert -1 <= ssim(rendered, truth) <= 1
        assert ssim(truth, truth) == 1.0


@pytest.mark.parametrize("metric", [psnr, ssim, l1, psnr_colour_corrected])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite_are_refused(metric, value):
    """One pixel of NaN or infinity in a frame of floats is an error, not a score."""
    rendered, truth = (frame / 255 for frame in noisy_pair(20, 30))
    rendered[7, 9, 1] = value
    with refused(MetricError, "not finite"):
        metric(rendered, truth)


def test_frames_of_different_floats_compare():
    """float32 against float64 scores as float64 does, within the width of float32."""
    rendered, truth = (frame / 255 for frame in noisy_pair(20, 30))
    for metric in (psnr, ssim, l1, psnr_colour_corrected):
        assert metric(rendered.astype(np.float32), truth) == pytest.approx(metric(rendered, truth), rel=1e-5)


def test_more_noise_scores_worse():
    """PSNR and SSIM fall and L1 rises with the strength of the noise."""
    pairs = [noisy_pair(100, 100, strength) for strength in (2, 5, 12, 30, 70)]
    assert np.all(np.diff([psnr(*pair) for pair in pairs]) < 0)
    assert np.all(np.diff([ssim(*pair) for pair in pairs]) < 0)
    assert np.all(np.diff([l1(*pair) for pair in pairs]) > 0)


def test_colour_correction_removes_an_affine_colour_change_and_nothing_else():
    """An affine colour change alone costs nothing after correction; noise on top of it costs what it costs without it."""
    rendered, truth = (frame / 255 for frame in noisy_pair(90, 120))
    change = np.array([[0.7, 0.1, 0.0], [0.05, 0.8, 0.1], [0.0, 0.1, 0.6]])
    assert psnr_colour_corrected(truth @ change.T + 0.04, truth) > 90
    both = psnr_colour_corrected(rendered @ change.T + 0.04, truth)
    assert both == pytest.approx(psnr_colour_corrected(rendered, truth), abs=1e-3)


def test_colour_map_is_the_least_squares_fit():
    """The map equals numpy's least squares over all pixels of all frames."""
    rendered, truth = (np.stack([frame, frame[::-1] // 2]) for frame in noisy_pair(40, 50))
    design = np.concatenate([rendered.reshape(-1, 3) / 255, np.ones((rendered.size // 3, 1))], axis=1)
    wanted = np.linalg.lstsq(design, truth.reshape(-1, 3) / 255, rcond=None)[0].T
    np.testing.assert_allclose(fit_colour_map(rendered, truth), wanted, atol=1e-9)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), strength=st.floats(0.5, 80))
def test_colour_correction_never_lowers_psnr(seed, strength):
    """The identity is one of the maps that are fitted, so correcting cannot make a frame worse."""
    rendered, truth = noisy_pair(30, 40, strength, seed)
    assert psnr_colour_corrected(rendered, truth) >= psnr(rendered, truth) - 1e-6


def test_colour_correction_of_flat_frames_is_defined():
    """A frame of one colour, whose map is not unique, is mapped onto the mean colour of the truth."""
    rendered, truth = noisy_pair(30, 30)
    flat, mean = np.full_like(rendered, 90), np.broadcast_to(truth.mean(axis=(0, 1)) / 255, truth.shape)
    assert psnr_colour_corrected(flat, truth) == pytest.approx(psnr(mean, truth / 255), abs=1e-3)


def test_one_map_serves_a_whole_view():
    """A stack is corrected by one map, so exposure flicker stays visible that frame-by-frame correction would hide."""
    _, truth = noisy_pair(40, 40)
    view, flicker = np.stack([truth, truth]), np.stack([truth, truth // 2])
    alone = np.mean([psnr_colour_corrected(frame, truth) for frame in flicker])
    assert psnr_colour_corrected(flicker, view) < alone - 10


def test_moments_streamed_frame_by_frame_give_the_map_of_the_stack():
    """Frames added one by one give the map that numpy fits to all of them, whatever their order, 8-bit or float."""
    views = [noisy_pair(70, 50, strength, seed=3) for strength in (5, 20, 60)]
    design = np.concatenate([rendered.reshape(-1, 3) for rendered, _ in views]) / 255
    target = np.concatenate([truth.reshape(-1, 3) for _, truth in views]) / 255
    wanted = np.linalg.lstsq(np.concatenate([design, np.ones((len(design), 1))], axis=1), target, rcond=None)[0].T
    for pairs in (views, views[::-1], [(rendered / 255, truth / 255) for rendered, truth in views]):
        moments = ColourMoments()
        for rendered, truth in pairs:
            moments.add(rendered, truth)
        np.testing.assert_allclose(moments.map(), wanted, atol=1e-9)


def test_ssim_of_the_corrected_frame():
    """After the map an affine colour change costs SSIM nothing, and noise on top of it costs what it costs alone."""
    noisy, truth = (frame / 255 for frame in noisy_pair(60, 80, strength=4))

    def corrected_ssim(rendered):
        moments = ColourMoments()
        moments.add(rendered, truth)
        return ssim(apply_colour_map(moments.map(), rendered), unit_range(truth))

    change = np.array([[0.7, 0.1, 0.0], [0.0, 0.8, 0.0], [0.1, 0.0, 0.6]]).T
    assert ssim(truth @ change + 0.05, truth) < 0.99
    assert corrected_ssim(truth @ change + 0.05) > 0.99999
    assert corrected_ssim(noisy @ change + 0.05) == pytest.approx(corrected_ssim(noisy), abs=1e-4)


def test_corrected_colours_stay_between_black_and_white():
    """A map that overshoots is clipped, in 8-bit and float frames alike, and the identity changes nothing."""
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
        (np.zeros((20, 30, 3), np.int16), "rendered: wanted uint8 in 0..255 or float in .0, 1., got int16"),
    ],
)
def test_frames_that_do_not_fit_are_refused(metric, rendered, message):
    """Different shapes, kinds, or integers that are no 8-bit image are refused with both values named."""
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
