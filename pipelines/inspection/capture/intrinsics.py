"""Intrinsics against the image size and against the other cameras."""

from collections.abc import Sequence

import numpy as np

from ggvs_eval.camera import Camera
from ggvs_eval.pipelines.inspection.finding import RIG, Finding, Verdict, graded

QUESTION = "intrinsics"
# Lenses centre within a few percent; a quarter means a cropped picture or another picture's calibration.
WARN_OFF_CENTRE, BAD_OFF_CENTRE = 0.1, 0.25
# Square pixels, up to the rounding of a resize; users of anamorphic lenses know of them.
WARN_ASPECT, BAD_ASPECT = 0.01, 0.05
NARROWEST_DEG, WIDEST_DEG = 10.0, 150.0
# Cameras of one kind differ by 1 % in focal length; 3 % is another lens or a mistake.
ODD_FOCAL = 0.03


def check_intrinsics(cameras: Sequence[Camera]) -> tuple[Finding, ...]:
    """Evaluate each camera's intrinsics."""
    relative = np.array([camera.focal_px / max(camera.size) for camera in cameras])
    typical = float(np.median(relative))
    # A rig of mixed lenses has no typical one, so none is odd in it.
    is_uniform = float(np.median(np.abs(relative / typical - 1))) < ODD_FOCAL / 2 and len(cameras) > 2
    evaluated = [
        _evaluate(camera, float(value / typical) if is_uniform else 1.0) for camera, value in zip(cameras, relative, strict=True)
    ]
    views = [fields_of_view_deg(camera)[0] for camera in cameras]
    values = {"fov_deg": [round(min(views), 2), round(max(views), 2)], "one_kind_of_lens": is_uniform}
    measured = f"horizontal field of view {min(views):.1f} .. {max(views):.1f} deg, focal {typical:.3f} of the longer side"
    return (Finding(RIG, QUESTION, "ok", measured, values), *evaluated)


def fields_of_view_deg(camera: Camera) -> tuple[float, float]:
    """Horizontal and vertical field of view, degrees, through the image centre."""
    horizontal = np.degrees(2 * np.arctan(camera.width / 2 / camera.K[0, 0]))
    return float(horizontal), float(np.degrees(2 * np.arctan(camera.height / 2 / camera.K[1, 1])))


def off_centre(camera: Camera) -> float:
    """Distance of the principal point from the image centre along the axis where it is larger, as a share of that side."""
    return float(np.abs(camera.K[:2, 2] / np.array(camera.size) - 0.5).max())


def _evaluate(camera: Camera, focal_ratio: float) -> Finding:
    off, ratio, view = off_centre(camera), float(camera.K[0, 0] / camera.K[1, 1]), fields_of_view_deg(camera)[0]
    values = {
        "off_centre": round(off, 4),
        "fx_over_fy": round(ratio, 4),
        "fov_deg": round(view, 2),
        "focal_ratio": round(focal_ratio, 4),
    }
    verdict: Verdict = "warn"
    if off > WARN_OFF_CENTRE:
        verdict, measured = (
            graded(off, WARN_OFF_CENTRE, BAD_OFF_CENTRE),
            f"principal point {100 * off:.0f} % of the side off centre",
        )
        advice = "cropped frames? shift the principal point alike"
    elif abs(ratio - 1) > WARN_ASPECT:
        verdict, measured = graded(abs(ratio - 1), WARN_ASPECT, BAD_ASPECT), f"fx / fy = {ratio:.3f}"
        advice = "calibrated for frames of another aspect? scale both axes; by COLMAP? 'calibrate --camera-model SIMPLE_RADIAL'"
    elif not NARROWEST_DEG < view < WIDEST_DEG:
        measured, advice = f"horizontal field of view {view:.0f} deg", "focal length in pixels of another size?"
    elif abs(focal_ratio - 1) > ODD_FOCAL:
        measured, advice = f"focal length x {focal_ratio:.3f} of the rig's median", "another lens? else see the epipolar error"
    else:
        verdict, measured, advice = "ok", f"field of view {view:.1f} deg", ""
    return Finding(camera.name, QUESTION, verdict, measured, values, advice)
