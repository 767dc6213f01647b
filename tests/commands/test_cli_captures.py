"""The verbs that deal with captures: what they print, what they write, and how they end."""

import json
import subprocess
import sys

import numpy as np
import pytest

from ggvs_eval.pipelines.commands.main import run_command
from helpers.captures import NAMES, make_rig, write_poses, write_videos
from helpers.small_runs import small_protocol


def run(*arguments: object) -> None:
    run_command([str(argument) for argument in arguments])


@pytest.mark.slow
def test_a_capture_that_does_not_open_is_a_bad_verdict(dynerf, tmp_path, capsys):
    """A NaN pose: the table says so, the JSON too, the exit code is 1, and of the rest what frames
    tell.
    """
    poses = np.load(dynerf / "poses_bounds.npy")
    poses[1, 2] = np.nan
    np.save(dynerf / "poses_bounds.npy", poses)

    with pytest.raises(SystemExit) as ended:
        run("check", dynerf, "--out", tmp_path / "check.json")

    findings = json.loads((tmp_path / "check.json").read_text())["findings"]
    assert ended.value.code == 1
    assert findings[0]["verdict"] == "bad"
    assert "row 1" in findings[0]["measured"]
    assert {finding["question"] for finding in findings[1:] if finding["verdict"] == "ok"} == {
        "frames",
        "frozen frames",
        "noise",
    }
    assert {finding["verdict"] for finding in findings[1:]} == {"ok", "unknown"}
    assert "verdict" in capsys.readouterr().out


@pytest.mark.slow
def test_units_are_taken_from_the_command_line(dynerf, tmp_path):
    """A number, or a file with a known baseline; the run folder's record says which."""
    distance = float(np.linalg.norm(make_rig()[1].centre - make_rig()[0].centre))
    (tmp_path / "mine.toml").write_text('[baseline]\ncameras = ["cam00", "cam01"]\nmetres = 0.1\n')
    (tmp_path / "p.toml").write_text(small_protocol(1, 0, ("PSNR",)).to_toml())
    words = ("--capture", dynerf, "--jobs", 1, "--protocol", tmp_path / "p.toml")
    for units, wanted, origin in (
        ("4", 4.0, "given by the user"),
        ("mine.toml", distance / 0.1, "baseline cam00 - cam01"),
    ):
        given = tmp_path / units if units.endswith(".toml") else units
        run("prepare", tmp_path / f"run-{units}", *words, "--units", given)

        record = json.loads((tmp_path / f"run-{units}" / "capture.json").read_text())
        assert record["units_per_metre"] == pytest.approx(wanted)
        assert record["units_origin"].startswith(origin)


@pytest.mark.parametrize(
    ("units", "message"),
    [("ten", "a number or a .toml file"), ("-1", "positive number"), ("no.toml", "no such file")],
)
def test_units_that_are_none_are_refused(dynerf, tmp_path, units, message):
    """What is no number and no file, not positive, or not there ends with one line."""
    with pytest.raises(SystemExit) as ended:
        run("prepare", tmp_path / "run", "--capture", dynerf, "--units", units)

    assert message in str(ended.value.code)
    assert "\n" not in str(ended.value.code)


def test_what_is_left_out_is_said(tmp_path, capsys):
    """cam13 of coffee_martini is dropped with a word about it, and kept with another where the user
    or the protocol asks.
    """
    names = (*NAMES, "cam13")
    scene = tmp_path / "coffee_martini"
    write_videos(scene, names)
    write_poses(scene, make_rig(names))
    for protocol, extra, said in (
        ("dynerf", (), True),
        ("dynerf", ("--keep-unsynced",), False),
        ("n3v_4dgs", (), False),
    ):
        with pytest.raises(SystemExit):
            run("prepare", tmp_path / "run", "--capture", scene, "--protocol", protocol, *extra)
        told = capsys.readouterr().err
        assert told.count("cam13 left out") == said
        assert told.count("known trap of Neural 3D Video, cam13 of coffee_martini, kept") == (
            not said
        )


def test_undistort_and_calibrate_speak_in_one_line(tmp_path):
    """Empty folders are refused with what was wanted."""
    (tmp_path / "empty").mkdir()
    for arguments in (
        ("calibrate", tmp_path / "empty", tmp_path / "out"),
        ("undistort", tmp_path / "empty", tmp_path / "out"),
    ):
        with pytest.raises(SystemExit) as ended:
            run(*arguments)
        assert str(ended.value.code).startswith("ggvs-eval: ")
        assert "\n" not in str(ended.value.code)
        assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_reader_that_goes_away_is_no_traceback():
    """`ggvs-eval ... | head -1` ends quietly."""
    command = f"'{sys.executable}' -m ggvs_eval demo --help | head -1"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=True)

    assert done.stdout.startswith("usage")
    assert done.stderr == ""
