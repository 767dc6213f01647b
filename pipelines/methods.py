"""Every method by the name that the command line and the folders use."""

import difflib
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any

from ggvs_eval.baselines.method import Method
from ggvs_eval.errors import RenderError
from ggvs_eval.toml_tables import build_table


@dataclass(frozen=True)
class MethodSpec:
    """One method or variant of it.

    Attributes:
        title: how tables call it.
        describe: one line for the help and the report.
        make: builds a fresh object that renders one sequence.
        packages: code its output depends on; a change there makes its renders stale.
        ours: whether it is this project's method or an ablation of it.
        online: whether it sees nothing of the future.
        usual: whether it is rendered where nobody names methods; ablations that only a sweep asks for are not.
        weights: files of the trained weights it renders with, see `weights_files`.
    """

    title: str
    describe: str
    make: Callable[[], Method]
    packages: tuple[str, ...]
    ours: bool = False
    online: bool = True
    usual: bool = True
    weights: tuple[str, ...] = ()


def _no_blending() -> Method:
    from ggvs_eval.baselines.no_blending import NoBlending

    return NoBlending()


def _distance_based() -> Method:
    from ggvs_eval.baselines.distance_based import DistanceBased

    return DistanceBased()


def _ours_geometric() -> Method:
    from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided

    return GeometryGuided()


def _ours_geometric_no_temporal() -> Method:
    from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided, OnlineOptions

    return GeometryGuided(OnlineOptions(temporal=False))


def _ours_geometric_points() -> Method:
    from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided, OnlineOptions

    return GeometryGuided(OnlineOptions(splatted_as="points"))


def _ours_geometric_no_background() -> Method:
    from ggvs_eval.pipelines.online.geometric_blender import GeometricBlender
    from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided

    return GeometryGuided(blender=GeometricBlender(background=False))


def _ours_geometric_offline() -> Method:
    from ggvs_eval.pipelines.online.whole_sequence import WholeSequence

    return WholeSequence()


def _ours_geometric_with(options: Any) -> Method:
    from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided

    return GeometryGuided(options)


BASELINE_CODE = ("ggvs_eval.kernels", "ggvs_eval.geometry", "ggvs_eval.baselines")
ONLINE_CODE = (*BASELINE_CODE, "ggvs_eval.pipelines.online")

# The label is `method` or `method+variant`; renders of a method lie in a folder of that name.
METHODS: dict[str, MethodSpec] = {
    "no-blending": MethodSpec(
        "No Blending", "all Gaussians of the K views in one pass, the nearest wins", _no_blending, BASELINE_CODE
    ),
    "distance-based": MethodSpec(
        "Distance-based Blending", "splatted views weighted by camera distance (LLFF)", _distance_based, BASELINE_CODE
    ),
    "ours-geometric": MethodSpec(
        "Ours (geometric weights)",
        "the whole online method with geometric weights in place of the blending network",
        _ours_geometric,
        ONLINE_CODE,
        ours=True,
    ),
    "ours-geometric+no-temporal": MethodSpec(
        "Ours (geometric weights), No Temporal Filtering",
        "without temporal depth filter and temporal term of the ray march",
        _ours_geometric_no_temporal,
        ONLINE_CODE,
        ours=True,
    ),
    "ours-geometric+point-splat": MethodSpec(
        "Ours (geometric weights), Point Splats",
        "views rendered forward as points of one pixel, not as pixel-sized Gaussians",
        _ours_geometric_points,
        ONLINE_CODE,
        ours=True,
        usual=False,
    ),
    "ours-geometric+no-background": MethodSpec(
        "Ours (geometric weights), No Background Blending",
        "what no view shows stays black",
        _ours_geometric_no_background,
        ONLINE_CODE,
        ours=True,
        usual=False,
    ),
    "ours-geometric+offline": MethodSpec(
        "Ours (geometric weights), Not Online",
        "a reference that sees the whole sequence: depth filtered backwards in time, then forwards",
        _ours_geometric_offline,
        ONLINE_CODE,
        ours=True,
        online=False,
        usual=False,
    ),
}


def weights_files(label: str) -> list[Path]:
    """Files of the trained weights that a method renders with."""
    return [Path(str(resources.files("ggvs_eval.pipelines") / "weights" / name)) for name in find_method(label).weights]


def usual_methods() -> tuple[str, ...]:
    """Labels of the methods that are rendered where nobody names any."""
    return tuple(label for label, spec in METHODS.items() if spec.usual)


# Methods whose constants a label may set, `ours-geometric+beta_temporal=0.6`: what makes one with given `OnlineOptions`.
CONFIGURABLE: dict[str, Callable[[Any], Method]] = {"ours-geometric": _ours_geometric_with}


def find_method(label: str) -> MethodSpec:
    """The method of that label; ``METHOD+OPTION=VALUE+...`` is one of `CONFIGURABLE` with other `OnlineOptions`.

    Raises:
        RenderError: unknown; the message names the nearest known one.
    """
    method, variant = split_label(label)
    if method in CONFIGURABLE and "=" in variant:
        return _configured(label, method, variant)
    if label not in METHODS:
        nearest = difflib.get_close_matches(label, METHODS, n=1, cutoff=0.0)[0]
        raise RenderError(f"unknown method {label!r}; did you mean {nearest}? Known are {', '.join(METHODS)}")
    return METHODS[label]


def _configured(label: str, method: str, variant: str) -> MethodSpec:
    """A method with the options that its label names."""
    from ggvs_eval.pipelines.online.geometry_guided import OnlineOptions

    settings = dict(part.partition("=")[::2] for part in variant.split("+"))
    values = {name: _option_value(text) for name, text in settings.items()}
    options = build_table(OnlineOptions, values, f"method {label}", "", RenderError)
    spec = METHODS[method]
    make = partial(CONFIGURABLE[method], options)
    return MethodSpec(f"{spec.title}, {variant.replace('+', ', ')}", spec.describe, make, spec.packages, spec.ours, usual=False)


def _option_value(text: str) -> Any:
    """A number or a truth value; anything else is a word."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def split_label(label: str) -> tuple[str, str]:
    """(method, variant) of a label; the variant of a plain method is the empty string."""
    method, _, variant = label.partition("+")
    return method, variant
