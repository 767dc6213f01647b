"""Frames that are a part of the pictures a calibration was made for."""

import numpy as np
import pytest

from ggvs_eval.datasets import open_capture
from ggvs_eval.datasets.assemble import Crop, crop_lens, given_crop, write_crop
from ggvs_eval.errors import CameraError
from ggvs_eval.files.images import write_image
from ggvs_eval.lens import Lens
from ggvs_eval.pipelines.inspection.capture.check import check_capture
from helpers.calibration_files import COEFFICIENTS, turned_rig, write_qualisys
from helpers.captures import HEIGHT, WIDTH, refusal
from helpers.small_layouts import camera_toml

LEFT, TOP, CUT = 3, 2, (WIDTH - 8, HEIGHT - 4)
PINHOLE = (0.0,) * 5


def picture(index: int) -> np.ndarray:
    """Noise, so that a shift by one pixel is seen."""
    return np.random.default_rng(index).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)


def cut(image: np.ndarray, left: int = LEFT, top: int = TOP) -> np.ndarray:
    return image[top : top + CUT[1], left : left + CUT[0]]


def qualisys_rig(folder, coefficients=PINHOLE):
    """Pictures cut by `LEFT` and `TOP`, of one camera whole; the file is of whole ones."""
    for index, camera in enumerate(turned_rig()):
        whole = picture(index)
        write_image(
            folder / f"{camera.name}.png", whole if index == 2 else np.ascontiguousarray(cut(whole))
        )
    write_qualisys(folder / "Calib.qca.txt", turned_rig(), coefficients=coefficients)
    return folder


def test_a_crop_that_is_said_moves_the_principal_point(tmp_path):
    """The cut cameras see each point as many pixels further left and up as were cut there; the
    whole one is as it was.
    """
    folder = qualisys_rig(tmp_path / "rig")
    write_crop(folder, Crop(LEFT, TOP))
    capture = open_capture(folder)

    assert [camera.size for camera in capture.cameras] == [CUT, CUT, (WIDTH, HEIGHT)]
    for index, (camera, whole) in enumerate(zip(capture.cameras, turned_rig(), strict=True)):
        offset = (0, 0) if index == 2 else (LEFT, TOP)
        assert camera.K[:2, 2] == pytest.approx(whole.K[:2, 2] - offset, abs=1e-9)
        assert camera.world_to_camera == pytest.approx(whole.world_to_camera, abs=1e-9)
        assert np.array_equal(
            capture.frame(camera.name, 0), picture(index) if index == 2 else cut(picture(index))
        )
    assert "frames begin at 3 2 of the calibrated picture, by crop.toml" in capture.notes


def test_distortion_stays_where_it_was(tmp_path):
    """A lens of the part sends each ray to the pixel of the whole, less the offset; frames are
    undistorted by it.
    """
    whole = Lens(turned_rig()[0].K, "opencv", COEFFICIENTS, WIDTH, HEIGHT)
    part = crop_lens("cam00", whole, CUT, Crop(LEFT, TOP))
    rays = np.random.default_rng(1).uniform(-0.3, 0.3, (40, 2))
    assert part.distort(rays, np.eye(3)) == pytest.approx(
        whole.distort(rays, np.eye(3)) - (LEFT, TOP)
    )
    assert (part.width, part.height) == CUT

    folder = qualisys_rig(tmp_path / "rig", COEFFICIENTS)
    write_crop(folder, Crop(LEFT, TOP))
    assert open_capture(folder).frame("cam00", 0).shape == (CUT[1], CUT[0], 3)


def test_capture_toml_says_it_camera_by_camera(tmp_path):
    """Key ``crop`` of a camera."""
    text = ""
    for index, camera in enumerate(turned_rig()):
        write_image(
            tmp_path / f"{camera.name}.png", np.ascontiguousarray(cut(picture(index), left=index))
        )
        text += camera_toml(camera, f"{camera.name}.png", f"crop = [{index}, {TOP}]")
    (tmp_path / "capture.toml").write_text(text)
    for index, (camera, whole) in enumerate(
        zip(open_capture(tmp_path).cameras, turned_rig(), strict=True)
    ):
        assert camera.K[:2, 2] == pytest.approx(whole.K[:2, 2] - (index, TOP), abs=1e-9)


def test_without_it_the_refusal_says_what_to_do_and_check_what_frames_tell(tmp_path):
    """How much is missing, the command that says where; questions about frames alone have their
    answers.
    """
    folder = qualisys_rig(tmp_path / "rig")
    message = refusal(folder)
    assert "8 columns and 4 rows of it are missing" in message
    assert f"ggvs-eval check {folder} --crop 0 0" in message

    check = check_capture(folder)
    assert not check.is_usable
    assert check.of("opens")[0].measured == message
    assert {finding.verdict for finding in (*check.of("frames"), *check.of("noise"))} <= {
        "ok",
        "warn",
        "unknown",
    }
    assert check.of("frames")[0].measured.startswith("3 cameras")
    assert check.of("poses")[0].verdict == "unknown"


def test_a_part_that_the_picture_does_not_have(tmp_path):
    """Beyond its border, or before it; the file is kept as it was written."""
    whole = Lens(turned_rig()[0].K, "opencv", (0.0,) * 4, WIDTH, HEIGHT)
    for crop in (Crop(9, 0), Crop(0, 5), Crop(-1, 0)):
        with pytest.raises(CameraError, match="wanted a crop within"):
            crop_lens("cam00", whole, CUT, crop)
    assert crop_lens("cam00", whole, (WIDTH // 2, HEIGHT // 2), Crop(9, 9)) is whole
    assert given_crop(tmp_path) is None
    write_crop(tmp_path, Crop(4, 0))
    assert given_crop(tmp_path) == Crop(4, 0)
