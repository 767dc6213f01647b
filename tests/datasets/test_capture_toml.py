"""capture.toml: a rig of one's own, by hand and from a real one."""

import re
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.datasets import open_capture
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.images import write_image
from ggvs_eval.files.video import write_video
from ggvs_eval.lens import Lens
from helpers.captures import FPS, HEIGHT, NAMES, WIDTH, make_image, make_rig, mean_colours, refusal
from helpers.lens_pictures import psnr, straight, through_lens
from helpers.small_layouts import N_INSTANTS, camera_toml, write_capture_toml, write_frames


@pytest.fixture
def toml_rig(tmp_path) -> Path:
    return write_capture_toml(tmp_path / "rig")


def one_image_rig(folder: Path, more: str = "", head: str = "", images: list | None = None) -> Path:
    """Four cameras with an image each."""
    text = head
    for index, camera in enumerate(make_rig()):
        write_image(
            folder / f"{camera.name}.png", make_image(index, 0) if images is None else images[index]
        )
        text += camera_toml(camera, f"{camera.name}.png", more)
    (folder / "capture.toml").write_text(text)
    return folder


def test_a_folder_called_capture_has_the_name_of_its_parent(tmp_path):
    """`evaluate VIDEOS OUT` writes OUT/capture, which says nothing to a reader; every other folder
    is a name.
    """
    for name, scene in (
        ("dome/capture", "dome"),
        ("capture/dome", "dome"),
        ("dome/capture2", "capture2"),
    ):
        assert open_capture(write_capture_toml(tmp_path / name)).scene == scene


@pytest.mark.parametrize("named", ["folder", "file"])
def test_videos_and_folders_of_images(toml_rig, named):
    """A rig of videos and image folders opens by its folder or its file, in the order of
    the file.
    """
    read = open_capture(toml_rig if named == "folder" else toml_rig / "capture.toml")
    assert (read.layout, read.scene, read.path) == ("capture.toml", "rig", toml_rig)
    assert (read.camera_names, read.n_frames, read.fps) == (NAMES, N_INSTANTS, FPS)
    for index, (camera, truth) in enumerate(zip(read.cameras, make_rig(), strict=True)):
        np.testing.assert_allclose(camera.world_to_camera, truth.world_to_camera, atol=1e-12)
        np.testing.assert_allclose(camera.K, truth.K, atol=1e-12)
        assert mean_colours(read, camera.name) == [(frame, index) for frame in range(N_INSTANTS)]


def test_every_key(tmp_path):
    """Scene, rate, units, near, far, background and masks are read."""
    folder = tmp_path / "rig"
    head = 'scene = "juggling"\nfps = 50\nunits_per_metre = 2.5\n'
    text = head
    for index, camera in enumerate(make_rig()):
        name = camera.name
        write_frames(folder / name, index)
        write_frames(folder / "masks" / name, index)
        write_image(folder / "bg" / f"{name}.jpg", make_image(index, 4))
        more = f'near = 1.5\nfar = 9.5\nbackground = "bg/{name}.jpg"\nmask = "masks/{name}"'
        text += camera_toml(camera, name, more)
    (folder / "capture.toml").write_text(text)
    read = open_capture(folder)
    assert (read.scene, read.fps, read.units_per_metre, read.units_origin) == (
        "juggling",
        50.0,
        2.5,
        "capture.toml",
    )
    assert {(camera.near, camera.far) for camera in read.cameras} == {(1.5, 9.5)}
    mask, background = read.extras_of("cam02").mask, read.background("cam02")
    assert mask is not None
    assert background is not None
    assert np.array_equal(next(mask.frames(1, 2)), make_image(2, 1))
    assert np.array_equal(background, make_image(2, 4))
    assert open_capture(folder, units=4.0).units_per_metre == 4.0


def test_single_images_and_the_range_of_the_rig(tmp_path):
    """Images are a single instant; without near and far the range is that of the rig."""
    read = open_capture(one_image_rig(tmp_path / "rig"))
    assert (read.n_frames, read.fps) == (1, 0.0)
    assert all(camera.near < 4 < camera.far for camera in read.cameras)


def test_camera_to_world(tmp_path):
    """The inverse pose is as good."""
    folder = one_image_rig(tmp_path / "rig")
    text = (folder / "capture.toml").read_text()
    for camera in make_rig():
        inverse = np.linalg.inv(camera.world_to_camera).tolist()
        text = text.replace(
            f"world_to_camera = {camera.world_to_camera.tolist()}", f"camera_to_world = {inverse}"
        )
    assert "world_to_camera" not in text
    (folder / "capture.toml").write_text(text)
    for camera, truth in zip(open_capture(folder).cameras, make_rig(), strict=True):
        np.testing.assert_allclose(camera.world_to_camera, truth.world_to_camera, atol=1e-12)


def test_pixel_centres_at_whole_numbers(tmp_path):
    """K as OpenCV calibrates it is moved by half a pixel."""
    whole = (
        open_capture(one_image_rig(tmp_path / "rig", head='pixel_centre = "whole"\n')).cameras[0].K
    )
    np.testing.assert_allclose(whole[:2, 2], make_rig()[0].K[:2, 2] + 0.5)


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [
        ("opencv", (-0.2, 0.05, 0.001, -0.002)),
        ("opencv", (0.1, 0.02, 0.0, 0.0, 0.01)),
        ("fisheye", (0.03, -0.01, 0.004, -0.001)),
    ],
)
def test_distorted_frames_are_undistorted(tmp_path, model, coefficients):
    """Frames of a lens become the pinhole images of the cameras, and no pixel of them is blank."""
    lens = Lens(make_rig()[0].K, model, coefficients, WIDTH, HEIGHT)
    more = f'distortion = {{ model = "{model}", coefficients = {list(coefficients)} }}'
    read = open_capture(one_image_rig(tmp_path / "rig", more, images=[through_lens(lens)] * 4))
    np.testing.assert_allclose(read.cameras[2].K, lens.undistorted_K())
    assert psnr(read.frame("cam02", 0), straight(lens, read.cameras[2].K)) > 42


POSE = make_rig()[1].world_to_camera


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (r"\Z", "\nfpss = 3\n", "unknown key camera[3].fpss; did you mean camera[3].frames?"),
        (
            r"\A",
            "unit_per_metre = 3\n",
            "unknown key unit_per_metre; did you mean units_per_metre?",
        ),
        (r"\A", "fps = 'fast'\n", "fps must be a finite number, got 'fast'"),
        (r"\A", "fps = -3\n", "fps must be positive, got -3; correct or drop it"),
        (r"\A", "units_per_metre = 0\n", "units_per_metre must be positive, got 0"),
        (
            r"\A",
            "pixel_centre = 'corner'\n",
            "pixel_centre must be one of 'half', 'whole', got 'corner'",
        ),
        (r"\A", "[", "not valid TOML"),
        (r"\A(.|\n)*", "", "missing key camera"),
        (r"\A(.|\n)*", "camera = []", "wanted at least one [[camera]], got none; describe the rig"),
        ("width = 64", "width = 64.5", "camera[0].width must be a whole number, got 64.5"),
        ("width = 64", "width = 0", "the size must be positive, got 0 x 48"),
        ("width = 64", "width = 80", "frames of 64 x 48 have another shape than the 80 x 48"),
        ("height = 48", "", "missing key camera[0].height; add it"),
        ('cam01"', 'cam00"', "wanted cameras of different names, got several called cam00"),
        (
            'name = "cam01"',
            'name = "../cam01"',
            "wanted camera names that can be file names, got '../cam01'",
        ),
        (
            r'"cam01\.png"',
            '"cam07.png"',
            "wanted frames in 'cam07.png', there is no such file or folder; correct the path",
        ),
        (r'"cam01\.png"', r'"a\\u0000b"', "there is no such file or folder"),
        (r'"cam01\.png"', '"capture.toml"', "capture.toml: wanted an image"),
        (
            r"K = \[\[57.6, 0.0",
            "K = [[57.6, 2.0",
            "K must be fx 0 cx / 0 fy cy / 0 0 1 in pixels, zero skew, got 57.6 2 32 /",
        ),
        (
            r"K = \[\[57.6, 0.0, 32.0\], ",
            "K = [",
            "K of cam00 must be 3 rows of 3 numbers, got rows of [3, 3]",
        ),
        (r"K = \[\[57.6", "K = [[nan", "camera[0].K[0][0] must be a finite number, got nan"),
        (
            r"world_to_camera = .*",
            "",
            "camera cam00 wants one of world_to_camera and camera_to_world, got 0",
        ),
        (
            r"\Z",
            f"\ncamera_to_world = {np.eye(4).tolist()}\n",
            "cam03 wants one of world_to_camera and camera_to_world, got 2",
        ),
        (
            re.escape(str(POSE.tolist())),
            str(POSE.T.tolist()),
            "the last row of the pose of cam01 must be 0 0 0 1, got [-0.3",
        ),
        (
            f"world.*{re.escape(str(POSE.tolist()))}",
            f"camera_to_world = {np.diag([0.0, 1, 1, 1]).tolist()}",
            "cannot be inverted",
        ),
        (r"\Z", "\nnear = 2.0\n", "camera cam03 wants near and far or neither; add the other"),
        (
            r"\Z",
            "\nnear = 5.0\nfar = 4.0\n",
            "camera cam03: depth range must satisfy 0 < near < far",
        ),
        (
            r"\Z",
            '\ndistortion = { model = "fish", coefficients = [] }\n',
            "model must be one of 'opencv', 'fisheye', got 'fish'",
        ),
        (
            r"\Z",
            '\ndistortion = { model = "opencv", coefficients = [1] }\n',
            "cam03: lens: the opencv model wants 4 or 5",
        ),
        (r"\Z", '\nmask = "masks"\n', "wanted one mask of cam03 per frame, got 2 for 1 frames"),
    ],
)
def test_mistakes(tmp_path, old, new, message):
    """Whatever is unknown, missing, mistyped or makes no rig is refused in one line that names file
    and key.
    """
    folder = one_image_rig(tmp_path / "rig")
    write_frames(folder / "masks", 0)
    text, count = re.subn(
        old, lambda _: new.replace("\\\\", "\\"), (folder / "capture.toml").read_text(), count=1
    )
    assert count == 1
    (folder / "capture.toml").write_text(text)
    assert message in refusal(folder)


def test_endless_files_are_not_read(tmp_path):
    """What is neither a file nor a folder holds no frames."""
    folder = one_image_rig(tmp_path / "rig")
    text = (folder / "capture.toml").read_text()
    (folder / "capture.toml").write_text(text.replace('"cam01.png"', '"/dev/zero"'))
    with pytest.raises(CaptureError, match="/dev/zero: wanted images"):
        open_capture(folder)


def test_frame_counts_and_rates_must_agree(toml_rig):
    """A camera with more frames, or of another rate, is named."""
    write_video(
        toml_rig / "videos" / "cam03.mp4", [make_image(3, frame) for frame in range(4)], FPS
    )
    assert (
        "wanted one frame count for all cameras, got cam00 2, cam01 2, cam02 2, cam03 4"
        in refusal(toml_rig)
    )
    write_video(
        toml_rig / "videos" / "cam03.mp4", [make_image(3, frame) for frame in range(2)], 25.0
    )
    assert (
        "wanted one frame rate for all cameras, got cam00 30, cam01 30, cam02 30, cam03 25"
        in refusal(toml_rig)
    )
