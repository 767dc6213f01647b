"""This machine: free memory, of the machine or the container, the time of known work, and how long
tasks take by it.
"""

import threading
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from time import perf_counter

import cv2
import numpy as np

from ggvs_eval.tasks.task import Made, Result, read_record

CGROUP = Path("/sys/fs/cgroup")
MEMINFO = Path("/proc/meminfo")
SELF = Path("/proc/self")
KIB = 1024
SAMPLED_EVERY_S = 0.05
# of the probe on the machine for which times are given: two quiet cores of a Xeon with AVX-512
REFERENCE_S = 0.40
SIZE, PRODUCTS, MATCHES = 768, 60, 10


def available_bytes(meminfo: Path = MEMINFO, cgroup: Path = CGROUP) -> float:
    """Return the memory available without swapping; infinite where the system does not report it.

    Args:
        cgroup: the account of the container (control groups, version 2); its limit may be lower
            than the machine's.
    """
    machine = _field(meminfo, "MemAvailable:", KIB)
    try:
        limit, usage = (
            float((cgroup / "memory.max").read_text()),
            float((cgroup / "memory.current").read_text()),
        )
    except (OSError, ValueError):  # no control groups, or a limit of "max"
        return machine
    # files the kernel drops when memory is asked for
    cached = _field(cgroup / "memory.stat", "inactive_file", 1)
    return min(machine, limit - usage + (cached if cached != float("inf") else 0))


def resident_bytes(pids: Iterable[int]) -> tuple[float, float]:
    """Sum the resident memory of processes, and find the highest peak of any one.

    0 if the system does not report it.
    """
    total, most = 0.0, 0.0
    for pid in pids:
        status = Path(f"/proc/{pid}/status")
        resident, highest = _field(status, "VmRSS:", KIB), _field(status, "VmHWM:", KIB)
        if resident != float("inf"):
            total, most = total + resident, max(most, highest)
    return total, most


class PeakMemory:
    """Highest resident memory of this process while a block of code runs, looked at every
    `SAMPLED_EVERY_S`.

    The kernel's own peak would be exact; it is of the process's whole life, and to reset it would
    hide from `has_room` what earlier jobs have needed.

    Attributes:
        bytes: the peak; None if the system does not report it.
    """

    def __init__(self, process: Path = SELF) -> None:
        self.bytes: int | None = None
        self._status, self._is_over = process / "status", threading.Event()
        self._watcher = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> "PeakMemory":
        self._look()
        self._watcher.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over.set()
        self._watcher.join()
        self._look()

    def _watch(self) -> None:
        while not self._is_over.wait(SAMPLED_EVERY_S):
            self._look()

    def _look(self) -> None:
        resident = _field(self._status, "VmRSS:", KIB)
        if resident != float("inf"):
            self.bytes = max(self.bytes or 0, int(resident))


def has_room(running: int, pids: Iterable[int]) -> bool:
    """Return whether one more job fits next to those that run, if each needs as much as the largest
    has needed so far.

    Args:
        running: jobs that are being worked on; what they have not taken yet is kept for them.
    """
    resident, most = resident_bytes(pids)
    return available_bytes() + resident >= (running + 1) * most


def _field(file: Path, name: str, unit_bytes: int) -> float:
    """Return a number from a file of `name number` lines, in bytes.

    Infinite where it is not there.
    """
    try:
        for line in file.read_text().splitlines():
            if line.startswith(name):
                return float(line.split()[1]) * unit_bytes
    except OSError:  # another system, or a process that is gone
        pass
    return float("inf")


@cache
def pace() -> float:
    """Seconds that work takes here for each second on the reference machine.

    Cores that are busy now count as slow ones.
    """
    return probe_s() / REFERENCE_S


def probe_s() -> float:
    """Seconds of the work that evaluations mostly do: products of matrices, as of convolutions, and
    semi-global matching.
    """
    random = np.random.default_rng(0)
    matrix = random.random((SIZE, SIZE), np.float32)
    image = random.integers(0, 256, (360, 480), np.uint8)
    matcher = cv2.StereoSGBM.create(0, 64, 3)
    started = perf_counter()
    for _ in range(PRODUCTS):
        matrix @ matrix
    for _ in range(MATCHES):
        matcher.compute(image, image)
    return perf_counter() - started


@dataclass(frozen=True)
class Estimate:
    """Time of some results.

    Attributes:
        seconds: of a core, for those that are known.
        unknown: number of files, maps or scenes without an estimate.
    """

    seconds: float
    unknown: int


def estimate(
    left: Iterable[Result], history: Iterable[Made] = (), pace: Callable[[], float] = pace
) -> Estimate:
    """Return the time that results take.

    Args:
        history: results that were made here.
        pace: seconds that a core-second of `Result.cost_s` takes here; called where a cost is used.
    """
    paces = _paces(history)
    seconds, unknown = 0.0, 0
    for result in left:
        word = result.pace or result.kind
        if word in paces:
            seconds += result.count * paces[word]
        elif result.cost_s is not None:
            seconds += result.count * result.cost_s * pace()
        else:
            unknown += result.count
    return Estimate(seconds, unknown)


def _paces(history: Iterable[Made]) -> dict[str, float]:
    """Return the mean seconds of a file for each word of pace."""
    took: dict[str, list[float]] = defaultdict(list)
    for result in history:
        # of each stage of each file, or of all together
        seconds = read_record(result.folder).get("seconds")
        if seconds:
            total = sum(map(sum, seconds.values())) if isinstance(seconds, dict) else seconds
            took[result.pace or result.kind].append(total / max(result.count, 1))
    return {word: sum(seconds) / len(seconds) for word, seconds in took.items()}
