"""Tables of scored runs as Markdown, for `fill_tables`."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from ggvs_eval.errors import ResultsError
from ggvs_eval.merged_results import merge_results
from ggvs_eval.reports.figures.sweep_figures import SECONDS, read_k_table
from ggvs_eval.reports.model.measured import read_run
from ggvs_eval.reports.tables.error_budget import budget_table
from ggvs_eval.results import Results
from ggvs_eval.run_folder import JOB_FILE, ON_SCREEN, RunFolder, read_json
from ggvs_eval.statistics.intervals import Interval, intervals

DECIMALS = {
    "PSNR": 2,
    "PSNR_cc": 2,
    "SSIM": 3,
    "LPIPS": 3,
    "L1": 2,
    "TCC": 3,
    "STED": 2,
    "Flicker": 2,
    "SDT": 3,
    "SDV": 3,
}
DECIMALS |= {"EPI_coherence": 3, "switch_ratio": 2}

ON_THE_SCREEN = ("PSNR", "SSIM", "LPIPS", "TCC", "STED")
FIDELITY = ("PSNR", "SSIM", "LPIPS", "L1")
USUAL_VIEW = "cam00"  # that Neural 3D Video is tested on by most
# of the README; no network but the method's own
FRONT_METHODS = ("no-blending", "distance-based", "interpolation", "ours")

CLIP_DATASETS = {"dynerf": "DyNeRF", "enerf": "ENeRF-Outdoor", "d3dmv": "D3DMV"}
CLIP_METHODS = {"enerf": "ENeRF", "gpsg": "GPSG", "ibrnet": "IBRNet", "ours": "paper's"}


def results_table(run: Path) -> str:
    """Means of one run as Markdown, methods by their shown names."""
    summary = Results.read(run).summary().droplevel("dataset")
    columns = [name for name in DECIMALS if name in summary.columns]
    return _markdown(_named(summary[columns], run))


def report_table(run: Path, names: Sequence[str], columns: Sequence[str] = ()) -> str:
    """Tables of a run's report side by side, as Markdown, each value with half the width of its
    interval.

    Args:
        run: its folder.
        names: of the tables in ``report/tables.csv``, e.g. ``price``.
        columns: which; all by default.

    Raises:
        FileNotFoundError: there is no report.
        ResultsError: it has no such table.
    """
    cells = pd.read_csv(run / "report" / "tables.csv")
    cells = cells[cells["table"].isin(names) & (cells["kind"] != "reference")]
    if cells.empty:
        raise ResultsError(f"{run} has no table {' or '.join(names)}")
    if columns:
        cells = cells[cells["column"].str.split().str[0].isin(columns)]
    units = cells["unit"].fillna("")
    cells = cells.assign(
        head=(cells["column"] + " (" + units + ")").where(units != "", cells["column"])
    )
    heads = list(dict.fromkeys(cells["head"]))
    rows = ["| method | " + " | ".join(heads) + " |", "| --- |" + " ---: |" * len(heads)]
    for method, row in cells.groupby("method", sort=False):
        texts = {cell.head: _with_half_width(cell) for cell in row.itertuples()}
        rows.append(f"| {method} | " + " | ".join(texts.get(head, "") for head in heads) + " |")
    return "\n".join(rows)


def _with_half_width(cell: Any) -> str:
    """A cell's text, and half of its interval with the same decimals.

    Without a number its note is the text.
    """
    shown = next((text for text in (cell.shown, cell.note) if isinstance(text, str)), "–")
    if cell.hi != cell.hi:
        return shown
    decimals = len(shown.partition(".")[2])
    return f"{shown} ± {(cell.hi - cell.lo) / 2:.{decimals}f}"


def views_table(run: Path) -> str:
    """PSNR per test view as Markdown."""
    return _markdown(_named(Results.read(run).per_view("PSNR"), run))


def fidelity_table(run: Path, labels: Sequence[str], usual_view: bool = False) -> str:
    """Fidelity of some methods in one run as Markdown, and that of `ours` in the data set's usual
    test view where asked for.
    """
    results, names = Results.read(run), read_json(run / "methods.json")["names"]
    measured = results.summary().droplevel("dataset")
    named = {names[label]: measured.loc[tuple(label.partition("+")[::2])] for label in labels}
    if usual_view:
        in_view = {
            metric: results.per_view(metric).loc[("ours", ""), USUAL_VIEW] for metric in FIDELITY
        }
        named[f"{names['ours']}, {USUAL_VIEW}"] = pd.Series(in_view)
    rows = ["| method | " + " | ".join(FIDELITY) + " |", "| --- |" + " ---: |" * len(FIDELITY)]
    for name, values in named.items():
        rows.append(
            f"| {name} | "
            + " | ".join(f"{values[metric]:.{DECIMALS[metric]}f}" for metric in FIDELITY)
            + " |"
        )
    return "\n".join(rows)


def ceilings_table(run: Path) -> str:
    """Tabulate the scores of perfect renderings on the capture of one run, as Markdown."""
    entries = [
        entry for entry in read_json(run / "references.json") if entry["group"] == "consistency"
    ]
    columns = list(dict.fromkeys(column for entry in entries for column in entry["values"]))
    rows = [f"| method | {' | '.join(columns)} |", "| --- |" + " ---: |" * len(columns)]
    rows += [
        f"| {entry['name']} | {' | '.join(_ceiling(entry, column) for column in columns)} |"
        for entry in entries
    ]
    return "\n".join(rows)


def _ceiling(entry: Mapping[str, Any], metric: str) -> str:
    """A value, a bound, or the word that there is none."""
    value = entry["values"].get(metric, "")
    if isinstance(value, str):
        return "unknown"
    return f"{entry.get('bounds', {}).get(metric, '')} {value:.{DECIMALS[metric]}f}".strip()


def sweep_table(root: Path, metrics: Sequence[str]) -> str:
    """Means over the captures of a sweep, each with half the width of its interval, and seconds per
    frame where it rendered.

    Args:
        root: folder of the sweep.
        metrics: which.

    Raises:
        ResultsError: nothing is scored there.
    """
    runs = _runs_of(root)
    results = merge_results([Results.read(run) for run in runs])
    (dataset,) = results.table["dataset"].unique()
    shown = [metric for metric in metrics if metric in set(results.table["metric"])]
    columns = {metric: intervals(results, metric, dataset) for metric in shown}
    names = read_json(runs[0] / "methods.json")
    seconds = {label: _seconds(runs, label) for label in names["labels"]}
    heads = [*shown, "s / frame"] if any(value == value for value in seconds.values()) else shown
    rows = [f"| method | {' | '.join(heads)} |", "| --- |" + " ---: |" * len(heads)]
    for label in names["labels"]:
        cells = [
            *(_with_interval(metric, columns[metric][label]) for metric in shown),
            f"{seconds[label]:.2f}",
        ][: len(heads)]
        rows.append(f"| {names['names'].get(label, label)} | {' | '.join(cells)} |")
    return "\n".join(rows)


def k_table(sweep: Path, metrics: Sequence[str]) -> str:
    """Means of a sweep over the number of source views K, as Markdown: a row per method and K."""
    lines = read_k_table(sweep)
    shown = [metric for metric in metrics if metric in lines]
    rows = [
        f"| method | K | {' | '.join(shown)} | s / frame |",
        "| --- | ---: |" + " ---: |" * (len(shown) + 1),
    ]
    for method in dict.fromkeys(lines.index.get_level_values("method")):
        for k, line in lines.loc[method].iterrows():
            cells = [f"{line[metric]:.{DECIMALS.get(metric, 3)}f}" for metric in shown]
            rows.append(f"| {method} | {k} | {' | '.join(cells)} | {line[SECONDS]:.2f} |")
    return "\n".join(rows)


def stream_table(sweep: Path) -> str:
    """What is on the screen, how soon and how often, as Markdown: a row per K and method of a sweep
    with a stream.
    """
    heads = [
        *(f"{metric} seen" for metric in ON_THE_SCREEN),
        "PSNR",
        "pictures/s",
        "latency, ms",
        "shown",
        "dropped",
    ]
    rows = [f"| method | K | {' | '.join(heads)} |", "| --- | ---: |" + " ---: |" * len(heads)]
    for run in map(RunFolder, _runs_of(sweep)):
        k, times = run.protocol().synthesis.k, read_json(run.stream_record)["methods"]
        scores, names = (
            _by_label(Results.read(run.root).summary().droplevel("dataset")),
            read_json(run.root / "methods.json"),
        )
        for label in names["labels"]:
            displayed = (
                scores.loc[f"{label}{ON_SCREEN}"] if f"{label}{ON_SCREEN}" in scores.index else {}
            )
            values = [_rounded(metric, displayed.get(metric, math.nan)) for metric in ON_THE_SCREEN]
            values.append(_rounded("PSNR", scores.loc[label, "PSNR"]))
            told = [
                times[label].get(key) for key in ("per_second", "latency_ms", "shown", "dropped")
            ]
            cells = [*values, *("–" if value is None else f"{value:.0f}" for value in told)]
            rows.append(f"| {names['names'].get(label, label)} | {k} | {' | '.join(cells)} |")
    return "\n".join(rows)


def _rounded(metric: str, value: float) -> str:
    return "–" if value != value else f"{value:.{DECIMALS[metric]}f}"


def budget_rows(run: Path) -> str:
    """Tabulate where the squared error of the first method shown lies, view by view, as
    Markdown.
    """
    table = budget_table(read_run(run))
    if table is None:
        raise ResultsError(f"{run} has no pictures")
    heads = [" ".join(filter(None, (column.name, f"({column.unit})"))) for column in table.columns]
    rows = ["| | " + " | ".join(heads) + " |", "| --- |" + " ---: |" * len(heads)]
    return "\n".join(
        [
            *rows,
            *(
                f"| {row.name} | {' | '.join(cell.shown for cell in row.cells)} |"
                for row in table.rows
            ),
        ]
    )


def author_clips_table(file: Path) -> str:
    """Tabulate what ``benchmarks.author_clips`` wrote: means over the sequences of a data set, and
    the codec's floor.
    """
    rows = [
        "| data set | method | mTV | Sharpness | mTV2 | mTV2 / Sharpness |",
        "| --- | --- | ---: | ---: | ---: | ---: |",
    ]
    clips = pd.DataFrame(
        [
            {"dataset": clip["dataset"], "sequence": clip["sequence"], "method": method, **values}
            for clip in read_json(file)["clips"].values()
            for method, values in clip["values"].items()
        ]
    )
    clips["ratio"] = clips["mTV2"] / clips["Sharpness"]
    numbers = ["mTV", "Sharpness", "mTV2", "ratio"]
    for dataset, title in CLIP_DATASETS.items():
        here = clips[clips["dataset"] == dataset]
        if here.empty:
            continue
        encodings = here.groupby(["method", "sequence"])[numbers]
        means = encodings.mean().groupby("method").mean()
        head = f"{title}, {here['sequence'].nunique()} sequences"
        for method, name in CLIP_METHODS.items():
            rows.append(
                f"| {head} | {name} | {' | '.join(f'{value:.3f}' for value in means.loc[method])} |"
            )
        ours = (encodings.max() - encodings.min()).loc["ours"].mean()
        cells = (
            f"{ours[name]:.3f} ({ours[name] / means.loc['ours', name]:.1%})" for name in numbers
        )
        rows.append(f"| {head} | *codec floor* | {' | '.join(cells)} |")
    return "\n".join(rows)


def author_clips_colmap_table(file: Path) -> str:
    """Tabulate the COLMAP consistency of the authors' clips: one sequence per data set, and its
    control.
    """
    rows = [
        "| sequence | method | registered | track length | matches | views |",
        "| --- | --- | ---: | ---: | ---: | ---: |",
    ]
    measured = read_json(file)["colmap"]
    if not measured:
        raise ResultsError(
            f"{file} has no COLMAP consistency; run benchmarks.author_clips with --colmap"
        )
    for dataset, title in CLIP_DATASETS.items():
        for method, name in (
            CLIP_METHODS | {"ours, shuffled": "*paper's, views shuffled*"}
        ).items():
            if values := measured.get(dataset, {}).get(method):
                shown = (
                    f"{values['registered']:.2f} | {values['track_length']:.1f} | "
                    f"{values['matches']:.0f} | {values['n_views']}"
                )
                rows.append(f"| {title}, {values['sequence']} | {name} | {shown} |")
    return "\n".join(rows)


def colmap_controls_table(file: Path) -> str:
    """Tabulate what ``benchmarks.colmap_controls`` wrote: a row per control and method of
    the run.
    """
    rows = [
        "| images | registered | track length | matches | sharpness |",
        "| --- | ---: | ---: | ---: | ---: |",
    ]
    for name, values in read_json(file).items():
        cells = (
            f"{values['registered']:.2f}",
            f"{values['track_length']:.1f}",
            f"{values['matches']:.0f}",
            f"{values['sharpness']:.2f}",
        )
        rows.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(rows)


def _runs_of(sweep: Path) -> list[Path]:
    """The scored runs of a sweep, of one capture or of several."""
    runs = sorted(
        file.parent for pattern in ("*", "*/*") for file in sweep.glob(f"{pattern}/results.parquet")
    )
    if not runs:
        raise ResultsError(f"{sweep} holds no scored runs of a sweep")
    return runs


def _with_interval(metric: str, interval: Interval) -> str:
    decimals = DECIMALS.get(metric, DECIMALS["PSNR"] if metric.startswith("PSNR") else 3)
    value = f"{interval.value:.{decimals}f}"
    return value if interval.half_width is None else f"{value} ± {interval.half_width:.{decimals}f}"


def _seconds(runs: Sequence[Path], label: str) -> float:
    """Median over all frames of all views and captures."""
    records = [
        read_json(file)["seconds"]
        for run in runs
        for file in (run / "renders" / label).glob(f"*/{JOB_FILE}")
    ]
    return float(
        pd.Series(
            [sum(stages) for record in records for stages in zip(*record.values(), strict=True)]
        ).median()
    )


def _named(table: pd.DataFrame, run: Path) -> pd.DataFrame:
    names = read_json(RunFolder(run).root / "methods.json")["names"]
    return _by_label(table).rename(index=names)


def _by_label(table: pd.DataFrame) -> pd.DataFrame:
    """Rows by a method and its variant, by its label."""
    return table.set_axis(["+".join(filter(None, label)) for label in table.index], axis=0)


def _markdown(table: pd.DataFrame) -> str:
    rows = [
        "| method | " + " | ".join(map(str, table.columns)) + " |",
        "| --- |" + " ---: |" * len(table.columns),
    ]
    for name, values in table.iterrows():
        cells = (
            f"{value:.{DECIMALS.get(column, DECIMALS['PSNR'])}f}"
            for column, value in values.items()
        )
        rows.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(rows)
