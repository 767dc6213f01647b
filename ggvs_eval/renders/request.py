"""Fit of renders to a run: its views, frames and sizes, and the captured frames.

Rendered frames that are pictures on disk are RGB in PNG, linked as it is; everything else is
decoded once, and it is said.
"""

import os
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.errors import RenderError
from ggvs_eval.files.images import read_image, write_image
from ggvs_eval.files.picture_header import (
    SEEN_THROUGH,
    PictureHeader,
    read_picture_header,
    transparent_share,
)
from ggvs_eval.files.plain import LARGEST_PICTURE, check_plain, why_unread
from ggvs_eval.progress import counted
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
        first_frame: number of the protocol's first frame, given by the user; None to infer it.
        fps: frames per second of the capture; 0 if it is not known.
    """

    label: str
    views: tuple[str, ...]
    frames: range
    n_frames: int
    sizes: Mapping[str, tuple[int, int]]
    cameras: tuple[str, ...]
    truth_root: Path
    first_frame: int | None = None
    fps: float = 0.0

    def truth(self, view: str, frame: int) -> Image8:
        """Return the captured frame, (H, W, 3) uint8 RGB."""
        return read_image(frame_path(self.truth_root / view, frame))


class RenderedView(Protocol):
    """The frames of one view, in any supported form."""

    @property
    def numbers(self) -> tuple[int, ...]:
        """Frame numbers that there are, ascending."""

    def faults(self, size: tuple[int, int]) -> dict[int, str]:
        """Return frame number -> why this frame cannot be used at (width, height), e.g. ``64 x 48
        instead of 128 x 96``.
        """

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
        hints: view -> what is there instead of its missing frames.
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
            raise RenderError(
                f"{file}: wanted a captured frame to compare with, got none; run `ggvs-eval "
                f"prepare`"
            )
        sizes[view] = read_header(file).size
    return FrameRequest(
        label=label,
        views=views,
        frames=frames,
        n_frames=record["n_frames"],
        sizes=sizes,
        cameras=tuple(record["cameras"]),
        truth_root=run.root / "truth",
        first_frame=first_frame,
        fps=record.get("fps", 0.0),
    )


@dataclass(frozen=True)
class Fit:
    """Fit of renders to a protocol.

    Attributes:
        usable: view -> frames that can be scored, ascending; views without any have no entry.
        missing: what is not there, by view.
        faulty: what is there and cannot be used, by view and reason.
        extras: what belongs to no view or frame.
        untested: other cameras of the capture that were rendered too, which is no fault.
    """

    usable: Mapping[str, tuple[int, ...]]
    missing: tuple[str, ...]
    faulty: tuple[str, ...]
    extras: tuple[str, ...]
    untested: tuple[str, ...] = ()


def fit(renders: RenderSet, request: FrameRequest) -> Fit:
    """Compare the renders found with those wanted."""
    usable, missing, faulty = {}, [], []
    for view in request.views:
        rendered = renders.views.get(view)
        numbers = rendered.numbers if rendered else ()
        faults = rendered.faults(request.sizes[view]) if rendered else {}
        doubles = renders.doubles.get(view, {})
        absent = [
            frame for frame in request.frames if frame not in numbers and frame not in doubles
        ]
        if absent:
            missing.append(
                f"{request.label} in {view} lacks {_absent(absent, view, renders, request)}"
            )
        if doubles:
            example = (
                f"several pictures of one frame: {' and '.join(doubles[min(doubles)])}; give a "
                "folder with one of each"
            )
            faulty.append(f"{request.label} in {view}: {as_ranges(sorted(doubles))} ({example})")
        by_fault: dict[str, list[int]] = defaultdict(list)
        for frame, fault in faults.items():
            by_fault[fault].append(frame)
        faulty += [
            f"{request.label} in {view}: {as_ranges(frames)} ({fault})"
            for fault, frames in by_fault.items()
        ]
        good = tuple(frame for frame in numbers if frame not in faults)
        if good:
            usable[view] = good
    owners = {
        extra: [name for name in request.cameras if re.search(as_word(name), extra)]
        for extra in renders.extras
    }
    strays = {
        extra: names[0]
        for extra, names in owners.items()
        if len(names) == 1 and names[0] not in request.views
    }
    extras = tuple(extra for extra in renders.extras if extra not in strays)
    return Fit(
        usable=usable,
        missing=tuple(missing),
        faulty=tuple(faulty),
        extras=extras,
        untested=tuple(name for name in request.cameras if name in strays.values()),
    )


def as_word(name: str) -> str:
    """Return a regular expression of a view's name as a separate word."""
    return rf"(?<![A-Za-z0-9]){re.escape(name)}(?![A-Za-z0-9])"


def _absent(frames: list[int], view: str, renders: RenderSet, request: FrameRequest) -> str:
    """Return the frames that are not there, how they would be numbered, and what is there
    instead.
    """
    numbered = (
        f" (numbered {as_ranges([frame + renders.first for frame in frames])})"
        if renders.first
        else ""
    )
    lacking = (
        f"all {len(frames)} frames"
        if len(frames) == len(request.frames)
        else as_ranges(frames) + numbered
    )
    return f"{lacking}, but {renders.hints[view]}" if renders.hints.get(view) else lacking


def require_whole(fitted: Fit, path: Path, numbering: str) -> None:
    """Refuse renders that are not exactly those wanted.

    Raises:
        RenderError: anything missing, extra or unusable; up to 20 of each are named, and all are
            counted.
    """
    groups = {
        "frames are missing": fitted.missing,
        "cannot be used": fitted.faulty,
        "fits no view and frame": fitted.extras,
    }
    listed = [f"{title}: {_listed(items)}" for title, items in groups.items() if items]
    if listed:
        if fitted.untested:
            listed.append(
                f"there are renders of {', '.join(fitted.untested)}, which the protocol does not "
                f"test"
            )
        numbered = [numbering] if numbering else []
        advice = ", or score the rest by `ggvs-eval score --allow-partial`" if fitted.usable else ""
        raise RenderError(f"{path}: {'; '.join([*numbered, *listed])}; fix these{advice}")


def partial_text(fitted: Fit, request: FrameRequest) -> str:
    """Describe the frames behind a row of these renders; empty if none is missing."""
    if not fitted.usable:
        raise RenderError(
            f"{request.label}: wanted frames of the protocol, got none: "
            f"{_listed((*fitted.missing, *fitted.faulty))}; check views, frames and size"
        )
    n_whole = sum(len(frames) == len(request.frames) for frames in fitted.usable.values())
    n_frames = sum(len(frames) for frames in fitted.usable.values())
    if n_whole == len(request.views):
        return ""
    text = (
        f"{n_whole} of {len(request.views)} views complete, {n_frames} of "
        f"{len(request.views) * len(request.frames)} frames"
    )
    return f"{text} ({', '.join(fitted.usable)})"


def _listed(items: Sequence[str]) -> str:
    more = f" and {len(items) - LISTED} more" if len(items) > LISTED else ""
    return "; ".join(items[:LISTED]) + more


def read_header(path: Path) -> PictureHeader:
    """Return the size and kind of a picture, without decoding it."""
    try:
        check_plain(path, LARGEST_PICTURE)
    except OSError as error:
        raise RenderError(
            f"{path}: wanted a picture, got an unreadable file ({why_unread(error)}); restore it"
        ) from error
    try:
        return read_picture_header(path)
    except Exception as error:  # the parser raises any exception on a damaged header
        contents = "other bytes or a damaged header"
        raise RenderError(
            f"{path}: wanted a PNG or JPEG picture, got {contents}; render this frame again"
        ) from error


def size_fault(size: tuple[int, int], expected_size: tuple[int, int]) -> str:
    """Describe a wrong (width, height) of a frame; empty if it is right.

    Examples:
        >>> size_fault((320, 120), (160, 120))
        '320 x 120 instead of 160 x 120: 2 pictures side by side? cut out the rendered one'
    """
    if size == expected_size:
        return ""
    fault = f"{size[0]} x {size[1]} instead of {expected_size[0]} x {expected_size[1]}"
    for axis, lie in ((0, "side by side"), (1, "one above the other")):
        count, remainder = divmod(size[axis], expected_size[axis])
        if size[1 - axis] == expected_size[1 - axis] and count > 1 and not remainder:
            return f"{fault}: {count} pictures {lie}? cut out the rendered one"
    if size[0] < expected_size[0] and abs(
        size[0] / expected_size[0] - size[1] / expected_size[1]
    ) < 1 / min(expected_size):
        return (
            f"{fault}: to score them at this size, set synthesis.width = {size[0]}, "
            f"synthesis.height = {size[1]} in a protocol; sets of another size need one of their "
            "own"
        )
    return fault


class PixelRemarks:
    """Notes on the pixels of a view's frames, gathered while these are read."""

    def __init__(self) -> None:
        self._black: list[int] = []
        self._grey: list[int] = []

    def add(self, number: int, image: Image8) -> None:
        """Look at the next frame, (H, W, 3)."""
        if not image.any():
            self._black.append(number)
        elif np.array_equal(image[..., 0], image[..., 1]) and np.array_equal(
            image[..., 1], image[..., 2]
        ):
            self._grey.append(number)

    def notes(self) -> list[str]:
        """Return a line for each kind of remarkable frame; none if there are none."""
        black, grey = (
            f"{counted(len(some), 'frame')} ({as_ranges(some)})"
            for some in (self._black, self._grey)
        )
        notes = [f"{black} all zero (failed rendering?); scored anyway"] if self._black else []
        return notes + (
            [f"{grey} grey: the same level is measured in all three channels"] if self._grey else []
        )


@dataclass(frozen=True)
class PictureView:
    """Frames of one view that are pictures, a `RenderedView`.

    Attributes:
        pictures: frame number -> file.
        is_temporary: whether the files are temporary and can be moved; else they are linked.
    """

    pictures: Mapping[int, Path]
    is_temporary: bool = False

    @property
    def numbers(self) -> tuple[int, ...]:
        """Frame numbers that there are, ascending."""
        return tuple(sorted(self.pictures))

    def faults(self, size: tuple[int, int]) -> dict[int, str]:
        """Return the frames that are damaged, of another size, or not of 8 bits."""
        faults = {number: _fault(path, size) for number, path in sorted(self.pictures.items())}
        return {number: fault for number, fault in faults.items() if fault}

    def write(self, folder: Path, numbers: tuple[int, ...]) -> list[str]:
        """Link RGB in PNG under its frame numbers and decode the rest.

        Says what was decoded, and what is black or grey.
        """
        folder.mkdir(parents=True, exist_ok=True)
        converted: dict[str, list[int]] = defaultdict(list)
        remarks = PixelRemarks()
        for number in numbers:
            source, target = self.pictures[number], frame_path(folder, number)
            header, image = read_header(source), read_image(source)
            remarks.add(number, image)
            if header.form == "JPEG":
                converted[
                    "of JPEG, decoded once to PNG: coding errors count against the method"
                ].append(number)
            # seen from its pixels
            for conversion in header._replace(
                colours=header.colours.replace("grey", "")
            ).conversions:
                converted[f"read {conversion}"].append(number)
            if header.has_alpha and transparent_share(source):
                converted[f"read {SEEN_THROUGH}"].append(number)
            if header.form == "JPEG" or header.colours:
                write_image(target, image)
            elif self.is_temporary:
                source.replace(target)
            else:
                os.symlink(source.resolve(), target)
        notes = [
            f"{counted(len(frames), 'frame')} ({as_ranges(frames)}) {how}"
            for how, frames in converted.items()
        ]
        return notes + remarks.notes()


def _fault(path: Path, size: tuple[int, int]) -> str:
    """State why one picture cannot be used; empty if it can."""
    try:
        header = read_header(path)
    except RenderError:
        return "no picture that can be read"
    if header.size != size:
        return size_fault(header.size, size)
    return (
        f"{header.bits} bits per channel instead of 8: convert them yourself"
        if header.bits > 8
        else ""
    )
