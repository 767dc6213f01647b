"""Jumps of the picture where other source cameras take over: the abrupt changes that the paper's EPI figure points at."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.metric import Value
from ggvs_eval.metrics.path.rendered_path import PathMetric, PathScorer, RenderedPath, whole_path

NAMES = ("switch_ratio", "switch_excess")
ROUNDING_255 = 1.0 / 3.0  # mean absolute difference of two images that differ by rounding to 8 bit alone


@dataclass(frozen=True)
class SwitchScore:
    """Change at the steps where the set of source cameras changes, against the other steps.

    Attributes:
        ratio: mean change at the switches over the mean elsewhere; 1 = no more than elsewhere, lower is better.
        excess_255: mean change at the switches less the mean elsewhere, grey levels of 255; 0 = no more than elsewhere.
        n_switches: measured steps at which the set changes.
    """

    ratio: float
    excess_255: float
    n_switches: int
    n_steps: int


def switch_steps(sources: Sequence[Collection[str]]) -> list[bool]:
    """Tell for each step between poses whether the set of source cameras changes; their order does not matter."""
    sets = [frozenset(names) for names in sources]
    return [before != after for before, after in pairwise(sets)]


def switch_score(step_errors_255: Sequence[float | None], sources: Sequence[Collection[str]]) -> SwitchScore:
    """Compare the change along the path at switches of the source cameras with the change elsewhere.

    Args:
        step_errors_255: change from each pose to the next after motion compensation by depth, grey levels of 255, V - 1 of
            them: `steps.StepError.error_255`; steps that have none (None) do not count.
        sources: names of the source cameras of each pose, V of them, e.g. the K nearest.

    Raises:
        MetricError: numbers that do not fit each other, no switch on this path, or a switch at every step.

    Reading:
        Not in the paper. Parallax does not count, since the change is taken along the lines of the EPI. 8-bit rounding alone
        changes 1/3 grey level; means below that count as 1/3 in the ratio, so that it stays finite for perfect renderings.
    """
    if len(sources) != len(step_errors_255) + 1:
        raise MetricError(f"switch score: {len(sources)} poses have {len(sources) - 1} steps, got {len(step_errors_255)} errors")
    switches = switch_steps(sources)
    if not any(switches):
        raise MetricError(f"no switch on this path: one set of source cameras at all {len(sources)} poses; use a longer path")
    if all(switches):
        raise MetricError(f"every step switches the source cameras ({len(switches)} steps); use more poses on this path")
    measured = [(error, switch) for error, switch in zip(step_errors_255, switches, strict=True) if error is not None]
    at_switches = [error for error, switch in measured if switch]
    elsewhere = [error for error, switch in measured if not switch]
    if not at_switches or not elsewhere:
        raise MetricError(f"no step {'with' if elsewhere else 'without'} a switch could be measured; check the depths")
    there, rest = float(np.mean(at_switches)), float(np.mean(elsewhere))
    return SwitchScore(max(there, ROUNDING_255) / max(rest, ROUNDING_255), there - rest, len(at_switches), len(measured))


def _measure(path: RenderedPath) -> list[Value]:
    if not any(path.sources):
        raise MetricError("switch score: nobody says which cameras the images are made of; name the sources of each pose")
    measured = switch_score([step.error_255 for step in path.steps], path.sources)
    path.n_switches = measured.n_switches
    return whole_path(NAMES, measured.ratio, measured.excess_255)


_SCORER = PathScorer(NAMES, _measure)
SWITCH_RATIO = PathMetric(
    name="switch_ratio",
    function=switch_score,
    higher_is_better=False,
    describe="change where the source cameras switch over change elsewhere",
    scorer=_SCORER,
)
SWITCH_EXCESS = PathMetric(
    name="switch_excess",
    function=switch_score,
    unit="grey levels of 255",
    higher_is_better=False,
    describe="change where the source cameras switch minus elsewhere",
    scorer=_SCORER,
)
