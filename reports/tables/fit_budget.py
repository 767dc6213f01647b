"""What seconds of fitting buy: the time to equal quality, and the best method under each budget."""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.model.table import Cell, Column, Row, Table, format_value
from ggvs_eval.reports.tables.fitted import difference_cell, fit_records, fit_seconds
from ggvs_eval.results import label_of

STATED_DB = 30.0  # a PSNR that a fit may be asked for, beside those of the methods that need none
POINTS = (
    "The points are whole fits: rows of a method that differ in steps (`4dgs+steps=1000`; `ggvs-eval sweep budget` has a series)."
)


def budget_tables(run: MeasuredRun) -> tuple[Table, ...]:
    """Cost at equal quality and the best method under each budget; nothing where no method is fitted."""
    fits = fit_records(run)
    summary = run.results.summary().droplevel("dataset")
    numbers = {label_of(*names): float(summary.loc[names].get("PSNR", math.nan)) for names in summary.index}
    psnr_db = {label: numbers[label] for label in run.labels if math.isfinite(numbers.get(label, math.nan))}
    if not any(label in psnr_db for label in fits):
        return ()
    return tuple(table for table in (_equal_quality(run, fits, psnr_db), _winners(run, fits, psnr_db)) if table)


def _equal_quality(run: MeasuredRun, fits: Mapping[str, list[dict[str, Any]]], psnr_db: Mapping[str, float]) -> Table | None:
    """Seconds of fitting at which a method first reaches what others have without any, on held-out views.

    Reading:
        A fit's own curve is of its training images, and held-out views shown to it on the way would be a leak. So the curve is
        made of whole fits: a method's labels that differ in ``steps`` are its points, and between two of them a crossing is a
        bound from either side.
    """
    instant = [label for label in psnr_db if label not in fits]
    ours = next((label for label in run.ours_first if label in instant and label in run.ours), None)
    rivals = [label for label in (ours, next((each for each in instant if each.startswith("enerf")), None)) if label]
    targets = {f"as {run.name(label)}, {psnr_db[label]:.2f} dB": psnr_db[label] for label in rivals}
    targets |= {f"{STATED_DB:g} dB": STATED_DB}
    families: dict[str, list[tuple[float, float]]] = {}
    names: dict[str, str] = {}
    for label in (each for each in fits if each in psnr_db):  # in the order of the run, not of a set
        family = re.sub(r"\+steps=\d+", "", label)
        families.setdefault(family, []).append((fit_seconds(fits[label]), psnr_db[label]))
        names.setdefault(family, re.sub(r", [\d,]+ steps|\+steps=\d+", "", run.name(label)))
    if not families or not rivals:
        return None
    columns = tuple(Column(name, "s", False, "Seconds of one fold's fit.") for name in targets)
    rows = [
        Row(names[family], tuple(_crossing(sorted(points), target) for target in targets.values()))
        for family, points in families.items()
    ]
    caption = f"Seconds of fitting until a method's PSNR on held-out views is that of a method that needs no fit. {POINTS}"
    return Table("equal_quality", "Cost at equal quality", caption, columns, tuple(rows), run.scene)


def _crossing(points: Sequence[tuple[float, float]], target_db: float) -> Cell:
    """The first of some (seconds, dB), rising in seconds, that reaches a PSNR; a bound, as the truth lies between two points."""
    at = next((at for at, (_, reached_db) in enumerate(points) if reached_db >= target_db), None)
    if at is None:
        seconds, best_db = max(points, key=lambda point: point[1])
        return Cell("not reached", note=f"{best_db:.2f} dB at best, after {format_value(seconds)} s")
    seconds = points[at][0]
    before = f"(more than {format_value(points[at - 1][0])})" if at else ""
    return Cell(format_value(seconds), seconds, bound="at most", beside=before)


def _winners(run: MeasuredRun, fits: Mapping[str, list[dict[str, Any]]], psnr_db: Mapping[str, float]) -> Table | None:
    """The best PSNR that a budget of seconds buys; a line for each budget from which another method is best.

    Reading:
        A method that needs no fit costs nothing here, as depth is left out for all. A dearer fit becomes the best only where the
        interval of its paired difference to the best before it lies above zero: what cannot be told apart is not worth the wait.
    """
    cost_s = {label: fit_seconds(fits[label]) if label in fits else 0.0 for label in psnr_db}
    by_cost = sorted(psnr_db, key=lambda label: (cost_s[label], -psnr_db[label]))
    rows: list[Row] = []
    best, dataset = "", str(run.results.table["dataset"].iloc[0])
    for label in by_cost:
        ahead = difference_cell(run.metrics["PSNR"], run.results, label, best, dataset) if best else None
        if best and not (ahead and ahead.low is not None and ahead.low > 0):
            continue
        from_s = Cell(format_value(cost_s[label]), cost_s[label]) if cost_s[label] else Cell("0", 0.0)
        number = Cell(format_value(psnr_db[label], run.metrics["PSNR"].decimals), psnr_db[label])
        rows.append(run.row(label, (from_s, number, ahead or Cell("nothing is cheaper"))))
        best = label
    columns = (
        Column("fitting", "s", None, "Seconds of one fold's fit that this method needs: the budget from which it is the best."),
        Column("PSNR", "dB", None, "Mean of the held-out views."),
        Column("ahead of the line above", "dB", None, "Paired difference with its interval."),
    )
    caption = (
        f"The best method for what one waits before the first picture. Left out: dearer, and not better but by chance. {POINTS}"
    )
    return Table("budget", "The best under a budget", caption, columns, tuple(rows), run.scene)
