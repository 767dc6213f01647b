"""Measured values as the figures of `make validate`: each with its unit, its target and the
baseline of the same run as peer.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

Figures = dict[str, dict[str, Any]]
COMMAND = "python -m benchmarks.depth_validation"
BASELINE = "sgbm"  # the matcher that every other one is compared with


@dataclass(frozen=True)
class Measure:
    """One column of a table.

    Attributes:
        name: of the column and of the figure.
        unit: for people.
        higher_is_better: its direction.
        target: what should be reached; None for none.
        target_of: only matchers whose name begins so have the target; "" for all.
    """

    name: str
    unit: str
    higher_is_better: bool
    target: float | None = None
    target_of: str = ""

    def ratio(self, value: float, peer_value: float) -> float | None:
        """By which factor a value is better than the peer's; None where one of them is 0."""
        if not value or not peer_value:
            return None
        return value / peer_value if self.higher_is_better else peer_value / value


def figures_of(
    group: str, measures: Sequence[Measure], values: Mapping[str, Mapping[str, float]]
) -> Figures:
    """Return the figures named depth.<group>.<measure>.<matcher>.

    What could not be measured (NaN) is left out.

    Args:
        group: what was evaluated, e.g. ``motorcycle``.
        measures: the columns.
        values: of each matcher, by the measures' names.
    """
    figures: Figures = {}
    baseline = values.get(BASELINE)
    for matcher, row in values.items():
        for measure in measures:
            if not math.isfinite(row[measure.name]):
                continue
            entry = _entry(measure, matcher, row[measure.name])
            if (
                baseline is not None
                and matcher != BASELINE
                and math.isfinite(baseline[measure.name])
            ):
                peer_value = baseline[measure.name]
                entry |= {
                    "peer": BASELINE,
                    "peer_value": peer_value,
                    "ratio": measure.ratio(entry["value"], peer_value),
                }
            figures[f"depth.{group}.{measure.name}.{matcher}"] = entry
    return figures


def quoted_figures(
    group: str,
    measures: Sequence[Measure],
    values: Mapping[str, Mapping[str, float]],
    quoted: Mapping[str, Mapping[str, float]],
) -> Figures:
    """Return the same values against published ones, named
    depth.<group>.<measure>.<matcher>.vs.<peer>.

    Args:
        group: as for `figures_of`.
        measures: as for `figures_of`; unpublished ones are left out.
        values: as for `figures_of`.
        quoted: published values of each peer, by the measures' names.
    """
    figures: Figures = {}
    for matcher, row in values.items():
        for peer, published in quoted.items():
            for measure in measures:
                if measure.name not in published:
                    continue
                peer_value = published[measure.name]
                compared = {
                    "peer": peer,
                    "peer_value": peer_value,
                    "ratio": measure.ratio(row[measure.name], peer_value),
                }
                entry = _entry(measure, matcher, row[measure.name]) | compared
                figures[f"depth.{group}.{measure.name}.{matcher}.vs.{peer.replace(' ', '-')}"] = (
                    entry
                )
    return figures


def _entry(measure: Measure, matcher: str, value: float) -> dict[str, Any]:
    return {
        "value": float(value),
        "unit": measure.unit,
        "target": measure.target if matcher.startswith(measure.target_of) else None,
        "higher_is_better": measure.higher_is_better,
        "command": COMMAND,
    }
