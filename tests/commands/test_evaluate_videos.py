"""From the videos of a rig to a page in one command, which prints each step as a command and stops
where check is bad.
"""

import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.datasets import open_capture
from ggvs_eval.errors import CaptureError, CommandError
from ggvs_eval.files.video import write_video
from ggvs_eval.pipelines.commands.evaluate import evaluate
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.results import Results
from ggvs_eval.run_folder import RunFolder
from helpers.refusals import refused
from helpers.small_rig import film, make_cameras

pytestmark = [pytest.mark.usefixtures("no_figures")]
FAST = ("--methods", "no-blending", "--frames", "2", "--jobs", "1")


def call(*words: object) -> None:
    """A command line; errors of the user end it with their line."""
    run_command([*map(str, words)])


def steps(text: str) -> list[list[str]]:
    """The command lines that were printed as steps."""
    return [
        shlex.split(line.removeprefix("$ "))
        for line in text.splitlines()
        if line.startswith("$ ggvs-eval ")
    ]


@pytest.fixture(scope="module")
def room(tmp_path_factory) -> Path:
    """Eight neighbouring cameras of the demo room, as videos alone, and the poses of all."""
    from ggvs_eval.synthetic.shipped import write_room

    folder = tmp_path_factory.mktemp("room")
    whole = write_room(folder / "whole")
    (folder / "videos").mkdir()
    for video in sorted(whole.glob("*.mp4"))[:16:2]:
        shutil.copy(video, folder / "videos")
    return folder


@pytest.mark.proof  # two calls of COLMAP and depth, a minute and a half of a core
def test_videos_become_a_page_by_steps_that_are_said(room, tmp_path, capsys):
    """Calibrate, check, protocol and run, each printed as it goes; a second call repeats the check
    alone, and gives the same.
    """
    out = tmp_path / "out"
    call("evaluate", room / "videos", out, *FAST)
    told = capsys.readouterr().out
    assert [words[1] for words in steps(told)] == ["calibrate", "check", "protocol", "run"]
    assert Path(told.splitlines()[-1]) == out / "run" / "report" / "index.html"
    assert (out / "run" / "report" / "index.html").is_file()
    assert RunFolder(out / "run").protocol().frames.count == 2
    assert RunFolder(out / "run").check_record.read_bytes() == (out / "check.json").read_bytes()
    first = Results.read(out / "run").table
    call("evaluate", room / "videos", out, *FAST)
    assert [words[1] for words in steps(capsys.readouterr().out)] == ["check", "run"]
    assert Results.read(out / "run").table.equals(first)
    for words in [
        [
            "protocol",
            out / "capture",
            tmp_path / "again.toml",
            "--check",
            out / "check.json",
            "--frames",
            "2",
        ]
    ]:
        call(*words)  # what was said does the same
    assert (tmp_path / "again.toml").read_text() == (out / "protocol.toml").read_text()


@pytest.mark.proof  # COLMAP and depth, some forty seconds of a core
def test_videos_of_unequal_lengths_and_rates_become_a_page_by_repair(tmp_path):
    """The refusal names the option, which takes the span that all have; the videos stay as they
    are.
    """
    (tmp_path / "videos").mkdir()
    for index, camera in enumerate(make_cameras()):
        images = film(camera)
        if index == 4:
            images = [images[round(1.2 * frame)] for frame in range(20)]
        write_video(
            tmp_path / "videos" / f"{camera.name}.mp4",
            images[: 21 if index == 2 else 24],
            25 if index == 4 else 30,
        )
    with pytest.raises(CaptureError, match="--repair' takes the span that all have"):
        evaluate(tmp_path / "videos", tmp_path / "out")
    call("evaluate", tmp_path / "videos", tmp_path / "out", *FAST, "--repair")
    capture = open_capture(tmp_path / "out" / "capture")
    assert (capture.n_frames, capture.fps) == (18, 25.0)
    assert (tmp_path / "out" / "run" / "report" / "index.html").is_file()


def test_another_rig_in_the_folder_of_one_is_refused(tmp_path, monkeypatch):
    """Other videos, or the same names recorded again, are never shown with the poses and the
    numbers of the first.
    """
    calibrated = []

    def write_capture(videos: Path, capture: Path, _options: object) -> None:
        calibrated.append(videos)
        capture.mkdir()
        (capture / "calibration.json").write_text("{}")

    monkeypatch.setattr("ggvs_eval.pipelines.commands.evaluate.calibrate.calibrate", write_capture)
    for rig, level in (("first", 50), ("second", 90)):
        for name in ("cam00", "cam01", "cam02"):
            frames = np.full((3, 32, 48, 3), level, np.uint8)
            write_video(tmp_path / rig / f"{name}.mp4", frames, 30)
    for _ in range(2):
        with refused(CommandError, "capture: stopped"):
            evaluate(tmp_path / "first", tmp_path / "out")
    with refused(CaptureError, "other frames than", "second has; choose another OUT"):
        evaluate(tmp_path / "second", tmp_path / "out")
    shutil.copy(tmp_path / "second" / "cam01.mp4", tmp_path / "first" / "cam01.mp4")
    with refused(CaptureError, "other frames than"):
        evaluate(tmp_path / "first", tmp_path / "out")
    assert calibrated == [tmp_path / "first"]


def test_a_bad_capture_stops_with_its_verdict(dynerf, tmp_path, capsys):
    """A camera that cannot be: the table says so, neither a protocol nor a run follows, and the
    line says how to go on.
    """
    poses = np.load(dynerf / "poses_bounds.npy")
    poses[:, 4] = 1e-3  # a focal length of nothing
    poses[1:, [3, 8, 13]] = poses[0, [3, 8, 13]]
    np.save(dynerf / "poses_bounds.npy", poses)
    with pytest.raises(SystemExit, match="stopped: check found faults"):
        call("evaluate", dynerf, tmp_path / "out", *FAST)
    told = capsys.readouterr().out
    assert [words[1] for words in steps(told)] == ["check"]
    assert "bad" in told
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["check.json"]


def test_nothing_to_evaluate_leaves_nothing(tmp_path):
    """A path that does not exist is an error and makes no folder."""
    with pytest.raises(SystemExit, match="got no such path; check it"):
        call("evaluate", tmp_path / "nowhere", tmp_path / "out", *FAST)
    assert list(tmp_path.iterdir()) == []
