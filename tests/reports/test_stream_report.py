"""What is on the screen, in a report: its tables in every format, its figure, its part of
the page.
"""

import csv
import json
from dataclasses import replace

import pytest

from ggvs_eval.errors import ResultsError
from ggvs_eval.protocol import Stream
from ggvs_eval.reports.figures.stream import draw_rates, rate_panels, stream_table
from ggvs_eval.reports.model.measured import read_run
from ggvs_eval.reports.page.stream_section import stream_section
from ggvs_eval.reports.report import write_report
from ggvs_eval.reports.run_groups import read_groups
from ggvs_eval.reports.section import Report
from ggvs_eval.reports.tables.compare_runs import write_comparison
from ggvs_eval.results import PROVENANCE_FILE
from ggvs_eval.run_folder import RunFolder, write_json
from helpers.run_folders import RunShape, make_protocol, write_run

LABELS = ("no-blending", "ours", "ours+scale=0.5", "4dgs")
SCREENS = tuple(f"{label}@screen" for label in LABELS[:3])
METRICS = ("PSNR", "LPIPS", "TCC", "SDV")
FAST = {
    "shown": 3,
    "repeated": 0,
    "dropped": 0,
    "dark": 1,
    "latency_ms": 20.0,
    "latency_p95_ms": 25.0,
    "per_second": 50.0,
}
SLOW = {
    "shown": 1,
    "repeated": 1,
    "dropped": 0,
    "dark": 2,
    "latency_ms": 66.0,
    "latency_p95_ms": 66.0,
    "per_second": 15.0,
}
RECORD = {
    "depth": "with live depth of its sources, measured here",
    "methods": {
        "no-blending": {"stages_ms": {"depth": 12.0, "splat": 8.0}, **FAST},
        "ours": {"stages_ms": {"depth": 12.0, "all": 54.0}, **SLOW},
        "ours+scale=0.5": {"stages_ms": {}, **FAST, "per_second": None},
        "4dgs": {"absent": "offline: it needs the whole clip"},
    },
}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run whose protocol has a stream of 30 frames a second."""
    names = tuple((label, label.upper()) for label in LABELS + SCREENS)
    shape = RunShape(labels=LABELS + SCREENS, names=names, metrics=METRICS, poses=0)
    root = write_run(tmp_path_factory.mktemp("run") / "run", shape)
    folder, protocol = RunFolder(root), replace(make_protocol(shape), stream=Stream(fps=30.0))
    folder.protocol_file.write_text(protocol.to_toml())
    results = json.loads((root / PROVENANCE_FILE).read_text())
    results["provenance"]["protocol_sha256"] = protocol.sha256
    write_json(root / PROVENANCE_FILE, results)
    write_json(folder.stream_record, RECORD)
    return root


def test_the_table_has_times_rates_and_counts(run):
    """Milliseconds with the share of depth, latency in both units, and the reason where a method is
    not on the screen.
    """
    table = stream_table(read_run(run))
    assert table is not None
    shown = {row.name: [cell.shown for cell in row.cells] for row in table.rows}

    assert shown["NO-BLENDING"] == [
        "20.0 (depth 12.0)",
        "50.00",
        "20 (25)",
        "0.6 (0.8)",
        "3",
        "0",
        "0",
        "1",
    ]
    assert shown["OURS"][:4] == ["66.0 (depth 12.0)", "15.00", "66 (66)", "2.0 (2.0)"]
    assert shown["OURS+SCALE=0.5"][1] == "no limit"
    assert {cell.hint for cell in table.rows[3].cells} == {"offline: it needs the whole clip"}
    assert "live depth" in table.caption


def test_the_figure_joins_the_sizes_of_a_method(run, tmp_path):
    """A family per method, marks by their rate; what has no rate or no number has no mark."""
    panels = rate_panels([read_run(run)])

    assert [panel.axes.metric for panel in panels] == ["PSNR", "LPIPS", "TCC"]
    assert [
        (family.name, [mark.per_second for mark in family.marks]) for family in panels[0].families
    ] == [
        ("NO-BLENDING", [50.0]),
        ("OURS", [15.0]),
    ]
    assert [text for _, text in panels[0].axes.logarithmic_ticks()] == ["20", "50"]
    assert draw_rates(panels, tmp_path / "stream.png").stat().st_size > 5000


def test_a_method_at_a_fraction_of_its_size_alone_has_its_name(run):
    """The family is called as the method is, without the size, and not by its label."""
    read = read_run(run)
    record = {"methods": {"ours+scale=0.5": RECORD["methods"]["no-blending"]}}
    write_json(RunFolder(run).stream_record, record)
    named = replace(read, names={"ours": "OURS", "ours+scale=0.5": "OURS, scale=0.5"})
    try:
        panels = rate_panels([named])
    finally:
        write_json(RunFolder(run).stream_record, RECORD)

    assert [family.name for family in panels[0].families] == ["OURS"]


def test_what_is_seen_has_a_table_of_its_own(run):
    """Every metric of frames, ranked among what is seen; no other table and no picture has these
    rows.
    """
    groups = read_groups([run])
    (table,) = stream_section(Report(groups)).tables[groups[0].id]

    assert [row.label for row in table.rows] == [*SCREENS]
    assert [column.name for column in table.columns] == [*METRICS]
    assert any(cell.shade for row in table.rows for cell in row.cells)
    assert {row.label for of_group in groups[0].tables for row in of_group.rows} == {*LABELS}
    assert read_run(run).pictured == LABELS


def test_two_rows_of_the_screen_are_compared_as_their_table_ranks_them(run):
    """Against each other they are rows like any others; names of both are refused where there is
    none.
    """
    assert "better" in write_comparison(SCREENS[0], SCREENS[2], run)
    with pytest.raises(ResultsError, match="no values of method '4dgs@screen'"):
        write_comparison(SCREENS[0], "4dgs@screen", run)


@pytest.mark.slow
def test_it_is_on_the_page_and_in_the_files(run, tmp_path):
    """The part is there, its numbers once; Markdown, CSV and LaTeX have both tables; without a
    stream there is no such part.
    """
    page = write_report([run], tmp_path / "report").read_text()

    assert 'id="on-time"' in page
    assert page.count('<th scope="col"') > 0
    assert "offline: it needs the whole clip" in page
    for name in ("tables.md", "tables.tex"):
        text = (tmp_path / "report" / name).read_text()
        assert "Displayed frames and their delay" in text
        assert text.count("Displayed frames during live capture") == 1
    with (tmp_path / "report" / "tables.csv").open() as file:
        lines = [line for line in csv.DictReader(file) if line["table"] == "on_time"]
    assert {line["column"] for line in lines} >= {"rate", "latency", "behind", "dropped"}
    assert (tmp_path / "report" / "figures" / "stream.png").is_file()

    plain = write_run(tmp_path / "plain", RunShape(poses=0))
    assert (
        'id="on-time"'
        not in write_report([plain], tmp_path / "other", with_figures=False).read_text()
    )
