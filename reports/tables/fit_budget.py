"""What seconds of fitting buy: the time to equal quality, and the best method under each budget."""

import math
import re
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.model.table import Cell, Column, Row, Table, format_value
from ggvs_eval.reports.tables.fitted import difference_cell, fit_records, fit_seconds
from ggvs_eval.results import label_of
from ggvs_eval.statistics.paired import OUTCOMES, Comparison, Outcome, judge_against

STATED_DB = 30.0  # a PSNR that a fit may be asked for, beside those of the methods that need none
POINTS = (
    "The points are whole fits: rows of a method that differ in steps (`4dgs+steps=1000`; `ggvs-eval sweep budget` has a series)."
)


def budget_tables(run: MeasuredRun) -> tuple[Table, ...]:
    """Cost at equal quality and the best method under each budget, of ranked methods alone; nothing where none is fitted."""
    summary = run.results.summary().droplevel("dataset")
    numbers = {label_of(*names): float(summary.loc[names].get("PSNR", math.nan)) for names in summary.index}
    ranked = [label for label in run.labels if label not in run.results.set_aside]
    psnr_db = {label: numbers[label] for label in ranked if math.isfinite(numbers.get(label, math.nan))}
    fits = {label: records for label, records in fit_records(run).items() if label in psnr_db}
    if not fits:
        return ()
    return tuple(table for table in (_equal_quality(run, fits, psnr_db), _winners(run, fits, psnr_db)) if table)


def _against(run: MeasuredRun, reference: str, labels: Collection[str]) -> dict[str, Comparison]:
    """Methods judged against one of them in PSNR."""
    note, dataset = run.metrics["PSNR"], str(run.results.table["dataset"].iloc[0])
    return judge_against(run.results, note.name, note.higher_is_better, dataset, reference, labels)


def _equal_quality(run: MeasuredRun, fits: Mapping[str, list[dict[str, Any]]], psnr_db: Mapping[str, float]) -> Table | None:
    """Seconds of fitting at which a method first reaches what others have without any, on held-out views.

    Reading:
        A fit's own curve is of its training images, and held-out views shown to it on the way would be a leak. So the curve is
        made of whole fits: a method's labels that differ in ``steps`` are its points, and between two of them a crossing is a
        bound from either side. A fit has reached a method where its number is no worse and the clip is not too short to call it.
    """
    instant = [label for label in psnr_db if label not in fits]
    ours = next((label for label in run.ours_first if label in instant and label in run.ours), None)
    rivals = [label for label in (ours, next((each for each in instant if each.startswith("enerf")), None)) if label]
    if not rivals:
        return None
    families: dict[str, list[str]] = {}
    for label in fits:
        families.setdefault(re.sub(r"\+steps=\d+", "", label), []).append(label)
    targets = {f"{STATED_DB:g} dB": {label: _reached("equal", psnr_db[label] - STATED_DB) for label in fits}}
    for rival in reversed(rivals):
        found = {label: _reached(one.outcome, one.difference) for label, one in _against(run, rival, fits).items()}
        targets = {f"as {run.name(rival)}, {psnr_db[rival]:.2f} dB": found} | targets
    columns = tuple(Column(name, "s", False, "Seconds of one fold's fit.") for name in targets)
    rows = []
    for labels in families.values():
        points = [sorted((fit_seconds(fits[each]), psnr_db[each], found[each]) for each in labels) for found in targets.values()]
        rows.append(Row(re.sub(r", [\d,]+ steps|\+steps=\d+", "", run.name(labels[0])), tuple(map(_crossing, points))))
    caption = f"Seconds of fitting until a method's PSNR on held-out views is that of a method that needs no fit. {POINTS}"
    return Table("equal_quality", "Cost at equal quality", caption, columns, tuple(rows), run.scene)


def _reached(outcome: Outcome, ahead_db: float) -> Outcome:
    """Outcome against a target, ``worse`` wherever the number falls short of it and the clip is long enough to say so."""
    return outcome if outcome in ("too short", "untested") or ahead_db >= 0 else "worse"


def _crossing(points: Sequence[tuple[float, float, Outcome]]) -> Cell:
    """The first of some (seconds, dB, outcome against a target), rising in seconds, that is not worse than the target.

    The cell is a bound, as the truth lies between two points.
    """
    at = next((at for at, (*_, outcome) in enumerate(points) if outcome != "worse"), None)
    if at is None:
        seconds, best_db, _ = max(points, key=lambda point: point[1])
        return Cell("not reached", note=f"{best_db:.2f} dB at best, after {format_value(seconds)} s")
    seconds, reached_db, outcome = points[at]
    if outcome in ("too short", "untested"):
        return Cell(OUTCOMES[outcome], note=f"{reached_db:.2f} dB after {format_value(seconds)} s")
    before = f"(more than {format_value(points[at - 1][0])})" if at else ""
    return Cell(format_value(seconds), seconds, bound="at most", beside=before)


def _winners(run: MeasuredRun, fits: Mapping[str, list[dict[str, Any]]], psnr_db: Mapping[str, float]) -> Table | None:
    """The best PSNR that a budget of seconds buys; a line for each budget from which another method is best.

    Reading:
        A method that needs no fit costs nothing here, as depth is left out for all. A dearer fit becomes the best only where it
        is judged better than the best before it, among all that are dearer: what cannot be told apart, or is too short to call,
        is not worth the wait.
    """
    cost_s = {label: fit_seconds(fits[label]) if label in fits else 0.0 for label in psnr_db}
    by_cost = sorted(psnr_db, key=lambda label: (cost_s[label], -psnr_db[label]))
    rows: list[Row] = []
    best, ahead = by_cost[0], Cell("nothing is cheaper")
    while best:
        from_s = Cell(format_value(cost_s[best]), cost_s[best]) if cost_s[best] else Cell("0", 0.0)
        number = Cell(format_value(psnr_db[best], run.metrics["PSNR"].decimals), psnr_db[best])
        rows.append(run.row(best, (from_s, number, ahead)))
        judged = _against(run, best, by_cost[by_cost.index(best) + 1 :])
        best = next((label for label, one in judged.items() if one.outcome == "better"), "")
        ahead = difference_cell(run.metrics["PSNR"], judged.get(best))
    columns = (
        Column("fitting", "s", None, "Seconds of one fold's fit that this method needs: the budget from which it is the best."),
        Column("PSNR", "dB", None, "Mean of the held-out views."),
        Column("ahead of the line above", "dB", None, "Paired difference with its interval."),
    )
    caption = (
        "The best method for what one waits before the first picture. Left out: dearer, and not better, or the clip is too short "
        f"to call it. {POINTS}"
    )
    return Table("budget", "The best under a budget", caption, columns, tuple(rows), run.scene)
