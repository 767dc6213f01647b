"""The leaderboard: numbers of many runs, without their frames."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from ggvs_eval.errors import ResultsError
from ggvs_eval.merged_results import merge_results
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.protocol import load_protocol
from ggvs_eval.reports.model.measured import read_scores
from ggvs_eval.reports.page.leaderboard import write_leaderboard
from ggvs_eval.reports.tables.report_tables import main_tables
from ggvs_eval.results import Results
from helpers.page_reader import PageReader
from helpers.refusals import refused
from helpers.run_folders import LABELS, NAMES, RunShape, write_run

SHAPE = RunShape(views=("cam00",), metrics=("PSNR", "LPIPS"), poses=0)


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> list[Path]:
    """Two scenes under one protocol and one under another, without their frames; nobody changes
    them.
    """
    root = tmp_path_factory.mktemp("runs")
    shapes = {
        "first": replace(SHAPE, scene="first"),
        "second": replace(SHAPE, scene="second", labels=LABELS[:2]),
        "far": replace(SHAPE, scene="first", k=3),
    }
    made = [write_run(root / name, shape) for name, shape in shapes.items()]
    for run in made:
        for folder in ("renders", "truth"):
            shutil.rmtree(run / folder)
    return made


def test_one_page_has_the_tables_of_all_protocols(runs, tmp_path):
    """Every number of each protocol's table is on the page, which loads nothing and says what does
    not compare.
    """
    page = write_leaderboard(runs, tmp_path / "board.html")
    read = PageReader(page.read_text(encoding="utf-8"))

    assert read.addresses == []
    for group in (runs[:2], runs[2:]):
        measured = [read_scores(run) for run in group]
        for table in main_tables(measured, merge_results([run.results for run in measured])):
            assert all(cell.shown in read.texts for row in table.rows for cell in row.cells)
    missing = f"{NAMES[LABELS[2]]} is not measured on second; it is not ranked."
    assert sum(missing in text for text in read.texts) == 1
    assert page.read_bytes() == write_leaderboard(runs, tmp_path / "again.html").read_bytes()


def test_a_method_measured_twice_on_a_scene_is_refused(runs, tmp_path):
    """Which of two values would be shown is chance."""
    again = shutil.copytree(runs[0], tmp_path / "again")
    with refused(ResultsError, LABELS[0], "first", "again", "leave out"):
        write_leaderboard([runs[0], again], tmp_path / "board.html")
    with refused(ResultsError, "one run folder", "got none"):
        write_leaderboard([], tmp_path / "board.html")


def test_the_command_writes_a_leaderboard(runs, tmp_path, capsys):
    """`report --to leaderboard` prints the page that it wrote."""
    run_command(
        ["report", *map(str, runs), "--to", "leaderboard", "--out", str(tmp_path / "board.html")]
    )
    assert capsys.readouterr().out.strip() == str(tmp_path / "board.html")
    assert "Leaderboard" in (tmp_path / "board.html").read_text(encoding="utf-8")


def test_published_rows_stand_on_the_page_under_their_own_protocol_alone(tmp_path):
    """Of two scored runs, the one under n3v_4dgs has 4DGS's row in grey and its source below; the
    other has neither.
    """
    run = write_run(
        tmp_path / "flame_steak", replace(SHAPE, scene="flame_steak", dataset="Neural 3D Video")
    )
    other = write_leaderboard([run], tmp_path / "other.html").read_text(encoding="utf-8")
    protocol = load_protocol("n3v_4dgs")
    protocol = replace(protocol, measurement=replace(protocol.measurement, metrics=SHAPE.metrics))
    (run / "protocol.toml").write_text(protocol.to_toml())
    results = Results.read(run)
    replace(results, provenance={**results.provenance, "protocol_sha256": protocol.sha256}).write(
        run
    )
    page = write_leaderboard([run], tmp_path / "board.html").read_text(encoding="utf-8")

    assert '<tr class="published grey"' in page
    assert "4DGS (published, mean of 6 scenes)" in page
    assert (
        "Grey: Wu et al., 4D Gaussian Splatting for Real-Time Dynamic Scene Rendering, CVPR 2024"
        in page
    )
    assert "published grey" not in other
    assert "4DGS" not in other
