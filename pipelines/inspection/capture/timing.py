"""Time offset of each camera against the rig, by the motion that two views see alike without
matching.

Every point of the scene is in one half-plane that is bounded by the line through the two centres,
and both cameras see it in that same half-plane, regardless of its depth. So the motion within each
half-plane rises and falls in both at the same instants (the idea of motion barcodes, Ben-Artzi et
al. 2016, with energies in place of bits).
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from ggvs_eval.arrays import Array, Array32
from ggvs_eval.camera import Camera
from ggvs_eval.finding import RIG, Finding, Verdict, graded
from ggvs_eval.geometry.epipolar import neighbour_pairs
from ggvs_eval.pipelines.inspection.capture.frames import frozen_frames
from ggvs_eval.pipelines.inspection.capture.pairs import solve_differences
from ggvs_eval.pipelines.inspection.capture.records import CameraRecord, robust_sigma
from ggvs_eval.pipelines.inspection.capture.stillness import describe_when

PLANES = 48
# Share of pixels at the rims that may be outside the planes compared.
RIM_SHARE = 0.02
QUESTION = "time offset"
LARGEST_LAG = 8
# Fewer frames leave nothing to correlate once they are shifted.
FEWEST_FRAMES = 8
# Random signals of 24 planes and 16 frames reach 0.2 at the best of 17 lags; motion seen by two
# cameras gave 0.6 - 0.98.
LEAST_CORRELATION = 0.35
# A whole frame wrong pairs pictures of different instants. Less is usual without genlock, and hard
# to know, see below.
BAD_FRAMES, WARN_FRAMES = 0.75, 0.5
# How far the lags of a camera's pairs may scatter about the solution before it is not believed.
LARGEST_SCATTER_FRAMES = 0.75
# One pair cannot tell which of its two cameras is wrong; two can both lead to a camera that hangs
# on no other.
FEWEST_PAIRS = 3
DROPPED = "dropped frames"
# Frames lost at once; frames on either side of a step.
LARGEST_STEP, LEAST_SIDE = 3, 3
# Gain of a step in squared difference, in units of what is left of it in a frame, and of each
# standard deviation of the motion at that frame. No sound camera of 72 takes of 15 to 24 frames
# with noise up to 3 levels reaches 1.6;
# 61 of 66 that lost one do.
LEAST_GAIN, SPIKE_GAIN, SPIKE_RANGE, LEAST_SPIKE_SIGMA = 1.6, 0.4, (-2.0, 5.0), 0.05
# Of the picture between two frames.
JUMP_PX, MOST_JUMPS_SHARE = 0.5, 0.3
LEAST_RESIDUAL, WORST_ROW, SLOW_FRAMES = 0.01, 4.0, 2.0
# Half widths of intervals are so many standard errors. Cameras far apart see motion from different
# sides, which moves the lag of all their pairs alike: of 466 cameras in step the offsets had a
# standard deviation of 0.13 frames, more where motion correlates less (up to 0.9 frames at 0.64),
# so the error has a part that goes with the correlation.
SIGMAS, UNLIKE_SIGMA_FRAMES, LEAST_HALF_WIDTH = 3.0, 0.25, 0.1


@dataclass(frozen=True)
class Lag:
    """By how much one camera's motion trails another's.

    Attributes:
        frames: lag of the best agreement, with a fraction.
        correlation: at that lag, 1 for equal signals.
        margin: how much better that is than the best lag two or more frames away.
        at_edge: the best lag is the largest that was tried, so the true one may be beyond.
    """

    frames: float
    correlation: float
    margin: float
    at_edge: bool


def plane_signals(
    camera: Camera, partner: Camera, energy_camera: Array32, energy_partner: Array32
) -> tuple[Array, Array] | None:
    """Return the motion energy per half-plane and frame as two cameras see it, both (PLANES, T).

    None if they share no plane.

    Args:
        energy_camera: (T, h, w).
        energy_partner: (T, h', w').
    """
    if np.linalg.norm(partner.centre - camera.centre) < 1e-9:
        return None
    angles = plane_angles(camera, partner)
    low = max(np.quantile(angle, RIM_SHARE) for angle in angles)
    high = min(np.quantile(angle, 1 - RIM_SHARE) for angle in angles)
    if not low < high:
        return None
    edges = np.linspace(low, high, PLANES + 1)
    first, second = (
        _per_plane(energy, np.digitize(angle.ravel(), edges))
        for energy, angle in zip((energy_camera, energy_partner), angles, strict=True)
    )
    return first, second


def plane_angles(camera: Camera, partner: Camera) -> tuple[Array, Array]:
    """Angle about the line through both centres of the half-plane that each pixel's ray is in,
    radians, (H, W) each.
    """
    baseline = partner.centre - camera.centre
    baseline /= np.linalg.norm(baseline)
    forward = camera.axis + partner.axis
    forward = forward - baseline * (baseline @ forward)
    # they look along the line, at each other or one behind the other
    if np.linalg.norm(forward) < 1e-6:
        forward = np.cross(baseline, np.eye(3)[np.abs(baseline).argmin()])
    forward /= np.linalg.norm(forward)
    side = np.cross(baseline, forward)
    rays = camera.rays(), partner.rays()
    return np.arctan2(rays[0] @ side, rays[0] @ forward), np.arctan2(
        rays[1] @ side, rays[1] @ forward
    )


def best_lag(first: Array, second: Array, largest: int) -> Lag | None:
    """Return the lag at which second[t + lag] follows first[t] best.

    None where too little happens in either.

    Args:
        first: signals, (P, T).
        largest: lags from -largest to largest are tried.
    """
    lags = np.arange(-largest, largest + 1)
    scores = np.array([_correlation(first, second, int(lag)) for lag in lags])
    if not np.isfinite(scores).all():
        return None
    peak = int(scores.argmax())
    far = scores[np.abs(lags - lags[peak]) >= 2]
    at_edge = peak in (0, len(lags) - 1)
    shift = 0.0 if at_edge else _parabola_peak(*scores[peak - 1 : peak + 2])
    return Lag(
        frames=float(lags[peak] + shift),
        correlation=float(scores[peak]),
        margin=float(scores[peak] - far.max()),
        at_edge=at_edge,
    )


def _per_plane(energy: Array32, planes: NDArray[np.int64]) -> Array:
    """Return the mean energy of the pixels of each plane, (PLANES, T); 0 if a plane has none."""
    count = np.bincount(planes, minlength=PLANES + 2)[1:-1]
    sums = np.stack(
        [np.bincount(planes, frame.ravel(), PLANES + 2)[1:-1] for frame in energy], axis=1
    )
    return np.asarray(sums / np.maximum(count, 1)[:, None])


def _correlation(first: Array, second: Array, lag: int) -> float:
    """Return the correlation over all planes of the frames that overlap at a lag.

    Planes count by how much happens in them.
    """
    frames = first.shape[1]
    first = first[:, max(0, -lag) : frames - max(0, lag)]
    second = second[:, max(0, lag) : frames + min(0, lag)]
    mask = np.isfinite(first).all(axis=0) & np.isfinite(second).all(axis=0)
    if not mask.any():
        return float("nan")
    first, second = first[:, mask], second[:, mask]
    first, second = (signal - signal.mean(axis=1, keepdims=True) for signal in (first, second))
    energy = float((first**2).sum() * (second**2).sum())
    return float((first * second).sum() / np.sqrt(energy)) if energy > 1e-12 else float("nan")


def _parabola_peak(before: float, at: float, after: float) -> float:
    """Locate the maximum of the parabola through three equidistant values, relative to the middle
    one.
    """
    curvature = before - 2 * at + after
    return float(np.clip(0.5 * (before - after) / curvature, -0.5, 0.5)) if curvature < 0 else 0.0


Lags = dict[tuple[int, int], Lag]
Signals = dict[tuple[int, int], tuple[Array, Array]]


def check_timing(
    cameras: Sequence[Camera],
    records: Sequence[CameraRecord],
    doubtful: Collection[int] = (),
    fps: float = 0.0,
) -> tuple[Finding, ...]:
    """Offsets of all cameras from the motion that neighbours see, and frames that one of them lost
    or doubled.

    Args:
        doubtful: indices of cameras whose calibration is wrong, whose motion can be compared with
            no other's.
        fps: frames per second, to say offsets in milliseconds too.

    Returns:
        Of each question one finding for the rig and one for each camera; ``offset_frames`` is
        positive for a camera that is ahead: its frame t shows what the others show at t + offset.
        Of a camera that lost frames it is that at the start.
    """
    reason = _why_not(records) or (
        "the calibration is in doubt, see epipolar error" if len(doubtful) == len(cameras) else ""
    )
    if reason:
        subjects = (RIG, *(camera.name for camera in cameras))
        return tuple(
            Finding(subject=subject, question=question, verdict="unknown", measured=reason)
            for question in (QUESTION, DROPPED)
            for subject in subjects
        )
    signals = pair_signals(cameras, records, doubtful)
    lags = _supported(len(cameras), measure_lags(signals))
    steps = find_steps(len(cameras), signals, lags)
    if any(steps.values()):
        signals = {pair: _in_step(pair, motions, steps) for pair, motions in signals.items()}
        lags = _supported(len(cameras), measure_lags(signals))
    offsets = solve_offsets(len(cameras), lags)
    evaluated, dropped = [], []
    for index, record in enumerate(records):
        own = [lag for pair, lag in lags.items() if index in pair]
        if reason := _unknown(record, index in doubtful, len(cameras), own):
            evaluated.append(
                Finding(subject=record.name, question=QUESTION, verdict="unknown", measured=reason)
            )
            dropped.append(
                Finding(subject=record.name, question=DROPPED, verdict="unknown", measured=reason)
            )
            continue
        evaluated.append(_evaluate(record.name, index, offsets, lags, steps[index]))
        dropped.append(_dropped(record.name, steps[index], timed_frames(records), fps))
    n_known = int(np.isfinite(offsets).sum())
    if not n_known:
        reason = "no motion that neighbours share"
        rig = Finding(
            subject=RIG,
            question=QUESTION,
            verdict="unknown",
            measured=reason,
            values={},
            advice="compare a clap or a flash manually",
        )
        return (
            rig,
            *evaluated,
            Finding(subject=RIG, question=DROPPED, verdict="unknown", measured=reason),
            *dropped,
        )
    spread = float(np.nanmax(np.abs(offsets)))
    extent = f"largest {spread:.2f} frames" + (f" ({1000 * spread / fps:.0f} ms)" if fps else "")
    correlation = float(np.median([lag.correlation for lag in lags.values()]))
    values = {
        "largest_frames": round(spread, 3),
        "n_cameras": n_known,
        "correlation": round(correlation, 3),
    }
    text = f"{extent} among {n_known} cameras, {len(lags)} pairs, correlation {correlation:.2f}"
    n_steps = sum(map(len, steps.values()))
    lost = Finding(
        subject=RIG,
        question=DROPPED,
        verdict="ok",
        measured="none" if not n_steps else f"{n_steps} in the clip",
        values={"n_steps": n_steps},
    )
    return (
        Finding(subject=RIG, question=QUESTION, verdict="ok", measured=text, values=values),
        *evaluated,
        lost,
        *dropped,
    )


def timed_frames(records: Sequence[CameraRecord]) -> list[int]:
    """Return the frames whose motion any camera knows, ascending.

    -1 stands in gaps, so that no lag reaches over one.
    """
    instants = sorted(set().union(*(record.energy for record in records)))
    frames = []
    for before, frame in zip([instants[0] - 1, *instants], instants, strict=False):
        frames += [-1] * min(frame - before - 1, LARGEST_LAG) + [frame]
    return frames


def pair_signals(
    cameras: Sequence[Camera], records: Sequence[CameraRecord], doubtful: Collection[int] = ()
) -> Signals:
    """Motion per half-plane of each pair of neighbours at `timed_frames`, both (PLANES, T).

    NaN of frames that were not read.
    """
    usable = {
        index for index, record in enumerate(records) if len(record.energy) >= FEWEST_FRAMES - 1
    } - set(doubtful)
    frames, frozen = (
        timed_frames(records),
        frozen_frames(np.stack([record.change for record in records])),
    )
    energies, small = {}, {}
    for index in usable:
        shape = next(iter(records[index].energy.values())).shape
        missing = np.full(shape, np.nan, np.float32)
        repeats = np.flatnonzero(frozen[index])
        readable = records[index].energy.keys() - jumps(records[index]) - {*repeats, *(repeats + 1)}
        energies[index] = np.stack(
            [records[index].energy[frame] if frame in readable else missing for frame in frames]
        ).astype(np.float32)
        small[index] = cameras[index].resized(*shape[::-1])
    signals: Signals = {}
    for i, j in neighbour_pairs(cameras):
        if i in usable and j in usable:
            motions = plane_signals(small[i], small[j], energies[i], energies[j])
            if motions is not None:
                signals[i, j] = motions
    return signals


def jumps(record: CameraRecord) -> set[int]:
    """Frames at which the whole picture jumps, so that everything in it seems to move.

    None of a camera that always shakes.
    """
    steps = np.linalg.norm(np.diff(record.shifts_px, axis=0), axis=1)
    instants = np.flatnonzero(steps > JUMP_PX) + 1
    return set(instants.tolist()) if len(instants) < MOST_JUMPS_SHARE * len(steps) else set()


def measure_lags(signals: Signals) -> Lags:
    """Lag of each pair of neighbours whose motion agrees at one lag clearly better than at
    others.
    """
    lags: Lags = {}
    for pair, (first, second) in signals.items():
        lag = best_lag(first, second, min(LARGEST_LAG, first.shape[1] // 3))
        if lag is not None and lag.correlation >= LEAST_CORRELATION and not lag.at_edge:
            lags[pair] = lag
    return lags


def _supported(count: int, lags: Lags) -> Lags:
    """Lags of cameras that enough others confirm.

    One that depends on a single pair confirms no other.
    """
    least = min(FEWEST_PAIRS, count - 1)
    while True:
        counts = {index: sum(index in pair for pair in lags) for index in range(count)}
        supported = {
            pair: lag for pair, lag in lags.items() if min(counts[index] for index in pair) >= least
        }
        if len(supported) == len(lags):
            return lags
        lags = supported


def solve_offsets(count: int, lags: Lags) -> Array:
    """Offset of each camera, frames, median 0, (count,); NaN if no pair determines it."""
    if not lags:
        return np.full(count, np.nan)
    weights = np.array([lag.correlation * max(lag.margin, 0.01) for lag in lags.values()])
    return solve_differences(
        count, list(lags), np.array([lag.frames for lag in lags.values()]), weights
    )


@dataclass(frozen=True)
class Step:
    """Frames that a camera lost or doubled.

    Attributes:
        row: where the signals fit best if its motion is shifted from here on.
        first: the earliest row that fits about as well.
        last: the latest.
        size: frames lost; negative for doubled ones.
    """

    row: int
    first: int
    last: int
    size: int


def find_steps(count: int, signals: Signals, lags: Lags) -> dict[int, list[Step]]:
    """Return the steps of each camera in its offset against its neighbours, ascending in time.

    Reading:
        At each instant a camera's motion is compared with that of every neighbour at every lag.
        Motion changes slowly, and two views of it differ in strength, so only what is quick in it
        is compared. Where frames are lost, more motion shows at once. The step that lowers the sum
        of squared differences most, with what the motion at that frame speaks for it, is taken if
        it does so by more than those of clean rigs; then each side is searched.
    """
    offsets = np.nan_to_num(np.rint(solve_offsets(count, lags))).astype(int)
    steps: dict[int, list[Step]] = {}
    for index in range(count):
        motions = [
            signals[pair] if pair[0] == index else signals[pair][::-1]
            for pair in lags
            if index in pair
        ]
        base = [int(offsets[index] - offsets[sum(pair) - index]) for pair in lags if index in pair]
        costs = [_lag_costs(*motion, lag) for motion, lag in zip(motions, base, strict=True)]
        steps[index] = (
            _steps_of(np.stack(costs), _spikes(motions, base), 0)
            if len(costs) >= min(FEWEST_PAIRS, count - 1)
            else []
        )
    return steps


def _lag_costs(first: Array, second: Array, base: int) -> Array:
    """Return the squared difference of what is quick in two motions, at each instant and change of
    lag, (T, 2 LARGEST_STEP + 1).

    Args:
        first: (P, T).
        base: lag without a change.
    """
    first, second = (_quick(signal) for signal in (first, second))
    return np.stack(
        [
            ((first - _later(second, base + change)) ** 2).mean(axis=0) / 2
            for change in range(-LARGEST_STEP, LARGEST_STEP + 1)
        ],
        axis=1,
    )


def _later(signal: Array, lag: int) -> Array:
    """Return the signal (P, T) of `lag` instants later at each; NaN if there is none."""
    frames = signal.shape[1]
    moved = np.full_like(signal, np.nan)
    begin, end = max(0, -lag), frames - max(0, lag)
    if begin < end:
        moved[:, begin:end] = signal[:, begin + lag : end + lag]
    return moved


def _quick(signal: Array) -> Array:
    """Return a motion (P, T) without its slow part, all planes of about one strength, of mean
    square 1; NaN stays.
    """
    mask = np.isfinite(signal)
    weights = gaussian_filter1d(mask.astype(float), SLOW_FRAMES, axis=1)
    slow = gaussian_filter1d(np.where(mask, signal, 0.0), SLOW_FRAMES, axis=1) / np.maximum(
        weights, 1e-9
    )
    quick = np.where(mask, signal - slow, 0.0)
    strength = np.sqrt((quick**2).mean(axis=1, keepdims=True))
    quick = quick / np.maximum(strength, max(0.3 * float(strength.mean()), 1e-9))
    scale = float(np.sqrt(np.mean(quick[mask] ** 2))) if mask.any() else 0.0
    return np.where(mask, quick / max(scale, 1e-9), np.nan)


def _spikes(motions: Sequence[tuple[Array, Array]], base: Sequence[int]) -> Array:
    """Excess motion of a camera over its neighbours per instant, in standard deviations, (T,).

    0 if unknown.
    """
    camera_motion = np.stack([motion.mean(axis=0) for motion, _ in motions])
    neighbour_motion = np.stack(
        [_later(motion, lag).mean(axis=0) for (_, motion), lag in zip(motions, base, strict=True)]
    )
    neighbour_motion = neighbour_motion / np.maximum(
        np.nanmean(neighbour_motion, axis=1, keepdims=True), 1e-9
    )
    mask = np.isfinite(camera_motion).all(axis=0) & np.isfinite(neighbour_motion).any(axis=0)
    ratio = np.log(np.maximum(camera_motion[:, mask].mean(axis=0), 1e-3)) - np.log(
        np.maximum(np.nanmedian(neighbour_motion[:, mask], axis=0), 1e-2)
    )
    spikes = np.zeros(camera_motion.shape[1])
    if len(ratio):
        spikes[mask] = (ratio - np.median(ratio)) / max(robust_sigma(ratio), LEAST_SPIKE_SIGMA)
    return spikes


def _steps_of(costs: Array, spikes: Array, start: int) -> list[Step]:
    """Return the steps of one camera.

    Args:
        costs: of each neighbour, instant and change of lag, (N, T, L).
        spikes: (T,).
        start: row of the signals that is the first of these.
    """
    mask = np.isfinite(costs)
    counts = mask.sum(axis=0)
    mean = np.where(mask, costs, 0.0).sum(axis=0) / np.maximum(counts, 1)  # (T, L)
    some = (counts[:, LARGEST_STEP - 1 : LARGEST_STEP + 2] > 0).all(
        axis=1
    )  # elsewhere lags next to each other cannot be compared
    if some.sum() <= 2 * LEAST_SIDE:
        return []
    mean = np.where(some[:, None], np.where(counts > 0, mean, mean.max(axis=1, keepdims=True)), 0.0)
    mean = np.minimum(mean, WORST_ROW * np.median(mean[some]))
    unit = max(float(mean[some].min(axis=1).mean()), LEAST_RESIDUAL)
    # (T + 1, L)
    before = np.concatenate([np.zeros((1, mean.shape[1])), np.cumsum(mean, axis=0)]) / unit
    places = np.arange(mean.shape[1])
    sizes = places[None] - places[:, None]
    # (T + 1, L, L): one lag before a row, another from it on
    prices = before[:, :, None] + (before[-1] - before)[:, None, :]
    prices[:-1] -= SPIKE_GAIN * np.where(
        sizes > 0, np.clip(spikes, *SPIKE_RANGE)[:, None, None], 0.0
    )
    prices[:, places, places] = np.inf
    inner = prices[LEAST_SIDE:-LEAST_SIDE]
    row, old_lag, new_lag = (int(value) for value in np.unravel_index(inner.argmin(), inner.shape))
    row += LEAST_SIDE
    if before[-1].min() - prices[row, old_lag, new_lag] < LEAST_GAIN:
        return []
    near = prices[:, old_lag, new_lag] <= prices[row, old_lag, new_lag] + 0.5
    first = last = row
    while first > LEAST_SIDE and near[first - 1]:
        first -= 1
    while last < len(mean) - LEAST_SIDE and near[last + 1]:
        last += 1
    step = Step(row=start + row, first=start + first, last=start + last, size=new_lag - old_lag)
    left, right = (slice(None), slice(row)), (slice(None), slice(row, None))
    return [
        *_steps_of(costs[left], spikes[left[1]], start),
        step,
        *_steps_of(costs[right], spikes[right[1]], start + row),
    ]


def _in_step(
    pair: tuple[int, int], motions: tuple[Array, Array], steps: dict[int, list[Step]]
) -> tuple[Array, Array]:
    """Return the signals of two cameras as they would be had none lost or doubled a frame."""
    mended = []
    for index, signal in zip(pair, motions, strict=True):
        shift, place = np.zeros(signal.shape[1], int), np.arange(signal.shape[1])
        for step in steps[index]:
            shift[step.row :] += step.size
        target = place + shift
        inside = (target >= 0) & (target < len(place))
        moved = np.full_like(signal, np.nan)
        moved[:, target[inside]] = signal[:, place[inside]]
        mended.append(moved)
    return mended[0], mended[1]


def _why_not(records: Sequence[CameraRecord]) -> str:
    longest = max((len(record.energy) for record in records), default=0) + 1
    if len(records) < 2:
        return "one camera alone has no offset"
    if longest < FEWEST_FRAMES:
        return f"{longest} frame{'s' * (longest != 1)}, at least {FEWEST_FRAMES} are needed"
    return ""


def _unknown(
    record: CameraRecord, is_doubtful: bool, n_cameras: int, own_lags: Sequence[Lag]
) -> str:
    """Return the reason why one camera has no result; empty if it has one."""
    if is_doubtful:
        return "its calibration is in doubt, see epipolar error"
    if len(record.energy) < FEWEST_FRAMES - 1:
        return f"{len(record.energy) + 1} frames in a row, at least {FEWEST_FRAMES} are needed"
    return (
        "no motion that enough neighbours see too"
        if len(own_lags) < min(FEWEST_PAIRS, n_cameras - 1)
        else ""
    )


def _evaluate(name: str, index: int, offsets: Array, lags: Lags, steps: Sequence[Step]) -> Finding:
    own_lags = {pair: lag for pair, lag in lags.items() if index in pair}
    offset = float(offsets[index])
    if not np.isfinite(offset):
        return Finding(
            subject=name,
            question=QUESTION,
            verdict="unknown",
            measured="its neighbours share no motion with the rest of the rig",
        )
    residuals = np.array([offsets[i] - offsets[j] - lag.frames for (i, j), lag in own_lags.items()])
    scatter = float(np.median(np.abs(residuals)))
    if scatter > LARGEST_SCATTER_FRAMES:
        return Finding(
            subject=name,
            question=QUESTION,
            verdict="unknown",
            measured=f"its {len(own_lags)} neighbours contradict each other by {scatter:.1f} "
            f"frames",
        )
    correlation = float(np.median([lag.correlation for lag in own_lags.values()]))
    usual = float(
        np.median([abs(offsets[i] - offsets[j] - lag.frames) for (i, j), lag in lags.items()])
    )
    unlike = UNLIKE_SIGMA_FRAMES * np.sqrt(1 - correlation**2) / correlation
    half_width = max(
        SIGMAS * np.hypot(1.4826 * max(scatter, usual) * 1.2533 / np.sqrt(len(own_lags)), unlike),
        LEAST_HALF_WIDTH,
    )
    values = {"offset_frames": round(offset, 3), "half_width_frames": round(half_width, 3)}
    values |= {
        "correlation": round(correlation, 3),
        "n_pairs": len(own_lags),
        "is_constant": not steps,
    }
    size = abs(offset)
    verdict: Verdict = "ok" if size <= half_width else graded(size, WARN_FRAMES, BAD_FRAMES)
    direction = "ahead of" if offset > 0 else "behind"
    text = f"{size:.2f} +- {half_width:.2f} frames {direction} the rig"
    text += (
        f"{' at the start' if steps else ''}, correlation {correlation:.2f} with "
        f"{len(own_lags)} cameras"
    )
    advice = "" if verdict == "ok" else "shot without genlock? drop the camera for fast motion"
    if n_frames := whole_shift(values):
        advice = (
            f"'check --repair' shifts it by {abs(n_frames)} frame{'s' * (abs(n_frames) > 1)}; or "
            "drop it"
        )
    elif verdict == "bad" and steps:
        advice = f"see {DROPPED}: no shift suits the whole clip"
    return Finding(
        subject=name,
        question=QUESTION,
        verdict=verdict,
        measured=text,
        values=values,
        advice=advice,
    )


def whole_shift(values: Mapping[str, Any]) -> int:
    """Return the frames by which a camera can be shifted into step.

    0 if its offset is not certainly beyond half a frame.

    Args:
        values: of a finding on the time offset.
    """
    offset = float(values["offset_frames"])
    is_certain = abs(offset) - values.get("half_width_frames", 0.0) > 0.5 and values.get(
        "is_constant", True
    )
    return round(offset) if is_certain else 0


def _dropped(name: str, steps: Sequence[Step], frames: Sequence[int], fps: float) -> Finding:
    """Return the frames that one camera lost or doubled."""
    if not steps:
        return Finding(
            subject=name, question=DROPPED, verdict="ok", measured="none", values={"steps": []}
        )
    parts, values = [], []
    for step in steps:
        near = [frame for frame in frames[step.first : step.last + 1] if frame >= 0]
        first, last = (near[0], near[-1]) if near else (frames[step.row - 1], frames[step.row])
        count = abs(step.size)
        how = "lost" if step.size > 0 else "doubled"
        parts.append(f"{count} frame{'s' * (count > 1)} {how} {describe_when(first, last, fps)}")
        values.append({"frames": step.size, "first_frame": first, "last_frame": last})
    end = sum(step.size for step in steps)
    if end:
        parts.append(
            f"from there on {abs(end)} frame{'s' * (abs(end) > 1)} "
            f"{'ahead' if end > 0 else 'behind'}"
        )
    advice = (
        "copy or convert this video again; until then evaluate the frames before, or drop "
        "this camera"
    )
    return Finding(
        subject=name,
        question=DROPPED,
        verdict="bad",
        measured="; ".join(parts),
        values={"steps": values},
        advice=advice,
    )
