"""What a reader makes of the page in a real browser: fewer methods, a copied table, a link that
keeps it all, paper.
"""

import base64

import numpy as np
import pytest

from ggvs_eval.reports.figures.slices import find_breaks
from ggvs_eval.reports.model.measured import read_run
from ggvs_eval.reports.model.table import Cell, Column, Row, Table
from ggvs_eval.reports.page.quality_over_time import quality_over_time
from ggvs_eval.reports.tables.timing import TOTAL, timing_table
from ggvs_eval.reports.tables.worst_frames import worst_frames_table
from helpers.painted_page import STAGE, clock, show_part
from helpers.run_folders import LABELS, RunShape, write_run

HIDDEN = LABELS[0]
NAME = "No Blending"
# Elements that show the method by its name and can be seen now.
SEEN = (
    "[...document.querySelectorAll('[data-method]')].filter(one => one.dataset.method === "
    "arguments[0] && one.getClientRects().length)"
)


def untick(browser, label: str = HIDDEN) -> None:
    """Take the tick from a method's box."""
    browser.click(".methods summary")
    browser.click(f".methods input[value='{label}']")
    browser.press("\ue00c")


def copied(browser, selector: str) -> str:
    """What a button puts on the clipboard."""
    browser.run(
        "(window.took = null, navigator.clipboard.writeText = text => { window.took = text; return "
        "Promise.resolve(); })"
    )
    browser.click(selector)
    return browser.wait("window.took")


def test_a_method_without_its_tick_is_nowhere(shown):
    """Its rows, curves, slices, pictures and heat maps go, the viewer offers it no more, and one
    click brings all of it back.
    """
    untick(shown)
    assert shown.text(".methods summary").strip() == "Methods: 2 of 3"
    for part in ("results", "heat", "slices", "timing", "compare"):
        show_part(shown, part)
        assert shown.run(f"{SEEN}.length", NAME) == 0, part
        assert shown.run("document.querySelector(arguments[0]).checkVisibility()", f"#{part}")
    option = f"[data-role=left] option[value='{HIDDEN}']"
    assert shown.run("document.querySelector(arguments[0]).disabled", option)
    assert shown.run("document.querySelector('[data-role=left]').value") != HIDDEN
    shown.click(".methods summary")
    shown.click(".methods button")
    show_part(shown, "results")
    assert shown.run(f"{SEEN}.length", NAME) > 0
    assert shown.complaints() == []


def test_the_last_method_stays(shown):
    """The last tick cannot be taken from a page; heat maps and slices are pictures with words for
    who does not see them.
    """
    shown.click(".methods summary")
    for label in LABELS:
        shown.click(f".methods input[value='{label}']")
    assert shown.run("document.querySelectorAll('.methods input:checked').length") == 1
    assert shown.run("[...document.querySelectorAll('canvas')].length") > 3
    assert shown.run(
        "[...document.querySelectorAll('canvas')].every(one => one.getAttribute('role') === 'img' "
        "&& one.ariaLabel)"
    )


def test_a_copied_table_is_the_one_that_is_seen(shown):
    """LaTeX and CSV have the rows in their order on the screen, without those of hidden methods;
    the CSV is not rounded.
    """
    untick(shown)
    show_part(shown, "results")
    shown.click("#results table:not(.leaders) thead th:nth-child(2) .sort")
    names = shown.run(
        "[...document.querySelectorAll('#results table:not(.leaders)')][0].tBodies[0].rows.length"
    )
    assert names == len(LABELS) + 1  # and the ceiling
    latex = copied(shown, "#results [data-copy=latex]")
    assert latex.startswith("% \\usepackage{booktabs}")
    assert latex.count("\\begin{tabular}") == latex.count("\\bottomrule") == 1
    assert NAME not in latex
    assert latex.index("\\midrule\n\\textcolor{gray}{Ceiling}") > 0
    lines = copied(shown, "#results [data-copy=csv]").splitlines()
    assert lines[0].startswith("Method,PSNR (dB),PSNR (dB) low,PSNR (dB) high")
    assert len(lines) == 1 + len(LABELS)
    assert len(lines[1].replace('"', "").split(",")[-1]) > 6
    assert shown.text("#results .copies output") == "copied"


def test_a_link_keeps_methods_mode_and_zoom(started, painted):
    """What is chosen is in the address, and a page that is opened there shows the same; what is as
    ever is left out.
    """
    started.visit(painted)
    untick(started)
    started.choose("[data-role=left]", LABELS[2])
    started.focus(STAGE)
    started.press("m", "m", "+", "\ue014")
    mode = started.run("document.querySelector('input[name^=mode]:checked').value")
    zoom = started.run("document.querySelector('.viewer').style.getPropertyValue('--zoom')")
    # written a moment later
    place = started.wait(f"/\\/{mode}\\/[^/]+\\/no-blending/.test(location.hash) && location.hash")
    started.visit(painted, place=place)
    assert started.run("document.querySelector('[data-role=left]').value") == LABELS[2]
    assert started.run("document.querySelector('input[name^=mode]:checked').value") == mode
    assert (
        started.run("document.querySelector('.viewer').style.getPropertyValue('--zoom')")
        == zoom
        != "1"
    )
    assert started.text(".methods summary").strip() == "Methods: 2 of 3"
    assert clock(started).startswith("frame 3 of")
    assert started.complaints() == []


def test_a_worst_frame_leads_to_its_picture(shown):
    """A click on the value opens its view and frame, that method beside the truth."""
    show_part(shown, "heat")
    href = shown.run("document.querySelector('#views td a').getAttribute('href')")
    _, view, frame, _, pair = href.split("/")
    shown.click("#views td a")
    shown.wait("document.querySelector('.stage').checkVisibility()")
    assert shown.run("document.querySelector('[data-role=view]').value") == view
    assert clock(shown).startswith(f"frame {frame} of")
    assert [
        shown.run(f"document.querySelector('[data-role={role}]').value")
        for role in ("left", "right")
    ] == pair.split(",")
    assert shown.complaints() == []


def test_the_first_tab_stop_skips_to_the_results(started, painted):
    """The first tab stop is a link that is seen once it has the focus, and leads behind the
    header.
    """
    started.visit(painted)
    started.press("\ue004")
    assert started.run("document.activeElement.className") == "skip"
    assert started.run("document.activeElement.getBoundingClientRect().top") >= 0
    started.press("\ue007")
    assert started.wait("document.activeElement.id === 'main'")


def test_paper_has_scores_and_figures_alone(started, painted):
    """Printed are the first screen, tables and figures, from any tab; nothing that is empty, black
    or wider than the sheet.
    """
    started.visit(painted, place="#timing")
    started.driven.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    started.resize((703, 1000))  # an A4 sheet within its margins
    try:
        seen = "document.querySelector(arguments[0]).checkVisibility({contentVisibilityAuto: true})"
        for shown in (
            ".headline",
            ".opening img",
            "#results table",
            "#curves svg",
            "#slices .strip img",
            "#timing table",
        ):
            assert started.run(seen, shown), shown
        for hidden in (
            ".stage",
            "#through",
            "#errors",
            "#heat",
            "#videos",
            ".tabs",
            ".copies",
            ".methods",
        ):
            assert not started.run(seen, hidden), hidden
        wide = (
            "[...document.querySelectorAll('table')].filter(one => "
            "one.getBoundingClientRect().right > innerWidth)"
        )
        assert started.run(f"{wide}.map(one => one.parentElement.ariaLabel)") == []
        pages = started.driven.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True})
        assert base64.b64decode(pages["data"]).count(b"/Type /Page\n") <= 6
    finally:
        started.driven.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})


def test_the_worst_frame_is_the_worst(tmp_path):
    """The two columns of a metric are its worst frame and the one that a twentieth of the frames
    are no better than.
    """
    run = read_run(
        write_run(tmp_path / "run", RunShape(metrics=("PSNR", "LPIPS", "STED"), poses=0))
    )
    table = worst_frames_table(run)
    assert [column.name for column in table.columns] == [
        *(
            "PSNR, 5th percentile",
            "PSNR, worst frame",
            "LPIPS, 95th percentile",
            "LPIPS, worst frame",
        ),
    ]
    for row in table.rows:
        for at, metric, worst in ((1, "PSNR", min), (3, "LPIPS", max)):
            values = {
                (view, int(frame)): value
                for view in run.protocol.views.test
                for frame, value in run.results.per_frame(metric, view)[
                    (row.label.partition("+")[0], row.label.partition("+")[2])
                ].items()
            }
            place = worst(values, key=values.get)
            assert (row.cells[at].value, row.cells[at].place) == (
                pytest.approx(values[place]),
                place,
            )


def test_breaks_are_where_a_jump_was_planted():
    """A jump that the truth does not have is found at its sample and column; noise, or what the
    truth does too, is none.
    """
    random = np.random.default_rng(0)
    truth = np.repeat(random.integers(0, 200, (1, 200, 3)), 20, axis=0).astype(np.uint8)
    truth[10:, 40:60] += 50  # something moves in front, in both
    noisy = np.clip(truth + random.normal(0, 2, truth.shape), 0, 255).astype(np.uint8)
    assert find_breaks(noisy, truth) == ()
    noisy[7, 120:140] = np.clip(noisy[7, 120:140].astype(int) + 40, 0, 255)
    (found,) = find_breaks(noisy, truth)  # there and back is one
    assert found.at in {7, 8}
    assert 118 <= found.x <= 142
    assert found.apart == pytest.approx(40, abs=4)


def test_quality_over_time_places_what_has_both(tmp_path):
    """A slower method is further right, a better one higher, and one without times is named
    instead.
    """
    run = read_run(write_run(tmp_path / "run", RunShape(metrics=("PSNR",), poses=0)))
    names = [run.name(label) for label in LABELS]
    drawn = quality_over_time(
        Column("PSNR", "dB", True),
        [*zip(names, (20.0, 25.0, 25.1), strict=True), ("theirs", 30.0)],
        [timing_table(run)],
    )
    assert drawn.untimed == ("theirs",)
    assert [dot.name for dot in drawn.dots] == names[::-1]  # the best on top
    assert (
        quality_over_time(Column("PSNR", "dB", True), [("theirs", 30.0)], [timing_table(run)])
        is None
    )


@pytest.mark.parametrize("seed", range(4))
def test_names_of_methods_that_are_close_do_not_overlap(seed):
    """Ten methods within 2 dB, most of them around one value: no name is on another one, on a dot,
    or outside.
    """
    rng = np.random.default_rng(seed)
    names = [
        "No Blending",
        "Distance-based Blending",
        "GGVS (online)",
        "ENeRF",
        "GPS-Gaussian, Given Depth (retrained, compact)",  # longer than what is left on either side
        *(f"GGVS (online), no {n}" for n in "abcde"),
    ]
    values = [*rng.uniform(30, 31.8, 4), *rng.normal(32, 0.05, 6)]
    cells = [(Cell(f"{time:.0f}", time),) for time in rng.uniform(20, 300, 10)]
    rows = tuple(Row(name, each, "measured", name) for name, each in zip(names, cells, strict=True))
    timing = Table("timing", "", "", (Column(TOTAL, "ms", False),), rows)
    drawn = quality_over_time(
        Column("PSNR", "dB", True), list(zip(names, values, strict=True)), [timing]
    )
    boxes = []
    for dot in drawn.dots:
        width = 5.2 * len(dot.name)
        left = dot.name_x - width if dot.is_left else dot.name_x
        boxes += [
            (left, dot.name_y - 9, left + width, dot.name_y + 2),
            (dot.x - 4, dot.y - 4, dot.x + 4, dot.y + 4),
        ]
    meeting = [
        (one, other)
        for at, one in enumerate(boxes)
        for other in boxes[at + 1 :]
        if one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]
    ]
    dots = set(boxes[1::2])
    assert [pair for pair in meeting if not dots.issuperset(pair)] == []
    assert all(
        left >= 46 and right <= 330 and top >= 0 and bottom <= 148
        for left, top, right, bottom in boxes[::2]
    )
