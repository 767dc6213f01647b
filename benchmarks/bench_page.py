"""Page load time in a real browser, and time to switch method or view: of the demo's page, and of a
long run's.

``python -m benchmarks.bench_page`` or ``python -m benchmarks.bench_page PAGE``
"""

import sys
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np

# the browser and run folders made by hand are the tests' own
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from ggvs_eval.protocol import Frames
from ggvs_eval.reports.report import write_report
from helpers.browser import INSTALL, Browser, lacking_parts, open_browser  # type: ignore[import-not-found]
from helpers.run_folders import NAMES, RunShape, write_run  # type: ignore[import-not-found]

COMMAND = "python -m benchmarks.bench_page"
DEMO = Path("out/demo/report/index.html")
VIEWS, FRAMES, METHODS = 9, 100, 6  # the paper's DyNeRF protocol
WIDTH, HEIGHT = 480, 360
REPEATS = 5
OPEN_MS, SWITCH_MS = 1000.0, 100.0  # targets: what is felt as one go, and as at once
Figure = dict[str, Any]
# Runs before the page's own script: notes when the first picture of the viewer is displayed.
WATCH = """
document.addEventListener("load", (event) => {
  if (!event.target.closest?.(".stage")) return;
  requestAnimationFrame(() => { window.firstPictureMs ??= performance.now(); });
}, true);
"""
# Another choice of a select of the viewer; ends when every picture in sight is decoded and drawn.
SWITCH = """
const [role, done] = arguments;
const select = document.querySelector(`.viewer [data-role="${role}"]`);
select.selectedIndex = (select.selectedIndex + 1) % select.options.length;
const start = performance.now();
select.dispatchEvent(new Event("change"));
const images = [...document.querySelectorAll(".viewer img")];
const shown = images.filter((image) => image.checkVisibility());
Promise.all(shown.map((image) => image.decode())).then(
  () => requestAnimationFrame(() => done(performance.now() - start)));
"""


def measure() -> dict[str, Figure]:
    """Name -> figure of both pages.

    Of none where there is no browser, of the long one alone where there is no demo.
    """
    if lacking_parts():
        print(
            f"page not measured: {' and '.join(lacking_parts())} not found; run: {INSTALL}",
            file=sys.stderr,
        )
        return {}
    with tempfile.TemporaryDirectory() as folder:
        pages = {"long": write_long_page(Path(folder))} | ({"demo": DEMO} if DEMO.is_file() else {})
        return {
            name: figure
            for key, page in pages.items()
            for name, figure in measure_page(key, page).items()
        }


def measure_page(key: str, page: Path) -> dict[str, Figure]:
    """Least of `REPEATS` in a separate browser, whose first opening warms it up.

    Times by the clock, and of its main thread.
    """
    with tempfile.TemporaryDirectory() as profile, open_browser(Path(profile)) as browser:
        browser.driven.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": WATCH})
        browser.driven.execute_cdp_cmd("Performance.enable", {"timeDomain": "threadTicks"})
        openings = [_open(browser, page) for _ in range(REPEATS + 1)][1:]
        browser.run("document.querySelector('.viewer').scrollIntoView({behavior: 'instant'})")
        switches = {
            role: [_switch(browser, role) for _ in range(REPEATS)] for role in ("left", "view")
        }
    figures = {f"page.{key}_size_mb": _figure(page.stat().st_size / 1e6, "MB", 30.0)}
    for name, times in zip(
        ("first_picture", "ready", "open_cpu"), zip(*openings, strict=True), strict=True
    ):
        figures[f"page.{key}_{name}_ms"] = _figure(min(times), "ms", OPEN_MS)
    for role, name in (("left", "other_method"), ("view", "other_view")):
        for kind, times in zip(("", "_cpu"), zip(*switches[role], strict=True), strict=True):
            figures[f"page.{key}_{name}{kind}_ms"] = _figure(min(times), "ms", SWITCH_MS)
    return figures


def _open(browser: Browser, page: Path) -> tuple[float, float, float]:
    """Milliseconds from the start of the navigation to the first picture and to the page being
    ready, and of processor time.
    """
    browser.driven.get("about:blank")
    before_ms = _cpu_ms(browser)
    browser.visit(page)
    browser.wait("window.firstPictureMs > 0", seconds=60.0)
    ready_ms = browser.wait(
        "performance.getEntriesByType('navigation')[0].loadEventEnd", seconds=60.0
    )
    return browser.run("window.firstPictureMs"), ready_ms, _cpu_ms(browser) - before_ms


def _switch(browser: Browser, role: str) -> tuple[float, float]:
    """Return the milliseconds from a choice to its picture, and of processor time."""
    before_ms = _cpu_ms(browser)
    took_ms = float(browser.driven.execute_async_script(SWITCH, role))
    return took_ms, _cpu_ms(browser) - before_ms


def _cpu_ms(browser: Browser) -> float:
    """Return the processor time of the page's main thread so far.

    Other programs on the machine do not add to it.
    """
    metrics = browser.driven.execute_cdp_cmd("Performance.getMetrics", {})["metrics"]
    return next(1e3 * metric["value"] for metric in metrics if metric["name"] == "TaskDuration")


def write_long_page(folder: Path) -> Path:
    """Return the page of a run as long as the paper's, of textured pictures that move."""
    rng = np.random.default_rng(0)
    coarse = rng.integers(0, 255, (HEIGHT // 8, WIDTH // 8, 3)).astype(np.uint8)
    texture = cv2.resize(coarse, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    labels = tuple([*NAMES, *(f"method-{number}" for number in range(METHODS - len(NAMES)))])
    views = tuple(f"cam{number:02d}" for number in range(VIEWS))
    shape = RunShape(
        views, Frames(0, FRAMES), WIDTH, HEIGHT, 48, True, labels, ("PSNR", "SSIM", "TCC")
    )
    numbers = {name: number for number, name in enumerate((*labels, *views, "truth", "path"))}

    def paint(label: str, view: str, index: int) -> np.ndarray:
        return np.roll(texture, (numbers[label], 4 * index + 16 * numbers[view]), axis=(0, 1))

    return write_report([write_run(folder / "run", shape, paint)], folder / "report")


def _figure(value: float, unit: str, target: float | None = None) -> Figure:
    return {
        "value": value,
        "unit": unit,
        "target": target,
        "higher_is_better": False,
        "command": COMMAND,
    }


if __name__ == "__main__":
    figures = measure_page("given", Path(sys.argv[1])) if len(sys.argv) > 1 else measure()
    for name, figure in figures.items():
        print(
            name,
            *(f"{key}={value}" for key, value in figure.items() if value not in (None, COMMAND)),
            sep="  ",
        )
