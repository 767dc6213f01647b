"""One progress bar for everything that takes longer than a blink."""

from collections.abc import Iterable, Iterator
from typing import TypeVar

Item = TypeVar("Item")
LOOK_BACK_S = 3600.0  # over which speed is estimated


def track(items: Iterable[Item], description: str, total: int | None = None) -> Iterator[Item]:
    """Yield the items with a bar, the elapsed time and the time left; silent where the output is not a terminal.

    Args:
        items: what is worked on; consumed lazily.
        description: what is being done, a few words.
        total: number of items where `len(items)` does not tell.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("left"))
    console = Console(stderr=True)
    # The default looks back 30 s and shows no time left for jobs that take longer.
    bar = Progress(
        *columns, TimeRemainingColumn(), console=console, disable=not console.is_terminal, speed_estimate_period=LOOK_BACK_S
    )
    with bar as progress:
        yield from progress.track(items, description=description, total=total)


def duration(seconds: float) -> str:
    """A length of time in the unit that suits it."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"
