"""Every section of a report can be deleted: the page is written without it, and one line
names it.
"""

import html
import re
import sys

import pytest

from ggvs_eval import plugins
from ggvs_eval.protocol import Frames
from ggvs_eval.reports.report import write_report
from ggvs_eval.reports.section import SECTIONS
from helpers.house_measures import reached_modules
from helpers.import_graph import modules
from helpers.run_folders import RunShape, write_run

SHAPE = RunShape(metrics=("PSNR", "TCC"), poses=2, views=("cam00",), frames=Frames(0, 2))
TRUNK = {f"ggvs_eval.{name}" for name in reached_modules("reports.report")}
LEAVES = {
    f"ggvs_eval.{name}"
    for name, file in modules().items()
    if name.startswith("reports.") and file.stem != "__init__"
} - TRUNK
OF_SECTIONS = {SECTIONS.root(name) for name in SECTIONS.known()}
LINE = re.compile(
    r"section (.+?) (?:is part of|wants) (\S+), which is not installed; reinstall ggvs-eval or "
    r"omit it"
)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A small run; nobody changes it."""
    return write_run(tmp_path_factory.mktemp("apart") / "run", SHAPE)


@pytest.fixture
def delete():
    """Take modules away: they cannot be found, and what imports them is imported anew; later tests
    have all as it was.
    """
    loaded = {name: sys.modules[name] for name in LEAVES | OF_SECTIONS if name in sys.modules}

    def take_away(gone: set[str]) -> None:
        plugins.missing_part.cache_clear()
        plugins.say_once.cache_clear()
        for name in loaded:
            del sys.modules[name]
        sys.modules.update(dict.fromkeys(gone))

    yield take_away
    plugins.missing_part.cache_clear()
    for name in LEAVES | OF_SECTIONS:
        sys.modules.pop(name, None)
    for name, module in loaded.items():
        package, _, name_there = name.rpartition(".")
        sys.modules[name] = module
        setattr(sys.modules[package], name_there, module)


@pytest.mark.slow
@pytest.mark.parametrize("gone", sorted(OF_SECTIONS))
def test_one_can_be_deleted(run, delete, tmp_path, capsys, gone):
    """The page lacks what the module gives, and says so in a line, as the terminal does; no link of
    the rest is dead.
    """
    delete({gone})
    page = write_report([run], tmp_path, with_figures=False).read_text(encoding="utf-8")

    lines = LINE.findall(html.unescape(page))
    assert {module for _, module in lines} == {gone}
    assert {name for name in SECTIONS.known() if SECTIONS.root(name) == gone} <= {
        name for name, _ in lines
    }
    assert LINE.findall(capsys.readouterr().err) == lines
    assert 'id="results"' in page
    assert set(re.findall(r'href="#([^"/]+)"', page)) <= {*re.findall(r'\bid="([^"]+)"', page)}


def test_all_can_be_deleted(run, delete, tmp_path, capsys):
    """Without any, and without all that they alone use, tables and the page are written; each one
    has its line.
    """
    delete(LEAVES | OF_SECTIONS)
    page = write_report([run], tmp_path).read_text(encoding="utf-8")

    assert LINE.findall(html.unescape(page)) == [
        (name, SECTIONS.root(name)) for name in SECTIONS.known()
    ]
    assert {file.name for file in tmp_path.iterdir()} == {
        "index.html",
        *(f"tables.{kind}" for kind in ("csv", "md", "tex", "xlsx")),
    }
    assert len(capsys.readouterr().err.splitlines()) == len(SECTIONS.known())
    assert {*re.findall(r'<section id="([^"]+)"', page)} == {"results", "views", "measured"}


PLUGIN = """
from ggvs_eval.reports.model.table import Cell, Column, Row, Table
from ggvs_eval.reports.section import SectionContent


def counts(report):
    column = Column("methods", higher_is_better=None)
    tables = {}
    for key, run in report.runs.items():
        row = Row("all", (Cell(str(len(run.labels)), float(len(run.labels))),))
        tables[key] = [Table("counts", "Counted", "How many.", (column,), (row,))]
    sheet = {"id": "mine", "title": "My sheet", "comes_first": False, "html": '<section id="mine" class="sheet"></section>'}
    return SectionContent(tables=tables, part="views", sheets=[sheet])


SECTIONS = {"counts": counts, "broken": lambda report: 1 / 0}
"""  # noqa: E501


def test_a_plugin_adds_a_section(run, monkeypatch, tmp_path, capsys):
    """Its table is on the page and in the files, its sheet has a tab; another one that fails is a
    line.
    """
    file = tmp_path / "my_sections.py"
    file.write_text(PLUGIN)
    monkeypatch.setenv(plugins.FILES, str(file))
    monkeypatch.setattr(sys, "path", [*sys.path])
    plugins._offered.cache_clear()
    try:
        page = write_report([run], tmp_path / "report", with_figures=False).read_text(
            encoding="utf-8"
        )
    finally:
        plugins._offered.cache_clear()

    assert "## Counted" in (tmp_path / "report" / "tables.md").read_text(encoding="utf-8")
    assert "Counted" in page
    assert '<a href="#mine">My sheet</a>' in page
    assert '<section id="mine" class="sheet"></section>' in page
    line = (
        f"section plug-in {file}: section 'broken' does not work (ZeroDivisionError: division "
        f"by zero)"
    )
    assert line in html.unescape(page)
    assert line in capsys.readouterr().err
