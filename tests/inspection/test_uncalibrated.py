"""Videos that have no poses yet: what frames alone tell, and which command comes next."""

from ggvs_eval.files.video import write_video
from ggvs_eval.pipelines.inspection.capture.check import QUESTIONS, check_capture
from helpers.captures import FPS, N_FRAMES, make_image, write_folders, write_videos


def test_frames_are_checked_and_the_rest_waits(tmp_path):
    """Nothing is bad, no question is forgotten, and each that wants poses names the command."""
    write_videos(tmp_path / "table")
    check = check_capture(tmp_path / "table")

    assert check.is_usable
    assert {finding.question for finding in check.findings} == set(QUESTIONS)
    (frames,) = (finding for finding in check.of("frames") if finding.subject == "rig")
    assert frames.verdict == "ok"
    assert frames.measured == f"4 cameras, {N_FRAMES} frames of 64 x 48, 30 fps"
    for question in ("poses", "time offset", "colour gain", "units"):
        (finding,) = check.of(question)
        assert (finding.verdict, finding.measured) == ("unknown", "no calibration yet")
        assert finding.advice == f"ggvs-eval calibrate {tmp_path / 'table'} RIG, then check RIG"


def test_folders_of_images_are_videos_too(tmp_path):
    """As `calibrate` finds them."""
    write_folders(tmp_path / "table")
    assert check_capture(tmp_path / "table").is_usable


def test_videos_of_different_lengths_are_bad(tmp_path):
    """The counts, and what to do."""
    write_videos(tmp_path / "table")
    write_video(tmp_path / "table" / "cam02.mp4", [make_image(2, frame) for frame in range(3)], FPS)
    check = check_capture(tmp_path / "table")
    assert not check.is_usable
    assert "cam01 5, cam02 3" in check.findings[0].measured
    assert "cut them to a common length" in check.findings[0].measured


def test_one_video_is_no_rig(tmp_path):
    """Two cameras at least; otherwise the layouts are listed as before."""
    write_videos(tmp_path / "table", ("cam00",))
    check = check_capture(tmp_path / "table")
    assert check.findings[0].question == "opens"
    assert "wanted a capture in a known layout" in check.findings[0].measured
