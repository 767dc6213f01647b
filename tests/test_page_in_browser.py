"""The page in a real browser: what somebody sees who clicks, drags and presses keys on it."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import browser as browsers
from browser import DESKTOP, PHONE, open_browser
from ggvs_eval.protocol import Frames
from ggvs_eval.reports.report import write_report
from run_folders import LABELS, RunShape, write_run

SHAPE = RunShape(width=160, height=120, frames=Frames(2, 4), dataset="DyNeRF", metrics=("PSNR", "L1", "TCC"))
RED = {label: 20 + 50 * number for number, label in enumerate(("truth", *LABELS))}
STAGE, SLICES = ".stage", ".cuts"


def paint(label: str, view: str, index: int) -> np.ndarray:
    """A picture whose colour says what it is of: red the method, green the row, blue the view and the frame or pose."""
    picture = np.zeros((SHAPE.height, SHAPE.width, 3), np.uint8)
    picture[..., 0] = RED[label]
    picture[..., 1] = 2 * np.arange(SHAPE.height)[:, None]
    picture[..., 2] = 20 * index + (120 if view == "cam03" else 0)
    return picture


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> Path:
    """The page of such a run."""
    return write_report([write_run(tmp_path_factory.mktemp("page") / "run", SHAPE, paint)])


@pytest.fixture(scope="module")
def started(tmp_path_factory):
    """One browser for all tests of this file."""
    with open_browser(tmp_path_factory.mktemp("browser")) as browser:
        yield browser


@pytest.fixture
def shown(started, page):
    """The page, freshly opened at desktop width; a test that makes it complain fails."""
    started.visit(page)
    yield started
    assert started.complaints() == []


def wait_for_slices(browser) -> None:
    """Bring the slices into sight and wait until they are drawn."""
    browser.run("document.querySelector(arguments[0]).scrollIntoView({block: 'center', behavior: 'instant'})", SLICES)
    browser.wait("document.querySelector('.linked').getAttribute('aria-busy') === 'false'")


def names(browser, table: int = 0) -> list[str]:
    """First column of a table of results as it stands."""
    rows = "[...document.querySelectorAll('#results table')[arguments[0]].tBodies[0].rows]"
    return browser.run(f"{rows}.map(row => row.cells[0].textContent)", table)


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("size", [DESKTOP, PHONE], ids=["desktop", "phone"])
def test_fits_and_loads_nothing(started, page, size, dark):
    """On a desktop and on a phone, light and dark: no sideways scrolling, nothing loaded, no broken picture, no complaint."""
    started.visit(page, size, dark)
    assert started.run("document.documentElement.scrollWidth") <= size[0]
    assert started.run("performance.getEntriesByType('resource').filter(e => !e.name.startsWith('data:')).length") == 0
    assert started.wait("[...document.querySelectorAll('img[src]')].every(image => image.complete && image.naturalWidth > 0)")
    paper = [int(n) for n in re.findall(r"\d+", started.run("getComputedStyle(document.body).backgroundColor"))]
    assert max(paper) < 40 if dark else min(paper) > 240
    assert started.complaints() == []


def is_dark(browser) -> bool:
    """Whether the page is dark, read from what lies behind its text."""
    return max(int(n) for n in re.findall(r"\d+", browser.run("getComputedStyle(document.body).backgroundColor"))) < 40


def test_theme_is_switched_by_keyboard_and_kept(started, page):
    """Radio buttons show the page dark, light or as the system is, by arrow keys too; a choice outlives the page."""
    started.visit(page)
    try:
        started.run("document.querySelector('.theme input:checked').focus()")
        assert started.run("document.activeElement.value") == "system"
        started.press("\ue013")
        assert (started.run("document.activeElement.value"), is_dark(started)) == ("dark", True)
        started.visit(page)
        assert (started.run("document.querySelector('.theme input:checked').value"), is_dark(started)) == ("dark", True)
        started.click(".theme input[value=light]")
        started.visit(page, dark=True)
        assert not is_dark(started)
        started.click(".theme input[value=system]")
        assert is_dark(started)
    finally:
        started.run("localStorage.clear()")
    assert started.complaints() == []


def test_theme_needs_no_storage(started, page):
    """Where the browser lets a page from disk keep nothing, the switch works until the page is closed, without complaint."""
    refuse = "Object.defineProperty(window, 'localStorage', {get() { throw new DOMException('refused', 'SecurityError'); }})"
    added = started.driven.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": refuse})
    try:
        started.visit(page)
        started.click(".theme input[value=dark]")
        assert is_dark(started)
        started.visit(page)
        assert not is_dark(started)
    finally:
        started.driven.execute_cdp_cmd("Page.removeScriptToEvaluateOnNewDocument", added)
    assert started.complaints() == []


@pytest.mark.parametrize(
    "shape",
    [
        RunShape(frames=Frames(0, 1), metrics=("PSNR", "TCC"), poses=0),
        RunShape(metrics=("STED",), path_truth=False),
        RunShape(labels=LABELS[:1], views=("cam00",), metrics=("PSNR",)),
    ],
    ids=["one frame, no path", "no value per frame, virtual path", "one method, one view"],
)
def test_poor_runs_have_a_working_page(started, tmp_path, shape):
    """Whatever a run lacks, its page works without a complaint, and says what there is not."""
    started.visit(write_report([write_run(tmp_path / "run", shape)]))
    wait_for_slices(started)
    assert ("one frame only" in started.text(".cuts")) == (shape.frames.count == 1)
    assert ("no truth on a virtual path" in started.text(".cuts")) == (not shape.path_truth)
    assert ("No metric of this run has a value per frame" in started.text("#heat")) == (shape.metrics == ("STED",))
    started.run("document.querySelector('.stage').focus()")
    started.press("v", "b", "m", "d", "+", "0", "\ue014")
    assert started.text("[data-role=clock]").startswith(f"frame {shape.frames.start + (shape.frames.count > 1)} of")
    assert started.complaints() == []


def test_each_group_of_a_page_has_a_viewer_of_its_own(started, tmp_path):
    """Two protocols on one page: the contents lead to a group, its controls and the keys move its viewer and not the other's."""
    shapes = (replace(SHAPE, metrics=("PSNR",), poses=2), replace(SHAPE, frames=Frames(0, 3), metrics=("PSNR",), poses=2))
    runs = [write_run(tmp_path / str(number), shape, paint) for number, shape in enumerate(shapes)]
    started.visit(write_report(runs, tmp_path / "report"))
    clocks = "[...document.querySelectorAll('[data-role=clock]')].map(clock => clock.textContent.slice(0, 14))"
    assert started.run(clocks) == ["frame 2 of 2–5", "frame 0 of 0–2"]
    started.run("document.querySelector('.contents tbody tr:nth-child(2) a').click()")
    assert started.run("location.hash") == "#group1"
    started.wait("Math.abs(document.getElementById('group1').getBoundingClientRect().top) < 60")
    started.run("document.querySelectorAll('.stage')[1].focus()")
    started.press("\ue014", "v")
    assert started.run(clocks) == ["frame 2 of 2–5", "frame 1 of 0–2"]
    assert started.run("[...document.querySelectorAll('[data-role=view]')].map(view => view.value)") == ["cam00", "cam03"]
    started.click("#group1-heat .cells", 0.9, 0.25)
    assert started.run(clocks) == ["frame 2 of 2–5", "frame 2 of 0–2"]
    assert started.run("document.documentElement.scrollWidth") <= DESKTOP[0]
    assert started.run("document.querySelectorAll('.contents .sort').length") == 0
    assert started.complaints() == []


def test_divider_wipes_between_the_pictures(shown):
    """Left of the divider lies the left picture, right of it the right one; dragging the divider moves the border."""
    shown.choose("[data-role=left]", "no-blending")
    assert abs(shown.colour(STAGE, 0.3, 0.4)[0] - RED["no-blending"]) < 12
    assert abs(shown.colour(STAGE, 0.7, 0.4)[0] - RED["truth"]) < 12
    shown.drag(STAGE, (0.5, 0.6), (0.15, 0.6))
    assert abs(shown.colour(STAGE, 0.3, 0.4)[0] - RED["truth"]) < 12
    assert abs(shown.colour(STAGE, 0.05, 0.4)[0] - RED["no-blending"]) < 12


def test_blink_shows_one_picture_at_a_time(shown):
    """In blink mode the whole stage shows the left picture, then the whole stage the right one."""
    shown.choose("[data-role=left]", "no-blending")
    shown.click("input[value=blink]")
    for is_second, label in ((True, "truth"), (False, "no-blending")):
        shown.wait("document.querySelector('.stage').classList.contains('second') === arguments[0]", is_second)
        shown.run("document.querySelector('.stage').classList.toggle('second', arguments[0])", is_second)
        colours = [shown.run("getComputedStyle(document.querySelector('.over')).visibility")]
        assert colours == ["visible" if label == "truth" else "hidden"]
    assert shown.run("getComputedStyle(document.querySelector('.divider')).visibility") == "hidden"


def test_two_and_all_stand_beside_each_other(shown):
    """`two` shows the chosen two pictures side by side, `all` the truth and every method."""
    counted = "[...document.querySelectorAll('[data-role=all] figure')].filter(f => f.offsetParent).map(f => f.dataset.key)"
    shown.choose("[data-role=left]", "no-blending")
    shown.click("input[value=two]")
    assert shown.run(counted) == ["truth", "no-blending"]
    shown.click("input[value=all]")
    assert shown.run(counted) == ["truth", *LABELS]


def test_time_moves_picture_clock_and_curves(shown):
    """Arrow keys on the stage step through time: picture, clock, scrubber and the cursors of all curves go along."""
    before = shown.run("document.querySelector('.plots .cursor').getAttribute('x1')")
    shown.find(STAGE).send_keys("")
    shown.run("document.querySelector('.stage').focus()")
    shown.press("\ue014", "\ue014")
    assert shown.text("[data-role=clock]").startswith("frame 4 of 2–5")
    assert shown.run("document.querySelector('[data-role=frame]').value") == "2"
    assert abs(shown.colour(STAGE, 0.7, 0.4)[2] - 20 * 4) < 12
    assert shown.run("document.querySelector('.plots .cursor').getAttribute('x1')") != before
    shown.press(" ")
    shown.wait("!document.querySelector('[data-role=clock]').textContent.startsWith('frame 4')")


def test_click_cuts_its_row_over_viewpoints_and_time(shown):
    """A click chooses a row; each method's slices hold that row of its frames and of its path pictures, in their order."""
    shown.click(STAGE, 0.25, 0.75)
    wait_for_slices(shown)
    row = int(re.search(r"Row (\d+) of 120 in cam00", shown.text(".linked [data-role=row]"))[1])
    assert abs(row - 90) <= 1
    for number, label in enumerate(("truth", *LABELS)):
        epi, along = (f".cut:nth-child({3 * number + column} of .cuts > *) canvas" for column in (5, 6))
        for place in range(SHAPE.poses):
            assert np.abs(np.subtract(shown.canvas_colour(epi, 80, place), (RED[label], 2 * row, 20 * place))).max() < 12
        for place, frame in enumerate((2, 3, 4, 5)):
            assert np.abs(np.subtract(shown.canvas_colour(along, 80, place), (RED[label], 2 * row, 20 * frame))).max() < 12


def test_slices_follow_view_and_row(shown):
    """Another view, then another row by the keyboard, and the slices are those of that view and row."""
    wait_for_slices(shown)
    shown.choose("[data-role=view]", "cam03")
    shown.run("document.querySelector('.stage').focus()")
    before = int(re.search(r"Row (\d+)", shown.text(".linked [data-role=row]"))[1])
    shown.press("S", "s", "s")
    wait_for_slices(shown)
    assert shown.text(".linked [data-role=row]") == f"Row {before + 12} of 120 in cam03"
    shown.wait("Math.abs(document.querySelector('.along canvas').dataset.share * 120 - arguments[0] - 0.5) < 0.01", before + 12)
    assert np.abs(np.subtract(shown.canvas_colour(".along canvas", 80, 0), (RED["truth"], 2 * (before + 12), 160))).max() < 12


def test_click_into_a_slice_or_a_curve_goes_to_that_frame(shown):
    """Time runs downwards in a slice and to the right in a curve; a click there shows that frame in the viewer."""
    wait_for_slices(shown)
    shown.click(".along", 0.5, 0.6)
    assert shown.text("[data-role=clock]").startswith("frame 4 of")
    assert shown.text(".linked .values b") != "–"
    shown.click(".linked .plot svg", 0.98, 0.5)
    assert shown.text("[data-role=clock]").startswith("frame 5 of")


def test_heat_map_opens_the_frame_of_a_cell(shown):
    """A click into the second row, third column of the first method's map shows cam03, frame 4, that method beside the truth."""
    shown.click(".cells", 0.6, 0.75)
    assert shown.run("[...document.querySelectorAll('.viewer select')].map(s => s.value)") == ["cam03", LABELS[0], "truth"]
    assert shown.text("[data-role=clock]").startswith("frame 4 of")
    assert shown.run("document.activeElement.className").startswith("stage")
    assert re.fullmatch(r"No Blending, cam03, frame 4: PSNR [\d.]+ dB", shown.text("[data-role=cell]"))


def test_heat_map_by_keyboard(shown):
    """Arrow keys choose a cell of a focused map and say what it holds, the enter key opens it."""
    shown.run("document.querySelectorAll('.cells')[1].focus()")
    shown.press("\ue015", "\ue014")
    assert shown.text("[data-role=cell]").startswith("Ours (geometric weights), cam03, frame 3: PSNR")
    shown.press("\ue007")
    assert shown.text("[data-role=clock]").startswith("frame 3 of")


def test_heat_map_is_brighter_where_it_is_worse(shown):
    """In both directions of metrics the worst cells are brighter than the best ones; a cell without a value is empty."""
    for metric in ("PSNR", "L1"):
        shown.choose(".heats [data-role=metric]", metric)
        worst, best = (sum(shown.canvas_colour(f".heat:nth-child({number}) canvas", 1, 0)) for number in (1, 3))
        assert worst > best + 100
    shown.choose(".heats [data-role=metric]", "TCC")
    alpha = "document.querySelector('.cells canvas').getContext('2d').getImageData(arguments[0], 0, 1, 1).data[3]"
    assert [shown.run(alpha, frame) for frame in (0, 1)] == [0, 255]


def test_zoom_is_shared_by_all_pictures(shown):
    """Plus zooms every picture at the chosen pixel and dragging moves them together; `fit` shows the whole again."""
    pictures = "[...document.querySelectorAll('.picture .placed')].filter(e => e.offsetParent)"
    placed = f"[...new Set({pictures}.map(e => new DOMMatrix(getComputedStyle(e).transform).a))]"
    shown.click(STAGE, 0.2, 0.2)
    shown.run("document.querySelector('.stage').focus()")
    shown.press("+", "+")
    assert shown.run(placed) == [2.25]
    green = shown.colour(STAGE, 0.7, 0.8)[1]
    shown.drag(STAGE, (0.8, 0.9), (0.8, 0.4))
    assert shown.colour(STAGE, 0.7, 0.8)[1] > green + 30
    shown.click("[data-role=fit]")
    assert shown.run(placed) == [1]


def test_pixel_is_the_one_under_the_pointer_when_zoomed(shown):
    """A click into a zoomed picture chooses the pixel that is seen there."""
    shown.run("document.querySelector('.stage').focus()")
    shown.press("+", "+", "+", "+")
    green = shown.colour(STAGE, 0.9, 0.8)[1]
    shown.click(STAGE, 0.9, 0.8)
    y = int(re.search(r"y (\d+)", shown.text("[data-role=place]"))[1])
    assert abs(green - 2 * y) < 8


def test_two_fingers_zoom(started, page):
    """On a phone two fingers that move apart zoom the pictures."""
    started.visit(page, PHONE)
    started.pinch(STAGE, 2.0)
    zoom = started.run("Number(getComputedStyle(document.querySelector('.viewer')).getPropertyValue('--zoom'))")
    assert 1.6 < zoom < 2.4
    assert started.complaints() == []


def test_videos_play(shown):
    """The page carries a video of the truth and of each method that this browser can decode and play."""
    videos = "[...document.querySelectorAll('#videos video')]"
    assert shown.run(f"{videos}.length") == 1 + len(LABELS)
    shown.wait(f"{videos}.every(video => video.readyState >= 1 && video.videoWidth === 160)")
    shown.run(f"{videos}[1].play()")
    shown.wait(f"{videos}[1].currentTime > 0 && !{videos}[1].error")


def test_tables_sort_best_first(shown):
    """A click on a head puts the best first, a second the worst, a third the old order; published rows stay last."""
    original = names(shown)
    grey = original[len(LABELS) :]
    assert grey
    for sorts, state in ((original[:3][::-1], "descending"), (original[:3], "ascending"), (original[:3], "none")):
        shown.click("#results thead th:nth-child(2) .sort")
        assert names(shown) == [*sorts, *grey]
        assert shown.run("document.querySelector('#results thead th:nth-child(2)').getAttribute('aria-sort')") == state


def test_everything_is_reached_by_the_tab_key(shown):
    """Tab alone reaches heads of tables, heat maps, the stage, the scrubber and the zoom; what has the focus can be seen to."""
    reached = set()
    for _ in range(110):
        shown.press("\ue004")
        reached.add(shown.run("document.activeElement.className + '|' + (document.activeElement.dataset.role ?? '')"))
        assert shown.run("getComputedStyle(document.activeElement).outlineStyle") != "none"
        if "|fit" in reached and "|frame" in reached:
            break
    assert {"sort|", "cells|", "stage picture|", "|frame", "|view", "|closer"} <= reached


@pytest.mark.parametrize("promise", ["GGVS_BROWSER", ""])
def test_absent_browser_is_never_silent(monkeypatch, promise):
    """Where a browser is promised its absence fails with the line to run; elsewhere it skips with the same line."""
    monkeypatch.delenv("GGVS_BROWSER", raising=False)
    if promise:
        monkeypatch.setenv(promise, "1")
    monkeypatch.setattr(browsers.shutil, "which", lambda name: None)
    expected = pytest.fail.Exception if promise else pytest.skip.Exception
    with pytest.raises(expected, match="apt-get install --no-install-recommends chromium chromium-driver"):
        browsers.find_browser()
