"""A real browser for tests: Debian's Chromium without a window, driven by its own driver.

Nothing is installed here. Where a browser is promised (the environment variable GGVS_BROWSER is
set) its absence is a failure with the line to run, elsewhere the tests are skipped and say why.
"""

import importlib.util
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from PIL import Image

INSTALL = (
    "sudo apt-get install --no-install-recommends chromium chromium-driver && pip install "
    "'selenium>=4.30'"
)
DESKTOP, PHONE = (1280, 900), (390, 844)


def lacking_parts() -> list[str]:
    """What is not installed of what a real browser takes, by the names of the packages."""
    found = {"chromium": shutil.which("chromium"), "chromium-driver": shutil.which("chromedriver")}
    return [
        name
        for name, path in {**found, "selenium": importlib.util.find_spec("selenium")}.items()
        if not path
    ]


def find_browser() -> tuple[str, str]:
    """Paths of the browser and its driver; ends the test where there is none, as skipped or
    failed.
    """
    lacking = lacking_parts()
    if lacking:
        message = f"no real browser, {' and '.join(lacking)} not found; run: {INSTALL}"
        promised = os.environ.get("GGVS_BROWSER")
        pytest.fail(message, pytrace=False) if promised else pytest.skip(message)
    return str(shutil.which("chromium")), str(shutil.which("chromedriver"))


@contextmanager
def open_browser() -> Iterator["Browser"]:
    """Start a browser, which ends with the block and with it the folder of its files."""
    binary, driver = find_browser()
    from selenium import webdriver
    from selenium.webdriver.chrome.options import Options
    from selenium.webdriver.chrome.service import Service

    options = Options()
    options.binary_location = binary
    # Containers run as root, where Chromium's sandbox cannot start; the page under test is our own.
    # WebGL needs no GPU.
    for argument in (
        "--headless=new",
        "--no-sandbox",
        "--disable-dev-shm-usage",
        "--enable-unsafe-swiftshader",
    ):
        options.add_argument(argument)
    # Whatever the page asks of a network, it does not get.
    options.add_argument("--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    # Chromium opens a socket among its temporary files, whose path may have 107 bytes at most.
    with TemporaryDirectory(dir="/tmp", ignore_cleanup_errors=True) as profile:
        options.add_argument(f"--user-data-dir={profile}")
        driven = webdriver.Chrome(
            options=options, service=Service(driver, env=os.environ | {"TMPDIR": profile})
        )
        try:
            yield Browser(driven)
        finally:
            driven.quit()


class Browser:
    """What tests do with a page, in their words."""

    def __init__(self, driven) -> None:
        self.driven = driven

    def visit(
        self,
        page: Path,
        size: tuple[int, int] = DESKTOP,
        dark: bool = False,
        place: str = "",
        moving: bool = False,
    ) -> None:
        """Open a page from disk at a place (`#...`) in a window of a size (its inside, pixels),
        light or dark, moving or calm.
        """
        self.resize(size)
        # The driver scrolls to what it clicks on; a page that glides there has moved away from
        # under the next click.
        media = {
            "prefers-color-scheme": "dark" if dark else "light",
            "prefers-reduced-motion": "no-preference" if moving else "reduce",
        }
        features = [{"name": name, "value": value} for name, value in media.items()]
        self.driven.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
        # the same address again would be a reload, which scrolls back to where it was
        self.driven.get("about:blank")
        self.driven.get(page.resolve().as_uri() + place)
        self.wait(
            "document.readyState === 'complete' && [...document.images].every(image => "
            "image.complete)"
        )
        self._settle()

    def resize(self, size: tuple[int, int]) -> None:
        """Give the window a size (its inside, pixels); it keeps the size for the pages that
        follow.
        """
        width, height = size
        metrics = {
            "width": width,
            "height": height,
            "deviceScaleFactor": 1,
            "mobile": size == PHONE,
        }
        self.driven.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)

    def run(self, script: str, *arguments):
        """Value of a JavaScript expression; arguments are `arguments[0]`, ..."""
        return self.driven.execute_script(f"return {script}", *arguments)

    def find(self, selector: str):
        """The first element that a selector finds."""
        return self.driven.find_element("css selector", selector)

    def text(self, selector: str) -> str:
        """What the first element that a selector finds says, on the screen or not."""
        return self.run("document.querySelector(arguments[0]).textContent", selector)

    def click(self, selector: str, x: float = 0.5, y: float = 0.5) -> None:
        """Click at a place in an element, fractions of its box, with a real mouse event."""
        self.drag(selector, (x, y), (x, y))

    def drag(self, selector: str, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Press at one place in an element, move to another and release; fractions of its box."""
        box = self._box(selector)
        places = [
            {"x": box["x"] + x * box["width"], "y": box["y"] + y * box["height"]}
            for x, y in (start, end)
        ]
        self._mouse("mouseMoved", places[0])
        self._mouse("mousePressed", places[0], button="left", buttons=1, clickCount=1)
        if start != end:
            for share in (0.25, 0.5, 0.75, 1.0):
                between = {
                    axis: places[0][axis] + share * (places[1][axis] - places[0][axis])
                    for axis in "xy"
                }
                self._mouse("mouseMoved", between, button="left", buttons=1)
        self._mouse("mouseReleased", places[1], button="left", clickCount=1)
        self._settle()

    def _box(self, selector: str) -> dict[str, float]:
        """Bring an element to the middle of the window, and say where it lies in it."""
        script = (
            "(e => (e.scrollIntoView({block: 'center', behavior: 'instant'}), "
            "e.getBoundingClientRect().toJSON()))"
        )
        box = self.run(f"{script}(document.querySelector(arguments[0]))", selector)
        self._settle()
        return box

    def _settle(self) -> None:
        """Wait until the page has drawn twice: then it stands still, and has seen the events that
        were sent to it.
        """
        script = (
            "const done = arguments[0]; requestAnimationFrame(() => requestAnimationFrame(() "
            "=> done()))"
        )
        self.driven.execute_async_script(script)

    def _mouse(self, kind: str, place: dict[str, float], **more) -> None:
        self.driven.execute_cdp_cmd("Input.dispatchMouseEvent", {"type": kind, **place, **more})

    def press(self, *keys: str, held: str = "") -> None:
        """Press keys one after the other, wherever the focus is; another one may be held down
        meanwhile.
        """
        from selenium.webdriver.common.action_chains import ActionChains

        for key in keys:
            chain = ActionChains(self.driven)
            (
                chain.key_down(held).send_keys(key).key_up(held) if held else chain.send_keys(key)
            ).perform()
        self._settle()

    def focus(self, selector: str) -> None:
        """Put the focus on the first element that a selector finds."""
        self.run("document.querySelector(arguments[0]).focus()", selector)

    def turn_wheel(self, selector: str, down_px: float, with_ctrl: bool = False) -> None:
        """Turn the wheel above the middle of an element."""
        box = self._box(selector)
        middle = {"x": box["x"] + box["width"] / 2, "y": box["y"] + box["height"] / 2}
        self._mouse("mouseWheel", middle, deltaX=0, deltaY=down_px, modifiers=2 if with_ctrl else 0)
        self._settle()

    def point(self, selector: str, x: float, y: float) -> None:
        """Move the mouse to a place in an element without pressing, fractions of its box."""
        box = self._box(selector)
        self._mouse(
            "mouseMoved", {"x": box["x"] + x * box["width"], "y": box["y"] + y * box["height"]}
        )
        self._settle()

    def choose(self, selector: str, option: str) -> None:
        """Choose an option of a select by its value."""
        options = self.driven.find_elements("css selector", f"{selector} option")
        next(one for one in options if one.get_attribute("value") == option).click()

    def wait(self, script: str, *arguments, seconds: float = 10.0):
        """Wait until a JavaScript expression is true, and give it back; one that throws (a page
        without a body yet) is not.
        """
        from selenium.common.exceptions import JavascriptException
        from selenium.webdriver.support.wait import WebDriverWait

        waiting = WebDriverWait(
            self.driven, seconds, 0.05, ignored_exceptions=[JavascriptException]
        )
        return waiting.until(lambda _: self.run(script, *arguments), script)

    def complaints(self) -> list[str]:
        """Errors and warnings on the console since it was last asked; advice on how fast this test
        reads canvases is none.
        """
        entries = [
            entry
            for entry in self.driven.get_log("browser")
            if "willReadFrequently" not in entry["message"]
        ]
        return [entry["message"] for entry in entries if entry["level"] in ("SEVERE", "WARNING")]

    def pinch(self, selector: str, factor: float) -> None:
        """Put two fingers on the middle of an element and move them apart by a factor."""
        box = self._box(selector)
        middle = {"x": box["x"] + box["width"] / 2, "y": box["y"] + box["height"] / 2}
        for kind, half in (
            ("touchStart", 40.0),
            ("touchMove", 40.0 * factor**0.5),
            ("touchMove", 40.0 * factor),
        ):
            fingers = [
                {"x": middle["x"] + side * half, "y": middle["y"], "id": number}
                for number, side in enumerate((-1, 1))
            ]
            self.driven.execute_cdp_cmd(
                "Input.dispatchTouchEvent", {"type": kind, "touchPoints": fingers}
            )
        self.driven.execute_cdp_cmd(
            "Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []}
        )
        self._settle()

    def colour(self, selector: str, x: float, y: float) -> tuple[int, ...]:
        """Colour that the screen shows at a place in an element, fractions of its box: red, green,
        blue.
        """
        box = self._box(selector)
        picture = Image.open(BytesIO(self.driven.get_screenshot_as_png())).convert("RGB")
        return picture.getpixel(
            (int(box["x"] + x * box["width"]), int(box["y"] + y * box["height"]))
        )

    def canvas_colour(self, canvas: str, x: int, y: int) -> list[int]:
        """Colour of one pixel of a canvas: red, green, blue."""
        script = "[...document.querySelector(arguments[0]).getContext('2d').getImageData(arguments[1], arguments[2], 1, 1).data]"  # noqa: E501
        return self.run(script, canvas, x, y)[:3]

    def shoot(self, file: Path) -> None:
        """Write a picture of what the window shows."""
        self.driven.save_screenshot(str(file))
