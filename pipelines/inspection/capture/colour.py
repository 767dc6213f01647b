"""Colour gain and noise of each camera against the rig.

What timing and colour make of it becomes corrections.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array
from ggvs_eval.datasets.corrections import (
    Correction,
    corrections_file,
    describe_corrections,
    read_corrections,
    write_corrections,
)
from ggvs_eval.finding import RIG, Finding, graded
from ggvs_eval.geometry.epipolar import MatchedPair
from ggvs_eval.pipelines.inspection.capture import timing
from ggvs_eval.pipelines.inspection.capture.pairs import solve_with_errors
from ggvs_eval.pipelines.inspection.capture.records import CameraRecord

GAIN, DRIFT, NOISE = "colour gain", "colour over time", "noise"
# 4 % is just visible at a seam. Published captures differ by up to 19 % (flame_steak), which costs
# every method alike; at 25 % no method can reach 20 dB of PSNR in mid grey, and something is wrong
# with the export.
WARN_GAIN, BAD_GAIN = 0.04, 0.25
# Outside, clipping and black levels make a gain look smaller than it is.
DARKEST, BRIGHTEST = 20.0, 235.0
FEWEST_COLOURS = 15
# Half widths of intervals, in standard errors; the codec's effect on a median of colours is not
# known better.
SIGMAS, LEAST_SIGMA = 3.0, 0.001
PARTS_PER_SIDE, FEWEST_IN_PART, FEWEST_PARTS = 4, 3, 4
# Above 5 levels PSNR against a perfect image is below 34 dB; twice the rig's own noise points at
# one sensor.
WARN_SIGMA, BAD_SIGMA, ODD_FACTOR, LEAST_ODD_SIGMA = 5.0, 12.0, 2.0, 2.0
CHANNELS = ("red", "green", "blue")


@dataclass(frozen=True, eq=False)
class Gains:
    """Gains of all cameras with their errors.

    Attributes:
        log: logarithm of the factor on the sRGB values, median 0 over the rig: brightness, the mean
            of the channels, and what red, green and blue have beyond it, (N, 4); NaN where unknown.
        error: standard error of each, (N, 4).
    """

    log: Array
    error: Array

    @property
    def factors(self) -> Array:
        """Factor on red, green and blue as measured, (N, 3)."""
        return np.asarray(np.exp(self.log[:, :1] + self.log[:, 1:]))

    @property
    def half_widths(self) -> Array:
        """Half width of the interval of each factor, relative, (N, 3)."""
        return SIGMAS * np.hypot(self.error[:, :1], self.error[:, 1:])

    @property
    def certain(self) -> Array:
        """Factors without those parts whose interval holds 0, (N, 3)."""
        log = np.where(np.abs(self.log) > SIGMAS * self.error, self.log, 0.0)
        return np.asarray(
            np.where(np.isfinite(self.factors), np.exp(log[:, :1] + log[:, 1:]), np.nan)
        )


def check_gain(names: Sequence[str], pairs: Sequence[MatchedPair]) -> tuple[Finding, ...]:
    """Gain per channel of every camera, median 1 over the rig, from the colours of matched features
    at any instants.
    """
    gains = camera_gains(len(names), pairs)
    finite = np.isfinite(gains.factors).all(axis=1)
    evaluated = [
        _evaluate_gain(name, *gain)
        for name, *gain in zip(names, gains.factors, gains.half_widths, gains.certain, strict=True)
    ]
    if not finite.any():
        reason = "too few matches of medium brightness between neighbours"
        return (Finding(subject=RIG, question=GAIN, verdict="unknown", measured=reason), *evaluated)
    spread, width = np.abs(gains.factors[finite] - 1), float(np.median(gains.half_widths[finite]))
    text = (
        f"median deviation {100 * np.median(spread):.1f} %, largest {100 * spread.max():.1f} %, "
        f"{finite.sum()} cameras"
    )
    text += f", known within {100 * width:.1f} %"
    values = {
        "median_deviation": round(float(np.median(spread)), 4),
        "largest_deviation": round(float(spread.max()), 4),
    }
    return (
        Finding(
            subject=RIG,
            question=GAIN,
            verdict="ok",
            measured=text,
            values=values | {"half_width": round(width, 4)},
        ),
        *evaluated,
    )


def camera_gains(count: int, pairs: Sequence[MatchedPair]) -> Gains:
    """Return the gains of all cameras.

    Args:
        pairs: of two cameras as often as there are instants at which they were matched.

    Reading:
        Features on one surface share what it reflects to either side, so they are not independent:
        the error of a pair is at least that of the medians of the picture's parts. Matches at
        several instants are mostly of the same surfaces: their medians are averaged, but their
        error is as of one.
    """
    logs: dict[tuple[int, int], list[Array]] = {}
    sigmas: dict[tuple[int, int], list[Array]] = {}
    for pair in pairs:
        first, second = (
            pair.colours_first.astype(np.float64),
            pair.colours_second.astype(np.float64),
        )
        usable = is_usable(first) & is_usable(second)
        if usable.sum() >= FEWEST_COLOURS:
            parts = brightness_and_casts(np.log(first[usable] / second[usable]))  # (M, 4)
            middle, sigma = median_and_error(parts)
            sigma = np.maximum(
                sigma, [surface_error(parts, uv[usable]) for uv in (pair.uv_first, pair.uv_second)]
            ).max(axis=0)
            logs.setdefault((pair.first, pair.second), []).append(middle)
            sigmas.setdefault((pair.first, pair.second), []).append(sigma)
    solved = np.full((count, 4), np.nan), np.full((count, 4), np.inf)
    if logs:
        matched = list(logs)
        differences, errors = (
            np.array([np.mean(table[pair], axis=0) for pair in matched]) for table in (logs, sigmas)
        )
        for part in range(4):
            solved[0][:, part], solved[1][:, part] = solve_with_errors(
                count, matched, differences[:, part], errors[:, part]
            )
    return Gains(*solved)


def surface_error(values: Array, uv: Array) -> Array:
    """Return the standard error of the median of (M, n) values by how it differs between parts of
    the picture, (n,).
    """
    low, high = uv.min(axis=0), uv.max(axis=0)
    column, row = (
        np.minimum((uv - low) / np.maximum(high - low, 1e-9) * PARTS_PER_SIDE, PARTS_PER_SIDE - 1)
        .astype(int)
        .T
    )
    part = row * PARTS_PER_SIDE + column
    numbers = [number for number in np.unique(part) if (part == number).sum() >= FEWEST_IN_PART]
    if len(numbers) < FEWEST_PARTS:  # all of one surface
        return np.asarray(1.4826 * np.median(np.abs(values - np.median(values, axis=0)), axis=0))
    return median_and_error(
        np.array([np.median(values[part == number], axis=0) for number in numbers])
    )[1]


def is_usable(colours: Array) -> NDArray[np.bool_]:
    """Return the mask of colours (..., 3) that are neither dark nor clipped in any channel."""
    return np.asarray(((colours > DARKEST) & (colours < BRIGHTEST)).all(axis=-1))


def brightness_and_casts(logs: Array) -> Array:
    """Return the mean of the channels (..., 3), and what each has beyond it, (..., 4)."""
    mean = logs.mean(axis=-1, keepdims=True)
    return np.concatenate([mean, logs - mean], axis=-1)


def median_and_error(values: Array) -> tuple[Array, Array]:
    """Return the median over the first axis, NaN left out, and its standard error."""
    middle = np.nanmedian(values, axis=0)
    spread = 1.4826 * np.nanmedian(np.abs(values - middle), axis=0)
    count = np.maximum(np.isfinite(values).sum(axis=0), 1)
    return middle, np.maximum(1.2533 * spread / np.sqrt(count), LEAST_SIGMA)


def check_noise(records: Sequence[CameraRecord]) -> tuple[Finding, ...]:
    """Return the noise of every camera against fixed limits and against the rig."""
    sigmas = np.array([record.noise_sigma_255 for record in records])
    finite = sigmas[np.isfinite(sigmas)]
    if not len(finite):
        reason = "fewer than two frames in a row"
        return tuple(
            Finding(subject=subject, question=NOISE, verdict="unknown", measured=reason)
            for subject in (RIG, *(record.name for record in records))
        )
    median = float(np.median(finite))
    rig = Finding(
        subject=RIG,
        question=NOISE,
        verdict="ok",
        measured=f"sigma {median:.2f} of 255 levels, median",
        values={"sigma_255": round(median, 3)},
    )
    return (
        rig,
        *(
            _evaluate_noise(record.name, float(record.noise_sigma_255), median)
            for record in records
        ),
    )


def _evaluate_gain(name: str, factors: Array, half_widths: Array, certain: Array) -> Finding:
    if not np.isfinite(factors).all():
        return Finding(
            subject=name,
            question=GAIN,
            verdict="unknown",
            measured="too few matches of medium brightness with any neighbour",
        )
    verdict = graded(float(np.abs(certain - 1).max()), WARN_GAIN, BAD_GAIN)
    text = ", ".join(
        f"{channel} x {value:.3f}" for channel, value in zip(CHANNELS, factors, strict=True)
    )
    text += f" (+- {100 * float(half_widths.max()):.1f} %)"
    parts = {"gain": certain, "measured_gain": factors, "half_width": half_widths}
    values = {name: part.round(4).tolist() for name, part in parts.items()}
    advice = (
        ""
        if verdict == "ok"
        else "'check --repair' divides its frames by these gains; or use a colour-corrected metric"
    )
    return Finding(
        subject=name, question=GAIN, verdict=verdict, measured=text, values=values, advice=advice
    )


def _evaluate_noise(name: str, sigma: float, median: float) -> Finding:
    if not np.isfinite(sigma):
        return Finding(
            subject=name,
            question=NOISE,
            verdict="unknown",
            measured="fewer than two frames in a row",
        )
    verdict = graded(sigma, WARN_SIGMA, BAD_SIGMA)
    is_odd = sigma > max(ODD_FACTOR * median, LEAST_ODD_SIGMA)
    if verdict == "ok" and is_odd:
        verdict = "warn"
    advice = (
        ""
        if verdict == "ok"
        else "check this camera's gain (ISO) and bit rate; PSNR against it is limited by its noise"
    )
    return Finding(
        subject=name,
        question=NOISE,
        verdict=verdict,
        measured=f"sigma {sigma:.2f} of 255 levels",
        values={"sigma_255": round(sigma, 3)},
        advice=advice,
    )


def propose_corrections(
    findings: Iterable[Finding], present: Mapping[str, Correction]
) -> dict[str, Correction]:
    """Corrections of the cameras that were found to be out of step by whole frames, or brighter or
    darker than the rig.

    Args:
        present: corrections under which they were found; what is found is added to them.

    Returns:
        All corrections, by camera; `present` if there is nothing to add.

    Reading:
        Half a frame and less cannot be corrected by a shift, nor can an offset that changes within
        the clip. Of gains only those parts are written whose interval excludes 1, and none of a
        camera that the check does not warn of, or whose gain drifts.
    """
    corrections, findings = dict(present), list(findings)
    drifting = {
        finding.subject
        for finding in findings
        if finding.question == DRIFT and finding.verdict in ("warn", "bad")
    }
    for finding in findings:
        if finding.subject == RIG or finding.verdict not in ("warn", "bad"):
            continue
        before = corrections.get(finding.subject, Correction(finding.subject))
        if finding.question == timing.QUESTION and timing.whole_shift(finding.values):
            total = before.offset_frames + timing.whole_shift(finding.values)
            corrections[finding.subject] = replace(before, offset_frames=total)
        elif finding.question == GAIN and finding.subject not in drifting:
            gain = tuple(
                round(old * new, 4)
                for old, new in zip(before.gain, finding.values["gain"], strict=True)
            )
            corrections[finding.subject] = replace(before, gain=gain)
    return corrections


def repair_capture(path: Path, findings: Iterable[Finding]) -> str:
    """Write what was found into the capture's ``corrections.toml``.

    Returns:
        The file and what it says now; empty if there was nothing to add, and the file is as it was.
    """
    file = corrections_file(path)
    present = read_corrections(file)
    corrections = propose_corrections(findings, present)
    if corrections == present:
        return ""
    write_corrections(file, corrections)
    return f"{file}: {describe_corrections(corrections)}"


def describe_repair(before: Iterable[Finding], after: Iterable[Finding]) -> list[str]:
    """Return one line for each offset and gain that a repair changed: what the check said before
    it, and what it says after.
    """
    latest = {(finding.subject, finding.question): finding for finding in after}
    return [
        f"{old.subject} {old.question}: {old.measured} -> "
        f"{latest[old.subject, old.question].measured}"
        for old in before
        if old.subject != RIG
        and old.verdict in ("warn", "bad")
        and old.question in (timing.QUESTION, GAIN)
        if (old.subject, old.question) in latest
        and latest[old.subject, old.question].measured != old.measured
    ]
