"""Fit of one picture onto another by shift and scale, and how evenly the shift holds over the picture."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array32

ITERATIONS = 12
MARGIN_PX = 6
COARSE_SIDE_PX = 160
UNSCALED = 1.0
SCALES = tuple(1.0741**step for step in range(-5, 6))  # 0.7 to 1.43
# A coarse scale is taken up only where it explains this much more than none.
COARSE_GAIN = 0.75
REGIONS = 3
MEDIAN_SAMPLES = 20_000


@dataclass(frozen=True)
class Placement:
    """Registration of a rendered picture with the true one: rendered(x + shift + (scale - 1)(x - centre)) is truth(x).

    Attributes:
        shift_px: rightwards and downwards, at the centre.
        scale: horizontally and vertically; above 1 the rendering is enlarged.
        unevenness_px: usual deviation of nine regions, each on its own, from that, as a standard deviation; a region or two where
            the rendering shows something else do not count.
    """

    shift_px: tuple[float, float]
    scale: tuple[float, float]
    unevenness_px: float


def place(rendered: Array32, truth: Array32) -> Placement:
    """Fit shift and scale of two grey pictures (H, W), robust against ghosts, holes and wrong colours.

    Differences are weighed down where they are larger than usual; slow changes of brightness are taken out.
    """
    ours, theirs = _outlines(rendered), _outlines(truth)
    height, width = theirs.shape
    half = np.array([width / 2, height / 2])
    start = _coarse_start(rendered, truth)
    motion = np.array([start.shift_px[0], (start.scale[0] - 1) * half[0], start.shift_px[1], (start.scale[1] - 1) * half[1]])
    motion = _refine(ours, theirs, motion, np.ones_like(theirs))
    uneven = _unevenness(ours, theirs, motion)
    scale = 1 + motion[1] / half[0], 1 + motion[3] / half[1]
    return Placement((float(motion[0]), float(motion[2])), (float(scale[0]), float(scale[1])), uneven)


def _outlines(grey: Array32) -> Array32:
    """The picture without noise and without slow changes."""
    smooth = cv2.GaussianBlur(grey, (0, 0), 1.0)
    return np.asarray(smooth - cv2.GaussianBlur(smooth, (0, 0), 8.0), dtype=np.float32)


def _coarse_start(rendered: Array32, truth: Array32) -> Placement:
    """Scale or shift by more than refinement reaches, from small copies; neither unless it explains much more than none."""
    factor = min(COARSE_SIDE_PX / max(truth.shape), 1.0)
    size = round(truth.shape[1] * factor), round(truth.shape[0] * factor)
    small = (cv2.GaussianBlur(cv2.resize(image, size, interpolation=cv2.INTER_AREA), (0, 0), 1.5) for image in (rendered, truth))
    ours, theirs = (np.asarray(image - cv2.GaussianBlur(image, (0, 0), 12.0), dtype=np.float32) for image in small)
    rests = {(x, y): _rest(ours, theirs, (x, y), (0.0, 0.0)) for x in SCALES for y in SCALES}
    least = COARSE_GAIN * rests[UNSCALED, UNSCALED]
    best = min(rests, key=lambda key: rests[key])
    (x, y), _ = cv2.phaseCorrelate(theirs, ours, cv2.createHanningWindow(size, cv2.CV_32F))
    if _rest(ours, theirs, (UNSCALED, UNSCALED), (x, y)) < min(least, rests[best]):
        return Placement((x / factor, y / factor), (1.0, 1.0), 0.0)
    return Placement((0.0, 0.0), best if rests[best] < least else (1.0, 1.0), 0.0)


def _rest(ours: Array32, theirs: Array32, scale: tuple[float, float], shift_px: tuple[float, float]) -> float:
    """1 - correlation where both pictures are, the rendered one scaled about its centre and shifted back."""
    height, width = theirs.shape
    inset = [(1 - factor) * (size - 1) / 2 for factor, size in zip(scale, (width, height), strict=True)]
    matrix = np.array([[scale[0], 0, inset[0] + shift_px[0]], [0, scale[1], inset[1] + shift_px[1]]])
    moved = cv2.warpAffine(ours, matrix, (width, height), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    sources = (np.arange(size) * matrix[axis, axis] + matrix[axis, 2] for axis, size in enumerate((width, height)))
    x, y = ((source >= 0) & (source <= size - 1) for source, size in zip(sources, (width, height), strict=True))
    first, second = moved[np.ix_(y, x)], theirs[np.ix_(y, x)]
    energy = float(np.sqrt((first * first).sum() * (second * second).sum()))
    return 1 - float((first * second).sum()) / energy if energy > 0 else 1.0


def _refine(ours: Array32, theirs: Array32, motion: NDArray[np.float64], window: Array32) -> NDArray[np.float64]:
    """Gauss-Newton steps on (shift x, growth x, shift y, growth y), growth in pixels at the border."""
    height, width = theirs.shape
    y, x = np.mgrid[:height, :width].astype(np.float32)
    across, down = (x - (width - 1) / 2) / (width / 2), (y - (height - 1) / 2) / (height / 2)
    truth_x, truth_y = _gradient(theirs)
    for _ in range(ITERATIONS):
        map_x = (x + motion[0] + motion[1] * across).astype(np.float32)
        map_y = (y + motion[2] + motion[3] * down).astype(np.float32)
        moved = cv2.remap(ours, map_x, map_y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        slope_x, slope_y = (0.5 * (a + b) for a, b in zip(_gradient(moved), (truth_x, truth_y), strict=True))
        inside = (
            (map_x >= MARGIN_PX) & (map_x <= width - 1 - MARGIN_PX) & (map_y >= MARGIN_PX) & (map_y <= height - 1 - MARGIN_PX)
        )
        step = _step(theirs - moved, (slope_x, slope_x * across, slope_y, slope_y * down), window * inside.astype(np.float32))
        motion = motion + step
        if np.abs(step).max() < 2e-3:
            break
    return motion


def _step(rest: Array32, derivatives: tuple[Array32, ...], window: Array32) -> NDArray[np.float64]:
    """Weighted least squares; a rest of twice the usual size counts half."""
    used = rest[window > 0]
    if used.size < 100:
        return np.zeros(4)
    usual = 1.4826 * float(np.median(np.abs(used[:: used.size // MEDIAN_SAMPLES + 1]))) + 1e-3
    weights = window / (1 + np.square(rest / np.float32(2 * usual)))
    jacobian = np.stack([np.broadcast_to(derivative, rest.shape).ravel() for derivative in derivatives])  # (4, pixels)
    weighted = jacobian * weights.ravel()
    normal = (weighted @ jacobian.T).astype(np.float64)
    # A picture without texture along an axis does not move along it.
    ridge = 1e-6 * float(np.trace(normal)) + 1e-9
    return np.linalg.solve(normal + ridge * np.eye(4), (weighted @ rest.ravel()).astype(np.float64))


def _gradient(image: Array32) -> tuple[Array32, Array32]:
    x, y = (cv2.Sobel(image, cv2.CV_32F, dx, dy, ksize=3, scale=1 / 8) for dx, dy in ((1, 0), (0, 1)))
    return np.asarray(x, dtype=np.float32), np.asarray(y, dtype=np.float32)


def _unevenness(ours: Array32, theirs: Array32, motion: NDArray[np.float64]) -> float:
    """Measure the scatter of the shifts of single regions about the fit, px."""
    height, width = theirs.shape
    left: list[float] = []
    for row in range(REGIONS):
        for column in range(REGIONS):
            ys = slice(row * height // REGIONS, (row + 1) * height // REGIONS)
            xs = slice(column * width // REGIONS, (column + 1) * width // REGIONS)
            left += _region_shift(ours, theirs, motion, ys, xs)
    return 1.4826 * float(np.median(np.abs(left)))


def _region_shift(ours: Array32, theirs: Array32, motion: NDArray[np.float64], ys: slice, xs: slice) -> list[float]:
    """Shift that one region would add to the fit, by two steps of its own."""
    height, width = theirs.shape
    y, x = np.mgrid[ys, xs].astype(np.float32)
    map_x = x + motion[0] + motion[1] * (x - (width - 1) / 2) / (width / 2)
    map_y = y + motion[2] + motion[3] * (y - (height - 1) / 2) / (height / 2)
    added = np.zeros(2)
    for _ in range(4):
        moved = cv2.remap(ours, (map_x + added[0]).astype(np.float32), (map_y + added[1]).astype(np.float32), cv2.INTER_CUBIC)
        rest, (slope_x, slope_y) = theirs[ys, xs] - moved, _gradient(moved)
        zero = np.zeros_like(slope_x)
        window = np.zeros_like(rest)
        window[2:-2, 2:-2] = 1  # derivatives at the rim of a region are one-sided
        step = _step(rest, (slope_x, zero, slope_y, zero), window)
        added += np.clip(step[[0, 2]], -0.5, 0.5)
    return [float(added[0]), float(added[1])]
