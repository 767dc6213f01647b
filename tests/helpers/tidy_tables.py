"""Results made of numbers alone: matrices of views and frames, autocorrelated noise."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from ggvs_eval.arrays import Array
from ggvs_eval.metrics.metric import MetricOptions
from ggvs_eval.metrics.registry import METRICS, pooling_records
from ggvs_eval.results import Results, make_table
from ggvs_eval.statistics.pooling import MEAN


def make_rows(
    label: str, metric: str, values: ArrayLike, scene: str = "room", dataset: str = "Demo"
) -> list[tuple]:
    """Rows of a (V, T) matrix; views are cam00, cam01, ..., frames start at 2."""
    method, _, variant = label.partition("+")
    matrix = np.asarray(values, dtype=np.float64)
    return [
        (dataset, scene, method, variant, f"cam{view:02}", 2 + frame, metric, matrix[view, frame])
        for view in range(matrix.shape[0])
        for frame in range(matrix.shape[1])
    ]


def make_spread_rows(label: str, l1: ArrayLike, scene: str = "room", ddof: int = 1) -> list[tuple]:
    """Rows of L1, and of SDT and SDV as the score step writes them."""
    matrix = np.asarray(l1, dtype=np.float64)
    method, _, variant = label.partition("+")
    head = ("Demo", scene, method, variant)
    rows = make_rows(label, "L1", matrix, scene)
    rows += [
        (*head, f"cam{view:02}", -1, "SDT", value)
        for view, value in enumerate(matrix.std(axis=1, ddof=ddof))
    ]
    rows += [
        (*head, None, 2 + frame, "SDV", value)
        for frame, value in enumerate(matrix.std(axis=0, ddof=ddof))
    ]
    return rows


def make_sted_rows(
    label: str, spatial: ArrayLike, temporal: ArrayLike, scene: str = "room"
) -> list[tuple]:
    """Rows of the parts of STED per pair, and of their products per view."""
    method, _, variant = label.partition("+")
    first, second = np.asarray(spatial, dtype=np.float64), np.asarray(temporal, dtype=np.float64)
    rows = make_rows(label, "STED_spatial", first, scene) + make_rows(
        label, "STED_temporal", second, scene
    )
    products = first.mean(axis=1) * second.mean(axis=1)
    head = ("Demo", scene, method, variant)
    return rows + [
        (*head, f"cam{view:02}", -1, "STED", value) for view, value in enumerate(products)
    ]


def make_results(
    rows: list[tuple], provenance: Mapping[str, object] | None = None, ddof: int = 1
) -> Results:
    """Results of these rows; metrics that nobody knows are means."""
    known = pooling_records([row[6] for row in rows if row[6] in METRICS], MetricOptions(ddof=ddof))
    pooling = {row[6]: MEAN.record() for row in rows} | known
    return Results(
        make_table(rows),
        {"protocol_sha256": "a" * 64, "inputs": {}, "pooling": pooling, **(provenance or {})},
    )


def autoregressive(
    generator: np.random.Generator, series: int, frames: int, correlation: float
) -> Array:
    """(series, frames) of mean 0 and variance 1, each value the `correlation`-th part of the one
    before, plus noise.
    """
    noise = generator.standard_normal((series, frames)) * np.sqrt(1.0 - correlation**2)
    values = np.empty((series, frames))
    values[:, 0] = generator.standard_normal(series)
    for frame in range(1, frames):
        values[:, frame] = correlation * values[:, frame - 1] + noise[:, frame]
    return values
