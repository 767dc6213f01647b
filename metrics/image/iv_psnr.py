"""IV-PSNR, the fidelity measure of ISO/IEC MPEG immersive video: PSNR that forgives two pixels and a shade of colour."""

from typing import Literal

import numpy as np

from ggvs_eval import kernels
from ggvs_eval.arrays import Image8, Mask
from ggvs_eval.metrics.inputs import Image, check_pair, count_inside, require_finite, white_level
from ggvs_eval.metrics.metric import FURTHER, ViewMetric

WEIGHTS = np.array([4, 1, 1]) / 6  # of Y, Cb and Cr
WHITE = 255.0


def iv_psnr(rendered: Image, truth: Image, mask: Mask | None = None, colours: Literal["rgb", "ycbcr"] = "rgb") -> float:
    """IV-PSNR of one frame (Dziembowski, Mieloch, Stankowski, Grzelka 2022).

    The rounded mean difference of colour is taken out, by 3 levels at most. Then each rendered pixel is compared with
    that true one within two pixels (5 x 5) which is nearest to it in colour, 4 dY^2 + dCb^2 + dCr^2, and each true one likewise.

    Args:
        rendered: (H, W, 3), uint8 in 0..255 or float in [0, 1].
        truth: captured frame, same shape and kind.
        mask: (H, W), which pixels count and may be matched; None for all.
        colours: what the three channels are; RGB becomes 8-bit YCbCr of BT.709 without headroom.

    Returns:
        The worse of both directions, each the mean of the PSNRs of Y, Cb and Cr with weights 4:1:1, dB; higher is better. Equal
        frames have a squared error of 1 in all, not 0: 110 dB at 1352x1014.

    Raises:
        MetricError: images or mask do not fit each other, or fewer than 64 pixels inside.

    Example:
        >>> import numpy as np
        >>> truth = np.random.default_rng(0).integers(0, 255, (48, 64, 3), dtype=np.uint8)
        >>> round(iv_psnr(np.roll(truth, 1, axis=1), truth, colours="ycbcr"), 1)  # of a shift only the border remains
        34.7

    Reading:
        The paper speaks of video, which is YCbCr; frames here are RGB. Taken: the reference software's own conversion to
        ``YCbCr_BT709`` at full chroma. Frames of floats are rounded to 8 bit, which the definition wants.
    """
    from ggvs_eval.kernels import _iv_psnr

    check_pair(rendered, truth)
    if mask is not None:
        count_inside(mask, truth.shape[:2])
    first, second = (np.ascontiguousarray(_eight_bit(image)) for image in (rendered, truth))
    level = kernels.SIMD_LEVELS.index(kernels.get_simd_level())
    chosen = None if mask is None else np.ascontiguousarray(mask, dtype=np.uint8)
    errors, _, n_pixels = _iv_psnr.matched_errors(first, second, chosen, colours == "rgb", kernels.get_threads(), level)
    psnr_db = 10 * np.log10(WHITE**2 * n_pixels / np.maximum(errors, 1))  # (2 directions, Y Cb Cr)
    return float((psnr_db @ WEIGHTS).min())


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
        "PSNR of YCbCr that forgives 2 pixels of misregistration and a global colour offset of 3 levels; what it lies above PSNR "
        "is error of these two kinds, and noise, part of which the search matches"
    ),
    reference="Dziembowski et al. 2022; ISO/IEC MPEG immersive video",
    inside=lambda pair, mask: iv_psnr(pair.rendered, pair.truth.image, mask),
)
