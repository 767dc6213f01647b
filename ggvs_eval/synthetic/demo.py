"""The demo capture: the procedural room filmed by the rig, in DyNeRF's layout, with exact depth and a true camera path."""

import json
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import asdict, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from ggvs_eval.camera import Camera
from ggvs_eval.errors import CaptureError
from ggvs_eval.images import Image8, quantise, write_image
from ggvs_eval.processes import worker_pool
from ggvs_eval.progress import track
from ggvs_eval.synthetic.exact_depth import DepthWriter, depth_path
from ggvs_eval.synthetic.geometry import Array32
from ggvs_eval.synthetic.lighting import Instant, LitRoom
from ggvs_eval.synthetic.options import DemoOptions
from ggvs_eval.synthetic.raycast import View
from ggvs_eval.synthetic.rig import UNITS_PER_METRE, llff_poses, rig, sideways_path
from ggvs_eval.synthetic.room import build_room
from ggvs_eval.video import write_video

VERSION = 1
PATH_LENGTH = 5.0
DESCRIPTION = "demo.json"


def write_demo(folder: Path, options: DemoOptions, workers: int | None = None) -> Path:
    """Write the capture; a complete one of the same options is left as it is.

    Args:
        folder: where to; absent, empty, or the same demo.
        options: what to film.
        workers: processes, by default one per core; 1 stays in this process. The bytes do not depend on it.

    Returns:
        The folder: ``camXX.mp4``, ``poses_bounds.npy``, ``depth/camXX.h5``, ``path/poses_bounds.npy`` and ``path/images/`` (one
        instant, without gain and noise) and ``demo.json``.

    Raises:
        CaptureError: the folder holds something else, or has lost some of its files.
    """
    if _is_written(folder, options):
        return folder
    folder.parent.mkdir(parents=True, exist_ok=True)
    unfinished = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    try:
        with _executor(workers or os.cpu_count() or 1) as executor:
            _film(executor, unfinished, options)
        unfinished.chmod(0o755)
        unfinished.replace(folder)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
    return folder


def film(options: DemoOptions, camera: Camera, instants: Iterable[Instant]) -> Iterator[tuple[Image8, Array32]]:
    """Frames of one camera as they go to the encoder, gain and noise included, each with its exact depth.

    Args:
        options: of the demo.
        camera: one of its rig.
        instants: the lit room at each frame.

    Yields:
        RGB uint8 (H, W, 3) and depth in world units, float32 (H, W).
    """
    number = int(camera.name.removeprefix("cam"))
    gain = camera_gains(options)[number]
    rng = np.random.default_rng([options.seed, 3, number])
    view = View(lit_room(options.seed).static, camera, options.supersampling)
    for instant in instants:
        image, depth = view.render(instant)
        noise = rng.standard_normal(image.shape, np.float32) * (options.noise_sigma_255 / 255)
        yield quantise(image * gain + noise), depth


def camera_gains(options: DemoOptions) -> Array32:
    """Factor on the sRGB values of each camera, (N, 3): an exposure and a smaller error of colour balance."""
    rng = np.random.default_rng([options.seed, 4])
    count = 2 * options.cameras_per_row
    exposure, balance = rng.standard_normal((count, 1)), rng.standard_normal((count, 3))
    return (1 + options.exposure_spread * (exposure + 0.5 * balance)).astype(np.float32)


@lru_cache(maxsize=1)
def lit_room(seed: int) -> LitRoom:
    """The room of a seed, lit; kept, as it takes seconds."""
    return LitRoom(build_room(seed))


def _executor(workers: int) -> Executor:
    """Processes that start afresh: forked ones would inherit the threads of torch and OpenCV."""
    if workers == 1:
        return ThreadPoolExecutor(1)
    return worker_pool(workers)


def _film(executor: Executor, folder: Path, options: DemoOptions) -> None:
    """Three rounds: light every instant, film every camera, walk along the path."""
    cameras = rig(options.seed, options.width, options.height, options.cameras_per_row)
    path = sideways_path(cameras[0], PATH_LENGTH, options.path_poses)
    light = folder / "light"
    light.mkdir()
    jobs = [executor.submit(_light_frame, light, options, index) for index in range(options.n_frames)]
    for job in track(jobs, "lighting the room", len(jobs)):
        job.result()
    filmed = [executor.submit(_film_camera, folder, options, camera) for camera in cameras]
    walked = [executor.submit(_walk, folder, options, pose) for pose in path]
    found = [job.result() for job in track(filmed + walked, "filming", len(filmed + walked))]
    np.save(folder / "poses_bounds.npy", llff_poses(found[: len(cameras)]))
    if path:
        np.save(folder / "path" / "poses_bounds.npy", llff_poses(found[len(cameras) :]))
    shutil.rmtree(light)
    (folder / DESCRIPTION).write_text(json.dumps(_description(options), indent=1) + "\n")


def _light_frame(light: Path, options: DemoOptions, index: int) -> None:
    instant = lit_room(options.seed).at(index / options.fps)
    np.savez(light / f"{index:04d}.npz", static=instant.static_light, moving=instant.moving_light)


@lru_cache(maxsize=32)
def _stored_instant(light: Path, options: DemoOptions, index: int) -> Instant:
    with np.load(light / f"{index:04d}.npz") as stored:
        return lit_room(options.seed).recall(index / options.fps, stored["static"], stored["moving"])


def _film_camera(folder: Path, options: DemoOptions, camera: Camera) -> Camera:
    """Write the video and the depth of one camera; gives it with the depth range of its first frame."""
    instants = (_stored_instant(folder / "light", options, index) for index in range(options.n_frames))
    bounded: list[Camera] = []

    def images() -> Iterator[Image8]:
        for index, (image, depth) in enumerate(film(options, camera, instants)):
            if not bounded:
                bounded.append(_with_range(camera, depth))
            kept.add(index, depth)
            yield image

    with DepthWriter(depth_path(folder, camera.name), options.depth_frames, options.height, options.width) as kept:
        write_video(folder / f"{camera.name}.mp4", images(), options.fps, options.crf)
    return bounded[0]


def _walk(folder: Path, options: DemoOptions, pose: Camera) -> Camera:
    """Write one image of the camera path; gives its camera with its depth range."""
    instant = _stored_instant(folder / "light", options, options.path_frame)
    image, depth = View(instant.static, pose, options.supersampling).render(instant)
    write_image(folder / "path" / "images" / f"{pose.name}.png", quantise(image))
    return _with_range(pose, depth)


def _with_range(camera: Camera, depth: Array32) -> Camera:
    """The camera with LLFF's depth range: the 1st and the 99.9th percentile of what it sees."""
    near, far = np.percentile(depth[depth > 0], [1.0, 99.9])
    return replace(camera, near=float(near), far=float(far))


def _description(options: DemoOptions) -> dict[str, object]:
    return {
        "version": VERSION,
        "options": asdict(options),
        "units_per_metre": UNITS_PER_METRE,
        "path_time_s": options.path_frame / options.fps,
        "camera_gains": [[round(float(value), 6) for value in gain] for gain in camera_gains(options)],
    }


def _is_written(folder: Path, options: DemoOptions) -> bool:
    """Whether the folder holds this very demo; False where it is absent or empty."""
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return False
    described = folder / DESCRIPTION
    if not described.is_file():
        raise CaptureError(f"{folder}: wanted an empty folder or a demo of these options, found other files; choose another")
    if described.read_text() != json.dumps(_description(options), indent=1) + "\n":
        raise CaptureError(f"{folder}: holds a demo of other options or another version; delete it or choose another folder")
    needed = ["poses_bounds.npy", *(f"cam{number:02d}.mp4" for number in range(2 * options.cameras_per_row))]
    missing = [name for name in needed if not (folder / name).is_file()]
    if missing:
        raise CaptureError(f"{folder}: this demo has lost {', '.join(missing)}; delete the folder and write it again")
    return True
