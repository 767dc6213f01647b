"""Which cameras are held out of a rig of one's own, and the reason of each."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.capture import Capture
from ggvs_eval.datasets import open_capture
from ggvs_eval.errors import CaptureError, ProtocolError
from ggvs_eval.finding import Finding
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.pipelines.inspection.capture.check import CaptureCheck
from ggvs_eval.pipelines.run.suggest_protocol import (
    hold_out,
    propose_protocol,
    published_protocols,
    read_doubts,
    suggest_protocol,
)
from ggvs_eval.protocol import load_protocol
from ggvs_eval.run_folder import write_json
from helpers.captures import make_rig
from helpers.command_line import refusal
from helpers.refusals import refused

NAMES = [f"cam{number}" for number in range(6)]


def rig_of(names=NAMES, turned: str = "") -> Capture:
    """A row of cameras; one may look away from what the others see."""
    cameras = make_rig(names)
    away = np.diag([-1.0, 1.0, -1.0, 1.0])
    cameras = [
        replace(camera, world_to_camera=away @ camera.world_to_camera)
        if camera.name == turned
        else camera
        for camera in cameras
    ]
    return Capture("scene", "colmap", Path("scene"), tuple(cameras), (), 30, 30.0, 1.0, "guess")


def test_every_camera_has_a_reason():
    """Held out with its sources and what they show, or a source because the others are held out."""
    proposal = propose_protocol(rig_of())
    assert list(proposal.reasons) == NAMES
    assert proposal.protocol.views.test == ("cam1", "cam3", "cam5")
    assert proposal.reasons["cam3"].startswith("held out: ")
    assert proposal.reasons["cam3"].endswith("% of its view")
    assert "stays a source" in proposal.reasons["cam2"]
    assert suggest_protocol(rig_of()) == proposal.protocol


def test_test_views_may_be_chosen():
    """Each with what its sources show of it; the rest stays as proposed; a name of no camera is
    told with those there are.
    """
    rig = rig_of(turned="cam2")
    proposal = hold_out(propose_protocol(rig), rig, ("cam2", "cam0"), {})
    assert proposal.protocol.views.test == ("cam2", "cam0")
    assert proposal.protocol.measurement == suggest_protocol(rig).measurement
    assert proposal.reasons["cam0"].startswith("held out, as requested: cam1")
    assert proposal.reasons["cam2"].endswith("cover 0 % of its view")
    assert proposal.reasons["cam1"] == "stays a source"
    with refused(CaptureError, "no camera cam9", "cam0, cam1"):
        hold_out(propose_protocol(rig), rig, ("cam9",), {})


@pytest.mark.parametrize("count", [21, pytest.param(240, marks=pytest.mark.slow)])
def test_nine_of_many_cameras_are_spread_over_the_rig(count):
    """One of each ninth of the cameras; the reason of the others is true of all of them, and said
    once.
    """
    names = [f"{number:06d}" for number in range(count)]
    proposal = propose_protocol(rig_of(names))
    held_out = [int(name) for name in proposal.protocol.views.test]
    assert len(held_out) == 9
    assert max(held_out) - min(held_out) >= 0.75 * count
    assert np.ptp(np.diff(held_out)) <= 2
    others = {
        reason
        for name, reason in proposal.reasons.items()
        if name not in proposal.protocol.views.test
    }
    assert others == {f"stays a source: nine of {count} cameras, spread evenly, are held out"}


@pytest.mark.slow
def test_a_doubtful_camera_among_many_gives_its_place_to_a_neighbour():
    """The ninth of the rig that it lies in keeps a test view."""
    names = [f"{number:06d}" for number in range(90)]
    sure = propose_protocol(rig_of(names)).protocol.views.test
    proposal = propose_protocol(rig_of(names), {sure[4]: "noise: 9"})
    assert len(proposal.protocol.views.test) == 9
    assert sure[4] not in proposal.protocol.views.test
    assert abs(int(proposal.protocol.views.test[4]) - int(sure[4])) == 2


def test_published_protocols_are_those_whose_cameras_a_capture_has():
    """A capture of the cameras, frames and shape of Neural 3D Video is offered its protocols, a
    shorter one none.
    """
    cameras = [
        camera.resized(1344, 1008)
        for camera in rig_of([f"cam{number:02d}" for number in range(21)]).cameras
    ]
    alike = replace(rig_of(), cameras=tuple(cameras), n_frames=300)
    assert not published_protocols(replace(alike, n_frames=40))
    assert {each.name for each in published_protocols(alike)} == {
        "n3v_3dgstream",
        "n3v_4dgs",
        "n3v_queen",
        "n3v_stg",
    }
    steak = {each.name for each in published_protocols(replace(alike, scene="flame_steak"))}
    assert {name for name in steak if "sparse" in name} == {
        "n3v_sparse2",
        "n3v_sparse3",
        "n3v_sparse4",
    }
    wide = replace(alike, cameras=tuple(camera.resized(1920, 1080) for camera in cameras))
    assert {each.name for each in published_protocols(wide)} == {"meetroom_3dgstream"}
    assert not published_protocols(rig_of())


def test_a_camera_in_doubt_is_no_truth():
    """What the check found is the reason; the others stay held out."""
    proposal = propose_protocol(rig_of(), {"cam3": "time offset: 0.4 frames behind the rig"})
    assert proposal.protocol.views.test == ("cam1", "cam5")
    assert all(
        part in proposal.reasons["cam3"] for part in ("stays a source", "time offset", "0.4 frames")
    )
    assert proposal.protocol.views.chosen_by.endswith(
        "without those in doubt and those that the other cameras hardly show"
    )


def test_a_view_that_nobody_shows_is_passed_over():
    """A run would refuse it; nothing at all can be held out of one camera."""
    proposal = propose_protocol(rig_of(turned="cam3"))
    assert proposal.protocol.views.test == ("cam1", "cam5")
    assert "cover 0 % of its view" in proposal.reasons["cam3"]
    with refused(CaptureError, "wanted two cameras or more, got 1", "add cameras"):
        propose_protocol(rig_of(["cam00"]))


def test_the_other_cameras_take_over_where_none_is_left():
    """With every second camera in doubt those between are held out; with all in doubt the rule
    stands.
    """
    doubts = dict.fromkeys(NAMES[1::2], "noise: 9")
    assert propose_protocol(rig_of(), doubts).protocol.views.test == ("cam0", "cam2", "cam4")
    everybody = propose_protocol(rig_of(), dict.fromkeys(NAMES, "noise: 9"))
    assert everybody.protocol.views.test == ("cam1", "cam3", "cam5")
    assert everybody.reasons["cam1"] == "held out: by rule, although no camera is well covered"


def test_a_packaged_protocol_keeps_its_views():
    """Its own words are the reason; a doubt is told beside."""
    capture = replace(
        rig_of([f"cam{number:02d}" for number in range(21)]), layout="dynerf", n_frames=300
    )
    proposal = propose_protocol(capture, {"cam00": "noise: sigma 9"})
    assert proposal.protocol == load_protocol("dynerf")
    assert proposal.reasons["cam00"].startswith("chosen by us: ")
    assert proposal.reasons["cam00"].endswith("; but noise: sigma 9")
    assert proposal.reasons["cam01"] == "not a test view of the packaged protocol dynerf"


def test_doubts_are_the_worst_of_a_check(tmp_path):
    """Warnings and worse, of cameras, the worst one of each."""
    findings = (
        Finding("rig", "units", "warn", "unknown"),
        Finding("cam1", "time offset", "bad", "2 frames behind"),
        Finding("cam1", "noise", "warn", "sigma 9"),
        Finding("cam2", "noise", "ok", "sigma 1"),
        Finding("cam3", "noise", "unknown", "one frame"),
    )
    write_json(tmp_path / "check.json", CaptureCheck(tmp_path, findings).to_json())
    assert read_doubts(tmp_path / "check.json") == {"cam1": "time offset: 2 frames behind"}
    for text in (
        "{}",
        "[]",
        '{"findings": [{"a": 1}]}',
        '{"findings": [1]}',
        '{"findings": [{"subject":',
        "\x80",
    ):
        (tmp_path / "check.json").write_text(text, encoding="latin-1")
        with refused(CaptureError, "ggvs-eval check"):
            read_doubts(tmp_path / "check.json")


def test_the_command_writes_a_file_that_run_takes(dynerf, tmp_path, capsys):
    """A file that is there is left alone; frames and poses may be fewer, for a first look."""
    file = tmp_path / "new" / "mine.toml"
    run_command(["protocol", str(dynerf), str(file), "--frames", "2", "--path-poses", "3"])
    written = load_protocol(file)
    assert (written.frames.count, written.path.poses) == (2, 3)
    assert written.views == suggest_protocol(rig_of(["cam00", "cam01", "cam02", "cam03"])).views
    assert "held out: " in capsys.readouterr().out
    assert "got an existing one" in refusal("protocol", dynerf, file)
    run_command(["protocol", str(dynerf), str(tmp_path / "late.toml"), "--start", "1"])
    late, n_frames = load_protocol(tmp_path / "late.toml").frames, open_capture(dynerf).n_frames
    assert (late.start, late.count) == (1, n_frames - 1)
    message = refusal("protocol", dynerf, tmp_path / "c.toml", "--start", str(n_frames))
    assert f"--start {n_frames}: wanted an instant of {dynerf}, 0 to {n_frames - 1}" in message
    assert "wanted a file of 'ggvs-eval check'" in refusal(
        "protocol", dynerf, tmp_path / "b.toml", "--check", file
    )
    assert json.dumps(str(tmp_path)) not in file.read_text()
    with pytest.raises(ProtocolError, match="one frame or more"):
        written.shortened(0, None)
