"""Tables of what methods see, take and cost, the spread over seeds, and the price of being online.

What seconds of fitting buy is the time to equal quality and the best method under each budget; what
differs between methods by design is next to what the protocol makes the same for all of them.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

from ggvs_eval.measured_frames import measuring_way
from ggvs_eval.reports.model.measured import METHODS_FILE, MeasuredRun, MetricNote
from ggvs_eval.reports.model.table import (
    SHORT_MEANS,
    Cell,
    Column,
    Row,
    Table,
    format_half_width,
    format_value,
    signed,
    spread_text,
)
from ggvs_eval.reports.section import Report, SectionContent, tables_of_runs
from ggvs_eval.reports.tables.timing import TOTAL, render_records, timing_table
from ggvs_eval.reports.tables.verdict import judge_runs
from ggvs_eval.results import Results, label_of, without_option
from ggvs_eval.run_folder import read_json
from ggvs_eval.statistics.intervals import LEVEL
from ggvs_eval.statistics.paired import OUTCOMES, Comparison, Outcome, Pair

MEGABYTE = 1e6
NOT_FITTED = "not fitted"
ELSEWHERE = (
    "4K4D was not run here: it needs foreground masks of all frames, its licence forbids "
    "commercial use and requires derived work to be open, and its 800,000 iterations take a day of "
    "a GPU; import its frames as `rendered:PATH`."
)
UNKNOWN = Cell("unknown: others made it")
UNRECORDED = Cell("not recorded")
COST_COLUMNS = (
    Column("cameras used", describe="of the capture's cameras; a fit uses all except its fold"),
    Column(
        "images used",
        describe="captured images, for the clip of one test view: cameras times instants",
    ),
    Column("look-ahead", describe="instants of the future that a frame depends on"),
    Column("fitting", "s/frame", describe="of one fold, over its instants"),
    Column(
        "whole fit",
        "s",
        describe="of one fold: time before the first frame of a method that uses the whole clip",
    ),
    Column("fitted on"),
    Column("rendering", "ms/frame", describe="median, as in the table of times"),
    Column(
        "peak memory",
        "MB",
        describe="highest resident memory of the process that fitted, or else rendered",
    ),
    Column("size", "MB/frame", describe="of the scene, over its instants"),
    Column("seeds", describe="fits by another seed that were measured too, and the first"),
)
NOTHING = {NOT_FITTED, UNRECORDED.text}  # a column of these alone is left out
STATED_DB = 30.0  # a PSNR that a fit can be asked for, besides the PSNRs of the methods without fit
POINTS = (
    "The points are whole fits: rows of a method that differ in steps (`4dgs+steps=1000`; "
    "`ggvs-eval sweep budget` has a series)."
)
DIFFERENCE_COLUMNS = (
    Column("depth", describe="whether the method is given depth of its sources"),
    Column("learned from", describe="what its weights or its scene were learned from"),
    Column("not as published", describe="differences of the implementation from the authors'"),
)
UNKNOWN_DIFFERENCE = "unknown: others made it"


def fit_records(run: MeasuredRun) -> dict[str, list[dict[str, Any]]]:
    """Return label -> cost of its fits, one record per fold; of fitted methods alone."""
    records: dict[str, list[dict[str, Any]]] = {}
    for label in run.labels:
        fits = [record["fit"] for record in render_records(run, label) if "fit" in record]
        if fits:
            # test views of a fold share one
            records[label] = [fit for at, fit in enumerate(fits) if fit not in fits[:at]]
    return records


def cost_tables(run: MeasuredRun) -> tuple[Table, ...]:
    """Return the tables of input and cost, and with fitted methods the spread over seeds."""
    fits = fit_records(run)
    tables = (_cost_table(run, fits), _seed_table(run))
    return tuple(table for table in tables if table)


def _cost_table(run: MeasuredRun, fits: Mapping[str, list[dict[str, Any]]]) -> Table | None:
    """Return a column per cost that any method has; None where others made all frames."""
    n_cameras = len(run.folder.capture_record().get("cameras", ()))
    ahead = read_json(run.folder.root / METHODS_FILE).get("look_ahead", ())
    lines = {
        label: _fit_cells(run, label, fits[label], n_cameras)
        if label in fits
        else _other_cells(run, label, n_cameras, ahead)
        for label in run.labels
    }
    if not any(cell.value is not None for line in lines.values() for cell in line):
        return None
    columns_shown = [
        at
        for at, _ in enumerate(COST_COLUMNS)
        if {line[at].text for line in lines.values()} - NOTHING
    ]
    rows = [run.row(label, [line[at] for at in columns_shown]) for label, line in lines.items()]
    caption = "Peak memory: of the process, including memory of earlier methods."
    if fits:
        folds = " · ".join(", ".join(fold) for fold in run.protocol.views.folds)
        caption = (
            f"Fitted methods render each test view from a fit without its fold ({folds}); the "
            "others from K sources. Fitting: mean over the folds, depth excluded as for all "
            f"methods. {caption} {ELSEWHERE}"
        )
    columns = tuple(COST_COLUMNS[at] for at in columns_shown)
    return Table(
        key="costs",
        title="Input and cost of each method",
        caption=caption,
        columns=columns,
        rows=tuple(rows),
        dataset=run.scene,
    )


def _fit_cells(
    run: MeasuredRun, label: str, fits: Sequence[dict[str, Any]], n_cameras: int
) -> tuple[Cell, ...]:
    """Return the cells of `COST_COLUMNS` of a fitted method."""
    counts = sorted({fit["cameras"] for fit in fits})
    span = f"to {counts[-1]} of {n_cameras}" if len(counts) > 1 else f"of {n_cameras}"
    machines = dict.fromkeys(
        f"{fit['threads']} thread{'s' * (fit['threads'] > 1)}, {fit['machine']}" for fit in fits
    )
    peaks = [fit["peak_bytes"] for fit in fits if fit.get("peak_bytes")]
    seeds = 1 + len(run.replicas.get(label, ()))
    return (
        Cell(str(counts[0]), float(counts[0]), beside=span),
        _count_cell(max(fit["cameras"] * fit["instants"] for fit in fits)),
        Cell("sequence") if fits[0]["look_ahead"] == "sequence" else Cell("0", 0.0),
        _number_cell(sum(fit["seconds"] / fit["instants"] for fit in fits) / len(fits)),
        _number_cell(fit_seconds(fits)),
        Cell("; ".join(machines)),
        _rendering_cell(run, label),
        _count_cell(round(max(peaks) / MEGABYTE)) if peaks else UNRECORDED,
        _number_cell(
            sum(fit["size_bytes"] / fit["instants"] for fit in fits) / len(fits) / MEGABYTE
        ),
        Cell(str(seeds), float(seeds)),
    )


def _other_cells(
    run: MeasuredRun, label: str, n_cameras: int, ahead: Collection[str]
) -> tuple[Cell, ...]:
    """Return the same of a method that renders each instant from its sources.

    Of what others made that is unknown.
    """
    records = render_records(run, label)
    is_known, not_fitted = (
        bool(records) and "splats" not in records[0].get("identity", {}),
        Cell(NOT_FITTED),
    )
    if not is_known:
        return (*[UNKNOWN] * 6, _rendering_cell(run, label), UNKNOWN, UNKNOWN, not_fitted)
    k, peaks = (
        run.protocol.synthesis.k,
        [record["peak_bytes"] for record in records if record.get("peak_bytes")],
    )
    return (
        Cell(str(k), float(k), beside=f"of {n_cameras}" if n_cameras else ""),
        _count_cell(k * run.protocol.frames.count),
        Cell("sequence") if label in ahead else Cell("0", 0.0),
        *[not_fitted] * 3,
        _rendering_cell(run, label),
        _count_cell(round(max(peaks) / MEGABYTE)) if peaks else UNRECORDED,
        *[not_fitted] * 2,
    )


def _count_cell(count: int) -> Cell:
    return Cell(f"{count:,}", float(count))


def _number_cell(value: float) -> Cell:
    return Cell(format_value(value), value)


def fit_seconds(fits: Sequence[dict[str, Any]]) -> float:
    """Return the seconds of a fit, the mean over its folds."""
    return float(sum(fit["seconds"] for fit in fits) / len(fits))


def _rendering_cell(run: MeasuredRun, label: str) -> Cell:
    table = timing_table(run)
    total = next(at for at, column in enumerate(table.columns) if column.name == TOTAL)
    cell = table.rows[run.labels.index(label)].cells[total]
    return replace(cell, beside="")


def _seed_table(run: MeasuredRun) -> Table | None:
    """Return the largest minus smallest number over the seeds of a fit.

    None if every method has one seed.
    """
    if run.all_results is None or not run.replicas:
        return None
    summary = run.all_results.summary().droplevel("dataset")
    numbers = {label_of(*names): summary.loc[names] for names in summary.index}
    notes = [note for name, note in run.metrics.items() if name in summary.columns]
    rows = []
    for label, replicas in run.replicas.items():
        values = [
            [float(numbers[replica][note.name]) for replica in (label, *replicas)] for note in notes
        ]
        rows.append(run.row(label, list(map(_seed_cell, notes, values))))
    columns = tuple(
        Column(name=note.name, unit=note.unit, higher_is_better=None, describe=note.describe)
        for note in notes
    )
    caption = (
        "Largest minus smallest number over the seeds of the fit; the other tables show the "
        "first seed."
    )
    return Table(
        key="seeds",
        title="Spread over seeds",
        caption=caption,
        columns=columns,
        rows=tuple(rows),
        dataset=run.scene,
    )


def _seed_cell(note: MetricNote, values: Sequence[float]) -> Cell:
    spread = max(values) - min(values)
    if spread != spread:  # NaN: a seed lacks the metric
        return Cell("not computed: a seed without it")
    numbers_text = ", ".join(format_value(value, note.decimals) for value in values)
    return Cell(format_half_width(max(values), spread, note.decimals), spread, note=numbers_text)


def price_tables(runs: Sequence[MeasuredRun], results: Results) -> tuple[Table, ...]:
    """Price of being online: every fitted method minus GGVS, per dataset.

    Nothing if either is missing or set aside.
    """
    labels = [label for run in runs for label in run.ours_first if label not in results.set_aside]
    fitted = list(
        dict.fromkeys(label for run in runs for label in fit_records(run) if label in labels)
    )
    own_labels = [label for label in labels if label in runs[0].ours and label not in fitted]
    if not fitted or not own_labels:
        return ()
    notes, standings = list(runs[0].metrics.values()), judge_runs(runs, results)
    tables = []
    for dataset in dict.fromkeys(str(name) for name in results.table["dataset"]):
        cells: dict[str, list[Cell]] = {label: [] for label in fitted}
        decided = standings[dataset].decide(
            Pair(note.name, label, own_labels[0]) for note in notes for label in fitted
        )
        for label, of_label in cells.items():
            for note in notes:
                comparison = decided.get(Pair(note.name, label, own_labels[0]))
                of_label.append(
                    difference_cell(note, comparison, results.why_absent(note.name, label))
                )
        columns = tuple(
            Column(
                name=f"{note.name} {note.arrow}",
                unit=note.unit,
                higher_is_better=None,
                describe=note.describe,
            )
            for note in notes
        )
        name, k = runs[0].name(own_labels[0]), runs[0].protocol.synthesis.k
        caption = (
            f"Each fitted method minus {name}, which uses {k} views and no future frames; ±: "
            f"{100 * LEVEL:.0f} % interval of the paired difference. Arrows: where the fitted "
            "method is better; bold: significantly, over all methods and metrics together. "
            f"{SHORT_MEANS}"
        )
        rows = tuple(
            Row(runs[0].name(label), tuple(of_label), label=label)
            for label, of_label in cells.items()
        )
        tables.append(
            Table(
                key="price",
                title="Price of being online",
                caption=caption,
                columns=columns,
                rows=rows,
                dataset=dataset,
            )
        )
    return tuple(tables)


def difference_cell(note: MetricNote, comparison: Comparison | None, why_absent: str = "") -> Cell:
    """Return a decided difference with its interval and what may be said of it, or why there is
    none.
    """
    if comparison is None or comparison.difference != comparison.difference:
        return Cell("not computed", note=why_absent or "no value")
    value, text = comparison.difference, signed(comparison.difference, note.decimals)
    if comparison.high is None:
        return Cell(
            text,
            value,
            note="; ".join(filter(None, (OUTCOMES[comparison.outcome], comparison.note))),
        )
    spread = spread_text(value, comparison.high - value, note.decimals, bool(comparison.short))
    outcome = "" if comparison.outcome in ("better", "worse") else OUTCOMES[comparison.outcome]
    remark = "; ".join(filter(None, (outcome, comparison.note)))
    return Cell(
        text=text,
        value=value,
        best=comparison.outcome == "better",
        shade=0.0,
        spread=spread,
        low=comparison.low,
        high=comparison.high,
        note=remark,
    )


def budget_tables(run: MeasuredRun) -> tuple[Table, ...]:
    """Cost at equal quality and the best method under each budget, of ranked methods alone.

    Nothing if none is fitted.
    """
    summary = run.results.summary().droplevel("dataset")
    numbers = {
        label_of(*names): float(summary.loc[names].get("PSNR", math.nan)) for names in summary.index
    }
    ranked = [label for label in run.labels if label not in run.results.set_aside]
    psnr_db = {
        label: numbers[label] for label in ranked if math.isfinite(numbers.get(label, math.nan))
    }
    fits = {label: records for label, records in fit_records(run).items() if label in psnr_db}
    if not fits:
        return ()
    return tuple(
        table
        for table in (_equal_quality(run, fits, psnr_db), _winners(run, fits, psnr_db))
        if table
    )


def _against(run: MeasuredRun, reference: str, labels: Collection[str]) -> dict[str, Comparison]:
    """Return the methods judged against one of them in PSNR."""
    (standings,) = judge_runs([run], run.results).values()
    decided = standings.decide(
        Pair("PSNR", label, reference) for label in labels if label != reference
    )
    return {pair.first: comparison for pair, comparison in decided.items()}


def _equal_quality(
    run: MeasuredRun, fits: Mapping[str, list[dict[str, Any]]], psnr_db: Mapping[str, float]
) -> Table | None:
    """Return the seconds of fitting at which a method first reaches what others have without any,
    on held-out views.

    Reading:
        A fit's own curve is of its training images, and held-out views shown to it on the way would
        be a leak. So the curve is made of whole fits: a method's labels that differ in ``steps``
        are its points, and between two of them a crossing is a bound from either side. A fit has
        reached a method where its number is no worse and the clip is not too short to call it.
    """
    instant = [label for label in psnr_db if label not in fits]
    own_label = next(
        (label for label in run.ours_first if label in instant and label in run.ours), None
    )
    rivals = [
        label
        for label in (own_label, next((name for name in instant if name.startswith("enerf")), None))
        if label
    ]
    if not rivals:
        return None
    families: dict[str, list[str]] = {}
    for label in fits:
        families.setdefault(without_option(label, "steps"), []).append(label)
    targets = {
        f"{STATED_DB:g} dB": {
            label: _reached("equal", psnr_db[label] - STATED_DB) for label in fits
        }
    }
    for rival in reversed(rivals):
        times = {
            label: _reached(result.outcome, result.difference)
            for label, result in _against(run, rival, fits).items()
        }
        targets = {f"as {run.name(rival)}, {psnr_db[rival]:.2f} dB": times} | targets
    columns = tuple(
        Column(name=name, unit="s", higher_is_better=False, describe="Seconds of one fold's fit.")
        for name in targets
    )
    rows = []
    for family, labels in families.items():
        points = [
            sorted((fit_seconds(fits[name]), psnr_db[name], times[name]) for name in labels)
            for times in targets.values()
        ]
        rows.append(Row(run.name(family), tuple(map(_crossing, points))))
    caption = (
        f"Seconds of fitting until a method's PSNR on held-out views is that of a method "
        f"that needs no fit. {POINTS}"
    )
    return Table(
        key="equal_quality",
        title="Cost at equal quality",
        caption=caption,
        columns=columns,
        rows=tuple(rows),
        dataset=run.scene,
    )


def _reached(outcome: Outcome, ahead_db: float) -> Outcome:
    """Outcome against a target, ``worse`` wherever the number falls short of it and the clip is
    long enough to say so.
    """
    return outcome if outcome in ("too short", "untested") or ahead_db >= 0 else "worse"


def _crossing(points: Sequence[tuple[float, float, Outcome]]) -> Cell:
    """Return the first of some (seconds, dB, outcome against a target), ascending in seconds, that
    is not worse than the target.

    The cell is a bound, as the truth is between two points.
    """
    at = next((at for at, (*_, outcome) in enumerate(points) if outcome != "worse"), None)
    if at is None:
        seconds, best_db, _ = max(points, key=lambda point: point[1])
        return Cell(
            "not reached", note=f"{best_db:.2f} dB at best, after {format_value(seconds)} s"
        )
    seconds, reached_db, outcome = points[at]
    if outcome in ("too short", "untested"):
        return Cell(OUTCOMES[outcome], note=f"{reached_db:.2f} dB after {format_value(seconds)} s")
    before = f"(more than {format_value(points[at - 1][0])})" if at else ""
    return Cell(format_value(seconds), seconds, bound="at most", beside=before)


def _winners(
    run: MeasuredRun, fits: Mapping[str, list[dict[str, Any]]], psnr_db: Mapping[str, float]
) -> Table | None:
    """Return the best PSNR that a budget of seconds buys.

    A line for each budget from which another method is best.

    Reading:
        A method that needs no fit costs nothing here, as depth is left out for all. A dearer fit
        becomes the best only where it is judged better than the best before it, among all that are
        dearer: what cannot be distinguished, or is too short to call, is not worth the wait.
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
        best = next(
            (label for label, comparison in judged.items() if comparison.outcome == "better"), ""
        )
        ahead = difference_cell(run.metrics["PSNR"], judged.get(best))
    columns = (
        Column(
            name="fitting",
            unit="s",
            higher_is_better=None,
            describe="Seconds of one fold's fit: the budget from which this method is best.",
        ),
        Column(
            name="PSNR", unit="dB", higher_is_better=None, describe="Mean of the held-out views."
        ),
        Column(
            name="ahead of the line above",
            unit="dB",
            higher_is_better=None,
            describe="Paired difference with its interval.",
        ),
    )
    caption = (
        "Best method for each waiting time before the first frame. Omitted: slower and not "
        f"better, or the clip is too short to decide. {POINTS}"
    )
    return Table(
        key="budget",
        title="Best method per budget",
        caption=caption,
        columns=columns,
        rows=tuple(rows),
        dataset=run.scene,
    )


def differences_table(run: MeasuredRun) -> Table | None:
    """Return the table of differences that no protocol can remove.

    None for runs scored before they were recorded.
    """
    declared = read_json(run.folder.root / METHODS_FILE).get("declared")
    if declared is None:
        return None
    rows = [
        run.row(
            label,
            [
                Cell(declared.get(label, {}).get(column.name, UNKNOWN_DIFFERENCE))
                for column in DIFFERENCE_COLUMNS
            ],
        )
        for label in run.labels
    ]
    caption = f"Differences that no protocol can remove. The same for all: {_same(run)}."
    return Table(
        key="differences",
        title="Differences between the methods",
        caption=caption,
        columns=DIFFERENCE_COLUMNS,
        rows=tuple(rows),
        dataset=run.scene,
    )


def _same(run: MeasuredRun) -> str:
    protocol, synthesis = run.protocol, run.protocol.synthesis
    sources = (
        ""
        if run.from_sources.isdisjoint(run.labels)
        else f"K = {synthesis.k} sources for those that render from sources; "
    )
    way = measuring_way(protocol.measurement)
    way_text = f", {way.describe}," if way else ""
    size = f"{synthesis.width} x {synthesis.height}" if synthesis.width else "the capture's size"
    return (
        f"test views {', '.join(protocol.views.test)}, each left out of its own rendering and of "
        f"the depth for it; {protocol.frames.count} frames of {size}, resized by "
        f"{synthesis.resize_filter}; {sources}scores from 8-bit images on disk{way_text} by one "
        "implementation of each metric"
    )


def costs_section(report: Report) -> SectionContent:
    """Return the tables of each run, and of each group the price of being online."""
    content = tables_of_runs(_tables, "timing")(report)
    prices = {
        group.id: price_tables([*group.runs.values()], group.results) for group in report.groups
    }
    return replace(content, tables={**prices, **content.tables})


def _tables(run: MeasuredRun) -> tuple[Table | None, ...]:
    return (*cost_tables(run), *budget_tables(run), differences_table(run))
