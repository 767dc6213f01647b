"""Every method by the name that the command line and the folders use."""

import difflib
from collections.abc import Callable
from dataclasses import dataclass

from ggvs_eval.baselines.method import Method
from ggvs_eval.errors import RenderError


@dataclass(frozen=True)
class MethodSpec:
    """One method or variant of it.

    Attributes:
        title: how tables call it.
        describe: one line for the help and the report.
        make: builds a fresh object that renders one sequence.
        packages: code its output depends on; a change there makes its renders stale.
        ours: whether it is this project's method or an ablation of it.
    """

    title: str
    describe: str
    make: Callable[[], Method]
    packages: tuple[str, ...]
    ours: bool = False


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
}


def find_method(label: str) -> MethodSpec:
    """The method of that label.

    Raises:
        RenderError: unknown; the message names the nearest known one.
    """
    if label not in METHODS:
        nearest = difflib.get_close_matches(label, METHODS, n=1, cutoff=0.0)[0]
        raise RenderError(f"unknown method {label!r}; did you mean {nearest}? Known are {', '.join(METHODS)}")
    return METHODS[label]


def split_label(label: str) -> tuple[str, str]:
    """(method, variant) of a label; the variant of a plain method is the empty string."""
    method, _, variant = label.partition("+")
    return method, variant
