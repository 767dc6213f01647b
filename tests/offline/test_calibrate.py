"""Calibration of a rig from one instant: poses, lenses, what may be known before, and what is said
when it fails.
"""

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.calibration_errors import measure_against
from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.datasets import open_capture
from ggvs_eval.datasets.camera_frames import find_rig_frames
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.colmap_text import Sightings, write_model
from ggvs_eval.files.images import read_image, write_image
from ggvs_eval.geometry.epipolar import epipolar_errors
from ggvs_eval.lens import Lens
from ggvs_eval.pipelines.offline.calibration import calibrate as calibration_job
from ggvs_eval.pipelines.offline.calibration.calibrate import (
    Calibration,
    CalibrationOptions,
    calibrate,
)
from ggvs_eval.pipelines.offline.calibration.known_cameras import (
    colmap_camera,
    read_known,
    write_intrinsics,
)
from helpers.calibration_files import write_qualisys
from helpers.captures import make_image, make_rig, write_colmap_model, write_folders, write_videos
from helpers.packed_films import unpack_film
from helpers.refusals import refused

NAMES = tuple(f"cam{number:02d}" for number in range(8))


@pytest.fixture(scope="module")
def demo(tmp_path_factory) -> Path:
    """Eight cameras of the demo room; nobody changes it."""
    return unpack_film("calibration", tmp_path_factory.mktemp("demo") / "room")


@pytest.fixture(scope="module")
def calibrated(demo) -> Calibration:
    """That room calibrated from its videos alone, with one lens for all cameras."""
    return calibrate(demo, demo.with_name("calibrated"), CalibrationOptions(shared_intrinsics=True))


def refusal_of(frames: Path, out: Path, **options: object) -> str:
    """The one line with which a calibration is refused; nothing may be left under the
    wanted name.
    """
    with pytest.raises(CaptureError) as caught:
        calibrate(frames, out, CalibrationOptions(**options))  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)
    assert not out.exists()
    assert not list(out.parent.glob(f".{out.name}.*"))
    return str(caught.value)


def write_stills(demo: Path, folder: Path, names: tuple[str, ...]) -> Path:
    """One image per camera of some of the demo's cameras."""
    capture = open_capture(demo)
    for name in names:
        write_image(folder / f"{name}.png", capture.frame(name, 0))
    return folder


@pytest.mark.slow
def test_all_cameras_are_found_near_the_truth(demo, calibrated):
    """All 8 cameras, below 1 px, centres within 1 % of the rig's extent and 1 degree of the truth,
    focal length within 2 %.
    """
    measured = measure_against(open_capture(demo), calibrated)
    assert (measured["n_given"], measured["n_registered"], calibrated.missing) == (8, 8, {})
    assert measured["mean_reprojection_error_px"] < 1
    assert measured["n_points"] > 300
    assert measured["centre_error_percent_max"] < 1
    assert measured["rotation_error_deg_max"] < 1
    assert measured["focal_error_percent_max"] < 2


@pytest.mark.slow
def test_result_opens_at_once(demo, calibrated):
    """The written folder is a capture with the cameras that were returned, the frames of the source
    and a record.
    """
    capture = open_capture(calibrated.path)
    assert (capture.layout, capture.camera_names, capture.n_frames) == ("colmap", NAMES, 1)
    assert np.array_equal(capture.frame("cam03", 0), open_capture(demo).frame("cam03", 0))
    for camera in capture.cameras:
        found = calibrated.cameras[camera.name]
        np.testing.assert_allclose(camera.world_to_camera, found.world_to_camera, atol=1e-12)
        assert (camera.near, camera.far) == (found.near, found.far)
    record = json.loads((calibrated.path / "calibration.json").read_text())
    assert record["registered"] == list(NAMES)
    assert record["points_seen"] == dict(calibrated.points_seen)
    assert min(calibrated.points_seen.values()) > 100
    assert record["mean_reprojection_error_px"] == calibrated.mean_reprojection_error_px
    assert record["options"]["shared_intrinsics"] is True
    assert record["versions"]["pycolmap"]
    beside = {entry.name for entry in calibrated.path.iterdir() if entry.suffix != ".mp4"}
    assert beside == {"calibration.json", "calibration.log", "sparse"}


@pytest.mark.proof
def test_equal_frames_give_equal_models(demo, calibrated, tmp_path):
    """The same frames as stills and the same options give the same bytes: seeds, order and threads
    are fixed.
    """
    stills = write_stills(demo, tmp_path / "stills", NAMES)
    again = calibrate(stills, tmp_path / "again", CalibrationOptions(shared_intrinsics=True))
    for name in ("cameras.bin", "images.bin", "points3D.bin"):
        assert (again.path / "sparse/0" / name).read_bytes() == (
            calibrated.path / "sparse/0" / name
        ).read_bytes()
    assert open_capture(again.path).camera_names == NAMES


@pytest.mark.slow
def test_known_intrinsics_stay_fixed(demo, tmp_path):
    """With the lenses given only poses are estimated, each camera keeps its own K to the last
    digit.
    """
    truth = open_capture(demo)
    lenses = {
        camera.name: Lens(camera.K, "opencv", (0.0,) * 4, *camera.size) for camera in truth.cameras
    }
    write_intrinsics(tmp_path / "intrinsics.toml", lenses)
    options = CalibrationOptions(
        known_intrinsics=tmp_path / "intrinsics.toml", camera_model="SIMPLE_RADIAL"
    )
    found = calibrate(demo, tmp_path / "out", options)
    for camera in truth.cameras:
        assert np.array_equal(found.cameras[camera.name].K, camera.K)
    measured = measure_against(truth, found)
    assert measured["n_registered"] == 8
    assert measured["centre_error_percent_max"] < 1
    assert measured["rotation_error_deg_max"] < 1


@pytest.mark.slow
def test_known_poses_stay_fixed(demo, tmp_path):
    """With lenses and poses given, cameras stay in their world and only points are found, at their
    true depth.
    """
    truth = open_capture(demo)
    found = calibrate(demo, tmp_path / "out", CalibrationOptions(known_poses=demo))
    for camera in truth.cameras:
        assert np.array_equal(found.cameras[camera.name].K, camera.K)
        np.testing.assert_allclose(
            found.cameras[camera.name].world_to_camera, camera.world_to_camera, atol=1e-9
        )
        assert (
            0.5 * camera.near
            < found.cameras[camera.name].near
            < found.cameras[camera.name].far
            < 2 * camera.far
        )
    assert found.mean_reprojection_error_px < 1
    assert found.n_points > 300


@pytest.mark.proof
def test_a_studios_poses_stay_fixed_and_metric(demo, tmp_path):
    """Poses of a Qualisys file are kept, in metres, and the capture that is written knows that they
    are.
    """
    capture = open_capture(demo)
    truth = []
    for camera in capture.cameras:
        metric = camera.world_to_camera.copy()
        metric[:3, 3] /= capture.units_per_metre
        truth.append(replace(camera, world_to_camera=metric))
    file = write_qualisys(tmp_path / "rig.qca.txt", truth, coefficients=(0.0,) * 5)
    found = calibrate(demo, tmp_path / "out", CalibrationOptions(known_poses=file))
    for camera in truth:
        np.testing.assert_allclose(
            found.cameras[camera.name].world_to_camera, camera.world_to_camera, atol=1e-9
        )
    assert found.n_points > 300
    assert open_capture(tmp_path / "out").units_per_metre == 1.0
    assert open_capture(tmp_path / "out").units_origin.startswith("units.toml")


@pytest.mark.proof
def test_lens_distortion_is_found(demo, tmp_path):
    """Frames of a barrel lens (k1 = -0.12) give that lens within 0.02, and a capture that is read
    undistorted.
    """
    truth = open_capture(demo)
    lens = Lens(truth.cameras[0].K, "opencv", (-0.12, 0.0, 0.0, 0.0), 640, 480)
    seen = cv2.undistortPoints(
        truth.cameras[0].pixel_centres().reshape(-1, 1, 2), lens.K, np.array(lens.coefficients)
    )
    maps = (seen.reshape(480, 640, 2) * lens.K[0, 0] + lens.K[:2, 2] - 0.5).astype(np.float32)
    for name in truth.camera_names:
        raw = cv2.remap(truth.frame(name, 0), maps[..., 0], maps[..., 1], cv2.INTER_CUBIC)
        write_image(tmp_path / "raw" / f"{name}.png", np.asarray(raw, np.uint8))
    options = CalibrationOptions(shared_intrinsics=True, camera_model="SIMPLE_RADIAL")
    found = calibrate(tmp_path / "raw", tmp_path / "out", options)
    assert read_known(tmp_path / "out")["cam00"].lens.coefficients[0] == pytest.approx(
        -0.12, abs=0.02
    )
    measured = measure_against(truth, found)
    assert measured["mean_reprojection_error_px"] < 1
    assert measured["centre_error_percent_max"] < 1
    assert measured["focal_error_percent_max"] < 2
    images = (
        open_capture(tmp_path / "out").frame("cam00", 0),
        read_image(tmp_path / "raw" / "cam00.png"),
    )
    errors = [
        np.abs(image.astype(float) - truth.frame("cam00", 0))[100:380, 150:490].mean()
        for image in images
    ]
    assert errors[0] < 0.5 * errors[1]


@pytest.mark.slow
def test_camera_that_sees_nothing_is_named(demo, tmp_path):
    """A camera that cannot be registered is refused by name, with its features and the mend, or
    left out if that is allowed.
    """
    stills = write_stills(demo, tmp_path / "stills", ("cam00", "cam01", "cam02", "cam05"))
    write_image(stills / "cam09.png", np.full((480, 640, 3), 90, np.uint8))
    message = refusal_of(stills, tmp_path / "out", shared_intrinsics=True)
    assert (
        "wanted a pose of all 5 cameras, found none of cam09 (0 features, 0 matches with its best "
        "partner)" in message
    )
    assert "texture, light or overlap" in message
    assert "--allow-missing" in message
    assert str(tmp_path / "out.log") in message
    assert "Registering image" in (tmp_path / "out.log").read_text()

    found = calibrate(
        stills, tmp_path / "out", CalibrationOptions(shared_intrinsics=True, allow_missing=True)
    )
    assert list(found.missing) == ["cam09"]
    assert open_capture(found.path).camera_names == ("cam00", "cam01", "cam02", "cam05")
    assert json.loads((found.path / "calibration.json").read_text())["missing"] == dict(
        found.missing
    )


@pytest.mark.slow
def test_too_little_texture(tmp_path):
    """Smooth pictures give no features; all cameras are named and leaving them out is not
    offered.
    """
    write_videos(tmp_path / "smooth")
    message = refusal_of(tmp_path / "smooth", tmp_path / "out", allow_missing=True)
    assert "found none of cam00 (0 features" in message
    assert "cam03 (0 features" in message
    assert "--allow-missing" not in message


@pytest.mark.parametrize(
    ("ending", "said"),
    [("os.kill(os.getpid(), 9)", "ended by signal 9"), ("1 / 0", "ZeroDivisionError")],
)
def test_child_process_ends_badly(tmp_path, monkeypatch, ending, said):
    """A crash or a kill of pycolmap's process is one line that names its log, which is kept."""
    (tmp_path / "broken_worker.py").write_text(
        f"import os\nprint('started', flush=True)\n{ending}\n"
    )
    monkeypatch.setattr(calibration_job, "WORKER", "broken_worker")
    monkeypatch.setenv(
        "PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    )
    write_videos(tmp_path / "frames")
    message = refusal_of(tmp_path / "frames", tmp_path / "out")
    assert said in message
    assert str(tmp_path / "out.log") in message
    assert "started" in (tmp_path / "out.log").read_text()


PINHOLE = Lens(np.diag([50.0, 50.0, 1.0]), "opencv", (0.0,) * 4, 64, 48)


def write_sizes(folder: Path) -> None:
    write_image(folder / "frames" / "a.png", make_image(0, 0))
    write_image(folder / "frames" / "b.png", make_image(1, 0, 32, 24))


def write_lengths(folder: Path) -> None:
    write_videos(folder / "frames", ("cam00", "cam01"))
    write_videos(folder / "frames", ("cam02",), n_frames=3)


def with_lenses(*names: str) -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        write_videos(folder / "frames")
        write_intrinsics(folder / "lens.toml", dict.fromkeys(names, PINHOLE))

    return write


@pytest.mark.parametrize(
    ("write", "options", "message"),
    [
        (with_lenses("a"), {"frame": 5}, "cam00.mp4: wanted frame 5, it has 5"),
        (with_lenses("a"), {"known_intrinsics": "absent.toml"}, "absent.toml: wanted a TOML file"),
        (
            with_lenses("cam00", 'odd "n"'),
            {"known_intrinsics": "lens.toml"},
            'cam01, cam02, cam03, it has cam00, odd "n"',
        ),
        (
            with_lenses(*NAMES[:4]),
            {"known_poses": "lens.toml"},
            "wanted poses, got only intrinsics of cam00",
        ),
        (
            write_sizes,
            {"shared_intrinsics": True},
            "wanted frames of one size for shared intrinsics",
        ),
        (write_lengths, {}, "got cam00 5, cam01 5, cam02 3; 'ggvs-eval check"),
    ],
)
def test_refused_before_any_work(tmp_path, write, options, message):
    """Instants and files that are not there, lenses of others, files without poses, and frames that
    do not fit together.
    """
    write(tmp_path)
    given = {
        key: tmp_path / value if isinstance(value, str) else value for key, value in options.items()
    }
    assert message in refusal_of(tmp_path / "frames", tmp_path / "out", **given)


def test_out_folder_with_content_is_kept(tmp_path):
    """A folder that holds something is never written into."""
    write_videos(tmp_path / "frames")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("keep")
    with refused(CaptureError, "empty folder"):
        calibrate(tmp_path / "frames", tmp_path / "out", CalibrationOptions())
    assert (tmp_path / "out" / "mine.txt").read_text() == "keep"


def test_options_that_contradict_each_other():
    """Known poses bring their lenses; giving both files is refused, as is a negative frame."""
    for options, words in (
        ({"known_intrinsics": Path("a.toml"), "known_poses": Path("b")}, "give one"),
        ({"frame": -1}, "must not be negative"),
        ({"refine": True}, "--known-poses RIG"),
    ):
        with refused(CaptureError, words):
            CalibrationOptions(**options)


@pytest.mark.parametrize(
    ("write", "names"),
    [
        (write_videos, ("cam00", "cam01", "cam02", "cam03")),
        (lambda folder: write_videos(folder / "videos"), ("cam00", "cam01", "cam02", "cam03")),
        (lambda folder: write_folders(folder, ("7", "12"), "images/{}"), ("12", "7")),
        (lambda folder: write_folders(folder, ("a", "b"), "{}/images"), ("a", "b")),
        (lambda folder: write_folders(folder, ("a", "b", "masks"), "{}"), ("a", "b")),
        (
            lambda folder: [
                write_image(folder / "images" / f"{n}.png", make_image(0, 0)) for n in "xyz"
            ],
            ("x", "y", "z"),
        ),
    ],
)
def test_frames_are_found_in_every_arrangement(tmp_path, write, names):
    """Videos, folders and single images are found by the names of their cameras, whatever else lies
    beside them.
    """
    write(tmp_path)
    (tmp_path / "notes.txt").write_text("no frames")
    assert tuple(find_rig_frames(tmp_path)) == names


@pytest.mark.slow
def test_poses_are_refined_in_their_world(demo, tmp_path):
    """Poses and lenses that are a little off agree with each other afterwards; the world and its
    scale stay.
    """
    truth = open_capture(demo)
    rng, folder = np.random.default_rng(5), tmp_path / "rough"
    rough = {camera.name: knocked(camera, rng) for camera in truth.cameras}
    write_model(folder, list(rough.values()), *one_sighting_each(list(rough.values())))

    refined = calibrate(
        demo, tmp_path / "refined", CalibrationOptions(known_poses=folder, refine=True)
    )

    assert contradiction_px(truth, refined.cameras) < 0.25 * contradiction_px(truth, rough)
    assert refined.mean_reprojection_error_px < 0.5
    assert (
        max(np.linalg.norm(refined.cameras[name].centre - rough[name].centre) for name in NAMES)
        < 0.05
    )


def contradiction_px(truth: Capture, cameras: Mapping[str, Camera]) -> float:
    """Median epipolar error of exact matches: how far off another camera's pixel a rig looks up
    what one sees.
    """
    rng, errors = np.random.default_rng(0), []
    for first, second in pairwise(NAMES):
        one, other = (truth.camera(name) for name in (first, second))
        depth = rng.uniform(2, 5, 200)
        rays = one.rays().reshape(-1, 3)[rng.integers(one.width * one.height, size=len(depth))]
        points = one.centre + depth[:, None] * rays
        uv = [camera.project(points)[0] for camera in (one, other)]
        errors.append(epipolar_errors(cameras[first], cameras[second], *uv))
    return float(np.median(np.concatenate(errors)))


def knocked(camera: Camera, rng: np.random.Generator) -> Camera:
    """A camera as it stands after somebody leaned on its tripod: turned by some tenths of a degree,
    zoomed by a percent.
    """
    pose, K = camera.world_to_camera.copy(), camera.K.copy()
    pose[:3, :3] = (
        Rotation.from_rotvec(np.radians(0.2) * rng.normal(size=3)).as_matrix() @ pose[:3, :3]
    )
    pose[:3, 3] = -pose[:3, :3] @ (camera.centre + 0.01 * rng.normal(size=3))
    K[[0, 1], [0, 1]] *= 1 + 0.01 * rng.normal()
    return replace(camera, K=K, world_to_camera=pose)


def one_sighting_each(cameras: list[Camera]) -> tuple[list[Sightings], np.ndarray]:
    """A point 3 m before each camera, which sees it: a model says how deep a scene is by its
    points.
    """
    grey = np.full((1, 3), 128, np.uint8)
    sightings = [
        Sightings(np.array([number]), camera.K[None, :2, 2], grey)
        for number, camera in enumerate(cameras)
    ]
    return sightings, np.array([camera.centre + 3 * camera.axis for camera in cameras])


def test_no_frames(tmp_path):
    """A folder without frames, or with those of one camera, is refused with the places where they
    are looked for.
    """
    write_image(tmp_path / "one.png", make_image(0, 0))
    with refused(CaptureError, "two cameras", "got none", "CAM.mp4"):
        find_rig_frames(tmp_path)
    with pytest.raises(CaptureError, match="nothing there"):
        find_rig_frames(tmp_path / "absent")


@pytest.mark.parametrize(
    ("lens_model", "coefficients", "model", "n_params"),
    [
        ("opencv", (0.0,) * 5, "PINHOLE", 4),
        ("opencv", (0.1, 0.0, 0.0, 0.0), "OPENCV", 8),
        ("opencv", (0.1, 0.0, 0.0, 0.0, 0.2), "FULL_OPENCV", 12),
        ("fisheye", (0.1, 0.0, 0.0, 0.0), "OPENCV_FISHEYE", 8),
    ],
)
def test_lenses_as_colmap_calls_them(lens_model, coefficients, model, n_params):
    """A lens becomes the smallest of COLMAP's models that holds it."""
    lens = Lens(np.diag([50.0, 60.0, 1.0]), lens_model, coefficients, 64, 48)
    name, params = colmap_camera(lens)
    assert (name, len(params), params[:2]) == (model, n_params, [50.0, 60.0])


def test_known_cameras_of_a_model_alone(tmp_path):
    """A COLMAP model without frames says lenses and poses, distortion included."""
    write_colmap_model(tmp_path, ["a.png", "b.png"], "SIMPLE_RADIAL", "0.05")
    known = read_known(tmp_path)
    assert tuple(known) == ("a", "b")
    assert known["b"].lens.coefficients == (0.05, 0.0, 0.0, 0.0)
    np.testing.assert_allclose(
        known["b"].world_to_camera, make_rig(("a", "b"))[1].world_to_camera, atol=1e-9
    )


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[[camera]]\nname='a'\nwidth=64\nheight=48\nK=[[1,0],[0,1]]\n", "3 rows of 3 numbers"),
        ("[[camera]]\nname='a'\nwidth=64\nheight=48\n", "missing key camera[0].K"),
        (
            "[[camera]]\nname='a'\nwidth=-1\nheight=48\nK=[[9,0,1],[0,9,1],[0,0,1]]\n",
            "must be positive",
        ),
        ("camera = []\n", "wanted cameras of different names"),
        ("camera = [", "not valid TOML"),
    ],
)
def test_damaged_intrinsics(tmp_path, text, expected):
    """Every damage to intrinsics.toml is one line that names file and mend."""
    (tmp_path / "intrinsics.toml").write_text(text)
    with pytest.raises(CaptureError) as caught:
        read_known(tmp_path)
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)
    assert str(tmp_path / "intrinsics.toml") in str(caught.value)
