"""The command line: what a user can mend is one line and exit code 1, and names the mend."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.pipelines.commands.main import COMMANDS
from helpers.captures import write_dynerf
from helpers.command_line import refusal


@pytest.fixture
def rig(tmp_path) -> Path:
    return write_dynerf(tmp_path / "rig")


def test_a_missing_video_is_named(rig, tmp_path):
    """One mp4 less than rows of poses: both counts and the mend."""
    next(iter(sorted(rig.glob("*.mp4")))).unlink()

    assert "poses_bounds.npy" in refusal("run", tmp_path / "run", "--capture", rig)


def test_a_truncated_video_is_named(rig, tmp_path):
    """Half an mp4 is refused before anything is computed, naming the file."""
    video = sorted(rig.glob("*.mp4"))[1]
    video.write_bytes(video.read_bytes()[: video.stat().st_size // 2])

    assert video.name in refusal("run", tmp_path / "run", "--capture", rig)


def test_a_nan_pose_is_named(rig, tmp_path):
    """A NaN in the pose file names the file and the row."""
    poses = np.load(rig / "poses_bounds.npy")
    poses[2, 3] = np.nan
    np.save(rig / "poses_bounds.npy", poses)

    assert "row 2" in refusal("run", tmp_path / "run", "--capture", rig)


def test_a_wrong_row_count_is_named(rig, tmp_path):
    """A pose file of another rig: rows against videos."""
    np.save(rig / "poses_bounds.npy", np.load(rig / "poses_bounds.npy")[:-1])

    assert "poses_bounds.npy" in refusal("prepare", tmp_path / "run", "--capture", rig)


def test_an_empty_folder_says_what_was_wanted(tmp_path):
    """An empty folder is no capture."""
    (tmp_path / "empty").mkdir()

    assert "empty" in refusal("run", tmp_path / "run", "--capture", tmp_path / "empty")


def test_an_unknown_protocol_key_names_the_nearest(rig, tmp_path):
    """A mistyped key of a protocol file names the right one."""
    (tmp_path / "mine.toml").write_text('nmae = "x"\n')

    message = refusal("run", tmp_path / "run", "--capture", rig, "--protocol", tmp_path / "mine.toml")

    assert "unknown key nmae; did you mean name?" in message


def test_a_folder_that_is_no_run_says_how_to_make_one(tmp_path):
    """Scoring, rendering or slicing something else than a run folder names the command that makes one."""
    assert "ggvs-eval run" in refusal("score", tmp_path)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command):
    """`--help` of each command exits cleanly and describes what it does."""
    result = subprocess.run(
        [sys.executable, "-m", "ggvs_eval", command, "--help"], capture_output=True, text=True, check=True, env=None
    )

    assert len(result.stdout) > 200
    assert (COMMANDS[command].__doc__ or "").split(".")[0].split()[0] in result.stdout
