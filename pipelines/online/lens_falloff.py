"""Fall-off of lenses towards the corners: one figure for all cameras, from what they see together."""

from collections.abc import Sequence

import numpy as np

from ggvs_eval.arrays import Array, Image8, Map
from ggvs_eval.camera import Camera
from ggvs_eval.kernels import get_threads

NOISE = 0.02  # of the logarithm of a look-up's colour; what is off by more than four times that says nothing of a lens
ROUNDS = 4  # of reweighting
PRIOR = 1.0  # weight of "none" beside the look-ups; squared tangents count in those of the picture's corner
LEAST = 0.03  # of the logarithm of brightness in the corner: less is not distinguished from none


class LensFallOff:
    """The fall-off that all sources share: the slope of the logarithm of brightness over the squared tangent from the axis.

    A surface that one camera sees near its axis and another near its corner is darker in the latter. Each pair of sources gives a
    slope; their mean counts as far as the pairs agree on it. State: the mean over the instants since the last gap in time.

    Args:
        memory: instants that the slope is the mean of, at most; 1 for none but the present one.

    Reading:
        Not in the paper. Only what the cameras share can be known of the target, which is never looked at: a fall-off of its
        own, or a field that each camera has for itself, cannot; of those that K sources have, their differences alone show, and
        taking them out leaves (1 + 1/K) of the variance where the blend leaves (1 + sum of squared weights). The squared tangent
        is the first term of the cosine law and of every lens profile. Shrinking by the disagreement of the pairs makes it exactly
        0 in rooms without, and nearly always where each camera has a field of its own.
    """

    def __init__(self, memory: int = 10) -> None:
        self._memory = memory
        self.forget()

    def forget(self) -> None:
        """Begin anew, after a gap in time."""
        self._count, self._slope = 0, 0.0

    def step(self, pairs: Sequence[tuple[Map, Map]], corner: float) -> float:
        """The slope by the present instant and those before, 0 where none can be measured.

        Args:
            pairs: of each pair of sources, what they see together: the logarithm of the ratio of its two brightnesses, (N,), and
                the difference of the squared tangents under which the two see it, (N,).
            corner: largest squared tangent in any of the pictures.
        """
        if len(pairs) < 2:  # they say nothing
            return self._slope
        self._count = min(self._count + 1, self._memory)
        self._slope += (shared_slope([fit_slope(*pair, corner) for pair in pairs], corner) - self._slope) / self._count
        return self._slope


def fit_slope(ratios: Map, spans: Map, corner: float) -> tuple[float, float]:
    """Slope of log ratios over differences of squared tangents, whatever their offset, and its weight: robust least squares."""
    x, y = spans.astype(np.float64) / corner, ratios.astype(np.float64)
    y = y - np.median(y)
    weights, slope, evidence = np.ones(len(x)), 0.0, 0.0
    for _ in range(ROUNDS):
        from_mean, up = x - np.average(x, weights=weights), y - np.average(y, weights=weights)
        evidence = float((weights * from_mean**2).sum())
        slope = float((weights * from_mean * up).sum()) / max(evidence, 1e-12)
        residuals = np.abs(up - slope * from_mean)
        weights = np.where(residuals < 4 * NOISE, NOISE / np.maximum(residuals, NOISE), 1e-9)
    return slope / corner, evidence


def shared_slope(slopes: Sequence[tuple[float, float]], corner: float) -> float:
    """Mean of the pairs' slopes by their weights, shrunk by how far they disagree; 0 of fewer than two pairs.

    Examples:
        >>> round(shared_slope([(-0.20, 90.0), (-0.21, 60.0), (-0.19, 80.0)], corner=1.0), 2)
        -0.19
        >>> shared_slope([(-0.20, 90.0), (0.15, 60.0), (0.05, 80.0)], corner=1.0)
        0.0
    """
    if len(slopes) < 2:
        return 0.0
    values, weights = np.array(slopes).T
    values = values * corner
    mean = float((weights * values).sum() / (weights.sum() + PRIOR))
    pairs = weights.sum() ** 2 / max((weights**2).sum(), 1e-12)  # that count alike
    variance = float((weights * (values - mean) ** 2).sum() / (weights.sum() + PRIOR) / max(pairs - 1, 0.5))
    doubt = LEAST**2 + 4 * variance
    return mean * (1 - doubt / mean**2) / corner if mean**2 > doubt else 0.0


def squared_tangents(camera: Camera) -> tuple[Array, Array]:
    """Squared tangents of the angle from the optical axis, of the camera's rows and of its columns; their sum is a pixel's."""
    across = (np.arange(camera.width) + 0.5 - camera.K[0, 2]) / camera.K[0, 0]
    down = (np.arange(camera.height) + 0.5 - camera.K[1, 2]) / camera.K[1, 1]
    return down**2, across**2


def corner_of(cameras: Sequence[Camera]) -> float:
    """The largest squared tangent in any picture of the cameras."""
    return max(float(down.max() + across.max()) for down, across in map(squared_tangents, cameras))


def flattened(image: Image8, camera: Camera, gain: Map, slope: float, corner: float) -> Image8:
    """A source image as it would be under no lens's fall-off, times a gain per channel; 8 bit.

    What is brightest is kept and the rest darkened, so that nothing is cut off.
    """
    from ggvs_eval.kernels import _core

    down, across = squared_tangents(camera)
    rows, columns = np.exp(-slope * down - max(-slope * corner, 0.0)), np.exp(-slope * across)
    gain = np.ascontiguousarray(gain, np.float32)
    return _core.shade(np.ascontiguousarray(image), gain, rows.astype(np.float32), columns.astype(np.float32), get_threads())


def fallen_off(image: Map, camera: Camera, slope: float, corner: float) -> Map:
    """Show what is blended of `flattened` sources, (H, W, 3), as the target's lens would, at most 1; in place."""
    if not slope:
        return image
    down, across = squared_tangents(camera)
    image *= np.exp(slope * down + max(-slope * corner, 0.0)).astype(np.float32)[:, None, None]
    image *= np.exp(slope * across).astype(np.float32)[:, None]
    return np.minimum(image, np.float32(1), out=image)
