"""The folder of a sweep as a report: its table and its curves over K above the groups of
its runs.
"""

import re
from pathlib import Path

import pytest

from ggvs_eval.reports.model.measured import read_run, sweep_runs
from ggvs_eval.reports.page.sweep_section import sweep_section
from ggvs_eval.reports.report import write_report
from helpers.small_runs import leave_out_pixels
from helpers.sweep_folders import KS, LINES, write_sweep

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def sweep(tmp_path_factory) -> Path:
    """A sweep of one capture over K; nobody changes it."""
    return write_sweep(tmp_path_factory.mktemp("sweeps") / "by-k")


@pytest.fixture(scope="module")
def page(sweep) -> str:
    """The page of the sweep, where it lies by default."""
    with pytest.MonkeyPatch.context() as patch:
        leave_out_pixels(patch)
        file = write_report([sweep])
    assert file == sweep / "report" / "index.html"
    return file.read_text(encoding="utf-8")


def test_a_sweep_stands_for_its_runs(sweep, page):
    """Each K is a group of its own, in the order of the sweep's table; the figure for a paper lies
    beside the page.
    """
    assert sweep_runs(sweep) == [sweep / f"k{k}" for k in KS]
    assert re.findall(r'class="group-name">room <span class="on">tiny, K\xa0=\xa0(\d)', page) == [
        "2",
        "3",
        "5",
    ]
    assert (sweep / "report" / "figures" / "k.png").is_file()


def test_table_and_curves_hold_what_was_swept(sweep, page):
    """Every line of the sweep is a row, unranked; each K is a dot of each method, higher where the
    value is, time from 0 on.
    """
    section = sweep_section(sweep, read_run(sweep / "k2").metrics)
    assert [row.name for row in section.table.rows] == [
        f"{method}, K = {variant[1:]}" for variant, method, *_ in LINES
    ]
    assert [[cell.value for cell in row.cells] for row in section.table.rows] == [
        list(line[2:]) for line in LINES
    ]
    assert not any(cell.best for row in section.table.rows for cell in row.cells)
    psnr, seconds = section.panels
    assert section.ks == KS
    assert [(curve.name, curve.pairs) for curve in psnr.curves] == [
        ("GGVS (online)", ((2, 30.2), (3, 30.3), (5, 30.5))),
        ("No Blending", ((2, 20.2), (3, 20.3), (5, 20.5))),
    ]
    assert psnr.y(30.5) < psnr.y(30.2) < psnr.y(20.2)
    assert (seconds.bounds[2], seconds.unit) == (0.0, "s")
    drawn = page[page.index('id="sweep0"') : page.index("<article")]
    assert drawn.count("<circle") == 2 * 2 * len(KS)
    assert "GGVS (online), K = 5: 30.5 dB" in drawn


def test_a_sweep_of_one_k_has_a_table_alone(sweep, tmp_path):
    """A sweep over methods at one K shows its lines and no curve; of several captures the mean is a
    line and no run.
    """
    (tmp_path / "sweep.csv").write_text(
        "capture,variant,method,PSNR\na,demo,GGVS (online),30\nb,demo,GGVS "
        "(online),31\nmean,demo,GGVS (online),30.5\n"
    )
    section = sweep_section(tmp_path, read_run(sweep / "k2").metrics)
    assert (section.panels, section.title) == ((), "Sweep")
    assert [row.name for row in section.table.rows] == [
        "GGVS (online), demo, a",
        "GGVS (online), demo, b",
        "GGVS (online), demo, mean",
    ]
    assert sweep_runs(tmp_path) == [tmp_path / "a" / "demo", tmp_path / "b" / "demo"]


@pytest.mark.slow
def test_a_sweep_may_stand_without_its_runs(sweep, tmp_path, monkeypatch):
    """As `tables_of` it follows the groups, says on what it was measured, and which command shows
    its runs.
    """
    leave_out_pixels(monkeypatch)
    page = write_report([sweep / "k2"], tmp_path / "report", tables_of=[sweep]).read_text(
        encoding="utf-8"
    )

    # one run, one group, which then has no frame of its own
    assert 'class="group-name"' not in page
    assert page.index('id="videos"') < page.index('id="sweep0"') < page.index("<footer>")
    assert f"ggvs-eval report {sweep}" in page
    assert "protocol tiny: 4 frames of" in page
    assert (tmp_path / "report" / "figures" / "k.png").is_file()


def test_a_method_has_one_colour_on_the_whole_page(page):
    """First screen, curves over time and curves over K draw a method in the same colour; no
    backtick is left on the page.
    """
    colours: dict[str, set[str]] = {}
    for name, colour in re.findall(r'<th scope="row">([^<]+)</th>\s*<td class="track (c\d)"', page):
        colours.setdefault(name, set()).add(colour)
    for colour, name in re.findall(r'<line class="(c\d)"[^>]*/></svg>([^<]+)</li>', page):
        colours.setdefault(name, set()).add(colour)
    for colour, name in re.findall(r'<polyline class="(c\d)"[^>]*><title>([^<]+)</title>', page):
        colours.setdefault(name, set()).add(colour)
    assert {"GGVS (online)", "No Blending"} < set(colours)
    assert all(len(of_name) == 1 for of_name in colours.values()), colours
    assert colours["GGVS (online)"] != colours["No Blending"]
    shown = re.sub(r"<(script|style|pre)\b.*?</\1>", "", page, flags=re.DOTALL)
    assert "`" not in shown
    assert "GGVS (online), k2" not in shown
