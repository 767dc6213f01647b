"""Colours of each camera over time: drift against the rig, as of automatic exposure and white
balance, and flicker.

Two cameras see the same surfaces under the same lamps. How the ratio of their colours changes is
the cameras' doing, however lamps fade; what all share is the lamps'.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.ndimage import median_filter

from ggvs_eval.arrays import Array
from ggvs_eval.finding import RIG, Finding, Verdict
from ggvs_eval.geometry.epipolar import MatchedPair
from ggvs_eval.pipelines.inspection.capture.colour import (
    CHANNELS,
    DRIFT,
    FEWEST_COLOURS,
    SIGMAS,
    brightness_and_casts,
    is_usable,
    median_and_error,
)
from ggvs_eval.pipelines.inspection.capture.pairs import solve_with_errors
from ggvs_eval.pipelines.inspection.capture.records import CameraRecord, robust_sigma
from ggvs_eval.pipelines.inspection.capture.stillness import BEGUN, DONE, describe_when

QUESTION = DRIFT
# As for constant gains: just visible at a seam; no constant divides a tenth away.
WARN_DRIFT, BAD_DRIFT = 0.04, 0.10
# From frame to frame, of the brightness; automatic exposure and people who pass change it more
# slowly.
WARN_FLICKER, ODD_FACTOR = 0.01, 2.0
ADVICE = (
    "lock exposure and white balance; score with a colour-corrected metric, or drop this camera"
)


def check_drift(
    names: Sequence[str],
    records: Sequence[CameraRecord],
    pairs: Sequence[MatchedPair],
    fps: float = 0.0,
) -> tuple[Finding, ...]:
    """Return the change of each camera's gains against the rig within the clip.

    Args:
        pairs: matches of the first frames.
        fps: frames per second, to give times in seconds too.
    """
    frames, logs, errors = gains_over_time(records, pairs)
    if len(frames) < 2 or not np.isfinite(logs).any():
        reason = (
            "fewer than two frames"
            if len(frames) < 2
            else "too few matches of medium brightness between neighbours"
        )
        return tuple(
            Finding(subject=subject, question=QUESTION, verdict="unknown", measured=reason)
            for subject in (RIG, *names)
        )
    # logarithms; flicker is what changes from frame to frame and back
    levels = [record.levels for record in records]
    flicker = np.array(
        [
            robust_sigma(np.diff(level, 2)) / np.sqrt(6) if len(level) > 2 else np.nan
            for level in levels
        ]
    )
    usual = float(np.nanmedian(flicker)) if np.isfinite(flicker).any() else float("nan")
    evaluated = [
        _evaluate(name, frames, logs[:, index], errors[:, index], float(flicker[index]), usual, fps)
        for index, name in enumerate(names)
    ]
    drifts = [finding.values["drift"] for finding in evaluated if "drift" in finding.values]
    lamps = float(
        np.nanmedian(
            [
                np.ptp(record.levels[np.isfinite(record.levels)])
                for record in records
                if np.isfinite(record.levels).any()
            ]
        )
    )
    text = (
        f"median drift {100 * np.median(drifts):.1f} %, largest {100 * max(drifts):.1f} % "
        f"against the rig; "
    )
    text += (
        f"brightness of all changes by {100 * lamps:.0f} %, {100 * usual:.1f} % from frame to frame"
    )
    values = {
        "largest_drift": max(drifts),
        "common_change": round(lamps, 4),
        "flicker": round(usual, 4),
    }
    if usual > WARN_FLICKER:
        advice = (
            "lamps or shutters flicker in all cameras: match the shutter to the mains (1/50 "
            "or 1/60 s), or use steady lamps"
        )
        return (
            Finding(
                subject=RIG,
                question=QUESTION,
                verdict="warn",
                measured=text,
                values=values,
                advice=advice,
            ),
            *evaluated,
        )
    return (
        Finding(subject=RIG, question=QUESTION, verdict="ok", measured=text, values=values),
        *evaluated,
    )


def gains_over_time(
    records: Sequence[CameraRecord], pairs: Sequence[MatchedPair]
) -> tuple[list[int], Array, Array]:
    """Return the change of the cameras' gains since the first frame, logarithms: brightness and
    casts, and their standard errors.

    Returns:
        Frames, those of which all cameras have colours, (S,); changes, median 0 over the rig, and
        errors, (S, N, 4).
    """
    frames = (
        sorted(set.intersection(*(set(record.sampled) for record in records))) if records else []
    )
    count = len(records)
    logs, errors = (
        np.full((len(frames), count, 4), np.nan),
        np.full((len(frames), count, 4), np.inf),
    )
    if not frames:
        return frames, logs, errors
    colours = [record.colours[np.searchsorted(record.sampled, frames)] for record in records]
    first = [record.instants[0].uv if 0 in record.instants else () for record in records]
    rows = [{tuple(at): row for row, at in enumerate(places)} for places in first]
    matched, middles, sigmas = [], [], []
    for pair in pairs:
        pair_colours = [
            # (S, M, 3)
            colours[camera][:, [rows[camera][tuple(at)] for at in uv]].astype(np.float64)
            for camera, uv in ((pair.first, pair.uv_first), (pair.second, pair.uv_second))
        ]
        usable = is_usable(pair_colours[0]) & is_usable(pair_colours[1])  # (S, M)
        ratio = np.where(
            usable[..., None],
            np.log(np.maximum(pair_colours[0], 1) / np.maximum(pair_colours[1], 1)),
            np.nan,
        )
        mask = usable & usable[:1]
        if mask.sum(axis=1).min() < FEWEST_COLOURS:
            continue
        change = brightness_and_casts(ratio - ratio[:1])[:, usable[0]]  # (S, M', 4)
        middle, sigma = median_and_error(change.swapaxes(0, 1))
        matched.append((pair.first, pair.second))
        middles.append(middle)
        sigmas.append(sigma)
    for place in range(len(frames) if matched else 0):
        for part in range(4):
            differences, spread = (
                np.array([values[place, part] for values in table]) for table in (middles, sigmas)
            )
            logs[place, :, part], errors[place, :, part] = solve_with_errors(
                count, matched, differences, spread
            )
    return frames, logs, errors


def _evaluate(
    name: str,
    frames: Sequence[int],
    logs: Array,
    errors: Array,
    flicker: float,
    usual: float,
    fps: float,
) -> Finding:
    """Return one camera's changes (S, 4)."""
    if not np.isfinite(logs).all():
        return Finding(
            subject=name,
            question=QUESTION,
            verdict="unknown",
            measured="too few matches of medium brightness with any neighbour",
        )
    series = median_filter(logs, size=(min(3, len(logs)), 1), mode="nearest")
    ranges = np.ptp(series, axis=0)
    half_widths = SIGMAS * np.sqrt(2) * np.median(errors, axis=0)
    part = int(np.where(ranges > half_widths, ranges, 0.0).argmax())
    size, half_width = float(ranges[part]), float(half_widths[part])
    values: dict[str, Any] = {
        "drift": round(size, 4),
        "half_width": round(half_width, 4),
        "flicker": round(flicker, 4),
    }
    is_odd = flicker > max(ODD_FACTOR * usual, WARN_FLICKER)
    if size <= max(WARN_DRIFT, half_width) and not is_odd:
        return Finding(
            subject=name,
            question=QUESTION,
            verdict="ok",
            measured=f"{100 * size:.1f} +- {100 * half_width:.1f} %",
            values=values,
        )
    if size <= max(WARN_DRIFT, half_width):
        text = (
            f"brightness pulses by {100 * flicker:.1f} % from frame to frame, the rig's by "
            f"{100 * usual:.1f} %"
        )
        return Finding(
            subject=name,
            question=QUESTION,
            verdict="warn",
            measured=text,
            values=values,
            advice=ADVICE,
        )
    verdict: Verdict = "bad" if size > BAD_DRIFT else "warn"
    course = series[:, part]
    low, high = int(course.argmin()), int(course.argmax())
    begin, end = min(low, high), max(low, high)
    progress = np.abs(course[begin : end + 1] - course[begin]) / size
    first, last = (
        begin + int(np.flatnonzero(progress <= BEGUN)[-1]),
        begin + int(np.flatnonzero(progress >= DONE)[0]),
    )
    grows = high > low
    direction = (
        ("brighter" if grows else "darker")
        if part == 0
        else f"{'more' if grows else 'less'} {CHANNELS[part - 1]}"
    )
    values |= {
        "first_frame": frames[min(first, last)],
        "last_frame": frames[last],
        "part": ("brightness", *CHANNELS)[part],
    }
    values["change"] = round(size if grows else -size, 4)
    when = describe_when(values["first_frame"], values["last_frame"], fps)
    text = (
        f"{direction} by {100 * np.expm1(size):.1f} +- {100 * half_width:.1f} % {when} against "
        f"the rig"
    )
    return Finding(
        subject=name,
        question=QUESTION,
        verdict=verdict,
        measured=text,
        values=values,
        advice=ADVICE,
    )
