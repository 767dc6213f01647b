"""Lines in an epipolar plane image: their slope and how straight they are, by the structure tensor.

An EPI (v, x) is a row of the image over the poses of a camera path; a scene point draws the line x = x0 + slope * v. Neighbouring
rows may be many pixels apart, where derivatives mean nothing; so the EPI is sheared by every whole slope of a range, and near its
own slope each line stands upright, where its tensor is measured ("refocusing" an EPI).
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from ggvs_eval.arrays import Array32
from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.inputs import Image, white_level

SMOOTHING_PX = 1.0
WINDOW_PX = 1.5
MARGIN_PX = 10  # radius of both filters
OVER_POSES = {-2: 0.125, -1: 0.375, 0: 0.375, 1: 0.125}  # weights of the pairs (v + m, v + m + 1) around pose v
MAX_SHEARS = 128


@dataclass(frozen=True, eq=False)
class Lines:
    """The best line through every pixel of an epipolar plane image, within a range of slopes.

    Attributes:
        slope_px: dx/dv, px per pose, (V - 4, X).
        across: gradient energy across the line, mean over RGB, (grey levels of 255 per px)^2, (V - 4, X).
        along: energy of the change along the line, mean over RGB, (grey levels of 255 per pose)^2, (V - 4, X).
        first_column: column of the EPI where they start; they end as far from the other side. Rows start at pose 2.
    """

    slope_px: Array32
    across: Array32
    along: Array32
    first_column: int


def find_lines(epi: Image, slope_range_px: tuple[float, float]) -> Lines:
    """Fit a line to every pixel by the structure tensor over 5 poses and about 7 columns, sheared by every whole slope.

    Args:
        epi: (V, W, 3), uint8 in 0..255 or float in [0, 1], V >= 5.
        slope_range_px: smallest and largest slope to allow, px per pose.

    Returns:
        For each pixel the line with the least change along it, relative to the change across it.

    Raises:
        MetricError: not an EPI, too narrow for these slopes, or more slopes than can be tried.

    Reading:
        The textbook's tensor takes its own orientation, and a flash of the whole image (a horizontal line) is perfectly
        coherent to it. Here a line must have a slope that some depth explains, and all other change counts against it.
        Change along v is the difference of neighbouring poses, not the smoother central one, which cannot see a line that
        jitters from pose to pose.
    """
    low, high = slope_range_px
    shears = range(math.floor(low + 0.5), math.ceil(high - 0.5) + 1)
    if epi.ndim != 3 or epi.shape[2] != 3 or epi.shape[0] < 5:
        raise MetricError(f"wanted an epipolar plane image (poses >= 5, width, 3), got {epi.shape}")
    first_column = MARGIN_PX + 2 * max(abs(shears[0]), abs(shears[-1]))
    if len(shears) > MAX_SHEARS or epi.shape[1] <= 2 * first_column:
        raise MetricError(
            f"slopes from {low:.1f} to {high:.1f} px per pose are too many for an image {epi.shape[1]} px wide; use more "
            "poses on the same way, or a larger near"
        )
    smooth, gradient = _filtered(epi)
    best: Lines | None = None
    for shear in shears:
        limits = max(low, shear - 0.5), min(high, shear + 0.5)
        best = _straighter(best, _upright_lines(smooth, gradient, shear, limits, first_column))
    if best is None:
        raise MetricError(f"wanted a range of slopes, got {low:g} to {high:g} px per pose")
    return best


def _filtered(epi: Image) -> tuple[Array32, Array32]:
    """The EPI smoothed along x by a Gaussian and its derivative, both (V, W, 3) on the scale 0..255."""
    scaled = epi.astype(np.float32) * np.float32(255.0 / white_level(epi))
    x = np.arange(-4.0, 5.0)
    gaussian = np.exp(-0.5 * (x / SMOOTHING_PX) ** 2)
    gaussian /= gaussian.sum()
    slope = x * gaussian
    slope /= (x * slope).sum()  # a ramp of 1 has derivative 1
    smooth, gradient = (cv2.filter2D(scaled, cv2.CV_32F, kernel[None]) for kernel in (gaussian, slope))
    return smooth, gradient


def _upright_lines(smooth: Array32, gradient: Array32, shear: int, limits: tuple[float, float], first_column: int) -> Lines:
    """Lines whose slope lies within `limits`, half a pixel around `shear` at most."""
    xx, xv, vv = (_over_window(pairs, shear, first_column) for pairs in _pair_tensors(smooth, gradient, shear))
    moved = np.divide(xv, xx, out=np.zeros_like(xx), where=xx > 1e-6)  # how much less than `shear` a line moves per pose
    np.clip(moved, shear - limits[1], shear - limits[0], out=moved)
    along = np.maximum(vv + moved * (moved * xx - 2 * xv), 0)
    return Lines(shear - moved, xx, along, first_column)


def _pair_tensors(smooth: Array32, gradient: Array32, shear: int) -> tuple[Array32, Array32, Array32]:
    """xx, xv, vv of poses v and v + 1 of the sheared EPI, each (V - 1, W - |shear|), by the column at pose v."""
    here, there = _shifted(-shear), _shifted(shear)
    x = (gradient[:-1, here] + gradient[1:, there]) * np.float32(0.5)
    v = smooth[1:, there] - smooth[:-1, here]
    products = (np.einsum("vxc,vxc->vx", *pair) / np.float32(3) for pair in ((x, x), (x, v), (v, v)))
    xx, xv, vv = (cv2.GaussianBlur(product, (13, 1), WINDOW_PX) for product in products)
    return xx, xv, vv


def _shifted(shift: int) -> slice:
    """Columns that remain when an image is read `shift` further right."""
    return slice(shift, None) if shift >= 0 else slice(None, shift)


def _over_window(pairs: Array32, shear: int, first_column: int) -> Array32:
    """Weighted sum over the pairs around each pose, along the sheared lines, (V - 4, X)."""
    n_poses, width = pairs.shape[0] + 1, pairs.shape[1] + abs(shear)
    total = np.zeros((n_poses - 4, width - 2 * first_column), np.float32)
    left = min(shear, 0)  # a pair's column at its earlier pose starts there when `here` was cut on the left
    for pair, weight in OVER_POSES.items():
        start = first_column + shear * pair + left
        total += np.float32(weight) * pairs[2 + pair : n_poses - 2 + pair, start : start + total.shape[1]]
    return total


def _straighter(best: Lines | None, other: Lines) -> Lines:
    """Of two lines through each pixel the one that changes less along itself, relative to the change across it."""
    if best is None:
        return other
    # along / across < along' / across' without a division by zero
    take = other.along * best.across < best.along * other.across
    pairs = ((best.slope_px, other.slope_px), (best.across, other.across), (best.along, other.along))
    slope_px, across, along = (np.where(take, theirs, ours) for ours, theirs in pairs)
    return Lines(slope_px, across, along, best.first_column)
