"""The viewer in a real browser: two pictures compared, time, zoom and the chosen pixel, by mouse,
keys and fingers.
"""

import re

import numpy as np
import pytest

from ggvs_eval.pipelines.commands.main import run_command
from helpers.painted_page import RED, SHAPE, STAGE, clock, paint, write_page
from helpers.run_folders import LABELS, write_run


def test_divider_wipes_between_the_pictures(shown):
    """Left of the divider lies the left picture, right of it the right one; dragging the divider
    moves the border.
    """
    shown.choose("[data-role=left]", "no-blending")
    assert abs(shown.colour(STAGE, 0.3, 0.4)[0] - RED["no-blending"]) < 12
    assert abs(shown.colour(STAGE, 0.7, 0.4)[0] - RED["truth"]) < 12
    shown.drag(STAGE, (0.5, 0.6), (0.15, 0.6))
    assert abs(shown.colour(STAGE, 0.3, 0.4)[0] - RED["truth"]) < 12
    assert abs(shown.colour(STAGE, 0.05, 0.4)[0] - RED["no-blending"]) < 12


def test_blink_shows_one_picture_at_a_time(shown):
    """`blink` shows the left picture, then the right one; `two` both side by side, `all` the truth
    and every method.
    """
    shown.choose("[data-role=left]", "no-blending")
    shown.click("input[value=blink]")
    for is_second, label in ((True, "truth"), (False, "no-blending")):
        shown.wait(
            "document.querySelector('.stage').classList.contains('second') === arguments[0]",
            is_second,
        )
        shown.run(
            "document.querySelector('.stage').classList.toggle('second', arguments[0])", is_second
        )
        colours = [shown.run("getComputedStyle(document.querySelector('.over')).visibility")]
        assert colours == ["visible" if label == "truth" else "hidden"]
    assert shown.run("getComputedStyle(document.querySelector('.divider')).visibility") == "hidden"
    counted = (
        "[...document.querySelectorAll('[data-role=all] figure')].filter(f => "
        "f.offsetParent).map(f => f.dataset.key)"
    )
    shown.choose("[data-role=left]", "no-blending")
    shown.click("input[value=two]")
    assert shown.run(counted) == ["truth", "no-blending"]
    shown.click("input[value=all]")
    assert shown.run(counted) == ["truth", *LABELS]


def test_time_moves_picture_clock_and_curves(shown):
    """Arrow keys on the stage step through time: picture, clock, scrubber and the cursors of all
    curves go along.
    """
    before = shown.run("document.querySelector('.plots .cursor').getAttribute('x1')")
    shown.focus(STAGE)
    shown.press("\ue014", "\ue014")
    assert clock(shown).startswith("frame 4 of 2–5")
    assert shown.run("document.querySelector('[data-role=frame]').value") == "2"
    assert abs(shown.colour(STAGE, 0.7, 0.4)[2] - 20 * 4) < 12
    assert shown.run("document.querySelector('.plots .cursor').getAttribute('x1')") != before
    shown.press(" ")
    shown.wait("!document.querySelector('[data-role=clock]').textContent.startsWith('frame 4')")


def test_zoom_is_shared_by_all_pictures(shown):
    """Plus zooms every picture at the chosen pixel, dragging moves all; `fit` shows the whole; a
    click chooses what is seen.
    """
    pictures = "[...document.querySelectorAll('.picture .placed')].filter(e => e.offsetParent)"
    placed = f"[...new Set({pictures}.map(e => new DOMMatrix(getComputedStyle(e).transform).a))]"
    shown.click(STAGE, 0.2, 0.2)
    shown.focus(STAGE)
    shown.press("+", "+")
    assert shown.run(placed) == [2.25]
    green = shown.colour(STAGE, 0.7, 0.8)[1]
    shown.drag(STAGE, (0.8, 0.9), (0.8, 0.4))
    assert shown.colour(STAGE, 0.7, 0.8)[1] > green + 30
    shown.click("[data-role=fit]")
    assert shown.run(placed) == [1]
    shown.focus(STAGE)
    shown.press("+", "+", "+", "+")
    green = shown.colour(STAGE, 0.9, 0.8)[1]
    shown.click(STAGE, 0.9, 0.8)
    y = int(re.search(r"y (\d+)", shown.text("[data-role=place]"))[1])
    assert abs(green - 2 * y) < 8


def zoom_of(browser) -> float:
    """How much the pictures are enlarged."""
    return browser.run(
        "Number(getComputedStyle(document.querySelector('.viewer')).getPropertyValue('--zoom'))"
    )


def pixel(browser) -> tuple[int, int]:
    """The chosen pixel, x and y."""
    x, y = re.findall(r"[xy] (\d+)", browser.text("[data-role=place]"))
    return int(x), int(y)


def test_buttons_and_wheel_zoom(shown):
    """The buttons zoom in, out and back; the wheel zooms while ctrl is held, and scrolls the page
    without.
    """
    shown.click("[data-role=closer]")
    shown.click("[data-role=closer]")
    assert zoom_of(shown) == 2.25
    shown.click("[data-role=farther]")
    assert zoom_of(shown) == 1.5
    shown.turn_wheel(STAGE, -200, with_ctrl=True)
    assert zoom_of(shown) > 1.9
    shown.click("[data-role=fit]")
    place = shown.run("scrollY")
    shown.turn_wheel(STAGE, 200)
    shown.wait("scrollY !== arguments[0]", place)
    assert zoom_of(shown) == 1


def test_keys_move_the_chosen_pixel(shown):
    """W, a, s and d move the chosen pixel by one, with shift by ten; it stays in the picture."""
    shown.click(STAGE, 0.5, 0.4)
    x, y = pixel(shown)
    shown.focus(STAGE)
    for keys, moved in (
        ("d", (1, 0)),
        ("D", (11, 0)),
        ("a", (10, 0)),
        ("A", (0, 0)),
        ("s", (0, 1)),
        ("S", (0, 11)),
        ("wW", (0, 0)),
    ):
        shown.press(*keys)
        assert pixel(shown) == (x + moved[0], y + moved[1]), keys
    shown.press(*"W" * 13)
    assert pixel(shown) == (x, 0)


def test_keys_choose_view_mode_divider_and_zoom(shown):
    """V is the next view, m the next mode, b blinks or does not, shift and arrows move the divider,
    +, -, = and 0 zoom.
    """
    shown.focus(STAGE)
    views = [
        shown.press("v") or shown.run("document.querySelector('[data-role=view]').value")
        for _ in range(2)
    ]
    assert views == ["cam03", "cam00"]
    divider = "parseFloat(document.querySelector('.stage').style.getPropertyValue('--at'))"
    shown.press("\ue012", held="\ue008")
    assert shown.run(divider) == 48
    shown.press("\ue014", "\ue014", held="\ue008")
    assert shown.run(divider) == 52
    assert clock(shown).startswith("frame 2 of")
    shown.press("=", "+", "-")
    assert zoom_of(shown) == 1.5
    shown.press("0")
    assert zoom_of(shown) == 1
    mode = "document.querySelector('.viewer input[type=radio]:checked').value"
    modes = [shown.press(key) or shown.run(mode) for key in "bbb"]
    assert modes == ["blink", "wipe", "blink"]
    modes = [shown.press("m") or shown.run(mode) for _ in range(3)]
    assert modes == ["two", "all", "wipe"]


def test_button_plays_and_scrubber_goes_to_a_frame(shown):
    """The button plays and pauses, and says which; a place on the scrubber is a frame, by arrow
    keys too.
    """
    shown.click("[data-role=play]")
    assert shown.run("document.querySelector('[data-role=play]').ariaLabel") == "Pause"
    shown.wait("!document.querySelector('[data-role=clock]').textContent.startsWith('frame 2')")
    shown.click("[data-role=play]")
    assert shown.run("document.querySelector('[data-role=play]').ariaLabel") == "Play"
    shown.click("[data-role=frame]", 0.98)
    assert clock(shown).startswith("frame 5 of")
    shown.focus("[data-role=frame]")
    shown.press("\ue012")
    assert clock(shown).startswith("frame 4 of")
    assert abs(shown.colour(STAGE, 0.7, 0.4)[2] - 20 * 4) < 12


def test_both_sides_and_the_view_are_chosen(shown):
    """Each of the three lists changes what it names: the left picture, the right one, the view of
    both.
    """
    shown.choose("[data-role=left]", LABELS[0])
    shown.choose("[data-role=right]", LABELS[1])
    shown.choose("[data-role=view]", "cam03")
    for x, label in ((0.3, LABELS[0]), (0.7, LABELS[1])):
        red, _, blue = shown.colour(STAGE, x, 0.4)
        assert np.abs(np.subtract((red, blue), (RED[label], 120 + 20 * 2))).max() < 12
    assert [shown.text(f"[data-role={side}-name]") for side in ("left", "right")] == [
        "No Blending",
        "GGVS (online), geometric weights",
    ]


def test_pictures_beside_each_other_and_error_maps_take_the_pointer(shown):
    """In the grid and on an error map a click chooses the pixel, dragging moves all pictures,
    fingers and the wheel zoom.
    """
    shown.click("input[value=all]")
    for picture in (
        "[data-role=all] figure:nth-child(2) .picture",
        "#errors figure:nth-child(2) .picture",
    ):
        shown.click("[data-role=fit]")
        shown.click(picture, 0.25, 0.75)
        assert np.abs(np.subtract(pixel(shown), (40, 90))).max() <= 1
        shown.turn_wheel(picture, -300, with_ctrl=True)
        assert zoom_of(shown) > 1.5
        left = "Number(getComputedStyle(document.querySelector('.viewer')).getPropertyValue('--x'))"
        before = shown.run(left)
        shown.drag(picture, (0.5, 0.5), (0.4, 0.5))
        assert shown.run(left) > before + 0.03
        before = zoom_of(shown)
        shown.pinch(picture, 1.5)
        assert zoom_of(shown) > 1.2 * before


SHOWN = "document.querySelector('.stage [data-role=under]').src"


@pytest.mark.slow
def test_frames_at_full_size_lie_beside_the_page(started, tmp_path):
    """Where the screen has more pixels than the page's own picture, the frame on disk is shown; of
    a page alone, its own.
    """
    run = write_run(tmp_path / "run", SHAPE, paint)
    page = write_page([run], run / "report" / "index.html", standalone=False)
    started.visit(page)
    file = run / "renders" / "ours-geometric" / "cam00" / "0002.png"
    assert started.wait(f"{SHOWN} === arguments[0]", file.resolve().as_uri())
    assert (
        started.run("document.querySelector('.stage [data-role=under]').naturalWidth")
        == SHAPE.width
    )
    assert "full size" in started.text("[data-role=full]")
    started.focus(STAGE)
    started.press("\ue014")
    assert started.wait(f"{SHOWN} === arguments[0]", file.with_name("0003.png").resolve().as_uri())
    assert started.complaints() == []

    alone = tmp_path / "carried off" / "index.html"
    alone.parent.mkdir()
    alone.write_bytes(page.read_bytes())
    started.visit(alone)
    assert started.run(f"{SHOWN}.startsWith('data:')")
    assert started.text("[data-role=full]") == ""
    started.complaints()  # that the files are not there


def test_crops_are_chosen_by_eye(shown, painted):
    """`c` marks a square on every picture, what is seen of a zoomed one; the command that the page
    prints draws it.
    """
    shown.click(STAGE, 0.5, 0.5)
    shown.focus(STAGE)
    shown.press("c")
    side = round(0.16 * SHAPE.width)
    first = f"{round(SHAPE.width / 2 - side / 2)},{round(SHAPE.height / 2 - side / 2)},{side}"
    command = shown.text("[data-role=command]")
    assert command.startswith("ggvs-eval figure crops run crops --view cam00 --frame 2 --squares ")
    assert command.endswith(f",{side} --methods ours-geometric")
    assert (
        max(
            abs(a - b)
            for a, b in zip(
                *(map(int, each.split(",")) for each in (first, command.split()[10])), strict=True
            )
        )
        <= 1
    )
    shown.press("+", "+", "c", "v")
    words = shown.text("[data-role=command]").split()
    assert words[words.index("--view") + 1] == "cam03"
    assert int(words[words.index("--squares") + 2].split(",")[2]) == round(SHAPE.height / 2.25)
    assert shown.run("document.querySelectorAll('.stage .crop').length") == 2
    words[3:5] = [str(painted.parent / "run"), str(painted.parent / "crops.png")]
    run_command(words[1:])
    assert (painted.parent / "crops.png").stat().st_size > 1000
    shown.click("[data-role=no-crops]")
    assert shown.run("document.querySelectorAll('.crop').length") == 0
