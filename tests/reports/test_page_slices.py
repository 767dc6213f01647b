"""The row of a clicked pixel in a real browser: its slices over viewpoints and time, and the curves
beside them.
"""

import re

import numpy as np

from helpers.painted_page import RED, SHAPE, STAGE, clock, show_part, wait_for_slices
from helpers.run_folders import LABELS


def test_click_cuts_its_row_over_viewpoints_and_time(shown):
    """A click chooses a row; each method's slices hold that row of its frames and of its path
    pictures, in their order.
    """
    shown.click(STAGE, 0.25, 0.75)
    wait_for_slices(shown)
    row = int(re.search(r"Row (\d+) of 120 in cam00", shown.text(".linked [data-role=row]"))[1])
    assert abs(row - 90) <= 1
    for number, label in enumerate(("truth", *LABELS)):
        epi, along = (
            f".cut:nth-child({3 * number + column} of .cuts > *) canvas" for column in (5, 6)
        )
        for place in range(SHAPE.poses):
            assert (
                np.abs(
                    np.subtract(
                        shown.canvas_colour(epi, 80, place), (RED[label], 2 * row, 20 * place)
                    )
                ).max()
                < 12
            )
        for place, frame in enumerate((2, 3, 4, 5)):
            assert (
                np.abs(
                    np.subtract(
                        shown.canvas_colour(along, 80, place), (RED[label], 2 * row, 20 * frame)
                    )
                ).max()
                < 12
            )


def test_slices_follow_view_and_row(shown):
    """Another view and row, and the slices are those; another metric, and the curves and values
    beside them are its own.
    """
    wait_for_slices(shown)
    shown.choose("[data-role=view]", "cam03")
    shown.focus(STAGE)
    before = int(re.search(r"Row (\d+)", shown.text(".linked [data-role=row]"))[1])
    shown.press("S", "s", "s")
    wait_for_slices(shown)
    assert shown.text(".linked [data-role=row]") == f"Row {before + 12} of 120 in cam03"
    shown.wait(
        "Math.abs(document.querySelector('.along canvas').dataset.share * 120 - arguments[0] - "
        "0.5) < 0.01",
        before + 12,
    )
    assert (
        np.abs(
            np.subtract(
                shown.canvas_colour(".along canvas", 80, 0), (RED["truth"], 2 * (before + 12), 160)
            )
        ).max()
        < 12
    )
    assert shown.run("document.querySelector('.linked .plot svg').dataset.metric") == "PSNR"
    assert shown.text(".linked .values b").endswith(" dB")
    shown.choose(".linked [data-role=metric]", "L1")
    assert shown.run("document.querySelector('.linked .plot svg').dataset.metric") == "L1"
    drawn, listed = (
        "[...document.querySelectorAll(arguments[0])].map(one => one.textContent)",
        ".linked .values b",
    )
    values = shown.run(drawn, listed)
    assert len(values) == len(LABELS)
    show_part(shown, "heat")
    shown.choose(".heats [data-role=metric]", "L1")
    shown.point(".cells", 0.1, 0.75)
    assert shown.text("[data-role=cell]").endswith(f"L1 {values[0]}")


def test_click_into_a_slice_or_a_curve_goes_to_that_frame(shown):
    """Time runs downwards in a slice and to the right in a curve; a click there shows that frame in
    the viewer.
    """
    wait_for_slices(shown)
    shown.click(".along", 0.5, 0.6)
    assert clock(shown).startswith("frame 4 of")
    assert shown.text(".linked .values b") != "–"
    shown.click(".linked .plot svg", 0.98, 0.5)
    assert clock(shown).startswith("frame 5 of")


def test_a_curve_opens_its_view_and_frame(shown):
    """A click into a curve further down brings the viewer into sight with that view and frame."""
    show_part(shown, "heat")
    plots = "#curves details:nth-of-type(1) .plot:nth-child(2) svg"
    assert shown.run("document.querySelector(arguments[0]).dataset.view", plots) == "cam03"
    shown.click(plots, 0.97, 0.5)
    assert clock(shown).startswith("frame 5 of")
    assert shown.run("document.querySelector('[data-role=view]').value") == "cam03"
    assert shown.run("document.activeElement.className").startswith("stage")
    assert shown.run(
        "(box => box.top >= 0 && box.top < "
        "innerHeight)(document.querySelector('.viewer').getBoundingClientRect())"
    )
