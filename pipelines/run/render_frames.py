"""What the jobs of `render` do: frames of one method, in one view or along the camera path, and how long each took."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.depth_store import DepthStore
from ggvs_eval.errors import RenderError
from ggvs_eval.files.images import quantise, write_image
from ggvs_eval.jobs.ledger import Entry
from ggvs_eval.jobs.processes import default_workers
from ggvs_eval.method import Instant, Method
from ggvs_eval.pipelines.methods.registry import split_label
from ggvs_eval.pipelines.methods.spec import MethodSpec
from ggvs_eval.pipelines.methods.splats import open_splats
from ggvs_eval.pipelines.run.diagnostics import write_diagnostics
from ggvs_eval.pipelines.run.instants import path_instants, view_instants
from ggvs_eval.pipelines.run.run_plan import SourcePlan
from ggvs_eval.results import installed_versions
from ggvs_eval.run_folder import JOB_FILE, frame_path, read_json
from ggvs_eval.scene_fitter import FittedScene

Shot = tuple[int, int, Camera]  # number of the frame in its folder, instant, target


def render_view(
    label: str, spec: MethodSpec, capture: Capture, plan: SourcePlan, frames: range, store: Path, workers: int, folder: Path
) -> dict[str, Any]:
    """Stream the source cameras through one method; only the frames of one instant are in memory."""
    method = spec.make()
    instants = view_instants(method, capture, plan, frames, DepthStore(store))
    seconds = [_render_frame(method, instant, frame_path(folder, instant.index)) for instant in instants]
    return _record(label, seconds, plan.target, workers)


def render_path(
    label: str,
    spec: MethodSpec,
    capture: Capture,
    plans: Sequence[SourcePlan],
    frame: int,
    store: Path,
    workers: int,
    folder: Path,
) -> dict[str, Any]:
    """Move the target camera along the path while time stands still."""
    method = spec.make()
    instants = path_instants(capture, plans, frame, DepthStore(store))
    seconds = [_render_frame(method, instant, frame_path(folder, instant.index)) for instant in instants]
    return _record(label, seconds, plans[0].target, workers)


def render_scene(label: str, spec: MethodSpec, fit: Entry, shots: Sequence[Shot], workers: int, folder: Path) -> dict[str, Any]:
    """Load a fitted scene once and render every shot of it."""
    if not fit.is_done():
        raise RenderError(f"{fit.name}: its scene is not in {fit.folder}; render again, which fits it first")
    record = _render_shots(label, spec.make_fitter().load(fit.folder), shots, workers, folder)
    took = {name: value for name, value in read_json(fit.folder / JOB_FILE).items() if name not in ("sha256", "identity")}
    return record | {"fit": took}


def render_splats(label: str, path: Path, instants: range, shots: Sequence[Shot], workers: int, folder: Path) -> dict[str, Any]:
    """Open the files once and render every shot of them."""
    return _render_shots(label, open_splats(path, instants), shots, workers, folder)


def _render_shots(label: str, scene: FittedScene, shots: Sequence[Shot], workers: int, folder: Path) -> dict[str, Any]:
    seconds = []
    for number, frame, target in shots:
        rendering = scene.render(frame, target)
        write_image(frame_path(folder, number), quantise(rendering.image))
        write_diagnostics(folder, number, rendering.diagnostics, target)
        seconds.append(rendering.seconds)
    return _record(label, seconds, shots[0][2], workers)


def _render_frame(method: Method, instant: Instant, path: Path) -> dict[str, float]:
    rendering = method.step(instant)
    write_image(path, quantise(rendering.image))
    write_diagnostics(path.parent, instant.index, rendering.diagnostics, instant.target)
    return rendering.seconds


def _record(label: str, seconds: Sequence[dict[str, float]], target: Camera, workers: int) -> dict[str, Any]:
    """Return what job.json records beside the identity: how long each stage of each frame took, and with what."""
    method, variant = split_label(label)
    return {
        "method": method,
        "variant": variant,
        "size": list(target.size),
        "seconds": {stage: [frame[stage] for frame in seconds] for stage in seconds[0]},
        "threads": max(default_workers() // workers, 1),
        "versions": installed_versions(),
    }
