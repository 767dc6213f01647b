"""The online step on a GPU, checked against the compiled path and timed part by part, then scoring: ``make bench-device``.

Three questions, in this order. Does the device render what the CPU renders, and twice the same? How long does each part take,
by events of the GPU, median and 95th percentile of warm frames? For how much of that does the GPU compute, by torch's profiler:
else it waits for the host, which a CUDA graph could save. Learned depth follows (`bench_device_depth`). The command needs CUDA's
torch, numpy, OpenCV, safetensors, pybind11, a C++ compiler and Warp, and no network; ``--device cpu --shrink 8`` tries it by
Warp's CPU device, whose times mean nothing.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import torch

from benchmarks.bench_device import scene
from benchmarks.bench_device_depth import is_as_the_cpu, measure_depth
from benchmarks.bench_device_scoring import LEAST_CLOSE, print_scoring
from ggvs_eval.compute_device import compute_device, describe_device
from ggvs_eval.kernels import get_threads
from ggvs_eval.method import Instant, Method, Rendering
from ggvs_eval.pipelines.online.device.step import DeviceGuided
from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided
from ggvs_eval.pipelines.online.network_blender import NetworkBlender

TARGETS_MS = {(480, 360): 4.0, (1352, 1014): 12.0}  # per frame, network included, on a Hopper GPU
PAPER_MS = "39-81"
CHECKED, WARM_UP, TIMED = 4, 8, 40  # frames
LEAST_SHARE = 0.999  # of pixels within a level, of depths within 1e-4
TRANSFERS = ("upload", "download")


def check(instants: Sequence[Instant], device: str) -> dict[str, float]:
    """Shares of pixels within a level of the CPU's, of depths within 1e-4 of them, and of pixels equal in two runs."""
    here, there, again = (
        _rendered(method, instants, CHECKED)
        for method in (GeometryGuided(blender=NetworkBlender()), DeviceGuided(device=device), DeviceGuided(device=device))
    )
    off = np.stack([np.abs(one.image - other.image).max(axis=-1) for one, other in zip(here, there, strict=True)])
    deep = [np.abs(_depth(one) - _depth(other)) <= 1e-4 * _depth(one) for one, other in zip(here, there, strict=True)]
    same = [(one.image == other.image).all(axis=-1) for one, other in zip(there, again, strict=True)]
    return {
        "within_a_level": float((off <= 1 / 255).mean()),
        "largest_levels": float(255 * off.max()),
        "depth_within_1e-4": float(np.mean(deep)),
        "equal_twice": float(np.mean(same)),
    }


def time_parts(instants: Sequence[Instant], device: str) -> dict[str, Any]:
    """Milliseconds of each part, its median over warm frames, by the host's clock too; of the frame without transfers."""
    method, rows = DeviceGuided(device=device), []
    for index in range(WARM_UP + TIMED):
        begun_s = perf_counter()
        method.step(_at(instants, index))
        rows.append({**method.details, "host": perf_counter() - begun_s})
    warm = rows[WARM_UP:]
    parts = {name: 1e3 * float(np.median([row[name] for row in warm])) for name in warm[0]}
    between = [1e3 * sum(row[name] for name in row if name not in (*TRANSFERS, "host")) for row in warm]
    figures = {"parts_ms": parts, "p50_ms": float(np.median(between)), "p95_ms": float(np.quantile(between, 0.95))}
    if torch.device(device).type == "cuda":
        figures["busy_ms"] = _busy_ms(method, instants, WARM_UP + TIMED)
    return figures


def _busy_ms(method: Method, instants: Sequence[Instant], first: int, frames: int = 10) -> float:
    """Milliseconds of a frame in which kernels of the GPU compute, transfers left out; 0 where the profiler sees none."""
    activities = [torch.profiler.ProfilerActivity.CPU, torch.profiler.ProfilerActivity.CUDA]
    with torch.profiler.profile(activities=activities) as profile:
        for index in range(first, first + frames):
            method.step(_at(instants, index))
    rows = [row for row in profile.key_averages() if "Memcpy" not in row.key]
    return sum(float(getattr(row, "self_device_time_total", 0.0)) for row in rows) / 1e3 / frames


def _rendered(method: Method, instants: Sequence[Instant], frames: int) -> list[Rendering]:
    return [method.step(_at(instants, index)) for index in range(frames)]


def _at(instants: Sequence[Instant], index: int) -> Instant:
    """Instant number `index` of a sequence that repeats two."""
    return Instant(index, instants[0].target, instants[index % len(instants)].sources, instants[0].units_per_metre)


def _depth(rendering: Rendering) -> np.ndarray:
    return np.zeros(0, np.float32) if rendering.depth is None else rendering.depth


def _print(size: tuple[int, int], figure: dict[str, Any], divisor: int) -> None:
    """The table of one size."""
    checked, times = figure["check"], figure["times"]
    whole = (size[0] * divisor, size[1] * divisor)
    print(f"\n{size[0]}x{size[1]}, K = 4, network included")
    good = min(checked["within_a_level"], checked["depth_within_1e-4"]) >= LEAST_SHARE and checked["equal_twice"] == 1.0
    print(
        f"  {'as the CPU renders it' if good else 'NOT AS THE CPU RENDERS IT'}: {checked['equal_twice']:.4%} equal in two runs,"
    )
    print(f"  {checked['within_a_level']:.4%} of the pixels within a level (at most {checked['largest_levels']:.2f}),")
    print(f"  {checked['depth_within_1e-4']:.4%} of the depths within 1e-4 of themselves")
    for name, milliseconds in times["parts_ms"].items():
        print(f"  {name:26s} {milliseconds:8.2f} ms")
    target = f", to reach {TARGETS_MS[whole]:g}" if divisor == 1 else ""
    print(
        f"  {'without transfers, p50':26s} {times['p50_ms']:8.2f} ms (p95 {times['p95_ms']:.2f}; the paper's {PAPER_MS}{target})"
    )
    if times.get("busy_ms"):
        print(
            f"  {'of that, kernels':26s} {times['busy_ms']:8.2f} ms; what is left waits for the host: a CUDA graph could save it"
        )


def _write(file: Path | None, record: dict[str, Any]) -> None:
    """Keep what is measured so far: a part that fails later must not take it along, a GPU may be had for minutes only."""
    if file is not None:
        file.write_text(json.dumps(record, indent=1))


def main() -> None:
    """Check and time both sizes; the figures go to a file as well where one is named. Exit code 1 where a check fails."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda", help="cuda, cuda:N, or cpu: Warp's CPU device, to try the command")
    parser.add_argument("--shrink", type=int, default=1, help="divides every side")
    parser.add_argument("--json", type=Path, help="file to write")
    options = parser.parse_args()
    device = compute_device(options.device)
    machine = f"{describe_device(device)}, torch {torch.__version__}, {get_threads()} threads of the CPU"
    print(machine)
    figures: dict[str, Any] = {}
    record: dict[str, Any] = {"machine": machine, "figures": figures}
    for width, height in TARGETS_MS:
        size = width // options.shrink, height // options.shrink
        instants = scene(*size)
        figure = {"check": check(instants, str(device)), "times": time_parts(instants, str(device))}
        _print(size, figure, options.shrink)
        figures[f"{size[0]}x{size[1]}"] = figure
        _write(options.json, record)
    depth = record["depth"] = measure_depth(str(device), options.shrink)
    _write(options.json, record)
    scoring = record["scoring"] = print_scoring(size, str(device))
    _write(options.json, record)
    rendered = min(figure["check"]["within_a_level"] for figure in figures.values()) >= LEAST_SHARE
    if not (rendered and is_as_the_cpu(depth) and scoring["largest_difference"] <= LEAST_CLOSE):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
