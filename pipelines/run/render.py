"""Render: every test view, and a camera path, by every method; one task per method and unit.

Diagnostics are a method's intermediate maps, as pictures next to its frames that the page shows.
"""

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from typing import Protocol as Door

import numpy as np

from ggvs_eval.arrays import Image8, Map
from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.colour_maps import coloured, depth_colours
from ggvs_eval.depth_store import DepthJob
from ggvs_eval.errors import RenderError, ViewRefusedError
from ggvs_eval.files.images import quantise, write_image
from ggvs_eval.jobs.machine import PeakMemory
from ggvs_eval.kernels import get_threads
from ggvs_eval.pipelines.methods.render_unit import PATH, RenderUnit
from ggvs_eval.pipelines.methods.spec import MethodSpec
from ggvs_eval.results import installed_versions, split_label
from ggvs_eval.run_folder import (
    JOB_FILE,
    REFUSED,
    RunFolder,
    diagnostics_path,
    frame_path,
    read_json,
    write_json,
)
from ggvs_eval.tasks.identity import code_of
from ggvs_eval.tasks.task import Task

# Okabe and Ito's colours, which the colour-blind can distinguish: one for each source view, nearest
# first.
VIEW_COLOURS = np.array(
    [
        (230, 159, 0),
        (86, 180, 233),
        (0, 158, 115),
        (240, 228, 66),
        (0, 114, 178),
        (213, 94, 0),
        (204, 121, 167),
    ],
    np.float32,
)
OF_TASK = ("sha256", "identity", "files")  # in a record, besides what its maker says
FITS = "fits"  # folder next to truth and depth


@dataclass(frozen=True, kw_only=True)
class UnitTask(Task):
    """A task of one method.

    Attributes:
        label: of the method.
        units: the test view that it renders, or ``path``; of a fit, all that are rendered from it.
    """

    label: str
    units: tuple[str, ...]

    @property
    def unit(self) -> str:
        """The only one of its units."""
        (unit,) = self.units
        return unit


class SceneFit(Door):
    """A scene that is fitted before a method renders from it.

    Attributes:
        label: of the method.
        cameras: that it is shown.
        indices: instants that it is shown.
        depth: jobs of depth, and the instants that it wants it of.
    """

    @property
    def label(self) -> str: ...  # noqa: D102

    @property
    def indices(self) -> range: ...  # noqa: D102

    @property
    def cameras(self) -> tuple[str, ...]: ...  # noqa: D102

    @property
    def depth(self) -> tuple[tuple[DepthJob, ...], tuple[int, ...]]: ...  # noqa: D102

    def task(self, capture: Capture, shared: Path, /) -> UnitTask:
        """Return the task that fits it."""


def render_task(
    run: RunFolder, label: str, spec: MethodSpec, unit: RenderUnit, fit: UnitTask | None = None
) -> UnitTask:
    """Return the task that renders one unit by one method.

    Args:
        fit: of the scene that it is rendered from.
    """
    inputs = {"method": label, "code": method_code(spec), **spec.identity(unit)}
    if spec.device != "cpu":  # whose bits are equal everywhere
        from ggvs_eval.compute_device import describe_device

        inputs["device"] = describe_device(spec.device)
    is_path = unit.name == PATH
    return UnitTask(
        name=f"{label} along the path" if is_path else f"{label} in {unit.name}",
        folder=run.path(label) if is_path else run.renders(label, unit.name),
        inputs=inputs,
        make=partial(_render, label, spec, unit),
        kind="path render" if is_path else "render",
        pace=label,
        count=len(unit.shots),
        needs=(fit,) if fit else (),
        label=label,
        units=(unit.name,),
        foreign=spec.foreign,
    )


def method_code(spec: MethodSpec) -> str:
    """Return the hash of the code that a method's frames are made by, from the captured ones to the
    files.
    """
    return code_of(*spec.modules, RenderUnit.__module__)


def note_labels(run: RunFolder, labels: Sequence[str]) -> None:
    """Remember the order in which methods were asked for, the last time for all of them.

    A table shows them in it.
    """
    order = run.root / "methods.json"
    record = read_json(order) if order.is_file() else {}
    before = record.get("labels", [])
    merged = list(dict.fromkeys([*([] if set(before) <= set(labels) else before), *labels]))
    if merged != record.get("labels"):
        write_json(order, {"labels": merged})


def _render(label: str, spec: MethodSpec, unit: RenderUnit, folder: Path) -> dict[str, Any]:
    """Write the pictures of a unit.

    Returns what job.json records besides the identity: seconds per stage.
    """
    seconds: list[dict[str, float]] = []
    refused: dict[str, str] = {}
    with PeakMemory() as memory:
        try:
            for (number, _, target), rendering in zip(
                unit.shots, spec.renderings(unit), strict=True
            ):
                if not np.isfinite(rendering.image).all():
                    raise RenderError(
                        f"{label}, frame {number}: wanted an image of finite numbers, got others"
                    )
                write_image(frame_path(folder, number), quantise(rendering.image))
                with spec.guard(f"its diagnostics of frame {number} are none"):
                    maps = {
                        name: diagnostics_picture(name, values, target)
                        for name, values in rendering.diagnostics.items()
                    }
                for name, picture in maps.items():
                    write_image(diagnostics_path(folder, name, number), picture)
                seconds.append(rendering.seconds)
        except ViewRefusedError as error:  # of some poses of a path: it has no picture then
            shutil.rmtree(folder)
            folder.mkdir()
            seconds, refused = [], {REFUSED: str(error)}
    name, variant = split_label(label)
    record = {
        "method": name,
        "variant": variant,
        "size": list(unit.plans[0].target.size),
        "seconds": {
            stage: [frame.get(stage, 0.0) for frame in seconds]
            for stage in (seconds[0] if seconds else ())
        },
        "threads": get_threads(),
        "peak_bytes": memory.bytes,
        "versions": installed_versions(),
        **refused,
    }
    took = read_json(unit.fit.folder / JOB_FILE) if unit.fit else {REFUSED: "no fit"}
    if REFUSED in took:
        return record
    return record | {"fit": {name: value for name, value in took.items() if name not in OF_TASK}}


def diagnostics_picture(name: str, values: Map, target: Camera) -> Image8:
    """Return one map of `Rendering.diagnostics` in the colours of its kind, (h, w, 3)."""
    return _PICTURES[name](values, target)


def view_colours(weights: Map) -> Image8:
    """Return the weights as a mixture of one colour per source view.

    Dark where the background takes over.

    Args:
        weights: (K, h, w); what is missing to a sum of 1 is the background's. From the eighth view
            on colours come again.
    """
    colours = np.take(VIEW_COLOURS, np.arange(len(weights)), axis=0, mode="wrap")
    return np.rint(np.einsum("khw,kc->hwc", weights, colours).clip(0, 255)).astype(np.uint8)


def _share(values: Map, _target: Camera) -> Image8:
    return coloured(values, "cividis", np.ones(values.shape, np.bool_))


_PICTURES: Mapping[str, Callable[[Map, Camera], Image8]] = {
    "depth": lambda depth, target: depth_colours(depth, target.near, target.far),
    "weights": lambda weights, _target: view_colours(weights),
    "coverage": _share,
    "motion": _share,
}
