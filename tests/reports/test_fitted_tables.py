"""Tables of fitted methods: costs out of the records of jobs, the spread over seeds, the price of being online."""

import csv

import pytest

from ggvs_eval.reports.model.measured import METHODS_FILE, read_run
from ggvs_eval.reports.run_groups import read_groups
from ggvs_eval.reports.tables.fitted import fitted_tables, price_tables
from ggvs_eval.reports.tables.table_formats import to_csv, to_latex, to_markdown
from ggvs_eval.results import Results
from ggvs_eval.run_folder import read_json, write_json
from ggvs_eval.statistics.paired import compare
from helpers.run_folders import RunShape, make_fitted, write_run

FITTED, SEED = "fwd", "fwd+seed=1"


@pytest.fixture(scope="module")
def fitted_run(tmp_path_factory):
    """A run of ours and of a fitted method by two seeds, two folds of one view each."""
    labels = ("ours-geometric", FITTED, SEED)
    names = (("ours-geometric", "Ours"), (FITTED, "4DGS"), (SEED, "4DGS, seed=1"))
    shape = RunShape(labels=labels, names=names, metrics=("PSNR", "TCC", "STED"), poses=0)
    root = write_run(tmp_path_factory.mktemp("run") / "run", shape)
    write_json(root / METHODS_FILE, read_json(root / METHODS_FILE) | {"ours": ["ours-geometric"]})
    return make_fitted(root, (FITTED, SEED))


def cells(table, name: str) -> dict[str, str]:
    """Head -> what is shown of a method."""
    row = next(row for row in table.rows if row.name == name)
    return {column.name: cell.shown for column, cell in zip(table.columns, row.cells, strict=True)}


def test_costs_of_every_method(fitted_run):
    """Of a fit: cameras, look-ahead, mean seconds per frame over the folds, machine, megabytes, seeds; of ours what it has."""
    costs, _ = fitted_tables(read_run(fitted_run))
    rendering = cells(costs, "Ours")["rendering"]
    assert cells(costs, "4DGS") == {
        **{"cameras used": "3 of 5", "look-ahead": "sequence", "fitting": "15.00", "fitted on": "2 threads, a processor"},
        **{"rendering": rendering, "size": "2.000", "seeds": "2"},
    }
    assert float(rendering) == pytest.approx(33.0)  # median of 30, 33, 36 ms
    ours = cells(costs, "Ours")
    assert (ours["cameras used"], ours["look-ahead"], ours["fitting"]) == ("2 of 5", "0", "not fitted")


def test_other_seeds_stand_in_the_spread_alone(fitted_run):
    """Rows, pictures and ranks show the first seed; the spread is the largest minus the smallest number."""
    measured = read_run(fitted_run)
    assert measured.labels == ("ours-geometric", FITTED)
    assert SEED not in {
        f"{m}+{v}" for m, v in zip(measured.results.table["method"], measured.results.table["variant"], strict=True)
    }
    _, spread = fitted_tables(measured)
    summary = Results.read(fitted_run).summary().droplevel("dataset")["PSNR"]
    (row,) = spread.rows
    assert row.cells[0].value == pytest.approx(abs(summary[("fwd", "")] - summary[("fwd", "seed=1")]))
    assert row.cells[0].note == ", ".join(f"{summary[('fwd', variant)]:.2f}" for variant in ("", "seed=1"))


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


def test_the_tables_are_in_every_format(fitted_run):
    """Page, Markdown, CSV and LaTeX."""
    from ggvs_eval.reports.page.page import render_page

    (group,) = read_groups([fitted_run])
    lines = list(csv.DictReader(to_csv([(group.protocol, group.all_tables)]).splitlines()))
    fitting = next(line for line in lines if (line["table"], line["method"], line["column"]) == ("costs", "4DGS", "fitting"))
    assert float(fitting["value"]) == 15.0
    assert any(line["table"] == "price" and line["lo"] and line["hi"] for line in lines)
    page = render_page([group])
    assert "4K4D has no row of ours: it wants foreground masks" in page
    for text in (to_markdown(group.all_tables), to_latex(group.all_tables), page):
        for title in ("Price of being online", "What each method sees and costs", "Spread over seeds"):
            assert title in text


def test_runs_without_fitted_methods_show_none_of_it(tmp_path):
    """No table more."""
    (group,) = read_groups([write_run(tmp_path / "run", RunShape(poses=0))])
    assert group.price == ()
    assert group.sections[0].fitted == ()
    assert not {"costs", "seeds", "price"} & {table.key for table in group.all_tables}
