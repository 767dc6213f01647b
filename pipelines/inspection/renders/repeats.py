"""Every rendered frame once, as a stream: of another size, blank, or a repetition of the one before."""

from dataclasses import dataclass

import cv2
import numpy as np

from ggvs_eval.arrays import Array32, Image8
from ggvs_eval.pipelines.inspection.finding import Finding
from ggvs_eval.pipelines.inspection.renders.view_frames import ViewFrames, shrink
from ggvs_eval.run_folder import as_ranges

CELLS = 16
# Contrast (standard deviation of 255 levels) of a frame without a picture, where the truth has one.
BLANK_CONTRAST, LEAST_CONTRAST = 1.5, 8.0
# Change of the cell that changes most: a repeated frame has hardly any, although the truth has its usual one.
STILL_SHARE, STILL_255 = 0.1, 0.5
MOVING_SHARE, MOVING_OVER_NOISE, MOVING_255 = 0.3, 3.0, 4.0


@dataclass(frozen=True)
class Change:
    """Difference of two neighbouring frames: in the cell where it is largest, and in the usual cell, levels of 255."""

    largest: float
    usual: float


@dataclass(frozen=True)
class Scan:
    """Result of one pass over the rendered frames."""

    findings: list[Finding]
    usable: list[int]


def scan_frames(name: str, view: ViewFrames) -> Scan:
    """Look at all frames; those of the truth are read only beside suspicious ones and to know its usual change."""
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
    candidates = [index for index, value in zip(still, changes, strict=True) if value < max(STILL_SHARE * usual, STILL_255)]
    blank = [index for index in blank if shrink(view.truth(index)).std(axis=(0, 1)).max() > LEAST_CONTRAST]
    findings = [*_wrong_size(name, view, sizes), *_blank(name, blank, len(view.frames)), *_repeated(name, view, candidates)]
    return Scan(findings, [index for index in view.frames if index not in set(blank)])


def change(before: Array32, after: Array32) -> Change:
    """Measure how much two pictures (h, w, 3) differ, by the mean of each of 16 x 16 cells."""
    difference = np.abs(after - before).mean(axis=-1)
    cells = cv2.resize(difference, (CELLS, CELLS), interpolation=cv2.INTER_AREA)
    return Change(float(cells.max()), float(np.median(cells)))


def resized(image: Image8, width: int, height: int) -> Image8:
    """A frame of the wrong size at the right one, to go on with."""
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _wrong_size(name: str, view: ViewFrames, sizes: dict[tuple[int, int], list[int]]) -> list[Finding]:
    height, width = view.truth(view.frames[0]).shape[:2]
    wrong = {size: indices for size, indices in sizes.items() if size != (width, height)}
    if not wrong:
        return []
    shown = "; ".join(f"frames {as_ranges(indices)} are {w} x {h}" for (w, h), indices in wrong.items())
    values = {"width_px": float(next(iter(wrong))[0]), "height_px": float(next(iter(wrong))[1])}
    measured = f"{shown}, the truth is {width} x {height}"
    return [Finding(name, "wrong size", "certain", measured, values, f"render at {width} x {height}, do not resize after")]


def _blank(name: str, blank: list[int], count: int) -> list[Finding]:
    if not blank:
        return []
    measured = f"frames {as_ranges(blank)} show nothing ({len(blank)} of {count})"
    advice = "render them again; black frames: is the camera inside something, or near and far wrong?"
    return [Finding(name, "blank frames", "certain", measured, {"n_frames": float(len(blank))}, advice)]


def _repeated(name: str, view: ViewFrames, candidates: list[int]) -> list[Finding]:
    """Of the frames that hardly differ from the one before those in which the truth goes on moving."""
    if not candidates:
        return []
    typical = _truth_change(view, list(view.frames)[1 :: max(len(view.frames) // 8, 1)])
    repeats = [index for index in candidates if _moves(_truth_change(view, [index]), typical)]
    if not repeats:
        return []
    whole = len(repeats) == len(view.frames) - 1
    measured = f"frames {as_ranges(repeats)} repeat the one before while the truth moves"
    measured = f"all {len(view.frames)} frames show one instant while the truth moves" if whole else measured
    values = {"n_frames": float(len(repeats)), "truth_change_255": typical.largest}
    advice = "is time handed to the renderer? a converted frame rate or frames skipped under load repeat some"
    return [Finding(name, "repeated frames", "certain", measured, values, advice)]


def _truth_change(view: ViewFrames, indices: list[int]) -> Change:
    """Median change of the truth from the frames before some frames to these."""
    changes = [change(shrink(view.truth(index - 1)), shrink(view.truth(index))) for index in indices]
    return Change(*(float(np.median([getattr(one, part) for one in changes])) for part in ("largest", "usual")))


def _moves(now: Change, typical: Change) -> bool:
    """Tell whether the truth changes as it usually does, and more than by noise, which all cells have alike."""
    return now.largest > max(MOVING_SHARE * typical.largest, MOVING_OVER_NOISE * now.usual, MOVING_255)
