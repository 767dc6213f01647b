"""How time and memory grow with cameras, frames and pixels: ``python -m benchmarks.bench_growth``.

An exponent is the slope of the logarithm of CPU time (all threads) over that of the size, between
the two largest sizes: 1 is growth in proportion. Above `SUPERLINEAR` something is done again for
each of what is there already.
"""

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from benchmarks.bench_online import Setting, _images, _instant, _scene
from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.files.images import write_image
from ggvs_eval.jobs.machine import PeakMemory
from ggvs_eval.pipelines.online.blending import GeometricBlender
from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided
from ggvs_eval.pipelines.online.network_blender import NetworkBlender
from ggvs_eval.pipelines.run.run_plan import RunRequest, plan_run
from ggvs_eval.protocol import CameraPath, Frames, Synthesis, Views, load_protocol
from ggvs_eval.statistics.autocorrelation import ErrorOfMean

COMMAND = "python -m benchmarks.bench_growth"
SUPERLINEAR = 1.2
CAMERAS, TEST_VIEWS = (10, 30, 100), 9
SIZES = ((240, 180), (480, 360), (960, 720), (1920, 1440))
STEPS, WARM_UP = 3, 2
# the first and the last hundred of a thousand are compared
FRAMES, FRAME_SIZE, SPAN = 1000, (160, 120), 100
SERIES = (100, 1000, 5000)  # frames of a clip whose mean has an interval
Figure = dict[str, Any]


def measure() -> dict[str, Figure]:
    """Return name -> figure."""
    return measure_cameras() | measure_pixels() | measure_frames() | measure_series()


def measure_cameras(counts: Sequence[int] = CAMERAS) -> dict[str, Figure]:
    """Seconds to plan a run of nine test views by the number of cameras, and the depth maps that it
    needs at an instant.
    """
    seconds, maps = [], []
    with tempfile.TemporaryDirectory() as root:
        for count in counts:
            capture = _write_row(Path(root) / f"{count}", count)
            base = load_protocol("demo")
            views = Views(
                capture.camera_names[count // 4 :][: min(TEST_VIEWS, count // 2)], "for growth"
            )
            protocol = replace(
                base, views=views, frames=Frames(0, 1), synthesis=Synthesis(4), path=CameraPath(0)
            )
            request = RunRequest(Path(root) / f"run{count}", capture, protocol, ("no-blending",))
            seconds.append(min(_cpu_s(plan_run, request) for _ in range(3)))
            maps.append(float(len(plan_run(request).view_jobs)))
    return {
        "growth.cameras.plan_seconds": _figure(seconds[-1], "CPU s"),
        "growth.cameras.plan_exponent": _exponent(counts, seconds),
        "growth.cameras.depth_maps": _figure(maps[-1], "maps an instant"),
    }


def measure_pixels(sizes: Sequence[tuple[int, int]] = SIZES) -> dict[str, Figure]:
    """CPU time of a warm step by pixels, and what it holds in memory at the largest size."""
    figures = {}
    for name, blender in (("geometric", GeometricBlender), ("network", NetworkBlender)):
        times, held = [], 0
        for width, height in sizes:
            setting = Setting(name, width, height, 4, STEPS)
            scene, method = _scene(setting), GeometryGuided(blender=blender())
            images = _images(scene)
            instants = [
                _instant(scene, images[index % 2], index, 4) for index in range(WARM_UP + STEPS)
            ]
            with PeakMemory() as before:
                pass
            with PeakMemory() as memory:
                times.append(min([_cpu_s(method.step, each) for each in instants][WARM_UP:]))
            held = (memory.bytes or 0) - (before.bytes or 0)
        pixels = [width * height for width, height in sizes]
        figures[f"growth.pixels.{name}_step"] = _figure(1e3 * times[-1], "CPU ms")
        figures[f"growth.pixels.{name}_exponent"] = _exponent(pixels, times)
        figures[f"growth.pixels.{name}_memory"] = _figure(held / pixels[-1], "bytes a pixel")
    return figures


def measure_frames(count: int = FRAMES) -> dict[str, Figure]:
    """Time of a step and memory at the end of a long clip, over those at its beginning."""
    setting = Setting("frames", *FRAME_SIZE, 2, count)
    scene, method = _scene(setting), GeometryGuided(blender=GeometricBlender())
    images, times, held = _images(scene), [], []
    for index in range(count):
        instant = _instant(scene, images[index % 2], index, 2)
        times.append(_cpu_s(method.step, instant))
        if index in (SPAN, count - 1):
            with PeakMemory() as memory:
                pass
            held.append(memory.bytes or 0)
    ratio = float(np.median(times[-SPAN:]) / np.median(times[WARM_UP : SPAN + WARM_UP]))
    return {
        "growth.frames.step_ratio": _figure(ratio, "x", SUPERLINEAR),
        "growth.frames.memory": _figure((held[1] - held[0]) / 2**20, "MiB more"),
    }


def measure_series(lengths: Sequence[int] = SERIES) -> dict[str, Figure]:
    """CPU time of the interval of a mean over frames, whose models are computed anew for each
    length.
    """
    series = [np.random.default_rng(0).normal(size=length) for length in lengths]
    seconds = [
        _cpu_s(lambda values: ErrorOfMean.of_series(values).half_width(0.05), each)
        for each in series
    ]
    return {
        "growth.series.seconds": _figure(seconds[-1], "CPU s"),
        "growth.series.exponent": _exponent(lengths, seconds),
    }


def _write_row(folder: Path, count: int) -> Capture:
    """Cameras side by side that look at one point, each with one grey picture."""
    cameras = []
    for index in range(count):
        across = 0.1 * (index - count / 2)
        turn = np.arctan2(across, 4.0 + 0.1 * count)
        pose = np.eye(4)
        pose[0, [0, 2]], pose[2, [0, 2]] = (
            (np.cos(turn), np.sin(turn)),
            (-np.sin(turn), np.cos(turn)),
        )
        pose[:3, 3] = -pose[:3, :3] @ (across, 0.0, 0.0)
        K = np.array([[300.0, 0, 160], [0, 300.0, 120], [0, 0, 1]])
        cameras.append(Camera(f"cam{index:03d}", K, pose, 320, 240, 2.0, 20.0))
        write_image(folder / cameras[-1].name / "0000.png", np.full((240, 320, 3), 100, np.uint8))
    sources = tuple(ImageFrames(folder / camera.name) for camera in cameras)
    return Capture("row", "folders", folder, tuple(cameras), sources, 1, 30.0, 1.0, "known")


def _cpu_s(work: Callable[[Any], object], what: Any) -> float:
    begin = process_time()
    work(what)
    return process_time() - begin


def _exponent(sizes: Sequence[int], seconds: Sequence[float]) -> Figure:
    return _figure(
        float(np.log(seconds[-1] / seconds[-2]) / np.log(sizes[-1] / sizes[-2])),
        "exponent",
        SUPERLINEAR,
    )


def _figure(value: float, unit: str, target: float | None = None) -> Figure:
    return {
        "value": value,
        "unit": unit,
        "target": target,
        "higher_is_better": False,
        "command": COMMAND,
    }


if __name__ == "__main__":
    for name, figure in measure().items():
        print(f"{name}: {figure['value']:.3g} {figure['unit']}")
