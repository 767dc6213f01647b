"""The viewer in a real browser: pictures come, the camera moves them, methods are chosen, errors
are messages in the page.
"""

import time
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from ggvs_eval.contrib.view.live_view import LiveView
from ggvs_eval.contrib.view.session import ViewDefaults
from ggvs_eval.contrib.view.viewer import Listener, Viewer, export_page
from ggvs_eval.pipelines.run.suggest_protocol import suggest_protocol
from helpers.browser import DESKTOP

pytestmark = pytest.mark.slow  # WebGL by software

CANVAS = "canvas"


@pytest.fixture
def page(playback, started, tmp_path):
    """The viewer's page, opened, with its first picture."""
    pytest.importorskip("viser")
    defaults = ViewDefaults(
        "ours-geometric",
        ("ours-geometric", "no-blending"),
        2,
        suggest_protocol(playback.capture),
        tmp_path,
    )
    listener = Listener(port=0)
    with Viewer(playback, defaults, listener) as viewer:
        started.resize(DESKTOP)
        started.driven.get(listener.address)
        started.wait("document.body.innerText.includes('frames per second')", seconds=60)
        yield started, viewer


@pytest.fixture(autouse=True)
def _quiet(started):
    """What viser's page says on the console - software rendering warns of itself - is no complaint
    of the tests that follow.
    """
    yield
    started.driven.get("about:blank")
    started.complaints()


def session_of(viewer: Viewer):
    (session,) = viewer._sessions.values()
    return session


def picture_of(browser) -> np.ndarray:
    """What the browser shows left of the controls, (h, w, 3)."""
    shown = Image.open(BytesIO(browser.driven.get_screenshot_as_png())).convert("RGB")
    return np.asarray(shown.crop((320, 0, shown.width // 2, shown.height)), np.int16)


def test_dragging_moves_the_picture(page):
    """The pose that is synthesised follows the mouse, and what the browser shows is another picture
    then.
    """
    browser, viewer = page
    recording, before = session_of(viewer).recording, picture_of(browser)
    recording.toggle()
    browser.drag(CANVAS, (0.4, 0.5), (0.6, 0.5))
    end = time.monotonic() + 60
    while (
        len({tuple(request.pose.centre.round(3)) for request in recording.requests}) < 2
        and time.monotonic() < end
    ):
        time.sleep(0.1)
    centres = {tuple(request.pose.centre.round(3)) for request in recording.requests}
    assert len(centres) > 1
    while (
        changed := float(np.abs(picture_of(browser) - before).mean())
    ) < 4 and time.monotonic() < end:
        time.sleep(0.1)
    assert changed >= 4


def test_outside_of_the_rig_is_said_and_left_by_a_key(page):
    """Far beside the cameras the page says so; R goes back to where the window opened."""
    browser, viewer = page
    session = session_of(viewer)
    opened = session.client.camera.position.copy()
    session.client.camera.position = opened + np.array([4.0, 0.0, 0.0])
    session.change()
    browser.wait('document.body.innerText.includes("outside the cameras\' coverage")', seconds=60)
    # one thing at a time
    assert not browser.run("document.body.innerText.includes('of what its sources see')")
    browser.run("document.activeElement.blur()")
    browser.press("r")
    browser.wait('!document.body.innerText.includes("outside the cameras\' coverage")', seconds=60)
    assert np.abs(session.client.camera.position - opened).max() < 1e-3


def test_a_camera_that_was_dragged_away_comes_back_within_reach(page):
    """The picture is of the nearest place within reach, the window's camera follows once it rests;
    no control moves.
    """
    browser, viewer = page
    session = session_of(viewer)
    leash, opened = session._leash, session.client.camera.position.copy()
    fields = (
        "[...document.querySelectorAll('input.mantine-TextInput-input')].map(one => "
        "one.getBoundingClientRect().top)"
    )
    before = browser.run(fields)
    session.client.camera.position = opened + np.array([0.0, 0.0, -30.0])
    session.change()
    assert np.linalg.norm(session._pose().centre - opened) < 31 - leash.reach
    end = time.monotonic() + 60
    while (
        np.abs(leash.keep(session.client.camera.position) - session.client.camera.position).max()
        > 1e-6
        and time.monotonic() < end
    ):
        time.sleep(0.1)
    distances = [
        np.linalg.norm(camera.centre - session.client.camera.position)
        for camera in viewer._playback.capture.cameras
    ]
    assert min(distances) <= leash.reach * 1.001
    assert browser.run(fields) == before


def test_an_unknown_method_is_a_message_in_the_page(page):
    """The page says what is known; a right label takes the message away."""
    browser, _ = page
    fields = browser.driven.find_elements("css selector", "input.mantine-TextInput-input")
    field = next(each for each in fields if each.is_displayed() and not each.get_attribute("value"))
    field.send_keys("no-blendin")
    browser.wait(
        "document.body.innerText.includes(\"unknown method 'no-blendin'; did you mean "
        'no-blending?")',
        seconds=30,
    )
    field.send_keys("g")
    browser.wait("document.body.innerText.includes('no-blending:')", seconds=30)
    assert not browser.run("document.body.innerText.includes('unknown method')")


def test_a_fault_in_one_picture_does_not_end_the_others(page, monkeypatch):
    """A bug of a method is a message in the page and on the terminal; the next picture comes as
    before.
    """
    browser, viewer = page
    with monkeypatch.context() as broken:
        broken.setattr(LiveView, "picture", lambda *_: 1 / 0)
        session_of(viewer).change()
        browser.wait("document.body.innerText.includes('ZeroDivisionError')", seconds=30)
    session_of(viewer).change()
    browser.wait("!document.body.innerText.includes('ZeroDivisionError')", seconds=30)
    assert all(thread.is_alive() for thread in viewer._threads)


def test_the_exported_page_needs_no_server(playback, started, tmp_path):
    """It draws the scene from the file alone; the browser of these tests reaches no network."""
    pytest.importorskip("viser")
    export_page(playback, [0, 1], tmp_path / "view.html", Listener(port=0))
    started.driven.get((tmp_path / "view.html").as_uri())
    started.wait("document.querySelector('canvas') !== null", seconds=60)
    assert [entry for entry in started.complaints() if "SEVERE" in entry] == []
