"""Fits: one scene per fold by a method that is fitted, one task per (method, seed, fold), which
continues where it was killed.
"""

import shutil
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from operator import index
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from ggvs_eval.capture import Capture
from ggvs_eval.depth_store import DepthJob, DepthStore
from ggvs_eval.errors import RenderError, ViewRefusedError
from ggvs_eval.jobs.engine import Workers
from ggvs_eval.jobs.machine import PeakMemory
from ggvs_eval.kernels import get_threads
from ggvs_eval.pipelines.run.folds import ALL, FoldPlan, fill_folds, plan_folds
from ggvs_eval.pipelines.run.footage import fold_footage
from ggvs_eval.pipelines.run.render import FITS, UnitTask
from ggvs_eval.pipelines.run.run_plan import RunPlan, visible_cameras
from ggvs_eval.progress import LINE_EVERY_S, duration
from ggvs_eval.results import describe_machine
from ggvs_eval.run_folder import REFUSED, read_json, write_json
from ggvs_eval.scene_fitter import Footage, SceneFitter
from ggvs_eval.tasks.identity import code_of
from ggvs_eval.tasks.task import AnyTask

if TYPE_CHECKING:  # which can be deleted alone
    from ggvs_eval.pipelines.methods.fitted import FittedMethod

TIME_FILE = "seconds.json"  # in the folder of a fit that is not finished
NOTE_EVERY_S = 5.0


@dataclass(frozen=True)
class FitPlan:
    """One fit of a method that is fitted to the capture, a `SceneFit`.

    Attributes:
        label: of the method, its seed included.
        fold: what it is shown, and what is held out.
        depth_indices: those at which it wants depth.
    """

    label: str
    fold: FoldPlan
    indices: range
    depth_indices: tuple[int, ...]
    method: "FittedMethod"

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the training cameras."""
        return self.fold.cameras

    @property
    def depth(self) -> tuple[tuple[DepthJob, ...], tuple[int, ...]]:
        """Depth that it is shown, and at which instants."""
        return self.fold.jobs, self.depth_indices

    def task(self, capture: Capture, shared: Path) -> UnitTask:
        """Return the task of the fit; its folder is the scene, and ``job.json`` says what it took.

        Args:
            capture: whose footage is prepared by the time it runs.
            shared: folder of the captured frames, of the depth store and of the fits.
        """
        depths, seed = DepthStore(shared / "depth"), self.method.seed
        footage = fold_footage(capture, self.fold, self.indices, depths, seed)
        name = f"{self.label}, {self.fold.name}"
        return UnitTask(
            name=name,
            folder=shared / FITS / self.label / self.fold.name,
            inputs=_inputs(capture, self),
            make=partial(_fit, name, self.method, footage),
            resumes=True,
            kind="fit",
            pace=self.label,
            label=self.label,
            units=self.fold.units,
            foreign=self.method.foreign,
        )


def complete(plan: RunPlan) -> RunPlan:
    """Return the plan with the fits of its methods that are fitted, and a protocol that states
    their folds.
    """
    fitted = {label: spec for label, spec in plan.methods.items() if spec.preparation == FITS}
    if not fitted:
        return plan
    protocol = fill_folds(plan.protocol, plan.original)
    visible = visible_cameras(plan.original, protocol)
    folds = plan_folds(visible, protocol.views.folds, bool(plan.path), plan.depth)
    fits = plan_fits(
        cast("Mapping[str, FittedMethod]", fitted), folds, plan.frames, plan.path_frame
    )
    return replace(plan, request=replace(plan.request, protocol=protocol), fits=fits)


def tasks(_plan: RunPlan) -> list[AnyTask]:
    """Return nothing: what is rendered from a scene needs its fit."""
    return []


def prepare(_plan: RunPlan, _workers: Workers) -> None:
    """Do nothing: fits are run before what is rendered from them."""


def plan_fits(
    methods: Mapping[str, "FittedMethod"], folds: Sequence[FoldPlan], frames: range, path_frame: int
) -> tuple[FitPlan, ...]:
    """Plan every fit of every fitted method.

    Args:
        folds: see `plan_folds`.
    """
    fits = []
    for label, method in methods.items():
        with method.guard("its fits cannot be planned", RenderError):
            fitter = method.make_fitter()
            for fold in folds:
                indices = _path_instants(fitter, frames, path_frame) if fold.name == ALL else frames
                with_depth = tuple(
                    indices[indices.index(index)] for index in fitter.depth_indices(indices)
                )
                fits.append(
                    FitPlan(
                        label=label,
                        fold=fold,
                        indices=indices,
                        depth_indices=with_depth,
                        method=method,
                    )
                )
    return tuple(fits)


def _path_instants(fitter: SceneFitter, frames: range, path_frame: int) -> range:
    """Return the footage of a fit for the camera path, at one instant: as much of the sequence as
    the method uses.
    """
    if fitter.look_ahead == "none" or path_frame not in frames:
        return range(path_frame, path_frame + 1)
    return range(frames.start, path_frame + 1) if fitter.look_ahead == "past" else frames


def _inputs(capture: Capture, fit: FitPlan) -> dict[str, Any]:
    """Everything that the scene depends on; what is held out is no part of it."""
    cameras, spec = {name: capture.camera(name).to_json() for name in fit.cameras}, fit.method
    return {
        "method": fit.label.partition("+")[0],
        "code": code_of(*spec.modules, fold_footage.__module__),
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


def _fit(name: str, method: "FittedMethod", footage: Footage, folder: Path) -> dict[str, Any]:
    """Fit, or continue; returns the record for the tables, or why a plug-in left no scene."""
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
        """Add the time of earlier attempts."""
        file = self.folder / TIME_FILE
        self._before_s: float = read_json(file)["seconds"] if file.is_file() else 0.0
        self._first_done: int | None = None
        self._noted_s = self._told_s = self.begun_s

    @property
    def seconds(self) -> float:
        """Seconds so far, of all attempts.

        What passed between an attempt's last note and its death is lost.
        """
        return self._before_s + time.monotonic() - self.begun_s

    def note(self, count: int, total: int) -> None:
        """Note how far the fit is."""
        now_s = time.monotonic()
        if self._first_done is None:
            self._first_done = count
        if now_s - self._noted_s >= NOTE_EVERY_S:
            write_json(
                self.folder / TIME_FILE, {"seconds": self.seconds, "done": count, "total": total}
            )
            self._noted_s = now_s
        if now_s - self._told_s >= LINE_EVERY_S:
            pace = (count - self._first_done) / (now_s - self.begun_s)
            left = f", about {duration((total - count) / pace)} left" if pace else ""
            print(
                f"{self.name}: {count} of {total} steps in {duration(self.seconds)}{left}",
                file=sys.stderr,
                flush=True,
            )
            self._told_s = now_s
