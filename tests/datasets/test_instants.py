"""One index shows one instant in all cameras: by the numbers of pictures, and by the times of videos."""

import pytest

from ggvs_eval.datasets import open_capture
from ggvs_eval.files.images import write_image
from helpers.captures import N_FRAMES, NAMES, make_image, make_rig, refusal, write_poses, write_timed_video


def numbered(folder, first):
    """A rig whose camera i has frames from first(i) on; the mark of a frame is its number."""
    write_poses(folder, make_rig())
    for index, name in enumerate(NAMES):
        for number in range(first(index), first(index) + N_FRAMES):
            write_image(folder / "frames" / name / f"{number:04d}.png", make_image(index, number % 10))
    return folder


def timed(folder, dropped):
    """A rig of ten frames whose camera i lacks the instant dropped(i) of eleven; the mark of a frame is its instant."""
    write_poses(folder, make_rig())
    for index, name in enumerate(NAMES):
        kept = [instant for instant in range(11) if instant != dropped(index)]
        write_timed_video(folder / f"{name}.mp4", [make_image(index, t) for t in kept], [20 * t for t in kept])
    return folder


def test_cameras_that_begin_later_are_aligned_by_number(tmp_path):
    """The common numbers are taken and noted, and each index shows one number in all cameras."""
    capture = open_capture(numbered(tmp_path / "room", lambda index: 102 if index == 3 else 100))
    assert capture.n_frames == N_FRAMES - 2
    for frame in range(capture.n_frames):
        assert {int(capture.frame(name, frame)[0, 0, 0]) for name in NAMES} == {30 + 20 * (2 + frame)}
    (note,) = (note for note in capture.notes if "all cameras have" in note)
    assert "frames 102 to 104" in note
    assert "cam03 from 102 to 106" in note


def test_cameras_without_a_common_number_are_refused(tmp_path):
    """With the range of each."""
    message = refusal(numbered(tmp_path / "room", lambda index: 200 if index == 3 else 100))
    assert "cam00, cam01, cam02 from 100 to 104; cam03 from 200 to 204" in message


def test_counting_from_zero_and_from_one_is_noted(tmp_path):
    """They are taken to begin together, as before, and the note says which is which."""
    capture = open_capture(numbered(tmp_path / "room", lambda index: index // 2))
    assert capture.n_frames == N_FRAMES
    (note,) = (note for note in capture.notes if "from 0 in some cameras" in note)
    assert "cam00, cam01 from 0 to 4; cam02, cam03 from 1 to 5" in note


@pytest.mark.parametrize(
    ("dropped", "message"),
    [
        (lambda index: 4 if index == 2 else 10, "cam02 lacks the frame at 0.133 s"),
        (lambda index: 4 if index == 2 else 8, "cam00, cam01, cam03 lack the frame at 0.267 s; cam02 lacks the frame at 0.133 s"),
    ],
    ids=["one", "each"],
)
def test_videos_that_drop_frames_are_refused_with_the_place(tmp_path, dropped, message):
    """Where one of them does, and where all do at different moments, so that their average rates agree."""
    assert message in refusal(timed(tmp_path / "room", dropped))


def test_a_frame_that_all_drop_is_no_fault(tmp_path):
    """Their frames are of one instant still."""
    assert open_capture(timed(tmp_path / "room", lambda index: 4)).n_frames == 10
