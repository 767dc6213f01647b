"""The examination of renders: each question in turn, its finding corrected before the next."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn

from ggvs_eval.arrays import Array32, Image8
from ggvs_eval.files.images import mean_of_channels, resize, round_levels
from ggvs_eval.finding import Finding, verdict_of
from ggvs_eval.metrics.image.psnr import psnr
from ggvs_eval.pipelines.inspection.renders.border import find_border
from ggvs_eval.pipelines.inspection.renders.copied import WINDOW, find_copied
from ggvs_eval.pipelines.inspection.renders.flicker import find_flicker
from ggvs_eval.pipelines.inspection.renders.identity import (
    ViewFrames,
    find_identity,
    longest_run,
    middle_of,
    remember,
    spread,
)
from ggvs_eval.pipelines.inspection.renders.placement import find_placement
from ggvs_eval.pipelines.inspection.renders.quick_checks import (
    SAMPLED_FRAMES,
    Scan,
    check_sample,
    find_repeated,
    scan_frames,
)
from ggvs_eval.pipelines.inspection.renders.tone import find_levels
from ggvs_eval.pipelines.inspection.renders.undo import drop_idle, undo_changes
from ggvs_eval.pipelines.inspection.table import WIDTH, findings_table
from ggvs_eval.scoring import FrameReader

QUESTION = "test view seen"
COMPARED = "PSNR"  # whose ceiling was checked
# Of 192 predictions of what perfect renders score none was off by more than 1 dB.
LIKELY_DB, CERTAIN_DB = 1.0, 2.0
INSTANTS = 3  # of a view that are looked at
# of the squared error by levels; planted gains of 1.06 and powers of 1.1 explain 0.1 and more
LEAST_EXPLAINED = 0.05
BLOCK_PX = 8
CROP_PX = 1024


FREQUENCIES = tuple(
    (u, v) for u in range(BLOCK_PX) for v in range(BLOCK_PX) if 0 < u + v < BLOCK_PX
)
# Share of the frequencies that need not show a comb: at high quality the lowest have steps of one
# level, which rounding hides.
UNTOLD_SHARE = 0.6
STEPS = np.arange(2.0, 40.5, 0.5)
# Pictures that never were JPEG had 0.04 at most, quality 95 gives 0.39 and 90 gives 0.5. Quality 98
# cannot be detected.
LIKELY_COMB, CERTAIN_COMB = 0.15, 0.35
FEWEST_BLOCKS = 40


def find_jpeg(name: str, view: ViewFrames) -> list[Finding]:
    """Look for coefficients of 8 x 8 blocks that are multiples of a step on JPEG's grid, and not on
    a grid half a block off.
    """
    combs = [comb_strength(view.rendered(index)) for index in spread(view.frames, INSTANTS)]
    strength = min(comb[0] for comb in combs)
    if strength < LIKELY_COMB:
        return []
    step = float(np.median([comb[1] for comb in combs]))
    text = (
        f"block coefficients come in steps (about {step:g} levels): comb {strength:.2f} on the "
        f"8 x 8 grid, 0 without JPEG"
    )
    verdict = verdict_of(strength > CERTAIN_COMB)
    values = {"comb": strength, "step_255": step}
    return [
        Finding(
            subject=name,
            question="JPEG",
            verdict=verdict,
            measured=text,
            values=values,
            advice="write PNG: JPEG costs decibels, or hides noise and gains some",
        )
    ]


def comb_strength(image: Image8) -> tuple[float, float]:
    """Measure how clearly block coefficients are quantised, 0 to 1, and the median step.

    0 where too few are large enough.
    """
    crop = image[:CROP_PX, :CROP_PX].astype(np.float32)
    luma = crop @ np.array([0.299, 0.587, 0.114], np.float32) - 128
    on, off = (_coefficients(luma[start:, start:]) for start in (0, BLOCK_PX // 2))
    combs = [_comb(on[:, u, v], off[:, u, v]) for u, v in FREQUENCIES]
    known_combs = [comb for comb in combs if comb is not None]
    if not known_combs:
        return 0.0, 0.0
    strength = float(np.quantile([value for value, _ in known_combs], UNTOLD_SHARE))
    return max(strength, 0.0), float(
        np.median([step for value, step in known_combs if value >= strength])
    )


def _coefficients(luma: Array32) -> NDArray[np.float64]:
    """Orthonormal discrete cosine transform of all whole blocks, (blocks, 8, 8)."""
    rows, columns = (size // BLOCK_PX for size in luma.shape)
    blocks = (
        luma[: rows * BLOCK_PX, : columns * BLOCK_PX]
        .reshape(rows, BLOCK_PX, columns, BLOCK_PX)
        .swapaxes(1, 2)
    )
    return np.asarray(
        dctn(blocks.reshape(-1, BLOCK_PX, BLOCK_PX).astype(np.float64), axes=(1, 2), norm="ortho")
    )


def _comb(on: NDArray[np.float64], off: NDArray[np.float64]) -> tuple[float, float] | None:
    """Measure how much better the best step fits on the grid than off it, less its gain the other
    way round by chance.
    """
    differences: list[float] = []
    for step in STEPS:
        # Coefficients that would be rounded to zero fit any large step.
        used_on, used_off = (values[np.abs(values) > 0.5 * step] for values in (on, off))
        if min(len(used_on), len(used_off)) < FEWEST_BLOCKS:
            break
        fits = [float(np.cos(2 * np.pi * values / step).mean()) for values in (used_on, used_off)]
        differences.append(fits[0] - fits[1])
    if not differences:
        return None
    best = int(np.argmax(differences))
    return differences[best] - max(-min(differences), 0.0), float(STEPS[best])


# Period of the traces, px, and the factors that leave them; a rational factor p/q repeats after p
# pixels.
PERIODS_PX = {2.0: "2", 3.0: "3 or 1.5", 4.0: "4 or 1.33", 2.5: "2.5 or 1.67", 5.0: "5 or 1.25"}
# Renders had 2.6 at most, those of networks that interpolate features 16; linear interpolation of
# the picture gives 3.7 to 50, cubic by 2 leaves no period and looks like blur.
LIKELY_PEAK, CERTAIN_PEAK = 4.5, 20.0
# Energy above the smaller picture's finest frequencies relative to the truth's; honest blur also
# lowers it, without a period.
LARGEST_FINE_SHARE = 0.35
# Repeated pixels have edges too, but also peaks of 90 and more.
PLAIN_PEAK = 40.0


def find_upscaling(name: str, view: ViewFrames) -> list[Finding]:
    """Look for periods in the curvature along rows and columns, as interpolation leaves them, where
    fine detail is missing.
    """
    peaks: list[NDArray[np.float64]] = []
    shares: list[float] = []
    for rendered, truth in view.pairs(spread(view.frames, INSTANTS)):
        grey = mean_of_channels(rendered)
        peaks += [_axis_peaks(plane) for plane in (grey, grey.T)]  # the weaker of both axes counts
        shares.append(fine_energy(rendered) / max(fine_energy(truth), 1e-9))
    strengths = np.min(peaks, axis=0)
    period, strength = list(PERIODS_PX)[strengths.argmax()], float(strengths.max())
    share = float(np.median(shares))
    if strength < LIKELY_PEAK or (share > LARGEST_FINE_SHARE and strength < PLAIN_PEAK):
        return []
    verdict = verdict_of(strength > CERTAIN_PEAK)
    text = (
        f"interpolated by {PERIODS_PX[period]}: period of {period:g} px {strength:.0f} times the "
        f"usual, {100 * share:.0f} % of the finest detail is left"
    )
    values = {"period_px": period, "peak": strength, "fine_share": share}
    advice = "enlarged, or of a network that interpolates features? render at the full size"
    return [
        Finding(
            subject=name,
            question="up-scaled",
            verdict=verdict,
            measured=text,
            values=values,
            advice=advice,
        )
    ]


def fine_energy(image: Image8) -> float:
    """Return the mean squared second difference along both axes, mostly of the finest
    frequencies.
    """
    grey = mean_of_channels(image)
    return float(np.mean([np.square(np.diff(grey, 2, axis=axis)).mean() for axis in (0, 1)]))


def _axis_peaks(plane: NDArray[np.float32]) -> NDArray[np.float64]:
    """Peaks in the spectrum of the mean slope or curvature of each column, relative to the usual of
    that spectrum, (periods,).

    Curvature has the period of linear and cubic interpolation, except for a factor of 2, which only
    the slope shows.
    """
    return np.max(
        [_spectrum_peaks(np.abs(np.diff(plane, order, axis=1)).mean(axis=0)) for order in (1, 2)],
        axis=0,
    )


def _spectrum_peaks(profile: NDArray[np.float32]) -> NDArray[np.float64]:
    level = np.log(profile + 0.05)
    # Only what changes within a few pixels; the picture itself changes slowly.
    fine = level - np.convolve(np.pad(level, 4, mode="edge"), np.ones(9) / 9, mode="valid")
    windowed = fine * np.hanning(len(fine))
    usual = float(np.median(np.abs(np.fft.rfft(windowed))[len(fine) // 8 :])) + 1e-9
    waves = np.exp(-2j * np.pi * np.arange(len(fine)) / np.array([*PERIODS_PX])[:, None])
    return np.abs(waves @ windowed) / usual


def examine(
    views: Mapping[str, ViewFrames],
    cameras: Mapping[str, FrameReader] | None = None,
    with_unknown: bool = False,
) -> list[Finding]:
    """Find what went wrong between a method and the folder of its renders.

    An honest rendering, blurred, ghosted, off in colour as it may be, gets no finding: a fault is
    reported only where it explains the pictures better than no fault does, by a margin, at every
    instant looked at.

    Args:
        views: name -> rendered and captured frames.
        cameras: captured frames of further cameras, which a view may be mistaken for; the views'
            own are known.
        with_unknown: also which questions the frames are too small or too few to answer.

    Returns:
        Findings by view, in the order of the views.
    """
    readers = dict(cameras or {}) | {name: view.truth for name, view in views.items()}
    pictures = {name: remember(read) for name, read in readers.items()}
    views = {
        name: replace(
            view, rendered=lru_cache(WINDOW)(view.rendered), truth=lru_cache(WINDOW)(view.truth)
        )
        for name, view in views.items()
    }
    scans: dict[str, Scan] = {}
    comparable: dict[str, ViewFrames] = {}
    for name, view in views.items():
        scans[name] = scan_frames(name, view)
        if usable := longest_run(scans[name].usable):
            comparable[name] = _comparable(view, usable, scans[name])
    on_disk = dict(comparable)
    view_findings: list[Finding] = []
    for name, view in comparable.items():
        of_camera, comparable[name] = find_identity(name, view, pictures)
        view_findings += of_camera
    placed = find_placement(comparable)
    comparable = undo_changes(comparable, placed)
    view_findings += placed
    for name, view in comparable.items():
        of_time, comparable[name] = check_sample(name, view)
        view_findings += of_time
    levels = drop_idle(comparable, find_levels(comparable, SAMPLED_FRAMES), LEAST_EXPLAINED)
    view_findings += levels
    for name, view in undo_changes(comparable, levels).items():
        # Copies among renders of another exposure flicker, too.
        copied = find_copied(name, view)
        is_copied = any(finding.verdict != "unknown" for finding in copied)
        view_findings += copied if is_copied else [*copied, *find_flicker(name, view)]
    view_findings = [
        finding for finding in view_findings if with_unknown or finding.verdict != "unknown"
    ]
    findings: list[Finding] = []
    for name, scan in scans.items():
        of_view = [finding for finding in view_findings if finding.subject == name]
        findings += scan.findings
        if name in on_disk:
            findings += find_repeated(name, views[name], scan, of_view) + of_view
            findings += _find_traces(
                name, on_disk[name], {finding.question for finding in [*of_view, *scan.findings]}
            )
    return findings


def _comparable(view: ViewFrames, usable: range, scan: Scan) -> ViewFrames:
    """Frames that are compared with the truth, at its size."""
    view = replace(view, frames=usable, truth_frames=view.truth_range)
    height, width = view.truth(usable[0]).shape[:2]
    has_size = all(finding.question != "wrong size" for finding in scan.findings)
    return (
        view if has_size else view.with_rendered(lambda image: resize(image, width, height, "area"))
    )


def _find_traces(name: str, view: ViewFrames, questions: Collection[str]) -> list[Finding]:
    """Look for traces in the pixels as they are on disk.

    JPEG has a period, and so have enlarged crops.
    """
    if "wrong size" in questions:
        return []
    periods = find_jpeg(name, view) or (
        [] if "wrong resize" in questions else find_upscaling(name, view)
    )
    return [*find_border(name, view), *periods]


def faults_table(findings: Sequence[Finding]) -> str:
    """Write the findings as text; views with word for word the same finding share a line."""
    return findings_table(findings, WIDTH, ("fault", "view"), most_lines=len(findings))


def find_seen(view: str, psnr_db: float, ceiling_db: float) -> list[Finding]:
    """Compare the PSNR of a view with that of a perfect rendering, which lacks the noise of the
    captured frames.

    A method that was trained on the view, started from it or has it among its sources repeats some
    of that noise.

    Args:
        view: name.
        psnr_db: of its renders, mean over the frames.
        ceiling_db: of the scene without noise, an estimate or an upper bound, see
            `ggvs_eval.metrics.ceilings`.

    Examples:
        >>> [find_seen("cam00", psnr, 37.0)[0].verdict for psnr in (38.5, 40.0)]
        ['likely', 'certain']
    """
    beyond_db = psnr_db - ceiling_db
    if not beyond_db > LIKELY_DB:
        return []
    text = (
        f"PSNR {psnr_db:.1f} dB, above the ceiling of a perfect rendering without noise and "
        f"codec, {ceiling_db:.1f} dB"
    )
    advice = (
        "was the method trained on, fitted to or initialised by this view? hold it out there too"
    )
    values = {"psnr_db": psnr_db, "ceiling_db": ceiling_db}
    return [
        Finding(
            subject=view,
            question=QUESTION,
            verdict=verdict_of(beyond_db > CERTAIN_DB),
            measured=text,
            values=values,
            advice=advice,
        )
    ]


def explain_loss(views: Mapping[str, ViewFrames]) -> str:
    """State that no fault was found, and whether the PSNR is one that needs none.

    Args:
        views: name -> rendered and captured frames without a finding, of which some in a row are
            read.

    Returns:
        A sentence that has the PSNR and, where they are above it, that of the captured frames an
        instant late, or of their mean colour.

    Reading:
        In a scene that moves slowly an honest rendering has less than the frame before (28.8 and
        37.1 dB in a demo room): that is said and is no reproach. Less than a picture of one colour
        has no honest rendering.
    """
    psnrs_db: list[tuple[float, ...]] = []
    for view in views.values():
        frames = middle_of(view.frames, SAMPLED_FRAMES)
        for index in frames[1:] or frames:
            truth = view.truth(index)
            flat = np.broadcast_to(round_levels(truth.mean(axis=(0, 1))), truth.shape)
            late = view.truth(index - 1) if index > frames.start else flat
            psnrs_db.append(
                tuple(psnr(picture, truth) for picture in (view.rendered(index), late, flat))
            )
    psnr_db, late_db, flat_db = np.mean(psnrs_db, axis=0)
    if psnr_db > max(late_db, flat_db):
        return f"no known fault found; PSNR {psnr_db:.2f} dB"
    if psnr_db > flat_db:
        return (
            f"no known fault found; PSNR {psnr_db:.2f} dB, less than captured frames one "
            f"instant late have ({late_db:.2f} dB)"
        )
    return (
        f"no known fault explains the PSNR of {psnr_db:.2f} dB; a picture of the mean colour "
        f"has {flat_db:.2f} dB"
    )
