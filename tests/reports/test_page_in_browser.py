"""The page as a whole in a real browser: it fits, loads nothing, and is led through by links and
keys, whatever a run lacks.
"""

import re
import time
from dataclasses import replace

import pytest

from ggvs_eval.protocol import Frames
from ggvs_eval.reports.page.page import PARTS
from helpers.browser import DESKTOP, PHONE
from helpers.painted_page import SHAPE, clock, paint, show_part, wait_for_slices, write_page
from helpers.run_folders import LABELS, RunShape, write_run

PAUSES_S = (0.2, 0.5, 1.0, 2.0, 4.0, 8.0)


@pytest.mark.parametrize(
    ("size", "dark"),
    [(DESKTOP, False), ((1000, 900), True), (PHONE, False)],
    ids=["desktop", "narrow", "phone"],
)
def test_fits_and_loads_nothing(started, painted, size, dark):
    """On a desktop and on a phone, light and dark: no sideways scrolling, nothing loaded, no broken
    picture, no complaint.
    """
    started.visit(painted, size, dark)
    assert (
        started.run("document.documentElement.scrollWidth - document.documentElement.clientWidth")
        <= 0
    )
    assert (
        started.run(
            "performance.getEntriesByType('resource').filter(e => "
            "!e.name.startsWith('data:')).length"
        )
        == 0
    )
    assert started.wait(
        "[...document.querySelectorAll('img[src]')].every(image => image.complete && "
        "image.naturalWidth > 0)"
    )
    paper = [
        int(n)
        for n in re.findall(r"\d+", started.run("getComputedStyle(document.body).backgroundColor"))
    ]
    assert max(paper) < 40 if dark else min(paper) > 240
    assert started.complaints() == []


def is_dark(browser) -> bool:
    """Whether the page is dark, read from what lies behind its text."""
    return (
        max(
            int(n)
            for n in re.findall(
                r"\d+", browser.run("getComputedStyle(document.body).backgroundColor")
            )
        )
        < 40
    )


def open_again(browser, page, theme: str, dark: bool = False) -> None:
    """Open a page that keeps a theme; what is stored just before a page is left may be lost, and is
    chosen anew then.
    """
    for pause_s in PAUSES_S:
        time.sleep(pause_s)
        browser.visit(page, dark=dark)
        if browser.run("document.querySelector('.theme input:checked').value") == theme:
            return
        browser.click(f".theme input[value={theme}]")
    pytest.fail(f"a page that was opened again does not know that {theme} was chosen")


def test_theme_is_switched_by_keyboard_and_kept(started, painted):
    """Radio buttons show the page dark, light or as the system is, by arrow keys too; a choice
    outlives the page.
    """
    started.visit(painted)
    try:
        started.run("document.querySelector('.theme input:checked').focus()")
        assert started.run("document.activeElement.value") == "system"
        started.press("\ue013")
        assert started.wait("document.activeElement.value === 'dark'")
        assert is_dark(started)
        open_again(started, painted, "dark")
        assert is_dark(started)
        started.click(".theme input[value=light]")
        open_again(started, painted, "light", dark=True)
        assert not is_dark(started)
        started.click(".theme input[value=system]")
        assert is_dark(started)
    finally:
        started.run("localStorage.clear()")
    assert started.complaints() == []


def test_theme_needs_no_storage(started, painted):
    """Where the browser lets a page from disk keep nothing, the switch works until the page is
    closed, without complaint.
    """
    refuse = (
        "Object.defineProperty(window, 'localStorage', {get() { throw new "
        "DOMException('refused', 'SecurityError'); }})"
    )
    added = started.driven.execute_cdp_cmd(
        "Page.addScriptToEvaluateOnNewDocument", {"source": refuse}
    )
    try:
        started.visit(painted)
        started.click(".theme input[value=dark]")
        assert is_dark(started)
        started.visit(painted)
        assert not is_dark(started)
    finally:
        started.driven.execute_cdp_cmd("Page.removeScriptToEvaluateOnNewDocument", added)
    assert started.complaints() == []


# Pixels that the strips of a row leave free to the right, and that pictures leave free in their
# strips.
FREE = """(strips => Math.max(...[...document.querySelectorAll('.cuts canvas')].map(canvas => {
    const cell = canvas.closest('.cut').getBoundingClientRect(), box = canvas.getBoundingClientRect();
    return Math.max(cell.width - box.width, cell.height - box.height);
}), strips.getBoundingClientRect().right - Math.max(...[...strips.children].map(one => one.getBoundingClientRect().right))))(
    document.querySelector('.cuts'))"""  # noqa: E501


@pytest.mark.slow
@pytest.mark.parametrize(
    "shape",
    [
        RunShape(frames=Frames(0, 1), metrics=("PSNR", "TCC"), poses=0),
        RunShape(frames=Frames(0, 1), metrics=("PSNR",)),
        RunShape(metrics=("STED",), path_truth=False),
        RunShape(labels=LABELS[:1], views=("cam00",), metrics=("PSNR",)),
    ],
    ids=[
        "one frame, no path",
        "one frame",
        "no value per frame, virtual path",
        "one method, one view",
    ],
)
def test_poor_runs_have_a_working_page(started, tmp_path, shape):
    """Whatever a run lacks, its page works without a complaint, and says what there is not."""
    started.visit(write_page([write_run(tmp_path / "run", shape)], tmp_path / "index.html"))
    follows_rows, has_time = shape.frames.count > 1 or shape.poses > 0, shape.frames.count > 1
    assert started.run(
        "['through', 'heat', 'curves', 'videos'].map(id => document.getElementById(id) !== null)"
    ) == [
        follows_rows,
        *[has_time] * 3,
    ]
    if follows_rows:
        wait_for_slices(started)
        assert started.run(FREE) < 2
        assert ("no truth on a virtual path" in started.text(".cuts")) == (not shape.path_truth)
    if has_time:
        assert ("No metric of this run has a value per frame" in started.text("#heat")) == (
            shape.metrics == ("STED",)
        )
    started.focus(".stage")
    started.press("v", "b", "m", "d", "+", "0", "\ue014")
    assert clock(started).startswith(f"frame {shape.frames.start + (shape.frames.count > 1)} of")
    assert started.complaints() == []


@pytest.mark.slow
def test_each_group_of_a_page_has_a_viewer_of_its_own(started, tmp_path):
    """Two protocols on one page: a tab leads to each, its controls and the keys move its viewer and
    not the other's.
    """
    shapes = (
        replace(SHAPE, metrics=("PSNR",), poses=2),
        replace(SHAPE, frames=Frames(0, 3), metrics=("PSNR",), poses=2),
    )
    runs = [write_run(tmp_path / str(number), shape, paint) for number, shape in enumerate(shapes)]
    started.visit(write_page(runs, tmp_path / "index.html"))
    clocks = (
        "[...document.querySelectorAll('[data-role=clock]')].map(clock => "
        "clock.textContent.slice(0, 14))"
    )
    assert started.run(clocks) == ["frame 2 of 2–5", ""]
    started.click(".rooms a:nth-child(2)")
    assert started.run("location.hash") == "#group1"
    assert started.run(
        "['group0', 'group1'].map(id => document.querySelector(`#${id} .stage`).checkVisibility())"
    ) == [
        False,
        True,
    ]
    assert started.run(clocks) == ["frame 2 of 2–5", "frame 0 of 0–2"]
    started.run("document.querySelectorAll('.stage')[1].focus()")
    started.press("\ue014", "v")
    assert started.run(clocks) == ["frame 2 of 2–5", "frame 1 of 0–2"]
    assert started.run(
        "[...document.querySelectorAll('[data-role=view]')].map(view => view.value)"
    ) == ["cam00", "cam03"]
    show_part(started, "group1-heat")
    started.click("#group1-heat .cells", 0.9, 0.25)
    assert started.run(clocks) == ["frame 2 of 2–5", "frame 2 of 0–2"]
    assert started.run("document.documentElement.scrollWidth") <= DESKTOP[0]
    assert started.complaints() == []


def test_everything_is_reached_by_the_tab_key(shown):
    """Tab and enter alone reach the tabs, and in them heads of tables, heat maps, the stage, the
    scrubber and the zoom.
    """
    expected = {
        "compare": {"|run", "|closer-look", "stage picture|", "|frame", "|view", "|closer"},
        "results": {"sort|"},
        "heat": {"cells|"},
    }
    for name, parts in expected.items():
        shown.focus(f".parts a[href='#{name}']")
        shown.press("\ue007")
        shown.focus(".rooms a")
        reached = set()
        for _ in range(40):
            shown.press("\ue004")
            reached.add(
                shown.run(
                    "document.activeElement.className + '|' + (document.activeElement.dataset.role "
                    "?? '')"
                )
            )
            assert shown.run("getComputedStyle(document.activeElement).outlineStyle") != "none"
            if parts <= reached:
                break
        assert parts <= reached


def test_each_link_leads_to_its_section(shown):
    """Every tab, and every place that older pages had a link to, brings what it names to the top,
    and to be seen.
    """
    addresses = shown.run("[...document.querySelectorAll('.tabs a')].map(link => link.hash)")
    # which a protocol without a stream lacks
    of_run = (name for name, *_ in PARTS if name != "on-time")
    assert addresses == [f"#{name}" for name in ("group0", *of_run)]
    older = ["#through", "#errors", "#views", "#curves", "#group0"]
    for address in [*addresses, *older]:
        if address in older:
            shown.run("location.hash = arguments[0]", address)
        else:
            shown.run("document.querySelector(`.tabs a[href='${arguments[0]}']`).click()", address)
        shown.wait(
            "location.hash === arguments[0] && "
            "document.querySelector(arguments[0]).checkVisibility()",
            address,
        )
        shown.wait(
            "(top => top < 80 || scrollY + innerHeight >= document.documentElement.scrollHeight - "
            "2)(document.querySelector(arguments[0]).getBoundingClientRect().top)",
            address,
        )


OPENED = """(parts => parts.map(part => [0, 1].map(() => {
    part.firstElementChild.click();
    return [part.open, part.lastElementChild.checkVisibility()];
})))([...document.querySelectorAll('details:not(.caption)')].filter(part => part.checkVisibility()))"""  # noqa: E501


@pytest.mark.parametrize(
    "size", [(1400, 900), (1000, 900), PHONE], ids=["desktop", "narrow", "phone"]
)
def test_long_captions_are_two_lines_until_they_are_opened(started, painted, size):
    """What is longer is behind "more", by a click; the plot of quality and time is next to the list
    of methods, not below it.
    """
    started.visit(painted, size, place="#results")
    lines = (
        "[...document.querySelectorAll('details.caption')].filter(one => one.checkVisibility())"
        ".map(one => one.querySelector('span').clientHeight / "
        "parseFloat(getComputedStyle(one).lineHeight))"
    )
    folded = started.run(lines)
    assert folded
    assert max(folded) <= 2.1
    started.run("document.querySelector('#results details.caption > summary').click()")
    assert max(started.run(lines)) > 2.1
    started.visit(painted, size)
    top = "document.querySelector('%s').getBoundingClientRect().y"
    plot, standings = (started.run(top % name) for name in (".over-time", ".standings"))
    assert (abs(plot - standings) < 40) == (size != PHONE)


def test_each_part_opens_and_closes(shown):
    """Every part that is folded away shows what is in it when its head is clicked, and hides it the
    next time; by keys too.
    """
    opened = []
    for sheet in range(shown.run("document.querySelectorAll('.tabs a').length")):
        shown.run("document.querySelectorAll('.tabs a')[arguments[0]].click()", sheet)
        opened += shown.run(OPENED)
    assert len(opened) > 10
    assert all(
        first[0] != second[0] and is_open == is_seen
        for first, second in opened
        for is_open, is_seen in (first, second)
    )
    part = "#measured details"
    shown.run("document.querySelector('a[href=\"#measured\"]').click()")
    is_open = "document.querySelector(arguments[0]).open"
    shown.click(f"{part} summary", 0.02)
    assert shown.run(is_open, part)
    shown.press("\ue007")
    assert not shown.run(is_open, part)
