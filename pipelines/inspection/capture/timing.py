"""Time offset of each camera against the rig."""

from collections.abc import Collection, Sequence

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera
from ggvs_eval.geometry.epipolar import neighbour_pairs
from ggvs_eval.pipelines.inspection.capture.camera_record import CameraRecord
from ggvs_eval.pipelines.inspection.capture.motion_signals import Lag, best_lag, motion_energy, plane_signals
from ggvs_eval.pipelines.inspection.capture.pairs import solve_differences
from ggvs_eval.pipelines.inspection.finding import RIG, Finding, Verdict

QUESTION = "time offset"
LARGEST_LAG = 8
# Fewer frames leave nothing to correlate once they are shifted.
FEWEST_FRAMES = 8
# Random signals of 24 planes and 16 frames reach 0.2 at the best of 17 lags; motion seen by two cameras gave 0.6 - 0.98.
LEAST_CORRELATION = 0.35
# A whole frame wrong pairs pictures of different instants. Less is usual without genlock, but above a quarter it can be seen.
BAD_FRAMES, WARN_FRAMES = 0.75, 0.3
# How far the lags of a camera's pairs may scatter about the solution before it is not believed.
LARGEST_SCATTER_FRAMES = 0.75
# One pair cannot tell which of its two cameras is wrong, nor whether it is wrong itself.
FEWEST_PAIRS = 2
Lags = dict[tuple[int, int], Lag]


def check_timing(
    cameras: Sequence[Camera], records: Sequence[CameraRecord], doubtful: Collection[int] = (), fps: float = 0.0
) -> tuple[Finding, ...]:
    """Offsets of all cameras from the motion that neighbours see.

    Args:
        doubtful: indices of cameras whose calibration is wrong, whose motion can be compared with no other's.
        fps: frames per second, to say offsets in milliseconds too.

    Returns:
        One finding for the rig and one for each camera; ``offset_frames`` is positive for a camera that is ahead: its frame t
        shows what the others show at t + offset.
    """
    reason = _why_not(records) or ("the calibration is in doubt, see epipolar error" if len(doubtful) == len(cameras) else "")
    if reason:
        return tuple(Finding(subject, QUESTION, "unknown", reason) for subject in (RIG, *(camera.name for camera in cameras)))
    lags = measure_lags(cameras, records, doubtful)
    offsets = solve_offsets(len(cameras), lags)
    evaluated = [
        _unknown(record, index in doubtful, len(cameras), [lag for pair, lag in lags.items() if index in pair])
        or _evaluate(record.name, index, offsets, lags)
        for index, record in enumerate(records)
    ]
    n_known = int(np.isfinite(offsets).sum())
    if not n_known:
        reason = "nothing moves, or not as neighbours see it"
        return (Finding(RIG, QUESTION, "unknown", reason, {}, "compare a clap or a flash by eye"), *evaluated)
    spread = float(np.nanmax(np.abs(offsets)))
    shown = f"largest {spread:.2f} frames" + (f" ({1000 * spread / fps:.0f} ms)" if fps else "")
    correlation = float(np.median([lag.correlation for lag in lags.values()]))
    values = {"largest_frames": round(spread, 3), "n_cameras": n_known, "correlation": round(correlation, 3)}
    measured = f"{shown} among {n_known} cameras, {len(lags)} pairs, correlation {correlation:.2f}"
    return (Finding(RIG, QUESTION, "ok", measured, values), *evaluated)


def measure_lags(cameras: Sequence[Camera], records: Sequence[CameraRecord], doubtful: Collection[int] = ()) -> Lags:
    """Lag of each pair of neighbours whose motion agrees at one lag clearly better than at others."""
    usable = {index for index, record in enumerate(records) if len(record.burst) >= FEWEST_FRAMES} - set(doubtful)
    energies = {index: motion_energy(records[index].burst) for index in usable}
    small = {index: cameras[index].resized(*records[index].burst.shape[:0:-1]) for index in usable}
    lags: Lags = {}
    for i, j in neighbour_pairs(cameras):
        if i in usable and j in usable:
            length = min(len(energies[i]), len(energies[j]))  # damage may have cut one short
            signals = plane_signals(small[i], small[j], energies[i][:length], energies[j][:length])
            lag = best_lag(*signals, min(LARGEST_LAG, length // 3)) if signals else None
            if lag is not None and lag.correlation >= LEAST_CORRELATION and not lag.at_edge:
                lags[i, j] = lag
    return lags


def solve_offsets(count: int, lags: Lags) -> Array:
    """Offset of each camera, frames, median 0, (count,); NaN where no pair tells."""
    if not lags:
        return np.full(count, np.nan)
    weights = np.array([lag.correlation * max(lag.margin, 0.01) for lag in lags.values()])
    return solve_differences(count, list(lags), np.array([lag.frames for lag in lags.values()]), weights)


def _why_not(records: Sequence[CameraRecord]) -> str:
    longest = max((len(record.burst) for record in records), default=0)
    if len(records) < 2:
        return "one camera alone has no offset"
    if longest < FEWEST_FRAMES:
        return f"{longest} frame{'s' * (longest != 1)}, at least {FEWEST_FRAMES} are needed"
    return ""


def _unknown(record: CameraRecord, is_doubtful: bool, n_cameras: int, own: Sequence[Lag]) -> Finding | None:
    """Say why nothing can be said of one camera; None where something can."""
    reason = ""
    if is_doubtful:
        reason = "its calibration is in doubt, see epipolar error"
    elif len(record.burst) < FEWEST_FRAMES:
        reason = f"{len(record.burst)} frames in a row, at least {FEWEST_FRAMES} are needed"
    elif len(own) < min(FEWEST_PAIRS, n_cameras - 1):
        reason = "no motion that enough neighbours see too"
    return Finding(record.name, QUESTION, "unknown", reason) if reason else None


def _evaluate(name: str, index: int, offsets: Array, lags: Lags) -> Finding:
    own = {pair: lag for pair, lag in lags.items() if index in pair}
    offset = float(offsets[index])
    if not np.isfinite(offset):
        return Finding(name, QUESTION, "unknown", "its neighbours share no motion with the rest of the rig")
    scatter = float(np.median([abs(offsets[i] - offsets[j] - lag.frames) for (i, j), lag in own.items()]))
    if scatter > LARGEST_SCATTER_FRAMES:
        return Finding(name, QUESTION, "unknown", f"its {len(own)} neighbours contradict each other by {scatter:.1f} frames")
    correlation = float(np.median([lag.correlation for lag in own.values()]))
    values = {"offset_frames": round(offset, 3), "correlation": round(correlation, 3), "n_pairs": len(own)}
    size = abs(offset)
    verdict: Verdict = "bad" if size > BAD_FRAMES else "warn" if size > WARN_FRAMES else "ok"
    whole = round(size)
    direction = "ahead of" if offset > 0 else "behind"
    measured = f"{size:.2f} frames {direction} the rig, correlation {correlation:.2f} with {len(own)} cameras"
    advice = "" if verdict == "ok" else "shot without genlock? leave the camera out where things move fast"
    if whole:
        advice = f"'check --repair' shifts it by {whole} frame{'s' * (whole > 1)}; or leave it out"
    return Finding(name, QUESTION, verdict, measured, values, advice)
