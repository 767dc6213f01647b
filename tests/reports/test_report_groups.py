"""A report of runs under different protocols: one page, one group of sections each, and no table
that mixes them.
"""

import csv
import html
import json
import re
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from ggvs_eval.errors import ResultsError
from ggvs_eval.protocol import Frames
from ggvs_eval.reports import report as report_module
from ggvs_eval.reports.model.table import Cell, Column, Row, Table
from ggvs_eval.reports.page.leaderboard import write_leaderboard
from ggvs_eval.reports.page.page import render_page
from ggvs_eval.reports.report import write_report
from ggvs_eval.reports.run_groups import read_groups
from ggvs_eval.reports.section import Report, with_sections
from ggvs_eval.reports.tables.verdict import leaders
from ggvs_eval.results import Results
from ggvs_eval.statistics.paired import Comparison, Judgement, Outcome
from helpers.page_reader import PageReader
from helpers.refusals import refused
from helpers.run_folders import LABELS, NAMES, RunShape, write_run

SMALL = RunShape(metrics=("PSNR", "TCC"), poses=2)
SHAPES = {
    "room": replace(SMALL, scene="room"),
    "street": replace(SMALL, scene="street", frames=Frames(0, 3), views=("cam00",)),
    "kitchen": replace(SMALL, scene="kitchen"),
}


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> dict[str, Path]:
    """Three runs: the first and the last under one protocol, the second under another; nobody
    changes them.
    """
    folder = tmp_path_factory.mktemp("groups")
    return {scene: write_run(folder / scene, shape) for scene, shape in SHAPES.items()}


@pytest.fixture(scope="module")
def report(runs, tmp_path_factory) -> Path:
    """Folder of their common report; of the figures of a run, which others draw, the folder
    alone.
    """
    with pytest.MonkeyPatch.context() as patch:
        makers = lambda report, out: [  # noqa: E731
            partial((out / key).mkdir, parents=True) for key in report.runs
        ]
        patch.setattr(report_module, "_figures", makers)
        return write_report(
            list(runs.values()), tmp_path_factory.mktemp("groups") / "report"
        ).parent


def rows_of(report: Path) -> list[dict[str, str]]:
    """Lines of the table of all values."""
    return list(csv.DictReader((report / "tables.csv").open(encoding="utf-8")))


def page_of(runs: list[Path]) -> str:
    """The page of a report on them."""
    return render_page(with_sections(Report(read_groups(runs))))


def test_runs_are_grouped_by_protocol_in_the_order_given(runs):
    """Runs of one protocol stand together, where the first of them was given; each group has a name
    of its own.
    """
    first, second = read_groups(list(runs.values()))
    assert [run.scene for run in first.runs.values()] == ["room", "kitchen"]
    assert [run.scene for run in second.runs.values()] == ["street"]
    assert (first.name, second.name) == ("room, tiny, K = 2", "street, tiny, K = 2")
    assert [group.scenes for group in read_groups([runs["street"], runs["kitchen"]])] == [
        "street",
        "kitchen",
    ]


def test_groups_alike_in_name_are_told_apart_by_hash(tmp_path):
    """Two protocols of one name and K, on one scene, are named with the beginning of their
    hashes.
    """
    shapes = (SMALL, replace(SMALL, frames=Frames(2, 3)))
    groups = read_groups([write_run(tmp_path / str(shape.frames.count), shape) for shape in shapes])
    assert [group.name for group in groups] == [
        f"room, tiny, K = 2, {group.protocol.sha256[:8]}" for group in groups
    ]
    assert len({group.name for group in groups}) == 2


@pytest.mark.slow
def test_a_demo_is_called_by_its_data_set(tmp_path):
    """A demo whose scene is named like a file is headed by its data set; the file's name heads its
    files alone.
    """
    demo = write_run(
        tmp_path / "demo", replace(SMALL, scene="scene000", dataset="Demo room, D3DMV's layout")
    )
    record = json.loads((demo / "capture.json").read_text())
    (demo / "capture.json").write_text(json.dumps(record | {"units_origin": "demo.json"}))
    other = write_run(tmp_path / "other", replace(SMALL, scene="street", dataset="DyNeRF"))
    text = page_of([demo, other])
    head = html.unescape(text[text.index("<h1") : text.index("</header>")])
    assert ">Demo room, D3DMV's layout · street</h1>" in head
    assert re.findall(r'data-room="run\d">([^<]*)<', head) == [
        "Demo room, D3DMV's layout",
        "street",
    ]
    assert text.count(">scene000</h") == 1
    assert "Demo room, D3DMV's layout</h1>" in html.unescape(page_of([demo]))


@pytest.mark.slow
def test_no_value_of_one_protocol_stands_among_anothers(report, runs):
    """Each group's main table is what a report of its runs alone holds; the CSV names protocol, K
    and hash in every line.
    """
    together = rows_of(report)
    assert {row["k"] for row in together} == {"2"}
    assert len({row["protocol_sha256"] for row in together}) == 2
    for names in (("room", "kitchen"), ("street",)):
        page = write_report(
            [runs[name] for name in names], report.parent / "-".join(names), with_figures=False
        )
        alone = rows_of(page.parent)
        mine = [row for row in together if row["protocol_sha256"] == alone[0]["protocol_sha256"]]
        assert mine == alone


def test_page_has_a_part_for_each_protocol(report):
    """Every link leads somewhere, no place is there twice, each group has all sections; tabs name
    the captures in their order.
    """
    text = (report / "index.html").read_text(encoding="utf-8")
    places = re.findall(r'\bid="([^"]+)"', text)
    assert len(places) == len(set(places))
    assert set(re.findall(r'href="#([^"/]+)"', text)) <= set(places)
    sections = (
        "results",
        "heat",
        "compare",
        "through",
        "errors",
        "slices",
        "curves",
        "videos",
        "views",
        "timing",
        "measured",
    )
    assert {f"group{at}-{name}" for at in range(2) for name in sections} <= set(places)
    assert not {"reproduction", "paper"} & set(places)  # none of these runs is on the paper's terms
    rooms = re.findall(r'<a href="#(\w+)" data-room="(\w+)">([^<]*)</a>', text)
    assert rooms == [
        ("group0", "run0", "room"),
        ("run1", "run1", "kitchen"),
        ("group1", "run2", "street"),
    ]
    assert re.findall(r'data-address="([^"]*)"', text) == ["room", "kitchen", "street"]


@pytest.mark.slow
def test_captures_of_one_name_have_an_address_each(tmp_path):
    """Names that are alike, or alike in an address, are told apart by scene, by protocol, and at
    last by their number.
    """
    shapes = (
        replace(SMALL, scene="a b"),
        replace(SMALL, scene="a-b"),
        replace(SMALL, scene="a b", k=3),
    )
    text = page_of([write_run(tmp_path / str(at), shape) for at, shape in enumerate(shapes)])
    names = re.findall(r'data-room="run\d">([^<]*)<', text)
    assert names == ["a b, tiny, K = 2, a b", "a b, tiny, K = 2, a-b", "a b, tiny, K = 3, a b"]
    addresses = re.findall(r'data-address="([^"]*)"', text)
    assert len(set(addresses)) == 3
    assert addresses[2] == "a-b-tiny-k-3-a-b"


def test_headings_go_down_one_level_at_a_time(report, runs):
    """Of one protocol or several: one first heading, and none that is more than one level below the
    one before it.
    """
    alone = write_report([runs["street"]], report.parent / "alone", with_figures=False)
    for page in (alone, report / "index.html"):
        levels = [
            int(tag[1])
            for tag in PageReader(page.read_text(encoding="utf-8")).tags
            if re.fullmatch(r"h[1-6]", tag)
        ]
        assert levels.count(1) == 1
        assert all(below <= above + 1 for above, below in pairwise(levels))


def test_files_tell_the_groups_apart(report):
    """Titles in Markdown, labels in LaTeX and sheets of the workbook are each there once; figures
    have a folder per run.
    """
    titles = re.findall(
        r"^## (.*)$", (report / "tables.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    labels = re.findall(r"\\label\{([^}]*)\}", (report / "tables.tex").read_text(encoding="utf-8"))
    assert len(titles) == len(set(titles)) == len(labels) == len(set(labels))
    assert sum("street, tiny, K = 2" in title for title in titles) == 2 + 6
    assert {folder.name for folder in (report / "figures").iterdir()} == {"run0", "run1", "run2"}
    pytest.importorskip("openpyxl", reason="no openpyxl, by which pandas writes workbooks")
    assert len(pd.ExcelFile(report / "tables.xlsx").sheet_names) == len(titles) + 2


@pytest.mark.slow
def test_captures_of_one_name_are_two_scenes(tmp_path):
    """Two captures whose folders are called alike count as two scenes in every table, told apart by
    what was captured.
    """
    shapes = [replace(SMALL, scene="room", content=content) for content in ("one", "other")]
    runs = [write_run(tmp_path / shape.content / "run", shape) for shape in shapes]
    other = Results.read(runs[1])
    replace(other, table=other.table.assign(value=other.table["value"] + 1.0)).write(runs[1])

    report = write_report(runs, tmp_path / "report", with_figures=False).parent

    psnr = [run.summary().xs("Demo room")["PSNR"].max() for run in map(Results.read, runs)]
    (best,) = [
        row
        for row in rows_of(report)
        if (row["table"], row["column"], row["method"]) == ("quality", "PSNR", NAMES[LABELS[2]])
    ]
    assert float(best["value"]) == pytest.approx(np.mean(psnr))
    scenes = {row["dataset"] for row in rows_of(report) if row["table"] == "view-PSNR"}
    assert len(scenes) == 2
    assert all(re.fullmatch(r"room [0-9a-f]{6}", scene) for scene in scenes)
    (group,) = read_groups(runs)
    assert set(group.results.provenance["inputs"]) == {f"{scene}/cam00" for scene in scenes}
    assert [
        scene for one in read_groups(runs[::-1]) for scene in sorted(one.results.scenes)
    ] == sorted(scenes)


@pytest.mark.parametrize("scene", ["room", "copy of it"])
def test_a_value_measured_twice_is_refused_with_both_places(scene, tmp_path):
    """Two versions of a run, under one name of the captured scene or two, are not one table: which
    value is shown is chance.
    """
    one = write_run(tmp_path / "one", replace(SMALL, content="frames"))
    two = write_run(tmp_path / "two", replace(SMALL, scene=scene, content="frames"))
    with refused(ResultsError, LABELS[0], "room", one.name, two.name):
        write_report([one, two], tmp_path / "both")
    with pytest.raises(ResultsError, match="is measured in"):
        write_leaderboard([one, two], tmp_path / "board.html")
    assert not (tmp_path / "both").exists()


def test_two_values_in_one_run_are_refused(tmp_path):
    """A table that holds a value twice is scored again, not cut to one of them."""
    run = write_run(tmp_path / "run", SMALL)
    results = Results.read(run)
    replace(results, table=pd.concat([results.table, results.table[:1]], ignore_index=True)).write(
        run
    )
    with refused(ResultsError, run.name, "PSNR", LABELS[0], "room", "two values", "score"):
        write_report([run])


@pytest.mark.slow
def test_means_over_other_scenes_are_not_ranked(tmp_path):
    """A method that lacks a scene is shown, never best and in no headline, though its number is;
    every format says so.
    """
    frames = Frames(0, 24)
    both = [
        replace(SMALL, scene=scene, frames=frames, poses=0, labels=LABELS[:2])
        for scene in ("room", "hall")
    ]
    runs = [
        write_run(tmp_path / shape.scene, shape)
        for shape in (both[0], replace(both[1], labels=LABELS))
    ]
    (group,) = read_groups(runs)
    quality = group.tables[0]
    (lacking,) = [row for row in quality.rows if row.name == NAMES[LABELS[2]]]
    values = [row.cells[0].value for row in quality.rows]
    assert lacking.cells[0].value == max(values)
    assert (lacking.cells[0].best, lacking.cells[0].shade, lacking.competes) == (False, 0.0, False)
    assert f"{NAMES[LABELS[2]]} is not measured on room; it is not ranked." in quality.notes
    verdict = group.verdict
    assert [one.label for one in verdict.contenders] == [LABELS[1], LABELS[0]]
    assert verdict.headline.startswith(NAMES[LABELS[1]])


@pytest.mark.slow
def test_versions_that_a_table_mixes_are_named(tmp_path):
    """Values made under two versions of a library are said to be, in the caption; one version of
    each is not worth a word.
    """
    runs = [write_run(tmp_path / scene, replace(SMALL, scene=scene)) for scene in ("room", "hall")]
    assert "versions" not in " ".join(read_groups(runs)[0].tables[0].notes)
    for run, version in zip(runs, ("2.3.0", "2.4.1"), strict=True):
        found = Results.read(run)
        replace(
            found,
            provenance=found.provenance | {"versions": {"ggvs-eval": version, "torch": version}},
        ).write(run)
    (group,) = read_groups(runs)
    assert all(
        "several versions: torch 2.3.0 and 2.4.1." in " ".join(table.notes)
        for table in group.tables
    )


def made_table(psnr: dict[str, tuple[float, Outcome]], kinds: tuple[str, ...] = ()) -> Table:
    """A table of PSNR of methods with their outcomes against the first, which is the best."""
    column = Column("PSNR", "dB", True)
    kinds += ("measured",) * (len(psnr) - len(kinds))
    rows = [
        Row(name, (Cell(f"{value:.1f}", value, spread="± 0.1"),), kind, name)
        for (name, (value, _)), kind in zip(psnr.items(), kinds, strict=True)
    ]
    best, *others = (name for name, kind in zip(psnr, kinds, strict=True) if kind == "measured")
    short = {name: "clip too short" if psnr[name][1] == "too short" else "" for name in others}
    decided = {
        name: Comparison(-1.0, None, None, 0.5, "", short[name], outcome=psnr[name][1])
        for name in others
    }
    return Table(
        "quality",
        "Quality",
        "",
        (column,),
        tuple(rows),
        "room",
        judgements={"PSNR": Judgement(best, decided, {}, {}, {})},
    )


def test_leaders_are_the_judgements_best_and_its_ties():
    """The best with its cell, what is as good and what the clip is too short for; one method leads
    alone, grey rows never.
    """
    table = made_table(
        {
            "a": (31.0, "equal"),
            "b": (30.9, "as good"),
            "c": (30.8, "too short"),
            "d": (20.0, "worse"),
        }
    )
    (psnr,) = leaders([table])
    assert (psnr.column.name, psnr.name, psnr.cell.text, psnr.cell.spread) == (
        "PSNR",
        "a",
        "31.0",
        "± 0.1",
    )
    assert (psnr.ties, psnr.short, psnr.judgement.winner, psnr.judgement.undecided) == (
        ("b",),
        ("c",),
        "",
        "clip too short",
    )
    (sure,) = leaders([made_table({"a": (31.0, "equal"), "d": (20.0, "worse")})])
    assert (sure.ties, sure.short, sure.judgement.winner, sure.judgement.undecided) == (
        (),
        (),
        "a",
        "",
    )
    assert [leader.column.name for leader in leaders([table], ["absent"])] == ["PSNR"]
    values = {"a": (30.0, "equal"), "paper": (99.0, "equal"), "b": (98.0, "equal")}
    (psnr,) = leaders([made_table(values, kinds=("measured", "published", "partial"))])
    assert (psnr.name, psnr.ties, psnr.judgement.winner) == ("a", (), "")
    assert leaders([]) == ()


def test_the_first_screen_has_the_best_with_its_interval(report):
    """Above the sections of a group stand the best value of each headline metric and its method;
    short clips name no winner.
    """
    text = (report / "index.html").read_text(encoding="utf-8")
    bold = [
        row
        for row in rows_of(report)
        if row["table"] in ("quality", "consistency") and row["best"] == "True"
    ]
    summaries = re.findall(r'<table class="leaders">.*?</table>', text, re.DOTALL)
    assert len(summaries) == 2
    told = "".join(summaries)
    assert all(row["shown"] in told for row in bold if row["method"] in told)
    assert told.count("<b>") == len({(row["protocol"], row["column"]) for row in bold})
    assert "no winner: nothing could be compared (" in told
    assert "Nothing is bold in " in (report / "tables.md").read_text(encoding="utf-8")
