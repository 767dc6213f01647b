"""A page whose pictures say by their colour what they are of, and its folder."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ggvs_eval.files.atomic import write_text
from ggvs_eval.protocol import Frames
from ggvs_eval.reports.page.page import render_page
from ggvs_eval.reports.run_groups import read_groups
from ggvs_eval.reports.section import Report, with_sections
from ggvs_eval.run_folder import write_json
from helpers.run_folders import LABELS, RunShape, write_run

SHAPE = RunShape(
    width=160, height=120, frames=Frames(2, 4), dataset="DyNeRF", metrics=("PSNR", "L1", "TCC")
)
RED = {label: 20 + 50 * number for number, label in enumerate(("truth", *LABELS))}
STAGE = ".stage"


def paint(label: str, view: str, index: int) -> np.ndarray:
    """A picture whose colour says what it is of: red the method, green the row, blue the view and
    the frame or pose.
    """
    picture = np.zeros((SHAPE.height, SHAPE.width, 3), np.uint8)
    picture[..., 0] = RED[label]
    picture[..., 1] = 2 * np.arange(SHAPE.height)[:, None]
    picture[..., 2] = 20 * index + (120 if view == "cam03" else 0)
    return picture


def write_page(runs: Sequence[Path], page: Path, standalone: bool = True) -> Path:
    """The page of a report alone; its figures for print take longer than all that a browser does
    with it.
    """
    report = Report(read_groups(runs), folder=None if standalone else page.parent)
    write_text(page, render_page(with_sections(report)))
    return page


def write_painted_page(folder: Path) -> Path:
    """The page of a run of two views, four frames and three methods."""
    run = write_run(folder / "run", SHAPE, paint)
    ceiling = {
        "group": "quality",
        "name": "Ceiling",
        "note": "a row that is no method.",
        "values": {"PSNR": 50.0},
    }
    write_json(run / "references.json", [ceiling])
    return write_page([run], folder / "index.html")


def wait_for_slices(browser) -> None:
    """Bring the slices of the row into sight and wait until they are drawn."""
    browser.run(
        "document.querySelector('.cuts').scrollIntoView({block: 'center', behavior: 'instant'})"
    )
    browser.wait("document.querySelector('.linked').getAttribute('aria-busy') === 'false'")


def show_part(browser, name: str) -> None:
    """Choose a part of the page by its tab; not by the mouse, which misses where pictures that
    arrive move the tab away.
    """
    browser.run("document.querySelector(arguments[0]).click()", f".parts a[href='#{name}']")
    browser.wait("document.getElementById(arguments[0]).checkVisibility()", name)


def clock(browser) -> str:
    """What the viewer says of its frame."""
    return browser.text("[data-role=clock]")
