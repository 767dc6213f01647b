"""Tables of fitted methods: costs out of the records of jobs, the spread over seeds, the price of
being online.
"""

import numpy as np
import pytest

from ggvs_eval.protocol import Frames
from ggvs_eval.reports.model.measured import METHODS_FILE, read_run
from ggvs_eval.reports.model.table import Cell
from ggvs_eval.reports.report import all_tables
from ggvs_eval.reports.run_groups import read_groups
from ggvs_eval.reports.section import Report, with_sections
from ggvs_eval.reports.tables.costs import (
    _crossing,
    budget_tables,
    cost_tables,
    differences_table,
    price_tables,
)
from ggvs_eval.results import Results
from ggvs_eval.run_folder import read_json, write_json
from ggvs_eval.statistics.paired import Outcome, compare
from helpers.run_folders import RunShape, make_fitted, write_run

FITTED, SEED = "fwd", "fwd+seed=1"


@pytest.fixture(scope="module")
def fitted_run(tmp_path_factory):
    """A run of ours and of a fitted method by two seeds, two folds of one view each."""
    labels = ("ours-geometric", FITTED, SEED)
    names = (("ours-geometric", "GGVS (online)"), (FITTED, "4DGS"), (SEED, "4DGS, seed=1"))
    shape = RunShape(labels=labels, names=names, metrics=("PSNR", "TCC", "STED"), poses=0)
    root = write_run(tmp_path_factory.mktemp("run") / "run", shape)
    write_json(root / METHODS_FILE, read_json(root / METHODS_FILE) | {"ours": ["ours-geometric"]})
    return make_fitted(root, (FITTED, SEED))


def cells(table, name: str) -> dict[str, str]:
    """Head -> what is shown of a method."""
    row = next(row for row in table.rows if row.name == name)
    return {column.name: cell.shown for column, cell in zip(table.columns, row.cells, strict=True)}


def test_costs_of_every_method(fitted_run):
    """Of a fit: cameras, images, look-ahead, mean seconds over the folds, machine, megabytes,
    seeds; of ours what it has.
    """
    costs, *_ = cost_tables(read_run(fitted_run))
    rendering = cells(costs, "GGVS (online)")["rendering"]
    assert cells(costs, "4DGS") == {
        **{
            "cameras used": "3 of 5",
            "images used": "12",
            "look-ahead": "sequence",
            "fitting": "15.00",
            "whole fit": "60.00",
            "fitted on": "2 threads, a processor",
        },
        **{"rendering": rendering, "size": "2.000", "seeds": "2"},
    }
    assert float(rendering) == pytest.approx(33.0)  # median of 30, 33, 36 ms
    ours = cells(costs, "GGVS (online)")
    assert (ours["cameras used"], ours["images used"], ours["look-ahead"], ours["fitting"]) == (
        "2 of 5",
        "8",
        "0",
        "not fitted",
    )


def test_costs_of_a_run_without_fits(tmp_path):
    """What every method has: cameras, images, time and memory, and no column of fits."""
    root = write_run(tmp_path / "run", RunShape(poses=0))
    for file in root.glob("renders/ours*/*/job.json"):
        write_json(file, read_json(file) | {"peak_bytes": 640_000_000})
    (costs,) = cost_tables(read_run(root))

    assert [column.name for column in costs.columns] == [
        "cameras used",
        "images used",
        "look-ahead",
        "rendering",
        "peak memory",
    ]
    assert {cells(costs, row.name)["peak memory"] for row in costs.rows} == {"640", "not recorded"}


def test_cost_at_equal_quality_is_bounded_by_whole_fits(tmp_path):
    """A method's lengths are one row; the crossing lies between two of them, before the first, or
    nowhere.
    """
    labels = ("ours", "4dgs+steps=100", "4dgs+steps=900")
    root = write_run(
        tmp_path / "run",
        RunShape(
            labels=labels, names=tuple(zip(labels, labels, strict=True)), metrics=("PSNR",), poses=0
        ),
    )
    write_json(root / METHODS_FILE, read_json(root / METHODS_FILE) | {"ours": ["ours"]})
    make_fitted(root, labels[1:])
    measured = read_run(root)
    summary = measured.results.summary().droplevel("dataset")["PSNR"]
    first, last = summary[("4dgs", "steps=100")], summary[("4dgs", "steps=900")]
    table = next(table for table in budget_tables(measured) if table.key == "equal_quality")

    assert [row.name for row in table.rows] == ["4dgs"]
    assert table.columns[0].name == f"as ours, {summary[('ours', '')]:.2f} dB"

    def crossing(*outcomes: Outcome) -> Cell:
        return _crossing([(10.0, first, outcomes[0]), (90.0, last, outcomes[1])])

    assert crossing("as good", "better").shown == "at most 10.00"
    assert crossing("worse", "equal").shown == "at most 90.00 (more than 10.00)"
    never = crossing("worse", "worse")
    assert (never.text, never.value) == ("not reached", None)
    assert never.hint.endswith("after 90.00 s")
    assert (crossing("worse", "too short").text, crossing("too short", "better").value) == (
        "too short to call",
        None,
    )


def test_families_stand_in_the_order_of_the_run(tmp_path):
    """Equal inputs give equal tables; a family of one fit is called by the shown name without its
    steps, never by the label.
    """
    labels = ("ours", "3dgs-per-instant+steps=300", "3dgstream", "4dgs", "fwd", "ibrnet", "mvsplat")
    titles = ("GGVS (online)", "3DGS per Instant, 300 steps", *labels[2:])
    names = (("3dgs-per-instant", "3DGS per Instant"), *zip(labels, titles, strict=True))
    root = write_run(
        tmp_path / "run", RunShape(labels=labels, names=names, metrics=("PSNR",), poses=0)
    )
    write_json(root / METHODS_FILE, read_json(root / METHODS_FILE) | {"ours": ["ours"]})
    measured = read_run(make_fitted(root, labels[1:]))
    table = next(table for table in budget_tables(measured) if table.key == "equal_quality")
    assert [row.name for row in table.rows] == ["3DGS per Instant", *labels[2:]]


def test_the_winner_changes_only_where_a_longer_fit_is_certainly_better(tmp_path):
    """Under no budget ours; a fit that is 3 dB behind or no better by more than chance is left out;
    one 3 dB ahead has a line.
    """
    labels = ("ours", "4dgs+steps=100", "4dgs+steps=200", "4dgs+steps=900")
    names = tuple(zip(labels, labels, strict=True))
    root = write_run(
        tmp_path / "run",
        RunShape(frames=Frames(0, 24), labels=labels, names=names, metrics=("PSNR",), poses=0),
    )
    write_json(root / METHODS_FILE, read_json(root / METHODS_FILE) | {"ours": ["ours"]})
    make_fitted(root, labels[1:])
    for label, factor in zip(labels[1:], (1, 2, 9), strict=True):
        for job in (root / "renders" / label).glob("*/job.json"):
            record = read_json(job)
            record["fit"]["seconds"] *= factor
            write_json(job, record)
    results = Results.read(root)
    table = results.table
    of = {label: table["variant"] == label.partition("+")[2] for label in labels}
    ours = table.loc[of["ours"], "value"].to_numpy()
    for label, ahead_db in zip(labels[1:], (-3.0, 0.0, 3.0), strict=True):
        wobble = 0.2 * np.random.default_rng(1).standard_normal(len(ours))
        table.loc[of[label], "value"] = ours + ahead_db + wobble
    results.write(root)
    best = next(table for table in budget_tables(read_run(root)) if table.key == "budget")

    assert [row.name for row in best.rows] == ["ours", "4dgs+steps=900"]
    first, last = (row.cells for row in best.rows)
    assert (first[0].text, last[0].value) == ("0", 540.0)
    assert first[2].value is None
    assert last[2].value == pytest.approx(3.0, abs=0.1)
    assert last[2].low > 0


def test_other_seeds_stand_in_the_spread_alone(fitted_run):
    """Rows, pictures and ranks show the first seed; the spread is the largest minus the smallest
    number.
    """
    measured = read_run(fitted_run)
    assert measured.labels == ("ours-geometric", FITTED)
    assert SEED not in {
        f"{m}+{v}"
        for m, v in zip(
            measured.results.table["method"], measured.results.table["variant"], strict=True
        )
    }
    spread = next(table for table in cost_tables(measured) if table.key == "seeds")
    summary = Results.read(fitted_run).summary().droplevel("dataset")["PSNR"]
    (row,) = spread.rows
    assert row.cells[0].value == pytest.approx(
        abs(summary[("fwd", "")] - summary[("fwd", "seed=1")])
    )
    assert row.cells[0].note == ", ".join(
        f"{summary[('fwd', variant)]:.2f}" for variant in ("", "seed=1")
    )


def test_price_is_the_paired_difference_with_its_interval(fitted_run):
    """Fitted minus ours, as `compare` has it; what has no interval says why."""
    measured = read_run(fitted_run)
    (price,) = price_tables([measured], measured.results)
    (row,) = price.rows
    known = compare(measured.results, "PSNR", FITTED, "ours-geometric", "Demo room")
    assert (row.name, row.cells[0].value, row.cells[0].low, row.cells[0].high) == (
        *("4DGS", known.difference, known.low, known.high),
    )
    assert row.cells[0].text.startswith("+")
    assert row.cells[2].high is None
    assert row.cells[2].hint.startswith("no interval: ")
    assert [column.name for column in price.columns] == ["PSNR ↑", "TCC ↑", "STED ↓"]


def test_what_differs_by_design_is_a_table_of_its_own(fitted_run):
    """What was declared stands beside what the protocol makes the same; of other people's frames
    nothing is known.
    """
    declared = {"depth": "given", "learned from": "this capture", "not as published": "fewer steps"}
    file = fitted_run / METHODS_FILE
    before = read_json(file)
    assert differences_table(read_run(fitted_run)) is None  # scored before it was recorded
    write_json(file, before | {"declared": {FITTED: declared}})
    table = differences_table(read_run(fitted_run))
    write_json(file, before)

    assert cells(table, "4DGS") == declared
    assert set(cells(table, "GGVS (online)").values()) == {"unknown: others made it"}
    assert "cam00, cam03" in table.caption
    assert "4 frames" in table.caption
    assert table.caption.endswith("metric.")  # nothing is announced that does not follow


def test_runs_without_fitted_methods_show_none_of_it(tmp_path):
    """No price, no seeds, no time to equal quality."""
    report = with_sections(
        Report(read_groups([write_run(tmp_path / "run", RunShape(metrics=("PSNR",), poses=0))]))
    )
    assert not {"equal_quality", "budget", "seeds", "price"} & {
        table.key for table in all_tables(report, report.groups[0])
    }
