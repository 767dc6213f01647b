"""Videos that have no poses yet: what frames alone tell, and which command comes next."""

import pickle
import shutil

import numpy as np
import pytest

from ggvs_eval.datasets import open_capture
from ggvs_eval.datasets.camera_frames import find_rig_frames
from ggvs_eval.datasets.find_cameras import file_marks
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.video import write_video
from ggvs_eval.pipelines.inspection.capture.check import QUESTIONS, check_capture
from helpers.captures import FPS, N_FRAMES, make_image, write_folders, write_videos
from helpers.refusals import refused


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
    assert f"'ggvs-eval check {check.path} --repair'" in check.findings[0].measured


def test_one_video_is_no_rig(tmp_path):
    """Two cameras at least; otherwise the layouts are listed as before."""
    write_videos(tmp_path / "table", ("cam00",))
    check = check_capture(tmp_path / "table")
    assert check.findings[0].question == "opens"
    assert "wanted a capture in a known layout" in check.findings[0].measured


MARKED = {
    "cameras.xml": '<?xml version="1.0"?>\n<document version="2.0.0">\n<chunk label="Chunk '
    '1">\n</chunk></document>',
    "cameras.csv": "#name,x,y,alt,heading,pitch,roll\ncam00.jpg,0,0,0,0,0,0",
    "bundle.out": "# Bundle file v0.3\n4 0\n60 0 0",
    "camera/0_00000.json": '{"orientation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "focal_length": '
    "86.9}",
    "camchain.yaml": "cam0:\n  rostopic: /cam0\ncam1:\n  T_cn_cnm1: []",
    "calibration.json": '{"CalibrationInformation": {"Cameras": []}}',
    "session.xcp": '<?xml version="1.0"?>\n<Cameras SOURCE="Nexus"></Cameras>',
    "calib.json": '{"model": {"polymorphic_name": "libCalib::CameraModelOpenCV"}}',
    "cameras_sphere.npz": "PK world_mat_0.npy",
    "Demo.json": '{"cameras": [{"Principle_point": [32, 24], "Depth_range": [1, 9]}]}',
    "traj.txt": "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1",
    "lowres_wide.traj": "307.5 0 0 0 0 0 0",
    "keyframes/cameras/1664481236000.json": '{"fx": 60, "t_00": 1}',
    "SN12345678.conf": "[LEFT_CAM_HD]\nfx=60",
    "mv_images/00000/cam01.jpg": "a picture",
    "rig.json": '[{"cameras": [{"cam_from_rig_rotation": [1, 0, 0, 0]}]}]',
    "cameras/camera_extrinsics.json": '{"cam00": "[1 0 0 0] [0 1 0 0] [0 0 1 0] [0 0 0 1]"}',
    "reconstruction.meshed.json": '[{"shots": {}}]',
    "sfm_data.json": '{"sfm_data_version": "0.3"}',
    "cameras.sfm": '{"views": []}',
    "room_calibrated_camera_parameters.txt": "fileName imageWidth imageHeight",
    "room_calibrated_external_camera_parameters.txt": "imageName X Y Z Omega Phi Kappa",
    "room.psx": "<document/>",
    "cams/00000000_cam.txt": "extrinsic\n1 0 0 0",
    "temple_par.txt": "2\ntemple0001.png 1520.4 0 302.3",
    "calib.txt": "cam0=[3979.911 0 1244.772; 0 3979.911 1019.507; 0 0 1]",
    "room.log": "0 0 1\n1 0 0 0\n0 1 0 0\n",
    "scan.r3d": "PK",
    "metadata": '{"perFrameIntrinsicCoeffs": []}',
    "system.cal": "?",
    "system.mcal": "<Profile>",
    "flight_dltCoefs.csv": "1,2,3",
    "stereoParams.mat": "MATLAB 5.0 MAT-file",
    "Calib_Results.m": "fc = [ 657.3 ; 657.7 ];",
    "calibrated_cameras_data.yml": "camera_0: {}",
    "0012_09_annots.smc": "?",
    "annots.npy": "?",
    "pose_intrinsic_imu.json": "{}",
    "sensor.yaml": "T_BS:\n  cols: 4",
    "stage.usda": "#usda 1.0",
}


@pytest.fixture(scope="module")
def videos(tmp_path_factory):
    """Videos without poses; nobody changes them."""
    folder = tmp_path_factory.mktemp("videos") / "table"
    write_videos(folder)
    return folder


@pytest.mark.parametrize("name", MARKED)
def test_calibrations_that_are_not_read_are_named_first(name, videos, tmp_path):
    """Beside videos: not usable, and the message begins with the file."""
    shutil.copytree(videos, tmp_path / "table")
    (tmp_path / "table" / name).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / "table" / name).write_text(MARKED[name])
    check = check_capture(tmp_path / "table")
    assert not check.is_usable
    (finding,) = check.of("opens")
    assert f"table: {name} exists: " in finding.measured


def test_every_mark_is_tried_here():
    """A row of the table without a case above would be data that nothing holds."""
    assert len(file_marks()) == len(MARKED) + 1  # Vicon's has two rows


def test_cameras_above_and_far_below_are_named(tmp_path):
    """Beside a sequence's own note, and from the folder of all of them; files that differ by a
    number are one.
    """
    take = tmp_path / "subject" / "takes" / "01"
    write_videos(take)
    (take / "info.json").write_text('{"intrinsics": "date01"}')
    (tmp_path / "subject" / "calibration").mkdir()
    for index in range(2):
        (tmp_path / "subject" / "calibration" / f"{index}.txt").write_text(
            "86.9 0 80\n0 86.9 60\n0 0 1"
        )
    (finding,) = check_capture(take).of("opens")
    assert "info.json exists: cameras (an entry intrinsics)" in finding.measured
    assert "and more in ../../calibration/" in finding.measured
    (finding,) = check_capture(tmp_path).of("opens")
    assert (
        "subject/calibration/0.txt, subject/takes/01/info.json and 1 like these exist"
        in finding.measured
    )


def test_other_files_are_noted(tmp_path):
    """What holds no cameras that can be seen is no fault, and is not passed over in silence; our
    own report is.
    """
    write_videos(tmp_path / "table")
    (tmp_path / "table" / "rig_calib_final.bin").write_bytes(b"?\0")
    (tmp_path / "table" / "calibration.json").write_text(
        '{"registered": 4, "mean_reprojection_error_px": 0.3}'
    )
    check = check_capture(tmp_path / "table")
    assert check.is_usable
    assert check.of("frames")[0].measured.endswith("not used: rig_calib_final.bin")


NUMBERS = {
    "KRT": "cam00\n86.88 0 79.5\n0 86.88 59.5\n0 0 1\n",
    "views/view.csv": "name,a,b\ncam00,0.8,0.6,0,-0.6,0.8,0,0,0,1\n",
    "params.npy": np.array([[0.96, 0.28, 0, 5], [-0.28, 0.96, 0, 6], [0, 0, 1, 7]]),
    "rig.pkl": {"cam00": [[86.88, 0, 79.5], [0, 86.88, 59.5], [0, 0, 1]]},
    "P.txt": "114.54081 6.03454 26.69027 325.38 30.77331 98.04343 22.99723 352.26 0.48591 0.25852 "
    "0.8349 3\n",
    "trajectory.txt": "1 2 3 0.5 0.5 -0.5 0.5\n3 2 1 0.1 0.7 0.7 0.1\n",
}


@pytest.mark.parametrize("name", NUMBERS)
def test_cameras_are_told_by_their_numbers(name, videos, tmp_path):
    """Whatever a file is called: one that holds an intrinsic matrix or rotations ends with 1 and is
    named first.
    """
    shutil.copytree(videos, tmp_path / "table")
    file, content = tmp_path / "table" / name, NUMBERS[name]
    file.parent.mkdir(exist_ok=True)
    if isinstance(content, str):
        file.write_text(content)
    else:
        with file.open("wb") as stream:
            np.save(stream, content) if name.endswith("npy") else pickle.dump(content, stream)
    check = check_capture(tmp_path / "table")
    assert not check.is_usable
    assert f"table: {name} exists: cameras (" in check.of("opens")[0].measured


def test_names_and_keypoints_are_no_cameras(videos, tmp_path):
    """A telling name without such numbers, and many numbers without such a form, are no
    calibration.
    """
    shutil.copytree(videos, tmp_path / "table")
    (tmp_path / "table" / "camera_notes.txt").write_text("the third one was moved at 10:45")
    (tmp_path / "table" / "keypoints.csv").write_text(
        "\n".join(f"{i},{i * 1.37 % 1},{i * 0.71 % 1}" for i in range(500))
    )
    assert check_capture(tmp_path / "table").is_usable


def test_chapters_of_one_recording_are_no_cameras(tmp_path):
    """GoPro's names: refused with the way to join them."""
    write_videos(tmp_path / "table", ("GX010001", "GX020001", "GX010002", "GX020002"))
    check = check_capture(tmp_path / "table")
    assert not check.is_usable
    assert (
        "chapters of one recording: GX010001 and GX020001; GX010002 and GX020002"
        in check.of("opens")[0].measured
    )
    with refused(CaptureError, "chapters of one recording", "concat"):
        open_capture(tmp_path / "table")
    with refused(CaptureError, "chapters of one recording", "concat"):
        find_rig_frames(tmp_path / "table")
