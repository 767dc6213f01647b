"""A report is kept while its runs, its code and all of its files are as they were."""

import socket
from importlib.util import find_spec

import pytest

from ggvs_eval.pipelines.run.evaluate import report
from ggvs_eval.reports.tables import table_formats
from helpers.run_folders import RunShape, write_run

SMALL = RunShape(views=("cam00",), metrics=("PSNR", "TCC"), poses=0)


@pytest.mark.slow
def test_every_file_that_is_lost_or_changed_comes_back(tmp_path):
    """The page and each table, deleted in turn; nothing is written where nothing is missing."""
    run = write_run(tmp_path / "run", SMALL)
    folder = report([run], with_figures=False).parent
    files = {file: file.read_bytes() for file in folder.iterdir() if not file.name.startswith(".")}
    assert {"index.html", "tables.md", "tables.tex", "tables.csv", "reproduction.csv"} <= {
        file.name for file in files
    }
    page = (folder / "index.html").stat().st_mtime_ns
    report([run], with_figures=False)
    assert (folder / "index.html").stat().st_mtime_ns == page
    for lost in files:
        lost.unlink()
        report([run], with_figures=False)
        assert lost.read_bytes() == files[lost], lost
    (folder / "tables.tex").write_text("9.99")
    report([run], with_figures=False)
    assert (folder / "tables.tex").read_bytes() == files[folder / "tables.tex"]


@pytest.mark.slow
def test_a_workbook_comes_once_it_can_be_written(tmp_path, monkeypatch, capsys):
    """Where openpyxl was installed after the first report, the next one has a workbook."""
    pytest.importorskip("openpyxl")
    run = write_run(tmp_path / "run", SMALL)
    with monkeypatch.context() as without:
        without.setattr(
            table_formats.importlib.util,
            "find_spec",
            lambda name: None if name == "openpyxl" else find_spec(name),
        )
        folder = report([run], with_figures=False).parent
    assert not (folder / "tables.xlsx").exists()
    assert "openpyxl" in capsys.readouterr().err
    report([run], with_figures=False)
    assert (folder / "tables.xlsx").is_file()


def test_what_a_killed_report_left_goes(tmp_path):
    """A report that was killed leaves a folder; it neither stays nor makes the next one another."""
    run = write_run(tmp_path / "run", SMALL)
    page = report([run], with_figures=False)
    written_ns = page.stat().st_mtime_ns
    left = run / f".report.{socket.gethostname().replace('.', '-')}.4194304000.tmp"
    left.mkdir()
    (left / "index.html").touch()

    report([run], with_figures=False)

    assert not left.exists()
    assert page.stat().st_mtime_ns == written_ns
