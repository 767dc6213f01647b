"""Tables as other programs read them: LaTeX that compiles, a workbook that pandas and Excel
open.
"""

import csv
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from ggvs_eval.errors import ResultsError
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.protocol import Frames
from ggvs_eval.reports.model.measured import read_run
from ggvs_eval.reports.model.table import Cell, Column, Row, Table
from ggvs_eval.reports.report import write_report
from ggvs_eval.reports.tables.report_tables import main_tables
from ggvs_eval.reports.tables.reproduction import paper_tables, reproduce
from ggvs_eval.reports.tables.table_formats import copyable, to_csv, to_latex, write_excel
from ggvs_eval.reports.tables.verdict import evaluate_verdict
from ggvs_eval.reports.tables_of_runs import scores_text, tables_of_runs
from helpers.command_line import refusal
from helpers.refusals import refused
from helpers.run_folders import RunShape, write_run

ENGINE = next(
    filter(None, map(shutil.which, ("pdflatex", "lualatex", "xelatex", "tectonic"))), None
)
NASTY = "_100%_ & $x^2$ {y} \\z #1 ~ < > ± − ∞"
MANY = 60  # more tables than LaTeX holds back before it has to place one
PACKAGES = ("booktabs", "xcolor", "graphicx")


@pytest.fixture(scope="module")
def nasty_run(tmp_path_factory) -> Path:
    """A whole run on DyNeRF by its name, with a method whose name is full of TeX's characters;
    nobody changes it.
    """
    names = (
        ("no-blending", NASTY),
        ("ours-geometric", "GGVS (online)"),
        ("ours-geometric+no-temporal", "Without"),
    )
    return write_run(
        tmp_path_factory.mktemp("files") / "run", RunShape(dataset="DyNeRF", names=names)
    )


@pytest.fixture(scope="module")
def report(nasty_run) -> Path:
    """Folder of its report."""
    return write_report([nasty_run], with_figures=False).parent


def compile_latex(body: str, folder: Path) -> str:
    """Log of a document that holds this; fails the test where the engine stops."""
    assert ENGINE is not None
    packages = "\\usepackage{booktabs}\\usepackage[table]{xcolor}\\usepackage{graphicx}"
    text = f"\\documentclass{{article}}{packages}\\begin{{document}}{body}\\end{{document}}"
    (folder / "paper.tex").write_text(text, encoding="utf-8")
    options = [] if ENGINE.endswith("tectonic") else ["-interaction=nonstopmode", "-halt-on-error"]
    done = subprocess.run(
        [ENGINE, *options, "paper.tex"],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
        errors="replace",
    )
    assert done.returncode == 0, done.stdout[-2000:]
    assert (folder / "paper.pdf").stat().st_size > 1000
    return done.stdout


@pytest.mark.skipif(
    ENGINE is None,
    reason="no LaTeX engine; apt-get install texlive-latex-base texlive-latex-recommended",
)
def test_latex_compiles_and_fits_the_page(report, tmp_path):
    """All tables of a report compile in a plain article with the packages that their head names,
    and stay in the margins.
    """
    for name in ("tables.tex", "reproduction.tex"):
        shutil.copy(report / name, tmp_path)
        assert all(
            re.search(rf"% \\usepackage(\[\w+\])?\{{{package}\}}", (report / name).read_text())
            for package in PACKAGES
        )
    log = compile_latex(r"\input{tables.tex}\clearpage\input{reproduction.tex}", tmp_path)
    assert "Overfull" not in log
    assert "Missing character" not in log


def test_the_papers_values_are_shaded_as_the_paper_shades_them(nasty_run):
    """Of the PSNR on DyNeRF the best is bold and full blue, 29.51 in proportion, the worst two
    white; ours stand below each.
    """
    table = next(
        table
        for table in paper_tables(reproduce([read_run(nasty_run)]))
        if (table.key, table.dataset) == QUALITY
    )
    assert [row.name for row in table.rows[-2:]] == ["Ours (paper)", "Ours, this run"]
    assert [cell.text for cell in table.rows[-1].cells] == ["data absent"] * 4
    psnr = {row.name.removesuffix(" (paper)"): row.cells[0] for row in table.rows[::2]}
    above = 2 * (29.51 - 16.97) / (31.17 - 16.97) - 1
    assert psnr["ENeRF"].shade == pytest.approx(above / (2 * (1 - above) + 1))
    assert (psnr["Ours"].shade, psnr["Ours"].best, psnr["FWD"].shade, psnr["IBRNet"].shade) == (
        1.0,
        True,
        0.0,
        0.0,
    )
    assert r"\cellcolor[rgb]{0.750, 0.750, 1}\textbf{\textcolor{gray}{31.17}}" in to_latex([table])


QUALITY = ("reproduction-quality", "DyNeRF")


def test_workbook_holds_the_tables_numbers(report):
    """Every number is read back to Excel's 16 digits, shaded and bold as in the page; what lies in
    the CSV lies in it too.
    """
    pytest.importorskip("openpyxl", reason="no openpyxl, by which pandas writes workbooks")
    sheets = pd.read_excel(report / "tables.xlsx", sheet_name=None)
    lines = pd.read_csv(report / "tables.csv")
    quality = lines[
        (lines["table"] == "quality") & (lines["column"] == "PSNR") & (lines["kind"] != "published")
    ]
    found = sheets["quality DyNeRF"]
    assert found["PSNR (dB)"].iloc[: len(quality)].tolist() == pytest.approx(
        quality["value"].tolist(), rel=1e-14
    )
    assert found["Method"].iloc[0] == NASTY
    assert len(sheets["values"]) == len(lines)
    assert len(sheets["reproduction"]) == 146
    import openpyxl

    place = openpyxl.load_workbook(report / "tables.xlsx")["quality DyNeRF"]
    best = next(row for row in place.iter_rows(min_row=2) if row[0].value == "Without")
    assert (best[1].font.bold, best[1].fill.fgColor.rgb, best[1].number_format.split('"')[0]) == (
        True,
        "FFBFBFFF",
        "0.00",
    )


def test_latex_explains_only_the_marks_that_a_table_has():
    """A table without shades, bold or published rows has no line on them; a grey reference row is
    not a published one.
    """
    plain = (Row("a", (Cell("1", 1.0),)), Row("Ceiling", (Cell("2", 2.0),), "reference"))
    marked = (
        Row("a", (Cell("1", 1.0, True, 1.0),)),
        Row("b (paper)", (Cell("2", 2.0),), "published"),
    )
    for rows, wanted in ((plain, []), (marked, ["Blue", "Bold", "Grey"])):
        table = Table("t", "T", "", (Column("PSNR"),), rows)
        for text in (to_latex([table]), copyable(table)["latex"][0]):
            assert re.findall(r"^% (Blue|Bold|Grey)", text, re.MULTILINE) == wanted


def test_no_cell_of_a_csv_is_a_formula():
    """A data set, method or note that begins as a formula has an apostrophe before it; numbers have
    none.
    """
    cells = (Cell("-0.5", -0.5, low=-1.0, high=0.0, note="@note"), Cell("+cmd|' /C calc'!A0"))
    table = Table(
        "t", "T", "", (Column("PSNR"), Column("=x")), (Row('=HYPERLINK("a")', cells),), "-data set"
    )
    for line in csv.reader(to_csv([(None, [table])]).splitlines()):
        assert not any(re.match(r"[=+@\t\r]|-[^\d]", cell) for cell in line), line
    assert "-0.5,-1.0,0.0,-0.5" in to_csv([(None, [table])])


def test_workbook_takes_names_literally(tmp_path):
    """A method called like a formula stays a name, sheets of one name get two, 1,535 is a number;
    equal tables, equal bytes.
    """
    openpyxl = pytest.importorskip(
        "openpyxl", reason="no openpyxl, by which pandas writes workbooks"
    )
    table = Table(
        "a/b*c",
        "T",
        "",
        (Column("PSNR"),),
        (Row("=1+1", (Cell("not computed: why"),)),),
        "a very long name of a data set",
    )
    first = write_excel([table, table], {"values": "a,b\n=2+2,1\n"}, tmp_path / "a.xlsx")
    second = write_excel([table, table], {"values": "a,b\n=2+2,1\n"}, tmp_path / "b.xlsx")
    sheets = pd.read_excel(first, sheet_name=None)
    assert len(sheets) == 3
    assert [sheet.iloc[0].tolist() for sheet in sheets.values()] == [
        ["=1+1", "not computed: why"]
    ] * 2 + [["=2+2", 1]]
    assert first.read_bytes() == second.read_bytes()
    numbers = Table("t", "T", "", (Column("images used"),), (Row("a", (Cell("1,535", 1535.0),)),))
    place = openpyxl.load_workbook(write_excel([numbers], {}, tmp_path / "a.xlsx"))["t"].cell(2, 2)
    assert (place.value, place.number_format) == (1535, "#,##0")


def test_a_table_for_a_paper_is_of_stored_results_alone(nasty_run, tmp_path, capsys):
    """The chosen columns in their order, without a frame of the run, by one line of terms; what
    changes a number stays below.
    """
    run = tmp_path / "run"
    shutil.copytree(nasty_run, run, ignore=shutil.ignore_patterns("truth", "renders", "path"))
    run_command(["table", str(run), "--columns", "SSIM", "PSNR"])
    shown = capsys.readouterr().out
    assert "| Method | SSIM ↑ | PSNR ↑ |" in shown
    protocol = read_run(nasty_run).protocol
    assert f"Mean over 4 frames of 2 views, K = 2; protocol tiny, {protocol.sha256[:8]}." in shown
    assert "PSNR in dB." in shown
    run_command(["table", str(run), "--columns", "SSIM", "PSNR", "--notes"])
    assert len(capsys.readouterr().out) > len(shown)
    run_command(["table", str(run), "--columns", "PSNR", "--to", "csv"])
    assert {line["column"] for line in csv.DictReader(capsys.readouterr().out.splitlines())} == {
        "PSNR"
    }
    assert refusal("table", str(run), "--columns", "PSNRR").endswith("did you mean PSNR?")


def test_several_scenes_are_columns_beside_their_mean(tmp_path):
    """A table per metric: each scene's value, and the mean of the scenes last; another protocol is
    refused.
    """
    metrics = ("PSNR", "LPIPS")
    shapes = [RunShape(scene=scene, content=scene, metrics=metrics) for scene in ("fern", "flower")]
    roots = [write_run(tmp_path / shape.scene, shape) for shape in shapes]
    lines = list(csv.DictReader(tables_of_runs(roots, metrics, "csv").splitlines()))
    assert [(line["table"], line["column"]) for line in lines[:3]] == [
        ("PSNR", "fern"),
        ("PSNR", "flower"),
        ("PSNR", "Mean"),
    ]
    values = [float(line["value"]) for line in lines if line["table"] == "PSNR"]
    for fern, flower, mean in zip(values[::3], values[1::3], values[2::3], strict=True):
        assert mean == pytest.approx((fern + flower) / 2, abs=1e-12)
    write_run(tmp_path / "other", RunShape(scene="other", k=3))
    with refused(ResultsError, "runs of one protocol", "cannot share a table"):
        tables_of_runs([roots[0], tmp_path / "other"], [], "csv")


def test_code_in_captions_is_code_in_latex(nasty_run):
    """A code span becomes typewriter text, its special characters escaped; a backtick would open a
    quotation.
    """
    run = read_run(nasty_run)
    caption = "Made by `ggvs-eval sweep a_b`, 50 % of it"
    table = replace(main_tables([run], run.results)[0], caption=caption, notes=("see `K`",))
    text = to_latex([table])
    assert r"Made by \texttt{ggvs-eval sweep a\_b}, 50 \% of it" in text
    assert r"see \texttt{K}" in text
    assert "`" not in text.partition(r"\begin{table}")[2]


def test_score_prints_what_the_page_judges(tmp_path, monkeypatch):
    """The headline, rows from the best down with their intervals, stars where the page is bold;
    narrow terminals get blocks.
    """
    run = write_run(tmp_path / "run", RunShape(frames=Frames(0, 40), dataset="DyNeRF"))
    measured = read_run(run)
    tables = main_tables([measured], measured.results, with_grey=False)
    verdict = evaluate_verdict([measured], measured.results, tables)
    monkeypatch.setenv("COLUMNS", "1000")
    headline, names, *rows, _ = scores_text(run).splitlines()
    assert headline == f"{verdict.headline}. {verdict.margin}"
    assert [row.split()[0] for row in rows] == [
        one.label for one in (*verdict.contenders, *verdict.parts)
    ]
    for line in rows:
        cells = [
            cell
            for table in tables
            for row in table.rows
            if row.label == line.split()[0]
            for cell in row.cells
        ]
        assert line.count("*") == sum(cell.best for cell in cells)
        assert all(cell.spread in line for cell in cells)
    monkeypatch.setenv("COLUMNS", "50")
    blocks = scores_text(run).splitlines()[1:]
    assert max(map(len, blocks)) <= 50
    assert " ".join(blocks).split().count(rows[0].split()[0]) > 1
    assert names.split() == [
        word for line in blocks if line.startswith("  ") for word in line.split()
    ]
