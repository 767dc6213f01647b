"""Numbering of rendered frames: one decision for all views of a method, reported, and an error
where there are two.

Reading:
    Numbers in names are instants of the capture, counted from 0; or from 1 if they fit the protocol
    only then, and the protocol starts with the capture or the last number is one that no instant
    counted from 0 has. Numbers beyond the capture are counted from their first where that gives the
    whole capture, or a protocol that starts with it. What fits in two ways, or would fit only if
    counted from the protocol's first frame, is an error: ``--first-frame`` says which number that
    frame bears, and then nothing is guessed. Pictures are never compared: a method that is one
    frame late would be put right in silence.
"""

import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, NamedTuple, TypeVar

from ggvs_eval.errors import RenderError
from ggvs_eval.files.listing import same_name
from ggvs_eval.files.names import numbers_in
from ggvs_eval.renders.request import FrameRequest, as_word
from ggvs_eval.run_folder import as_ranges

Item = TypeVar("Item")
Numbers = Collection[int]


@dataclass(frozen=True)
class Numbered(Generic[Item]):
    """The items of each view by instant.

    Attributes:
        frames: view -> frame number of the protocol -> item.
        extras: view -> items that are no frame of the protocol.
        doubles: view -> frame number -> the several items that claim it.
        first: the number that the capture's first instant bears.
        note: the decision, in one line.
    """

    frames: Mapping[str, Mapping[int, Item]]
    extras: Mapping[str, Sequence[Item]]
    doubles: Mapping[str, Mapping[int, Sequence[Item]]]
    first: int
    note: str


class Place(NamedTuple):
    """Parts of a picture's name: its view, its frame number, and the number of further numbers in
    it.
    """

    view: str
    number: int | None
    n_numbers: int


def frame_numbers(folder: Path, stems: Sequence[str], view: str = "") -> list[int | None]:
    """The last whole number in each name, e.g. 12 of ``frame_0012``.

    One that is part of the view's name (``cam00``) is none.
    """
    names = (
        stems if view.isdigit() or not view else [re.sub(as_word(view), "", stem) for stem in stems]
    )
    try:
        numbers = numbers_in(names, are_of_one=False)
    except ValueError as error:
        raise RenderError(
            f"{folder}: wanted pictures whose numbers can be read in one way, got {error}"
        ) from None
    return [number if isinstance(number, int) else None for number in numbers]


def places_of(folder: Path, names: Iterable[str], views: Sequence[str]) -> list[Place | None]:
    """Return view and frame of relative names, without suffix.

    None unless exactly one view's name is in it once as a word.
    """
    places: list[tuple[str, str] | None] = []
    for name in map(same_name, names):
        matches = [
            (view, match) for view in views for match in re.finditer(as_word(same_name(view)), name)
        ]
        view, match = matches[0] if len(matches) == 1 else ("", None)
        places.append((view, f"{name[: match.start()]}|{name[match.end() :]}") if match else None)
    numbers = iter(frame_numbers(folder, [remainder for _, remainder in filter(None, places)]))
    return [
        Place(place[0], next(numbers), len(re.findall(r"\d+", place[1]))) if place else None
        for place in places
    ]


def number_views(
    path: Path, views: Mapping[str, Sequence[tuple[int | None, Item]]], request: FrameRequest
) -> Numbered[Item]:
    """Give the items of all views the protocol's frame numbers.

    Args:
        views: view -> number in the name, and item, of each of its items.
        request: frames of the protocol and of the capture, and what the user says of the numbers.

    Raises:
        RenderError: views that are numbered differently, or numbers that fit in several ways or in
            none.
    """
    is_alone = request.n_frames == 1 and request.first_frame is None  # then its number says nothing
    if len(request.frames) == 1 and all(
        len(items) == 1 and (is_alone or items[0][0] is None) for items in views.values()
    ):
        alone = {view: {request.frames[0]: items[0][1]} for view, items in views.items()}
        return Numbered(
            frames=alone,
            extras={},
            doubles={},
            first=0,
            note=f"the only frame of each view is assumed to be instant {request.frames[0]}",
        )
    numbers = {
        view: {number for number, _ in items if number is not None} for view, items in views.items()
    }
    try:
        first, note = _decide(numbers, request)
    except RenderError as error:
        raise RenderError(f"{path}: {error}") from None
    frames: dict[str, dict[int, Item]] = {}
    extras: dict[str, list[Item]] = {}
    doubles: dict[str, dict[int, Sequence[Item]]] = {}
    for view, items in views.items():
        by_frame: dict[int, list[Item]] = defaultdict(list)
        for number, item in items:
            if number is not None:
                by_frame[number - first].append(item)
        frames[view] = {
            frame: some[0]
            for frame, some in by_frame.items()
            if frame in request.frames and len(some) == 1
        }
        doubles[view] = {
            frame: some
            for frame, some in by_frame.items()
            if frame in request.frames and len(some) > 1
        }
        is_clear = request.first_frame is not None or set(by_frame) == set(range(request.n_frames))
        allowed = range(request.n_frames) if is_clear else request.frames
        beyond = [item for frame, some in by_frame.items() if frame not in allowed for item in some]
        extras[view] = [item for number, item in items if number is None] + beyond
    return Numbered(frames=frames, extras=extras, doubles=doubles, first=first, note=note)


def _decide(numbers: Mapping[str, Numbers], request: FrameRequest) -> tuple[int, str]:
    """Return the number that the capture's first instant bears, and the line that says so."""
    all_numbers = sorted(set().union(*numbers.values()))
    if not all_numbers:
        return 0, "no frame has a number in its name"
    if request.first_frame is not None:
        first = request.first_frame - request.frames.start
        return (
            first,
            f"numbered by --first-frame {request.first_frame}: "
            f"{_taken(all_numbers, first, request)}",
        )
    _refuse_unlike(numbers, request)
    first = _first_number(all_numbers, request)
    origin = f"numbered from {first}:" if first else "frames" if len(all_numbers) > 1 else "frame"
    return first, f"{origin} {_taken(all_numbers, first, request)}"


def _first_number(numbers: Sequence[int], request: FrameRequest) -> int:
    """Return the number of the capture's first instant, from the numbers of all views."""
    if numbers[0] > request.n_frames:
        return _beyond(numbers, request)
    from_0, from_1 = (_fits(numbers, first, request) for first in (0, 1))
    lacks_0, lacks_1 = (not _shifted(numbers, first).issuperset(request.frames) for first in (0, 1))
    ends_past = numbers[-1] == request.n_frames  # the last of a capture that is numbered from 1
    if _is_run(numbers, len(request.frames)) and lacks_0 and lacks_1:
        raise RenderError(
            f"frames are numbered {as_ranges(list(numbers))}, the protocol uses the instants "
            f"{as_ranges(list(request.frames))} of 0-{request.n_frames - 1}; render those, or give "
            f"--first-frame {numbers[0]} if number {numbers[0]} shows instant "
            f"{request.frames.start}"
        )
    if numbers[0] == 0 or (from_0 and not lacks_0):
        return 0
    if (from_1 and not from_0) or (lacks_0 and not lacks_1):
        if request.frames.start == 0 or ends_past:
            return 1
        raise _ambiguous(numbers, request)
    if (from_0 and from_1) or not (lacks_0 or lacks_1 or ends_past):
        raise _ambiguous(numbers, request)
    return 1 if ends_past else 0


def _fits(numbers: Sequence[int], first: int, request: FrameRequest) -> bool:
    """Return whether numbers are frames of the protocol alone, or the whole capture, if its first
    instant has number `first`.
    """
    shifted = _shifted(numbers, first)
    return shifted.issubset(request.frames) or shifted == set(range(request.n_frames))


def _beyond(numbers: Sequence[int], request: FrameRequest) -> int:
    """Return the first of numbers of which none can be an instant."""
    shifted = _shifted(numbers, numbers[0])
    if shifted == set(range(request.n_frames)) or (
        request.frames.start == 0 and shifted == set(request.frames)
    ):
        return numbers[0]
    raise RenderError(
        f"frames are numbered {as_ranges(list(numbers))}, the capture has the instants "
        f"0-{request.n_frames - 1}; number them by instant, or give by --first-frame the number of "
        f"instant {request.frames.start}"
    )


def _ambiguous(numbers: Sequence[int], request: FrameRequest) -> RenderError:
    """The error of numbers that may be counted from 0 or from 1."""
    start = request.frames.start
    return RenderError(
        f"frames are numbered {as_ranges(list(numbers))}, which can be the instants "
        f"{as_ranges(list(numbers))} or, counted from 1, "
        f"{as_ranges([number - 1 for number in numbers])}, and the protocol uses "
        f"{as_ranges(list(request.frames))}; name them by instant, or give --first-frame {start} "
        f"if number {start} shows instant {start}, --first-frame {start + 1} if number {start + 1} "
        "does"
    )


def _refuse_unlike(numbers: Mapping[str, Numbers], request: FrameRequest) -> None:
    """Refuse views that hold the wanted frames under different numbers."""
    firsts = {}
    for view, view_numbers in numbers.items():
        if _is_run(sorted(view_numbers), len(request.frames)):
            firsts[view] = min(view_numbers) - request.frames.start
        elif _is_run(sorted(view_numbers), request.n_frames):
            firsts[view] = min(view_numbers)
    if len(set(firsts.values())) > 1:
        odd = list({first: view for view, first in firsts.items()}.values())
        listed = ", ".join(f"{view} {as_ranges(sorted(numbers[view]))}" for view in odd)
        raise RenderError(
            f"views are numbered differently: {listed}; wanted one numbering for all views, rename "
            f"the frames"
        )


def _is_run(numbers: Sequence[int], count: int) -> bool:
    return len(numbers) == count and numbers[-1] - numbers[0] == count - 1


def _shifted(numbers: Numbers, first: int) -> set[int]:
    return {number - first for number in numbers}


def _taken(numbers: Sequence[int], first: int, request: FrameRequest) -> str:
    inside = [number for number in numbers if number - first in request.frames]
    instants = as_ranges([number - first for number in inside])
    if not inside:
        return (
            f"{as_ranges(list(numbers))} are used as the instants "
            f"{as_ranges(sorted(_shifted(numbers, first)))} of the capture"
        )
    if len(inside) == 1 == len(numbers):
        return f"{inside[0]} is used as the instant {instants} of the capture"
    if _shifted(numbers, first) == set(range(request.n_frames)) and len(inside) < len(numbers):
        origin = f"of {as_ranges(list(numbers))}, the whole capture, {as_ranges(inside)} are used"
        return f"{origin} as the instants {instants}" if first else origin
    return f"{as_ranges(inside)} are used as the instants {instants} of the capture"


def number_streams(path: Path, counts: Mapping[str, int], request: FrameRequest) -> Numbered[int]:
    """Give the frames of videos or stacks, which have an order and no numbers, the protocol's frame
    numbers.

    Args:
        counts: view -> how many frames there are.
        request: frames of the protocol and of the capture; ``first_frame`` is a place in the stream
            here.

    Returns:
        View -> frame number -> index in the stream.

    Raises:
        RenderError: more frames than the protocol's, but not the whole capture, while the protocol
            starts inside it, or the whole capture in some views alone: which are meant cannot be
            known.
    """
    start, n_wanted, n_frames = request.frames.start, len(request.frames), request.n_frames
    is_whole = n_wanted < n_frames and all(count == n_frames for count in counts.values())
    first_frame = request.first_frame
    if (
        first_frame is None
        and start
        and not is_whole
        and any(count > n_wanted for count in counts.values())
    ):
        listed = ", ".join(f"{view} {count}" for view, count in counts.items())
        raise RenderError(
            f"{path}: wanted {n_wanted} frames of each view (the protocol's) or {n_frames} (the "
            f"whole capture), got {listed}; cut them to the protocol's frames, or give by "
            f"--first-frame the frame, counted from 0, of instant {start}"
        )
    # index of the capture's first instant
    first = first_frame - start if first_frame is not None else 0 if is_whole else -start
    frames = {
        v: {frame: frame + first for frame in request.frames if 0 <= frame + first < count}
        for v, count in counts.items()
    }
    unused = {
        view: [] if is_whole or first_frame is not None else list(range(n_wanted, count))
        for view, count in counts.items()
    }
    instants = as_ranges(list(request.frames))
    note = f"the frames of each view are used, in order, as the instants {instants}"
    if first_frame is not None:
        note = (
            f"by --first-frame {first_frame}, frame {first_frame} of each view (counted from 0) "
            f"shows instant {start}"
        )
    elif is_whole:
        note = (
            f"each view has the {n_frames} frames of the whole capture, of which {instants} are "
            "used"
        )
    return Numbered(frames=frames, extras=unused, doubles={}, first=0, note=note)
