"""Compiled kernels and the two settings they share: the number of threads and the instruction set.

Results depend on neither, bit for bit: work is cut by image regions, not by threads, and no
instruction set contracts or reorders arithmetic. Convolutions of the blending network and its
refiner, IBRNet's layers, deformation fields and VGG take fused multiply-adds, which the baseline
has from the C library at a tenth of the speed. The environment variables ``GGVS_EVAL_THREADS`` and
``GGVS_EVAL_SIMD`` (baseline, avx2, avx512) set the defaults.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

First = TypeVar("First")
Second = TypeVar("Second")
SIMD_LEVELS = ("baseline", "avx2", "avx512")

_settings: dict[str, int] = {}


def set_threads(count: int) -> None:
    """Use `count` threads in every kernel of this process from now on.

    Raises:
        ValueError: count is below 1.
    """
    if count < 1:
        raise ValueError(f"threads: wanted at least 1, got {count}")
    _settings["threads"] = count


def get_threads() -> int:
    """Return the number of threads of a kernel: as set, else ``GGVS_EVAL_THREADS``, else the CPUs
    this process may use.
    """
    if "threads" not in _settings:
        setting = os.environ.get("GGVS_EVAL_THREADS", "")
        if setting and not setting.isdecimal():
            raise ValueError(f"GGVS_EVAL_THREADS: wanted a number of threads, got {setting!r}")
        set_threads(int(setting) if setting else usable_cpus())
    return _settings["threads"]


def side_by_side(first: Callable[[], First], second: Callable[[], Second]) -> tuple[First, Second]:
    """Do two pieces of work that need nothing of each other at the same time, each filling the gaps
    of the other.

    With one thread for all kernels it is one after the other. Errors of either are raised.
    """
    if get_threads() == 1:
        return first(), second()
    with ThreadPoolExecutor(1) as beside:
        future = beside.submit(second)
        return first(), future.result()


def set_simd_level(name: str) -> None:
    """Use one instruction set of `SIMD_LEVELS` from now on.

    Meant for tests and for comparing machines.

    Raises:
        ValueError: unknown name, or this processor lacks it.
    """
    if name not in available_levels():
        raise ValueError(
            f"instruction set: wanted one of {', '.join(available_levels())} on this processor, "
            f"got {name!r}"
        )
    _settings["level"] = SIMD_LEVELS.index(name)


def get_simd_level() -> str:
    """Return the instruction set in use: as set, else ``GGVS_EVAL_SIMD``, else the best one of this
    processor.
    """
    if "level" not in _settings:
        set_simd_level(os.environ.get("GGVS_EVAL_SIMD") or available_levels()[-1])
    return SIMD_LEVELS[_settings["level"]]


def available_levels() -> tuple[str, ...]:
    """Return the instruction sets this processor runs, slowest first."""
    from ggvs_eval.kernels import _core

    return SIMD_LEVELS[: _core.best_level() + 1]


def usable_cpus() -> int:
    """Return the number of CPUs that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
