"""IV-PSNR, the fidelity measure of ISO/IEC MPEG immersive video: PSNR that forgives two pixels and
a shade of colour.
"""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ggvs_eval import kernels
from ggvs_eval.arrays import Image8, Mask
from ggvs_eval.metrics.inputs import Image, check_pair, count_inside, require_finite, white_level
from ggvs_eval.metrics.metric import FURTHER, ViewMetric

Colours = Literal["rgb", "ycbcr"]
WEIGHTS = np.array([4, 1, 1]) / 6  # of Y, Cb and Cr
WHITE = 255.0


def iv_psnr(
    rendered: Image, truth: Image, mask: Mask | None = None, colours: Colours = "rgb"
) -> float:
    """IV-PSNR of one frame (Dziembowski, Mieloch, Stankowski, Grzelka 2022).

    The rounded mean difference of colour is taken out, by 3 levels at most. Then each rendered
    pixel is compared with that true one within two pixels (5 x 5) which is nearest to it in colour,
    4 dY^2 + dCb^2 + dCr^2, and vice versa.

    Args:
        rendered: (H, W, 3), uint8 in 0..255 or float in [0, 1].
        truth: captured frame, same shape and kind.
        mask: (H, W), which pixels count and may be matched; None for all.
        colours: what the three channels are; RGB becomes 8-bit YCbCr of BT.709 without headroom.

    Returns:
        The worse of both directions, each the mean of the PSNRs of Y, Cb and Cr with weights 4:1:1,
        dB; higher is better. Equal frames have a squared error of 1 in all, not 0: 110 dB at
        1352x1014.

    Raises:
        MetricError: images or mask do not fit each other, or fewer than 64 pixels inside.

    Example:
        >>> import numpy as np
        >>> truth = np.random.default_rng(0).integers(0, 255, (48, 64, 3), dtype=np.uint8)
        >>> round(
        ...     iv_psnr(np.roll(truth, 1, axis=1), truth, colours="ycbcr"), 1
        ... )  # of a shift only the border remains
        34.7

    Reading:
        The paper speaks of video, which is YCbCr; frames here are RGB. Taken: the reference
        software's own conversion to ``YCbCr_BT709`` at full chroma. Frames of floats are rounded to
        8 bit, which the definition wants.
    """
    matched, _, n_pixels = _squared_errors(rendered, truth, mask, colours)
    return float((_decibels(matched, n_pixels) @ WEIGHTS).min())


def psnr_ycbcr(rendered: Image, truth: Image, mask: Mask | None = None) -> float:
    """PSNR of the YCbCr that `iv_psnr` is of, with its weights: what it would be if it forgave
    nothing.

    Args:
        rendered: (H, W, 3), uint8 in 0..255 or float in [0, 1], RGB.
        truth: captured frame, same shape and kind.
        mask: (H, W), which pixels count; None for all.

    Returns:
        Mean of the PSNRs of Y, Cb and Cr with weights 4:1:1, dB; some 2 to 4 dB above that of RGB,
        as chroma errs less.

    Raises:
        MetricError: as of `iv_psnr`.

    Example:
        >>> import numpy as np
        >>> truth = np.full((16, 16, 3), 100, np.uint8)
        >>> round(psnr_ycbcr(truth + 5, truth), 2)  # luma is 5 off, chroma is right
        46.84
    """
    _, plain, n_pixels = _squared_errors(rendered, truth, mask, "rgb")
    return float(_decibels(plain, n_pixels) @ WEIGHTS)


def _squared_errors(
    rendered: Image, truth: Image, mask: Mask | None, colours: Colours
) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
    """Sums (2, 3) of the errors to the best pixels, both directions, those (3,) to the pixels' own
    places; number of pixels.
    """
    from ggvs_eval.kernels import _iv_psnr

    check_pair(rendered, truth)
    if mask is not None:
        count_inside(mask, truth.shape[:2])
    first, second = (np.ascontiguousarray(_eight_bit(image)) for image in (rendered, truth))
    level = kernels.SIMD_LEVELS.index(kernels.get_simd_level())
    region = None if mask is None else np.ascontiguousarray(mask, dtype=np.uint8)
    matched, plain, _, n_pixels = _iv_psnr.matched_errors(
        first, second, region, colours == "rgb", kernels.get_threads(), level
    )
    return matched, plain, n_pixels


def _decibels(errors: NDArray[np.int64], n_pixels: int) -> NDArray[np.float64]:
    return np.asarray(10 * np.log10(WHITE**2 * n_pixels / np.maximum(errors, 1)))


def _eight_bit(image: Image) -> Image8:
    if image.dtype == np.uint8:
        return image
    require_finite(float(image.sum()), "IV-PSNR")
    return np.rint(np.clip(image, 0, 1) * WHITE / white_level(image)).astype(np.uint8)


IV_PSNR = ViewMetric(
    name="IV_PSNR",
    kind="frame",
    function=iv_psnr,
    unit="dB",
    higher_is_better=True,
    group=FURTHER,
    decimals=2,
    describe=(
        "PSNR of YCbCr that tolerates 2 pixels of misregistration and a global colour offset of 3 "
        "levels; its margin over PSNR_YCbCr is error of these two kinds, and noise matched by the "
        "search"
    ),
    reference="Dziembowski et al. 2022; ISO/IEC MPEG immersive video",
    inside=lambda pair, mask: iv_psnr(pair.rendered, pair.truth.image, mask),
)
PSNR_YCBCR = ViewMetric(
    name="PSNR_YCbCr",
    kind="frame",
    function=psnr_ycbcr,
    unit="dB",
    higher_is_better=True,
    group=FURTHER,
    decimals=2,
    describe="PSNR of Y, Cb and Cr, weights 4:1:1: IV_PSNR without tolerance",
    reference="as the reference software of IV-PSNR prints it",
    inside=lambda pair, mask: psnr_ycbcr(pair.rendered, pair.truth.image, mask),
)
