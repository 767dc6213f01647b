"""Depth, confidence and differences as colours that the colour-blind can distinguish, with their
scales.

What has no value is drawn as a pattern, since any flat colour could be taken for one: light checks
where nothing is known, dark and orange stripes where a value was filled in.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8, Map, Mask

STOPS = 17  # of a scale's gradient
TICKS = 5
CHECK_PX = 6
STRIPE_PX = 4
CHECKS = (255, 208)  # white and light grey, which no colour map here comes near
STRIPES = ((213, 94, 0), (40, 16, 0))
DIFFERENCE_FULL_SCALE = 64.0  # of 255 levels; what differs more is drawn alike


@dataclass(frozen=True)
class Scale:
    """The legend of a colour map.

    Attributes:
        gradient: colours from left to right, evenly spaced, as ``#rrggbb``.
        ticks: place from left to right, in [0, 1], and the value there.
    """

    gradient: tuple[str, ...]
    ticks: tuple[tuple[float, float], ...]


def depth_colours(depth: Map, nearest: float, farthest: float) -> Image8:
    """Return the inverse depth in viridis, near = yellow, far = dark blue; checks if there is none.

    Args:
        depth: (H, W), world units, 0 = invalid.

    Examples:
        >>> depth_colours(np.array([[1.0, 4.0]], np.float32), nearest=1.0, farthest=4.0).tolist()
        [[[253, 231, 36], [68, 1, 84]]]
    """
    inverse = np.divide(1, depth, out=np.zeros_like(depth), where=depth > 0)
    return coloured(_share(inverse, 1 / farthest, 1 / nearest), "viridis", depth > 0)


def depth_scale(nearest: float, farthest: float) -> Scale:
    """Return the scale of `depth_colours`, far to near."""
    inverse = np.linspace(1 / farthest, 1 / nearest, TICKS)
    return Scale(_gradient("viridis"), _ticks(1 / inverse))


def confidence_colours(confidence: Map, is_known: Mask, is_filled: Mask) -> Image8:
    """Confidence in cividis, 0 = dark blue, 1 = yellow.

    Stripes where depth was filled in, checks if there is none.
    """
    colours = coloured(confidence, "cividis", is_known)
    row, column = np.nonzero(is_filled)
    colours[is_filled] = np.array(STRIPES, np.uint8)[(row + column) // STRIPE_PX % 2]
    return colours


def confidence_scale() -> Scale:
    """Return the scale of `confidence_colours`."""
    return Scale(_gradient("cividis"), _ticks(np.linspace(0, 1, TICKS)))


def difference_colours(difference: Map, is_known: Mask) -> Image8:
    """Differences of images in magma, none = black, 64 of 255 levels or more = near white.

    Checks if there is nothing.
    """
    return coloured(_share(difference, 0, DIFFERENCE_FULL_SCALE), "magma", is_known)


def difference_scale() -> Scale:
    """Return the scale of `difference_colours`, levels of 255."""
    return Scale(_gradient("magma"), _ticks(np.linspace(0, DIFFERENCE_FULL_SCALE, TICKS)))


def with_checks(image: Image8, is_known: Mask) -> Image8:
    """Return the image with checks where it shows nothing, (H, W, 3)."""
    if is_known.all():
        return image.copy()
    return np.where(is_known[..., None], image, _checks(is_known.shape))


def _share(values: Map, low: float, high: float) -> Map:
    return ((values - np.float32(low)) / np.float32(max(high - low, 1e-12))).astype(np.float32)


def coloured(share: Map, name: str, is_known: Mask) -> Image8:
    """Return the values from 0 to 1 in a colour map of Matplotlib, checks if there is none, (H, W,
    3).
    """
    colours = _table(name)
    return with_checks(
        colours.take(np.clip(np.rint(share * 255), 0, 255).astype(np.intp), axis=0), is_known
    )


def _table(name: str) -> Image8:
    """256 colours of a perceptually uniform map, (256, 3)."""
    from matplotlib import colormaps

    return (colormaps[name](np.arange(256), bytes=True)[:, :3]).astype(np.uint8)


def _checks(shape: tuple[int, ...]) -> Image8:
    row, column = np.indices(shape[:2]) // CHECK_PX
    return np.repeat(np.where((row + column) % 2, *CHECKS).astype(np.uint8)[..., None], 3, axis=-1)


def _gradient(name: str) -> tuple[str, ...]:
    colours = _table(name)[np.rint(np.linspace(0, 255, STOPS)).astype(np.intp)]
    return tuple(f"#{red:02x}{green:02x}{blue:02x}" for red, green, blue in colours.tolist())


def _ticks(values: NDArray[np.floating]) -> tuple[tuple[float, float], ...]:
    return tuple(
        zip(
            np.linspace(0, 1, len(values)).tolist(), np.asarray(values, float).tolist(), strict=True
        )
    )
