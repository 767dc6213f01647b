"""Two names with one set of frames: said by score, page and compare, and not ranked against each
other.
"""

import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from ggvs_eval.datasets import open_capture
from ggvs_eval.files.images import read_image, write_image
from ggvs_eval.pipelines.run.import_renders import import_renders, run_for
from ggvs_eval.pipelines.run.score import score
from ggvs_eval.protocol import Frames, Views
from ggvs_eval.reports.tables.compare_runs import differences, method_sides, run_sides
from ggvs_eval.results import Results
from ggvs_eval.run_folder import RunFolder, frame_path
from ggvs_eval.statistics.paired import Ranking, judge
from helpers.small_runs import small_protocol, write_small_capture

VIEWS, N_FRAMES = ("cam00", "cam01"), 5
RANKINGS = [Ranking("PSNR", True)]


@pytest.fixture(scope="module")
def room(tmp_path_factory) -> Path:
    """A small capture and renders of it: `mine`, a copy of it, and others; nobody changes it."""
    folder = tmp_path_factory.mktemp("twins")
    capture, random = write_small_capture(folder / "room"), np.random.default_rng(3)
    protocol = replace(
        small_protocol(N_FRAMES, 0, ("PSNR",)),
        views=Views(VIEWS, "test"),
        frames=Frames(0, N_FRAMES),
    )
    (folder / "p.toml").write_text(protocol.to_toml(), encoding="utf-8")
    for view in VIEWS:
        for number in range(N_FRAMES):
            truth = capture.frame(view, number)
            for label in ("mine", "other"):
                blurred = cv2.GaussianBlur(truth, (7, 7), 1.2) + random.normal(0, 2, truth.shape)
                write_image(
                    folder / label / view / f"{number:04d}.png",
                    blurred.clip(0, 255).astype(np.uint8),
                )
    shutil.copytree(folder / "mine", folder / "twin")
    return folder


def scored(room: Path, root: Path, *labels: str) -> RunFolder:
    """A scored run of some of the renders."""
    with run_for(root, lambda: open_capture(room / "room"), str(room / "p.toml"), 1) as made:
        for label in labels:
            import_renders(made, label, room / label)
    score(made)
    return made


def test_a_copy_under_a_second_name_is_not_ranked(room, tmp_path, capsys):
    """`twin` is set aside by judge, score's lines and compare, with the reason; `mine` and `other`
    are ranked as before.
    """
    run = scored(room, tmp_path / "run", "mine", "other", "twin")
    results = Results.read(run.root)

    assert results.set_aside == {"twin": "shows the same frames as mine"}
    (line,) = results.fault_lines()
    assert "twin shows the same frames as mine, so it is not ranked" in line
    assert "10 of 10 frames are equal byte by byte" in line
    judgement = judge(results, RANKINGS, str(results.table["dataset"][0])).judgements["PSNR"]
    assert judgement.unranked == {"twin": "shows the same frames as mine"}
    assert {judgement.best, *judgement.comparisons} == {"mine", "other"}
    rows = differences(*method_sides(run.root, "mine", "twin"), run.root)
    assert {row.verdict for row in rows} == {"not compared: second shows the same frames as mine"}


def test_one_frame_in_ten_makes_another_method(room, tmp_path):
    """More than 1 % of the frames differ: both are ranked."""
    run = scored(room, tmp_path / "run", "mine", "twin")
    file = frame_path(run.renders("twin", "cam01"), 2)
    write_image(file, read_image(file) // 2)

    assert score(run).set_aside == {}


def test_a_view_with_the_frames_of_another_one_is_said(room, tmp_path):
    """Renders of cam00 in the folder of cam01 too."""
    shutil.copytree(room / "other" / "cam00", tmp_path / "copied" / "cam00")
    shutil.copytree(room / "other" / "cam00", tmp_path / "copied" / "cam01")
    with run_for(
        tmp_path / "run", lambda: open_capture(room / "room"), str(room / "p.toml"), 1
    ) as run:
        import_renders(run, "copied", tmp_path / "copied")

    (fault,) = [fault for fault in score(run).faults if fault.question.startswith("same frames")]

    assert (fault.view, fault.words) == ("cam01", "shows the same frames as cam00")


def test_runs_with_the_same_frames_are_not_compared(room, tmp_path):
    """Two runs, one set of frames: no difference is decided, and the reason is given."""
    roots = [scored(room, tmp_path / name, "mine").root for name in ("one", "two")]
    ((first, second),) = run_sides(*roots)

    rows = differences(first, second, roots[0])

    assert {row.verdict for row in rows} == {
        "not compared: first and second are the same frames, byte by byte"
    }
