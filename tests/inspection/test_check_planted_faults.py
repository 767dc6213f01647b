"""The check of a capture, on a small rig with one fault planted at a time."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from ggvs_eval.camera import Camera
from ggvs_eval.datasets.llff import read_llff_poses, write_llff_poses
from ggvs_eval.files.images import write_image
from ggvs_eval.pipelines.inspection.capture.check import (
    QUESTIONS,
    CaptureCheck,
    check_capture,
    run_check,
)
from helpers.small_rig import N_FRAMES, NAMES, brighten, film


def changed(filmed, name: str, change: Callable[[Camera], Camera]) -> list[Camera]:
    """The rig's cameras, one of them changed."""
    return [change(camera) if camera.name == name else camera for camera in filmed.cameras]


def scale_focal(camera: Camera, factor: float) -> Camera:
    return replace(camera, K=camera.K * [[factor, 1, 1], [1, factor, 1], [1, 1, 1]])


def mirror_world(camera: Camera, axis: int) -> Camera:
    """The pose in a world mirrored along an axis, and along the camera's own; it stays a
    rotation.
    """
    mirror = np.diag(np.where(np.arange(4) == axis, -1.0, 1.0))
    return replace(camera, world_to_camera=mirror @ camera.world_to_camera @ mirror)


def accused(check: CaptureCheck) -> dict[str, set[str]]:
    """Cameras that are warned of or bad, per question."""
    found: dict[str, set[str]] = {}
    for finding in check.findings:
        if finding.verdict in ("warn", "bad"):
            found.setdefault(finding.question, set()).add(finding.subject)
    found.pop("units", None)  # guessed in every one of these captures
    return found


def answer(check: CaptureCheck, question: str, subject: str):
    return next(finding for finding in check.of(question) if finding.subject == subject)


@pytest.mark.slow
def test_a_rig_without_fault_has_no_bad_line_and_no_camera_to_look_at(filmed):
    """Nothing but the guessed units is remarked on, every question but that is ok, and estimates
    have intervals.
    """
    check = filmed.check()

    assert accused(check) == {}
    assert check.is_usable
    assert {finding.verdict for finding in check.findings if finding.question != "units"} == {"ok"}
    assert answer(check, "epipolar error", "rig").values["median_px"] < 0.4
    assert answer(check, "time offset", "rig").values["largest_frames"] < 0.3
    for question in ("stands still", "colour over time", "colour gain", "time offset"):
        assert all(
            " +- " in finding.measured or "(+- " in finding.measured
            for finding in check.of(question)[1:]
        )


@pytest.mark.slow
def test_swapped_cameras_are_named_with_the_mend(filmed):
    """Two exchanged videos are both bad by epipolar error, said to fit each other's poses, and
    nobody else is blamed.
    """
    check = filmed.check(cam01=filmed.frames["cam05"], cam05=filmed.frames["cam01"])

    assert accused(check) == {"epipolar error": {"cam01", "cam05"}}
    assert not check.is_usable
    found = answer(check, "epipolar error", "cam01")
    assert found.verdict == "bad"
    assert found.values["fits_pose_of"] == "cam05"
    assert "exchange the frames of cam01 and cam05" in found.advice
    assert answer(check, "time offset", "cam01").verdict == "unknown"


@pytest.mark.slow
def test_swapped_cameras_of_a_small_rig_are_named(filmed):
    """No camera of five agrees with most others then; the answer for the rig names the two."""
    few = replace(filmed, cameras=filmed.cameras[:5], records=filmed.records[:5])
    check = few.check(cam01=filmed.frames["cam03"], cam03=filmed.frames["cam01"])

    assert (
        "they fit if cam01 and cam03 exchange frames or poses"
        in answer(check, "epipolar error", "rig").measured
    )


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1.05, pytest.param(0.95, marks=pytest.mark.slow)])
def test_a_wrong_focal_length_is_named_with_its_factor(filmed, factor):
    """One camera whose focal length is 5 % off is bad, and the factor that mends it is found within
    1 %.
    """
    check = filmed.check(changed(filmed, "cam02", lambda camera: scale_focal(camera, factor)))

    assert accused(check) == {"epipolar error": {"cam02"}, "intrinsics": {"cam02"}}
    found = answer(check, "epipolar error", "cam02")
    assert found.verdict == "bad"
    assert found.values["repair"] == "focal"
    assert found.values["focal_factor"] == pytest.approx(1 / factor, abs=0.01)


@pytest.mark.slow
def test_a_focal_length_wrong_in_all_cameras_is_said_of_the_rig(filmed):
    """When all focal lengths are 10 % off no camera is blamed, the rig is, with the factor."""
    check = filmed.check([scale_focal(camera, 1.1) for camera in filmed.cameras])

    found = answer(check, "epipolar error", "rig")
    assert accused(check) == {"epipolar error": {"rig"}}
    assert found.verdict == "bad"
    assert found.values["focal_factor"] == pytest.approx(1 / 1.1, abs=0.03)


@pytest.mark.slow
def test_a_mirrored_pose_that_is_still_a_rotation_is_found(filmed):
    """A pose mirrored in a world plane passes as a rotation; its epipolar error gives it away and
    the mirror is named.
    """
    check = filmed.check(changed(filmed, "cam03", lambda camera: mirror_world(camera, 0)))

    assert set(accused(check)["epipolar error"]) == {"cam03"}
    assert set().union(*accused(check).values()) == {"cam03"}
    found = answer(check, "epipolar error", "cam03")
    assert found.verdict == "bad"
    assert "mirrored in x" in found.measured


@pytest.mark.slow
@pytest.mark.parametrize("axis", [1, 2])
def test_a_mirrored_system_of_all_cameras_is_named(filmed, axis):
    """Left-handed axes, the world's and the cameras', pass as rotations; the pictures contradict,
    and the mirror is named.
    """
    check = filmed.check([mirror_world(camera, axis) for camera in filmed.cameras])

    found = answer(check, "epipolar error", "rig")
    assert found.verdict == "bad"
    assert f"its own {'xyz'[axis]} axis too (left-handed axes" in found.measured
    assert found.advice == "correct all cameras as named"


@pytest.mark.slow
def test_a_pose_turned_round_is_found_by_pose_and_by_matches(filmed):
    """Half a turn about the x axis, as OpenGL's axes would be, looks away from the scene and puts
    the matches behind it.
    """
    half_turn = np.diag([1.0, -1.0, -1.0, 1.0])
    check = filmed.check(
        changed(
            filmed,
            "cam05",
            lambda camera: replace(camera, world_to_camera=half_turn @ camera.world_to_camera),
        )
    )

    assert answer(check, "poses", "cam05").verdict == "bad"
    assert answer(check, "epipolar error", "cam05").verdict == "bad"
    assert "OpenGL" in answer(check, "epipolar error", "cam05").measured
    assert set().union(*accused(check).values()) == {"cam05"}


@pytest.mark.slow
def test_a_reflection_is_the_first_line_and_what_needs_poses_is_unknown(rig):
    """A pose with determinant -1: one bad line with the message; what frames alone tell is told,
    and no question passed over.
    """
    poses = read_llff_poses(rig / "poses_bounds.npy")
    poses[3] = poses[3]._replace(
        world_to_camera=np.diag([-1.0, 1, 1, 1]) @ poses[3].world_to_camera
    )
    write_llff_poses(rig / "poses_bounds.npy", poses)

    check = check_capture(rig)

    first, *others = check.findings
    assert (first.question, first.verdict) == ("opens", "bad")
    assert "cam03" in first.measured
    assert "determinant -1" in first.measured
    assert {finding.question for finding in others} == set(QUESTIONS)
    assert {finding.question for finding in others if finding.verdict == "ok"} == {
        "frames",
        "frozen frames",
        "stands still",
        "noise",
    }
    assert {finding.measured for finding in others if finding.verdict == "unknown"} == {
        "the capture does not open"
    }
    assert not check.is_usable


@pytest.mark.slow
@pytest.mark.parametrize("shift", [2, -2])
def test_a_camera_out_of_step_is_found(filmed, shift):
    """One camera two frames ahead or behind is bad with its offset and the sign; all others
    are ok.
    """
    check = filmed.check(cam02=film(filmed.cameras[2], shift))

    found = answer(check, "time offset", "cam02")
    assert accused(check) == {"time offset": {"cam02"}}
    assert found.verdict == "bad"
    assert found.values["offset_frames"] == pytest.approx(shift, abs=0.3)
    assert ("ahead" if shift > 0 else "behind") in found.measured


@pytest.mark.slow
def test_a_gain_of_15_percent_is_found(filmed):
    """The camera that is 1.15 times as bright is warned of, its gain known within 2 %; all others
    are ok.
    """
    check = filmed.check(cam05=[brighten(frame, 1.15) for frame in filmed.frames["cam05"]])

    found = answer(check, "colour gain", "cam05")
    assert accused(check) == {"colour gain": {"cam05"}}
    assert found.verdict == "warn"
    assert found.values["gain"] == pytest.approx([1.15] * 3, abs=0.02)


@pytest.mark.slow
def test_frozen_frames_are_found(filmed):
    """A frame that repeats the one before while the others move on is named; four of them
    are bad.
    """
    once, often = filmed.frames["cam01"], filmed.frames["cam04"]
    check = filmed.check(
        cam01=[*once[:10], once[9], *once[11:]], cam04=[*often[:12], *[often[11]] * 4, *often[16:]]
    )

    one, four = (answer(check, "frozen frames", name) for name in ("cam01", "cam04"))
    assert (one.verdict, one.values["frames"]) == ("warn", [10])
    assert (four.verdict, four.values["frames"]) == ("bad", [12, 13, 14, 15])
    assert accused(check) == {"frozen frames": {"cam01", "cam04"}}


@pytest.mark.slow
def test_damage_names_the_file_and_the_frame_and_the_other_cameras_go_on(rig):
    """Zeros in the middle of one video: that camera is bad from a certain frame on, all others are
    read to their end.
    """
    video = rig / "cam02.mp4"
    content = bytearray(video.read_bytes())
    size = len(content) // 4
    content[2 * size : 3 * size] = bytes(size)
    video.write_bytes(bytes(content))

    check = check_capture(rig)

    found = answer(check, "frames", "cam02")
    assert found.verdict == "bad"
    assert "cam02.mp4" in found.measured
    assert 0 < found.values["damaged"][0] < N_FRAMES
    assert all(
        answer(check, "frames", name).values["n_read"] == N_FRAMES
        for name in NAMES
        if name != "cam02"
    )
    assert accused(check) == {"frames": {"cam02"}}


@pytest.mark.slow
def test_a_truncated_video_does_not_open(rig):
    """A video cut in half gives the adapter's message as a bad line, not an error."""
    video = rig / "cam02.mp4"
    video.write_bytes(video.read_bytes()[:2000])

    check = check_capture(rig)

    assert check.findings[0].verdict == "bad"
    assert "cam02.mp4" in check.findings[0].measured


@pytest.mark.slow
def test_a_single_instant_leaves_timing_and_noise_unknown_with_the_reason(
    filmed, written_rig, tmp_path
):
    """One image per camera: what needs time says so, geometry and colour are evaluated as ever, in
    worker processes too.
    """
    for name in NAMES:
        write_image(tmp_path / "one" / name / "images" / "0000.png", filmed.frames[name][0])
    shutil.copy(written_rig / "poses_bounds.npy", tmp_path / "one")

    check = check_capture(tmp_path / "one", workers=2)

    assert accused(check) == {}
    for question, reason in (
        ("time offset", "1 frame, at least 8"),
        ("noise", "fewer than two"),
        ("frozen frames", "fewer than two"),
    ):
        assert {finding.verdict for finding in check.of(question)} == {"unknown"}
        assert reason in check.of(question)[0].measured
    assert answer(check, "epipolar error", "rig").values["n_pairs"] > 10


@pytest.mark.slow
def test_a_scene_in_which_nothing_moves_leaves_timing_unknown(filmed):
    """Videos that repeat one frame tell nothing about timing, and no camera is called frozen."""
    check = filmed.check(**{name: [frames[0]] * N_FRAMES for name, frames in filmed.frames.items()})

    assert accused(check) == {}
    assert {finding.verdict for finding in check.of("time offset")} == {"unknown"}
    assert "no motion that neighbours share" in check.of("time offset")[0].measured


@pytest.mark.slow
def test_depth_bounds_in_other_units_are_found(filmed):
    """Near and far ten times too large contradict the depth of the matches."""
    check = filmed.check(
        changed(
            filmed,
            "cam03",
            lambda camera: replace(camera, near=10 * camera.near, far=10 * camera.far),
        )
    )

    assert answer(check, "depth range", "cam03").verdict == "bad"
    assert accused(check)["depth range"] == {"cam03"}


@pytest.mark.slow
def test_run_check_writes_json_and_a_table_that_fits(written_rig, tmp_path):
    """The JSON holds every finding; the table has one line per question and stays within 130
    columns.
    """
    check, table = run_check(written_rig, tmp_path / "check.json")

    written = json.loads((tmp_path / "check.json").read_text())
    assert written["is_usable"] is True
    assert len(written["findings"]) == len(check.findings)
    assert max(map(len, table.splitlines())) <= 130
    for question in {finding.question for finding in check.findings}:
        assert sum(line.strip().startswith(question) for line in table.splitlines()) == 1
    assert not any(name in table for name in NAMES)


@pytest.mark.slow
def test_capture_of_one_camera_is_told_what_cannot_be_known(rig):
    """A lone camera has no neighbours: nothing fails, and each question that needs them is
    unknown.
    """
    for name in NAMES[1:]:
        (rig / f"{name}.mp4").unlink()
    write_llff_poses(rig / "poses_bounds.npy", read_llff_poses(rig / "poses_bounds.npy")[:1])

    check = check_capture(rig)

    assert check.is_usable
    for question in ("epipolar error", "time offset", "colour gain", "overlap"):
        assert {finding.verdict for finding in check.of(question)} == {"unknown"}


@pytest.mark.slow
def test_two_poses_at_one_place_blame_the_one_that_its_images_contradict(filmed):
    """Of two cameras with one pose the one whose matches fit it is let off."""
    pose = filmed.cameras[2].world_to_camera
    check = filmed.check(
        changed(filmed, "cam03", lambda camera: replace(camera, world_to_camera=pose))
    )

    assert answer(check, "poses", "cam03").verdict == "bad"
    assert answer(check, "poses", "cam02").verdict == "ok"
