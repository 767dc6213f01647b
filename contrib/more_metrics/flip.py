"""FLIP, the difference that is seen when two images are shown in turn, by its authors' library."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Mask
from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.inputs import Image, check_pair, count_inside, require_finite, white_level
from ggvs_eval.metrics.metric import FURTHER, FramePair, ViewMetric


def flip(rendered: Image, truth: Image) -> float:
    """Return the mean FLIP error of one frame (Andersson et al. 2020), seen at 67 pixels per
    degree.

    Args:
        rendered: (H, W, 3), uint8 in 0..255 or float in [0, 1], sRGB.
        truth: captured frame, same shape and kind.

    Returns:
        0 for equal frames, at most 1; lower is better.

    Raises:
        MetricError: shapes or kinds differ, or flip-evaluator is not installed.

    Example:
        >>> import numpy as np
        >>> truth = np.full((16, 16, 3), 100, np.uint8)
        >>> flip(truth, truth)  # doctest: +SKIP
        0.0

    Reading:
        The library's own viewing conditions, a monitor 0.7 m wide of 3840 pixels at 0.7 m,
        regardless of the size of the frame: one of 1352x1014 is seen 20 degrees wide.
    """
    return float(flip_map(rendered, truth).mean(dtype=np.float64))


def flip_map(
    rendered: Image, truth: Image, pixels_per_degree: float | None = None
) -> NDArray[np.float32]:
    """FLIP error of each pixel, (H, W), 0 to 1.

    At the library's own 67.02 pixels per degree where nothing else is said.
    """
    check_pair(rendered, truth)
    try:
        import flip_evaluator
    except ImportError as error:
        raise MetricError("FLIP needs flip-evaluator; `pip install 'ggvs-eval[flip]'`") from error
    for image in (rendered, truth):
        require_finite(float(image.sum(dtype=np.float64)), "FLIP")
    images = (_unit_range(image) for image in (truth, rendered))
    conditions = {} if pixels_per_degree is None else {"ppd": pixels_per_degree}
    errors, *_ = flip_evaluator.evaluate(
        *images, "LDR", applyMagma=False, computeMeanError=False, parameters=conditions
    )
    return np.asarray(errors[..., 0], dtype=np.float32)


def _unit_range(image: Image) -> NDArray[np.float32]:
    unit: NDArray[Any] = np.clip(image.astype(np.float32) / np.float32(white_level(image)), 0, 1)
    return np.ascontiguousarray(unit, dtype=np.float32)


def _inside(pair: FramePair, mask: Mask) -> float:
    count_inside(mask, mask.shape)
    errors = pair.once(flip_map, lambda: flip_map(pair.rendered, pair.truth.image))
    return float(errors[mask].mean(dtype=np.float64))


FLIP = ViewMetric(
    name="FLIP",
    kind="frame",
    function=flip,
    higher_is_better=False,
    group=FURTHER,
    decimals=4,
    describe="difference seen when the frames are shown in turn, at 67 pixels per degree",
    reference="Andersson et al. 2020",
    inside=_inside,
)
