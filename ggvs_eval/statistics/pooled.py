"""A metric's number for one scene as a function of how much each view and each frame counts.

And every number of a data set.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.errors import ResultsError
from ggvs_eval.results import Results, label_of
from ggvs_eval.statistics.decomposition import make_panel
from ggvs_eval.statistics.pooling import Pool, Pooling

if TYPE_CHECKING:
    import pandas as pd

SAME = 1e-6  # largest relative difference between a number in the table and the same from its parts


@dataclass(frozen=True)
class PooledScene:
    """The number of one method (or the difference of two) on one scene.

    Attributes:
        views: names of the views; None alone where values belong to the whole rig.
        frames: numbers of the frames, -1 alone where values belong to the whole sequence.
        pool: (weights of the views (R, V) or (1, V), weights of the frames (R, T) or (1, T), rows
            sum to 1) -> numbers (R,).
        views_given: whether its views are no sample of others, however many there are.
        squares: whether what each frame moves is a square of its errors, and so never as even as
            they are.
    """

    scene: str
    views: tuple[str | None, ...]
    frames: tuple[int, ...]
    pool: Pool
    views_given: bool = False
    squares: bool = False

    @property
    def value(self) -> float:
        """The number itself: every view and frame counts the same."""
        return float(self.pool(*self.even())[0])

    def even(self) -> tuple[Array, Array]:
        """Equal weights of views (1, V) and frames (1, T)."""
        views, frames = len(self.views), len(self.frames)
        return np.full((1, views), 1.0 / views), np.full((1, frames), 1.0 / frames)

    def minus(self, subtrahend: "PooledScene") -> "PooledScene":
        """Return the difference to another method under the same weights."""
        if (self.views, self.frames) != (subtrahend.views, subtrahend.frames):
            sizes = " and ".join(
                f"{len(scene.views)} x {len(scene.frames)}" for scene in (self, subtrahend)
            )
            raise ResultsError(
                f"{self.scene}: not the same views and frames ({sizes}); score both methods on the "
                f"same frames"
            )
        return replace(self, pool=lambda v, f: self.pool(v, f) - subtrahend.pool(v, f))


def pool_scene(
    cells: "Mapping[str, pd.DataFrame]", metric: str, pooling: Pooling, scene: str, subject: str
) -> PooledScene:
    """Find out how a metric's number on a scene is made of views and frames.

    Args:
        cells: rows of the table of one method and scene by metric, those of the pooling's parts
            among them.
        pooling: how it is made.

    Raises:
        ResultsError: missing or infinite cells, or a number in the table that its parts do not
            give.
    """
    if metric not in cells:
        raise ResultsError(f"{metric} of {subject}: no values in the results; score it")
    if absent := [part for part in pooling.parts if part not in cells]:
        raise ResultsError(
            f"{metric} of {subject}: no {', '.join(absent)} per view and frame in the results; "
            f"score again"
        )
    panels = [
        make_panel(cells[part], f"{part} of {subject}") for part in pooling.parts or (metric,)
    ]
    first = panels[0]
    if any((panel.views, panel.frames) != (first.views, first.frames) for panel in panels):
        raise ResultsError(
            f"{metric} of {subject}: its parts are of different views or frames; score again"
        )
    pool = pooling.pool(*(panel.values for panel in panels))
    pooled = PooledScene(
        scene=scene,
        views=first.views,
        frames=first.frames,
        pool=pool,
        views_given=pooling.takes_views_as_given,
        squares=pooling.squares,
    )
    if pooling.parts:
        from_table = float(
            make_panel(cells[metric], f"{metric} of {subject}").values.mean(axis=1).mean()
        )
        from_parts = pooled.value
        # NaN is refused too
        if not abs(from_table - from_parts) <= SAME * max(abs(from_table), abs(from_parts)):
            raise ResultsError(
                f"{subject}: {from_table:.6g} in the table, {from_parts:.6g} from its parts; score "
                f"again"
            )
    return pooled


@dataclass(frozen=True)
class PooledTable:
    """One metric on one data set.

    Attributes:
        values: label -> mean over frames, then views, then scenes, as
            `ggvs_eval.results.Results.summary` has it.
        scenes: label -> its number on each scene, scenes in alphabetical order.
        refusals: label -> why its number cannot be made of views and frames.
        no_interval: why no number has an interval; empty if they have.
    """

    values: Mapping[str, float]
    scenes: Mapping[str, tuple[PooledScene, ...]]
    refusals: Mapping[str, str]
    no_interval: str = ""

    def scenes_of(self, label: str) -> tuple[PooledScene, ...]:
        """Return the scenes of one method."""
        if label not in self.scenes:
            raise ResultsError(
                self.refusals.get(label, f"{label}: no values in the results; score it")
            )
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
        return PooledTable(
            values,
            {},
            dict.fromkeys(values, f"the results lack the pooling of {metric}; score again"),
        )
    scenes: dict[str, tuple[PooledScene, ...]] = {}
    refusals: dict[str, str] = {}
    for label, by_scene in cells.items():
        try:
            scenes[label] = tuple(
                pool_scene(by_scene[scene], metric, pooling, scene, f"{label} in {scene}")
                for scene in sorted(by_scene)
            )
        except ResultsError as refusal:
            refusals[label] = str(refusal)
    return PooledTable(
        values=values, scenes=scenes, refusals=refusals, no_interval=pooling.no_interval
    )


def _cells(
    results: Results, metric: str, parts: Sequence[str], dataset: str
) -> "dict[str, dict[str, dict[str, pd.DataFrame]]]":
    """Rows of the metric and of what it is made of: label -> scene -> metric -> rows.

    Methods in the order of the table.
    """
    table = results.table
    table = table[table["metric"].isin({metric, *parts}) & (table["dataset"] == dataset)]
    by_label: dict[str, dict[str, dict[str, pd.DataFrame]]] = {}
    for (method, variant, scene, name), rows in table.groupby(
        ["method", "variant", "scene", "metric"], sort=False
    ):
        by_label.setdefault(label_of(str(method), str(variant)), {}).setdefault(str(scene), {})[
            str(name)
        ] = rows
    scenes_of = {
        label: {scene: names for scene, names in scenes.items() if metric in names}
        for label, scenes in by_label.items()
    }
    return {label: scenes for label, scenes in scenes_of.items() if scenes}


def _mean(by_scene: "Mapping[str, Mapping[str, pd.DataFrame]]", metric: str) -> float:
    """Return the mean over frames, then views, then scenes, as in the summary."""
    per_scene = [
        rows[metric].groupby("view", dropna=False)["value"].mean().mean()
        for rows in by_scene.values()
    ]
    return float(sum(per_scene) / len(per_scene))
