"""A page shows what faulty renders would look like and score without their fault, and ranks none of
it.
"""

import base64
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from ggvs_eval.arrays import Image8
from ggvs_eval.contrib.what_if import page as what_if_page
from ggvs_eval.contrib.what_if.page import keep_for_page, undo_faults
from ggvs_eval.datasets import open_capture
from ggvs_eval.files.images import read_image
from ggvs_eval.pipelines.run.import_renders import import_renders, run_for
from ggvs_eval.pipelines.run.score import score
from ggvs_eval.reports.model.measured import read_run
from ggvs_eval.reports.page.pictures import UndoneRenders
from ggvs_eval.run_folder import RunFolder, frame_path
from ggvs_eval.synthetic.shipped import FIXED, LATE, QUICK_ROOM, quick_protocol
from helpers.painted_page import write_page

pytestmark = pytest.mark.slow

VIEW = "cam00"
WEBP_255 = 4.0  # mean error of a compressed picture
STANDINGS = re.compile(r'<table class="standings">.*?</table>', re.DOTALL)


@pytest.fixture(scope="module")
def quick(quick_demo, tmp_path_factory) -> Path:
    """The quick demo with the renders of one view; nobody changes it."""
    folder = Path(shutil.copytree(quick_demo, tmp_path_factory.mktemp("undone") / "quick"))
    for renders in (folder / FIXED, folder / LATE):
        for other in set(renders.iterdir()) - {renders / VIEW}:
            shutil.rmtree(other)
    return folder


@pytest.fixture(scope="module")
def run(quick) -> RunFolder:
    """Its two sets of renders, scored: one of them shows every frame an instant late."""
    protocol = quick_protocol()
    short = replace(protocol, views=replace(protocol.views, test=(VIEW,)))
    cheap = replace(
        short, measurement=replace(protocol.measurement, metrics=("PSNR",), ceilings=False)
    )
    (quick / "cheap.toml").write_text(cheap.to_toml(), encoding="utf-8")
    with run_for(
        quick / "run", lambda: open_capture(quick / QUICK_ROOM), str(quick / "cheap.toml"), 1
    ) as made:
        for label, folder in (("mine", FIXED), ("late", LATE)):
            import_renders(made, label, quick / folder)
    score(made)
    return made


@pytest.fixture(scope="module")
def page(run) -> Path:
    return write_page([run.root], run.root / "report" / "index.html")


def picture(address: str) -> Image8:
    return cv2.imdecode(
        np.frombuffer(base64.b64decode(address.partition(",")[2]), np.uint8), cv2.IMREAD_COLOR
    )[..., ::-1]


def test_frames_and_score_of_a_late_set_without_its_fault(quick, run, page):
    """Frames move by an instant, the last one is missing; one sentence has both scores, standings
    have the honest set alone.
    """
    text = page.read_text(encoding="utf-8")
    data = json.loads(re.search(r'data-role="data">(.*?)</script>', text, re.DOTALL)[1])  # type: ignore[index]

    assert data["keys"] == ["truth", "late", "mine", "late/undone"]
    assert data["names"]["late/undone"] == "late (faulty): frames renumbered by -1"
    *there, missing = data["images"][VIEW]["late/undone"]
    for frame, address in zip(data["frames"], there, strict=False):
        handed_in = read_image(frame_path(quick / LATE / VIEW, frame + 1))
        assert np.abs(picture(address).astype(float) - handed_in).mean() < WEBP_255
    assert np.ptp(picture(missing)) == 0
    found = re.search(
        r"PSNR as handed in ([\d.]+) dB; frames renumbered by -1 \(certain\) ([\d.]+) dB; not "
        r"ranked",
        text,
    )
    assert found
    assert float(found[2]) - float(found[1]) > 3
    assert text.count('data-role="undone"') == 1
    assert "late" not in STANDINGS.search(text)[0]  # type: ignore[index]
    assert len(text) < 25e6


def test_what_is_undone_follows_scores_and_what_if(run, monkeypatch):
    """A method without a fault is left as it is; `what-if` adds the methods that it finds a fault
    in, and takes them back.
    """
    monkeypatch.setattr(
        what_if_page,
        "_undone",
        lambda _run, label: UndoneRenders(label, "", lambda _view, _frame: None),
    )
    measured = read_run(run.root)
    assert list(undo_faults(measured)) == ["late"]
    clean = replace(
        measured,
        results=replace(measured.results, provenance=measured.results.provenance | {"faults": []}),
    )
    assert undo_faults(clean) == {}
    try:
        keep_for_page(run, {"late": True})
        keep_for_page(run, {"mine": False})
        assert list(undo_faults(clean)) == ["late"]
        keep_for_page(run, {"late": False})
        assert undo_faults(clean) == {}
    finally:
        (run.root / "what_if.json").unlink()


def test_a_switch_undoes_the_fault_in_the_comparison(started, page):
    """The box undoes the side that shows the method, or the left one; it follows the choice of
    pictures.
    """
    sides = "['left', 'right'].map(role => document.querySelector(`[data-role=${role}]`).value)"
    checked = "document.querySelector('[data-role=undone]').checked"
    started.visit(page)
    started.click(".parts a[href='#compare']")
    started.choose("[data-role=left]", "mine")
    started.click("[data-role=undone]")
    assert started.run(sides) == ["late/undone", "truth"]
    started.click("[data-role=undone]")
    assert started.run(sides) == ["late", "truth"]
    started.choose("[data-role=right]", "late/undone")
    assert started.run(checked)
    assert started.run("document.querySelector('[data-role=over]').src").startswith(
        "data:image/webp"
    )
    assert started.complaints() == []
