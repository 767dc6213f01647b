"""The online step on a GPU, checked against the compiled path and timed, then scoring: ``make
bench-device``.

In this order. Does the device render what the CPU renders, and twice the same? How long does a step
take, by events of the GPU, played from its recording, median and 95th percentile of warm frames;
from arrays to a picture by the host's clock; where the target moves at every step; and until a new
recording is ready? Which kernels is it made of, how long does each take next to the time in which
its arrays could be moved once, and how long does the GPU wait between them? Learned depth follows
(`bench_device_depth`). The command needs CUDA's torch, numpy, OpenCV, safetensors, pybind11, a C++
compiler and Warp, and no network; ``--device cpu --shrink 8`` tries it by Warp's CPU device, whose
times mean nothing.
"""

import argparse
import json
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import count
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import torch

from benchmarks.bench_device import scene
from benchmarks.bench_device_depth import is_as_the_cpu, measure_depth
from ggvs_eval.compute_device import compute_device, describe_device
from ggvs_eval.contrib import warp as rooms
from ggvs_eval.contrib.warp.step import DeviceGuided
from ggvs_eval.kernels import get_threads
from ggvs_eval.method import Instant, Rendering
from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided
from ggvs_eval.pipelines.online.network_blender import NetworkBlender

# a step; from arrays to an 8-bit picture; on a Hopper GPU
TARGETS_MS = {(480, 360): (2.5, 3.0), (1352, 1014): (8.5, 10.0)}
PAPER_MS = "39-81"
CHECKED, WARM_UP, TIMED, PROFILED = 4, 8, 40, 4  # frames
LEAST_SHARE = 0.999  # of pixels within a level, of depths within 1e-4
DEAREST = 24  # kernels listed
COPIED_BYTES = 2**30
Figures = dict[str, Any]


def check(instants: Sequence[Instant], device: str) -> dict[str, float]:
    """Return the shares of pixels within a level of the CPU's, of depths within 1e-4 of them, and
    of pixels equal in two runs.
    """
    here, there, again = (
        [method.step(_at(instants, index)) for index in range(CHECKED)]
        for method in (
            GeometryGuided(blender=NetworkBlender()),
            DeviceGuided(device=device),
            DeviceGuided(device=device),
        )
    )
    off = np.stack(
        [
            np.abs(one.image - other.image).max(axis=-1)
            for one, other in zip(here, there, strict=True)
        ]
    )
    deep = [
        np.abs(_depth(one) - _depth(other)) <= 1e-4 * _depth(one)
        for one, other in zip(here, there, strict=True)
    ]
    same = [
        (one.image == other.image).all(axis=-1) for one, other in zip(there, again, strict=True)
    ]
    return {
        "within_a_level": float((off <= 1 / 255).mean()),
        "largest_levels": float(255 * off.max()),
        "depth_within_1e-4": float(np.mean(deep)),
        "equal_twice": float(np.mean(same)),
    }


def time_steps(instants: Sequence[Instant], device: str) -> Figures:
    """Milliseconds of a step, of a call from arrays to an 8-bit picture, of one whose target moves,
    and of the first ones.
    """
    method, first = DeviceGuided(device=device), []
    for index in range(3):  # the first runs call by call, the others are recorded
        begun_s = perf_counter()
        method.step(_at(instants, index))
        first.append(1e3 * (perf_counter() - begun_s))
    numbers = count(3)
    steps = _warm(lambda: 1e3 * method.step(_at(instants, next(numbers))).seconds["step"])
    calls = _warm(lambda: _host_ms(lambda: method.show(_at(instants, next(numbers)))))
    moving = _warm(lambda: 1e3 * method.step(_moved(instants, next(numbers))).seconds["step"])
    return {
        **{
            f"{name}_ms": value
            for name, value in zip(("p50", "p95"), _percentiles(steps), strict=True)
        },
        **{
            f"call_{name}_ms": value
            for name, value in zip(("p50", "p95"), _percentiles(calls), strict=True)
        },
        "moving_p50_ms": _percentiles(moving)[0],
        "recording_ms": max(first[1:]) - calls[0],
        "launched_ms": _time_parts(instants, device),
    }


def _time_parts(instants: Sequence[Instant], device: str) -> dict[str, float]:
    """Return the milliseconds of each part of a step that is launched call by call, in the order of
    the step.
    """
    method = DeviceGuided(device=device, recorded=False)
    rows = []
    for index in range(WARM_UP + TIMED // 4):
        method.step(_at(instants, index))
        rows.append(method.details)
    return {
        name: 1e3 * float(np.median([row[name] for row in rows[WARM_UP:]])) for name in rows[-1]
    }


def profile_kernels(instants: Sequence[Instant], device: str) -> Figures:
    """Profile the GPU in a played step: kernels, launches, gaps, and copies.

    Nothing without a GPU.
    """
    if torch.device(device).type != "cuda":
        return {}
    method, numbers = DeviceGuided(device=device), count(0)
    least = _least_bytes(method, instants, numbers)
    for _ in range(3):
        method.step(_at(instants, next(numbers)))
    activities = [torch.profiler.ProfilerActivity.CUDA]
    with torch.profiler.profile(activities=activities) as profile:
        for _ in range(PROFILED):
            method.step(_at(instants, next(numbers)))
    events = [
        (event.start_ns(), event.duration_ns(), event.name())
        for event in profile.profiler.kineto_results.events()
        if event.device_type() == torch.autograd.DeviceType.CUDA
    ]
    copies = [event for event in events if event[2].startswith(("Memcpy HtoD", "Memcpy DtoH"))]
    work = sorted(
        event for event in events if not event[2].startswith(("Memcpy HtoD", "Memcpy DtoH"))
    )
    busy, gaps = _busy_and_gaps(work)
    rate = _copy_bytes_per_ms(device)
    kernels: dict[str, list[float]] = defaultdict(lambda: [0.0, 0.0])
    for _, duration, name in work:
        kernels[name][0] += duration / 1e6 / PROFILED
        kernels[name][1] += 1 / PROFILED
    rows = [
        {"name": name, "ms": ms, "launches": launches, "floor_ms": _floor(name, least, rate)}
        for name, (ms, launches) in sorted(kernels.items(), key=lambda row: -row[1][0])
    ]
    return {
        "busy_ms": busy / PROFILED,
        "gaps_ms": gaps / PROFILED,
        "copies_ms": sum(duration for _, duration, _ in copies) / 1e6 / PROFILED,
        "launches": len(work) / PROFILED,
        "copy_tb_per_s": rate / 1e9,
        "kernels": rows,
    }


def _busy_and_gaps(events: Sequence[tuple[int, int, str]]) -> tuple[float, float]:
    """Milliseconds in which any of some events runs, and between them within steps.

    One that overlaps another counts once.
    """
    busy = gaps = 0.0
    end = None
    for start, duration, _ in events:
        if end is None or start > end:
            if end is not None and start - end < 200_000:  # longer ones are between steps
                gaps += start - end
            busy += duration
            end = start + duration
        elif start + duration > end:
            busy += start + duration - end
            end = start + duration
    return busy / 1e6, gaps / 1e6


def _least_bytes(
    method: DeviceGuided, instants: Sequence[Instant], numbers: Iterator[int]
) -> dict[str, float]:
    """Return the bytes of the arrays that each of this package's kernels is given in a step, each
    once.
    """
    method.step(_at(instants, next(numbers)))
    found: dict[str, float] = defaultdict(float)
    with _watched(
        lambda kernel, tensors: found.__setitem__(
            kernel, found[kernel] + sum(each.nbytes for each in tensors)
        )
    ):
        method._recorded = False
        method.step(_at(instants, next(numbers)))
        method._recorded = True
    return found


@contextmanager
def _watched(seen: Callable[[str, list[torch.Tensor]], None]) -> Iterator[None]:
    """Within, `seen` hears of every launch of the package's kernels."""
    import importlib
    import pkgutil

    modules = [
        importlib.import_module(f"{rooms.__name__}.{each.name}")
        for each in pkgutil.iter_modules(rooms.__path__)
    ]
    users = [module for module in modules if hasattr(module, "launch")]
    launch = users[0].launch

    def watched(kernel: Any, size: Any, *arguments: Any, **options: Any) -> None:
        places = {each.data_ptr(): each for each in arguments if isinstance(each, torch.Tensor)}
        seen(kernel.key, list(places.values()))
        launch(kernel, size, *arguments, **options)

    for module in users:
        module.launch = watched  # type: ignore[attr-defined]
    try:
        yield
    finally:
        for module in users:
            module.launch = launch  # type: ignore[attr-defined]


def _floor(name: str, least: dict[str, float], rate: float) -> float:
    """Return the milliseconds in which a kernel's arrays could be moved once.

    0 for others' kernels.
    """
    keys = [key for key in least if name.startswith(f"{key.rpartition('.')[2]}_")]
    return least[max(keys, key=len)] / rate if keys else 0.0


def _copy_bytes_per_ms(device: str) -> float:
    """Return the bytes read and written in a millisecond by a large copy on the device."""
    source = torch.zeros(COPIED_BYTES // 4, device=device)
    out = torch.empty_like(source)
    times = []
    for _ in range(8):
        begun, ended = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        begun.record()
        out.copy_(source)
        ended.record()
        ended.synchronize()
        times.append(begun.elapsed_time(ended))
    return 2 * COPIED_BYTES / float(np.median(times[2:]))


def _warm(measure: Callable[[], float]) -> list[float]:
    return [measure() for _ in range(WARM_UP + TIMED)][WARM_UP:]


def _host_ms(work: Callable[[], object]) -> float:
    begun_s = perf_counter()
    work()
    return 1e3 * (perf_counter() - begun_s)


def _percentiles(times: Sequence[float]) -> tuple[float, float]:
    return float(np.median(times)), float(np.quantile(times, 0.95))


def _at(instants: Sequence[Instant], index: int) -> Instant:
    """Instant number `index` of a sequence that repeats two."""
    return Instant(
        index,
        instants[0].target,
        instants[index % len(instants)].sources,
        instants[0].units_per_metre,
    )


def _moved(instants: Sequence[Instant], index: int) -> Instant:
    """Return the same from a pose that is another at every step."""
    instant = _at(instants, index)
    pose = instant.target.world_to_camera.copy()
    pose[0, 3] += 0.05 * np.sin(index)
    return replace(instant, target=replace(instant.target, world_to_camera=pose))


def _depth(rendering: Rendering) -> np.ndarray:
    return np.zeros(0, np.float32) if rendering.depth is None else rendering.depth


def _print(size: tuple[int, int], figure: Figures, divisor: int) -> None:
    """The table of one size."""
    checked, times = figure["check"], figure["times"]
    whole = (size[0] * divisor, size[1] * divisor)
    print(f"\n{size[0]}x{size[1]}, K = 4, network included")
    good = (
        min(checked["within_a_level"], checked["depth_within_1e-4"]) >= LEAST_SHARE
        and checked["equal_twice"] == 1.0
    )
    print(
        f"  {'as the CPU renders it' if good else 'NOT AS THE CPU RENDERS IT'}: "
        f"{checked['equal_twice']:.4%} equal in two runs,"
    )
    print(
        f"  {checked['within_a_level']:.4%} of the pixels within a level (at most "
        f"{checked['largest_levels']:.3f}),"
    )
    print(f"  {checked['depth_within_1e-4']:.4%} of the depths within 1e-4 of themselves")
    step, call = TARGETS_MS[whole] if divisor == 1 else (0.0, 0.0)
    print(
        f"  {'a step, p50':28s} {times['p50_ms']:8.2f} ms (p95 {times['p95_ms']:.2f}; the paper's "
        f"{PAPER_MS}, to reach {step:g})"
    )
    print(
        f"  {'arrays to picture, p50':28s} {times['call_p50_ms']:8.2f} ms (p95 "
        f"{times['call_p95_ms']:.2f}, to reach {call:g})"
    )
    print(f"  {'a moving target, p50':28s} {times['moving_p50_ms']:8.2f} ms")
    print(f"  {'a new recording':28s} {times['recording_ms']:8.1f} ms")
    print(
        "  launched call by call: "
        + ", ".join(f"{name} {ms:.2f}" for name, ms in times["launched_ms"].items())
    )
    if kernels := figure["kernels"]:
        print(
            f"  kernels {kernels['busy_ms']:.2f} ms of {kernels['launches']:.0f} launches, gaps "
            f"{kernels['gaps_ms']:.2f}, copies {kernels['copies_ms']:.2f} (copy rate "
            f"{kernels['copy_tb_per_s']:.2f} TB/s)"
        )
        for row in kernels["kernels"][:DEAREST]:
            print(
                f"    {row['ms']:7.3f} ms  {row['launches']:5.1f} x  floor {row['floor_ms']:.3f}  "
                f"{row['name'][:90]}"
            )


def _write(file: Path | None, record: Figures) -> None:
    """Keep what is measured so far: a part that fails later must not take it along, a GPU may be
    had for minutes only.
    """
    if file is not None:
        file.write_text(json.dumps(record, indent=1))


def main() -> None:
    """Check and time both sizes; the figures go to a file as well where one is named.

    Exit code 1 where a check fails.
    """
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--device",
        default="cuda",
        help="cuda, cuda:N, or cpu: Warp's CPU device, to try the command",
    )
    parser.add_argument("--shrink", type=int, default=1, help="divides every side")
    parser.add_argument("--json", type=Path, help="file to write")
    parser.add_argument(
        "--step-alone", action="store_true", help="neither learned depth nor scoring"
    )
    options = parser.parse_args()
    device = compute_device(options.device)
    machine = (
        f"{describe_device(device)}, torch {torch.__version__}, {get_threads()} threads of the CPU"
    )
    print(machine)
    figures: Figures = {}
    record: Figures = {"machine": machine, "figures": figures}
    for width, height in TARGETS_MS:
        size = width // options.shrink, height // options.shrink
        instants = scene(*size)
        figure = {
            "check": check(instants, str(device)),
            "times": time_steps(instants, str(device)),
            "kernels": profile_kernels(instants, str(device)),
        }
        _print(size, figure, options.shrink)
        figures[f"{size[0]}x{size[1]}"] = figure
        _write(options.json, record)
    rendered = min(figure["check"]["within_a_level"] for figure in figures.values()) >= LEAST_SHARE
    if not options.step_alone:
        # of metrics, which have their own kernels
        from benchmarks.bench_device_scoring import LEAST_CLOSE, print_scoring

        depth = record["depth"] = measure_depth(str(device), options.shrink)
        _write(options.json, record)
        scoring = record["scoring"] = print_scoring(size, str(device))
        _write(options.json, record)
        rendered = (
            rendered and is_as_the_cpu(depth) and scoring["largest_difference"] <= LEAST_CLOSE
        )
    if not rendered:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
