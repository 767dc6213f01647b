"""Check of the registration of sensor depth with its colour: displacement of its edges in pixels, and its scale."""

import numpy as np

from ggvs_eval.capture import Capture
from ggvs_eval.errors import GgvsError
from ggvs_eval.pipelines.inspection.finding import RIG, SEVERITY, Finding, Verdict, graded
from ggvs_eval.pipelines.offline.sensor.registered_capture import displacement, is_sequence
from ggvs_eval.pipelines.offline.sensor.registration import Registration
from ggvs_eval.pipelines.offline.sensor.registration_estimate import Displacement

QUESTION = "depth registration"
# Of images 480 pixels wide: a pixel beside an edge takes the other surface's colour along; three show at arm's length.
WARN_PX, BAD_PX = 1.0, 3.0
# A scale error of 1 % moves a neighbour 5 % of the depth away by a quarter of a pixel at 480 pixels.
WARN_SCALE, BAD_SCALE = 0.01, 0.03
# What single frames want beside the common registration: poses, blur, or a rolling shutter.
WARN_FRAME_PX = 2.0


def check_depth_registration(capture: Capture) -> tuple[Finding, ...]:
    """Measure how far sensor depth lies off its colour; no finding for captures without sensor depth."""
    if not any(extras.depth is not None for extras in capture.extras):
        return ()
    if not is_sequence(capture):
        return (Finding(RIG, QUESTION, "unknown", "several cameras with a sensor each: only sequences of one are measured"),)
    try:
        measured = displacement(capture)
    except GgvsError as error:
        return (Finding(RIG, QUESTION, "unknown", f"frames cannot be read: {error}"),)
    if measured is None:
        return (Finding(RIG, QUESTION, "unknown", "too few edges of depth to compare with colour"),)
    return (_evaluate(measured, capture.cameras[0].width),)


def _evaluate(measured: Displacement, width_px: int) -> Finding:
    enlarged = width_px / measured.width_px
    applied, registration = measured.applied, measured.registration
    offset_px = measured.displacement_px if applied.moves else 0.0
    scale_error = abs(applied.scale - 1)
    grades: tuple[Verdict, ...] = (
        graded(offset_px, WARN_PX, BAD_PX),
        graded(scale_error, WARN_SCALE, BAD_SCALE),
        "warn" if measured.frame_px > WARN_FRAME_PX else "ok",
    )
    values = {
        "displacement_px": round(measured.displacement_px * enlarged, 3),
        "error_px": round(measured.error_px * enlarged, 3),
        "right_px": round(registration.right * width_px, 3),
        "down_px": round(registration.down * width_px, 3),
        "roll_deg": round(float(np.degrees(registration.roll_rad)), 4),
        "delay_frames": round(registration.delay_frames, 3),
        "scale": round(registration.scale, 5),
        "scale_error": round(measured.scale_error, 5) if np.isfinite(measured.scale_error) else None,
        "frame_px": round(measured.frame_px * enlarged, 3) if np.isfinite(measured.frame_px) else None,
        "psnr_given_db": _number(measured.psnr_db[0]),
        "psnr_mended_db": _number(measured.psnr_db[1]),
        "is_mended": applied != Registration(),
        "n_frames": measured.n_frames,
        "n_edges": measured.n_edges,
    }
    shown = (
        f"depth edges {values['displacement_px']:.2f} +- {values['error_px']:.2f} px off colour, single frames "
        f"{measured.frame_px * enlarged:.1f} px, scale {registration.scale:.4f}; warped neighbours {measured.psnr_db[0]:.2f} dB"
    )
    return Finding(RIG, QUESTION, max(grades, key=SEVERITY.__getitem__), shown, values, _advice(measured, width_px))


def _advice(measured: Displacement, width_px: int) -> str:
    if measured.applied != Registration():
        return (
            f"--registration estimated mends it ({measured.applied.describe(width_px)}): warped neighbours "
            f"{measured.psnr_db[1]:.2f} dB; or register the depth maps to the colour camera"
        )
    if measured.frame_px > WARN_FRAME_PX:
        return "no common registration mends it: poses, motion blur or the sensor's delay differ from frame to frame"
    return ""


def _number(value: float) -> float | None:
    return round(value, 3) if np.isfinite(value) else None
