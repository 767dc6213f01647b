"""Fit: one scene per fold by every method that is fitted; one job per (method, seed, fold), which goes on where it was killed."""

import shutil
import sys
import time
from dataclasses import dataclass, field
from functools import partial
from operator import index
from pathlib import Path
from typing import Any

from ggvs_eval.capture import Capture
from ggvs_eval.depth_store import DepthStore
from ggvs_eval.errors import ViewRefusedError
from ggvs_eval.jobs.code_identity import code_identity
from ggvs_eval.jobs.free_memory import PeakMemory
from ggvs_eval.kernels import get_threads
from ggvs_eval.pipelines.methods.fitted import FittedMethod
from ggvs_eval.pipelines.run.folds import FitPlan
from ggvs_eval.pipelines.run.footage import fold_footage
from ggvs_eval.pipelines.run.unit_job import UnitJob
from ggvs_eval.progress import LINE_EVERY_S, duration
from ggvs_eval.results import describe_machine
from ggvs_eval.run_folder import REFUSED, read_json, write_json
from ggvs_eval.scene_fitter import Footage

FITS = "fits"  # folder beside truth and depth
TIME_FILE = "seconds.json"  # in the folder of a fit that is not finished
NOTE_EVERY_S = 5.0


def fit_job(capture: Capture, fit: FitPlan, spec: FittedMethod, shared: Path) -> UnitJob:
    """The job of one fit; its folder is the scene, and ``job.json`` says what it took.

    Args:
        capture: whose footage is prepared by the time the job runs.
        shared: folder of the captured frames, of the depth store and of the fits.
    """
    footage = fold_footage(capture, fit, DepthStore(shared / "depth"), spec.seed)
    name = f"{fit.label}, {fit.fold.name}"
    work = partial(_fit, name, spec, footage)
    folder = shared / FITS / fit.label / fit.fold.name
    return UnitJob(name, folder, _identity(capture, fit, spec), work, resumes=True, label=fit.label, units=fit.fold.units)


def _identity(capture: Capture, fit: FitPlan, spec: FittedMethod) -> dict[str, Any]:
    """Everything that the scene depends on; what is held out is no part of it."""
    cameras = {name: capture.camera(name).to_json() for name in fit.fold.cameras}
    return {
        "method": fit.label.partition("+")[0],
        "code": code_identity(*spec.modules, fold_footage.__module__),
        "settings": spec.settings,
        "seed": spec.seed,
        "cameras": cameras,
        "frames": {name: capture.digest(name) for name in cameras},
        "depth": {job.camera_name: job.key for job in fit.fold.jobs},
        "instants": [fit.indices.start, fit.indices.stop],
        "depth_instants": list(fit.depth_indices),
        "fps": capture.fps,
        "units_per_metre": capture.units_per_metre,
        "resize": capture.resize_filter,
        **({} if spec.device == "cpu" else {"device": spec.device}),
    }


def _fit(name: str, method: FittedMethod, footage: Footage, folder: Path) -> dict[str, Any]:
    """Fit, or go on; returns the record for the tables, or why a plug-in left no scene."""
    fitter, clock = method.make_fitter(), FitClock(name, folder)
    try:
        with PeakMemory() as memory, method.guard(f"failed to fit {name}"):
            fitter.fit(footage, folder, clock.note)
            size_bytes = index(fitter.load(folder).size_bytes)
    except ViewRefusedError as error:
        shutil.rmtree(folder)
        folder.mkdir()
        return {REFUSED: str(error)}
    record = {
        "seconds": clock.seconds,
        "instants": len(footage.indices),
        "cameras": len(footage.cameras),
        "look_ahead": fitter.look_ahead,
        "seed": footage.seed,
        "size_bytes": size_bytes,
        "threads": get_threads(),
        "peak_bytes": memory.bytes,
        "machine": _machine(method.device),
    }
    (folder / TIME_FILE).unlink(missing_ok=True)
    return record


def _machine(device: str) -> str:
    if device == "cpu":
        return describe_machine()["processor"]
    from ggvs_eval.compute_device import describe_device

    return describe_device(device)


@dataclass
class FitClock:
    """Time of a fit over all its attempts, and a line per minute about the time left.

    Attributes:
        name: of the fit, for people.
        folder: of the fit; keeps the time that earlier attempts took.
    """

    name: str
    folder: Path
    begun_s: float = field(default_factory=time.monotonic)

    def __post_init__(self) -> None:
        """Pick up the time of earlier attempts."""
        file = self.folder / TIME_FILE
        self._before_s: float = read_json(file)["seconds"] if file.is_file() else 0.0
        self._first_done: int | None = None
        self._noted_s = self._told_s = self.begun_s

    @property
    def seconds(self) -> float:
        """Seconds so far, of all attempts; what passed between an attempt's last note and its death is lost."""
        return self._before_s + time.monotonic() - self.begun_s

    def note(self, done: int, total: int) -> None:
        """Note how far the fit is."""
        now_s = time.monotonic()
        if self._first_done is None:
            self._first_done = done
        if now_s - self._noted_s >= NOTE_EVERY_S:
            write_json(self.folder / TIME_FILE, {"seconds": self.seconds, "done": done, "total": total})
            self._noted_s = now_s
        if now_s - self._told_s >= LINE_EVERY_S:
            pace = (done - self._first_done) / (now_s - self.begun_s)
            left = f", about {duration((total - done) / pace)} left" if pace else ""
            print(f"{self.name}: {done} of {total} steps in {duration(self.seconds)}{left}", file=sys.stderr, flush=True)
            self._told_s = now_s
