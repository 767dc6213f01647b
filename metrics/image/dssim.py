"""D-SSIM 1 and 2: structural dissimilarity as tables of dynamic scenes print it, under the two data
ranges that are in use.
"""

import numpy as np

from ggvs_eval.arrays import Mask
from ggvs_eval.metric_choices import SsimName
from ggvs_eval.metrics.image.ssim import masked_ssim, ssim_map
from ggvs_eval.metrics.inputs import Image, require_finite
from ggvs_eval.metrics.metric import FURTHER, FramePair, ViewMetric

VARIANTS: dict[int, SsimName] = {1: "uniform7", 2: "uniform7-range2"}


def dssim(rendered: Image, truth: Image, data_range: int = 1) -> float:
    """Return the structural dissimilarity of one frame, (1 - SSIM) / 2.

    Args:
        rendered: (H, W, 3), uint8 in 0..255 or float in [0, 1].
        truth: captured frame, same shape and kind.
        data_range: 1 for D-SSIM 1, 2 for D-SSIM 2.

    Returns:
        0 for equal frames, at most 1; lower is better. The SSIM is scikit-image's of images in [0,
        1]: uniform window of 7 x 7, sample covariance.

    Raises:
        MetricError: shapes or kinds differ, or an image is smaller than the window.

    Example:
        >>> import numpy as np
        >>> truth = np.full((16, 16, 3), 100, np.uint8)
        >>> round(dssim(truth // 2, truth, 1), 4), round(dssim(truth // 2, truth, 2), 4)
        (0.0999, 0.0998)

    Reading:
        The names are of the tables on Neural 3D Video, where some evaluators gave scikit-image the
        range 1, and others gave none, which for floats means 2: the same frames then score about
        half.
    """
    return _dissimilarity(
        float(ssim_map(rendered, truth, VARIANTS[data_range]).mean(dtype=np.float64))
    )


def _dissimilarity(similarity: float) -> float:
    return require_finite((1 - similarity) / 2, "D-SSIM")


def _dssim1(rendered: Image, truth: Image) -> float:
    return dssim(rendered, truth, 1)


def _dssim2(rendered: Image, truth: Image) -> float:
    return dssim(rendered, truth, 2)


def _inside1(pair: FramePair, mask: Mask) -> float:
    return _dissimilarity(masked_ssim(pair.rendered, pair.truth.image, mask, VARIANTS[1]))


def _inside2(pair: FramePair, mask: Mask) -> float:
    return _dissimilarity(masked_ssim(pair.rendered, pair.truth.image, mask, VARIANTS[2]))


DSSIM1, DSSIM2 = (
    ViewMetric(
        name=f"DSSIM{data_range}",
        kind="frame",
        function=function,
        higher_is_better=False,
        group=FURTHER,
        decimals=4,
        describe=f"(1 - SSIM) / 2, uniform window of 7 x 7, data range {data_range}.0",
        reference="scikit-image; D-SSIM 1 and 2 as distinguished by Li et al. 2024 (Spacetime "
        "Gaussians)",
        inside=inside,
        inside_note=" in windows wholly inside it",
    )
    for data_range, function, inside in ((1, _dssim1, _inside1), (2, _dssim2, _inside2))
)
