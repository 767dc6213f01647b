"""Pictures on the screen: what a viewer sees at every instant while a method takes its time.

Methods are evaluated as if every picture were waited for. A viewer sees, at instant t, the newest
picture that was ready by then, and compares it with the world as it is at t. For detection this is
streaming perception (Li, Wang, Ramanan: Towards Streaming Perception, ECCV 2020); here it is
measured of synthesised views. The sequence on the screen is a re-indexing of the renders, so that
it is a row of its own, with the metrics of every other row.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ggvs_eval.protocol import Stream

# frames: what is ready that much after an instant was ready at it, and sums of rounded times make
# no difference
TIE = 1e-6


@dataclass(frozen=True)
class Screen:
    """Displayed frames at each instant of a clip.

    Attributes:
        frames: frame number, counted from the clip's first, of the picture at each instant; None
            while there is none yet.
        latencies_s: from the capture of each picture that is shown to its being ready, in their
            order.
        per_second: pictures that the method can make in a second; infinite where it takes no time.
        warm_up: instants at the beginning that are not scored.
    """

    frames: tuple[int | None, ...]
    latencies_s: tuple[float, ...]
    per_second: float
    warm_up: int = 0

    @property
    def scored(self) -> dict[int, int]:
        """Instants that are scored, those with a picture behind the warm-up, and what they show."""
        lit = enumerate(self.frames[self.warm_up :], self.warm_up)
        return {instant: frame for instant, frame in lit if frame is not None}

    def record(self) -> dict[str, Any]:
        """Counts and times as JSON values: of the instants from the first picture on, and of those
        before it (``dark``).
        """
        lit = [frame for frame in self.frames if frame is not None]
        numbers = sorted(set(lit))
        latencies_ms = [1000 * latency for latency in self.latencies_s]
        return {
            "shown": len(numbers),
            "repeated": len(lit) - len(numbers),
            "dropped": numbers[-1] - numbers[0] + 1 - len(numbers) if numbers else 0,
            "dark": len(self.frames) - len(lit),
            "latency_ms": float(np.mean(latencies_ms)) if latencies_ms else None,
            "latency_p95_ms": float(np.percentile(latencies_ms, 95)) if latencies_ms else None,
            "per_second": self.per_second if math.isfinite(self.per_second) else None,
        }


def on_screen(stages_s: Sequence[float], count: int, stream: Stream) -> Screen:
    """Displayed frames, from the time of each stage of a method.

    A method begins with the newest frame whenever it is free. It is busy with one for the sum of
    its stages, or for the longest of them where stages are pipelined; the picture is ready after
    their sum in either case.

    Args:
        stages_s: seconds of each stage, the same for every frame.
        count: instants of the clip.
        stream: rate of the cameras and policy.

    Examples:
        >>> on_screen([0.0], 4, Stream(fps=10)).frames
        (0, 1, 2, 3)
        >>> on_screen([0.1, 0.1], 6, Stream(fps=10)).frames
        (None, None, 0, 0, 2, 2)
        >>> on_screen([0.1, 0.1], 6, Stream(fps=10, pipelined=True)).frames
        (None, None, 0, 1, 2, 3)

    Reading:
        Li et al. let a detector skip a frame where it is better to wait for the next one (their
        dynamic schedule); here it never waits while a new frame is there. Before an instant means
        at it, too: a picture that takes no time is shown at its own instant, one that takes any
        time at the next. Admission to a pipeline is by its longest stage, so that frames wait
        before it and never in it.
    """
    # in frames
    latency, busy = (
        sum(stages_s) * stream.fps,
        (max if stream.pipelined else sum)(stages_s) * stream.fps,
    )
    allowed = stream.deadline_ms / 1000 * stream.fps if stream.policy == "deadline" else math.inf
    ready: list[tuple[float, int]] = []
    frame, free = 0, 0.0
    while frame < count:
        begun = max(free, float(frame))
        if begun + latency - frame <= allowed + TIE:
            ready.append((begun + latency, frame))
        free = begun + busy
        frame = max(frame + 1, math.floor(free + TIE))
    pictures: list[int | None] = []
    for instant in range(count):
        ready_frames = [number for time, number in ready if time <= instant + TIE]
        pictures.append(ready_frames[-1] if ready_frames else None)
    waits = {number: time - number for time, number in ready}
    latencies = tuple(
        waits[number] / stream.fps
        for number in sorted({frame for frame in pictures if frame is not None})
    )
    return Screen(
        frames=tuple(pictures),
        latencies_s=latencies,
        per_second=stream.fps / busy if busy else math.inf,
        warm_up=stream.warm_up,
    )
