"""Names of frames and cameras: the numbers that they bear, and the camera that a picture is of."""

import re
from collections.abc import Iterable, Sequence
from datetime import datetime
from decimal import Decimal
from itertools import pairwise
from pathlib import PurePosixPath
from statistics import median
from typing import Any

Number = int | Decimal
# The last number of a name: the text before it, its digits, and those behind a point, if that is
# the only one.
LAST = re.compile(r"(.*?)(?:(?<![\d.])(\d+)\.)?(\d+)\D*", re.DOTALL)
# File systems take no longer ones.
LONGEST_NAME_BYTES, LONGEST_PATH = 200, 1000
LISTED = 24
STAMP_FROM = 10**9  # seconds since 1970, and all that counts finer
# A time of day, its fields parted by one character or, behind a date, by none; milliseconds or
# finer may follow.
CLOCK = re.compile(
    r"(?<!\d)(?:((?:19|20)\d\d)[-_.]?(\d\d)[-_.]?(\d\d)[-_T ]+)?"
    r"(\d\d)([-_:.]?)(\d\d)\5(\d\d)(?:[-_.:,]?(\d{3}(?:\d{3}){,2}))?(?!\d)"
)
DAY_S = 86_400
SHORTEST_STEP_S = 0.002  # of a clock; finer fields count


class Fields(int):
    """Several numbers of a name in one, the first the most significant: a date and a time of day,
    whose steps say nothing.
    """


def numbers_in(stems: Sequence[str], are_of_one: bool = True) -> list[Number | None]:
    """Return the number of each of the names of one folder's frames, without their suffixes.

    None if there is none.

    It is the last number of a name, unless that is the same in all of them, as the size of the
    pictures is: then the last that varies. Digits, a point and digits are one number, as time
    stamps have it, unless they are fields of a name: then the text before the point is the same in
    all of them, and the digits behind it count. Times of day are read in seconds, see `clock_s`.
    Where the order of that number is not the order of the names' numbers from left to right, or it
    repeats, as the thousandths of a clock do, all those that vary are one.

    Args:
        are_of_one: whether no two of the frames are of one instant, so that several numbers may be
            one.

    Raises:
        ValueError: names that can be read in both ways, each with another order.

    Examples:
        >>> numbers_in(["frame_9", "frame_10", "thumb"])
        [9, 10, None]
        >>> numbers_in(["10.75", "11.0"]), numbers_in(["cam01.0009", "cam01.0010"])
        ([Decimal('10.75'), 11], [9, 10])
        >>> (
        ...     numbers_in(["view_1_64x48", "view_2_64x48"]),
        ...     numbers_in(["10-59-59-800", "11-00-00-000"]),
        ... )
        ([1, 2], [Decimal('39599.800'), Decimal('39600.000')])
    """
    if are_of_one and (clock := _clock_times(stems)):
        return clock
    numbers = _last_numbers(stems)
    parts = [list(re.finditer(r"\d+", stem)) for stem in stems]
    if (
        len(
            {re.sub(r"\d+", "0", stem) for stem, fields in zip(stems, parts, strict=True) if fields}
        )
        != 1
    ):
        return numbers
    columns = list(
        zip(*([field[0] for field in fields] for fields in parts if fields), strict=True)
    )
    varying = [index for index, column in enumerate(columns) if len(set(map(int, column))) > 1]
    keys = [tuple(int(fields[index][0]) for index in varying) for fields in parts if fields]
    is_fraction = (
        any(re.search(r"\d\.\d+\D*$", stem) for stem in stems)
        and len(set(map(len, columns[-1]))) > 1
    )
    if (
        not varying
        or is_fraction
        or _ranks(keys) == _ranks([number for number in numbers if number is not None])
    ):
        return numbers
    upto = [
        stem[: fields[varying[-1]].end()] if fields else stem
        for stem, fields in zip(stems, parts, strict=True)
    ]
    numbers = _last_numbers(upto)
    if not are_of_one or _ranks(keys) == _ranks(
        [number for number in numbers if number is not None]
    ):
        return numbers
    widths = {index: max(map(len, columns[index])) for index in varying}
    return [
        Fields("".join(fields[index][0].zfill(width) for index, width in widths.items()))
        if fields
        else None
        for fields in parts
    ]


def clock_s(text: str) -> Decimal | None:
    """Return the time of day that a text states, seconds since midnight or, with a date, since
    1970; None if there is none.

    Reading:
        Three fields alone may count anything: without a date, milliseconds or finer belong to a
        clock.

    Examples:
        >>> clock_s("cam0_10-59-59-933"), clock_s("2026-05-01_10-59-59"), clock_s("shot_01_02_03")
        (Decimal('39599.933'), Decimal('1777633199'), None)
    """
    match = CLOCK.search(text)
    if not match or not (match[1] or (match[5] and match[8])):
        return None
    year, month, day, hour, _, minute, second, fraction = match.groups()
    try:
        instant = datetime.fromisoformat(
            f"{year or 1970}-{month or '01'}-{day or '01'}T{hour}:{minute}:{second}+00:00"
        )
    except ValueError:
        return None
    return Decimal(
        f"{instant.timestamp():.0f}.{fraction}" if fraction else f"{instant.timestamp():.0f}"
    )


def over_midnight(times: Sequence[Any]) -> list[Any]:
    """Return times of day of one recording, seconds: where it lasts over midnight, those after it
    count on.

    Examples:
        >>> over_midnight([86399.5, 0.5, 1.5])
        [86399.5, 86400.5, 86401.5]
    """
    gap, evening = max(
        ((later - earlier, later) for earlier, later in pairwise(sorted(times))), default=(0, 0)
    )
    return [time + DAY_S * (gap > DAY_S / 2 and time < evening <= DAY_S) for time in times]


def _clock_times(stems: Sequence[str]) -> list[Number | None]:
    """Return the times of day in names that all have one and go in steps of frames.

    Nothing of others.
    """
    times = over_midnight([time for time in map(clock_s, stems) if time is not None])
    steps_s = [later - earlier for earlier, later in pairwise(sorted(times))]
    return [*times] if len(times) == len(stems) > 1 and median(steps_s) >= SHORTEST_STEP_S else []


def _ranks(keys: Sequence[Any]) -> list[int]:
    places = {key: place for place, key in enumerate(sorted(set(keys)))}
    return [places[key] for key in keys]


def _last_numbers(stems: Sequence[str]) -> list[Number | None]:
    groups = [match and match.groups() for match in map(LAST.fullmatch, stems)]
    fields: list[Number | None] = [
        int(last) if (last := group and group[2]) else None for group in groups
    ]
    numbers = [_value(*group[1:]) if group else None for group in groups]
    prefixes = {(prefix, integer) for prefix, integer, _ in filter(None, groups)}
    if len(prefixes) > 1:
        return numbers
    if _order(fields) == _order(numbers) and len(set(numbers)) == len(set(fields)):
        are_seconds = all(integer and int(integer) >= STAMP_FROM for _, integer in prefixes)
        return numbers if are_seconds else fields
    if _are_even(fields) == _are_even(numbers):
        raise ValueError(
            f"{stems[0]}, whose last digits may count or be the fraction of a number: write as "
            f"many in all names"
        )
    return fields if _are_even(fields) else numbers


def is_stamp(number: Number) -> bool:
    """Return whether a number is a time, which was measured, instead of a count."""
    return isinstance(number, Fields) or number >= STAMP_FROM or number != int(number)


def camera_names(image_names: Sequence[str]) -> list[str]:
    """Return the camera that each of a rig's pictures is of, one picture per camera.

    A camera is called like its picture without the suffix; like a folder above it where pictures of
    several cameras are called alike, or where their names are numbers alone, which are those of
    frames.

    Examples:
        >>> (
        ...     camera_names(["images/cam00.png", "images/cam01.png"]),
        ...     camera_names(["cam00/0000.png", "cam01/0000.png"]),
        ... )
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


def _value(integer: str | None, last: str) -> Number:
    number = Decimal(f"{integer}.{last}" if integer else last)
    return int(number) if number == int(number) else number


def _order(numbers: Sequence[Number | None]) -> list[int]:
    return sorted(range(len(numbers)), key=lambda index: numbers[index] or 0)


def _are_even(numbers: Sequence[Number | None]) -> bool:
    ordered = sorted(number for number in numbers if number is not None)
    return len({later - earlier for earlier, later in pairwise(ordered)}) == 1


def is_inside(relative: str) -> bool:
    """Return whether a name in a calibration can be a file's below the capture.

    A hostile model must not lead out of it.
    """
    if not relative.isprintable() or len(relative) >= LONGEST_PATH:
        return False
    path = PurePosixPath(relative)
    fits = all(len(part.encode()) < LONGEST_NAME_BYTES for part in path.parts)
    return fits and bool(path.name) and not path.is_absolute() and ".." not in path.parts


def listed(names: Iterable[str]) -> str:
    """Return the names in a message, not thousands of them."""
    names = list(names)
    return ", ".join(names[:LISTED]) + (
        f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    )
