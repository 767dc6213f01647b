"""One metric of a whole table: every method's number on every scene of a data set."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ggvs_eval.errors import ResultsError
from ggvs_eval.results import Results, label_of
from ggvs_eval.statistics.pooled import PooledScene, pool_scene
from ggvs_eval.statistics.pooling import Pooling

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class PooledTable:
    """One metric on one data set.

    Attributes:
        values: label -> mean over frames, then views, then scenes, as `ggvs_eval.results.Results.summary` has it.
        scenes: label -> its number on each scene, scenes in alphabetical order.
        refusals: label -> why its number cannot be made of views and frames.
        no_interval: why no number has an interval of its own; empty where they have.
    """

    values: Mapping[str, float]
    scenes: Mapping[str, tuple[PooledScene, ...]]
    refusals: Mapping[str, str]
    no_interval: str = ""

    def scenes_of(self, label: str) -> tuple[PooledScene, ...]:
        """The scenes of one method."""
        if label not in self.scenes:
            raise ResultsError(self.refusals.get(label, f"{label}: no values in the results; score it"))
        return self.scenes[label]


def pool_table(results: Results, metric: str, dataset: str) -> PooledTable:
    """Collect one metric of every method.

    Args:
        results: every measured value; their provenance says how each metric is pooled.
    """
    record = results.provenance.get("pooling", {}).get(metric)
    pooling = None if record is None else Pooling.read(record)
    cells = _cells(results, metric, () if pooling is None else pooling.parts, dataset)
    values = {label: _mean(by_scene, metric) for label, by_scene in cells.items()}
    if pooling is None:
        return PooledTable(values, {}, dict.fromkeys(values, f"the results do not say how {metric} is pooled; score again"))
    scenes: dict[str, tuple[PooledScene, ...]] = {}
    refusals: dict[str, str] = {}
    for label, by_scene in cells.items():
        try:
            scenes[label] = tuple(
                pool_scene(by_scene[scene], metric, pooling, scene, f"{label} in {scene}") for scene in sorted(by_scene)
            )
        except ResultsError as refusal:
            refusals[label] = str(refusal)
    return PooledTable(values, scenes, refusals, pooling.no_interval)


def _cells(results: Results, metric: str, parts: Sequence[str], dataset: str) -> "dict[str, dict[str, dict[str, pd.DataFrame]]]":
    """Rows of the metric and of what it is made of: label -> scene -> metric -> rows; methods in the order of the table."""
    table = results.table
    table = table[table["metric"].isin({metric, *parts}) & (table["dataset"] == dataset)]
    by_label: dict[str, dict[str, dict[str, pd.DataFrame]]] = {}
    for (method, variant, scene, name), rows in table.groupby(["method", "variant", "scene", "metric"], sort=False):
        by_label.setdefault(label_of(str(method), str(variant)), {}).setdefault(str(scene), {})[str(name)] = rows
    measured = {label: {scene: names for scene, names in scenes.items() if metric in names} for label, scenes in by_label.items()}
    return {label: scenes for label, scenes in measured.items() if scenes}


def _mean(by_scene: "Mapping[str, Mapping[str, pd.DataFrame]]", metric: str) -> float:
    """Mean over frames, then views, then scenes, as in the summary."""
    per_scene = [rows[metric].groupby("view", dropna=False)["value"].mean().mean() for rows in by_scene.values()]
    return float(sum(per_scene) / len(per_scene))
