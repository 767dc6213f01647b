"""One progress line per training: bars on a terminal, a line at each tenth elsewhere."""

import sys
from collections.abc import Mapping
from types import TracebackType

from ggvs_eval.progress import LOOK_BACK_S

TENTHS = 10


class ProgressLines:
    """Lines for things that advance side by side; a context manager.

    Args:
        steps: name -> steps of each.
    """

    def __init__(self, steps: Mapping[str, int]) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

        console = Console(stderr=True)
        self._steps = dict(steps)
        self._tenths = dict.fromkeys(steps, -1)
        self._bars = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
            speed_estimate_period=LOOK_BACK_S,
        )
        self._tasks = {name: self._bars.add_task(name, total=total) for name, total in steps.items()}

    def __enter__(self) -> "ProgressLines":
        self._bars.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._bars.stop()

    def show(self, name: str, done: int) -> None:
        """So many steps are done."""
        self._bars.update(self._tasks[name], completed=done)
        tenth = TENTHS * done // max(self._steps[name], 1)
        if self._bars.disable and tenth > self._tenths[name]:
            self._tenths[name] = tenth
            print(f"{name}: {done} of {self._steps[name]} steps", file=sys.stderr, flush=True)

    def end(self, name: str, failed: bool) -> None:
        """Nothing more will be done."""
        outcome = "failed" if failed else "done"
        self._bars.update(self._tasks[name], description=f"{name}: {outcome}")
        self._bars.stop_task(self._tasks[name])
        if self._bars.disable:
            print(f"{name}: {outcome}", file=sys.stderr, flush=True)
