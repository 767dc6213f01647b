"""Seconds per frame of networks on the CPU and on a GPU: ``python -m benchmarks.bench_device
--device cuda``.

Both are timed in one run, on frames of the same curved wall before cameras in a row: medians after
warm-up, the whole step with uploads and downloads. The last column is the difference of the
pictures. IBRNet on the CPU sees a quarter of the pixels.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import torch

from ggvs_eval.arrays import Image8, Map
from ggvs_eval.camera import Camera
from ggvs_eval.compute_device import compute_device, describe_device
from ggvs_eval.files.images import quantise
from ggvs_eval.kernels import get_threads
from ggvs_eval.method import Instant, Method, SourceView
from ggvs_eval.pipelines.methods.network_options import NetworkOptions
from ggvs_eval.pipelines.methods.registry import find_method

K, BASELINE_M, RADIUS_M, NEAR, FAR = 4, 0.15, 4.0, 2.0, 6.0
NOISE_LEVELS = 3  # of 255, drawn anew for every other frame: masks are then not all alike
FAR_OFF_LEVELS = 2.0  # of 255; pixels that differ by more are counted
SMALL, LARGE, QUARTER = (480, 360), (1352, 1014), (240, 180)


@dataclass(frozen=True)
class Trial:
    """Timed combination of method, size and frames.

    Attributes:
        label: method.
        size: width and height.
        frames: measured on the device, after warm-up.
        cpu_frames: measured on the CPU, after a first one; none with 0.
    """

    label: str
    size: tuple[int, int]
    frames: int = 10
    cpu_frames: int = 2


TRIALS = (
    Trial("ours", SMALL, cpu_frames=10),
    Trial("ours", LARGE, cpu_frames=6),
    Trial("fwd", SMALL),
    Trial("gps-gaussian+given-depth", SMALL, cpu_frames=1),
    Trial("enerf", SMALL, cpu_frames=1),
    Trial("mvsplat", SMALL, cpu_frames=1),
    Trial("ibrnet", QUARTER, cpu_frames=1),
    Trial("ibrnet", SMALL, cpu_frames=0),
)
Figure = dict[str, Any]


def measure(device: str, trials: Sequence[Trial] = TRIALS) -> list[Figure]:
    """Return the figures of every trial, each printed as it comes.

    The picture of a first instant is compared.

    Args:
        device: to compare with the CPU, see `compute_device`.
        trials: what is timed.
    """
    figures = []
    for trial in trials:
        figures.append(_figure(trial, device))
        print(_line(figures[-1]), flush=True)
    return figures


def _figure(trial: Trial, device: str) -> Figure:
    """Return the seconds per frame and per stage on both, and the share of pixels that differ by
    more than two levels.
    """
    instants = scene(*trial.size)
    figure: Figure = {"label": trial.label, "width": trial.size[0], "height": trial.size[1]}
    images: dict[str, Map] = {}
    for place, name, warm_up, frames in (
        ("cpu", "cpu", 1, trial.cpu_frames),
        ("device", device, 3, trial.frames),
    ):
        if frames:
            method = find_method(trial.label, NetworkOptions(device=name)).make()
            timed = partial(_timed, method, instants)
            images[place], _ = timed(0)
            rows = [timed(index)[1] for index in range(1, warm_up + frames)][warm_up - 1 :]
            figure[place] = {
                stage: float(np.median([row[stage] for row in rows])) for stage in rows[0]
            }
    if len(images) == 2:
        off = np.abs(images["device"] - images["cpu"]).max(axis=-1)
        figure["differing_share"] = float((off > FAR_OFF_LEVELS / 255).mean())
        figure["ratio"] = figure["cpu"]["whole"] / figure["device"]["whole"]
    return figure


def _timed(method: Method, instants: Sequence[Instant], index: int) -> tuple[Map, dict[str, float]]:
    """Return the picture of a frame, and the seconds of its stages and of the whole."""
    instant = Instant(
        index,
        instants[0].target,
        instants[index % len(instants)].sources,
        instants[0].units_per_metre,
    )
    begun_s = perf_counter()
    rendering = method.step(instant)
    return rendering.image, {**rendering.seconds, "whole": perf_counter() - begun_s}


def _line(figure: Figure) -> str:
    title = f"{figure['label']} {figure['width']}x{figure['height']}"
    parts = [f"{title:34s}"]
    for place in ("cpu", "device"):
        if place in figure:
            stages = " ".join(
                f"{stage} {1e3 * seconds:.1f}" for stage, seconds in figure[place].items()
            )
            parts.append(f"{place} ms: {stages}")
    if "ratio" in figure:
        parts.append(
            f"{figure['ratio']:.2f} times as fast, {figure['differing_share']:.3%} of the pixels "
            f"differ"
        )
    return " | ".join(parts)


def scene(width: int, height: int) -> list[Instant]:
    """Return two instants of a wall that bends around the cameras, the same except for noise."""
    cameras = [_camera(number, width, height) for number in range(K + 1)]
    target = cameras.pop(K // 2)
    pictures = [_look(camera) for camera in cameras]
    random = np.random.default_rng(0)
    instants = []
    for index in range(2):
        sources = tuple(
            SourceView(camera, _noisy(image, random), depth, np.ones_like(depth))
            for camera, (image, depth) in zip(cameras, pictures, strict=True)
        )
        instants.append(Instant(index, target, sources, units_per_metre=1.0))
    return instants


def _camera(number: int, width: int, height: int) -> Camera:
    """One of a slanted row, all looking along z: no source's border falls onto the target's, where
    rounding would decide.
    """
    focal, pose = 0.9 * width, np.eye(4)
    pose[:2, 3] = -BASELINE_M * (number - K / 2), 0.013 * number
    intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Camera(f"cam{number}", intrinsics, pose, width, height, NEAR, FAR)


def _look(camera: Camera) -> tuple[Image8, Map]:
    """Return the image and depth of the inside of a sphere around the world's origin, painted with
    waves.
    """
    rays, centre = camera.rays(), camera.centre
    square, half = (rays**2).sum(axis=-1), rays @ centre
    depth = (np.sqrt(half**2 + square * (RADIUS_M**2 - centre @ centre)) - half) / square
    points = centre + depth[..., None] * rays
    waves = [np.sin(points @ direction) for direction in ([9, 2, 0], [3, -11, 1], [25, 17, 5])]
    return quantise(0.5 + 0.4 * np.stack(waves, axis=-1)), depth.astype(np.float32)


def _noisy(image: Image8, random: np.random.Generator) -> Image8:
    noise = random.integers(-NOISE_LEVELS, NOISE_LEVELS + 1, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8)


def main() -> None:
    """Print a line per trial; everything as JSON where a file is named."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--device", default="auto", help="cpu, cuda, cuda:N or auto")
    parser.add_argument("--only", nargs="*", help="labels of methods; all by default")
    parser.add_argument(
        "--shrink", type=int, default=1, help="divides every side, to try the benchmark itself"
    )
    parser.add_argument("--json", type=Path, help="file to write")
    options = parser.parse_args()
    device = compute_device(options.device)
    machine = (
        f"{describe_device(device)}, torch {torch.__version__}, {get_threads()} threads of the CPU"
    )
    print(machine)
    trials = [trial for trial in TRIALS if not options.only or trial.label in options.only]
    shrunk = [
        Trial(each.label, _shrunk(each.size, options.shrink), each.frames, each.cpu_frames)
        for each in trials
    ]
    figures = measure(str(device), shrunk)
    if options.json:
        options.json.write_text(json.dumps({"machine": machine, "figures": figures}, indent=1))


def _shrunk(size: tuple[int, int], divisor: int) -> tuple[int, int]:
    return size[0] // divisor, size[1] // divisor


if __name__ == "__main__":
    main()
