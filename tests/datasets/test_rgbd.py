"""RGB-D sequences: a moving camera with a depth sensor, as ScanNet and HoloLens export them."""

import pickle
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ggvs_eval.datasets import open_capture
from ggvs_eval.datasets.rgbd import DepthFrames
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.images import write_image
from helpers.captures import make_image, refusal
from helpers.places import SHARED
from helpers.refusals import refused

HOLOLENS = SHARED / "data" / "hololens_rgbd"
WIDTH, HEIGHT = 64, 48
DEPTH_WIDTH, DEPTH_HEIGHT = 32, 24
NUMBERS = (0, 1, 2, 9, 10)  # ScanNet does not pad its numbers: 10 must come after 9
K = np.array([[60.0, 0, 33.0], [0, 62.0, 23.0], [0, 0, 1]])
K_DEPTH = np.array([[28.0, 0, 16.5], [0, 29.0, 12.5], [0, 0, 1]])


def make_pose(index: int) -> np.ndarray:
    """Camera to world: turned by 0.1 rad per frame about the vertical, 0.2 m to the right per
    frame.
    """
    cosine, sine = np.cos(0.1 * index), np.sin(0.1 * index)
    return np.array(
        [[cosine, 0, sine, 0.2 * index], [0, 1, 0, 0.1], [-sine, 0, cosine, 0], [0, 0, 0, 1]]
    )


def make_depth_mm(index: int, width: int = DEPTH_WIDTH, height: int = DEPTH_HEIGHT) -> np.ndarray:
    """A depth that differs in every pixel; its corner is unknown."""
    steps = 1500 + 100 * index + np.arange(width * height, dtype=np.uint16).reshape(height, width)
    steps[:2, :3] = 0
    return steps.astype(np.uint16)


def write_matrix(file: Path, matrix: np.ndarray) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(file, matrix, fmt="%f")


def write_scannet(folder: Path) -> Path:
    """What SensReader exports: no leading zeros, 4 x 4 matrices as text, depth of its own size in
    millimetres.
    """
    for name in ("color", "depth"):
        (folder / name).mkdir(parents=True)
        write_matrix(folder / "intrinsic" / f"extrinsic_{name}.txt", np.eye(4))
        matrix = np.eye(4)
        matrix[:3, :3] = K if name == "color" else K_DEPTH
        write_matrix(folder / "intrinsic" / f"intrinsic_{name}.txt", matrix)
    for index, number in enumerate(NUMBERS):
        cv2.imwrite(
            str(folder / "color" / f"{number}.jpg"), make_image(0, index, WIDTH, HEIGHT)[..., ::-1]
        )
        cv2.imwrite(str(folder / "depth" / f"{number}.png"), make_depth_mm(index))
        write_matrix(folder / "pose" / f"{number}.txt", make_pose(index))
    return folder


def write_hololens(folder: Path, first: int = 3) -> Path:
    """One file of poses whose rows follow the images, one matrix for both sensors; the fourth
    number is missing.
    """
    numbers = [first, first + 1, first + 2, first + 4, first + 5]
    for name in ("images", "depth"):
        (folder / name).mkdir(parents=True)
    for index, number in enumerate(numbers):
        cv2.imwrite(
            str(folder / "images" / f"{number:05d}.png"),
            make_image(0, index, WIDTH, HEIGHT)[..., ::-1],
        )
        cv2.imwrite(
            str(folder / "depth" / f"{number:05d}.png"), make_depth_mm(index, WIDTH, HEIGHT)
        )
    np.savetxt(folder / "poses.txt", [make_pose(index).ravel() for index in range(5)])
    np.savetxt(folder / "K.txt", K)
    return folder


@pytest.fixture(scope="module")
def scannet_scene(tmp_path_factory):
    return write_scannet(tmp_path_factory.mktemp("rgbd") / "scene0000_00")


@pytest.fixture
def scannet(scannet_scene, tmp_path) -> Path:
    """An intact export to read or to damage."""
    return Path(shutil.copytree(scannet_scene, tmp_path / "scene0000_00"))


def read_depth(capture, name: str) -> np.ndarray:
    (depth,) = capture.extras_of(name).depth.depths(0, 1)
    return depth


def test_opens_a_scannet_export(scannet):
    """Every frame is a metric camera of a single instant, in the order of numbers, with its image
    and pose.
    """
    capture = open_capture(scannet)
    assert (capture.layout, capture.scene, capture.n_frames, capture.fps) == (
        "rgbd",
        "scene0000_00",
        1,
        0.0,
    )
    assert capture.camera_names == ("000000", "000001", "000002", "000009", "000010")
    assert (capture.units_per_metre, capture.units_origin) == (
        1.0,
        "assumed of its form, which is that of a metric data set",
    )
    for index, camera in enumerate(capture.cameras):
        image = cv2.imread(str(scannet / "color" / f"{NUMBERS[index]}.jpg"))[..., ::-1]
        assert np.array_equal(capture.frame(camera.name, 0), image)
        np.testing.assert_allclose(camera.K, K)
        np.testing.assert_allclose(
            np.linalg.inv(camera.world_to_camera), make_pose(index), atol=1e-5
        )


def test_projects_as_the_poses_say(scannet):
    """A point that pose 3 puts 1 m to the right, 0.5 m down and 4 m ahead is seen at f x/z + c."""
    point_world = (make_pose(3) @ [1.0, 0.5, 4.0, 1.0])[:3]
    uv, depth = open_capture(scannet).camera("000009").project(point_world)
    np.testing.assert_allclose(uv, (60 / 4 + 33, 62 / 8 + 23), atol=1e-3)
    assert depth == pytest.approx(4.0, abs=1e-5)


def test_depth_is_seen_through_both_intrinsics(scannet):
    """Colour pixel (41, 30) looks at 28 (41.5 - 33) / 60 + 16.5 = 20.5 and 29 (30.5 - 23) / 62 +
    12.5 = 16.0 of the depth map.
    """
    depth = read_depth(open_capture(scannet), "000002")
    assert (depth.shape, depth.dtype) == ((HEIGHT, WIDTH), np.float32)
    for column, row in ((41, 30), (12, 7), (63, 24)):
        column_depth = int(28 * (column + 0.5 - 33) / 60 + 16.5)
        row_depth = int(29 * (row + 0.5 - 23) / 62 + 12.5)
        assert depth[row, column] == np.float32(make_depth_mm(2)[row_depth, column_depth] * 0.001)
    assert depth[30, 41] == np.float32((1700 + 16 * 32 + 20) * 0.001)


def test_depth_outside_the_sensor_is_unknown(tmp_path):
    """Pixels whose ray the sensor does not see, and pixels where it measured nothing, are 0;
    nothing is averaged.
    """
    cv2.imwrite(str(tmp_path / "0.png"), make_depth_mm(0))
    wide = np.array([[60.0, 0, 32.0], [0, 60.0, 24.0], [0, 0, 1]])
    narrow = np.array([[60.0, 0, 16.0], [0, 60.0, 12.0], [0, 0, 1]])
    (depth,) = DepthFrames(tmp_path / "0.png", 0.001, WIDTH, HEIGHT, wide, narrow).depths(0, 1)
    assert not depth[:12].any()
    assert not depth[:, 48:].any()
    np.testing.assert_array_equal(
        depth[12:36, 16:48], (make_depth_mm(0) * 0.001).astype(np.float32)
    )


def test_depth_without_intrinsics_of_its_own(tmp_path):
    """Where both sensors share the field of view, each depth pixel covers its block of the
    frame.
    """
    cv2.imwrite(str(tmp_path / "0.png"), make_depth_mm(0))
    cv2.imwrite(str(tmp_path / "1.png"), make_depth_mm(1))
    source = DepthFrames(tmp_path, 0.002, WIDTH, HEIGHT)
    assert source.n_frames == 2
    for index, depth in enumerate(source.depths(0, 2)):
        np.testing.assert_allclose(
            depth, np.kron(make_depth_mm(index), np.ones((2, 2))) * 0.002, rtol=1e-6
        )
    with refused(CaptureError, "1..2", "has 2"):
        list(source.depths(1, 3))


def test_opens_a_hololens_sequence(tmp_path):
    """Row i of the poses belongs to the i-th image, whatever its number; depth has the image's own
    grid.
    """
    capture = open_capture(write_hololens(tmp_path / "room"))
    assert capture.camera_names == ("000003", "000004", "000005", "000007", "000008")
    for index, camera in enumerate(capture.cameras):
        assert np.array_equal(capture.frame(camera.name, 0), make_image(0, index, WIDTH, HEIGHT))
        np.testing.assert_allclose(camera.K, K)
        np.testing.assert_allclose(
            np.linalg.inv(camera.world_to_camera), make_pose(index), atol=1e-12
        )
        np.testing.assert_allclose(
            read_depth(capture, camera.name), make_depth_mm(index, WIDTH, HEIGHT) * 0.001, rtol=1e-6
        )


def test_depth_range_holds_what_was_measured(scannet):
    """Near is 0.8 times the smallest 1st, far 1.2 times the largest 99th percentile of the known
    depths, for all cameras.
    """
    percentiles = [
        np.percentile(steps[steps > 0], (1, 99)) for steps in map(make_depth_mm, range(5))
    ]
    expected = 0.8e-3 * percentiles[0][0], 1.2e-3 * percentiles[4][1]
    assert [(camera.near, camera.far) for camera in open_capture(scannet).cameras] == [
        pytest.approx(expected)
    ] * 5


def test_travels_to_other_processes(scannet):
    """A capture with its depth can be pickled, before and after depth was read."""
    capture = open_capture(scannet)
    before = pickle.dumps(capture)
    depth = read_depth(capture, "000001")
    for pickled in (before, pickle.dumps(capture)):
        assert np.array_equal(read_depth(pickle.loads(pickled), "000001"), depth)
    digests = {capture.extras_of(name).depth.digest for name in capture.camera_names}
    assert len(digests) == 5


@pytest.mark.parametrize("lost", ["-inf", "nan"])
def test_lost_tracking_is_skipped(scannet, lost):
    """Frames without a finite pose are left out and listed; the others keep their poses."""
    assert open_capture(scannet).notes == ()
    for number in (1, 9):
        (scannet / "pose" / f"{number}.txt").write_text(" ".join([lost] * 16))
    capture = open_capture(scannet)
    assert capture.notes == ("000001, 000009 omitted: no finite pose (tracking lost)",)
    assert capture.camera_names == ("000000", "000002", "000010")
    np.testing.assert_allclose(capture.camera("000010").centre, make_pose(4)[:3, 3], atol=1e-5)
    for number in (0, 2):
        (scannet / "pose" / f"{number}.txt").write_text(" ".join([lost] * 16))
    assert "wanted at least 2 frames with a finite pose, got 1 of 5" in refusal(scannet)


def test_a_row_of_nan_is_skipped(tmp_path):
    """The same holds for rows of poses.txt."""
    poses = np.loadtxt(write_hololens(tmp_path / "room") / "poses.txt")
    poses[3] = np.nan
    np.savetxt(tmp_path / "room" / "poses.txt", poses)
    capture = open_capture(tmp_path / "room")
    assert capture.camera_names == ("000003", "000004", "000005", "000008")
    assert capture.notes[0].startswith("000007 omitted")


def cut(file: Path, kept: float) -> None:
    content = file.read_bytes()
    file.write_bytes(content[: int(kept * len(content))])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda folder: (folder / "depth" / "2.png").unlink(),
            "a depth map for each of the 5 images, got none for 2;",
        ),
        (
            lambda folder: (folder / "pose" / "9.txt").unlink(),
            "pose: wanted a pose for each of the 5 images, got none for 9;",
        ),
        (
            lambda folder: [file.unlink() for file in (folder / "color").iterdir()],
            "each of the 0 images, got no images",
        ),
        (
            lambda folder: shutil.copy(folder / "color" / "2.jpg", folder / "color" / "02.jpg"),
            "got a second one in 2.jpg",
        ),
        (lambda folder: cut(folder / "color" / "2.jpg", 0.5), "color/2.jpg: wanted an image, got"),
        (
            lambda folder: cut(folder / "depth" / "2.png", 0.7),
            "depth/2.png: wanted a depth map, got",
        ),
        (
            lambda folder: cut(folder / "depth" / "2.png", 0.0),
            "depth/2.png: wanted a picture, got an empty file",
        ),
        (
            lambda folder: shutil.copy(folder / "color" / "1.jpg", folder / "depth" / "1.png"),
            "channel, got uint8 (48, 64, 3)",
        ),
        (
            lambda folder: cv2.imwrite(
                str(folder / "color" / "2.jpg"), np.zeros((24, 32, 3), np.uint8)
            ),
            "got 32 x 24; resize",
        ),
        (
            lambda folder: cut(folder / "pose" / "2.txt", 0.5),
            "2.txt: wanted a matrix of 4 x 4 numbers, got",
        ),
        (
            lambda folder: (folder / "pose" / "2.txt").write_text("1 0 zero"),
            "got: line 1: no number in 'zero'",
        ),
        (
            lambda folder: (folder / "pose" / "2.txt").write_bytes(b"\xc3("),
            "a text file of numbers, got: 'utf-8' codec",
        ),
        (
            lambda folder: write_matrix(folder / "pose" / "2.txt", 2 * make_pose(2)),
            "frame 2, got the last row [0.0, 0.0, 0.0, 2",
        ),
        (
            lambda folder: write_matrix(folder / "pose" / "2.txt", np.diag([1, 1, -1, 1])),
            "frame 2: camera 000002: the rotation",
        ),
    ],
)
def test_frames_that_are_not_whole(scannet, change, message):
    """Missing, doubled, truncated and foreign files are named with what was found."""
    change(scannet)
    assert message in refusal(scannet)


@pytest.mark.parametrize(
    ("name", "matrix", "message"),
    [
        (
            "intrinsic_color",
            np.eye(3)[:2],
            "intrinsic_color.txt: wanted a matrix of 3 x 3 or 4 x 4 numbers, got 6 numbers",
        ),
        (
            "intrinsic_color",
            K * np.nan,
            "intrinsic_color.txt: wanted pinhole intrinsics without skew",
        ),
        ("intrinsic_color", K.T, "wanted pinhole intrinsics without skew"),
        (
            "intrinsic_color",
            np.diag([2, 2, 1]) @ K,
            "127 x 96 images, by its principal point (66, 46), these have 64 x 48",
        ),
        (
            "intrinsic_depth",
            K,
            "K is of about 64 x 48 images, by its principal point (33, 23), these have 32 x 24",
        ),
        (
            "extrinsic_depth",
            np.eye(4) + np.eye(4, k=3) * 40,
            "a depth camera within 1 m of the colour camera, got 40 m; write",
        ),
        (
            "extrinsic_depth",
            np.diag([1.1, 1, 1, 1]),
            "extrinsic_depth.txt: wanted a rotation and a translation, 4 x 4, got",
        ),
        (
            "extrinsic_color",
            np.eye(4) * np.nan,
            "extrinsic_color.txt: wanted a rotation and a translation, 4 x 4, got",
        ),
    ],
)
def test_calibration_that_makes_no_sense(scannet, name, matrix, message):
    """Intrinsics of another size or kind, and extrinsics that are no rigid transform or in
    millimetres, are refused.
    """
    write_matrix(scannet / "intrinsic" / f"{name}.txt", matrix)
    assert message in refusal(scannet)


def test_a_depth_camera_beside_the_colour_camera(scannet):
    """Extrinsics run from each camera to the device: depth of a sensor 0.3 m to the right belongs
    to the right.

    points_colour = inv(E_colour) E_depth points_depth, which is 0.33 - 0.03 = 0.3 m to the right
    here.
    """
    for file in (scannet / "depth").iterdir():
        cv2.imwrite(str(file), np.full((DEPTH_HEIGHT, DEPTH_WIDTH), 3000, np.uint16))
    for name, right_m in (("color", 0.03), ("depth", 0.33)):
        extrinsic = np.eye(4)
        extrinsic[0, 3] = right_m
        write_matrix(scannet / "intrinsic" / f"extrinsic_{name}.txt", extrinsic)
    capture = open_capture(scannet)
    depth = read_depth(capture, "000001")
    left, right = (60 * (0.3 / 3 + (edge - 16.5) / 28) + 33 for edge in (0, DEPTH_WIDTH))
    centres = np.arange(WIDTH) + 0.5
    np.testing.assert_allclose(
        depth[HEIGHT // 2], np.where((centres > left) & (centres < right), 3.0, 0.0), rtol=1e-6
    )
    assert not depth[HEIGHT // 2].all()
    beside = capture.extras_of("000001").depth.digest
    for name in ("color", "depth"):
        write_matrix(scannet / "intrinsic" / f"extrinsic_{name}.txt", extrinsic)
    together = open_capture(scannet).extras_of("000001").depth
    assert together.depth_to_colour is None
    assert together.digest != beside


def test_calibration_that_is_missing(scannet):
    """Intrinsics are needed, extrinsics are not."""
    for name in ("color", "depth"):
        (scannet / "intrinsic" / f"extrinsic_{name}.txt").unlink()
    assert len(open_capture(scannet).cameras) == 5
    (scannet / "intrinsic" / "intrinsic_depth.txt").unlink()
    assert "intrinsic_depth.txt: wanted a text file of numbers, got: no such file" in refusal(
        scannet
    )


@pytest.mark.parametrize(("rows", "found"), [(4, "4 rows of 16"), (6, "6 rows of 16")])
def test_rows_and_images_do_not_match(tmp_path, rows, found):
    """One pose too few or too many cannot be attributed and is refused."""
    write_hololens(tmp_path / "room")
    np.savetxt(tmp_path / "room" / "poses.txt", [make_pose(index).ravel() for index in range(rows)])
    assert f"poses.txt: wanted 16 numbers for each of the 5 images, got {found}" in refusal(
        tmp_path / "room"
    )


def test_the_largest_value_is_unknown_depth(scannet):
    """65535 is no distance: it takes no part in the range and comes back as unknown, and a note
    tells the share of both.
    """
    before = open_capture(scannet).cameras[0]
    for file in sorted((scannet / "depth").glob("*.png")):
        depth = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        depth[:3] = 65535
        cv2.imwrite(str(file), depth)
    read = open_capture(scannet)
    assert read.cameras[0].far == pytest.approx(before.far, rel=0.1)
    assert any("% of the depth unknown: values 0 and 65535" in note for note in read.notes)
    assert read_depth(read, read.camera_names[0]).max() < before.far


def write_kinect(folder: Path, form: str, size: tuple[int, int] = (640, 480)) -> Path:
    """Three frames of 7-Scenes or TUM, whose depth is 2 m."""
    folder.mkdir(parents=True)
    rows = ["# timestamp tx ty tz qx qy qz qw"]
    for index in range(3):
        image, depth = (
            make_image(1, index, *size),
            np.full(size[::-1], 2000 if form == "7-scenes" else 10000, np.uint16),
        )
        depth[:9] = 65535 if form == "7-scenes" else 0
        if form == "7-scenes":
            colour_file, depth_file = (
                folder / f"frame-{index:06d}.{kind}.png" for kind in ("color", "depth")
            )
            write_matrix(folder / f"frame-{index:06d}.pose.txt", make_pose(index))
        else:
            colour_file, depth_file = (
                folder / "rgb" / f"{100 + index}.5.png",
                folder / "depth" / f"{100 + index}.51.png",
            )
            x, y, z, w = Rotation.from_matrix(make_pose(index)[:3, :3]).as_quat()
            rows.append(
                f"{100 + index}.495 {' '.join(map(str, make_pose(index)[:3, 3]))} {x} {y} {z} {w}"
            )
        for file, pixels in ((colour_file, image[..., ::-1]), (depth_file, depth)):
            file.parent.mkdir(exist_ok=True)
            cv2.imwrite(str(file), pixels)
    if form == "tum":
        write_image(folder / "rgb" / "200.0.png", image)
        (folder / "groundtruth.txt").write_text("\n".join(rows) + "\n")
    return folder


@pytest.mark.parametrize(
    ("form", "focal_px", "cx"), [("7-scenes", 585.0, 320.5), ("tum", 525.0, 320.0)]
)
def test_kinect_sequences(tmp_path, form, focal_px, cx):
    """7-Scenes' files side by side and TUM's folders of time stamps are one RGB-D camera each, that
    of the data set.
    """
    read = open_capture(write_kinect(tmp_path / "office", form))
    assert (read.layout, read.camera_names) == ("rgbd", ("000000", "000001", "000002"))
    assert read.cameras[0].K[[0, 0], [0, 2]].tolist() == [focal_px, cx]
    for index, camera in enumerate(read.cameras):
        np.testing.assert_allclose(
            np.linalg.inv(camera.world_to_camera), make_pose(index), atol=1e-6
        )
    depth = read_depth(read, "000001")
    assert (depth[20], depth[2].max()) == (pytest.approx(2.0), 0)
    assert np.array_equal(read.frame("000002", 0), make_image(1, 2, 640, 480))
    assert any("1 of 4 frames omitted" in note for note in read.notes) == (form == "tum")


@pytest.mark.parametrize("form", ["7-scenes", "tum"])
def test_another_camera_than_the_data_sets(tmp_path, form):
    """Of other sizes the files do not say the intrinsics: they are asked for, and read where they
    are.
    """
    folder = write_kinect(tmp_path / "mine", form, (64, 48))
    assert "wanted images of 640 x 480" in refusal(folder)
    assert "camera-intrinsics.txt" in refusal(folder)
    write_matrix(
        folder / "camera-intrinsics.txt", np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]])
    )
    assert open_capture(folder).cameras[0].K.tolist() == [[60, 0, 32], [0, 60, 24], [0, 0, 1]]


def agreement(capture, first: int, second: int, row_offset: int = 0) -> float:
    """Share of the pixels of one frame whose depth, warped into another, is within 5 % of the depth
    there.

    With an offset, both cameras take the pose that many rows further.
    """
    depth, truth = (read_depth(capture, capture.cameras[index].name) for index in (first, second))
    source, target = (capture.cameras[index + row_offset] for index in (first, second))
    points_world = source.unproject(source.pixel_centres(), depth.astype(np.float64))[depth > 0]
    uv, warped = target.project(points_world)
    seen = (warped > 0) & (uv >= 0).all(axis=1) & (uv < target.size).all(axis=1)
    column, row = uv[seen].astype(int).T
    found = truth[row, column]
    assert np.count_nonzero(found) > 0.2 * len(points_world)
    return float((np.abs(warped[seen] - found)[found > 0] < 0.05 * found[found > 0]).mean())


@pytest.mark.slow
@pytest.mark.skipif(
    not HOLOLENS.is_dir(), reason="the shared sequence hololens_rgbd is not on this machine"
)
def test_real_sequence():
    """Depth of a real frame, warped 3 frames ahead, agrees with the depth there; with the poses one
    row further it does not.
    """
    capture = open_capture(HOLOLENS)
    assert (len(capture.cameras), capture.cameras[0].name, capture.cameras[-1].name) == (
        240,
        "000003",
        "000243",
    )
    assert "000237" not in capture.camera_names
    assert capture.notes == ()
    # The last two pairs straddle the missing number.
    firsts = (5, 100, 150, 231, 233)
    agreements = [agreement(capture, first, first + 3) for first in firsts]
    assert min(agreements) > 0.93
    assert np.mean(agreements) > 0.97
    assert np.mean([agreement(capture, first, first + 3, 1) for first in firsts]) < 0.9
