"""Captures as people have them: rounded poses, pictures on their side, uneven videos, frames
elsewhere, absurd sizes.
"""

import json
import os
import shutil
import struct
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from ggvs_eval.camera import Camera, nearest_rotation
from ggvs_eval.capture import Capture
from ggvs_eval.datasets import open_capture
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.images import read_image, write_image
from ggvs_eval.files.picture_header import read_picture_header
from ggvs_eval.files.video import VideoFrames, write_video
from ggvs_eval.pipelines.inspection.capture.check import check_capture
from helpers.captures import (
    HEIGHT,
    N_FRAMES,
    NAMES,
    WIDTH,
    make_image,
    make_rig,
    refusal,
    write_dynerf,
    write_folders,
    write_poses,
    write_timed_video,
)
from helpers.fuzz import CAPTURES, IMPOSTORS, add_long_key, read_everything
from helpers.refusals import refused
from helpers.small_layouts import (
    camera_toml,
    transforms,
    write_capture_toml,
    write_easymocap,
    write_nerfstudio,
)

ONE = 1 << 16  # of a display matrix
TURNED = {  # EXIF orientation -> quarter turns against the clock by which such a picture is shown
    1: 0,
    3: 2,
    6: 3,
    8: 1,
}
SOON_S = 5.0  # of a core
WAITS_S = 60.0  # by the clock, on a busy machine; a pipe that is read never ends


def with_poses(folder: Path, change: Callable[[np.ndarray], np.ndarray]) -> Path:
    """The rig of capture.toml with other poses."""
    text = (write_capture_toml(folder) / "capture.toml").read_text()
    for camera in make_rig():
        pose = camera.world_to_camera.copy()
        pose[:3, :3] = change(pose[:3, :3])
        text = text.replace(str(camera.world_to_camera.tolist()), str(pose.tolist()))
    (folder / "capture.toml").write_text(text)
    return folder


def noise(amount: float) -> np.ndarray:
    return amount * np.random.default_rng(3).uniform(-1, 1, (3, 3))


def assert_rotations(capture: Capture) -> None:
    for camera in capture.cameras:
        assert np.abs(camera.rotation @ camera.rotation.T - np.eye(3)).max() < 1e-14
        assert np.linalg.det(camera.rotation) == pytest.approx(1)


@pytest.mark.parametrize("amount", [2e-4, 9e-3])
def test_rotations_that_are_off_by_little_are_straightened(amount, tmp_path):
    """The nearest rotation takes their place and a note names the deviation; the camera stays where
    it stood.
    """
    capture = open_capture(with_poses(tmp_path / "rig", lambda rotation: rotation + noise(amount)))

    assert_rotations(capture)
    (note,) = (each for each in capture.notes if "depth range" not in each)
    largest = max(camera.deviation for camera in capture.cameras)
    assert all(part in note for part in ("cam00, cam01, cam02, cam03", f"{largest:.1e}", "nearest"))
    assert amount / 4 < largest <= amount
    for given, camera in zip(make_rig(), capture.cameras, strict=True):
        matrix = given.rotation + noise(amount)
        assert camera.centre == pytest.approx(
            -np.linalg.solve(matrix, given.translation), abs=1e-12
        )
        # the stationary point of the distance: R^T M is symmetric
        nearest = nearest_rotation(matrix)[0]
        assert nearest.T @ matrix == pytest.approx((nearest.T @ matrix).T, abs=1e-12)
        assert camera.rotation == pytest.approx(nearest, abs=1e-14)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda rotation: rotation + noise(3e-2),
            "off the nearest rotation's, where 0.01 can be corrected",
        ),
        (lambda rotation: 2 * rotation, "where 0.01 can be corrected; scaled or rounded?"),
        (lambda rotation: 1e200 * rotation, "where 0.01 can be corrected"),
        (
            lambda rotation: rotation * [1, 1, -1],
            "determinant +1, got determinant -1.0000; check axis order",
        ),
    ],
)
def test_what_is_no_rotation_is_refused(change, message, tmp_path):
    """Noise beyond what can be corrected, scaled axes, numbers without sense, a mirror."""
    assert message in refusal(with_poses(tmp_path / "rig", change))


def test_rotations_as_files_keep_them_stay_bit_by_bit():
    """What is orthonormal to 1e-4 is not touched: results of captures that were read before stay
    the same.
    """
    camera = make_rig()[0]
    pose = camera.world_to_camera.round(5)

    kept = Camera("cam00", camera.K, pose, WIDTH, HEIGHT, 2.0, 8.0)

    assert kept.deviation == 0
    assert np.array_equal(kept.world_to_camera, pose)


def test_llff_and_nerfstudio_poses_are_straightened(tmp_path):
    """Where the file states camera-to-world, the centre is the file's."""
    llff = write_dynerf(tmp_path / "llff")
    rows = np.load(llff / "poses_bounds.npy")
    rows[:, :15].reshape(-1, 3, 5)[:, :, :3] *= 1.0002
    np.save(llff / "poses_bounds.npy", rows)
    values = transforms()
    for frame in values["frames"]:
        matrix = np.array(frame["transform_matrix"])
        matrix[:3, :3] *= 1.005
        frame["transform_matrix"] = matrix.tolist()

    for capture, deviation in (
        (open_capture(llff), "2.0e-04"),
        (open_capture(write_nerfstudio(tmp_path / "ns", values)), "5.0e-03"),
    ):
        assert_rotations(capture)
        assert f"off by up to {deviation}" in capture.notes[0]
        for given, camera in zip(make_rig(), capture.cameras, strict=True):
            assert camera.centre == pytest.approx(given.centre, abs=1e-9)


def turned_video(path: Path, images: list[np.ndarray], matrix: tuple[int, ...]) -> None:
    """A video with this display matrix: its 2 x 2 part."""
    write_video(path, images, 30.0, crf=0)
    content = bytearray(path.read_bytes())
    at = content.index(b"tkhd") + 44
    a, b, c, d = matrix
    content[at : at + 36] = struct.pack(">9i", a, b, 0, c, d, 0, 0, 0, 1 << 30)
    path.write_bytes(content)


@pytest.mark.parametrize(
    ("orientation", "matrix"),
    [
        (1, (ONE, 0, 0, ONE)),
        (6, (0, ONE, -ONE, 0)),
        (3, (-ONE, 0, 0, -ONE)),
        (8, (0, -ONE, ONE, 0)),
    ],
)
def test_pictures_and_videos_are_turned_by_one_rule(orientation, matrix, tmp_path):
    """EXIF in JPEG and PNG and a video's display matrix: the same picture comes out, in the size
    that its header promises.
    """
    upright = np.zeros((48, 64, 3), np.uint8)
    upright[:16], upright[:, :16] = (250, 40, 40), (40, 40, 250)
    stored = np.ascontiguousarray(np.rot90(upright, -TURNED[orientation]))
    exif = Image.Exif()
    exif[0x0112] = orientation
    files = [tmp_path / "a.jpg", tmp_path / "a.png"]
    for file in files:
        Image.fromarray(stored).save(
            file, exif=exif, **({"quality": 98, "subsampling": 0} if file.suffix == ".jpg" else {})
        )
    turned_video(tmp_path / "a.mp4", [stored] * 2, matrix)

    video = VideoFrames(tmp_path / "a.mp4")

    assert (
        [read_picture_header(file).size for file in files]
        == [(64, 48), (64, 48)]
        == [video.size] * 2
    )
    for image in (*map(read_image, files), *video.frames(0, 2)):
        assert image.shape == upright.shape
        assert np.abs(image.astype(int) - upright).mean() < 6  # 4:2:0 blurs the edges of colour


def test_a_turn_that_does_not_fit_the_calibration_is_refused(tmp_path):
    """A picture that is shown upright in a rig that was calibrated on its side: the sizes
    say so.
    """
    folder = write_capture_toml(tmp_path / "rig")
    turned_video(
        folder / "videos" / "cam00.mp4",
        [make_image(0, frame) for frame in range(2)],
        (0, ONE, -ONE, 0),
    )

    assert (
        "frames of 48 x 64 have another shape than the 64 x 48 that cam00 is calibrated for"
        in refusal(folder)
    )


def test_a_turn_by_any_other_angle_is_refused(tmp_path):
    """Nobody resamples here."""
    turned_video(tmp_path / "a.mp4", [make_image(0, 0)], (46341, 46341, -46341, 46341))

    with refused(CaptureError, "a.mp4", "right angles", "-45"):
        list(VideoFrames(tmp_path / "a.mp4").frames(0, 1))


def test_a_variable_frame_rate_is_said(tmp_path):
    """By camera and with the shortest and longest step; a constant one is not."""
    folder = write_dynerf(tmp_path / "room")
    assert open_capture(folder).notes == ()

    for index, name in enumerate(NAMES):
        images = [make_image(index, frame) for frame in range(N_FRAMES)]
        write_timed_video(
            folder / f"{name}.mp4", images, (0, 24, 52, 98, 120) if index else (0, 30, 60, 90, 120)
        )

    assert (
        "variable frame rate in cam01 (36.7 to 76.7 ms), cam02 (36.7 to 76.7 ms), cam03 (36.7 to "
        "76.7 ms): frame t of each camera counts as one instant, regardless of its time; their "
        "times differ by up to 13.3 ms"
    ) in open_capture(folder).notes


def test_frames_that_are_no_rgb_are_said(tmp_path):
    """Grey, palettes and 16 bits in folders, 10 bits in videos: by camera, and of how many
    frames.
    """
    folder = write_folders(tmp_path / "room")
    write_poses(folder, make_rig())
    grey, palette, deep = (folder / name / "images" / "0001.png" for name in NAMES[:3])
    Image.open(grey).convert("L").save(grey)
    Image.open(palette).convert("P").save(palette)
    cv2.imwrite(str(deep), cv2.imread(str(deep)).astype(np.uint16) * 257)

    assert open_capture(folder).notes == (
        f"frames of {NAMES[0]} (1 of {N_FRAMES}) are read grey, the same level in all three "
        f"channels",
        f"frames of {NAMES[1]} (1 of {N_FRAMES}) are read in the colours of a palette",
        f"frames of {NAMES[2]} (1 of {N_FRAMES}) are read cut from 16 to 8 bits",
    )
    np.testing.assert_array_equal(next(open_capture(folder).frames(NAMES[2], 1)), make_image(2, 1))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda file: file.with_suffix(".webp"),
            "gaps between 0 and 2, and 1 .webp unsupported pictures: convert them",
        ),
        (
            lambda file: file.with_name("other0002.png"),
            "several with the number 2 (0002.png and other0002.png)",
        ),
    ],
)
def test_frames_in_another_format_or_twice_are_named(change, message, tmp_path):
    """A gap may be a picture that is not read, a number may stand on two pictures."""
    folder = write_folders(tmp_path / "room")
    write_poses(folder, make_rig())
    file = folder / NAMES[0] / "images" / "0001.png"
    file.rename(change(file))

    assert message in refusal(folder)


@pytest.mark.parametrize("key", ["R_01", "Rot_01"])
def test_nan_in_either_rotation_of_extri_is_refused(key, tmp_path):
    """Also in the one that is not used."""
    folder = write_easymocap(tmp_path / "room")
    text = (folder / "extri.yml").read_text()
    start = text.index("[", text.index(f"{key}:")) + 1
    (folder / "extri.yml").write_text(text[:start] + " .Nan" + text[text.index(",", start) :])

    assert f"extri.yml: wanted finite numbers in {key}, got .Nan" in refusal(folder)


def write_hololens(folder: Path, depth: Callable[[int], np.ndarray]) -> Path:
    """An RGB-D sequence of two frames without intrinsics of its depth."""
    rig = make_rig(("cam00", "cam01"))
    (folder / "depth").mkdir(parents=True)
    for index in range(2):
        write_image(folder / "images" / f"{index}.png", make_image(index, 0))
        cv2.imwrite(str(folder / "depth" / f"{index}.png"), depth(index).astype(np.uint16))
    np.savetxt(
        folder / "poses.txt",
        np.stack([np.linalg.inv(camera.world_to_camera).ravel() for camera in rig]),
    )
    np.savetxt(folder / "K.txt", rig[0].K)
    return folder


@pytest.mark.parametrize(
    ("depth", "message"),
    [
        (
            lambda index: np.full((24, 24), 3000),
            "0.png: wanted depth of the shape of its 64 x 48 image, got 24 x 24",
        ),
        (
            lambda index: np.full((24, 32), 3000 * index),
            "0.png: wanted measured depth, got zeros alone; leave this frame out",
        ),
        (
            lambda index: np.full((24, 32 + 32 * index), 3000),
            "1.png: wanted 32 x 24 like the camera's other frames, got 64 x 24",
        ),
    ],
)
def test_depth_of_another_shape_or_of_nothing_is_refused(depth, message, tmp_path):
    """Depth that is cropped or stretched against its picture, a map of zeros, maps of several
    sizes.
    """
    assert message in refusal(write_hololens(tmp_path / "room", depth))


def test_depth_of_another_shape_needs_intrinsics_that_fit_it(tmp_path):
    """A wide colour camera beside a square sensor is fine; maps cropped after they were calibrated
    are not.
    """
    folder = CAPTURES["rgbd"](tmp_path / "room")
    for index in range(2):
        cv2.imwrite(str(folder / "depth" / f"{index}.png"), np.full((30, 32), 3000, np.uint16))
    assert "wanted a principal point near the middle of 32 x 30 images, got (16, 12)" in refusal(
        folder
    )

    K = np.eye(4)
    K[:3, :3] = [[28.8, 0, 16], [0, 28.8, 15], [0, 0, 1]]
    np.savetxt(folder / "intrinsic" / "intrinsic_depth.txt", K)
    assert open_capture(folder).sensed_cameras == {"000000", "000001"}


@pytest.mark.parametrize("how", ["a path", "a link"])
def test_frames_outside_the_capture_are_named_by_check(how, tmp_path):
    """Whether the file leads out of its folder or a link does."""
    folder = write_capture_toml(tmp_path / "rig")
    shutil.move(folder / "frames" / "cam01", tmp_path / "elsewhere")
    if how == "a link":
        (folder / "frames" / "cam01").symlink_to(tmp_path / "elsewhere")
    else:
        text = (folder / "capture.toml").read_text()
        (folder / "capture.toml").write_text(text.replace('"frames/cam01"', '"../elsewhere"'))

    finding = check_capture(folder).of("frames")[0]

    assert finding.verdict == "warn"
    assert (
        f"frames of cam01 are outside the capture's folder, in {tmp_path / 'elsewhere'}"
        in finding.measured
    )
    assert list(finding.values["outside"]) == ["cam01"]
    assert check_capture(write_capture_toml(tmp_path / "whole")).of("frames")[0].verdict == "ok"


def test_units_tell_what_is_known(tmp_path):
    """Where metres are guessed, near and far stand as they were given and nothing is told in
    metres.
    """
    file = write_capture_toml(tmp_path / "rig") / "capture.toml"
    text = file.read_text().replace("height = 48", "height = 48\nnear = 5.0\nfar = 14.0")
    for head, measured in (
        ("", "unknown scale; in world units the scene is within 5 .. 14, 8.37 at"),
        ("units_per_metre = 1.0\n", "8.37 m away"),
    ):
        file.write_text(head + text)
        assert measured in check_capture(file.parent).of("units")[0].measured


def many_frames(folder: Path, count: int) -> Path:
    values = transforms()
    values["frames"] = [
        {**values["frames"][0], "file_path": f"images/c{index}.png"} for index in range(count)
    ]
    return write_nerfstudio(folder, values)


def many_rows(folder: Path, count: int) -> Path:
    write_dynerf(folder)
    np.save(
        folder / "poses_bounds.npy",
        np.repeat(np.load(folder / "poses_bounds.npy")[:1], count, axis=0),
    )
    return folder


def many_poses(folder: Path, count: int) -> Path:
    write_hololens(folder, lambda index: np.full((24, 32), 3000))
    for index in range(2, count):
        os.link(folder / "images" / "0.png", folder / "images" / f"{index}.png")
    return folder


def many_names(folder: Path, count: int) -> Path:
    write_easymocap(folder)
    text = (folder / "intri.yml").read_text()
    names = "names:\n" + "".join(f'   - "{index}"\n' for index in range(count))
    (folder / "intri.yml").write_text(text.replace("names:\n", names))
    return folder


def many_models(folder: Path, count: int) -> Path:
    CAPTURES["spaces"](folder)
    (at,) = json.loads((folder / "models.json").read_text())
    (folder / "models.json").write_text(json.dumps([at * (count // len(at))]))
    return folder


@pytest.mark.parametrize(
    "write",
    [
        many_frames,
        many_rows,
        pytest.param(many_poses, marks=pytest.mark.slow),
        many_names,
        many_models,
    ],
)
def test_a_rig_of_more_than_10_000_cameras_is_refused_at_once(write, tmp_path):
    """Before poses are read, and before anything of every pair of cameras is held in memory."""
    folder = write(tmp_path / "rig", 10_002)
    begun_s = time.process_time()

    assert "wanted at most 10000 cameras, got 1000" in refusal(folder)
    assert time.process_time() - begun_s < SOON_S


def test_a_description_of_20_000_cameras_is_too_large(tmp_path):
    """TOML's parser takes a second per megabyte; its limit is one of bytes."""
    folder = write_capture_toml(tmp_path / "rig")
    (folder / "capture.toml").write_text(20_000 * camera_toml(make_rig()[0], "frames/cam01"))
    begun_s = time.process_time()

    assert "capture.toml: wanted a TOML file, got: 6 MB, above the limit of 4 MB" in refusal(folder)
    assert time.process_time() - begun_s < SOON_S


HEADERS = {
    "capture.toml": "capture.toml",
    "d3dmv": "scene000_pb.npy",
    "spaces": "models.json",
    "rgbd": "pose/0.txt",
    "multipleview": "cam01/frame_00001.png",
    "dynerf": "cam00.mp4",
    "enerf-outdoor": "extri.yml",
    "colmap": "sparse/0/points3D.bin",
    "nerfstudio": "transforms.json",
}


@pytest.mark.parametrize("impostor", [name for name in IMPOSTORS if name != "nothing"])
@pytest.mark.parametrize("layout", HEADERS)
def test_impostors_are_refused_at_once(layout, impostor, tmp_path):
    """A pipe, a device, an endless file, a folder or a link that leads nowhere in the place of a
    file of any layout.
    """
    folder = CAPTURES[layout](tmp_path / "room")
    (folder / HEADERS[layout]).unlink()
    IMPOSTORS[impostor](folder / HEADERS[layout])
    begun_s = time.monotonic()

    assert read_everything(folder) not in CAPTURES
    assert time.monotonic() - begun_s < WAITS_S


@pytest.mark.parametrize(
    ("layout", "file"),
    [
        ("capture.toml", "capture.toml"),
        ("enerf-outdoor", "extri.yml"),
        ("nerfstudio", "transforms.json"),
        ("rgbd", "pose/0.txt"),
    ],
)
def test_keys_of_60_kb_are_read_or_refused_at_once(layout, file, tmp_path):
    """Nobody looks for likely names, and no message repeats them."""
    folder = CAPTURES[layout](tmp_path / "room")
    add_long_key(folder / file)
    begun_s = time.process_time()

    assert len(read_everything(folder)) < 1500
    assert time.process_time() - begun_s < SOON_S
