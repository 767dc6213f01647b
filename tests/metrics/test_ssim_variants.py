"""Each named SSIM against the implementation it claims to be, and why the name belongs beside the
number.
"""

import json

import numpy as np
import pytest
from skimage.metrics import structural_similarity

from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.image.ssim import SSIM_VARIANTS, ssim, ssim_map, ssim_variant
from helpers.photographs import noisy_pair
from helpers.places import DATA_FOLDER
from helpers.refusals import refused

RECORDED_AS = {
    "gaussian-valid": "valid_11x11_gauss",
    "gaussian-zero": "zero_pad_3dgs",
    "uniform7": "skimage_default_7x7_uniform",
    "uniform7-range2": "skimage_7x7_data_range2",
}


def splatting_ssim(rendered, truth):
    """The SSIM of Gaussian splatting's evaluators: a grouped 11 x 11 convolution, padding 5 with
    zeros, five times, (3, H, W).
    """
    import torch

    x, y = (
        torch.from_numpy(image).permute(2, 0, 1)[None].double() / 255 for image in (rendered, truth)
    )
    line = torch.exp(-((torch.arange(11, dtype=torch.float64) - 5) ** 2) / (2 * 1.5**2))
    window = torch.outer(line, line)
    window = (window / window.sum()).expand(3, 1, 11, 11)
    mean_x, mean_y, xx, yy, xy = (
        torch.nn.functional.conv2d(image, window, padding=5, groups=3)
        for image in (x, y, x * x, y * y, x * y)
    )
    variance_x, variance_y, covariance = xx - mean_x**2, yy - mean_y**2, xy - mean_x * mean_y
    above = (2 * mean_x * mean_y + 0.01**2) * (2 * covariance + 0.03**2)
    return (
        (above / ((mean_x**2 + mean_y**2 + 0.01**2) * (variance_x + variance_y + 0.03**2)))[0]
        .permute(1, 2, 0)
        .numpy()
    )


@pytest.mark.parametrize("name", SSIM_VARIANTS)
def test_variants_equal_recorded_values(name):
    """On the recorded noisy and blurred images each variant has its own value: 0.791, 0.820, 0.839
    or 0.867 for the noise.
    """
    images, wanted = (
        np.load(DATA_FOLDER / "ssim_tcc_inputs.npz"),
        json.loads((DATA_FOLDER / "ssim_tcc_oracles.json").read_text()),
    )
    for image, case in (("b", "noise.05"), ("c", "blur1.5")):
        assert ssim_variant(images[image], images["a"], name) == pytest.approx(
            wanted[case][RECORDED_AS[name]], abs=1e-6
        )


@pytest.mark.parametrize(
    ("shape", "within"), [((11, 11), 5e-6), ((23, 64), 1e-6), ((32, 31), 1e-6), ((97, 45), 1e-6)]
)
def test_uniform_variants_equal_scikit_image(shape, within):
    """The uniform windows equal scikit-image's defaults with the data range of their name, also in
    few windows.
    """
    rendered, truth = noisy_pair(*shape)
    for name, data_range in (("uniform7", 1), ("uniform7-range2", 2)):
        wanted = structural_similarity(
            rendered / 255, truth / 255, data_range=data_range, channel_axis=2
        )
        assert ssim_variant(rendered, truth, name) == pytest.approx(wanted, abs=within)


@pytest.mark.parametrize("shape", [(11, 11), (40, 37), (97, 45)])
def test_zero_padded_variant_equals_a_convolution_with_padding(shape):
    """Every window, those that reach over the border too, equals the padded convolution of Gaussian
    splatting's evaluators.
    """
    pair = noisy_pair(*shape)
    np.testing.assert_allclose(ssim_map(*pair, "gaussian-zero"), splatting_ssim(*pair), atol=1e-4)
    assert ssim_variant(*pair, "gaussian-zero") == pytest.approx(
        splatting_ssim(*pair).mean(), abs=2e-6
    )


def test_map_of_the_default_has_the_mean_of_the_fast_kernel():
    """The map of valid windows and the compiled kernel are one metric, also on bright flat
    frames.
    """
    rendered, truth = noisy_pair(60, 71)
    for pair in (
        (rendered, truth),
        (rendered // 16 + 235, truth // 16 + 235),
        (np.full_like(truth, 254), truth // 64 + 252),
    ):
        values = ssim_map(*pair)
        assert values.shape == (50, 61, 3)
        assert values.mean(dtype=np.float64) == pytest.approx(ssim(*pair), abs=1e-6)
        assert ssim_variant(*pair, "gaussian-valid") == ssim(*pair)


def test_one_window_of_the_map_is_the_score_of_its_pixels():
    """The value at row 7 and column 9 is the SSIM of the 11 x 11 pixels that begin there."""
    rendered, truth = noisy_pair(60, 71)
    window = np.s_[7:18, 9:20]
    np.testing.assert_allclose(
        ssim_map(rendered, truth)[7, 9].mean(), ssim(rendered[window], truth[window]), atol=1e-4
    )


def test_what_cannot_be_scored_is_refused():
    """An unknown variant, frames that do not fit, and values that are not finite are errors."""
    rendered, truth = noisy_pair(60, 71)
    with refused(MetricError, "'luma'", "gaussian-valid, gaussian-zero, uniform7, uni"):
        ssim_variant(rendered, truth, "luma")
    with refused(MetricError, "(59, 71, 3)"):
        ssim_variant(rendered[1:], truth, "uniform7")
    broken = rendered / 255
    broken[3, 3, 0] = np.nan
    for name in SSIM_VARIANTS:
        with refused(MetricError, "SSIM", "not finite"):
            ssim_variant(broken, truth / 255, name)
