"""Epipolar error: cameras whose calibration contradicts their images, and the likely reason."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ggvs_eval.camera import Camera
from ggvs_eval.geometry.epipolar import MatchedPair, tolerances
from ggvs_eval.pipelines.inspection.capture.calibration_errors import (
    PairError,
    accused,
    camera_error,
    has_parallax,
    is_wrong,
    pair_error,
)
from ggvs_eval.pipelines.inspection.capture.camera_record import CameraRecord
from ggvs_eval.pipelines.inspection.capture.pairs import match_pairs
from ggvs_eval.pipelines.inspection.capture.repairs import Repair, explain_camera, explain_rig
from ggvs_eval.pipelines.inspection.finding import RIG, Finding, Verdict, graded

QUESTION = "epipolar error"
# Bounds for sequences that give each of hundreds of pictures a camera of its own.
MOST_JUDGES, MOST_EXPLAINED = 24, 8
GROSS_FOCAL = 0.03
REFINE = "refine the poses (calibrate RIG NEW --known-poses RIG --refine)"
RECALIBRATE = f"{REFINE}, or leave this camera out"


@dataclass(frozen=True)
class CalibrationVerdict:
    """Verdict of the matches on the calibration.

    Attributes:
        findings: for the rig and each camera.
        pairs: matched pairs, with those that were added for cameras in doubt.
        trusted: indices of cameras that agree with their neighbours; empty where they cannot be distinguished from the others.
        suspects: indices of cameras that do not.
    """

    findings: tuple[Finding, ...]
    pairs: tuple[MatchedPair, ...]
    trusted: tuple[int, ...]
    suspects: tuple[int, ...]


def check_epipolar(
    cameras: Sequence[Camera], records: Sequence[CameraRecord], pairs: Sequence[MatchedPair]
) -> CalibrationVerdict:
    """Evaluate every camera by the matches with its neighbours.

    A camera is accused when most of its pairs are wrong while the neighbours' other pairs are right; then what could be the
    reason is tried out on its matches with all trusted cameras.
    """
    all_pairs = tuple(pairs)
    pairs = [pair for pair in pairs if has_parallax(cameras[pair.first], cameras[pair.second])]
    errors = [pair_error(cameras, pair) for pair in pairs]
    suspects = accused(cameras, errors)
    matched = {index for pair in pairs for index in (pair.first, pair.second)}
    trusted = [index for index in sorted(matched) if index not in suspects]
    shared = explain_rig(cameras, pairs)
    over = [index for index in matched if camera_error(cameras, pairs, index) > tolerances(cameras[index])[0]]
    if shared or len(trusted) < max(2, len(matched) / 2) or len(over) > len(matched) / 2:
        return replace(_doubtful_rig(cameras, pairs, errors, shared), pairs=all_pairs)
    # Suspects are compared with trusted cameras all over the rig: of two exchanged ones each sees what the other's neighbours do.
    matched_pairs = {(pair.first, pair.second) for pair in pairs}
    evaluates, tried = trusted[:: len(trusted) // MOST_JUDGES + 1], suspects[:MOST_EXPLAINED]
    missing_pairs = {(min(index, other), max(index, other)) for index in tried for other in evaluates} - matched_pairs
    added = match_pairs(cameras, records, sorted(missing_pairs))
    pairs = [*pairs, *(pair for pair in added if has_parallax(cameras[pair.first], cameras[pair.second]))]
    repairs = dict.fromkeys(suspects) | {index: explain_camera(cameras, pairs, index, trusted) for index in tried}
    evaluated = [_evaluate(cameras, records, pairs, index, trusted, repairs) for index in range(len(cameras))]
    rig = _rig_finding(cameras, errors, suspects)
    return CalibrationVerdict((rig, *evaluated), (*all_pairs, *added), tuple(trusted), tuple(suspects))


def _evaluate(
    cameras: Sequence[Camera],
    records: Sequence[CameraRecord],
    pairs: Sequence[MatchedPair],
    index: int,
    trusted: Sequence[int],
    repairs: dict[int, Repair | None],
) -> Finding:
    """One camera against the trusted ones."""
    name = cameras[index].name
    own = [pair for pair in pairs if index in (pair.first, pair.second) and pair.seen_from(index)[0] in trusted]
    if not own:
        reason = "no frame to look at" if records[index].features is None else "too few matches with any neighbour"
        return Finding(name, QUESTION, "unknown", reason, {}, "look at this camera's picture and pose by eye")
    error_px = camera_error(cameras, own, index)
    values: dict[str, Any] = {
        "error_px": _finite(error_px),
        "n_pairs": len(own),
        "n_matches": sum(len(pair.uv_first) for pair in own),
    }
    shown = f"{error_px:.2f} px" if np.isfinite(error_px) else "matches lie behind the camera"
    repair, verdict = repairs.get(index), graded(error_px, *tolerances(cameras[index]))
    if index not in repairs:
        return Finding(name, QUESTION, verdict, shown, values, "" if verdict == "ok" else RECALIBRATE)
    measured = f"{shown} with {len(own)} cameras that agree among themselves"
    if repair is None:
        return Finding(name, QUESTION, verdict, measured, values, RECALIBRATE)
    values |= {"repair": repair.kind, "error_after_px": round(repair.error_px, 3), "focal_factor": repair.focal_factor}
    if repair.other is not None:
        values["fits_pose_of"] = cameras[repair.other].name
    measured = f"{shown}; {repair.meaning}: {repair.error_px:.2f} px"
    return Finding(name, QUESTION, verdict, measured, values, _advice(cameras, index, repair, repairs))


def _advice(cameras: Sequence[Camera], index: int, repair: Repair, repairs: dict[int, Repair | None]) -> str:
    if repair.other is not None:
        back = repairs.get(repair.other)
        other = cameras[repair.other].name
        if back is not None and back.other == index:
            return f"exchange the frames of {cameras[index].name} and {other}, or their poses"
        return f"give it the pose that {other} has now"
    if repair.focal_factor is not None:
        return f"multiply its focal length by {repair.focal_factor:.3f}, or calibrate again"
    return "correct the pose as named, or calibrate again"


def _rig_finding(cameras: Sequence[Camera], errors: Sequence[PairError], suspects: Sequence[int]) -> Finding:
    """All pairs of cameras that are not accused."""
    sound = [error for error in errors if error.first not in suspects and error.second not in suspects]
    medians = [error.median_px for error in sound]
    odd = [f"{cameras[error.first].name} - {cameras[error.second].name}" for error in sound if is_wrong(cameras, error)]
    values = {"median_px": _finite(float(np.median(medians))), "n_pairs": len(sound), "odd_pairs": odd}
    measured = f"median {np.median(medians):.2f} px over {len(sound)} pairs, {sum(error.n_matches for error in sound)} matches"
    return Finding(RIG, QUESTION, "ok", measured + (f"; odd: {', '.join(odd[:4])}" if odd else ""), values)


def _doubtful_rig(
    cameras: Sequence[Camera], pairs: Sequence[MatchedPair], errors: Sequence[PairError], repair: Repair | None
) -> CalibrationVerdict:
    """No camera can be trusted more than the others: too few matches anywhere, or a fault that all share."""
    if not errors:
        reason = "too few matches between neighbours (far apart, dark or bare of texture)"
        unknown = [Finding(camera.name, QUESTION, "unknown", reason) for camera in cameras]
        rig = Finding(RIG, QUESTION, "unknown", reason, {}, "compare the pictures and poses by eye")
        return CalibrationVerdict((rig, *unknown), tuple(pairs), (), ())
    each = [camera_error(cameras, pairs, index) for index in range(len(cameras))]
    verdicts = [graded(error, *tolerances(camera)) for error, camera in zip(each, cameras, strict=True)]
    # Half of the pairs of a rig hardly notice a common focal length, so their medians understate it.
    is_gross = repair is not None and (repair.focal_factor is None or abs(repair.focal_factor - 1) > GROSS_FOCAL)
    verdict: Verdict = "bad" if is_gross or "bad" in verdicts else "warn"
    median_px = float(np.median([error.median_px for error in errors]))
    values: dict[str, Any] = {"median_px": _finite(median_px), "n_pairs": len(errors)}
    measured = f"median {median_px:.1f} px over {len(errors)} pairs"
    if repair is None:
        measured, advice = (
            f"{measured}; no camera agrees with most others",
            f"{REFINE}; if that does not help, check that poses and frames belong together, or calibrate without them",
        )
    else:
        measured, advice = f"{measured}; {repair.meaning}: {repair.error_px:.2f} px", "correct all cameras as named"
        values |= {"repair": repair.kind, "focal_factor": repair.focal_factor}
    reason = "no neighbour can be trusted"
    unknown = [
        Finding(camera.name, QUESTION, "unknown", reason, {"error_px": _finite(error)})
        for camera, error in zip(cameras, each, strict=True)
    ]
    suspects = tuple(range(len(cameras))) if verdict == "bad" else ()
    return CalibrationVerdict((Finding(RIG, QUESTION, verdict, measured, values, advice), *unknown), tuple(pairs), (), suspects)


def _finite(value: float) -> float | None:
    """A number for JSON, which knows neither NaN nor infinity."""
    return round(value, 4) if np.isfinite(value) else None
