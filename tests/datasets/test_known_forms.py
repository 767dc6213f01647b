"""Forms in which people bring captures: known ones are read with their values, others named."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import av
import numpy as np
import pytest
from av.video.reformatter import ColorPrimaries, ColorTrc

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.datasets import open_capture
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.images import write_image
from ggvs_eval.lens import Lens
from ggvs_eval.pipelines.inspection.capture.check import check_capture, open_uncalibrated
from ggvs_eval.pipelines.offline.calibration.known_cameras import read_known
from ggvs_eval.pipelines.run.suggest_protocol import propose_protocol
from helpers.captures import (
    HEIGHT,
    N_FRAMES,
    NAMES,
    WIDTH,
    make_image,
    make_rig,
    refusal,
    write_colmap,
    write_poses,
    write_videos,
)
from helpers.community_layouts import write_frame_folders
from helpers.lens_pictures import psnr, straight, through_lens
from helpers.small_layouts import opencv_K, transforms, write_nerfstudio, write_storage


def assert_rig(
    capture: Capture, names: tuple[str, ...] = NAMES, rig: list[Camera] | None = None
) -> None:
    """The cameras of `make_rig`, in that order."""
    assert capture.camera_names == names
    for camera, truth in zip(capture.cameras, rig or make_rig(names), strict=True):
        np.testing.assert_allclose(camera.world_to_camera, truth.world_to_camera, atol=1e-9)
        np.testing.assert_allclose(camera.K, truth.K, atol=1e-9)


def test_folders_of_instants(tmp_path):
    """3DGStream's frameNNNNNN/images are instants, not cameras: each camera shows its picture of
    every one.
    """
    capture = open_capture(write_frame_folders(tmp_path / "scene", NAMES))
    assert (capture.layout, capture.n_frames) == ("3dgstream", 2)
    assert_rig(capture)
    assert np.array_equal(capture.frame("cam02", 1), make_image(2, 1))


def test_folders_of_instants_without_a_model(tmp_path):
    """Without poses they are still no cameras: `check` ends bad and names the folder, the layout
    and the way on.
    """
    folder = write_frame_folders(tmp_path / "scene", NAMES)
    shutil.rmtree(folder / "frame000000" / "sparse")
    check = check_capture(folder)
    assert not check.is_usable
    assert (
        "frame000000 exists, but the capture is incomplete, 3dgstream" in check.findings[0].measured
    )
    assert "ggvs-eval calibrate" in check.findings[0].measured


@pytest.mark.parametrize("suffix", [".png", ".JPG"])
def test_stills_of_llff(tmp_path, suffix):
    """poses_bounds.npy with one picture per camera in images/ is one instant; rows follow the order
    of names.
    """
    write_poses(tmp_path, make_rig())
    for index in range(4):
        write_image(tmp_path / "images" / f"IMG_{4000 + index}.png", make_image(index, 0))
    for file in list((tmp_path / "images").iterdir()) if suffix == ".JPG" else ():
        import cv2

        cv2.imwrite(str(file.with_suffix(".jpg")), cv2.imread(str(file)))
        file.with_suffix(".jpg").rename(file.with_suffix(suffix))
        file.unlink()
    capture = open_capture(tmp_path)
    assert (capture.layout, capture.n_frames, capture.fps) == ("dynerf", 1, 0.0)
    assert_rig(capture, tuple(f"IMG_{4000 + index}" for index in range(4)))
    assert np.abs(capture.frame("IMG_4003", 0).astype(int) - make_image(3, 0)).max() < 12
    (tmp_path / "images" / f"IMG_4003{suffix}").unlink()
    assert (
        "wanted one row for each of the 3 cameras on disk (IMG_4000, IMG_4001, IMG_4002), got 4 "
        "rows" in refusal(tmp_path)
    )


def write_splits(folder: Path) -> Path:
    """NeRF's files: an angle of view, no size, no suffixes, and the last two cameras in test/."""
    values = transforms()
    for split, frames in (("train", values["frames"][:2]), ("test", values["frames"][2:])):
        for frame in frames:
            name = Path(frame["file_path"]).stem
            write_image(folder / split / f"{name}.png", make_image(NAMES.index(name), 0))
            frame["file_path"] = f"./{split}/{name}"
        angle = {"camera_angle_x": 2 * np.arctan(0.5 / 0.9), "frames": frames}
        (folder / f"transforms_{split}.json").write_text(json.dumps(angle))
    return folder


def test_split_files_are_one_rig(tmp_path):
    """transforms_train and _test are the cameras of one rig, whose test views are proposed, seen
    from the others.
    """
    capture = open_capture(write_splits(tmp_path / "scene"))
    assert_rig(capture)
    assert capture.n_frames == 1
    assert np.array_equal(capture.frame("cam03", 0), make_image(3, 0))
    protocol = propose_protocol(capture).protocol
    assert (protocol.views.test, protocol.views.sources) == (("cam02", "cam03"), ("cam00", "cam01"))
    assert (protocol.views.chosen_by, protocol.synthesis.k) == ("the capture's own split", 2)


def test_a_split_by_file_names(tmp_path):
    """Nerfstudio's test_filenames name test views as well."""
    folder = write_nerfstudio(
        tmp_path / "scene", transforms() | {"test_filenames": ["images/cam01.png"]}
    )
    assert open_capture(folder).test_views == ("cam01",)


def changed(folder: Path, **changes: object) -> Path:
    values = {key: value for key, value in {**transforms(), **changes}.items() if value is not None}
    return write_nerfstudio(folder, values)


def test_sizes_of_the_pictures(tmp_path):
    """What the pictures say is not asked of the file."""
    assert_rig(open_capture(changed(tmp_path / "scene", w=None, h=None)))


def test_matrices_of_intrinsics(tmp_path):
    """K as a matrix of a frame; beside focal lengths both must agree."""
    frames = transforms()["frames"]
    for frame, camera in zip(frames, make_rig(), strict=True):
        frame["K"] = camera.K.tolist()
    assert_rig(
        open_capture(
            changed(tmp_path / "scene", fl_x=None, fl_y=None, cx=None, cy=None, frames=frames)
        )
    )
    frames[1]["K"][0][0] *= 1.5
    assert "two intrinsics of images/cam01.png" in refusal(
        changed(tmp_path / "other", frames=frames)
    )


@pytest.mark.parametrize("coefficients", [(0.0, 0.0, 0.0, 0.0), (0.03, -0.01, 0.004, -0.001)])
def test_is_fisheye_is_read(tmp_path, coefficients):
    """instant-ngp's word for an equidistant lens, with coefficients or without."""
    lens = Lens(make_rig()[0].K, "fisheye", coefficients, WIDTH, HEIGHT)
    named = dict(zip(("k1", "k2", "k3", "k4"), coefficients, strict=True))
    folder = changed(tmp_path / "scene", camera_model=None, is_fisheye=True, **named)
    write_image(folder / "images" / "cam01.png", through_lens(lens))
    capture = open_capture(folder)
    np.testing.assert_allclose(capture.cameras[1].K, lens.undistorted_K())
    assert psnr(capture.frame("cam01", 0), straight(lens, capture.cameras[1].K)) > 42
    assert "is_fisheye True of camera_model OPENCV" in refusal(
        changed(tmp_path / "both", is_fisheye=True)
    )


def test_keys_that_nobody_knows_are_named(tmp_path):
    """A key that is neither used nor harmless is a note, once; harmless ones are none."""
    capture = open_capture(changed(tmp_path / "scene", aabb_scale=16, rolling_shutter_time=0.03))
    assert [note for note in capture.notes if "unknown here" in note] == [
        "transforms.json: rolling_shutter_time unknown here, ignored"
    ]


def test_frames_of_different_times_are_no_rig(tmp_path):
    """D-NeRF's moving camera is not taken for cameras of one instant."""
    frames = transforms()["frames"]
    for index, frame in enumerate(frames):
        frame["time"] = index / 3
    assert "got 4 times" in refusal(changed(tmp_path / "scene", frames=frames))


def write_caliscope(folder: Path) -> tuple[str, ...]:
    """camera_array.toml beside cam_0.mp4, ..."""
    names, text = tuple(f"cam_{index}" for index in range(4)), ""
    write_videos(folder, names)
    for index, camera in enumerate(make_rig(names)):
        text += (
            f"[cameras.{index}]\ncam_id = {index}\nrotation_count = 0\nsize = [{WIDTH}, {HEIGHT}]\n"
        )
        text += f"matrix = {opencv_K(camera).tolist()}\ndistortions = [0.0, 0.0, 0.0, 0.0, 0.0]\n"
        text += (
            f"rotation = {camera.rotation.tolist()}\ntranslation = "
            f"{camera.translation.tolist()}\n\n"
        )
    text += (
        f"[cameras.4]\ncam_id = 4\nmatrix = {np.eye(3).tolist()}\nignore = true\nrotation = "
        f'"null"\n'
    )
    (folder / "camera_array.toml").write_text(text)
    return names


def write_xml(folder: Path) -> tuple[str, ...]:
    """One FileStorage XML per camera, as OpenCV's own sample writes them."""
    write_videos(folder)
    for camera in make_rig():
        entries = {"image_width": WIDTH, "image_height": HEIGHT, "camera_matrix": opencv_K(camera)}
        entries |= {
            "distortion_coefficients": np.zeros((5, 1)),
            "R": camera.rotation,
            "T": camera.translation.reshape(3, 1),
        }
        write_storage(folder / f"{camera.name}.xml", entries)
    return NAMES


@pytest.mark.parametrize(("write", "layout"), [(write_caliscope, "anipose"), (write_xml, "opencv")])
def test_calibrations_of_other_programs(tmp_path, write: Callable[[Path], tuple[str, ...]], layout):
    """Caliscope's table of tables and OpenCV's XML, whose rotations are matrices, beside videos."""
    names = write(tmp_path)
    capture = open_capture(tmp_path)
    assert (capture.layout, capture.n_frames) == (layout, N_FRAMES)
    assert_rig(capture, names)


@pytest.mark.parametrize(("model", "kind"), [("plumb_bob", "opencv"), ("equidistant", "fisheye")])
def test_lenses_of_ros(tmp_path, model, kind):
    """ROS' YAML has the keys of OpenCV's, without its first line and types."""
    coefficients = [0.1, 0.01, 0.0, 0.0] + [0.0] * (kind == "opencv")
    for camera in make_rig():
        data = ", ".join(map(str, opencv_K(camera).ravel()))
        text = f"image_width: {WIDTH}\nimage_height: {HEIGHT}\ncamera_name: {camera.name}\n"
        text += (
            f"camera_matrix:\n  rows: 3\n  cols: 3\n  data: [{data}]\ndistortion_model: {model}\n"
        )
        text += (
            f"distortion_coefficients:\n  rows: 1\n  cols: {len(coefficients)}\n  data: "
            f"{coefficients}\n"
        )
        (tmp_path / f"{camera.name}.yaml").write_text(text)
    known = read_known(tmp_path)
    assert tuple(known) == NAMES
    for camera in make_rig():
        np.testing.assert_allclose(known[camera.name].lens.K, camera.K)
        assert (known[camera.name].lens.model, known[camera.name].world_to_camera) == (kind, None)


def test_a_camera_without_a_pose_in_the_file(tmp_path):
    """Of a calibration file too, cameras that were not placed are left out and noted."""
    write_xml(tmp_path)
    storage = (tmp_path / "cam03.xml").read_text()
    (tmp_path / "cam03.xml").write_text(storage.replace("<R ", "<X ").replace("</R>", "</X>"))
    capture = open_capture(tmp_path)
    assert_rig(capture, NAMES[:3])
    assert "cam03 left out: calibrated, but without a pose" in capture.notes


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        (
            "cameras_parameters.txt",
            "x",
            "cameras_parameters.txt exists, but the capture is incomplete, technicolor",
        ),
        ("transforms_val.json.bak", "", None),
        ("transforms_test2.json", "{}", "transforms_test2.json exists"),
        (
            "intri.yml",
            "%YAML:1.0\n",
            "intri.yml exists, but the capture is incomplete, enerf-outdoor: no extri.yml",
        ),
        (
            "rig.xml",
            "<rig><intrinsics>1 2 3</intrinsics></rig>",
            "rig.xml exists: cameras (an entry intrinsics) in a form",
        ),
        (
            "cameras.json",
            '{"k": [[1, 0, 0]], "w2c": []}',
            "cameras.json exists: cameras (an entry k) in a form",
        ),
        ("notes.json", '{"actor": "anna"}', None),
        ("intrinsics.toml", "[[camera]]\nK = [[1.0]]\n", None),
    ],
)
def test_a_calibration_that_cannot_be_read_is_named(tmp_path, name, content, told):
    """With a layout's own mark there is no "no calibration yet": the file and its layout stand
    first, and the check is bad.
    """
    folder = tmp_path / "videos_of_mine"
    for camera in NAMES:
        write_image(folder / "images" / f"{camera}.png", make_image(1, 0))
    (folder / name).write_text(content)
    if told is None:
        assert open_uncalibrated(folder) is not None
        return
    with pytest.raises(CaptureError, match=r"capture\.toml|docs/captures\.md"):
        open_uncalibrated(folder)
    check = check_capture(folder)
    assert not check.is_usable
    assert check.findings[0].measured.startswith(f"{folder}: {told}")


def test_captures_two_levels_below_are_named(tmp_path):
    """COLMAP's automatic reconstruction keeps the capture in dense/0, which opens."""
    write_colmap(tmp_path / "dense" / "0")
    assert "name one of the captures in it: dense/0 (" in refusal(tmp_path)
    assert_rig(open_capture(tmp_path / "dense" / "0"))


@pytest.mark.parametrize(
    ("transfer", "told"),
    [(ColorTrc.ARIB_STD_B67, "HLG"), (ColorTrc.SMPTE2084, "PQ"), (ColorTrc.BT709, "")],
)
def test_levels_of_high_dynamic_range(tmp_path, transfer, told):
    """`check` names videos whose levels are not those of a display, and the command that converts
    them.
    """
    for name in NAMES:
        with av.open(str(tmp_path / f"{name}.mp4"), "w") as container:
            stream = container.add_stream("libx264", rate=30)
            stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
            stream.codec_context.color_trc, stream.codec_context.color_primaries = (
                transfer,
                ColorPrimaries.BT2020,
            )
            for frame in range(2):
                container.mux(
                    stream.encode(av.VideoFrame.from_ndarray(make_image(0, frame), format="rgb24"))
                )
            container.mux(stream.encode())
    write_poses(tmp_path, make_rig())
    finding = check_capture(tmp_path).of("frames")[0]
    assert (finding.verdict == "warn") == bool(told)
    assert finding.values.get("transfer", {}) == dict.fromkeys(NAMES if told else (), told)
    assert ("tonemap" in finding.advice) == bool(told)
