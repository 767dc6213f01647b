"""Temporal variation of depth maps: the flicker of a depth video from any source, without truth."""

from collections.abc import Sequence

import numpy as np

from ggvs_eval.arrays import Map, Mask
from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.image.sharpness import PERCENT
from ggvs_eval.metrics.inputs import LEAST_PIXELS, check_mask
from ggvs_eval.metrics.metric import DepthMetric, Series


def depth_mtv(later: Map, earlier: Map, static: Mask | None = None) -> float:
    """Return the mean absolute change of log depth from one frame to the next, times 100: mTV of a
    depth video.

    Args:
        later: depth at t + 1, (H, W) float, any unit, 0 or not finite = unknown; inverse depth
            (disparity) gives the same value.
        earlier: depth at t.
        static: (H, W), where the scene is static; None for the whole image.

    Returns:
        Mean over the pixels known in both frames; to first order the change in per cent of the
        depth. 0 for steady depth, and for a flat one: read it with `depth_sharpness`.

    Raises:
        MetricError: frames or mask do not fit each other, negative depth, or fewer than 64 pixels
            known in both.

    Example:
        >>> import numpy as np
        >>> wall = np.full((8, 8), 2.0, np.float32)
        >>> round(depth_mtv(1.01 * wall, wall), 2)
        1.0

    Reading:
        Not in the paper. Logarithms, because the flicker of depth is asked for of metric depth,
        depth up to scale and disparity alike: the value is the same in any unit, and in one
        direction of time as in the other. Depth that is known up to an offset too (disparity of
        relative networks) wants that offset taken out first.
    """
    return _variation((later, earlier), static)


def depth_mtv2(depths: Sequence[Map], static: Mask | None = None) -> float:
    """Return the mean absolute second difference of log depth over time, times 100: an even
    approach has none.

    Args:
        depths: three frames in order, as for `depth_mtv`.
        static: see `depth_mtv`.

    Raises:
        MetricError: not three frames, or as `depth_mtv`.

    Example:
        >>> import numpy as np
        >>> round(depth_mtv2([np.full((8, 8), depth, np.float32) for depth in (1.0, 2.0, 4.0)]), 6)
        0.0
    """
    if len(depths) != 3:
        raise MetricError(f"depth_mTV2 is a second difference: got {len(depths)} frames; needs 3")
    return _variation(depths, static)


def depth_blinking(later: Map, earlier: Map, static: Mask | None = None) -> float:
    """Return the part of the pixels whose depth is known in only one of two neighbouring frames:
    holes that come and go.

    Args:
        later: see `depth_mtv`.
        earlier: see `depth_mtv`.
        static: see `depth_mtv`.

    Returns:
        Per cent of the pixels known in at least one of the frames; 0 if none is.

    Example:
        >>> import numpy as np
        >>> whole, holed = np.ones((8, 8), np.float32), np.ones((8, 8), np.float32)
        >>> holed[:2] = 0
        >>> depth_blinking(holed, whole)
        25.0
    """
    has_depth = [np.isfinite(depth) & (depth > 0) for depth in _checked((later, earlier), static)]
    inside = np.ones_like(has_depth[0]) if static is None else static
    either = int(np.count_nonzero((has_depth[0] | has_depth[1]) & inside))
    return (
        PERCENT * int(np.count_nonzero((has_depth[0] ^ has_depth[1]) & inside)) / either
        if either
        else 0.0
    )


def depth_sharpness(depth: Map) -> float:
    """Return the mean absolute difference of log depth between neighbouring pixels, times 100:
    edges, slopes, and noise.

    Args:
        depth: see `depth_mtv`.

    Returns:
        Mean over horizontal and over vertical neighbours that are both known. A depth map that is
        smoothed over space has less.

    Raises:
        MetricError: not (H, W), negative depth, or fewer than 64 known pixels.

    Example:
        >>> import numpy as np
        >>> ramp = np.tile(np.exp(0.02 * np.arange(16)), (16, 1)).astype(np.float32)
        >>> round(depth_sharpness(ramp), 3)  # 2 % to the side, none down
        1.0
    """
    (depth,) = _checked((depth,), None)
    logarithm = _log(depth)
    if np.count_nonzero(np.isfinite(logarithm)) < LEAST_PIXELS:
        raise MetricError(
            f"depth sharpness: {np.count_nonzero(np.isfinite(logarithm))} known pixels; needs "
            f"{LEAST_PIXELS}"
        )
    differences = [np.abs(np.diff(logarithm, axis=axis)) for axis in (0, 1)]
    means = [
        float(difference[np.isfinite(difference)].mean())
        for difference in differences
        if np.isfinite(difference).any()
    ]
    return PERCENT * float(np.mean(means)) if means else 0.0


def _variation(depths: Sequence[Map], static: Mask | None) -> float:
    """Return the first or second absolute difference of log depth over two or three frames, mean
    over what is known in all.
    """
    logarithms = [_log(depth) for depth in _checked(depths, static)]
    with np.errstate(invalid="ignore"):
        change = (
            logarithms[0] - logarithms[1]
            if len(depths) == 2
            else logarithms[0] - 2 * logarithms[1] + logarithms[2]
        )
    comparable = np.isfinite(change) if static is None else np.isfinite(change) & static
    if np.count_nonzero(comparable) < LEAST_PIXELS:
        raise MetricError(
            f"{np.count_nonzero(comparable)} pixels have a depth in all {len(depths)} frames; "
            f"needs {LEAST_PIXELS}"
        )
    return PERCENT * float(np.abs(change[comparable]).mean(dtype=np.float64))


def _log(depth: Map) -> Map:
    """Natural logarithm; NaN if the depth is unknown."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.log(np.where(np.isfinite(depth) & (depth > 0), depth, np.nan).astype(np.float32))


def _checked(depths: Sequence[Map], static: Mask | None) -> Sequence[Map]:
    for depth in depths:
        if depth.ndim != 2 or not np.issubdtype(depth.dtype, np.number):
            raise MetricError(
                f"wanted depth maps (height, width) of numbers, got {depth.shape} {depth.dtype}"
            )
        if depth.shape != depths[0].shape:
            raise MetricError(
                f"one depth map is {depths[0].shape}, another {depth.shape}; a depth video has one "
                f"size"
            )
        if (depth < 0).any():
            raise MetricError(
                f"wanted depth above 0, and 0 where it is unknown; got {float(np.nanmin(depth)):g}"
            )
    if static is not None:
        check_mask(static, depths[0].shape)
    return depths


_REFERENCE = "docs/metrics.md"
DEPTH_SHARPNESS = DepthMetric(
    name="depth_Sharpness",
    function=depth_sharpness,
    unit="% of depth",
    higher_is_better=True,
    decimals=3,
    describe="mean absolute difference of neighbouring depths; more stable and less sharp is "
    "smoothed, noise raises it",
    reference=_REFERENCE,
    series=Series(1, lambda depths, _static: depth_sharpness(*depths)),
)
DEPTH_MTV = DepthMetric(
    name="depth_mTV",
    function=depth_mtv,
    unit="% of depth",
    higher_is_better=False,
    decimals=3,
    describe="mean absolute change of the depth from frame to frame; smoothing lowers it",
    reference=_REFERENCE,
    series=Series(2, _variation),
    beside=DEPTH_SHARPNESS.name,
)
DEPTH_MTV2 = DepthMetric(
    name="depth_mTV2",
    function=depth_mtv2,
    unit="% of depth",
    higher_is_better=False,
    decimals=3,
    describe="mean absolute second difference of the depth over time; smoothing lowers it",
    reference=_REFERENCE,
    series=Series(3, _variation),
    beside=DEPTH_SHARPNESS.name,
)
DEPTH_BLINKING = DepthMetric(
    name="depth_blinking",
    function=depth_blinking,
    unit="% of pixels",
    higher_is_better=False,
    decimals=3,
    describe="pixels whose depth is known in only one of two neighbouring frames",
    reference=_REFERENCE,
    series=Series(2, lambda depths, static: depth_blinking(depths[1], depths[0], static)),
    beside=DEPTH_SHARPNESS.name,
)
