"""Render: every test view, and a camera path, by every method; one job per method and unit."""

import shutil
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ggvs_eval.errors import RenderError, ViewRefusedError
from ggvs_eval.files.images import quantise, write_image
from ggvs_eval.jobs.code_identity import code_identity
from ggvs_eval.jobs.free_memory import PeakMemory
from ggvs_eval.kernels import get_threads
from ggvs_eval.pipelines.methods.render_unit import PATH, RenderUnit
from ggvs_eval.pipelines.methods.spec import MethodSpec
from ggvs_eval.pipelines.run.diagnostics import diagnostics_picture
from ggvs_eval.pipelines.run.unit_job import UnitJob
from ggvs_eval.results import installed_versions, split_label
from ggvs_eval.run_folder import JOB_FILE, REFUSED, RunFolder, diagnostics_path, frame_path, read_json, write_json


def render_job(run: RunFolder, label: str, spec: MethodSpec, unit: RenderUnit) -> UnitJob:
    """The job that renders one unit by one method."""
    identity = {"method": label, "code": method_code(spec), **spec.identity(unit)}
    if spec.device != "cpu":  # whose bits are equal everywhere
        from ggvs_eval.compute_device import describe_device

        identity["device"] = describe_device(spec.device)
    if unit.name == PATH:
        name, folder = f"{label} along the path", run.path(label)
    else:
        name, folder = f"{label} in {unit.name}", run.renders(label, unit.name)
    return UnitJob(name, folder, identity, partial(_render, label, spec, unit), label=label, units=(unit.name,))


def method_code(spec: MethodSpec) -> str:
    """Hash of the code that a method's frames are made by, from the captured ones to the files."""
    return code_identity(*spec.modules, RenderUnit.__module__)


def note_labels(run: RunFolder, labels: Sequence[str]) -> None:
    """Remember the order in which methods were asked for; a table shows them in it."""
    order = run.root / "methods.json"
    record = read_json(order) if order.is_file() else {}
    merged = list(dict.fromkeys([*record.get("labels", []), *labels]))
    if merged != record.get("labels"):
        write_json(order, {"labels": merged})


def _render(label: str, spec: MethodSpec, unit: RenderUnit, folder: Path) -> dict[str, Any]:
    """Write the pictures of a unit; returns what job.json records beside the identity: how long each stage of each took."""
    seconds, refused = [], {}
    with PeakMemory() as memory:
        try:
            for (number, _, target), rendering in zip(unit.shots, spec.renderings(unit), strict=True):
                if not np.isfinite(rendering.image).all():
                    raise RenderError(f"{label}, frame {number}: wanted a picture of numbers, some are none")
                write_image(frame_path(folder, number), quantise(rendering.image))
                with spec.guard(f"its diagnostics of frame {number} are none"):
                    maps = {name: diagnostics_picture(name, each, target) for name, each in rendering.diagnostics.items()}
                for name, picture in maps.items():
                    write_image(diagnostics_path(folder, name, number), picture)
                seconds.append(rendering.seconds)
        except ViewRefusedError as error:  # of some poses of a path: it has no picture then
            shutil.rmtree(folder)
            folder.mkdir()
            seconds, refused = [], {REFUSED: str(error)}
    method, variant = split_label(label)
    record = {
        "method": method,
        "variant": variant,
        "size": list(unit.plans[0].target.size),
        "seconds": {stage: [frame.get(stage, 0.0) for frame in seconds] for stage in (seconds[0] if seconds else ())},
        "threads": get_threads(),
        "peak_bytes": memory.bytes,
        "versions": installed_versions(),
        **refused,
    }
    took = read_json(unit.fit.folder / JOB_FILE) if unit.fit else {REFUSED: "no fit"}
    if REFUSED in took:
        return record
    return record | {"fit": {name: value for name, value in took.items() if name not in ("sha256", "identity")}}
