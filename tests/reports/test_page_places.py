"""Addresses, tabs and the first screen of the page in a real browser."""

from dataclasses import replace

import pytest

from ggvs_eval.protocol import Frames
from helpers.browser import PHONE
from helpers.painted_page import RED, SHAPE, STAGE, clock, paint, show_part, write_page
from helpers.run_folders import LABELS, write_run

pytestmark = pytest.mark.slow  # the page of three runs takes three seconds
RIVAL, MAIN = LABELS[:2]  # a baseline and ours, of which the third is a variant


@pytest.fixture(scope="module")
def rooms(tmp_path_factory):
    """A page of three runs: two scenes under one protocol, and a third under another."""
    folder = tmp_path_factory.mktemp("rooms")
    shapes = {
        "attic": replace(SHAPE, scene="attic", metrics=("PSNR",), poses=2),
        "cellar": replace(SHAPE, scene="cellar", metrics=("PSNR",), poses=2),
        "living room/2": replace(
            SHAPE, scene="living room/2", frames=Frames(0, 3), metrics=("PSNR",), poses=2
        ),
    }
    runs = [
        write_run(folder / str(number), shape, paint)
        for number, shape in enumerate(shapes.values())
    ]
    return write_page(runs, folder / "index.html")


def visible_viewers(browser) -> list[str]:
    """Addresses of the rooms whose viewer can be seen."""
    return browser.run(
        "[...document.querySelectorAll('.viewer')].filter(one => one.checkVisibility()).map(one => "
        "one.dataset.address)"
    )


def pixel(browser) -> str:
    """What the visible viewer says of its pixel."""
    return browser.run("[...document.querySelectorAll('.viewer')].find(one => "
                       "one.checkVisibility())"
                       ".querySelector('[data-role=place]').textContent")  # fmt: skip


def test_an_address_opens_room_view_frame_and_pixel(started, rooms):
    """`#room/view/frame/x,y` shows that room alone, its viewer in sight at that view, frame and
    pixel.
    """
    started.visit(rooms, place="#living-room-2/cam03/1/120,88")
    assert visible_viewers(started) == ["living-room-2"]
    viewer = "[...document.querySelectorAll('.viewer')].find(one => one.checkVisibility())"
    assert started.run(f"{viewer}.querySelector('[data-role=view]').value") == "cam03"
    assert started.run(f"{viewer}.querySelector('[data-role=clock]').textContent").startswith(
        "frame 1 of 0–2"
    )
    assert pixel(started) == "pixel x 120, y 88"
    assert started.run(
        f"(box => box.top >= 0 && box.top < innerHeight)({viewer}.getBoundingClientRect())"
    )
    assert (
        started.run("document.querySelector('.rooms [aria-current]').textContent")
        == "living room/2"
    )
    assert started.complaints() == []


def test_moving_about_keeps_the_address(shown):
    """View, frame and pixel are in the address as soon as they rest; it grows no history, and opens
    the same place again.
    """
    assert shown.run("location.hash") == ""
    entries = shown.run("history.length")
    shown.click(STAGE, 0.25, 0.75)
    shown.focus(STAGE)
    shown.press("v", "\ue014", "\ue014", "d")
    shown.wait("location.hash === arguments[0]", "#room/cam03/4/41,90")
    assert shown.run("history.length") == entries
    shown.run("location.hash = '#results'")
    shown.wait("document.getElementById('results').checkVisibility()")
    shown.run("location.hash = '#room/cam03/4/41,90'")
    shown.wait("document.querySelector('.stage').checkVisibility()")
    assert clock(shown).startswith("frame 4 of")
    assert pixel(shown) == "pixel x 41, y 90"


@pytest.mark.parametrize(
    "place",
    [
        "#room",
        "#room/cam99/99/9999,9999",
        "#room/cam03",
        "#room/cam03/x/1",
        "#nowhere/cam03/2/1,1",
        "#%E0%A4%A",
        "#room//2/",
        "#/",
    ],
)
def test_a_broken_address_is_no_broken_page(started, painted, place):
    """What an address lacks or what does not exist is left at what is there; the page works all the
    same.
    """
    started.visit(painted, place=place)
    assert visible_viewers(started) == ["room"]
    view = "document.querySelector('[data-role=view]').value"
    assert started.run(view) == (
        "cam03" if "/cam03" in place and "nowhere" not in place else "cam00"
    )
    assert clock(started).startswith("frame 5 of" if "/99/" in place else "frame 2 of")
    started.focus(STAGE)
    started.press("\ue012")
    assert clock(started).startswith("frame 4 of" if "/99/" in place else "frame 5 of")
    assert started.complaints() == []


def test_one_room_and_one_part_at_a_time(started, rooms):
    """Tabs show one room and one part of it; a scene of a shared protocol is chosen by its tab, an
    old place by its name.
    """
    started.visit(rooms)
    assert visible_viewers(started) == ["attic"]
    started.click(".rooms a:nth-child(2)")
    assert visible_viewers(started) == ["cellar"]
    assert started.run("document.querySelector('.opening:not([hidden])').dataset.of") == "run1"
    show_part(started, "group0-heat")
    assert (
        started.run(
            "[...document.querySelectorAll('.heats')].filter(one => one.checkVisibility()).length"
        )
        == 1
    )
    started.run("location.hash = '#group1-results'")
    started.wait("document.getElementById('group1-results').checkVisibility()")
    assert not started.run("document.getElementById('group0-heat').checkVisibility()")
    started.run("history.back()")
    started.wait("document.getElementById('group0-heat').checkVisibility()")
    assert started.run("document.querySelector('.opening:not([hidden])').dataset.of") == "run1"
    assert started.complaints() == []


@pytest.mark.parametrize("size", [(1400, 900), PHONE], ids=["desktop", "phone"])
def test_the_first_screen_answers_and_shows(started, painted, size):
    """Without scrolling: who is best, by how much, what was recorded beside the best and the
    runner-up, and the button.
    """
    started.visit(painted, size)
    parts = "[...document.querySelectorAll('.headline, .margin, .opening figure > img, .player')]"
    assert max(started.run(f"{parts}.map(one => one.getBoundingClientRect().bottom)")) <= size[1]
    assert started.run("document.querySelector('.headline').textContent").startswith(
        "GGVS (online), geometric weights is best"
    )
    assert started.run(
        "[...document.querySelectorAll('.opening figure')].map(one => one.dataset.key)"
    ) == [
        "truth",
        MAIN,
        RIVAL,
    ]
    for number, label in enumerate(("truth", MAIN, RIVAL), start=1):
        assert (
            abs(
                started.colour(f".opening figure:nth-child({number}) img", 0.5, 0.5)[0] - RED[label]
            )
            < 12
        )
    assert started.run("document.documentElement.scrollHeight") < 5000


MOMENT = "document.querySelector('[data-role=moment]').textContent"


def test_the_first_screen_moves(started, painted):
    """It plays by itself through every frame of every view, enlarged as well, until the button; who
    asked for calm presses it.
    """
    started.visit(painted, moving=True)
    started.wait(f"{MOMENT} === 'cam03, frame 5'")
    started.wait(f"{MOMENT} === 'cam00, frame 2'")
    started.run("document.querySelector('[data-role=run]').click()")
    stopped = started.run(MOMENT)
    pairs = (
        "[...document.querySelectorAll('.opening figure')].map(one => "
        "[...one.querySelectorAll('img')].map(each => each.src))"
    )
    assert [len(sources) for sources in started.run(pairs)] == [2] * 3
    assert all(picture == enlarged for picture, enlarged in started.run(pairs))
    assert started.run("document.querySelector('[data-role=run]').ariaLabel") == "Play"
    assert (
        started.driven.execute_async_script(f"setTimeout(() => arguments[0]({MOMENT}), 400)")
        == stopped
    )
    started.visit(painted)
    assert (
        started.driven.execute_async_script(f"setTimeout(() => arguments[0]({MOMENT}), 400)")
        == "cam00, frame 2"
    )
    started.click("[data-role=run]")
    started.wait(f"{MOMENT} === 'cam03, frame 3'")
    assert started.complaints() == []


def test_a_picture_of_the_first_screen_opens_its_place(shown):
    """A click into one opens the viewer at that method, view, frame and pixel; so does the link,
    without a pixel.
    """
    shown.click(".opening figure:nth-child(3) img", 0.25, 0.5)
    assert shown.run("document.querySelector('[data-role=left]').value") == RIVAL
    x, y = (int(word.strip("xy ")) for word in pixel(shown).removeprefix("pixel ").split(","))
    assert abs(x - 40) <= 1
    assert abs(y - 60) <= 1
    shown.click("[data-role=closer-look]")
    shown.wait("document.querySelector('.stage').checkVisibility()")
    assert shown.run("document.activeElement.className").startswith("stage")


def test_everything_can_be_read_without_scripts(started, rooms):
    """Where scripts are off, nothing is hidden but what is folded, the first screen has its
    pictures, and links lead to parts.
    """
    started.driven.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": True})
    try:
        started.driven.get("about:blank")
        started.driven.get(rooms.resolve().as_uri())
        hidden = started.run("[...document.querySelectorAll('.sheet, section, table, figure')]"
                             ".filter(one => !one.closest('details:not([open])') && "
                             "!one.checkVisibility()).length")  # fmt: skip
        assert hidden == 0
        assert started.run("document.documentElement.classList.contains('loading')") is False
        assert started.run(
            "[...document.querySelectorAll('.opening img')].every(image => image.naturalWidth > 0)"
        )
        assert started.run(
            "[...document.querySelectorAll('.tabs a')].every(link => "
            "document.querySelector(link.hash))"
        )
    finally:
        started.driven.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": False})
