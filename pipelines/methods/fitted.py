"""Methods that are fitted to one capture: offline references, and what optimises frame by frame."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from ggvs_eval.errors import RenderError
from ggvs_eval.method import Method
from ggvs_eval.pipelines.methods.spec import MethodSpec, option_values, option_words


def _no_step(title: str, **_: Any) -> Method:
    raise RenderError(f"{title} is fitted to a whole capture and cannot be shown frame by frame; render it with `ggvs-eval run`")


def fitted_method(title: str, describe: str, fitter: str, online: bool = False) -> MethodSpec:
    """A method by its `SceneFitter`.

    Args:
        title: how tables call it.
        describe: one line for the help and the report.
        fitter: ``module:class``, a frozen dataclass of its options.
        online: whether it sees nothing of the future.
    """
    module = fitter.partition(":")[0]
    return MethodSpec(title, describe, partial(_no_step, title), (module,), online=online, usual=False, fitter=fitter)


FITTED: dict[str, MethodSpec] = {
    "4dgs": fitted_method(
        "4DGS (compact)",
        "a cloud of Gaussians, moved by a HexPlane field or (motion=linear, polynomial) each by itself, fit to the whole clip",
        "ggvs_eval.baselines.fitted.four_d:FourD",
    ),
    "3dgs-per-instant": fitted_method(
        "3DGS per Instant",
        "a cloud of Gaussians fitted to each instant alone: the best of one instant, with nothing that ties it to the next",
        "ggvs_eval.baselines.fitted.per_instant:PerInstant",
        online=True,
    ),
    "3dgstream": fitted_method(
        "3DGStream (compact)",
        "the cloud of the previous instant, moved by a small field and completed, with seconds of fitting per instant",
        "ggvs_eval.baselines.fitted.stream:Stream",
        online=True,
    ),
}


def configured_fit(label: str, spec: MethodSpec, variant: str) -> MethodSpec:
    """A fitted method with the options and the seed that its label names.

    Raises:
        RenderError: an option that it has not, or a seed that is none.
    """
    values = option_values(variant)
    words = option_words(values)
    seed = values.pop("seed", 0)
    if type(seed) is not int or seed < 0:
        raise RenderError(f"method {label}: seed must be a whole number of 0 or more, got {seed!r}")
    configured = replace(spec, title=f"{spec.title}, {words}", fitter_options=values, seed=seed)
    configured.make_fitter()
    return configured


def splats_method(label: str, path: Path) -> MethodSpec:
    """A method that renders Gaussians which others have fitted.

    Args:
        label: how tables call it, too.
        path: of their files, see `ggvs_eval.pipelines.methods.splats.splats_files`.
    """
    describe = f"3D Gaussians that others have fitted, {path.name}, rendered by the splat of this package"
    modules = ("ggvs_eval.pipelines.methods.splats",)
    return MethodSpec(
        label, describe, partial(_no_step, label), modules, online=False, usual=False, splats=path, uses_depth=False
    )
