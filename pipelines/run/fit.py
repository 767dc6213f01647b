"""Fit: one scene per fold by every method that is fitted; one job per (method, seed, fold), which goes on where it was killed."""

import sys
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from ggvs_eval.capture import Capture
from ggvs_eval.depth_store import DepthStore
from ggvs_eval.errors import RenderError
from ggvs_eval.jobs.code_identity import code_identity
from ggvs_eval.jobs.engine import Workers, as_engine
from ggvs_eval.jobs.job import Job
from ggvs_eval.jobs.processes import default_workers
from ggvs_eval.pipelines.methods.network_options import AS_SHIPPED, NetworkOptions
from ggvs_eval.pipelines.methods.registry import find_method
from ggvs_eval.pipelines.methods.spec import MethodSpec
from ggvs_eval.pipelines.run.folds import ALL, FitPlan
from ggvs_eval.pipelines.run.footage import fold_footage
from ggvs_eval.pipelines.run.run_plan import RunPlan
from ggvs_eval.progress import LINE_EVERY_S, duration
from ggvs_eval.results import describe_machine
from ggvs_eval.run_folder import read_json, write_json
from ggvs_eval.scene_fitter import Footage, SceneFitter

PATH_UNIT = "path"  # the camera path, beside the test views
FITS = "fits"  # folder beside truth and depth
TIME_FILE = "seconds.json"  # in the folder of a fit that is not finished
NOTE_EVERY_S = 5.0


def fit_jobs(
    plan: RunPlan,
    labels: Sequence[str],
    workers: Workers = 1,
    networks: NetworkOptions = AS_SHIPPED,
    units: Collection[str] | None = None,
) -> list[Job]:
    """List the fits of some methods, in the order of the folds; none for methods that are not fitted.

    Args:
        plan: of a run whose footage and depth are prepared by the time the jobs run.
        labels: methods.
        workers: where jobs run.
        networks: where they compute.
        units: test views, or ``path``, that will be rendered from them; None for all.
    """
    at_once = as_engine(workers).jobs
    fits = [fit for fit in plan.fits if fit.label in labels]
    needed = [fit for fit in fits if units is None or not set(units).isdisjoint(fit.fold.held_out or (PATH_UNIT,))]
    return [fit_job(plan, fit, networks, at_once) for fit in needed]


def fit_of_view(plan: RunPlan, label: str, view: str) -> FitPlan:
    """The fit that a test view is held out from.

    Raises:
        RenderError: the run was not planned with this method.
    """
    return _only([fit for fit in plan.fits if fit.label == label and view in fit.fold.held_out], label)


def fit_of_path(plan: RunPlan, label: str) -> FitPlan:
    """The fit of all cameras, for the camera path; errors as of `fit_of_view`."""
    return _only([fit for fit in plan.fits if fit.label == label and fit.fold.name == ALL], label)


def _only(fits: list[FitPlan], label: str) -> FitPlan:
    if not fits:
        raise RenderError(f"{label} is fitted, and this run was planned without it; prepare the run with this method")
    return fits[0]


def fit_job(plan: RunPlan, fit: FitPlan, networks: NetworkOptions = AS_SHIPPED, at_once: int = 1) -> Job:
    """The job of one fit; its folder is the scene, and ``job.json`` says what it took."""
    spec = find_method(fit.label, networks)
    footage = fold_footage(plan.capture, fit, DepthStore(plan.shared_root / "depth"), spec.seed)
    name = f"{fit.label}, {fit.fold.name}"
    work = partial(_fit, name, spec.make_fitter(), footage, spec.device, max(default_workers() // at_once, 1))
    folder = plan.shared_root / FITS / fit.label / fit.fold.name
    return Job(name, folder, _identity(plan.capture, fit, spec), work, resumes=True)


def _identity(capture: Capture, fit: FitPlan, spec: MethodSpec) -> dict[str, Any]:
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


def _fit(name: str, fitter: SceneFitter, footage: Footage, device: str, threads: int, folder: Path) -> dict[str, Any]:
    """Fit, or go on; returns what the tables say about it."""
    clock = FitClock(name, folder)
    fitter.fit(footage, folder, clock.note)
    record = {
        "seconds": clock.seconds,
        "instants": len(footage.indices),
        "cameras": len(footage.cameras),
        "look_ahead": fitter.look_ahead,
        "seed": footage.seed,
        "size_bytes": fitter.load(folder).size_bytes,
        "threads": threads,
        "machine": _machine(device),
    }
    (folder / TIME_FILE).unlink(missing_ok=True)
    return record


def _machine(device: str) -> str:
    """The processor or the graphics card, in words."""
    if device == "cpu":
        return describe_machine()["processor"]
    from ggvs_eval.compute_device import compute_device, describe_device

    return describe_device(compute_device(device))


@dataclass
class FitClock:
    """Time of a fit over all its attempts, and a line per minute about what is left.

    Attributes:
        name: of the fit, for people.
        folder: of the fit; keeps the time that earlier attempts took.
    """

    name: str
    folder: Path
    begun_s: float = field(default_factory=time.monotonic)

    def __post_init__(self) -> None:
        """Pick up what earlier attempts took."""
        file = self.folder / TIME_FILE
        self._before_s: float = read_json(file)["seconds"] if file.is_file() else 0.0
        self._first_done: int | None = None
        self._noted_s = self._told_s = self.begun_s

    @property
    def seconds(self) -> float:
        """Seconds so far, of all attempts; what passed between an attempt's last note and its death is lost."""
        return self._before_s + time.monotonic() - self.begun_s

    def note(self, done: int, total: int) -> None:
        """Note how far the fit is.

        Args:
            done: steps from the fit's very beginning.
            total: steps in all.
        """
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
