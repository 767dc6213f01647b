"""Names of frames and cameras: the numbers that they bear, and the camera that a picture is of."""

import re
from collections.abc import Sequence
from decimal import Decimal
from itertools import pairwise
from pathlib import PurePosixPath

Number = int | Decimal
# The last number of a name: the text before it, its digits, and those behind a point, if that is the only one.
LAST = re.compile(r"(.*?)(?:(?<![\d.])(\d+)\.)?(\d+)\D*", re.DOTALL)
STAMP_FROM = 10**9  # seconds since 1970, and all that counts finer


def numbers_in(stems: Sequence[str]) -> list[Number | None]:
    """Return the last number in each of the names of one folder's frames, without their suffixes; None where there is none.

    Digits, a point and digits are one number, as time stamps have it, unless they are fields of a name: then the text before
    the point is the same in all of them, and the digits behind it count.

    Raises:
        ValueError: names that can be read in both ways, each with another order.

    Examples:
        >>> numbers_in(["frame_9", "frame_10", "thumb"])
        [9, 10, None]
        >>> numbers_in(["10.75", "11.0"]), numbers_in(["cam01.0009", "cam01.0010"])
        ([Decimal('10.75'), 11], [9, 10])
    """
    found = [match and match.groups() for match in map(LAST.fullmatch, stems)]
    fields: list[Number | None] = [int(last) if (last := each and each[2]) else None for each in found]
    numbers = [_value(*each[1:]) if each else None for each in found]
    before = {(prefix, whole) for prefix, whole, _ in filter(None, found)}
    if len(before) > 1:
        return numbers
    if _order(fields) == _order(numbers) and len(set(numbers)) == len(set(fields)):
        are_seconds = all(whole and int(whole) >= STAMP_FROM for _, whole in before)
        return numbers if are_seconds else fields
    if _are_even(fields) == _are_even(numbers):
        raise ValueError(f"{stems[0]}, whose last digits may count or be the fraction of a number: write as many in all names")
    return fields if _are_even(fields) else numbers


def is_stamp(number: Number) -> bool:
    """Return whether a number is a time, which was measured, instead of a count."""
    return number >= STAMP_FROM or number != int(number)


def camera_names(image_names: Sequence[str]) -> list[str]:
    """Return the camera that each of a rig's pictures is of, one picture per camera.

    A camera is called like its picture without the suffix; like a folder above it where pictures of several cameras are called
    alike, or where their names are numbers alone, which are those of frames.

    Examples:
        >>> camera_names(["images/cam00.png", "images/cam01.png"]), camera_names(["cam00/0000.png", "cam01/0000.png"])
        (['cam00', 'cam01'], ['cam00', 'cam01'])
    """
    paths = [PurePosixPath(name) for name in image_names]
    stems = [path.stem for path in paths]
    depth = min((len(path.parts) for path in paths), default=0)
    folders = [[path.parts[-level] for path in paths] for level in range(2, depth + 1)]
    unlike = next((names for names in folders if len(set(names)) == len(paths)), None)
    are_numbers = all(stem.isdecimal() for stem in stems)
    if len(set(stems)) == len(stems) and not (are_numbers and unlike):
        return stems
    return unlike or [path.parent.name or path.stem for path in paths]


def _value(whole: str | None, last: str) -> Number:
    number = Decimal(f"{whole}.{last}" if whole else last)
    return int(number) if number == int(number) else number


def _order(numbers: Sequence[Number | None]) -> list[int]:
    return sorted(range(len(numbers)), key=lambda index: numbers[index] or 0)


def _are_even(numbers: Sequence[Number | None]) -> bool:
    ordered = sorted(number for number in numbers if number is not None)
    return len({later - earlier for earlier, later in pairwise(ordered)}) == 1
