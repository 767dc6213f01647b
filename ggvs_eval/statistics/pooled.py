"""A metric's number for one scene as a function of how much each view and each frame counts."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ggvs_eval.arrays import Array
from ggvs_eval.errors import ResultsError
from ggvs_eval.statistics.panels import Panel, make_panel

Pool = Callable[[Array, Array], Array]

# Numbers of a whole sequence that are no means; they are recomputed from what they are made of.
PRODUCTS = {name: (f"{name}_spatial", f"{name}_temporal") for name in ("STED", "STED_ssn")}
DEVIATIONS = ("SDT", "SDV")
ERROR = "L1"
SAME = 1e-6  # largest relative difference between a number in the table and the same from its parts


@dataclass(frozen=True)
class PooledScene:
    """The number of one method (or the difference of two) on one scene.

    Attributes:
        scene: name.
        views: names of the views; None alone where values belong to the whole rig.
        frames: numbers of the frames, -1 alone where values belong to the whole sequence.
        pool: (weights of the views (R, V) or (1, V), weights of the frames (R, T) or (1, T), rows sum to 1) -> numbers (R,).
    """

    scene: str
    views: tuple[str | None, ...]
    frames: tuple[int, ...]
    pool: Pool

    @property
    def value(self) -> float:
        """The number itself: every view and frame counts the same."""
        return float(self.pool(*self.even())[0])

    def even(self) -> tuple[Array, Array]:
        """Equal weights of views (1, V) and frames (1, T)."""
        views, frames = len(self.views), len(self.frames)
        return np.full((1, views), 1.0 / views), np.full((1, frames), 1.0 / frames)

    def minus(self, other: "PooledScene") -> "PooledScene":
        """The difference to another method under the same weights.

        Raises:
            ResultsError: the two were not measured on the same views and frames.
        """
        if (self.views, self.frames) != (other.views, other.frames):
            sizes = " and ".join(f"{len(scene.views)} x {len(scene.frames)}" for scene in (self, other))
            raise ResultsError(f"{self.scene}: not the same views and frames ({sizes}); score both methods alike")
        return PooledScene(self.scene, self.views, self.frames, lambda v, f: self.pool(v, f) - other.pool(v, f))


def needed_metrics(metric: str) -> set[str]:
    """Names in the table that a metric's number is computed from, itself included."""
    return {metric, *PRODUCTS.get(metric, ()), *((ERROR,) if metric in DEVIATIONS else ())}


def pool_scene(cells: Mapping[str, pd.DataFrame], metric: str, scene: str, what: str, ddof: int = 1) -> PooledScene:
    """Find out how a metric's number on a scene is made of views and frames.

    Args:
        cells: rows of the table of one method and scene by metric, see `needed_metrics`.
        metric: whose number is wanted.
        scene: name of the scene.
        what: the method and scene for messages.
        ddof: of SDT and SDV.

    Raises:
        ResultsError: missing or infinite cells, or a number in the table that its parts do not give.

    Reading:
        The mean over frames, then views, but for three kinds. STED: in each view the product of the means over pairs of its two
        parts, then the mean over views (where the parts are not in the table, its values per view are all there is). SDT and
        SDV: the standard deviations of the L1 of each view and frame.
    """
    if metric not in cells:
        raise ResultsError(f"{metric} of {what}: no values in the results; score it")
    parts = PRODUCTS.get(metric, ())
    if metric in DEVIATIONS:
        if ERROR not in cells:
            raise ResultsError(f"{metric} of {what}: no {ERROR} per view and frame in the results; score {ERROR} too")
        panel = make_panel(cells[ERROR], f"{ERROR} of {what}")
        pooled = _scene(scene, panel, (pool_sdt if metric == "SDT" else pool_sdv)(panel.values, ddof))
    elif parts and all(part in cells for part in parts):
        first, second = (make_panel(cells[part], f"{part} of {what}") for part in parts)
        if (first.views, first.frames) != (second.views, second.frames):
            raise ResultsError(f"{metric} of {what}: its parts are of different pairs; score again")
        pooled = _scene(scene, first, pool_product(first.values, second.values))
    else:
        panel = make_panel(cells[metric], f"{metric} of {what}")
        return _scene(scene, panel, pool_mean(panel.values))
    _check_same(pooled, make_panel(cells[metric], f"{metric} of {what}"), f"{metric} of {what}")
    return pooled


def pool_mean(values: Array) -> Pool:
    """Mean over frames, then views, of (V, T)."""
    return lambda views, frames: (views * (frames @ values.T)).sum(axis=1)


def pool_product(first: Array, second: Array) -> Pool:
    """Mean over views of the product of two means over frames, each (V, T)."""
    return lambda views, frames: (views * (frames @ first.T) * (frames @ second.T)).sum(axis=1)


def pool_sdt(values: Array, ddof: int = 1) -> Pool:
    """Mean over views of the standard deviation over frames of (V, T)."""
    centred, factor = values - values.mean(axis=1, keepdims=True), _unbiased(values.shape[1], ddof)

    def pool(views: Array, frames: Array) -> Array:
        variance = frames @ np.square(centred).T - np.square(frames @ centred.T)
        return np.asarray((views * np.sqrt(np.maximum(variance, 0.0) * factor)).sum(axis=1))

    return pool


def pool_sdv(values: Array, ddof: int = 1) -> Pool:
    """Mean over frames of the standard deviation over views of (V, T)."""
    centred, factor = values - values.mean(axis=0, keepdims=True), _unbiased(values.shape[0], ddof)

    def pool(views: Array, frames: Array) -> Array:
        variance = views @ np.square(centred) - np.square(views @ centred)
        return np.asarray((frames * np.sqrt(np.maximum(variance, 0.0) * factor)).sum(axis=1))

    return pool


def _unbiased(count: int, ddof: int) -> float:
    """From the mean square to the variance with this ddof; nothing to correct where one value has no variance anyway."""
    return count / (count - ddof) if count > ddof else 1.0


def _scene(scene: str, panel: Panel, pool: Pool) -> PooledScene:
    return PooledScene(scene, panel.views, panel.frames, pool)


def _check_same(pooled: PooledScene, tabulated: Panel, what: str) -> None:
    """Refuse parts that do not give the number that the table has."""
    from_table, from_parts = float(tabulated.values.mean(axis=1).mean()), pooled.value
    if abs(from_table - from_parts) > SAME * max(abs(from_table), abs(from_parts)):
        raise ResultsError(f"{what}: {from_table:.6g} in the table, {from_parts:.6g} from its parts; score again")
