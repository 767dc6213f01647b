"""Calibration in a child process: input, progress, log of a failure."""

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any

from ggvs_eval.errors import CameraError, CaptureError
from ggvs_eval.pipelines.offline.calibration.known_cameras import KnownCamera, colmap_camera
from ggvs_eval.progress import track
from ggvs_eval.run_folder import write_json

LOG = "calibration.log"
WORKER = "ggvs_eval.pipelines.offline.calibration.calibration_worker"
# Lines of COLMAP's log that stand for one more image whose features, or whose pose, have been found.
PROGRESS = re.compile(r"Processed file \[|Registering image #")


def run_worker(unfinished: Path, out: Path, job: Mapping[str, Any]) -> dict[str, Any]:
    """Calibrate in a child process, whose output becomes the log.

    Args:
        unfinished: folder in the making; its ``work/images/`` holds the images, its ``work/sparse/0`` will hold the model.
        out: what it will be called, for errors; the log of a failure is kept beside it.
    """
    work = unfinished / "work"
    write_json(work / "job.json", job)
    command = [sys.executable, "-m", WORKER, str(work)]
    pipe = subprocess.PIPE
    with (
        (unfinished / LOG).open("w", encoding="utf-8") as log,
        subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=subprocess.STDOUT, text=True, errors="replace") as child,
    ):
        try:
            steps = 2 * sum(map(len, job["groups"]))
            for _ in track(_steps(child.stdout or (), log, steps), "calibrating", steps):
                pass
            child.wait()
        finally:
            child.kill()
    result = work / "result.json"
    if child.returncode or not result.is_file():
        kept = keep_log(unfinished, out)
        reason = f"was ended by signal {-child.returncode}" if child.returncode < 0 else f"said '{_last_line(kept)}'"
        raise CaptureError(f"{out}: wanted a calibration, but the process of pycolmap {reason}; see its log {kept}")
    return dict(json.loads(result.read_text(encoding="utf-8")))


def keep_log(unfinished: Path, out: Path) -> Path:
    """Copy the log of a calibration that failed to where it outlives the folder in the making."""
    kept = out.with_name(f"{out.name}.log")
    shutil.copyfile(unfinished / LOG, kept)
    return kept


def describe_known(path: Path, known_cameras: Mapping[str, KnownCamera], *, with_poses: bool) -> dict[str, dict[str, Any]]:
    """Known cameras as the worker reads them, by name."""
    described = {}
    for name, camera in known_cameras.items():
        try:
            model, params = colmap_camera(camera.lens)
        except CameraError as error:
            raise CaptureError(f"{path}: {name}: {error}") from error
        pose = camera.world_to_camera[:3].tolist() if with_poses and camera.world_to_camera is not None else None
        size = {"width": camera.lens.width, "height": camera.lens.height}
        described[name] = size | {"model": model, "params": params, "world_to_camera": pose}
    return described


def _steps(output: "IO[str] | tuple[str, ...]", log: IO[str], most: int) -> Iterator[None]:
    """Copy the child's output into the log; yields, at most so many times, as it goes on."""
    count = 0
    for line in output:
        log.write(line)
        if PROGRESS.search(line) and count < most:
            count += 1
            yield


def _last_line(log: Path) -> str:
    lines = log.read_text(encoding="utf-8").split("\n")
    return next((line.strip()[-200:] for line in reversed(lines) if line.strip()), "nothing")
