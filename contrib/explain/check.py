"""Verdicts on the cells of a published table: reproduced, by another convention, undecided,
or not.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Literal

import numpy as np

from ggvs_eval.contrib.explain.explain import (
    ALL_VIEWS,
    WEAK_CHANCE,
    chance,
    explain,
    metric_family,
    printed,
    tolerance,
)
from ggvs_eval.contrib.explain.quoted_tables import QuotedCell
from ggvs_eval.errors import GgvsError, ResultsError, did_you_mean
from ggvs_eval.merged_results import merge_results
from ggvs_eval.metrics.registry import METRICS
from ggvs_eval.pipelines.inspection.renders.identity import views_of_run
from ggvs_eval.pipelines.run.decoding import fast_truth
from ggvs_eval.progress import track
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.model.table import Cell
from ggvs_eval.reports.tables.report_tables import main_tables
from ggvs_eval.reports.tables.verdict import describe_outcome

Verdict = Literal["reproduced", "other convention", "undecided", "not reproduced", "not checked"]
VERDICTS: Mapping[Verdict, str] = {
    "reproduced": "equal to this protocol's value, to the printed digits",
    "other convention": "equal under another convention of the metric",
    "undecided": "not equal, but within the interval of this clip: too short to contradict it",
    "not reproduced": "outside the interval, and no known convention gives it",
    "not checked": "no such method, scene or metric in the runs",
}


@dataclass(frozen=True)
class CheckedCell:
    """A quoted cell with its verdict.

    Attributes:
        quoted: the cell.
        label: method of the runs that it was checked against; empty if there is none.
        measured: value under the runs' protocol; None if there is none.
        reason: convention, difference or what is missing, in words.
        by_chance: probability that a number near the quoted one with as many digits would match
            what was tried, 0 to 1.
        neighbour: the next method in the same column from which the clip does not distinguish it;
            empty if there is none.
    """

    quoted: QuotedCell
    verdict: Verdict
    label: str = ""
    measured: float | None = None
    reason: str = ""
    by_chance: float = 0.0
    neighbour: str = ""


class Runs:
    """Scored runs, asked for values of single cells.

    Args:
        runs: at least one; a scene can have a protocol of its own.
        names: name of a row of the table -> label of a method.
    """

    def __init__(self, runs: Sequence[MeasuredRun], names: Mapping[str, str]) -> None:
        """Raise ResultsError for a label that no run has."""
        self.runs, self.names = runs, names
        labels = list(dict.fromkeys(label for run in runs for label in run.labels))
        for name, label in names.items():
            if label not in labels:
                raise ResultsError(
                    f"{name}={label}: wanted a method of the runs, got "
                    f"{label!r}{did_you_mean(label, labels)}"
                )
        titles = (
            (title, label)
            for run in runs
            for label in run.labels
            for title in (label, run.name(label), run.names.get(label, label))
        )
        self._titles = {_plain(title): label for title, label in titles}
        self._value = cache(self._measure)
        self._conventions = cache(self._recompute)

    def label(self, method: str) -> str:
        """Return the method of a row's name: as given, by its label or by its title.

        Empty if there is none.
        """
        return self.names.get(method) or self._titles.get(_plain(method), "")

    def of_scene(self, scene: str) -> tuple[MeasuredRun, ...]:
        """Return the runs of a scene; all of them for a mean, none if the name is unknown."""
        called = _plain(scene)
        return tuple(
            run
            for run in self.runs
            if not called or called in map(_plain, (run.scene, run.title, run.protocol.dataset))
        )

    def value(self, metric: str, label: str, scene: str) -> Cell | None:
        """Return the measured value of a cell with its interval; None if it was not measured."""
        return self._value(metric, scene).get(label)

    def conventions(self, metric: str, label: str, scene: str) -> dict[str, float]:
        """Return the value under every known convention, means over the runs of the scene.

        None if they cannot be computed.
        """
        try:
            return self._conventions(metric, label, scene)
        except GgvsError:  # frames that are gone, or a metric with one convention
            return {}

    def outcome(self, metric: str, scene: str, label: str, rival: str) -> str:
        """Return how the runs of a scene decide between two methods, in words.

        Empty if the first is better or worse.
        """
        runs = self.of_scene(scene)
        return describe_outcome(
            runs, merge_results([run.results for run in runs]), (metric, label, rival)
        )

    def _measure(self, metric: str, scene: str) -> dict[str, Cell]:
        runs = self.of_scene(scene)
        if not runs or metric not in runs[0].metrics:
            return {}
        results = merge_results([run.results for run in runs])
        rows = [
            row for table in main_tables(runs, results, [metric]) for row in table.rows if row.label
        ]
        return {row.label: row.cells[0] for row in rows}

    def _recompute(self, metric: str, label: str, scene: str) -> dict[str, float]:
        family = metric_family(re.sub(r"(?<=dssim)[12]$", "", metric.lower()).replace("_", "-"))
        values_by_name: dict[str, list[float]] = {}
        runs = self.of_scene(scene)
        for run in runs:
            views = views_of_run(run.folder, label, as_measured=True)
            for recomputed in explain(family, "0", views, fast=fast_truth(run.folder)):
                if recomputed.views == ALL_VIEWS:
                    values_by_name.setdefault(recomputed.name, []).append(recomputed.value)
        return {
            name: float(np.mean(values))
            for name, values in values_by_name.items()
            if len(values) == len(runs)
        }


def check_cells(cells: Sequence[QuotedCell], runs: Runs) -> list[CheckedCell]:
    """Judge every cell; conventions are recomputed only for cells that the runs' own protocol does
    not reproduce.

    Reading:
        A convention whose match is likelier than `WEAK_CHANCE` to be an accident counts only if it
        also gives another cell of the same metric; otherwise the cell is not reproduced.
    """
    checked = [_against_protocol(cell, runs) for cell in cells]
    open_cells = [
        at for at, cell in enumerate(checked) if cell.verdict in ("undecided", "not reproduced")
    ]
    candidates = {
        at: _matching(cells[at], runs)
        for at in track(open_cells, "trying other conventions on cells")
    }
    for at, (matches, share) in candidates.items():
        elsewhere = {
            name
            for i, (names, _) in candidates.items()
            if i != at and cells[i].metric == cells[at].metric
            for name in names
        }
        names = matches if share <= WEAK_CHANCE else [name for name in matches if name in elsewhere]
        cell = checked[at]
        if names:
            words = names[0] if len(names) == 1 else f"{names[0]}, or {len(names) - 1} more"
            checked[at] = replace(cell, verdict="other convention", reason=words, by_chance=share)
        else:
            by_accident = f"; only a chance match: {matches[0]}" if matches else ""
            checked[at] = replace(cell, reason=f"{cell.reason}{by_accident}", by_chance=share)
    return [_with_neighbour(cell, checked, runs) for cell in checked]


def _against_protocol(cell: QuotedCell, runs: Runs) -> CheckedCell:
    label = runs.label(cell.method)
    if not label:
        known = ", ".join(dict.fromkeys(label for run in runs.runs for label in run.labels))
        return CheckedCell(
            cell,
            "not checked",
            reason=f"no method {cell.method!r} in the runs ({known}); name it with --rows",
        )
    hashes = {run.protocol.sha256 for run in runs.of_scene(cell.scene)}
    if len(hashes) != 1:
        reason = (
            "a mean over runs of several protocols"
            if hashes
            else f"no run of the scene {cell.scene!r}"
        )
        return CheckedCell(cell, "not checked", label, reason=reason)
    mean = runs.value(cell.metric, label, cell.scene)
    number = printed(cell.text)[0]
    if not mean or mean.value is None:
        return _without_own(cell, label, number, runs.conventions(cell.metric, label, cell.scene))
    value, under = mean.value, ""
    if not runs.of_scene(cell.scene)[0].protocol.measurement.lpips_net.startswith(cell.network):
        values = runs.conventions(cell.metric, label, cell.scene)
        under = next((name for name in values if name.lower().startswith(cell.network)), "")
        if not under:
            return CheckedCell(
                cell,
                "not checked",
                label,
                reason=f"its head names {cell.network}, which gave no value",
            )
        value = values[under]
    if abs(value - number) <= tolerance(cell.text, value):
        verdict: Verdict = "other convention" if under else "reproduced"
        return CheckedCell(
            quoted=cell,
            verdict=verdict,
            label=label,
            measured=value,
            reason=under,
            by_chance=chance(cell.text, [value]),
        )
    off = f"off by {number - value:+.3g}{under and f' under {under}'}"
    if (
        not under
        and mean.low is not None
        and mean.high is not None
        and mean.low <= number <= mean.high
    ):
        return CheckedCell(
            quoted=cell,
            verdict="undecided",
            label=label,
            measured=value,
            reason=f"{off}, within the interval {mean.low:.4g} to {mean.high:.4g}",
        )
    return CheckedCell(
        quoted=cell, verdict="not reproduced", label=label, measured=value, reason=off
    )


def _without_own(
    cell: QuotedCell, label: str, number: float, values: Mapping[str, float]
) -> CheckedCell:
    """Judge a cell of a metric that the protocol lacks by its conventions.

    A match that chance explains says nothing.
    """
    absent = f"{cell.metric} was not measured; add it to the protocol"
    if not values:
        return CheckedCell(cell, "not checked", label, reason=absent)
    nearest = min(values, key=lambda name: abs(values[name] - number))
    share, value = chance(cell.text, [*values.values()]), values[nearest]
    if abs(value - number) > tolerance(cell.text, value):
        return CheckedCell(
            quoted=cell,
            verdict="not reproduced",
            label=label,
            measured=value,
            reason=f"nearest is {nearest}",
            by_chance=share,
        )
    if share > WEAK_CHANCE:
        return CheckedCell(
            cell, "not checked", label, reason=f"{absent}; a chance match: {nearest}"
        )
    return CheckedCell(
        quoted=cell,
        verdict="other convention",
        label=label,
        measured=value,
        reason=nearest,
        by_chance=share,
    )


def _matching(cell: QuotedCell, runs: Runs) -> tuple[list[str], float]:
    """Return the conventions that give a cell's digits, and the probability that one of all would
    by chance.
    """
    values = runs.conventions(cell.metric, runs.label(cell.method), cell.scene)
    number = printed(cell.text)[0]
    names = [
        name for name, value in values.items() if abs(value - number) <= tolerance(cell.text, value)
    ]
    return names, chance(cell.text, [value for value in values.values() if math.isfinite(value)])


def _with_neighbour(result: CheckedCell, checked: Sequence[CheckedCell], runs: Runs) -> CheckedCell:
    """Add the next worse method of the column if the clip does not distinguish the two."""
    cell, better = result.quoted, METRICS[result.quoted.metric].higher_is_better
    if result.measured is None or better is None:
        return result

    def standing(row: CheckedCell) -> float:
        return printed(row.quoted.text)[0] * (1 if better else -1)

    rivals = [
        row
        for row in checked
        if row.quoted.heads == cell.heads and row.measured is not None and row.label != result.label
    ]
    worse = [row for row in rivals if standing(row) <= standing(result)]
    if not worse:
        return result
    nearest = max(worse, key=standing)
    outcome = runs.outcome(cell.metric, cell.scene, result.label, nearest.label)
    return replace(
        result,
        neighbour=f"not distinguished from {nearest.quoted.method} ({outcome})" if outcome else "",
    )


def expected_by_chance(checked: Sequence[CheckedCell]) -> tuple[float, float]:
    """Return the number of cells that would match by chance, and the probability that at least as
    many do as did.

    Reading:
        Cells are taken as independent, and all numbers near a quoted one as equally likely
        (`explain.chance`). The tail is that of the sum of unequal Bernoulli variables, computed
        exactly.

    Example:
        >>> cell = QuotedCell("a", "", "PSNR", "30.0", 0, 1)
        >>> expected_by_chance(
        ...     [
        ...         CheckedCell(cell, "reproduced", by_chance=0.5),
        ...         CheckedCell(cell, "reproduced", by_chance=0.5),
        ...     ]
        ... )
        (1.0, 0.25)
    """
    tried = [cell for cell in checked if cell.verdict != "not checked"]
    chances = [min(cell.by_chance, 1.0) for cell in tried]
    count = sum(cell.verdict in ("reproduced", "other convention") for cell in tried)
    distribution = np.array([1.0])
    for share in chances:
        distribution = np.convolve(distribution, [1.0 - share, share])
    return float(sum(chances)), float(min(distribution[count:].sum(), 1.0)) if count else 1.0


def _plain(name: str) -> str:
    return re.sub(r"\W|_", "", name).lower()
