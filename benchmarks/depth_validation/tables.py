"""Tables with a column per matcher and measure."""

from collections.abc import Hashable, Mapping
from typing import TypeVar

import pandas as pd

Column = tuple[str, str]  # matcher, "" for what holds for all of them; measure
Key = TypeVar("Key", bound=Hashable)


def wide_table(rows: Mapping[Key, Mapping[Column, float]]) -> pd.DataFrame:
    """Return a row per key, columns (matcher, measure) in the order in which they first occur.

    NaN where a row lacks one.
    """
    columns = list(dict.fromkeys(column for row in rows.values() for column in row))
    values = [[row.get(column, float("nan")) for column in columns] for row in rows.values()]
    return pd.DataFrame(values, list(rows), pd.MultiIndex.from_tuples(columns))


def mean_of_rows(table: pd.DataFrame) -> dict[str, dict[str, float]]:
    """Return the mean of each measure over the rows that have it, by matcher.

    What holds for all matchers is left out.
    """
    means: dict[str, dict[str, float]] = {}
    for column in table.columns:
        matcher, measure = tuple(column)
        if matcher:
            means.setdefault(matcher, {})[measure] = float(table[matcher, measure].mean())
    return means
