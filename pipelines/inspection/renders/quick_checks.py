"""Quick checks of every scoring, on a burst of frames next to the captured ones.

`examine` has all checks.

Channels in another order, rendered frames that show other instants than the captured ones (earlier,
later or reversed), and every rendered frame once, as a stream: of another size, blank, or a
repetition of the one before.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import permutations

import cv2
import numpy as np

from ggvs_eval.arrays import Array, Array32, Image8
from ggvs_eval.coverage import guessed_first
from ggvs_eval.files.images import mean_of_channels, round_levels
from ggvs_eval.finding import Finding, verdict_of
from ggvs_eval.pipelines.inspection.renders.border import find_border
from ggvs_eval.pipelines.inspection.renders.copied import find_copied
from ggvs_eval.pipelines.inspection.renders.flicker import find_flicker
from ggvs_eval.pipelines.inspection.renders.identity import (
    LARGEST_OFFSET,
    Sample,
    ViewFrames,
    find_identity,
    longest_run,
    middle_of,
    named_frames,
    remember,
    shrink,
    take_sample,
)
from ggvs_eval.pipelines.inspection.renders.placement import find_placement
from ggvs_eval.pipelines.inspection.renders.tone import find_tone
from ggvs_eval.pipelines.inspection.renders.undo import undo_changes
from ggvs_eval.run_folder import as_ranges
from ggvs_eval.scoring import FrameCheck, FrameReader, ScoredMethod
from ggvs_eval.transforms import order_name, reordered

OFFSET = "frame offset"
FEWEST_FRAMES = 4
# Motion left unexplained, 1 - correlation^2, relative to no offset on the same frames. Honest
# renders of 18 to 30 dB had 1.09 and more at every lag, and a frame's offset 0.92 at most, however
# slow the motion.
CERTAIN_RATIO, LIKELY_RATIO = 0.88, 0.96
# Standard errors of its logarithm, by the scatter of the squares of a picture: of 450 honest clips
# of 64 to 240 columns none was below -1.4.
CERTAIN_DEVIATIONS, LIKELY_DEVIATIONS, SQUARE_PX = -3.0, -2.0, 12
LEAST_CORRELATION = 0.45
CELLS = 16
# Contrast (standard deviation of 255 levels) of a frame without a picture, where the truth has one.
BLANK_CONTRAST, LEAST_CONTRAST = 1.5, 8.0
# Change of the cell that changes most: a repeated frame has hardly any, although the truth has its
# usual one.
STILL_SHARE, STILL_255 = 0.1, 0.5
MOVING_SHARE, MOVING_OVER_NOISE, MOVING_255 = 0.3, 3.0, 4.0
# Squared error of the hue (channels less their mean) relative to that of the order as it is.
CERTAIN_ORDER, LIKELY_ORDER = 0.5, 0.7
LEAST_HUE_255 = 3.0


def find_channel_order(
    name: str, view: ViewFrames, sample: Sample
) -> tuple[list[Finding], ViewFrames]:
    """Compare the hue of the pictures under every order of the channels.

    The mean of the channels does not depend on their order and is left out.
    """
    rendered_hue, truth_hue = (
        images - images.mean(axis=-1, keepdims=True)
        for images in (sample.rendered, sample.truth_now)
    )
    errors = {
        order: np.square(rendered_hue[..., list(order)] - truth_hue).mean(axis=(1, 2, 3))
        for order in permutations(range(3))
    }
    straight = errors[0, 1, 2]
    order = min(errors, key=lambda key: float(errors[key].mean()))
    ratio = float((errors[order] / np.maximum(straight, 1e-6)).max())  # at every instant
    hue_255 = float(np.sqrt(np.square(truth_hue).mean()))
    if order == (0, 1, 2) or ratio > LIKELY_ORDER or hue_255 < LEAST_HUE_255:
        return [], view
    came = order_name(order)
    values = {
        "hue_error_255": float(np.sqrt(straight.mean())),
        "hue_error_mended_255": float(np.sqrt(errors[order].mean())),
    }
    text = (
        f"channels come as {came}: the hue is off by {values['hue_error_255']:.1f} of 255, "
        f"reordered by {values['hue_error_mended_255']:.1f}"
    )
    advice = (
        "convert before writing: OpenCV reads and writes BGR"
        if came == "BGR"
        else "reorder the channels before writing"
    )
    verdict = verdict_of(ratio < CERTAIN_ORDER)
    finding = Finding(
        subject=name,
        question="channel order",
        verdict=verdict,
        measured=text,
        values={**values, "order": order},
        advice=advice,
    )
    return [finding], view.with_rendered(reordered({"order": order}).inverse)


SAMPLED_FRAMES = 12
# Copies are looked for at full size, which costs most. With fewer frames noise is not
# distinguishable from static content.
COPIED_FRAMES = 4


class QuickChecks:
    """Quick checks of one view, for any number of methods.

    The small captured frames are read once for all.
    """

    def __init__(self, view: str, truth: FrameReader, numbers: range) -> None:
        """Take the name of the view, its captured frames and the numbers of these."""
        self._view, self._truth, self._numbers = view, truth, numbers
        self._small_truth = _small(truth, SAMPLED_FRAMES + 2 * LARGEST_OFFSET)

    def check(self, rendered: FrameReader, frames: range) -> list[Finding]:
        """Find blank, repeated and mirrored frames, other instants, swapped channels, wrong tone
        and copies of the truth.

        All faults except copies are looked for in one burst in the middle, at small size. What
        moves a picture by less than a pixel, whether it shows another camera, and what cannot be
        answered is left to `examine`.

        Args:
            rendered: frames of the truth's size.
            frames: their numbers, in a row.
        """
        burst = middle_of(frames, SAMPLED_FRAMES)
        view = ViewFrames(
            rendered=_small(rendered, len(burst)),
            truth=self._small_truth,
            frames=burst,
            truth_frames=self._numbers,
        )
        scan = scan_frames(self._view, view)
        usable = longest_run(scan.usable)
        if not usable:
            return scan.findings
        view = replace(view, frames=usable)
        mirrored, view = find_identity(self._view, view, {self._view: remember(self._small_truth)})
        placed = find_placement({self._view: view})  # whose findings are left to `examine`
        view = undo_changes({self._view: view}, placed)[self._view]
        sampled, view = check_sample(self._view, view)
        tones = find_tone({self._view: take_sample(view, SAMPLED_FRAMES)})
        # likely ones need more views than one
        sampled += [finding for finding in tones if finding.verdict == "certain"]
        repeated = find_repeated(self._view, view, scan, sampled)
        middle = ViewFrames(
            rendered=rendered,
            truth=self._truth,
            frames=middle_of(usable, COPIED_FRAMES),
            truth_frames=self._numbers,
        )
        copied = find_copied(self._view, middle)
        # Copies among renders of another exposure flicker, too.
        is_copied = any(finding.verdict != "unknown" for finding in copied)
        flicker = [] if is_copied else find_flicker(self._view, view)
        border = [] if mirrored else find_border(self._view, middle)
        findings = [*scan.findings, *repeated, *mirrored, *sampled, *border, *copied, *flicker]
        return [finding for finding in findings if finding.verdict != "unknown"]


class _QuickQuestion:
    """The quick checks as scoring asks them."""

    def of_view(self, view: str, truth: FrameReader, numbers: range) -> FrameCheck:
        """See `Question`."""
        return QuickChecks(view, truth, numbers).check

    def of_method(
        self, method: ScoredMethod, findings: Mapping[str, list[Finding]]
    ) -> dict[str, list[Finding]]:
        """Doubt the numbers of imported frames."""
        counted_from, start = guessed_first(method.run, method.label), method.protocol.frames.start
        return {
            view: [doubt_numbering(finding, counted_from, start) for finding in of_view]
            for view, of_view in findings.items()
        }


QUESTION = _QuickQuestion()


def check_sample(name: str, view: ViewFrames) -> tuple[list[Finding], ViewFrames]:
    """Ask a burst of neighbouring instants when it is, and in which order of channels.

    Returns:
        Return the findings, and the view with time and channels corrected.
    """
    sample = take_sample(view, SAMPLED_FRAMES)
    shifted, view = find_offset(name, view, sample)
    sample = take_sample(view, SAMPLED_FRAMES) if shifted else sample
    swapped, view = find_channel_order(name, view, sample)
    return [*shifted, *swapped], view


def _small(read: FrameReader, count: int) -> FrameReader:
    """Return the frames at the size of a sample, as many as are asked for again."""

    def read_small(index: int) -> Image8:
        return round_levels(shrink(read(index)))

    return lru_cache(count)(read_small)


@dataclass(frozen=True)
class _Timing:
    """Instants that the frames show, and how well that explains them.

    Attributes:
        is_reversed: the last frame comes first.
        ratio: motion left unexplained, relative to no offset on the same frames.
        error: standard error of the logarithm of `ratio`.
        correlation: of the motion with that of the instants shown.
        straight: correlation with that of the instants of the frames' numbers.
    """

    lag: int
    is_reversed: bool
    ratio: float
    error: float
    correlation: float
    straight: float

    @property
    def deviations(self) -> float:
        """Logarithm of the ratio in its standard errors; negative if the offset explains more."""
        return float(np.log(self.ratio)) / max(self.error, 1e-6)

    @property
    def is_likely(self) -> bool:
        """Return whether the offset explains the motion better."""
        explains_more = self.ratio < LIKELY_RATIO and self.deviations < LIKELY_DEVIATIONS
        return explains_more and self.correlation > LEAST_CORRELATION


def find_offset(name: str, view: ViewFrames, sample: Sample) -> tuple[list[Finding], ViewFrames]:
    """Correlate the change over time of rendered and captured frames at every lag, forwards and
    backwards.

    Static content is removed by each pixel's mean over the instants, and with it most of what is
    wrong with a rendering; the gain of the motion, which blur lowers, does not matter either.
    """
    rendered, truth = _grey(sample.rendered), _grey(sample.truth)
    lags = range(-LARGEST_OFFSET, LARGEST_OFFSET + 1)
    turning = view.frames.start + view.frames[-1]
    orders = {(lag, False): [index + lag for index in sample.indices] for lag in lags if lag}
    orders |= {(lag, True): [turning - index + lag for index in sample.indices] for lag in lags}
    tried = [_timing(sample, rendered, truth, numbers, *key) for key, numbers in orders.items()]
    best = min(
        (timing for timing in tried if timing is not None),
        key=lambda timing: timing.ratio,
        default=None,
    )
    if best is None:
        return [
            Finding(
                subject=name,
                question=OFFSET,
                verdict="unknown",
                measured=f"fewer than {FEWEST_FRAMES} frames in a row",
            )
        ], view
    if not best.is_likely:
        order = "reversed order" if best.is_reversed else f"instant t{best.lag:+d}"
        too_little = (
            f"motion fits {order} about as well as t: too little moves, or too few pixels show it"
        )
        is_refuted = best.deviations > -LIKELY_DEVIATIONS
        return [] if is_refuted else [
            Finding(subject=name, question=OFFSET, verdict="unknown", measured=too_little)
        ], view
    return [_finding(name, best, view.truth_range)], view.reversed(
        best.lag
    ) if best.is_reversed else view.moved(best.lag)


def _finding(name: str, timing: _Timing, instants: range) -> Finding:
    values = {
        "offset_frames": float(timing.lag),
        "correlation": timing.correlation,
        "correlation_without": timing.straight,
        "deviations": timing.deviations,
    }
    reversal = (
        f"the frames come in reversed order{f', {timing.lag:+d}' if timing.lag else ''}"
        if timing.is_reversed
        else ""
    )
    text = (
        f"{reversal or f'frame t shows instant t{timing.lag:+d}'}: motion correlates "
        f"{timing.correlation:.2f} with it, {timing.straight:.2f} with t, {-timing.deviations:.1f} "
        "standard errors apart"
    )
    common = instants[timing.lag :] if timing.lag > 0 else instants[: timing.lag or None]
    absent = as_ranges(sorted(set(instants) - set(common)))
    flags = f"--start {common.start} " * (common.start > 0) + f"--frames {len(common)}"
    advice = (
        f"renumber the frames by {timing.lag:+d} and, as instant {absent} then has no render, "
        "score all methods under a protocol without it (ggvs-eval protocol CAPTURE mine.toml "
        f"{flags}): first frame counted from 0 or 1, or another start?"
    )
    question = "reversed time" if timing.is_reversed else OFFSET
    advice = (
        "number the frames from the first instant to the last" if timing.is_reversed else advice
    )
    verdict = verdict_of(timing.ratio < CERTAIN_RATIO and timing.deviations < CERTAIN_DEVIATIONS)
    return Finding(
        subject=name,
        question=question,
        verdict=verdict,
        measured=text,
        values=values,
        advice=advice,
    )


def is_offset(finding: Finding) -> bool:
    """Return whether frames show instants a constant number before or after their own."""
    return finding.question == OFFSET and finding.verdict != "unknown"


def doubt_numbering(finding: Finding, counted_from: int, start: int) -> Finding:
    """Return an offset with another remedy, where not the frames are off but the guess how their
    names are counted.

    Args:
        finding: of one view.
        counted_from: the number in the names that was taken for the capture's first instant.
        start: first instant of the protocol.
    """
    if (
        not is_offset(finding)
        or not counted_from
        or finding.values["offset_frames"] != counted_from
    ):
        return finding
    command = f"ggvs-eval protocol CAPTURE mine.toml --start {start + counted_from}"
    advice = (
        "make a protocol of the instants in the file names, which seem to be counted from 0, not "
        f"{counted_from} ({command})"
    )
    return replace(finding, advice=advice)


def _grey(frames: Array32) -> Array32:
    """Return the mean of the channels of each frame, noise smoothed a little, (n, h, w)."""
    return np.stack([cv2.GaussianBlur(mean_of_channels(frame), (0, 0), 1.0) for frame in frames])


def _timing(
    sample: Sample,
    rendered: Array32,
    truth: Array32,
    numbers: Sequence[int],
    lag: int,
    is_reversed: bool,
) -> _Timing | None:
    """Correlate the frames with the instants of these numbers.

    None if the truth has too few of them.

    Args:
        rendered: (n, h, w).
        truth: (m, h, w).
        lag: for the record, as is `is_reversed`.
    """
    instants = sample.truth_indices
    pairs = [(i, number) for i, number in enumerate(numbers) if number in instants]
    if len(pairs) < FEWEST_FRAMES:
        return None
    renders = rendered[[i for i, _ in pairs]]
    captures = truth[[sample.indices[i] - instants.start for i, _ in pairs]]
    lagged = truth[[number - instants.start for _, number in pairs]]
    renders, captures, lagged = (
        frames - frames.mean(axis=0) for frames in (renders, captures, lagged)
    )
    products = [
        _square_sums(a * b)
        for a, b in (
            (renders, lagged),
            (lagged, lagged),
            (renders, captures),
            (captures, captures),
            (renders, renders),
        )
    ]
    sums = np.stack(products)  # (5, squares)
    lagged_fit, straight, ratio = _unexplained(sums.sum(axis=1))
    # without each of the squares
    ratios = np.log(_unexplained(sums.sum(axis=1, keepdims=True) - sums)[2])
    error = float(np.sqrt((len(ratios) - 1) * ratios.var()))
    return _Timing(
        lag=lag,
        is_reversed=is_reversed,
        ratio=float(ratio),
        error=error,
        correlation=float(lagged_fit),
        straight=float(straight),
    )


def _square_sums(products: Array32) -> Array32:
    """Sum products (n, h, w) over the instants and over squares, (squares,), up to a common
    factor.
    """
    height, width = products.shape[1:]
    size = max(width // SQUARE_PX, 1), max(height // SQUARE_PX, 1)
    return cv2.resize(products.sum(axis=0), size, interpolation=cv2.INTER_AREA).ravel()


def _unexplained(sums: Array) -> tuple[Array, Array, Array]:
    """Return the correlation with the instants of a lag and with the straight ones, and the ratio
    of what these leave.

    Args:
        sums: of rendered times lagged, lagged squared, rendered times straight, straight squared,
            rendered squared, (5, ...).
    """
    lagged, straight = (
        np.maximum(sums[place], 0) / np.sqrt(np.maximum(sums[place + 1] * sums[4], 1e-12))
        for place in (0, 2)
    )
    return lagged, straight, (1 - lagged**2).clip(1e-6) / (1 - straight**2).clip(1e-6)


@dataclass(frozen=True)
class Change:
    """Difference of two neighbouring frames: in the cell where it is largest, and in the usual
    cell, levels of 255.
    """

    largest: float
    usual: float


@dataclass(frozen=True)
class Scan:
    """Result of one pass over the rendered frames.

    `repeats` are those that hardly differ from the one before.
    """

    findings: list[Finding]
    usable: list[int]
    repeats: list[int]


def scan_frames(name: str, view: ViewFrames) -> Scan:
    """Check all frames; those of the truth are read only for suspicious ones and for its usual
    change.
    """
    blank: list[int] = []
    still: list[int] = []
    changes: list[float] = []
    sizes: dict[tuple[int, int], list[int]] = {}
    before: Array32 | None = None
    for index in view.frames:
        image = view.rendered(index)
        sizes.setdefault((image.shape[1], image.shape[0]), []).append(index)
        small = shrink(image)
        if float(small.std(axis=(0, 1)).max()) < BLANK_CONTRAST:
            blank.append(index)
        elif before is not None and before.shape == small.shape:
            changes.append(change(before, small).largest)
            still.append(index)
        before = small if not blank or blank[-1] != index else None
    usual = float(np.median(changes)) if changes else 0.0
    candidates = [
        index
        for index, value in zip(still, changes, strict=True)
        if value < max(STILL_SHARE * usual, STILL_255)
    ]
    blank = [
        index
        for index in blank
        if shrink(view.truth(index)).std(axis=(0, 1)).max() > LEAST_CONTRAST
    ]
    findings = [*_wrong_size(name, view, sizes), *_blank(name, blank, len(view.frames))]
    return Scan(findings, [index for index in view.frames if index not in set(blank)], candidates)


def change(before: Array32, after: Array32) -> Change:
    """Measure how much two pictures (h, w, 3) differ, by the mean of each of 16 x 16 cells."""
    cells = cv2.resize(
        mean_of_channels(np.abs(after - before)), (CELLS, CELLS), interpolation=cv2.INTER_AREA
    )
    return Change(float(cells.max()), float(np.median(cells)))


def _wrong_size(
    name: str, view: ViewFrames, sizes: dict[tuple[int, int], list[int]]
) -> list[Finding]:
    height, width = view.truth(view.frames[0]).shape[:2]
    wrong = {size: indices for size, indices in sizes.items() if size != (width, height)}
    if not wrong:
        return []
    sizes_text = "; ".join(
        f"{named_frames(indices)} {w} x {h}" for (w, h), indices in wrong.items()
    )
    values = {"width_px": float(next(iter(wrong))[0]), "height_px": float(next(iter(wrong))[1])}
    text = f"{sizes_text}, the truth is {width} x {height}"
    return [
        Finding(
            subject=name,
            question="wrong size",
            verdict="certain",
            measured=text,
            values=values,
            advice=f"render at {width} x {height}, do not resize after",
        )
    ]


def _blank(name: str, blank: list[int], count: int) -> list[Finding]:
    if not blank:
        return []
    text = f"{named_frames(blank)} blank ({len(blank)} of {count})"
    advice = (
        "render them again; black frames: is the camera inside something, or near and far wrong?"
    )
    return [
        Finding(
            subject=name,
            question="blank frames",
            verdict="certain",
            measured=text,
            values={"n_frames": float(len(blank))},
            advice=advice,
        )
    ]


def find_repeated(
    name: str, view: ViewFrames, scan: Scan, findings: Sequence[Finding]
) -> list[Finding]:
    """Find repeats where the truth moves.

    Those held at an end by an offset in `findings` are its consequence, and left out.
    """
    instants = view.truth_range
    lag = sum(int(finding.values["offset_frames"]) for finding in findings if is_offset(finding))
    frozen = instants[-lag:] if lag > 0 else instants[1 : 1 - lag]
    candidates = [index for index in scan.repeats if index not in frozen]
    if not candidates:
        return []
    typical = _truth_change(view, list(view.frames)[1 :: max(len(view.frames) // 8, 1)])
    repeats = [index for index in candidates if _moves(_truth_change(view, [index]), typical)]
    if not repeats:
        return []
    repeats_text = (
        f"frames {as_ranges(repeats)} repeat the one before"
        if len(repeats) > 1
        else (f"frame {repeats[0]} repeats frame {repeats[0] - 1}")
    )
    is_all = len(repeats) == len(view.frames) - 1 > 1
    text = (
        f"{f'all {len(view.frames)} frames show one instant' if is_all else repeats_text} while "
        "the truth moves"
    )
    values = {"n_frames": float(len(repeats)), "truth_change_255": typical.largest}
    advice = "is time passed to the renderer? converted frame rates or dropped frames repeat some"
    return [
        Finding(
            subject=name,
            question="repeated frames",
            verdict="certain",
            measured=text,
            values=values,
            advice=advice,
        )
    ]


def _truth_change(view: ViewFrames, indices: list[int]) -> Change:
    """Return the median change of the truth from the frames before some frames to these."""
    changes = [
        change(shrink(view.truth(index - 1)), shrink(view.truth(index))) for index in indices
    ]
    return Change(
        *(
            float(np.median([getattr(truth_change, part) for truth_change in changes]))
            for part in ("largest", "usual")
        )
    )


def _moves(current: Change, typical: Change) -> bool:
    """Return whether the truth changes as it usually does, and more than by noise, which all cells
    have alike.
    """
    return current.largest > max(
        MOVING_SHARE * typical.largest, MOVING_OVER_NOISE * current.usual, MOVING_255
    )
