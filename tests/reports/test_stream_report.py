"""What is on the screen, in a report: its tables in every format, its figure, its part of the page."""

import csv
import json
from dataclasses import replace

import pytest

from ggvs_eval.protocol import Stream
from ggvs_eval.reports.figures.stream import draw_rates, rate_panels, stream_table
from ggvs_eval.reports.model.measured import read_run
from ggvs_eval.reports.report import write_report
from ggvs_eval.reports.tables.report_tables import main_captions
from ggvs_eval.results import PROVENANCE_FILE
from ggvs_eval.run_folder import RunFolder, write_json
from helpers.run_folders import RunShape, make_protocol, write_run

LABELS = ("no-blending", "ours", "ours+scale=0.5", "4dgs")
METRICS = ("PSNR", "LPIPS", "TCC", "PSNR_stream", "LPIPS_stream", "TCC_stream")
FAST = {"shown": 3, "repeated": 0, "dropped": 0, "dark": 1, "latency_ms": 20.0, "latency_p95_ms": 25.0, "per_second": 50.0}
SLOW = {"shown": 1, "repeated": 1, "dropped": 0, "dark": 2, "latency_ms": 66.0, "latency_p95_ms": 66.0, "per_second": 15.0}
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
    names = tuple((label, label.upper()) for label in LABELS)
    shape = RunShape(labels=LABELS, names=names, metrics=METRICS, poses=0)
    root = write_run(tmp_path_factory.mktemp("run") / "run", shape)
    folder, protocol = RunFolder(root), replace(make_protocol(shape), stream=Stream(fps=30.0))
    folder.protocol_file.write_text(protocol.to_toml())
    results = json.loads((root / PROVENANCE_FILE).read_text())
    results["provenance"]["protocol_sha256"] = protocol.sha256
    write_json(root / PROVENANCE_FILE, results)
    write_json(folder.stream_record, RECORD)
    return root


def test_the_table_has_times_rates_and_counts(run):
    """Milliseconds with the share of depth, latency in both units, and the reason where a method is not on the screen."""
    table = stream_table(read_run(run))
    assert table is not None
    shown = {row.name: [cell.shown for cell in row.cells] for row in table.rows}

    assert shown["NO-BLENDING"] == ["20.0 (depth 12.0)", "50.00", "20 (25)", "0.6 (0.8)", "3", "0", "0", "1"]
    assert shown["OURS"][:4] == ["66.0 (depth 12.0)", "15.00", "66 (66)", "2.0 (2.0)"]
    assert shown["OURS+SCALE=0.5"][1] == "no limit"
    assert {cell.hint for cell in table.rows[3].cells} == {"offline: it needs the whole clip"}
    assert "live depth" in table.caption


def test_the_figure_joins_the_sizes_of_a_method(run, tmp_path):
    """A family per method, marks by their rate; what has no rate or no number has no mark."""
    panels = rate_panels([read_run(run)])

    assert [panel.axes.metric for panel in panels] == ["PSNR", "LPIPS", "TCC"]
    assert [(family.name, [mark.per_second for mark in family.marks]) for family in panels[0].families] == [
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
    named = replace(read, names={**read.names, "ours+scale=0.5": "OURS, scale=0.5"})
    try:
        panels = rate_panels([named])
    finally:
        write_json(RunFolder(run).stream_record, RECORD)

    assert [family.name for family in panels[0].families] == ["OURS"]


@pytest.mark.parametrize(("warm_up", "instants"), [(0, "a method's first picture on"), (1, "the last 1 instant of 2")])
def test_the_caption_counts_the_instants_that_are_scored(run, warm_up, instants):
    """A mean over the screen is of fewer instants than the clip has frames."""
    read = read_run(run)
    count = read.protocol.frames.count
    streamed = replace(read, protocol=replace(read.protocol, stream=Stream(fps=30.0, warm_up=(count - 1) * warm_up)))

    caption = main_captions("stream", [streamed], read.results, read.names, ["PSNR_stream"])[0]

    assert instants.replace("of 2", f"of {count}") in caption


@pytest.mark.slow
def test_it_is_on_the_page_and_in_the_files(run, tmp_path):
    """The part is there, its numbers once; Markdown, CSV and LaTeX have both tables; without a stream there is no such part."""
    page = write_report([run], tmp_path / "report").read_text()

    assert 'id="on-time"' in page
    assert page.count('<th scope="col"') > 0
    assert "offline: it needs the whole clip" in page
    for name in ("tables.md", "tables.tex"):
        assert "Displayed frames and their delay" in (tmp_path / "report" / name).read_text()
    with (tmp_path / "report" / "tables.csv").open() as file:
        lines = [line for line in csv.DictReader(file) if line["table"] == "on_time"]
    assert {line["column"] for line in lines} >= {"rate", "latency", "behind", "dropped"}
    assert (tmp_path / "report" / "figures" / "stream.png").is_file()

    plain = write_run(tmp_path / "plain", RunShape(poses=0))
    assert 'id="on-time"' not in write_report([plain], tmp_path / "other", with_figures=False).read_text()
