"""Colour gain and noise of each camera against the rig; what timing and colour make of it becomes corrections."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.datasets.corrections import (
    Correction,
    corrections_file,
    describe_corrections,
    read_corrections,
    write_corrections,
)
from ggvs_eval.geometry.epipolar import MatchedPair
from ggvs_eval.pipelines.inspection.capture import timing
from ggvs_eval.pipelines.inspection.capture.frames import CameraRecord
from ggvs_eval.pipelines.inspection.capture.pairs import solve_differences
from ggvs_eval.pipelines.inspection.finding import RIG, Finding, graded

GAIN, NOISE = "colour gain", "noise"
# 4 % is just visible at a seam. Published captures differ by up to 19 % (flame_steak), which costs every method alike; at 25 % no
# method can reach 20 dB of PSNR in mid grey, and something is wrong with the export.
WARN_GAIN, BAD_GAIN = 0.04, 0.25
# Outside, clipping and black levels make a gain look smaller than it is.
DARKEST, BRIGHTEST = 20.0, 235.0
FEWEST_COLOURS = 15
# Above 5 levels PSNR against a perfect image is below 34 dB; twice the rig's own noise points at one sensor.
WARN_SIGMA, BAD_SIGMA, ODD_FACTOR, LEAST_ODD_SIGMA = 5.0, 12.0, 2.0, 2.0
CHANNELS = ("red", "green", "blue")


def check_gain(names: Sequence[str], pairs: Sequence[MatchedPair]) -> tuple[Finding, ...]:
    """Gain per channel of every camera, median 1 over the rig, from the colours of matched features."""
    gains = camera_gains(len(names), pairs)
    finite = np.isfinite(gains).all(axis=1)
    evaluated = [_evaluate_gain(name, gain) for name, gain in zip(names, gains, strict=True)]
    if not finite.any():
        reason = "too few matches of medium brightness between neighbours"
        return (Finding(RIG, GAIN, "unknown", reason), *evaluated)
    spread = np.abs(gains[finite] - 1)
    measured = f"median deviation {100 * np.median(spread):.1f} %, largest {100 * spread.max():.1f} %, {finite.sum()} cameras"
    values = {"median_deviation": round(float(np.median(spread)), 4), "largest_deviation": round(float(spread.max()), 4)}
    return (Finding(RIG, GAIN, "ok", measured, values), *evaluated)


def camera_gains(count: int, pairs: Sequence[MatchedPair]) -> Array:
    """Factor on the sRGB values of each camera and channel, median 1 per channel, (count, 3); NaN where unknown."""
    logs, weights, measured = [], [], []
    for pair in pairs:
        first, second = pair.colours_first.astype(np.float64), pair.colours_second.astype(np.float64)
        usable = ((np.minimum(first, second) > DARKEST) & (np.maximum(first, second) < BRIGHTEST)).all(axis=1)
        if usable.sum() >= FEWEST_COLOURS:
            ratio = np.log(first[usable] / second[usable])  # (M, 3)
            logs.append(np.median(ratio, axis=0))
            weights.append(np.sqrt(usable.sum()))
            measured.append((pair.first, pair.second))
    if not measured:
        return np.full((count, 3), np.nan)
    columns = [solve_differences(count, measured, column, np.array(weights)) for column in np.array(logs).T]
    return np.asarray(np.exp(np.stack(columns, axis=1)))


def check_noise(records: Sequence[CameraRecord]) -> tuple[Finding, ...]:
    """Noise of every camera against fixed limits and against the rig."""
    sigmas = np.array([record.noise_sigma_255 for record in records])
    finite = sigmas[np.isfinite(sigmas)]
    if not len(finite):
        reason = "fewer than two frames in a row"
        return tuple(Finding(subject, NOISE, "unknown", reason) for subject in (RIG, *(record.name for record in records)))
    median = float(np.median(finite))
    rig = Finding(RIG, NOISE, "ok", f"sigma {median:.2f} of 255 levels, median", {"sigma_255": round(median, 3)})
    return (rig, *(_evaluate_noise(record.name, float(record.noise_sigma_255), median) for record in records))


def _evaluate_gain(name: str, gain: Array) -> Finding:
    if not np.isfinite(gain).all():
        return Finding(name, GAIN, "unknown", "too few matches of medium brightness with any neighbour")
    verdict = graded(float(np.abs(gain - 1).max()), WARN_GAIN, BAD_GAIN)
    measured = ", ".join(f"{channel} x {value:.3f}" for channel, value in zip(CHANNELS, gain, strict=True))
    advice = "" if verdict == "ok" else "'check --repair' divides its frames by these gains; or use a colour-corrected metric"
    return Finding(name, GAIN, verdict, measured, {"gain": [round(float(value), 4) for value in gain]}, advice)


def _evaluate_noise(name: str, sigma: float, median: float) -> Finding:
    if not np.isfinite(sigma):
        return Finding(name, NOISE, "unknown", "fewer than two frames in a row")
    verdict = graded(sigma, WARN_SIGMA, BAD_SIGMA)
    is_odd = sigma > max(ODD_FACTOR * median, LEAST_ODD_SIGMA)
    if verdict == "ok" and is_odd:
        verdict = "warn"
    advice = "" if verdict == "ok" else "check this camera's gain (ISO) and bit rate; PSNR against it is limited by its noise"
    return Finding(name, NOISE, verdict, f"sigma {sigma:.2f} of 255 levels", {"sigma_255": round(sigma, 3)}, advice)


def propose_corrections(findings: Iterable[Finding], present: Mapping[str, Correction]) -> dict[str, Correction]:
    """Corrections of the cameras that were found to be out of step by whole frames, or brighter or darker than the rig.

    Args:
        present: corrections under which they were found; what is found is added to them.

    Returns:
        All corrections, by camera; `present` where there is nothing to add.

    Reading:
        Half a frame and less cannot be mended by a shift. Gains below the threshold of the check are left alone: they are hardly
        measured better.
    """
    corrections = dict(present)
    for finding in findings:
        if finding.subject == RIG or finding.verdict not in ("warn", "bad"):
            continue
        before = corrections.get(finding.subject, Correction(finding.subject))
        if finding.question == timing.QUESTION and round(finding.values["offset_frames"]):
            total = before.offset_frames + round(finding.values["offset_frames"])
            corrections[finding.subject] = replace(before, offset_frames=total)
        elif finding.question == GAIN:
            gain = tuple(round(old * new, 4) for old, new in zip(before.gain, finding.values["gain"], strict=True))
            corrections[finding.subject] = replace(before, gain=gain)
    return corrections


def repair_capture(path: Path, findings: Iterable[Finding]) -> str:
    """Write what was found into the capture's ``corrections.toml``.

    Returns:
        The file and what it says now; empty where there was nothing to add, and the file is as it was.
    """
    file = corrections_file(path)
    present = read_corrections(file)
    corrections = propose_corrections(findings, present)
    if corrections == present:
        return ""
    write_corrections(file, corrections)
    return f"{file}: {describe_corrections(corrections)}"
