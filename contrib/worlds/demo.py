"""The demo capture: the procedural room rendered by the rig, in the layout of any data set, with
exact depth.
"""

import json
import shutil
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

from ggvs_eval.camera import Camera
from ggvs_eval.contrib.worlds.film.film import PARTS, Footage, light_instant, stored_instant
from ggvs_eval.contrib.worlds.film.options import LATER, DemoOptions
from ggvs_eval.contrib.worlds.film.shots import Shot, camera_gains
from ggvs_eval.contrib.worlds.layouts.layouts import LAYOUTS
from ggvs_eval.datasets.units import DEMO_NOTES
from ggvs_eval.files.atomic import atomic_folder
from ggvs_eval.jobs.processes import worker_pool
from ggvs_eval.kernels import usable_cpus
from ggvs_eval.progress import track
from ggvs_eval.synthetic.shipped import MAIN, is_written, write_room

VERSION = 2
T = TypeVar("T")
SMALL = DemoOptions(width=384, height=216, n_frames=8, path_poses=0, depth_stride=0)
SHIPPED = DemoOptions(depth_stride=0)
# What was filmed of each room that ships. ENeRF-Outdoor: 18 cameras on an arc; D3DMV: 10 in two
# rows of five.
DEMO_ROOMS: dict[str, DemoOptions] = {
    MAIN: SHIPPED,
    "demo-enerf-outdoor": replace(
        SMALL, layout="enerf-outdoor", seed=1, cameras_per_row=9, rig="arc"
    ),
    "demo-d3dmv": replace(
        SMALL, layout="d3dmv", seed=2, cameras_per_row=5, rig="grid", width=320, height=180
    ),
}


def write_demo(folder: Path, options: DemoOptions, workers: int | None = None) -> Path:
    """Write the capture; a complete one of the same options is left as it is, and one that ships is
    unpacked.

    Args:
        folder: where to; absent, empty, or the same demo.
        workers: processes, by default one per core; 1 stays in this process. The bytes do not
            depend on it.

    Returns:
        The folder: the files of the layout and ``demo.json``; ``depth/camXX.h5`` except for rgbd,
        which has a sensor's depth; with dynerf and colmap ``path/poses_bounds.npy`` and
        ``path/images/`` (one instant, without gain and noise).
    """
    for name, shipped in DEMO_ROOMS.items():
        if options == shipped:
            return write_room(folder, name)
    if is_written(folder, _description(options), LAYOUTS[options.layout].files(options)):
        return folder
    return film_demo(folder, options, workers)


def film_demo(folder: Path, options: DemoOptions, workers: int | None = None) -> Path:
    """Film the capture as `write_demo` does, also if it is included in the package."""
    with atomic_folder(folder) as unfinished, _executor(workers or usable_cpus()) as executor:
        _film(executor, unfinished, options)
    return folder


def _executor(workers: int) -> Executor:
    """Return the processes that start afresh: forked ones would inherit the threads of torch and
    OpenCV.
    """
    if workers == 1:
        return ThreadPoolExecutor(1)
    return worker_pool(workers)


def _film(executor: Executor, folder: Path, options: DemoOptions) -> None:
    """Three rounds: light every instant, film every shot, write what wants all cameras."""
    layout = LAYOUTS[options.layout]
    shots, parts = layout.shots(options), folder / PARTS
    parts.mkdir()
    instants = sorted({index for shot in shots for index in shot.instants})
    _await(
        "lighting the room",
        [executor.submit(light_instant, parts, options, index) for index in instants],
    )
    cameras = _await(
        "filming", [executor.submit(_film_shot, folder, options, shot) for shot in shots]
    )
    # A worker has the room at hand; this process would have to light it first.
    executor.submit(layout.finish, folder, options, cameras).result()
    shutil.rmtree(parts)
    (folder / DEMO_NOTES).write_text(_description(options))


def _film_shot(folder: Path, options: DemoOptions, shot: Shot) -> Camera:
    footage = Footage(options, shot, partial(stored_instant, folder / PARTS, options))
    return LAYOUTS[options.layout].write_shot(folder, footage)


def _await(doing: str, jobs: list[Future[T]]) -> list[T]:
    return [job.result() for job in track(jobs, doing, len(jobs))]


def _description(options: DemoOptions) -> str:
    """Return the text of demo.json.

    Of options that came later it names those that are used, so that old demos stay valid.
    """
    unused = {name for name in LATER if getattr(options, name) == getattr(DemoOptions, name)}
    used_options = {name: value for name, value in asdict(options).items() if name not in unused}
    described = {
        "version": VERSION,
        "options": used_options,
        "units_per_metre": LAYOUTS[options.layout].units_per_metre,
        "path_time_s": options.path_frame / options.fps,
        "camera_gains": [
            [round(float(value), 6) for value in gain] for gain in camera_gains(options)
        ],
    }
    return json.dumps(described, indent=1) + "\n"
