"""Roofline of the kernels of the online step on this machine: ``python -m
benchmarks.bench_roofline``.

One step at 1352 x 1014 with K = 4 is recorded; then each of its kernels is called again with the
same arguments on one thread, in processor time, which a loaded machine does not lengthen much. Its
roof is the time that its operations take at the measured peak of arithmetic, or its bytes at the
measured peak of memory, whichever is longer; the share is roof over time.

Reading:
    Bytes are those of arguments and results, each moved once. Operations are those carried out,
    lanes that mean nothing included: counts per Gaussian, ray or pixel are in `OPERATIONS`, of
    which those of splat and march were counted in this scene.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from time import thread_time
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from benchmarks.bench_online import SETTINGS, _figure, _images, _instant, _scene
from ggvs_eval import kernels
from ggvs_eval.compute_device import one_thread
from ggvs_eval.kernels import _core as _COMPILED
from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided
from ggvs_eval.pipelines.online.network_blender import NetworkBlender

COMMAND = "python -m benchmarks.bench_roofline"
FRAMES = 3  # the last is recorded: by then every stage has a past
REPEATS = 7
SMALL = 16  # numbers of a matrix that is no map
# blocks of 4 x 4 pixels that a Gaussian touches; 28 % of the lanes are pixels that it reaches
LANES_PER_GAUSSIAN = 4.2 * 16
SAMPLES_PER_RAY = 8.6
# multiplications a pixel and packed filter value of convolutions of 3 x 3: one filters four rows
MINIMAL = 0.25
# Floating-point operations per pixel of a result, of all views; splat: of a source.
OPERATIONS: dict[str, Callable[["Call"], float]] = {
    "splat": lambda call: LANES_PER_GAUSSIAN * (26 + 2 * (1 + call.arguments[4])),
    "ray_march": lambda call: SAMPLES_PER_RAY * 60 * len(call.arguments[2]),
    "fusion_weights": lambda call: 49 * 4,
    "register_views": lambda call: 170 * len(call.arguments[2]),
    "compose": lambda call: 22 * len(call.arguments[0]) + 60,
    "overview": lambda call: 16 * len(call.arguments[0]),
    "register_and_overview": lambda call: 186 * len(call.arguments[2]),
    "refine": lambda call: (
        2
        * (
            sum(MINIMAL * look[0].size for look in call.arguments[7][:-1])
            + call.arguments[7][-1][0].size
        )
        + 140
    ),
    "mix_depth": lambda call: 8,
}


@dataclass(frozen=True)
class Call:
    """One call of a kernel."""

    name: str
    arguments: tuple[Any, ...]
    result: Any

    def operations(self) -> float | None:
        """Floating-point operations; None where they were not counted."""
        if self.name == "unet":
            return self._unet_operations()
        if self.name not in OPERATIONS:
            return None
        pixels = next(
            each.size
            for each in _arrays((self.result, self.arguments))
            if each.ndim == 2 and each.size > SMALL
        )
        return OPERATIONS[self.name](self) * pixels

    def _unet_operations(self) -> float:
        """Count those of the 3 x 3 convolutions: four levels down, the bottleneck, four
        levels up.
        """
        channels, layers = self.arguments[0], self.arguments[1]
        levels = [min(n // 2, 8 - n // 2) for n in range(len(layers))]
        pixels = channels.shape[1] * channels.shape[2]
        return float(
            sum(
                2 * MINIMAL * layer[0].size * pixels / 4**level
                for layer, level in zip(layers, levels, strict=True)
            )
        )

    def bytes_moved(self) -> int:
        """Of the arrays that go in and come out."""
        return sum(array.nbytes for array in (*_arrays(self.arguments), *_arrays(self.result)))


@dataclass
class _Recorder:
    """Replacement of the compiled module that records its calls."""

    calls: list[Call] = field(default_factory=list)

    def __getattr__(self, name: str) -> Callable[..., Any]:
        function = getattr(_COMPILED, name)

        def recorded(*arguments: Any) -> Any:
            result = function(*arguments)
            if name not in ("empty", "idle_bytes", "forget_idle", "best_level"):
                self.calls.append(Call(name, arguments, result))
            return result

        return recorded


def measure() -> dict[str, dict[str, Any]]:
    """Return the processor time of each kernel of a step, its share of its roof, AVX2 and AVX-512,
    and the step's memory.
    """
    arithmetic, memory = peak_operations(), peak_bytes()
    figures = {
        "roofline_peak_arithmetic": _one(arithmetic / 1e9, "GFLOP/s", higher=True),
        "roofline_peak_memory": _one(memory / 1e9, "GB/s", higher=True),
    }
    recorder = _Recorder()
    method = _record_step(recorder)
    groups: dict[str, list[Call]] = defaultdict(list)
    for call in recorder.calls:
        groups[call.name].append(call)
    best, slower = kernels.available_levels()[-1], kernels.available_levels()[-2:][0]
    totals = {level: 0.0 for level in (best, slower)}
    for name, calls in groups.items():
        seconds = {level: _fastest(calls, level) for level in totals}
        totals = {level: totals[level] + seconds[level] for level in totals}
        counts, moved = (
            [call.operations() for call in calls],
            sum(call.bytes_moved() for call in calls),
        )
        operations = sum(count or 0.0 for count in counts)
        roof = max(operations / arithmetic, moved / memory)
        label = f"roofline_{name}"
        figures |= {
            label: _one(1e3 * seconds[best], "CPU ms"),
            f"{label}_operations": _one(operations / 1e9, "GFLOP"),
            f"{label}_bytes": _one(moved / 1e6, "MB"),
            f"{label}_share": _one(100 * roof / seconds[best], "% of its roof", higher=True),
            f"{label}_{slower}": _one(seconds[slower] / seconds[best], f"x {best}"),
        }
        figures[f"{label}_results"] = _one(
            sum(each.nbytes for call in calls for each in _arrays(call.result)) / 1e6, "MB made"
        )
    figures |= {
        "roofline_all_kernels": _one(1e3 * totals[best], "CPU ms"),
        f"roofline_all_kernels_{slower}": _one(
            totals[slower] / totals[best], f"x {best}", target=1.8
        ),
        "step_memory_results": _one(
            sum(figures[f"roofline_{name}_results"]["value"] for name in groups), "MB made by all"
        ),
        "step_memory_kept_for_results": _one(
            _COMPILED.idle_bytes() / 1e6, "MB kept for the next step"
        ),
        "step_memory_peak": _one(_peak_megabytes(), "MB, of the whole process"),
    }
    del method
    return figures


def _record_step(recorder: _Recorder) -> GeometryGuided:
    """Record the kernels of the last of some frames.

    The method, whose state they may share, is returned.
    """
    setting = SETTINGS[0]
    scene, method = _scene(setting), GeometryGuided(blender=NetworkBlender())
    images = _images(scene)
    for index in range(FRAMES):
        kernels._core = recorder if index == FRAMES - 1 else _COMPILED  # type: ignore[attr-defined]
        method.step(_instant(scene, images[index % 2], index, setting.views))
    kernels._core = _COMPILED  # type: ignore[attr-defined]
    return method


def _fastest(calls: list[Call], level: str) -> float:
    """Return the sum over the calls of the least processor time, one thread, seconds."""
    number, total = kernels.SIMD_LEVELS.index(level), 0.0
    for call in calls:
        function, arguments = getattr(_COMPILED, call.name), list(call.arguments)
        if "level: " in str(function.__doc__):  # the instruction set is its last argument
            arguments[-2:] = [1, number]
        else:
            arguments[-1] = 1
        total += _least_seconds(partial(function, *arguments))
    return total


def peak_operations(channels: int = 64, size: int = 128) -> float:
    """Floating-point operations per second of one thread, by a convolution of oneDNN: it beats
    OpenBLAS and MKL here.
    """
    image = torch.rand(1, channels, size, size).contiguous(memory_format=torch.channels_last)
    weights = torch.rand(channels, channels, 3, 3).contiguous(memory_format=torch.channels_last)
    operations = 2 * channels * channels * 9 * (size - 2) ** 2
    with one_thread(), torch.inference_mode():
        return operations / _least_seconds(lambda: torch.conv2d(image, weights))


def peak_bytes(size: int = 64 << 20) -> float:
    """Return the bytes per second that one thread copies, read and written, from arrays that no
    cache holds.
    """
    source, target = np.ones(size, np.uint8), np.zeros(size, np.uint8)
    return 2 * size / _least_seconds(lambda: np.copyto(target, source))


def _least_seconds(work: Callable[[], object]) -> float:
    times = []
    for _ in range(REPEATS):
        begin = thread_time()
        work()
        times.append(thread_time() - begin)
    return min(times)


def _arrays(value: Any) -> Iterator[NDArray[Any]]:
    """Yield all arrays of nested tuples and lists.

    Cameras are numbers, and their matrices of 16 do not matter.
    """
    if isinstance(value, tuple | list):
        for each in value:
            yield from _arrays(each)
    elif isinstance(value, np.ndarray):
        yield value


def _peak_megabytes() -> float:
    """Return the largest resident memory of this process so far (Linux: 0 elsewhere)."""
    status = Path("/proc/self/status")
    lines = status.read_text(encoding="utf-8").splitlines() if status.exists() else []
    return next((int(line.split()[1]) / 1e3 for line in lines if line.startswith("VmHWM")), 0.0)


def _one(
    value: float, unit: str, target: float | None = None, higher: bool = False
) -> dict[str, Any]:
    return _figure(value, unit, target, higher_is_better=higher) | {"command": COMMAND}


if __name__ == "__main__":
    figures = measure()
    print(
        "| kernel | CPU ms | GFLOP | MB moved | MB made | share of its roof | AVX2 |\n| --- |"
        + " ---: |" * 6
    )
    for name in [name for name in figures if f"{name}_share" in figures]:
        slower = next(
            key
            for key in figures
            if key.startswith(f"{name}_") and figures[key]["unit"].startswith("x ")
        )
        keys = (
            name,
            f"{name}_operations",
            f"{name}_bytes",
            f"{name}_results",
            f"{name}_share",
            slower,
        )
        ms, operations, moved, made, share, ratio = (figures[key]["value"] for key in keys)
        label = name.removeprefix("roofline_")
        print(
            f"| {label} | {ms:.1f} | {operations:.2f} | {moved:.0f} | {made:.0f} | {share:.0f} % | "
            f"{ratio:.2f} x |"
        )
    for name in [
        name
        for name in figures
        if "_peak" in name or "all_kernels" in name or name.startswith("step_")
    ]:
        print(f"{name}: {figures[name]['value']:.4g} {figures[name]['unit']}")
