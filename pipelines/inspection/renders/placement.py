"""Placement of the rendered picture as a whole: shifted, stretched or cropped against the true one.

One picture is fitted onto the other by shift and scale, and how evenly the shift holds over the
picture says whether it is one.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array32
from ggvs_eval.files.images import mean_of_channels
from ggvs_eval.finding import Finding, verdict_of
from ggvs_eval.pipelines.inspection.renders.common_strength import Strength, find_strengths
from ggvs_eval.pipelines.inspection.renders.identity import ViewFrames, correlation, shrink, spread
from ggvs_eval.pipelines.inspection.renders.undo import drop_idle
from ggvs_eval.transforms import Pair, centring, resampled

ITERATIONS = 12
MARGIN_PX = 6
COARSE_SIDE_PX = 160
INSTANTS = 3
# Half a pixel of a larger picture is still a quarter here, and measured to a twentieth.
LONGEST_SIDE_PX = 960
# Standard deviations over views of honest methods with good depth, which have 0.02 px at most.
# Wrong depth shifts and enlarges pictures too, but unevenly, and not alike in both directions.
HONEST_SHIFT_PX, HONEST_GROWTH = 0.03, 0.0005
LEAST_SHIFT_PX, LEAST_STRETCH = 0.12, 0.025
# Disagreement of the parts of a picture as growth, of half its longer side.
GROWTH_UNEVENNESS = 4.0
LARGEST_ANISOTROPY = 0.12
NEAR_HALF_PX, CERTAIN_EVIDENCE = 0.12, 2.0
# Of the squared error of outlines. Wrong depth moved pictures of honest baselines by up to 0.7 px,
# which is 7 % of their error.
LEAST_EXPLAINED = 0.1

SCALES = tuple(1.0741**step for step in range(-5, 6))  # 0.7 to 1.43
# A coarse scale is taken up only where it explains this much more than none.
COARSE_GAIN = 0.75
REGIONS = 3
MEDIAN_SAMPLES = 20_000


@dataclass(frozen=True, eq=False)
class Placement:
    """Registration of a rendered picture with the true one: rendered(x + shift + growth * (x -
    centre)) is truth(x).

    Attributes:
        shift_px: rightwards and downwards, at the centre, (2,).
        growth: horizontally and vertically, (2,); above 0 the rendering is enlarged.
        unevenness_px: usual deviation of nine regions, each on its own, from that, as a standard
            deviation; a region or two where the rendering shows something else do not count.
    """

    shift_px: Pair
    growth: Pair
    unevenness_px: float


def place(rendered: Array32, truth: Array32) -> Placement:
    """Fit shift and scale of two grey pictures (H, W), robust against ghosts, holes and wrong
    colours.

    Differences are weighed down where they are larger than usual; slow changes of brightness are
    taken out.
    """
    half_px = np.array(truth.shape[::-1]) / 2
    scale, shift_px = _coarse_start(rendered, truth)
    motion = np.array([shift_px, (scale - 1) * half_px])
    motion, uneven = _refine(_outlines(rendered), _outlines(truth), motion)
    return Placement(motion[0], motion[1] / half_px, uneven)


def _outlines(grey: Array32) -> Array32:
    """Return the picture without noise and without slow changes."""
    smooth = cv2.GaussianBlur(grey, (0, 0), 1.0)
    return np.asarray(smooth - cv2.GaussianBlur(smooth, (0, 0), 8.0), dtype=np.float32)


def _coarse_start(rendered: Array32, truth: Array32) -> tuple[Pair, Pair]:
    """Scale or shift by more than refinement reaches, from small copies.

    Neither unless it explains much more than none.
    """
    factor = min(COARSE_SIDE_PX / max(truth.shape), 1.0)
    size = round(truth.shape[1] * factor), round(truth.shape[0] * factor)
    small = (
        cv2.GaussianBlur(cv2.resize(image, size, interpolation=cv2.INTER_AREA), (0, 0), 1.5)
        for image in (rendered, truth)
    )
    rendered_detail, truth_detail = (
        np.asarray(image - cv2.GaussianBlur(image, (0, 0), 12.0), dtype=np.float32)
        for image in small
    )
    shift_px, _ = cv2.phaseCorrelate(
        truth_detail, rendered_detail, cv2.createHanningWindow(size, cv2.CV_32F)
    )
    none, still = np.ones(2), np.zeros(2)
    starts = [
        (none, still),
        (none, np.array(shift_px)),
        *((np.array(scale), still) for scale in product(SCALES, SCALES)),
    ]
    rests = [_rest(rendered_detail, truth_detail, *start) for start in starts]
    scale, shift = starts[np.argmin([COARSE_GAIN * rests[0], *rests[1:]])]
    return scale, shift / factor


def _rest(rendered: Array32, truth: Array32, scale: Pair, shift_px: Pair) -> float:
    """1 - correlation in the middle, which both pictures show.

    The rendered one scaled about its centre and shifted back.
    """
    height, width = truth.shape
    moved = resampled(
        rendered, scale, centring(scale, (width, height)) + shift_px, cv2.INTER_LINEAR
    )
    middle = np.s_[height // 6 : -height // 6, width // 6 : -width // 6]
    return 1 - correlation(moved[middle], truth[middle])


def _refine(
    rendered: Array32, truth: Array32, motion: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]:
    """Gauss-Newton steps on ((shift x, shift y), (growth x, growth y)), growth in pixels at the
    border; then the unevenness.
    """
    height, width = truth.shape
    y, x = np.mgrid[:height, :width].astype(np.float32)
    across, down = (x - (width - 1) / 2) / (width / 2), (y - (height - 1) / 2) / (height / 2)
    truth_x, truth_y = _gradient(truth)
    for _ in range(ITERATIONS):
        map_x = (x + motion[0, 0] + motion[1, 0] * across).astype(np.float32)
        map_y = (y + motion[0, 1] + motion[1, 1] * down).astype(np.float32)
        moved = cv2.remap(rendered, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        moved_x, moved_y = _gradient(moved)
        slope_x, slope_y = 0.5 * (truth_x + moved_x), 0.5 * (truth_y + moved_y)
        inside = (
            (np.minimum(map_x, map_y) >= MARGIN_PX)
            & (map_x < width - MARGIN_PX)
            & (map_y < height - MARGIN_PX)
        )
        step = _step(
            truth - moved,
            (slope_x, slope_y, slope_x * across, slope_y * down),
            inside.astype(np.float32),
        )
        motion = motion + step.reshape(2, 2)
        if np.abs(step).max() < 2e-3:
            break
    return motion, _unevenness(rendered, truth, map_x, map_y)


def _step(
    residual: Array32, derivatives: tuple[Array32, ...], window: Array32
) -> NDArray[np.float64]:
    """Return the weighted least squares; a residual of twice the usual size counts half."""
    inside = residual[window > 0]
    if inside.size < 100:
        return np.zeros(len(derivatives))
    usual = 1.4826 * float(np.median(np.abs(inside[:: inside.size // MEDIAN_SAMPLES + 1]))) + 1e-3
    weights = window / (1 + np.square(residual / np.float32(2 * usual)))
    jacobian = np.stack([derivative.ravel() for derivative in derivatives])  # (parameters, pixels)
    weighted = jacobian * weights.ravel()
    normal = (weighted @ jacobian.T).astype(np.float64)
    # A picture without texture along an axis does not move along it.
    ridge = 1e-6 * float(np.trace(normal)) + 1e-9
    return np.linalg.solve(
        normal + ridge * np.eye(len(normal)), (weighted @ residual.ravel()).astype(np.float64)
    )


def _gradient(image: Array32) -> tuple[Array32, Array32]:
    return cv2.Sobel(image, cv2.CV_32F, 1, 0, scale=1 / 8), cv2.Sobel(
        image, cv2.CV_32F, 0, 1, scale=1 / 8
    )


def _unevenness(rendered: Array32, truth: Array32, map_x: Array32, map_y: Array32) -> float:
    """Measure the scatter of the shifts that single regions would add to the fit, px, by further
    steps.
    """
    shifts_px = []
    for rows in np.array_split(np.arange(truth.shape[0]), REGIONS):
        for columns in np.array_split(np.arange(truth.shape[1]), REGIONS):
            region = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
            window = np.zeros_like(truth[region])
            window[2:-2, 2:-2] = 1  # derivatives at the rim of a region are one-sided
            added = np.zeros(2, np.float32)
            for _ in range(4):
                moved = cv2.remap(
                    rendered, map_x[region] + added[0], map_y[region] + added[1], cv2.INTER_LINEAR
                )
                step = _step(truth[region] - moved, _gradient(moved), window)
                added += np.clip(step, -0.5, 0.5).astype(np.float32)
            shifts_px.append(added)
    return 1.4826 * float(np.median(np.abs(shifts_px)))


def find_placement(views: Mapping[str, ViewFrames]) -> list[Finding]:
    """Register some full-sized frames of all views: their scale, then the shift that is left
    without it.

    Returns:
        Findings by view; none of a view where they explain little of its error.
    """
    if not views:
        return []
    placed = [_register(view) for view in views.values()]
    uneven_px = np.array([[placement.unevenness_px] for placement in placed])
    half_px = np.array([[max(view.truth(view.frames[0]).shape) / 2] for view in views.values()])
    growths = np.array([placement.growth for placement in placed])
    shifts_px = np.array([placement.shift_px for placement in placed]) / (1 + growths)
    scales = find_strengths(growths, HONEST_GROWTH, GROWTH_UNEVENNESS * uneven_px / half_px)
    shifts = find_strengths(shifts_px, HONEST_SHIFT_PX, uneven_px)
    described = [
        _describe_scale(name, strength)
        for name, strength in zip(views, scales, strict=True)
        if strength
    ]
    described += [
        _describe_shift(name, strength)
        for name, strength in zip(views, shifts, strict=True)
        if strength
    ]
    findings = [finding for finding in described if finding]
    return drop_idle(
        views, findings, LEAST_EXPLAINED, lambda image: _outlines(mean_of_channels(image))
    )


def _register(view: ViewFrames) -> Placement:
    """Return the median over some instants, in pixels of the full size.

    Instants that disagree are uneven, too.
    """
    factor = max(max(view.truth(view.frames[0]).shape) / LONGEST_SIDE_PX, 1.0)
    placed = []
    for pair in view.pairs(spread(view.frames, INSTANTS)):
        rendered, truth = (mean_of_channels(shrink(image, LONGEST_SIDE_PX)) for image in pair)
        placed.append(place(rendered, truth))
    shifts_px = factor * np.array([placement.shift_px for placement in placed])
    growths = [placement.growth for placement in placed]
    uneven_px = factor * np.median([placement.unevenness_px for placement in placed])
    uneven_px = float(np.hypot(uneven_px, shifts_px.std(axis=0).max()))
    return Placement(np.median(shifts_px, axis=0), np.median(growths, axis=0), uneven_px)


def _describe_scale(name: str, strength: Strength) -> Finding | None:
    """Return a stretched, enlarged or reduced picture.

    A little, as by another focal length, only alike in both directions.
    """
    growth, error = strength.value, strength.half_width.max()
    zoom = growth.mean()
    how = "enlarged" if zoom > 0 else "reduced"
    if np.abs(growth).max() < LEAST_STRETCH:
        is_alike = np.ptp(growth) <= LARGEST_ANISOTROPY * abs(zoom) + error
        if strength.evidence.min() < 1 or not is_alike:
            return None
        question, verdict, growth = "focal length", verdict_of(False), np.full(2, zoom)
        text = (
            f"picture is {how} by {abs(zoom):.2%} +- {error:.2%} about its centre, equally in "
            f"all parts"
        )
        advice = (
            "check fx and fy: intrinsics of another size or before undistortion, or wrong "
            "calibration of the captured camera?"
        )
    else:
        question, verdict = "wrong resize", verdict_of(np.abs(growth).max() > 2 * LEAST_STRETCH)
        how = "stretched" if np.ptp(growth) > LEAST_STRETCH / 2 else how
        text = (
            f"picture is {how}: {1 + growth[0]:.1%} of its width, {1 + growth[1]:.1%} of its "
            f"height, at all instants"
        )
        advice = (
            "cropped or resized to another aspect? resize whole frames, and scale the intrinsics "
            "(fx, cx by width, fy, cy by height)"
        )
    scale_x, scale_y = 1 + growth
    values = {
        "scale_x": scale_x,
        "scale_y": scale_y,
        "scale_x_error": error,
        "scale_y_error": error,
    }
    return Finding(
        subject=name,
        question=question,
        verdict=verdict,
        measured=text,
        values=values,
        advice=advice,
    )


def _describe_shift(name: str, strength: Strength) -> Finding | None:
    x, y = strength.value
    size, error_px = max(abs(x), abs(y)), strength.half_width.max()
    if size < LEAST_SHIFT_PX:
        return None
    is_half = np.abs(2 * strength.value - np.rint(2 * strength.value)).max() / 2 < NEAR_HALF_PX
    is_certain = (
        is_half and strength.evidence.max() > CERTAIN_EVIDENCE and size > 0.5 - NEAR_HALF_PX
    )
    text = f"the whole picture is {x:+.2f} px right and {y:+.2f} px down, within {error_px:.2f} px"
    values = {
        "shift_x_px": x,
        "shift_y_px": y,
        "shift_x_px_error": error_px,
        "shift_y_px_error": error_px,
    }
    return Finding(
        subject=name,
        question="shift",
        verdict=verdict_of(is_certain),
        measured=text,
        values=values,
        advice=_shift_advice(size),
    )


def _shift_advice(size_px: float) -> str:
    if abs(size_px - 0.5) < NEAR_HALF_PX:
        return "pixel centres are at +0.5: check cx, cy and the resize convention (align_corners)"
    if size_px < 0.5:
        return (
            "check cx and cy, and resizes without antialiasing; or calibration error of the "
            "captured camera?"
        )
    return "check cx, cy, the origin of pixel coordinates and crops by a few pixels"
