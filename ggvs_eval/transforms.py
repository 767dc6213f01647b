"""What the way from a method to its folder does to frames: each change, and its inverse.

The doctor measures these changes, what-if takes them back, and tests plant them. The values of a
finding are the strength of the change that its question names.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import ceil
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.files.images import round_levels

VIDEO_BLACK, VIDEO_SLOPE = 16.0, 219 / 255
LANCZOS_REACH_PX = 4
# A shift that is known less well may be one by whole pixels or not.
LARGEST_ERROR_PX = 0.1
LEVELS = np.arange(256)[:, None]
Values = Mapping[str, Any]
Size = tuple[int, int]  # width and height
Change = Callable[[Image8], Image8]
Pair = NDArray[np.float64]  # across and down
Levels = NDArray[Any]


@dataclass(frozen=True)
class Transform:
    """A change of every frame of a view alike.

    Attributes:
        words: what `inverse` does.
        apply: frame (H, W, 3) uint8 -> the changed one.
        inverse: takes that back, as far as it can be.
        soft: `apply` by linear interpolation, if it interpolates at all.
        is_exact: whether no value is interpolated or rounded.
        border_px: width along each side within which pixels are made of pixels outside the picture.
    """

    words: str
    apply: Change
    inverse: Change
    soft: Change | None = None
    is_exact: bool = True
    border_px: int = 0


def mirrored(values: Values, _size: Size = (1, 1)) -> Transform:
    """Flip rows (axis 0), columns (axis 1) or both."""
    axes = tuple(values["axes"])
    words = {(1,): "flipped left to right", (0,): "flipped upside down"}

    def flip(image: Image8) -> Image8:
        return np.ascontiguousarray(np.flip(image, axes))

    return Transform(words.get(axes, "turned by 180 degrees"), flip, flip)


def reordered(values: Values, _size: Size = (1, 1)) -> Transform:
    """Write channels in another order; `order` is where red, green and blue are then."""
    order = list(values["order"])
    return Transform(
        f"channels read as {order_name(order)}",
        apply=lambda image: np.ascontiguousarray(image[..., np.argsort(order)]),
        inverse=lambda image: np.ascontiguousarray(image[..., order]),
    )


def order_name(order: Sequence[int]) -> str:
    """Return in which order channels come, where red, green and blue are then.

    Examples:
        >>> order_name((2, 0, 1))
        'GBR'
    """
    return "".join("RGB"[channel] for channel in np.argsort(order))


def ranged(values: Values, _size: Size) -> Transform:
    """Squeeze full-range levels into those of video where the slope is below 1, else stretch."""
    squeezed = LEVELS * VIDEO_SLOPE + VIDEO_BLACK
    expanded = (LEVELS - VIDEO_BLACK) / VIDEO_SLOPE
    if values["slope"] < 1:
        return _by_tables("levels expanded from 16..235", squeezed, expanded)
    return _by_tables("levels squeezed into 16..235", expanded, squeezed)


def powered(values: Values, _size: Size) -> Transform:
    """Take levels in 0..1 to a power."""
    power, shares = values["power"], LEVELS / 255
    words = f"levels to the power of {1 / power:.2f}"
    return _by_tables(words, 255 * shares**power, 255 * shares ** (1 / power))


def multiplied(values: Values, _size: Size) -> Transform:
    """Multiply levels by a gain, or by one for each channel."""
    gain = np.broadcast_to(values["gain"], 3)
    words = ", ".join(f"{channel:.3f}" for channel in gain[: 3 if np.ptp(gain) else 1])
    return _by_tables(f"levels divided by {words}", LEVELS * gain, LEVELS / gain)


def _by_tables(words: str, *levels: NDArray[np.floating]) -> Transform:
    """Replace each level by that of a table, and back by that of another, (256, 1 or 3)."""
    forward, back = (np.broadcast_to(round_levels(table), (256, 3)) for table in levels)
    channels = np.arange(3)
    return Transform(
        words,
        apply=lambda image: forward[image, channels],
        inverse=lambda image: back[image, channels],
        is_exact=False,
    )


def scaled(values: Values, size: Size) -> Transform:
    """Enlarge the picture about its centre."""
    scale = np.array([values["scale_x"], values["scale_y"]])
    outside_px = np.abs(np.maximum(scale, 1 / scale) - 1) * size / 2
    x, y = 1 / scale
    return _resampling(f"scaled to ({x:.2%}, {y:.2%})", scale, centring(scale, size), outside_px)


def shifted(values: Values, _size: Size) -> Transform:
    """Move the picture to the right and downwards.

    By whole pixels, which loses nothing, where a small error allows it.
    """
    shift_px = np.array([values["shift_x_px"], values["shift_y_px"]])
    error_px = values.get("shift_x_px_error", 0)
    is_whole = np.abs(shift_px - np.rint(shift_px)).max() <= error_px <= LARGEST_ERROR_PX
    shift_px = np.rint(shift_px) if is_whole else shift_px
    x, y = -np.round(shift_px, 2)
    transform = _resampling(f"moved by ({x:+g}, {y:+g}) px", np.ones(2), shift_px, shift_px)
    return (
        replace(transform, is_exact=True, border_px=int(np.abs(shift_px).max()))
        if is_whole
        else transform
    )


def _resampling(words: str, scale: Pair, offset_px: Pair, outside_px: Pair) -> Transform:
    """Put pixel x of a frame to scale * x + offset_px."""
    forward = partial(_interpolated, scale=1 / scale, offset_px=-offset_px / scale)
    return Transform(
        words,
        apply=forward,
        inverse=partial(_interpolated, scale=scale, offset_px=offset_px),
        soft=partial(forward, interpolation=cv2.INTER_LINEAR),
        is_exact=False,
        border_px=ceil(np.abs(outside_px).max()) + LANCZOS_REACH_PX,
    )


def _interpolated(
    image: Image8, scale: Pair, offset_px: Pair, interpolation: int = cv2.INTER_LANCZOS4
) -> Image8:
    return round_levels(resampled(image.astype(np.float32), scale, offset_px, interpolation))


def resampled(image: Levels, scale: Pair, offset_px: Pair, interpolation: int) -> Levels:
    """Take pixel x from scale * x + offset_px; beyond the border that of the border is repeated."""
    matrix = np.array([[scale[0], 0, offset_px[0]], [0, scale[1], offset_px[1]]])
    size, flags = image.shape[1::-1], interpolation | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(image, matrix, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)


def centring(scale: Pair, size: Size) -> Pair:
    """Return the offset, px, with which scaling pixel indices leaves the centre where it is."""
    return (np.array(size) - 1) / 2 * (1 - scale)


def at_ends(values: Values) -> list[Values]:
    """Return the parameters of a finding with each one at the lower and upper end of its interval.

    Args:
        values: with the half width of the interval of ``NAME`` as ``NAME_error``, where it has one.

    Examples:
        >>> at_ends({"slope": 2.0, "slope_error": 0.5})
        [{'slope': np.float64(1.5), 'slope_error': 0}, {'slope': np.float64(2.5), 'slope_error': 0}]
    """
    ends: list[Values] = []
    for name in values:
        if f"{name}_error" in values:
            for sign in (-1, 1):
                end = np.add(values[name], sign * values[f"{name}_error"])
                ends.append({**values, name: end, f"{name}_error": 0})
    return ends


# Question of a finding -> the change that it finds.
TRANSFORMS: Mapping[str, Callable[[Values, Size], Transform]] = {
    "mirrored": mirrored,
    "wrong resize": scaled,
    "focal length": scaled,
    "shift": shifted,
    "channel order": reordered,
    "value range": ranged,
    "tone curve": powered,
    "gain": multiplied,
}
