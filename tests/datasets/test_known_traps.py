"""Known traps: each is told once, in one line, where it concerns a capture, and nowhere else."""

from dataclasses import replace

import pytest

from ggvs_eval.datasets import DATASETS, open_capture
from ggvs_eval.datasets.assemble import apply_known_traps, known_traps
from helpers.captures import write_dynerf
from helpers.community_layouts import write_immersive, write_meetroom, write_technicolor


def test_every_trap_can_be_met():
    """Each is of named scenes, in small letters as they are compared, never of all that has a form,
    and says who says so.
    """
    for trap in known_traps():
        assert trap.layout in ("", *DATASETS)
        assert trap.scenes
        assert trap.scenes == [scene.lower() for scene in trap.scenes]
        assert trap.reason
        assert trap.source
        assert "\n" not in trap.reason + trap.source


@pytest.mark.parametrize(
    ("leave_out", "said"),
    [(True, "cam13 left out: known to be out of step"), (False, "cam13 of coffee_martini, kept")],
)
def test_coffee_martini_is_told_whether_cam13_is_left_out_or_kept(tmp_path, leave_out, said):
    """One note either way, with its source."""
    capture = open_capture(
        write_dynerf(tmp_path / "coffee_martini", ("cam12", "cam13")), drop_unsynced=leave_out
    )
    (note,) = capture.notes
    assert said in note
    assert "issue 5" in note


@pytest.mark.parametrize(
    ("write", "scene", "said"),
    [
        (
            write_technicolor,
            "Birthday",
            "known trap of Technicolor, cam09 of Birthday: Birthday_undist_00173_09.png is broken",
        ),
        (write_technicolor, "Painter", ""),
        (write_meetroom, "discussion", "known trap of MeetRoom, discussion: the lenses distort"),
        (
            write_immersive,
            "02_Flames",
            "known trap of Google Immersive, 02_Flames: frames are undistorted here",
        ),
        (write_dynerf, "sear_steak", ""),
    ],
)
def test_traps_are_told_of_their_own_scenes(tmp_path, write, scene, said):
    """A scene with a trap has one note that begins with it; others have none."""
    names = (
        [f"cam{number:02d}" for number in range(10)] if scene == "Birthday" else ["cam00", "cam01"]
    )
    notes = open_capture(write(tmp_path / scene, names)).notes
    assert len(notes) == bool(said)
    assert all(note.startswith(said) for note in notes)


def test_a_long_scene_is_told_only_where_it_is_long(tmp_path):
    """The first 300 frames of flame_salmon are what is published; a capture cut to these is as good
    as any.
    """
    capture = replace(
        open_capture(write_dynerf(tmp_path / "flame_salmon_1", ("cam00", "cam01"))), n_frames=1200
    )
    assert "four times as long" in apply_known_traps(capture).notes[-1]
    assert apply_known_traps(replace(capture, n_frames=300)).notes == ()
