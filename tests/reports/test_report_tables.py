"""Tables of the report: every number is the summary's, rounded; shading, published rows and
times.
"""

import csv
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from ggvs_eval.errors import ResultsError
from ggvs_eval.metrics.registry import METRICS
from ggvs_eval.protocol import Frames
from ggvs_eval.reports.model.measured import read_run
from ggvs_eval.reports.model.table import (
    SHORT,
    Cell,
    Column,
    Row,
    Table,
    format_half_width,
    format_value,
    rank,
    shade,
)
from ggvs_eval.reports.report import write_report
from ggvs_eval.reports.tables.error_budget import decomposition_table
from ggvs_eval.reports.tables.published import paper_beside, published_rows, published_values
from ggvs_eval.reports.tables.report_tables import main_tables
from ggvs_eval.reports.tables.table_formats import escape_latex, to_latex, to_markdown
from ggvs_eval.reports.tables.timing import timing_table
from ggvs_eval.reports.tables.verdict import leaders
from ggvs_eval.results import Results, make_table
from ggvs_eval.run_folder import read_json, write_json
from ggvs_eval.statistics.intervals import intervals
from helpers.page_reader import PageReader
from helpers.run_folders import LABELS, NAMES, RunShape, write_run

SMALL = RunShape(views=("cam00",), metrics=("PSNR", "LPIPS"), poses=0)


@pytest.fixture(scope="module")
def whole_run(tmp_path_factory) -> Path:
    """A whole run; nobody changes it."""
    return write_run(tmp_path_factory.mktemp("reports") / "run")


@pytest.fixture(scope="module")
def report(whole_run, tmp_path_factory) -> Path:
    """Folder of its report."""
    return write_report(
        [whole_run], tmp_path_factory.mktemp("reports") / "report", with_figures=False
    ).parent


def test_every_number_is_the_summary_rounded(whole_run, report):
    """Each cell of the main tables is the value of Results.summary, rounded as the table of
    decimals says.
    """
    summary = Results.read(whole_run).summary()
    rows = list(csv.DictReader((report / "tables.csv").open(encoding="utf-8")))
    page = PageReader((report / "index.html").read_text(encoding="utf-8"))
    labels = {name: label for label, name in NAMES.items()}
    main = [row for row in rows if row["table"] in {"quality", "consistency"}]
    assert len(main) == len(LABELS) * 9
    for row in main:
        method, _, variant = labels[row["method"]].partition("+")
        value = summary.loc[("Demo room", method, variant), row["column"]]
        assert float(row["value"]) == value
        assert row["shown"] == format_value(value, METRICS[row["column"]].decimals)
        assert row["shown"] in page.texts
        assert row["shown"] in (report / "tables.md").read_text(encoding="utf-8")
        assert row["shown"] in (report / "tables.tex").read_text(encoding="utf-8")


def test_views_have_their_own_numbers(whole_run, report):
    """Each cell of the table per view is the mean over the frames of that view."""
    rows = list(csv.DictReader((report / "tables.csv").open(encoding="utf-8")))
    values = Results.read(whole_run).per_view("TCC")
    shown = {
        (row["method"], row["column"]): float(row["value"])
        for row in rows
        if row["table"] == "view-TCC"
    }
    assert shown == {
        (NAMES["+".join(filter(None, key))], view): values.loc[key, view]
        for key in values.index
        for view in ("cam00", "cam03")
    }


@pytest.mark.parametrize(
    ("metric", "value", "text"),
    [
        ("PSNR", 31.1749, "31.17"),
        ("SSIM", 0.9355, "0.935"),
        ("L1", 5.0, "5.00"),
        ("STED", 2796.4, "2796"),
        ("STED", 68.7612, "68.76"),
        ("STED", 0.56312, "0.5631"),
        ("STED", 0.0, "0.000"),
        ("PSNR", float("inf"), "∞"),
    ],
)
def test_values_are_rounded_as_the_paper_does(metric, value, text):
    """Decimals are fixed per metric; STED has four significant digits; a perfect picture has
    infinite PSNR.
    """
    assert format_value(value, METRICS[metric].decimals) == text


def test_tables_follow_the_protocol_and_what_belongs_nowhere_comes_last(tmp_path):
    """Columns stand in the protocol's order, tables in that of their first metric, and further
    measures behind all others.
    """
    run = write_run(tmp_path / "run", RunShape(metrics=("SSIM_cc", "TCC", "SSIM", "PSNR"), poses=0))
    tables = main_tables([read_run(run)], Results.read(run))
    heads = [
        (table.key, table.title, [column.name for column in table.columns]) for table in tables
    ]
    assert heads == [
        ("consistency", "Temporal and view consistency", ["TCC"]),
        ("quality", "Image quality", ["SSIM", "PSNR"]),
        ("further", "Further measures", ["SSIM_cc"]),
    ]


def test_a_run_that_says_too_little_of_its_metrics_is_scored_again(tmp_path):
    """A run folder of an older version, whose metrics have no table and no digits, is refused with
    what to do.
    """
    run = write_run(tmp_path / "run", SMALL)
    notes = read_json(run / "metrics.json")
    del notes["PSNR"]["group"]
    write_json(run / "metrics.json", notes)
    with pytest.raises(
        ResultsError,
        match=r"metrics.json: wanted decimals, .*group.* of PSNR, got .*; run `ggvs-eval score .*` "
        r"again",
    ):
        read_run(run)


def test_missing_metric_says_why(tmp_path):
    """Where a metric could not be computed its reason stands in the cell, and no cell is blank or
    NaN.
    """
    run = write_run(
        tmp_path / "run", SMALL, not_computed={"LPIPS": "weights absent, run `make install`"}
    )
    report = write_report([run], with_figures=False).parent
    for name in ("index.html", "tables.md", "tables.csv", "tables.tex"):
        text = re.sub(r"base64,[\w+/=]+", "", (report / name).read_text(encoding="utf-8"))
        assert "not computed: weights absent" in text
        assert not re.search(r"<td[^>]*>\s*</td>|\| +\||& +&|\bnan\b", text, re.IGNORECASE)


def labelled(*values: float, kind: str = "measured") -> list[Row]:
    """Rows of one column whose labels are their numbers."""
    return [Row(f"{value}", (Cell(f"{value:.1f}", value),), kind, f"{value}") for value in values]


def test_bold_is_the_judgements_and_the_better_half_blue():
    """What is judged best alone is bold; the shade follows the gain curve of the paper's TeX;
    published rows have neither.
    """
    rows = [*labelled(1.0, 2.0, 2.98, 3.0), *labelled(9.0, kind="published")]
    column = [Column("PSNR", "dB", True)]
    ranked = [row.cells[0] for row in rank(column, rows, [{"3.0", "2.0", "9.0"}])]
    assert [cell.best for cell in ranked] == [False, True, False, True, False]
    assert [cell.shade > 0 for cell in ranked] == [False, False, True, True, False]
    assert not any(row.cells[0].best for row in rank(column, rows))
    falling = [row.cells[0].shade for row in rank([Column("L1", "", False)], rows)]
    assert (max(falling), falling[3]) == (falling[0], 0.0)
    assert shade(0.5, True) == shade(0.2, False) == 0.0
    assert shade(1.0, True) == shade(1.0, False) == 1.0
    assert shade(0.75, True) == pytest.approx(0.5 / (2.0 * 0.5 + 1.0))
    assert shade(0.75, False) == pytest.approx(0.5 / ((1 / 0.15 - 2) * 0.5 + 1.0))


def test_what_is_not_ranked_is_neither_bold_nor_shaded():
    """A number better than real keeps its digits and takes no part in the scale."""
    rows = labelled(1.0, 2.0, 3.0)
    better = replace(rows[0], cells=(replace(rows[0].cells[0], unranked="is better than real"),))
    ranked = rank([Column("SDT", "", False)], [better, *rows[1:]], [{"2.0"}])
    assert [(row.cells[0].best, row.cells[0].shade > 0) for row in ranked] == [
        (False, False),
        (True, True),
        (False, False),
    ]


def test_a_blurred_truth_wins_no_metric_of_the_path(tmp_path):
    """Numbers better than those of the captured images are shown and not ranked; the best up to
    there leads, untested.
    """
    metrics = ("PSNR", "reprojection", "E_warp")
    root = write_run(tmp_path / "run", RunShape(metrics=metrics, poses=0))
    found = Results.read(root)
    values = {
        "no-blending": (0.46, 1.0),
        "ours-geometric": (0.95, 1.8),
        "ours-geometric+no-temporal": (1.20, 2.5),
    }
    rows = [
        ("Demo room", "room", *label.partition("+")[::2], "path", -1, metric, value)
        for label, pair in values.items()
        for metric, value in zip(metrics[1:], pair, strict=True)
    ]
    table = pd.concat([found.table[found.table["metric"] == "PSNR"], make_table(rows)])
    replace(found, table=table).write(root)
    captured = {"reprojection": 0.8625, "E_warp": 1.5}
    write_json(
        root / "references.json",
        [{"group": "path", "name": "Captured images", "note": "real.", "values": captured}],
    )
    run = read_run(root)
    (path,) = [table for table in main_tables([run], run.results) if table.key == "path"]
    assert [[cell.best for cell in row.cells] for row in path.rows] == [
        [False, False],
        [False, False],
        [False, False],
        [False, False],
    ]
    assert [path.judgements[name].best for name in metrics[1:]] == ["ours-geometric"] * 2
    assert path.rows[0].cells[0].value == 0.46
    assert not path.rows[0].cells[0].shade
    assert "not ranked: it is better than the captured images" in path.rows[0].cells[0].hint
    assert (
        "Not ranked: No Blending in reprojection, No Blending in E_warp, which is better than the "
        "captured images" in " ".join(path.notes)
    )
    assert all(leader.judgement.undecided for leader in leaders([path], metrics))


def test_where_test_views_are_sources_the_caption_says_so(tmp_path):
    """Left out of its own rendering only is not held out; a protocol whose sources are no test
    views has no such sentence.
    """
    run = read_run(write_run(tmp_path / "run", SMALL))
    two = replace(run.protocol, views=replace(run.protocol.views, test=("cam00", "cam03")))
    apart = replace(two, views=replace(two.views, sources=("cam01", "cam02")))
    said = {
        name: "excluded from its own rendering only"
        in " ".join(main_tables([replace(run, protocol=protocol)], run.results)[0].notes)
        for name, protocol in {"one": run.protocol, "two": two, "apart": apart}.items()
    }
    assert said == {"one": False, "two": True, "apart": False}
    foreign = replace(run, protocol=two, from_sources=frozenset())
    caption = main_tables([foreign], run.results)[0].caption
    assert "source" not in caption
    mixed = main_tables([replace(foreign, from_sources=frozenset(LABELS[1:]))], run.results)[
        0
    ].caption
    assert f"K = 2 source views, except for {NAMES[LABELS[0]]}." in mixed


def test_alone_nobody_is_best(tmp_path):
    """A single method is neither marked nor shaded, for want of a comparison."""
    run = read_run(write_run(tmp_path / "run", RunShape(labels=("ours-geometric",))))
    cells = [
        cell
        for table in main_tables([run], run.results)
        for row in table.rows
        for cell in row.cells
    ]
    assert not any(cell.best or cell.shade for cell in cells)


def test_latex_escapes_every_special_character():
    """Each character that TeX obeys prints as itself; a table without rows is valid, its heads as
    the field writes them.
    """
    assert escape_latex("a_b 50% & {x} #1 $y$ ~ ^ \\") == (
        r"a\_b 50\% \& \{x\} \#1 \$y\$ \textasciitilde{} \textasciicircum{} \textbackslash{}"
    )
    table = Table("quality", "Quality", "Nothing yet.", (Column("PSNR", "dB", True),), ())
    assert "| Method | PSNR ↑ |" in to_markdown([table])
    assert "Method & PSNR $\\uparrow$" in to_latex([table])
    assert all("PSNR in dB." in text for text in (to_markdown([table]), to_latex([table])))


def test_latex_is_balanced(report):
    """Every environment is closed, every row of a tabular has as many cells as columns."""
    text = (report / "tables.tex").read_text(encoding="utf-8")
    assert re.findall(r"\\begin\{(\w+)\}", text).count("table") == text.count(r"\end{table}")
    for columns, body in re.findall(
        r"\\begin\{tabular\}\{(l+c*)\}(.*?)\\end\{tabular\}", text, re.DOTALL
    ):
        rows = [line for line in body.splitlines() if line.endswith(r"\\")]
        assert {len(re.findall(r"(?<!\\)&", row)) for row in rows} == {len(columns) - 1}
    assert re.search(r"\\cellcolor\[rgb\]\{0\.750, 0\.750, 1\}\\textbf\{", text)


def test_published_rows_stand_beside_their_own_dataset_only():
    """DyNeRF has the paper's rows and digits, a demo room none; the packaged tables are whole."""
    counts = Counter(value.table for value in published_values() if value.table)
    assert counts == {"quality": 60, "consistency": 60, "ablation": 20, "timing": 6}
    values = [
        value
        for value in published_values()
        if (value.protocol, value.table) == ("dynerf", "quality")
    ]
    rows = published_rows(values, ("PSNR", "PSNR_cc"))
    assert [row.name for row in rows][-1] == "Ours (paper)"
    assert [cell.text for cell in rows[-1].cells] == ["31.17", "not reported"]
    assert {row.kind for row in rows} == {"published"}
    assert paper_beside("quality", "Demo room", ("PSNR",), []) == ((), [])


def test_times_leave_out_the_first_frame(whole_run):
    """Median and 95th percentile are over all frames but each view's first, and the total is the
    sum of the stages.
    """
    table = timing_table(read_run(whole_run))
    assert [column.name for column in table.columns] == ["splat", "blend", "total"]
    assert [cell.shown for cell in table.rows[0].cells] == [
        "11.0 (12.0)",
        "22.0 (24.0)",
        "33.0 (36.0)",
    ]
    assert "K = 2, 64 × 48, 2 threads" in table.caption


def test_frames_of_others_have_no_times(tmp_path):
    """Frames that came without a record of their making say so instead of a time."""
    run = write_run(tmp_path / "run")
    for record in (run / "renders" / "no-blending").rglob("job.json"):
        record.unlink()
    assert timing_table(read_run(run)).footnote == "–: no times recorded."


@pytest.mark.slow
def test_a_paper_chooses_its_columns(tmp_path):
    """One table of the columns named, in their order, from whatever tables; its notes say nothing
    of any other column.
    """
    run = write_run(tmp_path / "run")
    measured = read_run(run)
    (table,) = main_tables([measured], measured.results, ("TCC", "PSNR"))
    assert [column.name for column in table.columns] == ["TCC", "PSNR"]
    quality, consistency = main_tables([measured], measured.results)[:2]
    for at, (whole, name) in enumerate(((consistency, "TCC"), (quality, "PSNR"))):
        place = [column.name for column in whole.columns].index(name)
        assert [row.cells[at] for row in table.rows if row.competes] == [
            row.cells[place] for row in whole.rows if row.competes
        ]
    assert "SDV" not in " ".join(table.notes)
    assert len(set(table.notes)) == len(table.notes)
    with pytest.raises(ResultsError, match=r"PSNRR was not measured; .*did you mean PSNR"):
        main_tables([measured], measured.results, ("PSNRR",))
    report = write_report(
        [run], tmp_path / "report", with_figures=False, columns=("TCC", "PSNR")
    ).parent
    assert "Method & TCC $\\uparrow$ & PSNR $\\uparrow$" in (report / "tables.tex").read_text(
        encoding="utf-8"
    )
    caption = re.search(r"\\caption\{(.*)\}", (report / "tables.tex").read_text(encoding="utf-8"))[
        1
    ]
    assert "Not ranked" not in caption
    assert len(caption) < 300
    columns = {
        row["column"] for row in csv.DictReader((report / "tables.csv").open(encoding="utf-8"))
    }
    assert columns > {"TCC", "PSNR"}


@pytest.mark.parametrize(
    ("metric", "value", "half_width", "text"),
    [
        ("PSNR", 31.17, 0.2149, "0.21"),
        ("SSIM", 0.935, 0.00021, "0.0002"),
        ("STED", 2796.4, 31.4, "31"),
        ("STED", 68.76, 3.0, "3.00"),
        ("PSNR", 31.17, 0.0, "0"),
    ],
)
def test_intervals_have_the_digits_of_their_values(metric, value, half_width, text):
    """A half width has the decimals of its value, or its first digit where those would
    print zero.
    """
    assert format_half_width(value, half_width, METRICS[metric].decimals) == text


def test_intervals_stand_in_every_format(whole_run, report):
    """Each cell of the main tables has its interval: behind ± where people read, as bounds in the
    CSV.
    """
    results, labels = Results.read(whole_run), {name: label for label, name in NAMES.items()}
    main = [
        row
        for row in csv.DictReader((report / "tables.csv").open(encoding="utf-8"))
        if row["table"] == "quality"
    ]
    page = PageReader((report / "index.html").read_text(encoding="utf-8"))
    markdown, latex = (
        (report / f"tables.{kind}").read_text(encoding="utf-8") for kind in ("md", "tex")
    )
    assert len(main) == len(LABELS) * 5
    for row in main:
        interval = intervals(results, row["column"], "Demo room")[labels[row["method"]]]
        assert (float(row["lo"]), float(row["hi"])) == (interval.low, interval.high)
        assert row["note"] == interval.note
        assert interval.note.startswith("given this scene, these 2 views")
        half = format_half_width(
            interval.value, interval.half_width, METRICS[row["column"]].decimals
        )
        half += SHORT * interval.is_short
        bold = row["best"] == "True"
        assert f"± {half}" in page.texts
        assert (
            f"| {'**' if bold else ''}{row['shown']}{'**' if bold else ''} ± {half} |" in markdown
        )
        spread = rf"$\pm$ {half.removesuffix(SHORT)}"
        spread = rf"\textcolor{{gray}}{{{spread}$\dagger$}}" if interval.is_short else spread
        assert rf"{row['shown']}{'}' if bold else ''} {{\scriptsize {spread}}}" in latex
    bold_means = (
        "Bold: best, or not significantly worse (paired, 95 % for all methods and metrics "
        "together)."
    )
    for said in ("given this scene, these 2 views.", bold_means):
        assert said in markdown
        assert said.replace("%", r"\%") in latex
        assert any(said in text for text in page.texts)


def write_tied_run(root: Path) -> Path:
    """A run in which the first two methods differ by noise on views that differ a lot, and the
    third is a little worse.
    """
    views, frames = tuple(f"cam{view:02}" for view in range(6)), 12
    write_run(root, RunShape(views, Frames(2, frames), 32, 32, 0, metrics=("PSNR",)))
    found, random = Results.read(root), np.random.default_rng(4)
    shared = np.repeat(30.0 + 3.0 * random.standard_normal(len(views)), frames)
    offsets = np.repeat([0.0, 0.0, -0.5], len(shared))
    values = np.tile(shared, 3) + offsets + 0.2 * random.standard_normal(len(offsets))
    Results(found.table.assign(value=values), found.provenance).write(root)
    return root


def test_ties_are_bold_together(tmp_path):
    """What cannot be told from the best is bold like it, though it prints fewer decibels."""
    run = read_run(write_tied_run(tmp_path / "run"))
    (table,) = main_tables([run], run.results)
    cells = {row.name: row.cells[0] for row in table.rows}
    assert {name for name, cell in cells.items() if cell.best} == {
        NAMES["no-blending"],
        NAMES["ours-geometric"],
    }
    assert len({cells[NAMES[label]].text for label in LABELS}) == 3


def test_what_has_no_interval_says_why(tmp_path):
    """With one frame nothing could be compared, so nothing is bold, no cell has bounds, and
    caption, page and CSV say why.
    """
    shape = RunShape(frames=Frames(0, 1), metrics=("PSNR", "SSIM"), poses=0)
    report = write_report([write_run(tmp_path / "run", shape)], with_figures=False).parent
    markdown = (report / "tables.md").read_text(encoding="utf-8")
    assert "No interval for PSNR, SSIM: 1 frame; an interval needs 2." in markdown
    assert (
        "Nothing is bold in PSNR, SSIM: nothing could be compared (1 frame; an interval needs 2)."
        in markdown
    )
    assert "±" not in markdown
    assert 'title="no interval: 1 frame; an interval needs 2"' in (report / "index.html").read_text(
        encoding="utf-8"
    )
    main = [
        row
        for row in csv.DictReader((report / "tables.csv").open(encoding="utf-8"))
        if row["table"] == "quality"
    ]
    assert {(row["lo"], row["hi"], row["note"]) for row in main} == {
        ("", "", "no interval: 1 frame; an interval needs 2")
    }
    assert not any(row["best"] == "True" for row in main)


def test_a_method_measured_on_other_frames_is_not_called_worse_or_equal(tmp_path):
    """A rival that lacks a frame is neither bold nor silently dropped: its cell says why it was not
    compared.
    """
    root = write_tied_run(tmp_path / "run")
    found = Results.read(root)
    gone = (found.table["method"] == "no-blending") & (found.table["frame"] == 5)
    Results(found.table[~gone], found.provenance).write(root)
    run = read_run(root)
    cells = {row.name: row.cells[0] for row in main_tables([run], run.results)[0].rows}
    other = cells[NAMES["no-blending"]]
    assert other.spread
    assert "not ranked: it was measured on other views or frames" in other.hint
    assert (cells[NAMES["ours-geometric"]].best, other.best, other.shade) == (True, False, 0.0)


def test_where_the_error_varies_adds_up(tmp_path):
    """The shares of views, time and rest are those of the L1 matrix and add up to the whole; one
    frame has no such table.
    """
    shape = RunShape(views=("cam00", "cam01"), metrics=("PSNR", "L1"), poses=0)
    run = read_run(write_run(tmp_path / "run", shape))
    table = decomposition_table(run)
    assert table is not None
    for row in table.rows:
        assert sum(cell.value for cell in row.cells[1:]) == pytest.approx(100)
    l1 = (
        run.results.table.query("metric == 'L1'")
        .groupby(["method", "variant"], sort=False)["value"]
        .mean()
    )
    assert [row.cells[0].value for row in table.rows] == pytest.approx(list(l1))
    assert (
        decomposition_table(
            read_run(write_run(tmp_path / "one", replace(shape, frames=Frames(0, 1))))
        )
        is None
    )
