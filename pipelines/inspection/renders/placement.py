"""Placement of the rendered picture as a whole: shifted, stretched or cropped against the true one."""

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from ggvs_eval.arrays import Array32, Image8
from ggvs_eval.pipelines.inspection.finding import Finding, verdict_of
from ggvs_eval.pipelines.inspection.renders.registration import Placement, place
from ggvs_eval.pipelines.inspection.renders.view_frames import ViewFrames, shrink, spread

INSTANTS = 3
# Half a pixel of a larger picture is still a quarter here, and measured to a twentieth.
LONGEST_SIDE_PX = 960
# Renders with good depth lie within 0.015 px, evenly to 0.01 px. Wrong depth shifts by up to 0.5 px as a whole, its parts scatter
# by 0.36 of that and more.
LEAST_SHIFT_PX = 0.12
LARGEST_UNEVENNESS, EVEN = 0.3, 0.15
NEAR_HALF_PX = 0.12
# Wrong depth made pictures grow by up to 1.7 %, but not alike in both directions, or unevenly: of the growth at the border.
LEAST_STRETCH, LEAST_ZOOM = 0.025, 0.004
LARGEST_ANISOTROPY, LARGEST_UNEVEN_GROWTH = 0.12, 0.08
LARGEST_SCATTER_PX = 0.25  # over the instants
FEWEST_VIEWS, VIEWS_SCATTER_PX = 3, 0.2


@dataclass(frozen=True)
class Placed:
    """Placement of the picture of a view.

    Attributes:
        findings: what is wrong with it.
        view: the view, a wrong scale of the picture mended.
        shift_px: rightwards and downwards; None where the scale is wrong too.
    """

    findings: list[Finding]
    view: ViewFrames
    shift_px: tuple[float, float] | None


def find_placement(name: str, view: ViewFrames) -> Placed:
    """Register some full-sized frames; a fault moves all of them alike, and all parts of each."""
    placed, factor = [], 1.0
    for rendered, truth in view.pairs(spread(view.frames, INSTANTS)):
        factor = max(max(truth.shape[:2]) / LONGEST_SIDE_PX, 1.0)
        placed.append(place(_grey(rendered), _grey(truth)))
    stretched = _evaluate_scale(name, placed) or _evaluate_zoom(name, placed, view)
    if not stretched:
        x, y = (float(value) for value in np.median([one.shift_px for one in placed], axis=0))
        return Placed(_evaluate_shift(name, placed, factor), view, (factor * x, factor * y))
    scale = stretched[0].values["scale_x"], stretched[0].values["scale_y"]
    return Placed(stretched, view.with_rendered(lambda image: _scaled(image, *scale)), None)


def shared_shift(shifts_px: Mapping[str, tuple[float, float]]) -> list[Finding]:
    """A shift that all views have alike, which single ones may leave in doubt: wrong depth moves each view its own way."""
    if len(shifts_px) < FEWEST_VIEWS:
        return []
    shifts = np.array(list(shifts_px.values()))
    x, y = (float(value) for value in np.median(shifts, axis=0))
    scatter = float(np.abs(shifts - (x, y)).max())
    if max(abs(x), abs(y)) < LEAST_SHIFT_PX or scatter > VIEWS_SCATTER_PX:
        return []
    measured = f"all {len(shifts)} views lie {x:+.2f} px right and {y:+.2f} px down, within {scatter:.2f} px"
    values = {"shift_x_px": x, "shift_y_px": y, "scatter_px": scatter}
    return [Finding(name, "shift", "likely", measured, values, _shift_advice(x, y)) for name in shifts_px]


def _scaled(image: Image8, scale_x: float, scale_y: float) -> Image8:
    """The picture reduced about its centre by these factors."""
    height, width = image.shape[:2]
    centre_x, centre_y = (width - 1) / 2, (height - 1) / 2
    matrix = np.array([[scale_x, 0, centre_x * (1 - scale_x)], [0, scale_y, centre_y * (1 - scale_y)]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(image, matrix, (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE), np.uint8)


def _grey(image: Image8) -> Array32:
    return np.asarray(shrink(image, LONGEST_SIDE_PX).mean(axis=-1), dtype=np.float32)


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
    """A little larger or smaller about the centre, alike in both directions and all parts, as by another focal length."""
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
    measured = f"picture is {'enlarged' if zoom > 0 else 'reduced'} by {abs(zoom):.1%} about its centre, alike in all parts"
    values = {"scale_x": 1 + zoom_x, "scale_y": 1 + zoom_y, "unevenness_px": uneven}
    advice = "check fx and fy: intrinsics of another size or before undistortion, or is the true camera's calibration off?"
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
    measured = f"the whole picture lies {x:+.2f} px right and {y:+.2f} px down, parts of it deviate by {uneven:.2f} px"
    values = {"shift_x_px": x, "shift_y_px": y, "unevenness_px": uneven}
    return [Finding(name, "shift", verdict, measured, values, _shift_advice(x, y))]


def _shift_advice(x: float, y: float) -> str:
    if abs(max(abs(x), abs(y)) - 0.5) < NEAR_HALF_PX:
        return "pixel centres lie at +0.5: check cx, cy and the resize convention (align_corners)"
    if max(abs(x), abs(y)) < 0.5:
        return "check cx and cy, and resizes without antialiasing; or is the true camera's calibration off by that?"
    return "check cx, cy, the origin of pixel coordinates and crops by a few pixels"
