"""nerfstudio captures: transforms.json with one image per camera."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ggvs_eval.datasets import open_capture
from ggvs_eval.files.images import write_image
from helpers.captures import N_FRAMES, NAMES, make_image, make_rig, refusal, write_folders
from helpers.small_layouts import transforms, write_nerfstudio


def rewritten(folder: Path, **changes: Any) -> Path:
    """The capture with other values at the top of its file; None takes a value away."""
    values = {key: value for key, value in {**transforms(), **changes}.items() if value is not None}
    return write_nerfstudio(folder, values)


def test_opens_as_calibrated(tmp_path):
    """OpenGL's camera-to-world matrices become the rig that was written."""
    read = open_capture(write_nerfstudio(tmp_path / "scene"))
    assert (read.layout, read.camera_names, read.n_frames, read.fps) == (
        "nerfstudio",
        NAMES,
        1,
        0.0,
    )
    for index, (camera, truth) in enumerate(zip(read.cameras, make_rig(), strict=True)):
        np.testing.assert_allclose(camera.world_to_camera, truth.world_to_camera, atol=1e-12)
        np.testing.assert_allclose(camera.K, truth.K)
        assert np.array_equal(read.frame(camera.name, 0), make_image(index, 0))


def test_a_pose_by_hand(tmp_path):
    """A camera at (1, 2, 3) that looks along -z with y up sees a point before it to the upper right
    in the upper right.
    """
    pose = np.eye(4)
    pose[:3, 3] = (1.0, 2.0, 3.0)
    frames = transforms()["frames"]
    frames[0]["transform_matrix"] = pose.tolist()
    camera = open_capture(rewritten(tmp_path / "scene", frames=frames)).camera("cam00")
    uv, depth = camera.project(np.array([1.2, 2.1, 1.0]))
    assert depth == pytest.approx(2.0)
    np.testing.assert_allclose(uv, [32 + 0.9 * 64 * 0.1, 24 - 0.9 * 64 * 0.05])


def over_time(folder: Path, name: Callable[[int, int], str], timed: bool = True) -> Path:
    """A fixed rig at three instants in one file, which lists the last instant first."""
    frames = []
    for instant in (2, 1, 0):
        for place, frame in enumerate(transforms()["frames"]):
            frames.append(
                {**frame, "file_path": name(place, instant)}
                | ({"time": instant / 2} if timed else {})
            )
            write_image(folder / frames[-1]["file_path"], make_image(place, instant))
    (folder / "transforms.json").write_text(json.dumps({**transforms(), "frames": frames}))
    return folder


@pytest.mark.parametrize("timed", [True, False])
@pytest.mark.parametrize(
    "name",
    [
        lambda place, instant: f"images/{NAMES[place]}/{instant:04d}.png",
        lambda place, instant: f"images/{NAMES[place]}_{instant}.png",
        lambda place, instant: f"{instant:03d}/{NAMES[place]}.png",
    ],
    ids=["folders of cameras", "one folder", "folders of instants"],
)
def test_a_rig_over_time_in_one_file(tmp_path, name, timed):
    """Frames of one pose are one camera, in the order of their times, else of their numbers; the
    poses decide.
    """
    read = open_capture(over_time(tmp_path / "scene", name, timed))

    assert (read.camera_names, read.n_frames) == (NAMES, 3)
    for place, camera in enumerate(read.cameras):
        np.testing.assert_allclose(camera.centre, make_rig()[place].centre, atol=1e-12)
        for instant in range(3):
            assert np.array_equal(read.frame(camera.name, instant), make_image(place, instant))


def test_a_rig_over_time_lacks_nothing(tmp_path):
    """A picture that is not there is named; times that a camera lacks, and a camera that moves, are
    refused.
    """
    folder = over_time(
        tmp_path / "scene", lambda place, instant: f"images/{NAMES[place]}/{instant:04d}.png"
    )
    (folder / "images" / NAMES[1] / "0001.png").unlink()
    assert f"images/{NAMES[1]}/0001.png" in refusal(folder)
    content = json.loads((folder / "transforms.json").read_text())
    (folder / "transforms.json").write_text(json.dumps(content | {"frames": content["frames"][1:]}))
    assert f"{3 * len(NAMES) - 1} frames of {len(NAMES)} cameras" in refusal(folder)
    folder = over_time(
        tmp_path / "split",
        lambda place, instant: f"images/{NAMES[place]}/{instant:04d}.png",
        timed=False,
    )
    whole = json.loads((folder / "transforms.json").read_text())
    (folder / "transforms.json").unlink()
    rest, first = [f for f in whole["frames"] if NAMES[0] not in f["file_path"]], whole["frames"][0]
    for split, frames in (("train", rest), ("test", [first])):
        (folder / f"transforms_{split}.json").write_text(json.dumps(whole | {"frames": frames}))
    assert "wanted one frame count for all cameras" in refusal(folder)


def test_intrinsics_of_a_frame_win(tmp_path):
    """What a frame says itself goes before the top of the file."""
    frames = transforms()["frames"]
    frames[2] |= {"fl_x": 70.0, "fl_y": 71.0, "cx": 30.0, "cy": 25.0}
    read = open_capture(rewritten(tmp_path / "scene", frames=frames))
    assert read.cameras[2].K[[0, 1, 0, 1], [0, 1, 2, 2]].tolist() == [70.0, 71.0, 30.0, 25.0]
    np.testing.assert_allclose(read.cameras[1].K, make_rig()[1].K)


def test_angle_of_view_instead_of_a_focal_length(tmp_path):
    """camera_angle_x alone means square pixels and a centred principal point."""
    angle_rad = 2 * np.arctan(32 / 80.0)
    changes = {"fl_x": None, "fl_y": None, "cx": None, "cy": None, "camera_angle_x": angle_rad}
    K = open_capture(rewritten(tmp_path / "scene", **changes)).cameras[0].K
    np.testing.assert_allclose(K, [[80, 0, 32], [0, 80, 24], [0, 0, 1]])


@pytest.mark.parametrize(
    ("model", "numbers"),
    [
        ("OPENCV", {"k1": -0.1, "k2": 0.02, "p1": 0.02, "p2": -0.01, "k3": 0.003}),
        ("OPENCV", {"k1": 0.08, "k2": 0.02, "p1": 0.0, "p2": 0.0, "k3": 0.01}),
        ("OPENCV_FISHEYE", {"k1": 0.03, "k2": -0.01, "k3": 0.004, "k4": -0.001}),
    ],
    ids=["barrel", "pincushion", "fisheye"],
)
def test_distorted_frames_are_undistorted(tmp_path, model, numbers):
    """The lens has the file's numbers in OpenCV's order, and frames come back as the pinhole image
    of the camera.
    """
    capture = open_capture(rewritten(tmp_path / "scene", camera_model=model, **numbers))
    lens = capture.sources[1].lens
    assert (lens.model, lens.coefficients) == (
        "fisheye" if "k4" in numbers else "opencv",
        tuple(numbers.values()),
    )
    np.testing.assert_allclose(lens.K, make_rig()[1].K)
    np.testing.assert_allclose(capture.cameras[1].K, lens.undistorted_K())


def test_image_folders_of_the_cameras_names(tmp_path):
    """Folders of frames beside the file win over the single image."""
    folder = write_nerfstudio(tmp_path / "scene")
    write_folders(folder)
    read = open_capture(folder)
    assert read.n_frames == N_FRAMES
    assert np.array_equal(read.frame("cam02", 3), make_image(2, 3))


def changed_frame(**changes: Any) -> list[dict[str, Any]]:
    frames = transforms()["frames"]
    frames[1] = {key: value for key, value in {**frames[1], **changes}.items() if value is not None}
    return frames


SCALED = (
    np.array(transforms()["frames"][1]["transform_matrix"]) @ np.diag([1.5, 1.5, 1.4, 1.0])
).tolist()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"frames": None}, "got: no 'frames'; export it again"),
        ({"frames": []}, "got: 0 frames of 0 cameras"),
        ({"frames": 3}, "wanted frames with poses and intrinsics"),
        ({"frames": transforms()["frames"][:1] * 2}, "got: 2 frames of 1 cameras"),
        ({"frames": changed_frame(file_path=None)}, "got: no 'file_path'"),
        ({"frames": changed_frame(transform_matrix=None)}, "got: no 'transform_matrix'"),
        (
            {"frames": changed_frame(transform_matrix=[[1, 0], [0]])},
            "wanted frames with poses and intrinsics",
        ),
        (
            {"frames": changed_frame(transform_matrix=np.eye(3).tolist())},
            "images/cam01.png is not 4 x 4 finite numbers",
        ),
        (
            {"frames": changed_frame(transform_matrix=[[float("nan")] * 4] * 4)},
            "is not 4 x 4 finite numbers",
        ),
        (
            {"frames": changed_frame(transform_matrix=SCALED)},
            "is not rigid (axes of length 1.5, 1.5, 1.4",
        ),
        (
            {"frames": changed_frame(transform_matrix=np.zeros((4, 4)).tolist())},
            "is not rigid (axes of length 0, 0, 0",
        ),
        (
            {"frames": changed_frame(transform_matrix=np.diag([1, 1, -1, 1.0]).tolist())},
            "determinant -1.0000",
        ),
        (
            {
                "frames": changed_frame(
                    transform_matrix=(2 * np.eye(4) - np.diag([1, 1, 1, 0.0])).tolist()
                )
            },
            "last row",
        ),
        (
            {"camera_model": "EQUIRECTANGULAR"},
            "camera_model 'EQUIRECTANGULAR', known are PINHOLE, SIMPLE_PINHOLE, OPENCV",
        ),
        ({"k4": 0.1}, "k4 = 0.1 of OPENCV, which programs read differently"),
        ({"k1": "many"}, "could not convert string to float: 'many'"),
        ({"k1": float("inf")}, "finite coefficients"),
        ({"k1": 900.0}, "leave blank pixels even at 4 times"),
        ({"w": 0}, "wanted frames with poses and intrinsics"),
        ({"h": 10**400}, "wanted frames with poses and intrinsics"),
        ({"fl_x": -1.0}, "K must be fx 0 cx"),
        ({"fl_x": None, "fl_y": None}, "got: no 'fl_x, camera_angle_x, x_fov or K'"),
        ({"fl_x": None, "fl_y": None, "camera_angle_x": 0.0}, "float division by zero"),
        ({"cx": float("nan")}, "K must be fx 0 cx"),
        ({"w": 80}, "frames of 64 x 48 have another shape than the 80 x 48"),
    ],
)
def test_damaged_values(tmp_path, changes, message):
    """Whatever is missing, mistyped or makes no camera is refused in one line."""
    assert message in refusal(rewritten(tmp_path / "scene", **changes), "nerfstudio")


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "7", "null", "[" * 100000, '{"frames":' * 50000, "\ufeff{}", "\x00"]
)
def test_json_that_is_none(tmp_path, text):
    """Broken or endlessly nested JSON is refused in one line."""
    folder = write_nerfstudio(tmp_path / "scene")
    (folder / "transforms.json").write_text(text)
    assert "transforms.json: wanted frames with poses and intrinsics" in refusal(folder)


@pytest.mark.parametrize(
    "name",
    [
        "../secret.png",
        "images/../../secret.png",
        "ABSOLUTE",
        "images/..",
        "..",
        "x" * 5000,
        "a\nb.png",
        "\ud800.png",
    ],
)
def test_names_do_not_lead_out_of_the_capture(tmp_path, name):
    """A hostile file_path finds nothing outside the folder of the capture."""
    write_image(tmp_path / "secret.png", make_image(1, 0))
    name = str(tmp_path / "secret.png") if name == "ABSOLUTE" else name
    frames = [{**transforms()["frames"][0], "file_path": name}]
    folder = rewritten(tmp_path / "scene", frames=frames)
    assert "wanted frames of" in refusal(folder)


def test_bytes_that_are_no_text(tmp_path):
    """The file must be UTF-8, or say by its first bytes what else it is."""
    folder = write_nerfstudio(tmp_path / "scene")
    (folder / "transforms.json").write_bytes(
        json.dumps({**transforms(), "by": "Jürgen"}, ensure_ascii=False).encode("latin-1")
    )
    assert "transforms.json: wanted frames" in refusal(folder)


def test_axes_of_one_length_are_brought_to_one(tmp_path):
    """Blender's camera with a scale: places as they are, with a note; axes of different lengths
    stay refused.
    """
    values = transforms()
    for frame in values["frames"]:
        frame["transform_matrix"] = (
            np.array(frame["transform_matrix"]) @ np.diag([0.02, 0.02, 0.02, 1.0])
        ).tolist()
    read = open_capture(write_nerfstudio(tmp_path / "scene", values))
    for camera, truth in zip(read.cameras, make_rig(), strict=True):
        np.testing.assert_allclose(camera.world_to_camera, truth.world_to_camera, atol=1e-12)
    assert any("have the length 0.02: brought to 1" in note for note in read.notes)

    values["frames"][0]["transform_matrix"] = (
        np.array(values["frames"][0]["transform_matrix"]) @ np.diag([2, 1, 1, 1])
    ).tolist()
    assert "is not rigid (axes of length 0.04, 0.02, 0.02" in refusal(
        write_nerfstudio(tmp_path / "other", values)
    )


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"w": None, "h": None, "cx": 64.0, "cy": 48.0}, "K is of about 128 x 96 images"),
        ({"cx": 0.5, "cy": 0.5}, "fractions of the side"),
    ],
    ids=["no size", "fractions"],
)
def test_intrinsics_of_other_pictures_are_named(tmp_path, changes, reason):
    """Whose principal point says so; coefficients of 0 are not blamed."""
    message = refusal(rewritten(tmp_path / "scene", **changes))
    assert reason in message
    assert "coefficients" not in message


@pytest.mark.parametrize(
    ("key", "turn"),
    [("from_na", [1.0, -1, -1, 1]), ("from_mitsuba", [-1.0, 1, -1, 1])],
    ids=["NeuS2", "Mitsuba"],
)
def test_poses_in_the_axes_of_another_program(tmp_path, key, turn):
    """instant-ngp's words for cameras that are turned against OpenGL's are applied, not passed
    over.
    """
    values = transforms() | {key: True}
    for frame in values["frames"]:
        frame["transform_matrix"] = (np.array(frame["transform_matrix"]) @ np.diag(turn)).tolist()
    for camera, truth in zip(
        open_capture(write_nerfstudio(tmp_path, values)).cameras, make_rig(), strict=True
    ):
        np.testing.assert_allclose(camera.world_to_camera, truth.world_to_camera, atol=1e-12)


@pytest.mark.parametrize(
    "entry",
    [{"latlong": True}, {"ftheta_p1": 0.01}, {"from_blender": 1}, {"projection": "orthographic"}],
)
def test_entries_that_say_where_a_pixel_looks_are_not_passed_over(tmp_path, entry):
    """In the file or in a single frame: refused by name, unless they say no."""
    frames = transforms()["frames"]
    frames[1] |= entry
    message = refusal(rewritten(tmp_path / "frame", frames=frames))
    assert next(iter(entry)) in message
    assert "undistort the frames" in message
    assert (
        open_capture(rewritten(tmp_path / "no", **dict.fromkeys(entry, False))).camera_names
        == NAMES
    )


def test_pictures_of_two_splits_that_are_called_alike(tmp_path):
    """NeRF's synthetic scenes: the split is part of the name; views that were never rendered are
    left out, with a note.
    """
    values = transforms()
    for split, frames in (("train", values["frames"][:3]), ("test", values["frames"][:1:-1])):
        for number, frame in enumerate(frames):
            frames[number] = {**frame, "file_path": f"./{split}/r_{number}"}
            if (split, number) != ("test", 1):
                write_image(tmp_path / split / f"r_{number}.png", make_image(number, 0))
        (tmp_path / f"transforms_{split}.json").write_text(json.dumps({**values, "frames": frames}))
    read = open_capture(tmp_path)
    assert (read.camera_names, read.test_views) == (
        ("test_r_0", "train_r_0", "train_r_1", "train_r_2"),
        ("test_r_0",),
    )
    np.testing.assert_allclose(read.cameras[0].centre, make_rig()[3].centre, atol=1e-12)
    assert "test_r_1 left out: calibrated, but without frames" in read.notes


def test_a_field_of_view_that_is_not_read_is_named(tmp_path):
    """Before its absence from what is read: exporting the file again would write it again."""
    message = refusal(rewritten(tmp_path / "scene", fl_x=None, fl_y=None, fov=58.1))
    assert "fov: 58.1 belongs to the lens" in message


def test_transforms_in_a_folder_beside_the_pictures(tmp_path):
    """The file may lie in a folder of its own, with the way to the pictures from there."""
    values = transforms()
    for frame in values["frames"]:
        frame["file_path"] = f"../{frame['file_path']}"
    write_nerfstudio(tmp_path)
    (tmp_path / "transforms.json").unlink()
    (tmp_path / "nerf").mkdir()
    (tmp_path / "nerf" / "transforms.json").write_text(json.dumps(values))
    assert open_capture(tmp_path).camera_names == NAMES
