"""Which rendered frame is which instant: by number where the numbers fit, else by order, and then it is said.

Reading:
    Numbers that are the protocol's are taken as they are. As many consecutive numbers as the protocol has frames (from 0, from 1)
    are its frames in order. Numbers 0 .. n - 1 of a whole capture of n frames are frames of the capture, of which the protocol's
    are used. Everything else keeps its numbers, so that a gap is a gap and never shifts the frames after it.
"""

import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Generic, TypeVar

from ggvs_eval.errors import RenderError
from ggvs_eval.run_folder import as_ranges

Item = TypeVar("Item")


@dataclass(frozen=True)
class Numbered(Generic[Item]):
    """Items by frame number.

    Attributes:
        frames: frame number of the protocol -> item.
        extras: items that are no frame of the protocol; where two claim one number, both.
        note: how the numbers were understood; empty where there was nothing to understand.
    """

    frames: dict[int, Item]
    extras: tuple[Item, ...]
    note: str = ""


def last_number(name: str) -> int | None:
    """The last number in a name, e.g. 12 of ``frame_0012``."""
    numbers = re.findall(r"\d+", name)
    return int(numbers[-1]) if numbers else None


def number_files(files: Sequence[PurePath], frames: range, n_frames: int) -> Numbered[PurePath]:
    """`number_items` by the last number in the files' names."""
    return number_items([(last_number(file.stem), file) for file in files], frames, n_frames)


def number_items(items: Sequence[tuple[int | None, Item]], frames: range, n_frames: int) -> Numbered[Item]:
    """Give the items of one view the protocol's frame numbers.

    Args:
        items: number in its name, and item.
        frames: frame numbers of the protocol.
        n_frames: frames of the whole capture.
    """
    if len(items) == 1 and len(frames) == 1:
        return Numbered({frames[0]: items[0][1]}, ())
    by_number: dict[int | None, list[Item]] = defaultdict(list)
    for number, item in items:
        by_number[number].append(item)
    unique = {number: found[0] for number, found in by_number.items() if number is not None and len(found) == 1}
    unclear = tuple(item for number, found in by_number.items() if number is None or len(found) > 1 for item in found)
    offset, note = _offset(sorted(unique), frames, n_frames)
    numbered = {number + offset: item for number, item in sorted(unique.items())}
    inside = {number: item for number, item in numbered.items() if number in frames}
    if len(unique) == n_frames > len(frames) and sorted(unique) == list(range(n_frames)):
        return Numbered(inside, unclear, f"frames {as_ranges(list(frames))} of the {n_frames} of the whole capture are used")
    return Numbered(inside, unclear + tuple(item for number, item in numbered.items() if number not in frames), note)


def _offset(numbers: list[int], frames: range, n_frames: int) -> tuple[int, str]:
    """What to add to the numbers, and the note that says so."""
    consecutive = bool(numbers) and numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    if not consecutive or len(numbers) != len(frames) or numbers[0] == frames.start:
        return 0, ""
    return frames.start - numbers[0], f"frames numbered {as_ranges(numbers)} are taken as {as_ranges(list(frames))}, in order"


def number_stream(count: int, frames: range, n_frames: int, name: str) -> Numbered[int]:
    """Give the frames of a video or stack, which have an order and no numbers, the protocol's frame numbers.

    Args:
        count: how many there are.
        frames: frame numbers of the protocol.
        n_frames: frames of the whole capture.
        name: whose frames they are, for the message.

    Returns:
        Frame number -> index in the stream.

    Raises:
        RenderError: more frames than the protocol's, but not the whole capture, while the protocol starts inside it: nobody
            can tell which are meant.
    """
    if count == n_frames > len(frames):
        note = f"frames {as_ranges(list(frames))} of the {n_frames} of the whole capture are used"
        return Numbered({number: number for number in frames}, (), note)
    if count > len(frames) and frames.start > 0:
        raise RenderError(
            f"{name}: wanted {len(frames)} frames (the protocol's) or {n_frames} (the whole capture), got {count}; "
            "cut it to the protocol's frames"
        )
    indices = {number: index for index, number in enumerate(frames) if index < count}
    note = f"{count} frames are taken as {as_ranges(list(indices))}, in order" if frames.start > 0 else ""
    return Numbered(indices, tuple(range(len(frames), count)), note)
