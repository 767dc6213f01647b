"""Time offset of each camera against the rig, by the motion that two views see alike without matching.

Every point of the scene lies in one half-plane that is bounded by the line through the two centres, and both cameras see it in
that same half-plane, whatever its depth. So the motion within each half-plane rises and falls in both at the same instants (the
idea of motion barcodes, Ben-Artzi et al. 2016, with energies in place of bits).
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array, Array32
from ggvs_eval.camera import Camera
from ggvs_eval.geometry.epipolar import neighbour_pairs
from ggvs_eval.pipelines.inspection.capture.frames import CameraRecord
from ggvs_eval.pipelines.inspection.capture.pairs import solve_differences
from ggvs_eval.pipelines.inspection.finding import RIG, Finding, Verdict

PLANES = 24
# Share of pixels at the rims that may lie outside the planes compared.
RIM_SHARE = 0.02
# Differences below so many times the usual one of that frame are noise, or the pulse of a codec's key frames.
NOISE_FACTOR, LEAST_LEVELS = 4.0, 1.0
SMOOTHING_SIGMA = 1.0
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


@dataclass(frozen=True)
class Lag:
    """By how much one camera's motion trails another's.

    Attributes:
        frames: lag of the best agreement, with a fraction.
        correlation: at that lag, 1 for equal signals.
        margin: how much better that is than the best lag two or more frames away.
        at_edge: the best lag is the largest that was tried, so the true one may lie beyond.
    """

    frames: float
    correlation: float
    margin: float
    at_edge: bool


def motion_energy(burst: NDArray[np.uint8]) -> Array32:
    """Square root of what changes from frame to frame beyond noise, (B - 1, h, w)."""
    energy = np.empty((max(len(burst) - 1, 0), *burst.shape[1:]), np.float32)
    for index in range(len(energy)):
        difference = cv2.absdiff(burst[index + 1], burst[index]).astype(np.float32)
        difference = cv2.GaussianBlur(difference, (0, 0), SMOOTHING_SIGMA)
        threshold = max(NOISE_FACTOR * float(np.median(difference)), LEAST_LEVELS)
        energy[index] = np.sqrt(np.maximum(difference - threshold, 0))
    return energy


def plane_signals(one: Camera, other: Camera, energy_one: Array32, energy_other: Array32) -> tuple[Array, Array] | None:
    """Motion energy per half-plane and frame as two cameras see it, both (PLANES, T); None where they share no plane.

    Args:
        energy_one: (T, h, w).
        energy_other: (T, h', w').
    """
    if np.linalg.norm(other.centre - one.centre) < 1e-9:
        return None
    angles = plane_angles(one, other)
    low = max(np.quantile(angle, RIM_SHARE) for angle in angles)
    high = min(np.quantile(angle, 1 - RIM_SHARE) for angle in angles)
    if not low < high:
        return None
    edges = np.linspace(low, high, PLANES + 1)
    first, second = (
        _per_plane(energy, np.digitize(angle.ravel(), edges))
        for energy, angle in zip((energy_one, energy_other), angles, strict=True)
    )
    return first, second


def plane_angles(one: Camera, other: Camera) -> tuple[Array, Array]:
    """Angle about the line through both centres of the half-plane that each pixel's ray lies in, radians, (H, W) each."""
    baseline = other.centre - one.centre
    baseline /= np.linalg.norm(baseline)
    forward = one.axis + other.axis
    forward = forward - baseline * (baseline @ forward)
    if np.linalg.norm(forward) < 1e-6:  # they look along the line, at each other or one behind the other
        forward = np.cross(baseline, np.eye(3)[np.abs(baseline).argmin()])
    forward /= np.linalg.norm(forward)
    side = np.cross(baseline, forward)
    rays = one.rays(), other.rays()
    return np.arctan2(rays[0] @ side, rays[0] @ forward), np.arctan2(rays[1] @ side, rays[1] @ forward)


def best_lag(one: Array, other: Array, largest: int) -> Lag | None:
    """The lag at which other[t + lag] follows one[t] best; None where too little happens in either.

    Args:
        one: signals, (P, T).
        largest: lags from -largest to largest are tried.
    """
    lags = np.arange(-largest, largest + 1)
    scores = np.array([_correlation(one, other, int(lag)) for lag in lags])
    if not np.isfinite(scores).all():
        return None
    peak = int(scores.argmax())
    far = scores[np.abs(lags - lags[peak]) >= 2]
    at_edge = peak in (0, len(lags) - 1)
    shift = 0.0 if at_edge else _parabola_peak(*scores[peak - 1 : peak + 2])
    return Lag(float(lags[peak] + shift), float(scores[peak]), float(scores[peak] - far.max()), at_edge)


def _per_plane(energy: Array32, planes: NDArray[np.int64]) -> Array:
    """Mean energy of the pixels of each plane, (PLANES, T); 0 where a plane has none."""
    count = np.bincount(planes, minlength=PLANES + 2)[1:-1]
    sums = np.stack([np.bincount(planes, frame.ravel(), PLANES + 2)[1:-1] for frame in energy], axis=1)
    return np.asarray(sums / np.maximum(count, 1)[:, None])


def _correlation(one: Array, other: Array, lag: int) -> float:
    """Correlation over all planes of the frames that overlap at a lag; planes count by how much happens in them."""
    frames = one.shape[1]
    first = one[:, max(0, -lag) : frames - max(0, lag)]
    second = other[:, max(0, lag) : frames + min(0, lag)]
    first, second = (signal - signal.mean(axis=1, keepdims=True) for signal in (first, second))
    energy = float((first**2).sum() * (second**2).sum())
    return float((first * second).sum() / np.sqrt(energy)) if energy > 1e-12 else float("nan")


def _parabola_peak(before: float, at: float, after: float) -> float:
    """Locate the maximum of the parabola through three equidistant values, relative to the middle one."""
    curvature = before - 2 * at + after
    return float(np.clip(0.5 * (before - after) / curvature, -0.5, 0.5)) if curvature < 0 else 0.0


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
