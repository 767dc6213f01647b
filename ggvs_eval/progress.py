"""Progress of everything that takes longer than a blink: a bar on a terminal, lines elsewhere."""

import sys
import threading
import time
from collections.abc import Iterable, Iterator, Sized
from typing import TypeVar

Item = TypeVar("Item")
LOOK_BACK_S = 3600.0  # over which speed is estimated
LINE_EVERY_S = 60.0  # where the output is no terminal


def track(items: Iterable[Item], description: str, total: int | None = None) -> Iterator[Item]:
    """Yield the items with a bar, the elapsed time and the time left.

    Where the output is no terminal, with a line per minute.

    Args:
        items: what is worked on; consumed lazily.
        total: number of items where `len(items)` is not available.
    """
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
    )
    console = Console(stderr=True)
    if total == 0 or (isinstance(items, Sized) and not len(items)):
        # in silence: a line of nothing says nothing, and a count may have been rounded down
        yield from items
        return
    if not console.is_terminal:
        yield from _with_lines(
            items, description, len(items) if total is None and isinstance(items, Sized) else total
        )
        return
    # The default looks back 30 s and shows no time left for jobs that take longer.
    bar = Progress(
        *columns, TimeRemainingColumn(), console=console, speed_estimate_period=LOOK_BACK_S
    )
    with bar as progress:
        yield from progress.track(items, description=description, total=total)


def _with_lines(items: Iterable[Item], description: str, total: int | None) -> Iterator[Item]:
    """Yield the items; a line says every minute how far they are, and one at their end how long
    they took.
    """
    begun_s, count, ended = time.monotonic(), 0, threading.Event()

    def tell() -> None:
        taken_s = time.monotonic() - begun_s
        left_s = (
            taken_s / count * (total - count) if count and total and not ended.is_set() else None
        )
        left = "" if left_s is None else f", about {duration(left_s)} left"
        of_total = "" if total is None else f" of {total}"
        print(
            f"{description}: {count}{of_total} in {duration(taken_s)}{left}",
            file=sys.stderr,
            flush=True,
        )

    def tell_every_minute() -> None:
        while not ended.wait(LINE_EVERY_S):
            tell()

    threading.Thread(target=tell_every_minute, daemon=True).start()
    try:
        for item in items:
            yield item
            count += 1
    finally:
        ended.set()
    tell()


def duration(seconds: float) -> str:
    """Return a length of time in the unit that suits it."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def counted(count: int, noun: str) -> str:
    """Return a number of things.

    Examples:
        >>> counted(1, "frame"), counted(2, "frame")
        ('1 frame', '2 frames')
    """
    return f"{count} {noun}{'s' * (count != 1)}"
