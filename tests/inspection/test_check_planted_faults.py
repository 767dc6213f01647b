"""The check of a capture, on a small rig with one fault planted at a time."""

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from ggvs_eval.arrays import Image8
from ggvs_eval.camera import Camera
from ggvs_eval.datasets import open_capture
from ggvs_eval.datasets.llff import LlffPose, llff_pose, read_llff_poses, write_llff_poses
from ggvs_eval.files.images import quantise, write_image
from ggvs_eval.files.video import VideoFrames, write_video
from ggvs_eval.pipelines.inspection.capture.check import (
    QUESTIONS,
    CaptureCheck,
    check_capture,
    examine,
    record_cameras,
    run_check,
)

pytestmark = pytest.mark.slow

WIDTH, HEIGHT, N_FRAMES, COLUMNS = 320, 240, 24, 3

NAMES = tuple(f"cam{number:02d}" for number in range(2 * COLUMNS))
# Corner, width vector, height vector, and how the corner moves per second: x, y, z in units.
Board = tuple[Sequence[float], Sequence[float], Sequence[float], Callable[[float], Sequence[float]]]


def still(_: float) -> Sequence[float]:
    return (0.0, 0.0, 0.0)


BOARDS: list[Board] = [
    ((-9, -6, 10), (18, 0, 0), (0, 12, 0), still),
    ((-7, 2.2, 4), (14, 0, 0), (0, 1.5, 6), still),
    ((-4.5, -2.5, 8), (2.5, 0, 1.2), (0, 3, 0), still),
    ((1.5, -2.2, 7), (2.4, 0, -1.0), (0, 3, 0.4), still),
    ((-1.4, -0.5, 6), (1.8, 0.2, 0.5), (0, 2, 0), still),
    ((-3.0, 0.4, 6), (1.0, 0, 0), (0, 1, 0), lambda t: (0.5 * np.sin(9 * t), 0.3 * np.sin(5 * t + 1), 0)),
    ((1.2, 0.6, 5.5), (0.9, 0, 0.2), (0, 0.9, 0), lambda t: (0.2 * np.cos(7 * t), 0.6 * np.sin(8 * t), 0)),
    ((-0.4, -2.0, 6.5), (1.1, 0, 0), (0, 0.8, 0), lambda t: (0.7 * np.sin(6 * t + 2), 0.4 * np.sin(11 * t), 0.3 * np.sin(4 * t))),
]


def texture(seed: int, size: tuple[int, int]) -> Image8:
    """Coloured blots of several sizes, (height, width, 3)."""
    rng = np.random.default_rng(seed)
    image = np.zeros((size[1], size[0], 3), np.float32)
    for cell, weight in ((60, 0.6), (26, 0.9)):
        coarse = rng.random((size[1] // cell + 2, size[0] // cell + 2, 3), np.float32) - 0.5
        image += weight * cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC)
    return quantise(0.5 + 0.55 * image)


TEXTURES = [texture(index, (900, 600) if index < 2 else (240, 220)) for index in range(len(BOARDS))]


def make_cameras() -> list[Camera]:
    """Two rows of three that look at one point, each a little off."""
    rng = np.random.default_rng(3)
    cameras = []
    for index, name in enumerate(NAMES):
        centre = np.array([1.1 * (index % COLUMNS - 1.0), 0.9 * (index // COLUMNS - 0.5), 0.0]) + rng.normal(0, 0.06, 3)
        forward = np.array([0.0, 0.0, 7.0]) + rng.normal(0, 0.15, 3) - centre
        forward /= np.linalg.norm(forward)
        right = np.cross([0.0, 1.0, 0.0], forward)
        right /= np.linalg.norm(right)
        world_to_camera = np.eye(4)
        world_to_camera[:3, :3] = np.stack([right, np.cross(forward, right), forward])
        world_to_camera[:3, 3] = -world_to_camera[:3, :3] @ centre
        K = np.array([[0.6 * WIDTH, 0, WIDTH / 2], [0, 0.6 * WIDTH, HEIGHT / 2], [0, 0, 1.0]])
        cameras.append(Camera(name, K, world_to_camera, WIDTH, HEIGHT, 3.5, 12.0))
    return cameras


def draw(camera: Camera, time_s: float, rng: np.random.Generator) -> Image8:
    """All boards from back to front, each by its homography."""
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    for (corner, across, down, moves), picture in zip(BOARDS, TEXTURES, strict=True):
        height, width = picture.shape[:2]
        origin = np.asarray(corner, float) + moves(time_s)
        plane = np.stack([np.asarray(across) / width, np.asarray(down) / height, origin], axis=1)  # texture pixel to world
        plane = camera.rotation @ plane
        plane[:, 2] += camera.translation
        half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])  # OpenCV counts from the centre of the first pixel
        homography = np.linalg.inv(half) @ camera.K @ plane @ half
        seen = cv2.warpPerspective(np.ones((height, width), np.uint8), homography, (WIDTH, HEIGHT), flags=cv2.INTER_NEAREST)
        warped = cv2.warpPerspective(picture, homography, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REPLICATE)
        image[seen > 0] = warped[seen > 0]
    return quantise(image / 255 + rng.normal(0, 1.5 / 255, image.shape))


def film(camera: Camera, first: int = 0) -> list[Image8]:
    """What a camera records from frame `first` on."""
    rng = np.random.default_rng([7, NAMES.index(camera.name)])
    return [draw(camera, (first + index) / 30, rng) for index in range(N_FRAMES)]


@pytest.fixture(scope="module")
def clean(tmp_path_factory) -> Path:
    """A rig without fault; nobody changes it."""
    folder = tmp_path_factory.mktemp("check") / "rig"
    cameras = make_cameras()
    for camera in cameras:
        write_video(folder / f"{camera.name}.mp4", film(camera), 30.0)
    write_llff_poses(folder / "poses_bounds.npy", [llff_pose(camera) for camera in cameras])
    return folder


@pytest.fixture(scope="module")
def clean_records(clean):
    """What the clean rig's frames give; faults of the poses alone need not decode them again."""
    return record_cameras(open_capture(clean), 1)


@pytest.fixture
def rig(clean, tmp_path) -> Path:
    """A rig to damage."""
    return Path(shutil.copytree(clean, tmp_path / "rig"))


def edit_pose(folder: Path, name: str, change: Callable[[LlffPose], LlffPose]) -> None:
    poses = read_llff_poses(folder / "poses_bounds.npy")
    index = NAMES.index(name)
    poses[index] = change(poses[index])
    write_llff_poses(folder / "poses_bounds.npy", poses)


def edit_frames(folder: Path, name: str, change: Callable[[list[Image8]], list[Image8]]) -> None:
    video = VideoFrames(folder / f"{name}.mp4")
    write_video(video.path, change(list(video.frames(0, video.n_frames))), 30.0)


def scale_focal(factor: float) -> Callable[[LlffPose], LlffPose]:
    return lambda pose: pose._replace(hwf=(*pose.hwf[:2], pose.hwf[2] * factor))


def with_pose(rotation: np.ndarray, centre: np.ndarray) -> np.ndarray:
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3], world_to_camera[:3, 3] = rotation, -rotation @ centre
    return world_to_camera


def mirror_world(pose: LlffPose) -> LlffPose:
    """The pose in a world mirrored in x; it stays a rotation."""
    rotation, mirror = pose.world_to_camera[:3, :3], np.diag([-1.0, 1.0, 1.0])
    centre = -rotation.T @ pose.world_to_camera[:3, 3]
    return pose._replace(world_to_camera=with_pose(mirror @ rotation @ mirror, mirror @ centre))


def turn_half(pose: LlffPose) -> LlffPose:
    return pose._replace(world_to_camera=np.diag([1.0, -1.0, -1.0, 1.0]) @ pose.world_to_camera)


def examined(folder: Path, records) -> CaptureCheck:
    return CaptureCheck(folder, examine(open_capture(folder), records))


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


def test_a_rig_without_fault_has_no_bad_line_and_no_camera_to_look_at(clean, clean_records):
    """Nothing but the guessed units is remarked on, and every question but that is ok."""
    check = examined(clean, clean_records)

    assert accused(check) == {}
    assert check.is_usable
    assert {finding.verdict for finding in check.findings if finding.question != "units"} == {"ok"}
    assert answer(check, "epipolar error", "rig").values["median_px"] < 0.4
    assert answer(check, "time offset", "rig").values["largest_frames"] < 0.3


def test_swapped_cameras_are_named_with_the_mend(rig):
    """Two exchanged videos are both bad by epipolar error, said to fit each other's poses, and nobody else is blamed."""
    (rig / "cam01.mp4").rename(rig / "spare")
    (rig / "cam05.mp4").rename(rig / "cam01.mp4")
    (rig / "spare").rename(rig / "cam05.mp4")

    check = check_capture(rig)

    assert accused(check) == {"epipolar error": {"cam01", "cam05"}}
    assert not check.is_usable
    found = answer(check, "epipolar error", "cam01")
    assert found.verdict == "bad"
    assert found.values["fits_pose_of"] == "cam05"
    assert "exchange the frames of cam01 and cam05" in found.advice
    assert answer(check, "time offset", "cam01").verdict == "unknown"


@pytest.mark.parametrize("factor", [1.05, 0.95])
def test_a_wrong_focal_length_is_named_with_its_factor(rig, clean_records, factor):
    """One camera whose focal length is 5 % off is bad, and the factor that mends it is found within 1 %."""
    edit_pose(rig, "cam02", scale_focal(factor))

    check = examined(rig, clean_records)

    assert accused(check) == {"epipolar error": {"cam02"}, "intrinsics": {"cam02"}}
    found = answer(check, "epipolar error", "cam02")
    assert found.verdict == "bad"
    assert found.values["repair"] == "focal"
    assert found.values["focal_factor"] == pytest.approx(1 / factor, abs=0.01)


def test_a_focal_length_wrong_in_all_cameras_is_said_of_the_rig(rig, clean_records):
    """When all focal lengths are 10 % off no camera is blamed, the rig is, with the factor."""
    for name in NAMES:
        edit_pose(rig, name, scale_focal(1.1))

    check = examined(rig, clean_records)

    found = answer(check, "epipolar error", "rig")
    assert accused(check) == {"epipolar error": {"rig"}}
    assert found.verdict == "bad"
    assert found.values["focal_factor"] == pytest.approx(1 / 1.1, abs=0.03)


def test_a_mirrored_pose_that_is_still_a_rotation_is_found(rig, clean_records):
    """A pose mirrored in a world plane passes as a rotation; its epipolar error gives it away and the mirror is named."""
    edit_pose(rig, "cam03", mirror_world)

    check = examined(rig, clean_records)

    assert set(accused(check)["epipolar error"]) == {"cam03"}
    assert set().union(*accused(check).values()) == {"cam03"}
    found = answer(check, "epipolar error", "cam03")
    assert found.verdict == "bad"
    assert "mirrored in x" in found.measured


@pytest.mark.parametrize("axis", [1, 2])
def test_a_mirrored_system_of_all_cameras_is_named(rig, clean_records, axis):
    """Left-handed axes, the world's and the cameras', pass as rotations; the pictures contradict, and the mirror is named."""
    mirror = np.diag(np.where(np.arange(3) == axis, -1.0, 1.0))

    def left_handed(pose: LlffPose) -> LlffPose:
        rotation = pose.world_to_camera[:3, :3]
        return pose._replace(
            world_to_camera=with_pose(mirror @ rotation @ mirror, mirror @ (-rotation.T @ pose.world_to_camera[:3, 3]))
        )

    for camera in open_capture(rig).camera_names:
        edit_pose(rig, camera, left_handed)
    found = answer(examined(rig, clean_records), "epipolar error", "rig")

    assert found.verdict == "bad"
    assert f"its own {'xyz'[axis]} axis too (left-handed axes" in found.measured
    assert found.advice == "correct all cameras as named"


def test_a_pose_turned_round_is_found_by_pose_and_by_matches(rig, clean_records):
    """Half a turn about the x axis, as OpenGL's axes would be, looks away from the scene and puts the matches behind it."""
    edit_pose(rig, "cam05", turn_half)

    check = examined(rig, clean_records)

    assert answer(check, "poses", "cam05").verdict == "bad"
    assert answer(check, "epipolar error", "cam05").verdict == "bad"
    assert "OpenGL" in answer(check, "epipolar error", "cam05").measured
    assert set().union(*accused(check).values()) == {"cam05"}


def test_a_reflection_is_the_first_line_and_what_needs_poses_is_unknown(rig):
    """A pose with determinant -1: one bad line with the message; what frames alone tell is told, and no question passed over."""
    edit_pose(rig, "cam03", lambda pose: pose._replace(world_to_camera=np.diag([-1.0, 1, 1, 1]) @ pose.world_to_camera))

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
    assert {finding.measured for finding in others if finding.verdict == "unknown"} == {"the capture does not open"}
    assert not check.is_usable


@pytest.mark.parametrize("shift", [2, -2])
def test_a_camera_out_of_step_is_found(rig, shift):
    """One camera two frames ahead or behind is bad with its offset and the sign; all others are ok."""
    camera = open_capture(rig).camera("cam02")
    write_video(rig / "cam02.mp4", film(camera, shift), 30.0)

    check = check_capture(rig)

    found = answer(check, "time offset", "cam02")
    assert accused(check) == {"time offset": {"cam02"}}
    assert found.verdict == "bad"
    assert found.values["offset_frames"] == pytest.approx(shift, abs=0.3)
    assert ("ahead" if shift > 0 else "behind") in found.measured


def test_a_gain_of_15_percent_is_found(rig):
    """The camera that is 1.15 times as bright is warned of, its gain known within 2 %; all others are ok."""
    edit_frames(rig, "cam05", lambda frames: [quantise(1.15 * frame / 255) for frame in frames])

    check = check_capture(rig)

    found = answer(check, "colour gain", "cam05")
    assert accused(check) == {"colour gain": {"cam05"}}
    assert found.verdict == "warn"
    assert found.values["gain"] == pytest.approx([1.15] * 3, abs=0.02)


def test_frozen_frames_are_found(rig):
    """A frame that repeats the one before while the others move on is named; four of them are bad."""
    edit_frames(rig, "cam01", lambda frames: [*frames[:10], frames[9], *frames[11:]])
    edit_frames(rig, "cam04", lambda frames: [*frames[:12], *[frames[11]] * 4, *frames[16:]])

    check = check_capture(rig)

    one, four = (answer(check, "frozen frames", name) for name in ("cam01", "cam04"))
    assert (one.verdict, one.values["frames"]) == ("warn", [10])
    assert (four.verdict, four.values["frames"]) == ("bad", [12, 13, 14, 15])
    assert accused(check) == {"frozen frames": {"cam01", "cam04"}}


def test_damage_names_the_file_and_the_frame_and_the_other_cameras_go_on(rig):
    """Zeros in the middle of one video: that camera is bad from a certain frame on, all others are read to their end."""
    video = rig / "cam02.mp4"
    content = bytearray(video.read_bytes())
    content[len(content) // 2 : len(content) // 2 + 4000] = bytes(4000)
    video.write_bytes(bytes(content))

    check = check_capture(rig)

    found = answer(check, "frames", "cam02")
    assert found.verdict == "bad"
    assert "cam02.mp4" in found.measured
    assert 0 < found.values["damaged"][0] < N_FRAMES
    assert all(answer(check, "frames", name).values["n_read"] == N_FRAMES for name in NAMES if name != "cam02")
    assert accused(check) == {"frames": {"cam02"}}


def test_a_truncated_video_does_not_open(rig):
    """A video cut in half gives the adapter's message as a bad line, not an error."""
    video = rig / "cam02.mp4"
    video.write_bytes(video.read_bytes()[:2000])

    check = check_capture(rig)

    assert check.findings[0].verdict == "bad"
    assert "cam02.mp4" in check.findings[0].measured


def test_a_single_instant_leaves_timing_and_noise_unknown_with_the_reason(clean, tmp_path):
    """One image per camera: what needs time says so, geometry and colour are evaluated as ever, in worker processes too."""
    capture = open_capture(clean)
    for name in NAMES:
        write_image(tmp_path / "one" / name / "images" / "0000.png", capture.frame(name, 0))
    shutil.copy(clean / "poses_bounds.npy", tmp_path / "one")

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


def test_a_scene_in_which_nothing_moves_leaves_timing_unknown(clean, tmp_path):
    """Videos that repeat one frame tell nothing about timing, and no camera is called frozen."""
    capture = open_capture(clean)
    for name in NAMES:
        write_video(tmp_path / "still" / f"{name}.mp4", [capture.frame(name, 0)] * 9, 30.0)
    shutil.copy(clean / "poses_bounds.npy", tmp_path / "still")

    check = check_capture(tmp_path / "still")

    assert accused(check) == {}
    assert {finding.verdict for finding in check.of("time offset")} == {"unknown"}
    assert "no motion that neighbours share" in check.of("time offset")[0].measured


def test_depth_bounds_in_other_units_are_found(rig, clean_records):
    """Near and far ten times too large contradict the depth of the matches."""
    edit_pose(rig, "cam03", lambda pose: pose._replace(near=10 * pose.near, far=10 * pose.far))

    check = examined(rig, clean_records)

    assert answer(check, "depth range", "cam03").verdict == "bad"
    assert accused(check)["depth range"] == {"cam03"}


def test_run_check_writes_json_and_a_table_that_fits(clean, tmp_path):
    """The JSON holds every finding; the table has one line per question and stays within 130 columns."""
    import json

    check, table = run_check(clean, tmp_path / "check.json")

    written = json.loads((tmp_path / "check.json").read_text())
    assert written["is_usable"] is True
    assert len(written["findings"]) == len(check.findings)
    assert max(map(len, table.splitlines())) <= 130
    for question in {finding.question for finding in check.findings}:
        assert sum(line.strip().startswith(question) for line in table.splitlines()) == 1
    assert not any(name in table for name in NAMES)


def test_capture_of_one_camera_is_told_what_cannot_be_known(rig):
    """A lone camera has no neighbours: nothing fails, and each question that needs them is unknown."""
    for name in NAMES[1:]:
        (rig / f"{name}.mp4").unlink()
    write_llff_poses(rig / "poses_bounds.npy", read_llff_poses(rig / "poses_bounds.npy")[:1])

    check = check_capture(rig)

    assert check.is_usable
    for question in ("epipolar error", "time offset", "colour gain", "overlap"):
        assert {finding.verdict for finding in check.of(question)} == {"unknown"}


def test_two_poses_at_one_place_blame_the_one_that_its_images_contradict(rig, clean_records):
    """Of two cameras with one pose the one whose matches fit it is let off."""
    poses = read_llff_poses(rig / "poses_bounds.npy")
    edit_pose(rig, "cam03", lambda _: replace_pose(poses[3], poses[2]))

    check = examined(rig, clean_records)

    assert answer(check, "poses", "cam03").verdict == "bad"
    assert answer(check, "poses", "cam02").verdict == "ok"


def replace_pose(pose: LlffPose, other: LlffPose) -> LlffPose:
    return pose._replace(world_to_camera=other.world_to_camera)
