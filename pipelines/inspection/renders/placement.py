"""Placement of the rendered picture as a whole: shifted, stretched or cropped against the true one.

One picture is fitted onto the other by shift and scale, and how evenly the shift holds over the picture says whether it is one.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array32, Image8
from ggvs_eval.files.images import mean_of_channels
from ggvs_eval.finding import Finding, verdict_of
from ggvs_eval.pipelines.inspection.renders.identity import ViewFrames, shrink, spread
from ggvs_eval.transforms import centring, resampled

ITERATIONS = 12
MARGIN_PX = 6
COARSE_SIDE_PX = 160
UNSCALED = 1.0
INSTANTS = 3
# Half a pixel of a larger picture is still a quarter here, and measured to a twentieth.
LONGEST_SIDE_PX = 960
# Renders with good depth are within 0.015 px, evenly to 0.01 px. Wrong depth shifts by up to 0.5 px as a whole, its parts scatter
# by 0.36 of that and more.
LEAST_SHIFT_PX = 0.12
LARGEST_UNEVENNESS, EVEN = 0.3, 0.15
NEAR_HALF_PX = 0.12
# Wrong depth made pictures grow by up to 1.7 %, but not alike in both directions, or unevenly: of the growth at the border.
LEAST_STRETCH, LEAST_ZOOM = 0.025, 0.004
LARGEST_ANISOTROPY, LARGEST_UNEVEN_GROWTH = 0.12, 0.08
LARGEST_SCATTER_PX = 0.25  # over the instants
FEWEST_VIEWS, VIEWS_SCATTER_PX = 3, 0.2


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
    """Return the picture without noise and without slow changes."""
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
    scales = np.array(scale)
    offset_px = centring(scales, (width, height)) + shift_px
    moved = resampled(ours, scales, offset_px, cv2.INTER_LINEAR)
    sources = (np.arange(size) * scales[axis] + offset_px[axis] for axis, size in enumerate((width, height)))
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
    """Return the weighted least squares; a rest of twice the usual size counts half."""
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
    """Shift that one region would add to the fit, by two further steps."""
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


@dataclass(frozen=True)
class Placed:
    """Placement of the picture of a view.

    Attributes:
        findings: what is wrong with it.
        view: the view, a wrong scale of the picture corrected.
        shift_px: rightwards and downwards; None if the scale is wrong too.
    """

    findings: list[Finding]
    view: ViewFrames
    shift_px: tuple[float, float] | None


def find_placement(name: str, view: ViewFrames) -> Placed:
    """Register some full-sized frames; a fault moves all of them alike, and all parts of each."""
    placed, factor = [], 1.0
    for rendered, truth in view.pairs(spread(view.frames, INSTANTS)):
        factor = max(max(truth.shape[:2]) / LONGEST_SIDE_PX, 1.0)
        placed.append(place(*(mean_of_channels(shrink(image, LONGEST_SIDE_PX)) for image in (rendered, truth))))
    stretched = _evaluate_scale(name, placed) or _evaluate_zoom(name, placed, view)
    if not stretched:
        x, y = (float(value) for value in np.median([one.shift_px for one in placed], axis=0))
        return Placed(_evaluate_shift(name, placed, factor), view, (factor * x, factor * y))
    scale = np.array([stretched[0].values["scale_x"], stretched[0].values["scale_y"]])

    def reduced(image: Image8) -> Image8:
        return resampled(image, scale, centring(scale, image.shape[1::-1]), cv2.INTER_LINEAR)

    return Placed(stretched, view.with_rendered(reduced), None)


def shared_shift(shifts_px: Mapping[str, tuple[float, float]]) -> list[Finding]:
    """Return a shift that all views have alike, which single ones may leave in doubt: wrong depth moves each view its own way."""
    if len(shifts_px) < FEWEST_VIEWS:
        return []
    shifts = np.array(list(shifts_px.values()))
    x, y = (float(value) for value in np.median(shifts, axis=0))
    scatter = float(np.abs(shifts - (x, y)).max())
    if max(abs(x), abs(y)) < LEAST_SHIFT_PX or scatter > VIEWS_SCATTER_PX:
        return []
    measured = f"all {len(shifts)} views are {x:+.2f} px right and {y:+.2f} px down, within {scatter:.2f} px"
    values = {"shift_x_px": x, "shift_y_px": y, "scatter_px": scatter}
    return [Finding(name, "shift", "likely", measured, values, _shift_advice(x, y)) for name in shifts_px]


def _evaluate_scale(name: str, placed: list[Placement]) -> list[Finding]:
    scales = np.array([one.scale for one in placed])  # (instants, 2)
    scale_x, scale_y = (float(value) for value in np.median(scales, axis=0))
    strongest = max(abs(scale_x - 1), abs(scale_y - 1))
    if strongest < LEAST_STRETCH or float(np.ptp(scales, axis=0).max()) > 0.3 * strongest:
        return []
    verdict = verdict_of(strongest > 2 * LEAST_STRETCH)
    how = "stretched" if abs(scale_x / scale_y - 1) > LEAST_STRETCH / 2 else "enlarged" if scale_x > 1 else "reduced"
    measured = f"picture is {how}: {100 * scale_x:.1f} % of its width, {100 * scale_y:.1f} % of its height, at all instants"
    advice = (
        "cropped or resized to another aspect? resize whole frames, and scale the intrinsics (fx, cx by width, fy, cy by height)"
    )
    return [Finding(name, "wrong resize", verdict, measured, {"scale_x": scale_x, "scale_y": scale_y}, advice)]


def _evaluate_zoom(name: str, placed: list[Placement], view: ViewFrames) -> list[Finding]:
    """Return a little larger or smaller about the centre, alike in both directions and all parts, as by another focal length."""
    zooms = np.array([one.scale for one in placed]) - 1  # (instants, 2)
    zoom_x, zoom_y = (float(value) for value in np.median(zooms, axis=0))
    zoom = (zoom_x + zoom_y) / 2
    height, width = view.truth(view.frames[0]).shape[:2]
    half_px = min(max(height, width), LONGEST_SIDE_PX) / 2
    uneven = float(np.median([one.unevenness_px for one in placed]))
    is_even = uneven < LARGEST_UNEVEN_GROWTH * abs(zoom) * half_px
    if abs(zoom) < LEAST_ZOOM or abs(zoom_x - zoom_y) > LARGEST_ANISOTROPY * abs(zoom) or not is_even:
        return []
    if float(np.ptp(zooms, axis=0).max()) > 0.3 * abs(zoom):
        return []
    measured = (
        f"picture is {'enlarged' if zoom > 0 else 'reduced'} by {100 * abs(zoom):.1f} % about its centre, equally in all parts"
    )
    values = {"scale_x": 1 + zoom_x, "scale_y": 1 + zoom_y, "unevenness_px": uneven}
    advice = "check fx and fy: intrinsics of another size or before undistortion, or wrong calibration of the captured camera?"
    return [Finding(name, "focal length", "likely", measured, values, advice)]


def _evaluate_shift(name: str, placed: list[Placement], factor: float) -> list[Finding]:
    shifts = factor * np.array([one.shift_px for one in placed])
    x, y = (float(value) for value in np.median(shifts, axis=0))
    uneven = factor * float(np.median([one.unevenness_px for one in placed]))
    size = max(abs(x), abs(y))
    if size < LEAST_SHIFT_PX or uneven > LARGEST_UNEVENNESS * size or np.ptp(shifts, axis=0).max() > LARGEST_SCATTER_PX * factor:
        return []
    whole = max(abs(2 * value - round(2 * value)) / 2 for value in (x, y))
    verdict = verdict_of(size > 0.5 - NEAR_HALF_PX and whole < NEAR_HALF_PX and uneven < EVEN * size)
    measured = f"the whole picture is {x:+.2f} px right and {y:+.2f} px down, parts of it deviate by {uneven:.2f} px"
    values = {"shift_x_px": x, "shift_y_px": y, "unevenness_px": uneven}
    return [Finding(name, "shift", verdict, measured, values, _shift_advice(x, y))]


def _shift_advice(x: float, y: float) -> str:
    if abs(max(abs(x), abs(y)) - 0.5) < NEAR_HALF_PX:
        return "pixel centres are at +0.5: check cx, cy and the resize convention (align_corners)"
    if max(abs(x), abs(y)) < 0.5:
        return "check cx and cy, and resizes without antialiasing; or calibration error of the captured camera?"
    return "check cx, cy, the origin of pixel coordinates and crops by a few pixels"
