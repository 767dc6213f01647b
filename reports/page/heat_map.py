"""Heat maps of a metric over view x frame, one per method, all of a metric on one scale."""

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.reports.figures.data_uris import LOSSLESS, webp_uri
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.section import Report, SectionContent

SIGNIFICANT = 5  # digits that a value keeps in the page


@dataclass(frozen=True)
class HeatMap:
    """One metric of every method over views and frames.

    Attributes:
        unit: unit of the values; empty if there is none.
        low: smallest finite value of all methods.
        high: largest finite value of all methods.
        values: label -> view -> one value per frame of the run; None if there is none or none that
            is finite.
    """

    metric: str
    unit: str
    higher_is_better: bool
    low: float
    high: float
    values: dict[str, dict[str, list[float | None]]]

    def record(self) -> dict[str, Any]:
        """Return the heat map as a JSON record for the page."""
        return {
            "unit": self.unit,
            "higher_is_better": self.higher_is_better,
            "low": self.low,
            "high": self.high,
            "values": self.values,
        }


def heat_maps(run: MeasuredRun) -> tuple[HeatMap, ...]:
    """Return one per metric that has a finite value for any view and frame, in the order of the
    protocol.
    """
    maps = (_heat_map(run, metric) for metric in run.metrics)
    return tuple(heat_map for heat_map in maps if heat_map)


def _heat_map(run: MeasuredRun, metric: str) -> HeatMap | None:
    views = run.protocol.views.test
    values: dict[str, dict[str, list[float | None]]] = {label: {} for label in run.labels}
    for view in views:
        for label, series in run.per_frame(metric, view).items():
            if label in values:
                row = map(float, series.reindex(list(run.frames)))
                values[label][view] = [
                    float(f"{value:.{SIGNIFICANT}g}") if math.isfinite(value) else None
                    for value in row
                ]
    finite = [
        value
        for of_label in values.values()
        for row in of_label.values()
        for value in row
        if value is not None
    ]
    if not finite:
        return None
    note = run.metrics[metric]
    return HeatMap(
        metric=metric,
        unit=note.unit,
        higher_is_better=note.higher_is_better,
        low=min(finite),
        high=max(finite),
        values=values,
    )


def heat_colours(count: int = 64) -> Image8:
    """Return the colours from the best to the worst value, (1, count, 3): cividis, which looks the
    same to colour-blind readers.

    Reading:
        Bright is worse, as in the error maps, whichever direction the metric has.
    """
    ramp = np.linspace(0, 255, count).round().astype(np.uint8)[None]
    return np.ascontiguousarray(
        cv2.applyColorMap(ramp, cv2.COLORMAP_CIVIDIS)[..., ::-1], dtype=np.uint8
    )


def heat_section(report: Report) -> SectionContent:
    """Return the heat maps of each run, which the page's viewer draws.

    Those of one frame are not worth a part of the page.
    """
    colours = ["#" + bytes(colour).hex() for colour in heat_colours()[0]]
    values: dict[str, dict[str, Any]] = {"": {"heat_scale": webp_uri(heat_colours(), LOSSLESS)}}
    data = {}
    for key, run in report.runs.items():
        maps = heat_maps(run)
        data[key] = {
            "heat": {heat_map.metric: heat_map.record() for heat_map in maps},
            "colours": colours,
        }
        values[key] = {"heat_map": len(run.frames) > 1 and report.data(key), "heat_maps": maps}
    return SectionContent(values=values, data=data)
