"""Frames that occur twice: those of another method under a second name, and those of another view of the same method.

They carry one measurement, so that a rank between them would be made up. It happens on published pages.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from ggvs_eval.files.images import read_image
from ggvs_eval.finding import Finding
from ggvs_eval.progress import counted
from ggvs_eval.results import SAME_FRAMES
from ggvs_eval.run_folder import frame_path
from ggvs_eval.scoring import FrameCheck, FrameReader, ScoredMethod

MOST_DIFFERING = 0.01  # share of the frames in which two methods may differ and still be one
ADVICE = "render one of them again; is its folder a copy of the other?"
FramePairs = Iterator[tuple[Path, Path] | None]  # None: known to differ


class SameFrames:
    """The question whether a method has the frames of another one; it is asked of a measured method, not of single frames."""

    def of_view(self, _view: str, _truth: FrameReader, _numbers: range) -> FrameCheck:
        """See `Question`."""
        return lambda _rendered, _frames: []

    def of_method(self, method: ScoredMethod, findings: Mapping[str, list[Finding]]) -> dict[str, list[Finding]]:
        """Compare with the methods that were scored before, and the views with each other.

        Reading:
            Of two methods with the same frames the later one is not ranked: those that were rendered here come
            before imported ones.
        """
        added = {view: list(of_view) for view, of_view in findings.items()}
        views, numbers = list(findings), method.protocol.frames.numbers
        for other in method.before:
            if measured := _shared(_of_methods(method, other, views), len(views) * len(numbers)):
                added[views[0]].append(Finding(views[0], f"{SAME_FRAMES}{other.label}", "certain", measured, {}, ADVICE))
                break
        for at, view in enumerate(views):
            for other_view in views[:at]:
                if measured := _shared(_of_views(method, view, other_view), len(numbers)):
                    added[view].append(Finding(view, f"{SAME_FRAMES}{other_view}", "certain", measured, {}, ADVICE))
        return added


QUESTION = SameFrames()


def _of_methods(method: ScoredMethod, other: ScoredMethod, views: list[str]) -> FramePairs:
    """Yield the frames of two methods; frames of different values are not read."""
    for view in views:
        scores = [[by_view.get(view, {}) for by_view in scored.values.values()] for scored in (method, other)]
        for number in method.protocol.frames.numbers:
            first, second = ([by_frame.get(number) for by_frame in by_metric] for by_metric in scores)
            folders = [method.run.renders(scored.label, view) for scored in (method, other)]
            is_alike = first == second and any(value is not None for value in first)
            yield (frame_path(folders[0], number), frame_path(folders[1], number)) if is_alike else None


def _of_views(method: ScoredMethod, view: str, other: str) -> FramePairs:
    """Yield the frames of two views of a method; files of different sizes are not read, as one program wrote them."""
    for number in method.protocol.frames.numbers:
        first, second = (frame_path(method.run.renders(method.label, name), number) for name in (view, other))
        sizes = {file.stat().st_size if file.is_file() else 0 for file in (first, second)}
        yield (first, second) if len(sizes) == 1 else None


def _shared(pairs: FramePairs, n_frames: int) -> str:
    """State how many frames are equal; empty as soon as too many are not."""
    n_differing = 0
    for pair in pairs:
        n_differing += pair is None or not np.array_equal(read_image(pair[0]), read_image(pair[1]))
        if n_differing >= MOST_DIFFERING * n_frames:
            return ""
    return f"{n_frames - n_differing} of {counted(n_frames, 'frame')} are equal pixel by pixel"
