"""Render: every test view, and a camera path, by every method; one job per (method, view)."""

import hashlib
from collections.abc import Collection, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from ggvs_eval.camera import Camera
from ggvs_eval.files.digest import digest_files
from ggvs_eval.jobs.code_identity import code_identity
from ggvs_eval.jobs.engine import Workers, as_engine
from ggvs_eval.jobs.job import Job, run_jobs
from ggvs_eval.jobs.ledger import Ledger
from ggvs_eval.pipelines.methods.network_options import AS_SHIPPED, NetworkOptions
from ggvs_eval.pipelines.methods.registry import find_method
from ggvs_eval.pipelines.methods.spec import MethodSpec
from ggvs_eval.pipelines.methods.splats import splats_files
from ggvs_eval.pipelines.run.fit import PATH_UNIT, fit_job, fit_jobs, fit_of_path, fit_of_view
from ggvs_eval.pipelines.run.folds import FitPlan
from ggvs_eval.pipelines.run.instants import view_instants
from ggvs_eval.pipelines.run.render_frames import Shot, render_path, render_scene, render_splats, render_view
from ggvs_eval.pipelines.run.run_plan import RunPlan, SourcePlan
from ggvs_eval.run_folder import RunFolder, read_json, write_json


def render(prepared: RunPlan, labels: Sequence[str], workers: Workers = 1, networks: NetworkOptions = AS_SHIPPED) -> int:
    """Synthesise the protocol's views and the camera path by each method; what exists is not rendered again.

    Args:
        prepared: the run folder with truth and depth.
        labels: methods, see `ggvs_eval.pipelines.methods.registry.METHODS`.
        workers: where jobs run.
        networks: with which weights and where networks compute.

    Returns:
        Number of (method, view) jobs that were run.

    Raises:
        DeviceError: no such device here.
        RenderError: unknown method, or jobs that failed; each is listed.
        WeightsError: a method lacks its weights, or they are not its own.
    """
    fits = needed_fits(prepared, labels, workers, networks)
    fitted = {fit.label for fit in prepared.fits}
    swift = render_jobs(prepared, [label for label in labels if label not in fitted], workers, networks)
    slow = render_jobs(prepared, [label for label in labels if label in fitted], workers, networks)
    ledger = Ledger(prepared.run.root, "render")
    ledger.write([job.entry for job in (*swift, *slow)])
    done = run_jobs(swift, workers, "rendering", ledger)
    if fits:
        of_fits = Ledger(prepared.shared_root, "fit")
        of_fits.write([job.entry for job in fits])
        run_jobs(fits, workers, "fitting", of_fits)
        done += run_jobs(slow, workers, "rendering from fitted scenes", ledger)
    note_labels(prepared.run, labels)
    return done


def render_jobs(
    prepared: RunPlan, labels: Sequence[str], workers: Workers = 1, networks: NetworkOptions = AS_SHIPPED
) -> list[Job]:
    """List the jobs that `render` runs: one per method along the camera path, and one per method and test view.

    Raises:
        DeviceError: no such device here.
        RenderError: unknown method.
        WeightsError: a method lacks its weights, or they are not its own.
    """
    specs = {label: find_method(label, networks) for label in labels}
    for spec in specs.values():
        spec.require()  # what is missing shows before anything is rendered
    at_once = as_engine(workers).jobs
    views = prepared.protocol.views.test
    along_path = [_path_job(prepared, label, spec, at_once) for label, spec in specs.items() if prepared.path]
    in_views = [_view_job(prepared, label, spec, view, at_once) for label, spec in specs.items() for view in views]
    # The longest first, so that all workers end at about the same time.
    return along_path + in_views if len(prepared.path) > len(prepared.frames) else in_views + along_path


def needed_fits(
    prepared: RunPlan,
    labels: Sequence[str],
    workers: Workers = 1,
    networks: NetworkOptions = AS_SHIPPED,
    units: Collection[str] | None = None,
) -> list[Job]:
    """List the fits that are done, or that something is still to be rendered from: a scene may go when its frames are there.

    Args:
        prepared: the run.
        labels: methods.
        workers: where jobs run.
        networks: with which weights and where networks compute.
        units: test views, or ``path``, that are rendered; None for all.
    """
    needed = []
    for label in dict.fromkeys(fit.label for fit in prepared.fits if fit.label in labels):
        missing = [job for job in render_jobs(prepared, [label], workers, networks) if not job.is_done()]
        left = {PATH_UNIT if job.folder == prepared.run.path(label) else job.folder.name for job in missing}
        asked = left if units is None else left.intersection(units)
        open_folders = {job.folder for job in fit_jobs(prepared, [label], workers, networks, asked)}
        fits = fit_jobs(prepared, [label], workers, networks, units)
        needed += [job for job in fits if job.folder in open_folders or job.is_done()]
    return needed


def note_labels(run: RunFolder, labels: Sequence[str]) -> None:
    """Remember the order in which methods were asked for; a table shows them in it."""
    order = run.root / "methods.json"
    record = read_json(order) if order.is_file() else {}
    merged = list(dict.fromkeys([*record.get("labels", []), *labels]))
    if merged != record.get("labels"):
        write_json(order, {"labels": merged})


def _view_job(prepared: RunPlan, label: str, spec: MethodSpec, view: str, workers: int) -> Job:
    """The job of one method in one test view over all frames of the protocol."""
    plan, frames = prepared.plans[view], prepared.frames
    name, folder = f"{label} in {view}", prepared.run.renders(label, view)
    if spec.is_fitted:
        shots = [(index, index, plan.target) for index in frames]
        return _scene_job(prepared, name, folder, fit_of_view(prepared, label, view), spec, shots, workers)
    if spec.splats:
        return _splats_job(prepared, name, folder, label, spec, [(index, index, plan.target) for index in frames], workers)
    work = partial(render_view, label, spec, prepared.capture, plan, frames, prepared.run.depth, workers)
    return Job(name, folder, _identity(prepared, label, spec, [plan]), work)


def _path_job(prepared: RunPlan, label: str, spec: MethodSpec, workers: int) -> Job:
    """The job of one method along the camera path, at the one instant of the path."""
    name, folder = f"{label} along the path", prepared.run.path(label)
    if spec.is_fitted:
        shots = [(pose, prepared.path_frame, plan.target) for pose, plan in enumerate(prepared.path)]
        return _scene_job(prepared, name, folder, fit_of_path(prepared, label), spec, shots, workers)
    if spec.splats:
        shots = [(pose, prepared.path_frame, plan.target) for pose, plan in enumerate(prepared.path)]
        return _splats_job(prepared, name, folder, label, spec, shots, workers)
    work = partial(render_path, label, spec, prepared.capture, prepared.path, prepared.path_frame, prepared.run.depth, workers)
    return Job(name, folder, _identity(prepared, label, spec, prepared.path), work)


def _scene_job(
    prepared: RunPlan, name: str, folder: Path, fit: FitPlan, spec: MethodSpec, shots: Sequence[Shot], workers: int
) -> Job:
    """The job that renders from a fitted scene, which has seen none of what is rendered."""
    scene = fit_job(prepared, fit, NetworkOptions(device=spec.device))
    identity = {
        "method": fit.label,
        "code": method_code(spec),
        "fit": scene.sha256,
        "shots": [[number, frame, *_camera_values(target)] for number, frame, target in shots],
        **({} if spec.device == "cpu" else {"device": _described(spec.device)}),
    }
    return Job(name, folder, identity, partial(render_scene, fit.label, spec, scene.entry, shots, workers))


def _splats_job(
    prepared: RunPlan, name: str, folder: Path, label: str, spec: MethodSpec, shots: Sequence[Shot], workers: int
) -> Job:
    """The job that renders Gaussians which others have fitted."""
    path, instants = Path(spec.splats or ""), range(prepared.capture.n_frames)
    identity = {
        "method": label,
        "code": method_code(spec),
        "splats": digest_files(splats_files(path)),
        "instants": [instants.start, instants.stop],
        "shots": [[number, frame, *_camera_values(target)] for number, frame, target in shots],
    }
    return Job(name, folder, identity, partial(render_splats, label, path.resolve(), instants, shots, workers))


def _identity(prepared: RunPlan, label: str, spec: MethodSpec, plans: Sequence[SourcePlan]) -> dict[str, Any]:
    """Everything that the pixels depend on; the CPU goes without saying, as its bits are equal everywhere."""
    sources = {(name, prepared.capture.digest(name), key) for plan in plans for name, key in plan.depth_keys.items()}
    return {
        "method": label,
        "code": method_code(spec),
        "settings": spec.settings,
        "weights": [hashlib.sha256(file.read_bytes()).hexdigest() for file in spec.weights],
        "targets": [_camera_values(plan.target) for plan in plans],
        "sources": sorted(sources),
        "shares": [plan.shares for plan in plans],
        "frames": [prepared.frames.start, prepared.frames.stop, prepared.path_frame],
        "units_per_metre": prepared.capture.units_per_metre,
        "resize": prepared.capture.resize_filter,
        **({} if spec.device == "cpu" else {"device": _described(spec.device)}),
    }


def method_code(spec: MethodSpec) -> str:
    """Hash of the code that a method's frames are made by, from the captured ones to the files."""
    return code_identity(*spec.modules, view_instants.__module__)


def _described(device: str) -> str:
    """A device in words, its model included: another one rounds otherwise."""
    from ggvs_eval.compute_device import compute_device, describe_device

    return describe_device(compute_device(device))


def _camera_values(camera: Camera) -> list[float]:
    return [*camera.K.ravel(), *camera.world_to_camera.ravel(), *camera.size, camera.near, camera.far]
