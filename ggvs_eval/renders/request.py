"""Fit of renders to a run: the views, frames and sizes that it asks for, and the captured frames beside them."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from ggvs_eval.arrays import Image8
from ggvs_eval.errors import RenderError
from ggvs_eval.files.images import read_image
from ggvs_eval.renders.view_folders import read_header
from ggvs_eval.run_folder import RunFolder, as_ranges, frame_path

LISTED = 20


@dataclass(frozen=True)
class FrameRequest:
    """Everything that a run asks of a method's frames.

    Attributes:
        label: what the method will be called.
        views: names of the test views, in the protocol's order.
        frames: frame numbers of the protocol.
        n_frames: frames of the whole capture; renders of all of them hold the protocol's too.
        sizes: view -> (width, height) in pixels.
        cameras: names of all cameras, in the capture's order.
        truth_root: folder of the captured frames, ``<view>/<frame>.png``.
        first_frame: number that the protocol's first frame bears, as the user says; None where the numbers shall tell.
    """

    label: str
    views: tuple[str, ...]
    frames: range
    n_frames: int
    sizes: Mapping[str, tuple[int, int]]
    cameras: tuple[str, ...]
    truth_root: Path
    first_frame: int | None = None

    def truth(self, view: str, frame: int) -> Image8:
        """The captured frame, (H, W, 3) uint8 RGB."""
        return read_image(frame_path(self.truth_root / view, frame))


class RenderedView(Protocol):
    """The frames of one view, wherever and however they lie."""

    @property
    def numbers(self) -> tuple[int, ...]:
        """Frame numbers that there are, rising."""

    def faults(self, size: tuple[int, int]) -> dict[int, str]:
        """Frame number -> why this frame cannot be used at (width, height), e.g. ``64 x 48 instead of 128 x 96``."""

    def write(self, folder: Path, numbers: tuple[int, ...]) -> list[str]:
        """Put these frames into a folder as ``<frame>.png``; returns remarks for people."""


@dataclass(frozen=True)
class RenderSet:
    """Contents of a source of renders.

    Attributes:
        views: test view -> its frames; a view that is not there has no entry.
        extras: names of pictures, videos or arrays that belong to no view or frame of the protocol.
        notes: how names were understood, and what they were compared with.
        numbering: how frame numbers were understood; the same for all views.
        first: the number that the capture's first instant bears in these names.
        doubles: view -> frame number -> names of the several pictures of it.
        hints: view -> what lies there instead of the frames that it lacks.
    """

    views: Mapping[str, RenderedView]
    extras: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    numbering: str = ""
    first: int = 0
    doubles: Mapping[str, Mapping[int, Sequence[str]]] = field(default_factory=dict)
    hints: Mapping[str, str] = field(default_factory=dict)


def request_of(run: RunFolder, label: str, first_frame: int | None = None) -> FrameRequest:
    """Return what a run asks of a method; `first_frame` as of `FrameRequest`."""
    protocol, record = run.protocol(), run.capture_record()
    frames = protocol.frames.numbers
    views = protocol.views.test
    sizes = {}
    for view in views:
        file = frame_path(run.truth(view), frames.start)
        if not file.is_file():
            raise RenderError(f"{file}: wanted a captured frame to compare with, there is none; run `ggvs-eval prepare`")
        sizes[view] = read_header(file).size
    return FrameRequest(
        label, views, frames, record["n_frames"], sizes, tuple(record["cameras"]), run.root / "truth", first_frame
    )


@dataclass(frozen=True)
class Fit:
    """Fit of renders to a protocol.

    Attributes:
        usable: view -> frames that can be scored, rising; views without any have no entry.
        missing: what is not there, by view.
        faulty: what is there and cannot be used, by view and reason.
        extras: what belongs to no view or frame.
    """

    usable: Mapping[str, tuple[int, ...]]
    missing: tuple[str, ...]
    faulty: tuple[str, ...]
    extras: tuple[str, ...]


def fit(renders: RenderSet, request: FrameRequest) -> Fit:
    """Compare the renders found with those wanted."""
    usable, missing, faulty = {}, [], []
    for view in request.views:
        rendered = renders.views.get(view)
        there = rendered.numbers if rendered else ()
        faults = rendered.faults(request.sizes[view]) if rendered else {}
        doubles = renders.doubles.get(view, {})
        absent = [frame for frame in request.frames if frame not in there and frame not in doubles]
        if absent:
            missing.append(f"{request.label} in {view} lacks {_absent(absent, view, renders, request)}")
        if doubles:
            example = f"several pictures of one frame: {' and '.join(doubles[min(doubles)])}; keep one"
            faulty.append(f"{request.label} in {view}: {as_ranges(sorted(doubles))} ({example})")
        by_fault: dict[str, list[int]] = defaultdict(list)
        for frame, fault in faults.items():
            by_fault[fault].append(frame)
        faulty += [f"{request.label} in {view}: {as_ranges(frames)} ({fault})" for fault, frames in by_fault.items()]
        good = tuple(frame for frame in there if frame not in faults)
        if good:
            usable[view] = good
    return Fit(usable, tuple(missing), tuple(faulty), renders.extras)


def _absent(frames: list[int], view: str, renders: RenderSet, request: FrameRequest) -> str:
    """Frames that are not there, how they would be numbered, and what is there instead."""
    numbered = f" (numbered {as_ranges([frame + renders.first for frame in frames])})" if renders.first else ""
    lacking = f"all {len(frames)} frames" if len(frames) == len(request.frames) else as_ranges(frames) + numbered
    return f"{lacking}, but {renders.hints[view]}" if renders.hints.get(view) else lacking


def require_whole(fitted: Fit, path: Path, numbering: str) -> None:
    """Refuse renders that are not exactly those wanted.

    Raises:
        RenderError: anything missing, extra or unusable; up to 20 of each are named, and all are counted.
    """
    groups = {"frames are missing": fitted.missing, "cannot be used": fitted.faulty, "belongs to nothing": fitted.extras}
    listed = [f"{title}: {_listed(items)}" for title, items in groups.items() if items]
    if listed:
        numbered = [numbering] if numbering else []
        raise RenderError(
            f"{path}: {'; '.join([*numbered, *listed])}; put this right, or give --allow-partial to score what fits"
        )


def partial_text(fitted: Fit, request: FrameRequest) -> str:
    """Describe the frames behind a row of these renders; empty where none is missing."""
    if not fitted.usable:
        raise RenderError(
            f"{request.label}: not a single frame fits the protocol: {_listed((*fitted.missing, *fitted.faulty))}; "
            "check views, frames and size"
        )
    n_whole = sum(len(frames) == len(request.frames) for frames in fitted.usable.values())
    n_frames = sum(len(frames) for frames in fitted.usable.values())
    if n_whole == len(request.views):
        return ""
    text = f"{n_whole} of {len(request.views)} views complete, {n_frames} of {len(request.views) * len(request.frames)} frames"
    return f"{text} ({', '.join(fitted.usable)})"


def _listed(items: Sequence[str]) -> str:
    more = f" and {len(items) - LISTED} more" if len(items) > LISTED else ""
    return "; ".join(items[:LISTED]) + more
