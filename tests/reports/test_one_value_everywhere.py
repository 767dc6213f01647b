"""One law of all formats: a value has the same digits, the same words and the same bold wherever it
is shown.
"""

import csv
import html
import re
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.reports.model.table import Table
from ggvs_eval.reports.report import all_tables, write_report
from ggvs_eval.reports.run_groups import read_groups
from ggvs_eval.reports.section import Report, with_sections
from ggvs_eval.reports.tables.table_formats import LATEX_SPECIAL
from ggvs_eval.results import Results
from ggvs_eval.run_folder import read_json, write_json
from helpers.run_folders import RunShape, make_fitted, write_run

Shown = list[tuple[str, bool]]  # what stands in the cells of a row, and whether it is bold
Rows = dict[str, Shown]
LABELS = ("no-blending", "ours-geometric", "4dgs", "4dgs+seed=1", "theirs")
NAMES = (
    ("no-blending", "No Blending"),
    ("ours-geometric", "GGVS (online) & co_1"),
    ("4dgs", "4DGS"),
    ("4dgs+seed=1", "4DGS, seed=1"),
)
METRICS = ("PSNR", "SSIM", "LPIPS", "TCC", "STED", "SDT", "SDV", "FLIP", "reprojection", "E_warp")
REFERENCES = [
    {
        **{"group": "quality", "name": "Ceiling", "note": "of a codec."},
        **{"values": {"PSNR": 40.256, "SSIM": 0.99}, "bounds": {"PSNR": "at most"}},
    },
    {
        **{"group": "consistency", "name": "Ceiling", "note": "of a codec."},
        **{
            "values": {"TCC": 0.9461, "STED": 0.33652},
            "bounds": {"TCC": "at most", "STED": "at least"},
        },
    },
    {
        "group": "path",
        "name": "Captured images",
        "note": "real.",
        "values": {"reprojection": 0.9, "E_warp": "no such path"},
    },
]


@pytest.fixture(scope="module")
def everything_run(tmp_path_factory) -> Path:
    """A run with everything that a cell can be: bounds, percentiles, counts, prices, absences,
    infinity, what is not ranked.
    """
    shape = RunShape(metrics=METRICS, labels=LABELS, names=NAMES, poses=0)
    root = write_run(
        tmp_path_factory.mktemp("law") / "run", shape, not_computed={"FLIP": "wants flip-evaluator"}
    )
    write_json(root / "references.json", REFERENCES)
    write_json(
        root / "methods.json", read_json(root / "methods.json") | {"ours": ["ours-geometric"]}
    )
    make_fitted(root, LABELS[2:4])
    for view in shape.views:
        (root / "renders" / "theirs" / view / "job.json").unlink()
    found = Results.read(root)
    table = found.table
    along = (
        table["metric"].isin(["reprojection", "E_warp"])
        & (table["view"] == "cam00")
        & (table["frame"] == 2)
    )
    table = table[~table["metric"].isin(["reprojection", "E_warp"]) | along].copy()
    table.loc[table["metric"].isin(["reprojection", "E_warp"]), ["view", "frame"]] = ["path", -1]
    table.loc[(table["metric"] == "PSNR") & (table["method"] == "no-blending"), "value"] = np.inf
    table = table[
        ~((table["metric"] == "SSIM") & (table["method"] == "theirs") & (table["view"] == "cam03"))
    ]
    absent = [["SSIM", "theirs", "room", "cam03", "in no frame"]]
    Results(table, found.provenance | {"absent": absent}, found.not_computed).write(root)
    return root


@pytest.fixture(scope="module")
def report(everything_run) -> Path:
    """Folder of its report."""
    return write_report([everything_run], with_figures=False).parent


@pytest.fixture(scope="module")
def tables(everything_run) -> tuple[Table, ...]:
    """The tables before they have a format."""
    report = with_sections(Report(read_groups([everything_run])))
    return tuple(all_tables(report, report.groups[0]))


def expected(table: Table) -> Rows:
    """Every cell with its interval."""
    return {
        row.name: [(f"{cell.shown} {cell.spread}".strip(), cell.best) for cell in row.cells]
        for row in table.rows
    }


def read_markdown(report: Path, table: Table) -> Rows:
    """The table of this title in ``tables.md``."""
    title = f"## {markdown(table.title)} ({markdown(table.dataset)})\n"
    part = (report / "tables.md").read_text(encoding="utf-8").split(title)[1].split("\n## ")[0]
    lines = [line for line in part.splitlines() if line.startswith("| ")][1:]
    found = {}
    for line in lines:
        name, *cells = re.split(r"(?<!\\) \| ", line[2:-2])
        bold = [re.fullmatch(r"\*\*(.*?)\*\*( ±.*)?", cell) for cell in cells]
        texts = [
            "".join(filter(None, match.groups())) if match else cell
            for match, cell in zip(bold, cells, strict=True)
        ]
        found[plain(name.strip("*"))] = [
            (plain(text.strip("*")), bool(match)) for text, match in zip(texts, bold, strict=True)
        ]
    return found


def markdown(text: str) -> str:
    return re.sub(r"([\\`*_|\[\]])", r"\\\1", text).replace("&", "&amp;")


def plain(text: str) -> str:
    return html.unescape(re.sub(r"\\(.)", r"\1", text))


def read_latex(report: Path, table: Table) -> Rows:
    """The table of this label in ``tables.tex``."""
    label = re.sub(r"[^a-z0-9-]+", "-", f"{table.key}-{table.dataset}".lower()).strip("-")
    text = (
        (report / "tables.tex")
        .read_text(encoding="utf-8")
        .split(rf"\label{{table:{label}}}")[1]
        .split(r"\bottomrule")[0]
    )
    found = {}
    for line in (
        line for line in text.split(r"\toprule")[1].splitlines()[2:] if line.endswith(r" \\")
    ):
        name, *cells = re.split(
            r"(?<!\\) & ", re.sub(r"\\cellcolor\[rgb\]\{[^}]*\}", "", line.removesuffix(r" \\"))
        )
        bold = [cell.startswith(r"\textbf{") for cell in cells]
        found[untex(name)] = list(zip(map(untex, cells), bold, strict=True))
    return found


def untex(text: str) -> str:
    """What LaTeX prints."""
    text = re.sub(r"\\textcolor\{gray\}|\\scriptsize |\\textbf", "", text)
    for character, command in LATEX_SPECIAL.items():
        if character not in "{}\\":
            text = text.replace(command, character)
    return text.replace("{", "").replace("}", "")


def read_csv(report: Path, table: Table) -> Rows:
    """The lines of the table in ``tables.csv``, which has intervals in columns of their own."""
    found: Rows = {}
    places = [
        (row, column, cell)
        for row in table.rows
        for column, cell in zip(table.columns, row.cells, strict=True)
    ]
    spreads = {(row.name, column.name): cell.spread for row, column, cell in places}
    for line in csv.DictReader((report / "tables.csv").open(encoding="utf-8")):
        if (line["table"], line["dataset"]) == (table.key, table.dataset):
            spread = spreads[line["method"], line["column"]]
            assert bool(spread) <= bool(line["lo"] and line["hi"])
            shown = line["shown"].removeprefix("'")  # before words that a spreadsheet would compute
            found.setdefault(line["method"], []).append(
                (f"{shown} {spread}".strip(), line["best"] == "True")
            )
    return found


def read_excel(report: Path, table: Table) -> Rows:
    """The sheet of the table, each number as its own format shows it."""
    openpyxl = pytest.importorskip(
        "openpyxl", reason="no openpyxl, by which pandas writes workbooks"
    )
    book = openpyxl.load_workbook(report / "tables.xlsx")
    name = re.sub(r"[\[\]:*?/\\']", "-", f"{table.key} {table.dataset}")[:31]
    found = {}
    for head, *cells in book[name].iter_rows(min_row=2):
        found[head.value] = [
            (in_format(cell.value, cell.number_format), bool(cell.font.bold)) for cell in cells
        ]
        widths = [book[name].column_dimensions[cell.column_letter].width for cell in cells]
        numbers = [isinstance(cell.value, float | int) for cell in cells]
        assert all(
            len(text) <= width
            for (text, _), width, number in zip(found[head.value], widths, numbers, strict=True)
            if number
        )  # else Excel shows hashes
    return found


def in_format(value: object, number_format: str) -> str:
    """What Excel shows: words in quotation marks, digits as in 0.00, a part of its own for what is
    negative.
    """
    if not isinstance(value, float | int):
        return str(value)
    parts = number_format.split(";")
    part, sign = (
        (parts[1], "") if value < 0 and len(parts) > 1 else (parts[0], "-" if value < 0 else "")
    )
    shown = ""
    for words, digits in re.findall(r'"([^"]*)"|((?:#,##)?0(?:\.0+)?)', part):
        comma = "," if digits.startswith("#,") else ""
        shown += (
            words if not digits else f"{sign}{abs(value):{comma}.{len(digits.partition('.')[2])}f}"
        )
    return shown


class PageTables(HTMLParser):
    """Title of a table on the page -> the rows of each table of that title."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: dict[str, list[Rows]] = {}
        self._title = self._name = ""
        self._cell: list[str] | None = None
        self._best = False
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        if values.get("role") == "region":
            self._title = values["aria-label"]
        if tag == "table":
            self.found.setdefault(self._title, []).append({})
        if tag == "td" or (tag == "th" and values.get("scope") == "row"):
            self._cell, self._best = [], "best" in (values.get("class") or "").split()

    def handle_data(self, data):
        if self._cell is not None and data.strip():
            self._cell.append(data.strip())

    def handle_endtag(self, tag):
        if tag in ("td", "th") and self._cell is not None:
            text, self._cell = " ".join(self._cell), None
            rows = self.found[self._title][-1]
            if tag == "th":
                self._name = text
                rows[text] = []
            else:
                rows[self._name].append((text, self._best))


def read_page(report: Path, table: Table) -> Rows:
    """The table of this title on the page; where there are several, the one with the most rows of
    the same.
    """
    candidates = PageTables((report / "index.html").read_text(encoding="utf-8")).found[table.title]
    names = {row.name for row in table.rows}
    return max(candidates, key=lambda rows: len(rows.keys() & names))


@pytest.mark.slow
@pytest.mark.parametrize("read", [read_page, read_markdown, read_csv, read_latex, read_excel])
def test_a_cell_is_the_same_in_every_format(read: Callable[[Path, Table], Rows], report, tables):
    """Digits, words before and behind them, intervals, words for what is absent, and bold of each
    cell of each table.
    """
    assert {table.key for table in tables} >= {
        "quality",
        "consistency",
        "path",
        "price",
        "timing",
        "costs",
        "seeds",
    }
    for table in tables:
        assert read(report, table) == expected(table), (read.__name__, table.key)


def test_the_run_has_every_kind_of_cell(tables):
    """What the law above is tested on: else it would hold of nothing."""
    cells = [cell for table in tables for row in table.rows for cell in row.cells]
    assert {cell.bound for cell in cells} == {"", "at most", "at least"}
    assert any(cell.beside.startswith("(") for cell in cells)
    assert any(cell.beside.startswith("of ") for cell in cells)
    assert any(cell.text == "∞" for cell in cells)
    assert any(cell.text.startswith("−") for cell in cells)
    assert any(cell.text.startswith("not computed") for cell in cells)
    assert any(cell.unranked for cell in cells)
    assert any(cell.best for cell in cells)
    assert any(cell.spread for cell in cells)
