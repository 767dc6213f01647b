"""One judgement: every place that names a best method says the same, and of methods that are equal
in truth none wins.
"""

import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.protocol import Frames
from ggvs_eval.reports.model.measured import METHODS_FILE, MeasuredRun, MetricNote, read_run
from ggvs_eval.reports.tables.compare_runs import Side, differences
from ggvs_eval.reports.tables.costs import budget_tables, price_tables
from ggvs_eval.reports.tables.report_tables import main_tables, view_tables
from ggvs_eval.reports.tables.table_formats import to_latex, to_markdown
from ggvs_eval.reports.tables.verdict import evaluate_verdict, judge_runs, leaders
from ggvs_eval.results import Results
from ggvs_eval.run_folder import read_json, write_json
from helpers.run_folders import RunShape, write_run
from helpers.tidy_tables import autoregressive, make_results, make_rows, make_spread_rows

FITS = tuple(f"4dgs+steps={steps}" for steps in (100, 200, 400, 800))
EQUALS = ("ours", *FITS)


def write_equals(
    root: Path, views: int, frames: int, metrics: tuple[str, ...] = ("PSNR",)
) -> MeasuredRun:
    """A run of ours and four ever dearer fits, without meaning in its values."""
    names = tuple(zip(EQUALS, ("GGVS (online)", *FITS), strict=True))
    cameras = tuple(f"cam{view:02}" for view in range(views))
    shape = RunShape(
        cameras, Frames(0, frames), 8, 8, 0, labels=EQUALS, names=names, metrics=metrics
    )
    write_run(root, shape, paint=lambda *_: np.full((8, 8, 3), 90, np.uint8))
    write_json(root / METHODS_FILE, read_json(root / METHODS_FILE) | {"ours": ["ours"]})
    for at, label in enumerate(FITS, start=1):
        for job in (root / "renders" / label).glob("*/job.json"):
            fit = {
                "instants": frames,
                "cameras": 3,
                "look_ahead": "sequence",
                "seed": 0,
                "size_bytes": 1,
                "seconds": 10.0 * at,
            }
            write_json(
                job, read_json(job) | {"fit": fit | {"threads": 2, "machine": "a processor"}}
            )
    return read_run(root)


def with_values(
    run: MeasuredRun, values: dict[str, np.ndarray], metric: str = "PSNR"
) -> MeasuredRun:
    """The run with these values (V, T) of a metric by method."""
    table = run.results.table.copy()
    for label, matrix in values.items():
        method, _, variant = label.partition("+")
        mine = (
            (table["method"] == method)
            & (table["variant"] == variant)
            & (table["metric"] == metric)
        )
        cells = table[mine].sort_values(["view", "frame"]).index
        table.loc[cells, "value"] = matrix.ravel()
    return replace(run, results=replace(run.results, table=table))


def winners(run: MeasuredRun) -> set[str]:
    """Places that name some method better than another, in a run of ours and fits, of one
    metric.
    """
    (table,) = main_tables([run], run.results)
    (leader,) = leaders([table])
    verdict = evaluate_verdict([run], run.results, [table])
    budgets = {each.key: each for each in budget_tables(run)}
    sides = [Side(label, label, run.results) for label in ("ours", FITS[-1])]
    (price,) = price_tables([run], run.results)
    named = {
        "judgement": bool(table.judgements["PSNR"].winner),
        "bold": sum(row.cells[0].best for row in table.rows) == 1,
        "leaders": bool(leader.judgement.winner),
        "headline": verdict.headline.endswith("is best"),
        "budget": len(budgets["budget"].rows) > 1,
        "price": any(cell.best for row in price.rows for cell in row.cells),
        "compare": any(
            one.is_significant for one in differences(*sides, run.folder.root) if not one.view
        ),
        "views": any(
            cell.best for each in view_tables(run) for row in each.rows for cell in row.cells
        ),
    }
    return {place for place, says in named.items() if says}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("frames", "correlation", "views", "sets"),
    [
        (12, 0.9, 3, 10),
        (24, 0.8, 9, 10),
        pytest.param(24, 0.0, 3, 40, marks=pytest.mark.proof),
        pytest.param(60, 0.9, 5, 40, marks=pytest.mark.proof),
    ],
)
def test_of_equal_methods_none_wins_anywhere(tmp_path, frames, correlation, views, sets):
    """Five methods equal but for correlated errors: in 5 % of data sets, and what chance adds, any
    place names one.
    """
    run, random = write_equals(tmp_path / "run", views, frames), np.random.default_rng(8)
    wrong: Counter[str] = Counter()
    for _ in range(sets):
        shared = 30.0 + random.standard_normal((views, 1))
        values = {
            label: shared + 0.3 * autoregressive(random, views, frames, correlation)
            for label in EQUALS
        }
        wrong.update(winners(with_values(run, values)))
    assert all(count <= sets / 10 for count in wrong.values()), wrong
    if frames == 12:
        assert wrong["budget"] == 0


@pytest.mark.slow
def test_every_place_says_the_same(tmp_path):
    """Winner, ties and what is too short to call are the judgement's in headline, leaders, bold,
    compare and budget.
    """
    run = write_equals(tmp_path / "run", 6, 40, ("PSNR", "SSIM", "L1", "LPIPS", "SDT", "SDV"))
    random = np.random.default_rng(2)
    ahead = {
        "PSNR": (1.0, 0.0, 0.99, -1.0, 3.0),
        "SSIM": (0, 0, 0, 0, 0),
        "L1": (0.0, 0.4, 0.4, 0.4, 0.4),
        "LPIPS": (0, 1, 2, 3, 4),
    }
    slow = 0.5 * np.linspace(-1, 1, 40)
    for metric, better in ahead.items():
        noise = {label: 0.05 * random.standard_normal((6, 40)) for label in EQUALS}
        drift = {label: slow * (metric == "L1" and label == "ours") for label in EQUALS}
        run = with_values(
            run,
            {
                label: 30 + db + noise[label] + drift[label]
                for label, db in zip(EQUALS, better, strict=True)
            },
            metric,
        )
    tables = main_tables([run], run.results)
    judgements = {name: one for table in tables for name, one in table.judgements.items()}
    labels = {row.name: row.label for table in tables for row in table.rows}
    verdict = evaluate_verdict([run], run.results, tables)
    said = {metric: name for name, metrics in verdict.others.items() for metric in metrics}
    assert (judgements["PSNR"].winner, verdict.headline) == (FITS[-1], f"{FITS[-1]} is best")
    assert judgements["L1"].undecided.startswith("clip too short")
    found = {leader.column.name: leader for leader in leaders(tables, list(judgements))}
    for metric, one in judgements.items():
        leader = found[metric]
        assert labels[leader.name] == one.best
        assert leader.judgement is one
        assert {labels[name] for name in leader.ties} == set(one.having("as good", "equal"))
        assert {labels[name] for name in leader.short} == set(one.having("too short"))
        if metric in ("SSIM", "LPIPS"):
            assert labels.get(said.get(metric)) == (one.winner or None)
        assert not {"SDT", "SDV"} & {*said, *verdict.tied}  # not within 1 dB
        for label in one.rivals if metric in ("PSNR", "L1", "SDV") else ():
            comparison = one.comparisons[label]
            half = None if comparison.high is None else comparison.high - comparison.difference
            assert comparison.outcome != "as good" or abs(comparison.difference) <= 3 * half
            sides = (Side(one.best, one.best, run.results), Side(label, label, run.results))
            told = next(
                each
                for each in differences(*sides, run.folder.root)
                if each.metric == metric and not each.view
            )
            assert not told.is_significant or comparison.outcome == "worse"
            assert not told.verdict.startswith("second better")
    for table in tables:
        for at, column in enumerate(table.columns):
            bold = {row.label for row in table.rows if row.cells[at].best}
            assert bold == set(judgements[column.name].marked)
        count = sum(cell.best for row in table.rows for cell in row.cells)
        assert (
            to_latex([table]).count(r"\textbf{") - 1
            == to_markdown([table]).count("**") // 2
            == count
        )
    budget = next(table for table in budget_tables(run) if table.key == "budget")
    assert [row.label for row in budget.rows] == ["ours", FITS[-1]]
    evenness = judgements["SDV"].unranked
    assert {FITS[0], FITS[2]} <= set(evenness)
    assert set(evenness) == set(judgements["SDT"].unranked)


def test_even_badness_wins_no_metric_of_evenness(tmp_path):
    """A method 3 dB behind is not ranked in SDT and SDV, however even, nor is one without a PSNR;
    L1 ranks both.
    """
    base = autoregressive(np.random.default_rng(4), 6, 60, 0.5) + np.arange(6.0)[:, None] + 10.0
    rows = make_spread_rows("good", base) + make_spread_rows("bad", 10.0 + 0.3 * (base - 10.0))
    rows += make_rows("good", "PSNR", 30.0 + 0.1 * base)
    notes = {
        metric: MetricNote(metric, "", False, "", "", "", "", None)
        for metric in ("SDT", "SDV", "L1")
    }
    run = replace(
        read_run(write_equals(tmp_path / "run", 3, 2).folder.root), metrics=notes, ours=frozenset()
    )
    for results in (
        make_results(rows + make_rows("bad", "PSNR", 27.0 + 0.1 * base)),
        make_results(rows),
    ):
        judgements = judge_runs([run], results)["Demo"].judgements
        for metric in ("SDT", "SDV"):
            judgement = judgements[metric]
            assert (judgement.best, judgement.winner, list(judgement.unranked)) == (
                "good",
                "",
                ["bad"],
            )
            assert "within 1 dB of the best PSNR" in judgement.unranked["bad"]
        assert judgements["L1"].unranked == {}


def test_a_certain_fault_and_a_partial_method_win_nowhere(tmp_path):
    """A fit of 40 dB trained on the test view, and one of one easy view: no headline, bold, budget,
    equal quality or price.
    """
    run, random = write_equals(tmp_path / "run", 3, 24), np.random.default_rng(4)
    ahead = dict(zip(EQUALS, (1.0, 0.0, 0.0, 9.0, 8.0), strict=True))
    run = with_values(
        run, {label: 30 + db + 0.1 * random.standard_normal((3, 24)) for label, db in ahead.items()}
    )
    table = run.results.table
    table = table[~((table["variant"] == "steps=800") & (table["view"] != "cam00"))]
    fault = [
        FITS[2],
        "room",
        "cam00",
        "test view seen",
        "certain",
        "40 dB, a perfect one has 35 dB",
        "take it out of the inputs",
    ]
    marks = {"faults": [fault], "partial": {FITS[3]: "partial in room: 1 of 3 views complete"}}
    results = Results(table, run.results.provenance | marks)
    run = replace(run, results=results)
    (main,) = main_tables([run], results)
    verdict = evaluate_verdict([run], results, [main])
    assert verdict.headline.startswith("GGVS (online) is best; ")
    assert f"{FITS[2]} was trained on the test view" in verdict.headline
    assert ": take it out of the inputs." in verdict.margin
    assert [row.label for row in main.rows if row.cells[0].best] == ["ours"]
    budgets = {each.key: each for each in budget_tables(run)}
    assert [row.label for row in budgets["budget"].rows] == ["ours"]
    assert all(
        cell.value is None for row in budgets["equal_quality"].rows for cell in row.cells[:1]
    )
    (price,) = price_tables([run], results)
    assert [row.label for row in price.rows] == list(FITS[:2])
    sides = (Side("GGVS (online)", "ours", results), Side(FITS[2], FITS[2], results))
    assert {one.verdict for one in differences(*sides, run.folder.root)} == {
        "not compared: second was trained on the test view"
    }


def test_nothing_outside_statistics_reads_a_bound_to_name_a_winner():
    """The decision is `statistics.paired.decide`'s: no report compares a bound or a p value with a
    number.
    """
    reports = Path(__file__).parents[2] / "reports"
    pattern = re.compile(
        r"\.(low|high|p_value|corrected)\b\s*[<>]|[<>]=?\s*\w+\.(low|high|p_value)\b"
    )
    allowed = {"reproduction.py"}  # whether a published number lies in an interval
    found = [
        file.name
        for file in reports.rglob("*.py")
        if pattern.search(file.read_text(encoding="utf-8"))
    ]
    assert set(found) <= allowed
