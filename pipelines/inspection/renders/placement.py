"""Whether the rendered picture as a whole lies where the true one does: shifted, stretched, cropped."""

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
# Honest renders with wrong depth shifted by up to 0.3 px as a whole, unevenly over the picture.
LEAST_SHIFT_PX = 0.4
# Of the shift. Regions that scatter by that much leave the middle of nine known to a sixth of the shift.
LARGEST_UNEVENNESS, EVEN = 0.5, 0.25
NEAR_HALF_PX = 0.12
# The same renders grew by up to 1.7 %.
LEAST_STRETCH = 0.025
LARGEST_SCATTER_PX = 0.25  # over the instants
FEWEST_VIEWS, VIEWS_SCATTER_PX = 3, 0.2


@dataclass(frozen=True)
class Placed:
    """Where the picture of a view lies.

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
    stretched = _evaluate_scale(name, placed)
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


def _evaluate_shift(name: str, placed: list[Placement], factor: float) -> list[Finding]:
    shifts = factor * np.array([one.shift_px for one in placed])
    x, y = (float(value) for value in np.median(shifts, axis=0))
    uneven = factor * float(np.median([one.unevenness_px for one in placed]))
    size = max(abs(x), abs(y))
    if size < LEAST_SHIFT_PX or uneven > LARGEST_UNEVENNESS * size or np.ptp(shifts, axis=0).max() > LARGEST_SCATTER_PX * factor:
        return []
    whole = max(abs(2 * value - round(2 * value)) / 2 for value in (x, y))
    verdict = verdict_of(whole < NEAR_HALF_PX and uneven < EVEN * size)
    measured = f"the whole picture lies {x:+.2f} px right and {y:+.2f} px down, parts of it deviate by {uneven:.2f} px"
    values = {"shift_x_px": x, "shift_y_px": y, "unevenness_px": uneven}
    return [Finding(name, "shift", verdict, measured, values, _shift_advice(x, y))]


def _shift_advice(x: float, y: float) -> str:
    if abs(max(abs(x), abs(y)) - 0.5) < NEAR_HALF_PX:
        return "pixel centres lie at +0.5: check cx, cy and the resize convention (align_corners)"
    return "check cx, cy, the origin of pixel coordinates and crops by a few pixels"
