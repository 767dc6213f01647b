"""Calibrations of Qualisys, anipose, freemocap and OpenCV: the same projections, a capture as it
stands, one line on damage.
"""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.datasets import open_capture
from ggvs_eval.datasets.calibration_file import CalibrationFile, read_calibration_file
from ggvs_eval.errors import CameraError, CaptureError
from ggvs_eval.files.video import write_video
from ggvs_eval.lens import Lens
from ggvs_eval.pipelines.offline.calibration.known_cameras import read_known
from ggvs_eval.pipelines.offline.calibration.undistort import read_lenses
from helpers.calibration_files import (
    COEFFICIENTS,
    project_opencv,
    turned_rig,
    write_anipose,
    write_opencv,
    write_qualisys,
    write_stereo,
)
from helpers.captures import FPS, HEIGHT, WIDTH, make_image
from helpers.places import SHARED
from helpers.refusals import refused

POSE2SIM = SHARED / "data" / "pose2sim_single_person"
FREEMOCAP = 'charuco_square_size = 39.0\npath_to_recorded_videos = "videos"'
EXACT_PX = 1e-6

FORMATS: dict[str, Callable[[Path], Path]] = {
    "qualisys": lambda folder: write_qualisys(folder / "Calib.qca.txt", turned_rig()),
    "qualisys, a part of the sensor": lambda folder: write_qualisys(
        folder / "Calib.qca.txt", turned_rig(), left=8, top=4
    ),
    "anipose": lambda folder: write_anipose(folder / "calibration.toml", turned_rig()),
    "freemocap": lambda folder: write_anipose(
        folder / "take_camera_calibration.toml", turned_rig(), FREEMOCAP
    ),
    "opencv": lambda folder: write_opencv(folder, turned_rig()),
}


def write_table(folder: Path, names: tuple[str, ...] = ("cam00", "cam01", "cam02")) -> Path:
    folder.mkdir(exist_ok=True)
    for index, name in enumerate(names):
        write_video(folder / f"{name}.mp4", [make_image(index, frame) for frame in range(2)], FPS)
    return folder


def project_read(file: CalibrationFile, name: str, points: np.ndarray) -> np.ndarray:
    """Where the camera that was read sees points, (P, 2), our pixel centres."""
    camera = file.cameras[name]
    assert camera.world_to_camera is not None
    seen = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    return camera.lens((WIDTH, HEIGHT)).distort(seen[:, :2] / seen[:, 2:], np.eye(3))


def points_before(rig) -> np.ndarray:
    rng = np.random.default_rng(5)
    uv = rng.uniform(0.1, 0.9, (50, 2)) * (WIDTH, HEIGHT)
    return rig[0].unproject(uv, rng.uniform(3.0, 6.0, 50))


@pytest.mark.parametrize("kind", FORMATS)
def test_points_are_seen_where_the_format_says(kind, tmp_path):
    """A rig in general position, with a distorting lens: every point falls on the same pixel to
    1e-6.
    """
    rig = turned_rig()
    file = read_calibration_file(FORMATS[kind](tmp_path))
    points = points_before(rig)

    assert list(file.cameras) == [camera.name for camera in rig]
    for camera in rig:
        assert (
            np.abs(
                project_read(file, camera.name, points) - 0.5 - project_opencv(camera, points)
            ).max()
            < EXACT_PX
        )
        assert file.cameras[camera.name].size == (WIDTH, HEIGHT)
    is_metric = kind.startswith(("qualisys", "freemocap"))
    assert (file.units is not None) == is_metric


def test_a_stereo_pair_has_its_world_in_the_left_camera(tmp_path):
    """M1 D1 M2 D2 R T: both cameras see a point of the left one's frame where OpenCV does; sizes
    come from the frames.
    """
    left, right, _ = turned_rig()
    file = read_calibration_file(write_stereo(tmp_path / "stereo.yml", left, right))
    points = points_before([left])
    in_left = points @ left.rotation.T + left.translation

    assert list(file.cameras) == ["left", "right"]
    for name, camera in (("left", left), ("right", right)):
        assert (
            np.abs(project_read(file, name, in_left) - 0.5 - project_opencv(camera, points)).max()
            < EXACT_PX
        )
    sizes = {"left": (WIDTH, HEIGHT), "right": (WIDTH, HEIGHT)}
    assert list(read_known(tmp_path / "stereo.yml", sizes)) == ["left", "right"]
    assert read_known(tmp_path / "stereo.yml") == {}


@pytest.mark.parametrize("kind", FORMATS)
def test_the_file_beside_the_videos_is_a_capture(kind, tmp_path):
    """Frames are undistorted, distances metric where the format says so, and a studio's marker
    cameras are left out.
    """
    rig = [*turned_rig(), *turned_rig(("marker7",))]
    folder = write_table(tmp_path / "table")
    FORMATS[kind](folder)
    if kind == "qualisys":
        write_qualisys(folder / "Calib.qca.txt", rig)

    capture = open_capture(folder)

    assert capture.layout == ("anipose" if kind == "freemocap" else kind.partition(",")[0])
    assert capture.camera_names == ("cam00", "cam01", "cam02")
    assert capture.frame("cam02", 1).shape == (HEIGHT, WIDTH, 3)
    if kind == "qualisys":
        assert "marker7 left out: calibrated, but without frames" in capture.notes
    if kind.startswith(("qualisys", "freemocap")):
        assert capture.units_per_metre == 1.0
    for camera, true in zip(capture.cameras, rig, strict=False):
        assert np.allclose(camera.centre, true.centre, atol=1e-9)
        assert camera.rotation == pytest.approx(true.rotation, abs=1e-9)


@pytest.mark.parametrize("kind", FORMATS)
def test_calibrate_and_undistort_take_the_file(kind, tmp_path):
    """What `--known-poses`, `--known-intrinsics` and `--lenses` are given: lenses with their
    distortion, and poses.
    """
    path = FORMATS[kind](tmp_path)
    known = read_known(path)
    for camera in turned_rig():
        lens = known[camera.name].lens
        assert lens.coefficients == pytest.approx(COEFFICIENTS)
        assert known[camera.name].world_to_camera == pytest.approx(camera.world_to_camera, abs=1e-9)
    if path.is_file():
        lenses = read_lenses(
            path, {camera.name: (2 * WIDTH, 2 * HEIGHT) for camera in turned_rig()}
        )
        assert lenses["cam00"].lens.K[:2] == pytest.approx(2 * turned_rig()[0].K[:2])


def test_a_fisheye_keeps_its_model(tmp_path):
    """Anipose's flag and OpenCV's ``fisheye_model`` choose the equidistant lens with four
    coefficients.
    """
    file = write_anipose(tmp_path / "calibration.toml", turned_rig())
    text = file.read_text().replace(
        f"distortions = {list(COEFFICIENTS)}", "distortions = [0.1, 0.0, 0.0, 0.0]\nfisheye = true"
    )
    file.write_text(text)
    lens = read_calibration_file(file).cameras["cam00"].lens(None)
    assert isinstance(lens, Lens)
    assert (lens.model, lens.coefficients) == ("fisheye", (0.1, 0.0, 0.0, 0.0))


def test_intrinsics_alone_are_sent_to_calibrate(tmp_path):
    """Without poses it is no capture; the message names the command that finds them."""
    folder = write_table(tmp_path / "table")
    text = write_anipose(folder / "lenses.toml", turned_rig()).read_text()
    kept = [line for line in text.splitlines() if not line.startswith(("rotation", "translation"))]
    (folder / "lenses.toml").write_text("\n".join(kept))

    with pytest.raises(
        CaptureError,
        match=r"only intrinsics of cam00, cam01, cam02; 'ggvs-eval calibrate .* --known-intrinsics",
    ):
        open_capture(folder)


DAMAGE = {
    "a number that is none": (
        "qualisys",
        'x="',
        'x="NaN',
        "a number x in transform of camera cam00",
    ),
    "a number that is absent": (
        "qualisys",
        "focalLengthV",
        "focal",
        "a number focalLengthV in intrinsic of camera cam00",
    ),
    "no transform": ("qualisys", "<transform", "<moved", "a number r11 in transform"),
    "cut": ("qualisys", "</calibration>", "", "the XML of a Qualisys calibration"),
    "entities": (
        "qualisys",
        "<calibration>",
        '<!DOCTYPE a [<!ENTITY b "c">]><calibration>',
        "XML without declarations",
    ),
    "nested": ("qualisys", "<cameras>", "<a>" * 100_000, "the XML of a Qualisys calibration"),
    "a flat matrix": ("anipose", "matrix = [[", "matrix = [", "TOML"),
    "a matrix of texts": (
        "anipose",
        "rotation = [",
        'rotation = ["a", ',
        "3 numbers in cam_0.rotation",
    ),
    "no translation": ("anipose", "translation", "shift", "3 numbers in cam_0.translation"),
    "a size of nothing": ("anipose", f"size = [ {WIDTH}", "size = [ 0", "a positive cam_0.size"),
    "two of one name": ("anipose", '"cam01"', '"cam00"', "cameras of different names"),
    "too few coefficients": (
        "anipose",
        f"distortions = {list(COEFFICIENTS)}",
        "distortions = [0.1]",
        "coefficients",
    ),
    "a camera without a focal length": (
        "opencv",
        "camera_matrix: !!opencv-matrix",
        "camera_matrix: 3",
        "camera_matrix",
    ),
    "a pose of nine numbers": (
        "opencv",
        "T: !!opencv-matrix\n   rows: 3",
        "T: !!opencv-matrix\n   rows: 2",
        "numbers in T",
    ),
}


@pytest.mark.parametrize("what", DAMAGE)
def test_what_is_damaged_is_one_line(what, tmp_path):
    """The file, what was wanted, what came."""
    kind, old, new, message = DAMAGE[what]
    folder = write_table(tmp_path / "table")
    written = FORMATS[kind](folder)
    file = written if written.is_file() else folder / "cam00.yml"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1) if what != "cut" else text.replace(old, new))

    with pytest.raises(CaptureError) as caught:
        open_capture(folder)

    assert message in str(caught.value)
    assert str(folder) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_frames_of_other_names_are_named(tmp_path):
    """Qualisys calls cameras by serial number; videos must be called so too."""
    folder = write_table(tmp_path / "table", ("left", "right"))
    write_qualisys(folder / "Calib.qca.txt", turned_rig())
    with refused(CaptureError, "cam00, cam01, cam02", "got none"):
        open_capture(folder)


@pytest.mark.slow
@pytest.mark.skipif(
    not POSE2SIM.is_dir(), reason="the shared capture pose2sim_single_person is not on this machine"
)
def test_a_real_calibration(tmp_path):
    """pose2sim's own file: four cameras at the height of a tripod look at one place in the room,
    and two of its videos open.
    """
    file = read_calibration_file(POSE2SIM / "Calib.qca.txt")
    assert [(camera.name, camera.size) for camera in file.cameras.values()] == [
        (f"cam0{n}", (1088, 1920)) for n in (1, 2, 3, 4)
    ]
    poses = [np.linalg.inv(camera.world_to_camera) for camera in file.cameras.values()]
    assert all(1.6 < pose[2, 3] < 2.2 for pose in poses)
    # The point nearest to all four axes: the sum over cameras of (I - a a^T) x = (I - a a^T) c.
    planes = [np.eye(3) - np.outer(pose[:3, 2], pose[:3, 2]) for pose in poses]
    meeting = np.linalg.solve(
        sum(planes), sum(plane @ pose[:3, 3] for plane, pose in zip(planes, poses, strict=True))
    )
    assert np.linalg.norm(meeting[:2]) < 1.0
    assert 0.3 < meeting[2] < 1.5
    assert all((meeting - pose[:3, 3]) @ pose[:3, 2] > 1.0 for pose in poses)

    # the two that were not cropped by their encoder
    for name in ("Calib.qca.txt", "videos/cam03.mp4", "videos/cam04.mp4"):
        (tmp_path / "videos").mkdir(exist_ok=True)
        (tmp_path / name).symlink_to(POSE2SIM / name)
    capture = open_capture(tmp_path)
    assert (capture.camera_names, capture.n_frames, capture.units_per_metre) == (
        ("cam03", "cam04"),
        100,
        1.0,
    )


def with_line(file: Path, line: str) -> Path:
    """The file with one more entry, at the first place where it makes one."""
    text = file.read_text()
    if file.suffix == ".txt":
        file.write_text(text.replace("<intrinsic ", f"<intrinsic {line} ", 1))
    else:
        at = "---\n" if "---\n" in text else "]\n"
        file.write_text(text.replace(at, f"{at}{line}\n", 1))
    return file


LINES = {
    "qualisys": ('radialDistortion4="0.5"', 'humidity="3"'),
    "anipose": ("xi = 1.2", "humidity = 3"),
    "opencv": ("xi: 1.2", "humidity: 3"),
}


@pytest.mark.parametrize("kind", LINES)
def test_entries_that_are_not_read_are_named(kind, tmp_path):
    """What belongs to the lens is refused by name, unless it is 0; anything else is noted."""
    of_lens, other = LINES[kind]
    folder = write_table(tmp_path / "table")
    written = FORMATS[kind](folder)
    file = written if written.is_file() else sorted(folder.glob("cam00.y*ml"))[0]
    whole = file.read_text()

    with_line(file, other)
    assert any("humidity unknown here, ignored" in note for note in open_capture(folder).notes)
    file.write_text(whole)
    with_line(file, of_lens)
    with refused(CaptureError, file.name, re.split("[ =:]", of_lens)[0], "belongs to the lens"):
        open_capture(folder)
    file.write_text(whole)
    with_line(file, re.sub(r"[\d.]+(\"?)$", r"0\1", of_lens))
    assert len(open_capture(folder).cameras) == 3


def test_four_coefficients_of_a_stereo_pair_want_their_model(tmp_path):
    """cv::fisheye writes four, and four are k1 k2 p1 p2 too: a key says which."""
    left, right, _ = turned_rig()
    file = write_stereo(tmp_path / "stereo.yml", left, right)
    text = re.sub(
        r"(D[12]: !!opencv-matrix\s+rows: )\d+(\s+cols: )\d+(.*?data: \[)[^\]]*",
        r"\g<1>4\g<2>1\3.1, .01, 0., 0.",
        file.read_text(),
        flags=re.S,
    )
    file.write_text(text)
    with refused(CaptureError, "stereo.yml", "got four in D1 and D2", "fisheye_model: 1"):
        read_calibration_file(file)
    for said, model in (("1", "fisheye"), ("0", "opencv")):
        file.write_text(text.replace("---\n", f"---\nfisheye_model: {said}\n", 1))
        assert {camera.model for camera in read_calibration_file(file).cameras.values()} == {model}


def test_matrices_in_three_forms_are_equal(tmp_path):
    """OpenCV's, a plain sequence and rows in brackets, as PyYAML writes arrays; and with one number
    a line.
    """
    camera = turned_rig()[0]
    file = sorted(write_opencv(tmp_path, [camera]).glob("*.y*ml"))[0]
    whole, read = file.read_text(), []
    matrix = re.compile(r"!!opencv-matrix\s+rows: (\d+)\s+cols: (\d+)\s+dt: d\s+data: \[([^\]]*)\]")

    def rows(match: re.Match[str]) -> list[list[str]]:
        values = "".join(match[3].split()).split(",")
        return [values[at : at + int(match[2])] for at in range(0, len(values), int(match[2]))]

    forms = (
        lambda match: match[0],
        lambda match: f"[{match[3]}]",
        lambda match: "[" + ", ".join(f"[{', '.join(row)}]" for row in rows(match)) + "]",
        lambda match: "".join(
            "\n- " + "\n  ".join(f"- {value}" for value in row) for row in rows(match)
        ),
    )
    for form in forms:
        file.write_text(matrix.sub(form, whole))
        (each,) = read_calibration_file(file).cameras.values()
        read.append((each.K.tolist(), each.coefficients, each.world_to_camera.tolist()))
    assert len(matrix.findall(whole)) >= 3
    assert read == read[:1] * 4


def test_files_that_share_one_camera_name_are_called_like_the_files(tmp_path):
    """ROS writes narrow_stereo into each."""
    folder = write_opencv(tmp_path, turned_rig())
    for file in folder.glob("*.y*ml"):
        with_line(file, "camera_name: narrow_stereo")
    assert list(read_calibration_file(folder).cameras) == ["cam00", "cam01", "cam02"]


@pytest.mark.parametrize(
    ("scale", "reason"),
    [(2.0, "K is of about 128 x 96 images"), (1 / WIDTH, "fractions of the side")],
)
@pytest.mark.parametrize("kind", ["opencv", "anipose"])
def test_a_K_of_other_images_is_told_from_its_principal_point(kind, scale, reason, tmp_path):
    """Where the file names no size; fractions of the side in any file."""
    camera = read_calibration_file(FORMATS[kind](tmp_path)).cameras["cam00"]
    K = np.array(
        [[camera.K[0, 0], 0, scale * WIDTH / 2], [0, camera.K[1, 1], scale * HEIGHT / 2], [0, 0, 1]]
    )
    with refused(CameraError, reason, f"{WIDTH} x {HEIGHT}"):
        replace(camera, K=K, size=None).lens((WIDTH, HEIGHT))
