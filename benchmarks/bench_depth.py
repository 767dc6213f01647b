"""Seconds and memory of one depth map at 1345 x 1008 from four partners on two cores: ``python -m
benchmarks.bench_depth``.

Each matcher runs in a separate process, one after another, on the same pictures: a floor, a wall
and a box before it, painted with noise of two scales, seen by five cameras as far apart and as far
from the scene as those of a real rig. With ``rig`` behind it, only what `play` and `view` wait for
is measured: the depth of all five cameras, by two processes.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.depth_store import DepthStore
from ggvs_eval.files.images import quantise, write_image
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthEstimator, DepthOptions
from ggvs_eval.pipelines.offline.depth.depth_choice import find_matcher
from ggvs_eval.pipelines.offline.depth.fill_store import plan_rig_depth, prepare_depth
from ggvs_eval.pipelines.offline.stereo.raft_stereo import RaftStereo
from ggvs_eval.raft_config import PUBLISHED

COMMAND = "python -m benchmarks.bench_depth"
WIDTH, HEIGHT, FOCAL_PX = 1345, 1008, 730.0
# of the camera and its partners, world units
PLACES = ((0.0, 0.0), (-1.1, 0.0), (1.1, 0.0), (-2.2, 0.0), (0.0, 2.75))
WALL, FLOOR, BOX, BOX_HALF = 20.0, 6.0, 11.0, 2.5
CORES, MAX_RUNS, ENOUGH_S = 2, 3, 60.0
RIG_INSTANTS = 2, 6  # each process takes half of them
LIVE_TARGET_S = 0.6
PEER = "sgbm"
Options = Callable[[], DepthOptions]
Figure = dict[str, Any]
# What is timed; the first is the one that the others are compared with. A new matcher is one line.
MATCHERS: Mapping[str, Options] = {
    PEER: lambda: DepthOptions(matcher=find_matcher("sgbm")),
    "live": lambda: DepthOptions(matcher=find_matcher("live")),
    "sweep": lambda: DepthOptions(matcher=find_matcher("sweep")),
    "raft": lambda: DepthOptions(matcher=find_matcher("raft")),
}


def measure_networks() -> dict[str, Figure]:
    """Seconds of one pass over one pair at half size: the compact network against the authors'
    default, whose weights are random.

    Random weights take as long as trained ones; each network makes the iterations that it is made
    for.
    """
    camera, partner = (camera_at(*place) for place in PLACES[:2])
    texture, size = make_texture(), (WIDTH // 2, HEIGHT // 2)
    left, right = (
        cv2.resize(look(each, texture), size, interpolation=cv2.INTER_AREA)
        for each in (camera, partner)
    )
    seconds = {}
    with tempfile.TemporaryDirectory() as folder:
        torch.manual_seed(0)
        published = Path(folder) / "random.pth"
        torch.save(RaftStereo(PUBLISHED["default"]).state_dict(), published)
        for name in ("raft", f"raft:{published}"):
            matcher = find_matcher(name)
            start = time.perf_counter()
            matcher.disparity(left, right, 0, 120)
            seconds[name] = time.perf_counter() - start
    compact, default = seconds.values()
    entry: Figure = {
        "value": compact,
        "unit": "s per pass at 672x504",
        "target": None,
        "higher_is_better": False,
        "command": COMMAND,
    }
    return {
        "depth.network_seconds.raft": entry
        | {"peer": "published default", "peer_value": default, "ratio": default / compact}
    }


def measure_rig() -> dict[str, Figure]:
    """Seconds a map of a rig of five cameras, each matched with the four others, as two processes
    fill a store with them.

    What six instants take less what two take: processes start and pairs are rectified once, however
    long the capture is. The processors' seconds say the same of a machine that has other work to
    do.
    """
    values_of = {}
    with tempfile.TemporaryDirectory() as root:
        capture = write_rig(Path(root) / "rig", max(RIG_INSTANTS))
        for name in (PEER, "live"):
            options = replace(MATCHERS[name](), consistency=False)
            jobs, times = plan_rig_depth(capture, options), []
            for instants in RIG_INSTANTS:
                store, start = DepthStore(Path(root) / f"{name}{instants}"), _clocks()
                prepare_depth(capture, jobs, range(instants), store, options, CORES)
                times.append(_clocks() - start)
            values_of[name] = (times[1] - times[0]) / (
                len(jobs) * (RIG_INSTANTS[1] - RIG_INSTANTS[0])
            )
    figures = {}
    for number, (measured, unit) in enumerate(
        (("rig_seconds", "s a map"), ("rig_cpu_seconds", "CPU s a map"))
    ):
        for name, values in values_of.items():
            figures[f"depth.{measured}.{name}"] = _figure(
                name, float(values[number]), unit, float(values_of[PEER][number])
            )
    figures["depth.rig_seconds.live"]["target"] = LIVE_TARGET_S
    return figures


def _clocks() -> NDArray[np.float64]:
    """Return the seconds on the wall, and those of processors in this process and in those that it
    has ended.
    """
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return np.array([time.perf_counter(), sum(each.ru_utime + each.ru_stime for each in used)])


def write_rig(folder: Path, n_frames: int) -> Capture:
    """Return the scene as all five cameras see it, the same at every instant, as folders of
    images.
    """
    texture, cameras = make_texture(), tuple(camera_at(*place) for place in PLACES)
    for camera in cameras:
        image = look(camera, texture)
        for frame in range(n_frames):
            write_image(folder / camera.name / f"{frame:04d}.png", image)
    sources = tuple(ImageFrames(folder / camera.name) for camera in cameras)
    return Capture("rig", "folders", folder, cameras, sources, n_frames, 30.0, 1.0, "known")


def measure() -> dict[str, Figure]:
    """Return name -> figure.

    A matcher that fails, as one without weights does, is named and left out.
    """
    values_of = {name: values for name in MATCHERS if (values := _in_a_child(name)) is not None}
    figures = measure_networks() | measure_rig()
    for name, values in values_of.items():
        for measured, unit in (("seconds", "s per depth map"), ("memory_mb", "MB at most")):
            figures[f"depth.{measured}.{name}"] = _figure(
                name, values[measured], unit, values_of.get(PEER, {}).get(measured)
            )
    return figures


def _figure(name: str, value: float, unit: str, peer_value: float | None) -> Figure:
    entry: Figure = {
        "value": value,
        "unit": unit,
        "target": None,
        "higher_is_better": False,
        "command": COMMAND,
    }
    if name == PEER or peer_value is None:
        return entry
    return entry | {"peer": PEER, "peer_value": peer_value, "ratio": peer_value / value}


def _in_a_child(name: str) -> dict[str, float] | None:
    """Run `_measure_here` in a process with two threads and return what it prints.

    None if it fails.
    """
    threads = dict.fromkeys(
        ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "GGVS_EVAL_THREADS"),
        str(CORES),
    )
    command = [sys.executable, "-m", "benchmarks.bench_depth", name]
    done = subprocess.run(
        command, env=os.environ | threads, capture_output=True, text=True, check=False
    )
    if done.returncode:
        reason = (
            done.stderr.strip().splitlines() or [f"the process ended with {done.returncode}"]
        )[-1]
        print(f"depth.{name} is left out: {reason}", file=sys.stderr)
        return None
    values: dict[str, float] = json.loads(done.stdout.strip().splitlines()[-1])
    return values


def _measure_here(name: str) -> dict[str, float]:
    """Fastest of some calls, and the most memory that this process then held, libraries, weights
    and pictures included.
    """
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:CORES])
    cv2.setNumThreads(CORES)
    camera, *partners = cameras = [camera_at(*place) for place in PLACES]
    texture = make_texture()
    image, *partner_images = [look(each, texture) for each in cameras]
    # painting the scene does not count
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    estimator = DepthEstimator(camera, partners, MATCHERS[name]())
    times: list[float] = []
    while not times or (len(times) < MAX_RUNS and sum(times) < ENOUGH_S):
        start = time.perf_counter()
        estimator.estimate(image, partner_images)
        times.append(time.perf_counter() - start)
    return {"seconds": min(times), "memory_mb": _peak_mb()}


def _peak_mb() -> float:
    """Largest resident size since the mark was reset; Linux only.

    Ru_maxrss cannot be reset and starts from the parent's.
    """
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return next(
        int(line.split()[1]) / 1024 for line in status.splitlines() if line.startswith("VmHWM")
    )


def camera_at(x: float, y: float) -> Camera:
    """Return a camera at (x, y, 0) that looks along z, turned a little towards the middle of the
    scene.
    """
    turned, _ = cv2.Rodrigues(np.array([y, -x, 0.0]) * (0.5 / BOX))
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3], world_to_camera[:3, 3] = turned, -turned @ [x, y, 0.0]
    K = np.array([[FOCAL_PX, 0.0, WIDTH / 2], [0.0, FOCAL_PX, HEIGHT / 2], [0.0, 0.0, 1.0]])
    return Camera(f"x{x:+.2f}y{y:+.2f}", K, world_to_camera, WIDTH, HEIGHT, 8.0, 25.0)


def look(camera: Camera, texture: NDArray[np.float32]) -> Image8:
    """Render the view of a camera, RGB, (H, W, 3).

    Texture depends on x + z and y + z, which no surface is parallel to.
    """
    rays, centre = camera.rays(), camera.centre
    with np.errstate(divide="ignore", invalid="ignore"):
        floor = (FLOOR - centre[1]) / rays[..., 1]
    # (H, W)
    depth = np.minimum((WALL - centre[2]) / rays[..., 2], np.where(floor > 0, floor, np.inf))
    box = (BOX - centre[2]) / rays[..., 2]
    on_box = centre + box[..., None] * rays
    depth = np.where((np.abs(on_box[..., :2]) < BOX_HALF).all(axis=-1), box, depth)
    points = centre + depth[..., None] * rays
    texels = (30 * (points[..., :2] + points[..., 2:]) + 512).astype(np.float32)
    grey = cv2.remap(texture, texels, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    return quantise(grey[..., None] * np.array([1.0, 0.9, 0.8]))


def make_texture() -> NDArray[np.float32]:
    """Return the noise of two scales, (2048, 2048), around 0.5."""
    noise = np.random.default_rng(0).normal(size=(2048, 2048)).astype(np.float32)
    fine, coarse = (cv2.GaussianBlur(noise, (0, 0), sigma) for sigma in (1.5, 12))
    return np.asarray(0.5 + 0.1 * (fine / fine.std() + coarse / coarse.std()), np.float32)


def _print(figures: Mapping[str, Figure]) -> None:
    for name, figure in figures.items():
        ratio = f", ratio {figure['ratio']:.3g}" if "ratio" in figure else ""
        print(f"{name}: {figure['value']:.4g} {figure['unit']}{ratio}")


if __name__ == "__main__":
    if sys.argv[1:] == ["rig"]:
        _print(measure_rig())
    elif len(sys.argv) > 1:
        print(json.dumps(_measure_here(sys.argv[1])))
    else:
        _print(measure())
