"""EasyMocap captures, as ENeRF-Outdoor is distributed: two camera files by OpenCV, and one folder
of images per camera.
"""

import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from ggvs_eval.datasets import open_capture
from ggvs_eval.datasets.easymocap import read_views
from ggvs_eval.files.images import write_image
from ggvs_eval.files.video import write_video
from ggvs_eval.lens import Lens
from helpers.captures import HEIGHT, WIDTH, make_image, make_rig, refusal
from helpers.lens_pictures import psnr, straight, through_lens
from helpers.small_layouts import (
    N_INSTANTS,
    NUMBERS,
    opencv_K,
    storage_entries,
    write_easymocap,
    write_storage,
)

BARREL = (-0.2, 0.05, 0.001, -0.002, 0.003)
PINCUSHION = (0.2, 0.05, 0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def intact_actor(tmp_path_factory) -> Path:
    return write_easymocap(tmp_path_factory.mktemp("captures") / "actor")


@pytest.fixture
def actor_folder(intact_actor, tmp_path) -> Path:
    """An intact capture of pinhole cameras, to read or to damage."""
    return Path(shutil.copytree(intact_actor, tmp_path / "actor"))


def rewrite(
    folder: Path, intri: dict | None = None, extri: dict | None = None, drop: tuple[str, ...] = ()
) -> Path:
    """Write both files again with other entries."""
    for file, entries, changes in zip(
        ("intri.yml", "extri.yml"), storage_entries(), (intri, extri), strict=True
    ):
        kept = {
            key: value for key, value in {**entries, **(changes or {})}.items() if key not in drop
        }
        write_storage(folder / file, kept, NUMBERS)
    return folder


def test_opens_as_calibrated(actor_folder):
    """Poses are world-to-camera, and OpenCV's principal point is moved by half a pixel."""
    read = open_capture(actor_folder)
    assert (read.layout, read.camera_names, read.n_frames, read.fps) == (
        "enerf-outdoor",
        NUMBERS,
        N_INSTANTS,
        30.0,
    )
    for index, (camera, truth) in enumerate(zip(read.cameras, make_rig(NUMBERS), strict=True)):
        np.testing.assert_allclose(camera.world_to_camera, truth.world_to_camera, atol=1e-12)
        np.testing.assert_allclose(camera.K, truth.K, atol=1e-12)
        assert np.array_equal(read.frame(camera.name, 1), make_image(index, 1))
    assert read.units_origin.startswith("guess")
    assert read.background("00") is None


@pytest.mark.parametrize("coefficients", [BARREL, PINCUSHION], ids=["barrel", "pincushion"])
def test_distorted_frames_are_undistorted_to_the_same_K(tmp_path, coefficients):
    """Frames come back straight with the lens's own K, as ENeRF undistorts; what the lens did not
    see is black.
    """
    folder = write_easymocap(tmp_path / "actor", coefficients)
    read = open_capture(folder)
    K = make_rig(NUMBERS)[0].K
    lens = Lens(K, "opencv", coefficients, WIDTH, HEIGHT)
    np.testing.assert_allclose(read.cameras[1].K, K, atol=1e-12)
    inside = np.s_[8:-8, 8:-8] if coefficients == PINCUSHION else np.s_[:]
    first, second = read.frames("01")
    assert psnr(first[inside], straight(lens, K)[inside]) > 42
    assert psnr(second[inside], straight(lens, K)[inside] / 2) > 42
    assert (first[0, 0].max() == 0) == (coefficients == PINCUSHION)


def test_distortion_called_D(tmp_path):
    """D_ is read where dist_ is absent, dist_ wins where both are there, and none means a
    pinhole.
    """
    folder = write_easymocap(tmp_path / "actor", BARREL)
    other = {f"D_{name}": np.array([[-0.1, 0.0, 0.0, 0.0]]) for name in NUMBERS}
    dist = {f"dist_{name}": np.array([BARREL]) for name in NUMBERS}
    rewrite(folder, {**other, **dist})
    assert read_views(folder / "intri.yml", folder / "extri.yml")[0][1].coefficients == BARREL
    rewrite(folder, other)
    assert read_views(folder / "intri.yml", folder / "extri.yml")[0][1].coefficients == (
        -0.1,
        0.0,
        0.0,
        0.0,
    )
    rewrite(folder)
    assert (
        read_views(folder / "intri.yml", folder / "extri.yml")[0][1]
        .lens((WIDTH, HEIGHT))
        .is_pinhole
    )


def test_rotation_vector_before_matrix(actor_folder):
    """R_ counts where both are there, Rot_ where it is alone."""
    turned = cv2.Rodrigues(np.array([0.0, 0.0, 0.3]))[0]
    rewrite(actor_folder, extri={"Rot_01": turned})
    truth = make_rig(NUMBERS)[1]
    np.testing.assert_allclose(
        open_capture(actor_folder).cameras[1].rotation, truth.rotation, atol=1e-12
    )
    rewrite(actor_folder, extri={"Rot_01": turned}, drop=("R_01",))
    np.testing.assert_allclose(open_capture(actor_folder).cameras[1].rotation, turned, atol=1e-12)


def test_the_centre_is_minus_R_transposed_T(actor_folder):
    """A quarter turn tells -R^T T from the -R^T-of-the-vector that another program computes."""
    rewrite(
        actor_folder,
        extri={
            "R_00": np.array([[0.0], [0.0], [np.pi / 2]]),
            "T_00": np.array([[1.0], [2.0], [3.0]]),
        },
    )
    np.testing.assert_allclose(
        open_capture(actor_folder).cameras[0].centre, [-2.0, 1.0, -3.0], atol=1e-12
    )


def test_files_by_hand(actor_folder):
    """EasyMocap's own writer and its older, unquoted lists are read like OpenCV's files."""
    lines = ["%YAML:1.0", "---", "names:", *(f"  - {name}" for name in NUMBERS)]
    for name, camera in zip(NUMBERS, make_rig(NUMBERS), strict=True):
        numbers = ", ".join(f"{value:.10f}" for value in opencv_K(camera).ravel())
        lines += [
            f"K_{name}: !!opencv-matrix",
            "  rows: 3",
            "  cols: 3",
            "  dt: d",
            f"  data: [{numbers}]",
        ]
    (actor_folder / "intri.yml").write_text("\n".join(lines) + "\n")
    read = open_capture(actor_folder)
    assert read.camera_names == NUMBERS
    np.testing.assert_allclose(read.cameras[2].K, make_rig(NUMBERS)[2].K, atol=1e-9)


def test_half_size_frames(actor_folder):
    """Frames of half the calibrated size scale K and lens; without W_ and H_ the principal point
    shows that K is of others.
    """
    for index, name in enumerate(NUMBERS):
        for file in (actor_folder / "images" / name).iterdir():
            write_image(file, make_image(index, 0, WIDTH // 2, HEIGHT // 2))
    assert open_capture(actor_folder).cameras[0].K[0, 0] == pytest.approx(0.9 * WIDTH / 2)
    rewrite(actor_folder, drop=tuple(f"{key}_{name}" for key in "HW" for name in NUMBERS))
    assert (
        "00: K is of about 64 x 48 images, by its principal point (32, 24), these have 32 x 24"
        in refusal(actor_folder)
    )


def write_extras(folder: Path, lens: Lens | None = None) -> None:
    """Hulls, masks of half size, a background per camera."""
    (folder / "vhull").mkdir()
    for frame in range(N_INSTANTS):
        np.save(
            folder / "vhull" / f"{frame:06d}.npy",
            np.array([[-0.5, -0.5, 4.0], [0.5, 0.5, 5.0 + frame]]),
        )
    for index, name in enumerate(NUMBERS):
        image = make_image(index, 4) if lens is None else through_lens(lens)
        write_image(folder / "bkgd" / f"{name}.png", image)
        half = cv2.resize(image, (WIDTH // 2, HEIGHT // 2), interpolation=cv2.INTER_AREA)
        for frame in range(N_INSTANTS):
            write_image(folder / "mask" / name / f"{frame:06d}.png", half)


def test_outdoor_is_metric_and_fast(actor_folder):
    """A sequence with hulls is metric and plays at 60 frames per second."""
    write_extras(actor_folder)
    read = open_capture(actor_folder)
    assert (read.units_per_metre, read.units_origin, read.fps) == (
        1.0,
        "assumed of its form, which is that of a metric data set",
        60.0,
    )
    assert open_capture(actor_folder, units=2.0).units_per_metre == 2.0


def test_backgrounds_and_masks(actor_folder):
    """Every camera gets its background, and its masks at their own size."""
    write_extras(actor_folder)
    read = open_capture(actor_folder)
    background = read.background("02")
    assert background is not None
    assert np.array_equal(background, make_image(2, 4))
    mask = read.extras_of("01").mask
    assert mask is not None
    assert mask.n_frames == N_INSTANTS
    assert [image.shape for image in mask.frames(0, 2)] == [(HEIGHT // 2, WIDTH // 2, 3)] * 2


@pytest.mark.parametrize("sized", [True, False], ids=["with W_ and H_", "without"])
def test_backgrounds_and_masks_are_undistorted(tmp_path, sized):
    """They pass the same lens as the frames, also where they are smaller."""
    folder = write_easymocap(tmp_path / "actor", BARREL)
    lens = Lens(make_rig(NUMBERS)[0].K, "opencv", BARREL, WIDTH, HEIGHT)
    write_extras(folder, lens)
    if not sized:
        dist = {f"dist_{name}": np.array([BARREL]) for name in NUMBERS}
        rewrite(folder, dist, drop=tuple(f"{key}_{name}" for key in "HW" for name in NUMBERS))
    read = open_capture(folder)
    background, mask = read.background("01"), read.extras_of("01").mask
    assert background is not None
    assert mask is not None
    truth = straight(lens, read.cameras[1].K)
    assert psnr(background, truth) > 42
    half = cv2.resize(truth, (WIDTH // 2, HEIGHT // 2), interpolation=cv2.INTER_AREA)
    assert psnr(next(mask.frames(0, 1)), half) > 33


def test_depth_range(actor_folder):
    """Hulls give near, background points far, extri.yml both; without anything the rig does."""
    alone = open_capture(actor_folder).cameras[1]
    write_extras(actor_folder)
    corners = np.array(
        [[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (4.0, 5.0, 6.0)]
    )
    depths = make_rig(NUMBERS)[1].project(corners)[1]
    with_hulls = open_capture(actor_folder).cameras[1]
    assert with_hulls.near == pytest.approx(0.9 * depths.min())
    assert with_hulls.far == pytest.approx(max(alone.far, 1.1 * depths.max()))
    points = "".join(f"0 0 {z}\n" for z in np.linspace(3, 20, 200))
    header = (
        "ply\nformat ascii 1.0\nelement vertex 200\nproperty float x\nproperty float "
        "y\nproperty float z\nend_header\n"
    )
    (actor_folder / "background.ply").write_text(header + points)
    with_points = open_capture(actor_folder).cameras[1]
    assert with_points.near == with_hulls.near
    assert with_points.far == pytest.approx(1.1 * 20, rel=0.01)
    shutil.rmtree(actor_folder / "vhull")
    seen = make_rig(NUMBERS)[1].project(
        np.stack([0 * np.linspace(3, 20, 200)] * 2 + [np.linspace(3, 20, 200)], -1)
    )[1]
    assert open_capture(actor_folder).cameras[1].near == pytest.approx(0.9 * np.percentile(seen, 1))
    rewrite(
        actor_folder,
        extri={
            f"{key}_{name}": value for key, value in (("n", 3.5), ("f", 9.0)) for name in NUMBERS
        },
    )
    assert [(camera.near, camera.far) for camera in open_capture(actor_folder).cameras] == [
        (3.5, 9.0)
    ] * 3


def test_people_around_the_camera(actor_folder):
    """Hulls that reach behind a camera cannot tell its nearest depth and do not spoil its range."""
    write_extras(actor_folder)
    np.save(actor_folder / "vhull" / "000001.npy", np.array([[-5.0, -5.0, -5.0], [5.0, 5.0, 5.0]]))
    assert all(0 < camera.near < camera.far for camera in open_capture(actor_folder).cameras)


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (
            np.zeros((3, 2)),
            "wanted (2, 3) finite numbers, the least and greatest corner, got (3, 2) float64",
        ),
        (np.full((2, 3), np.nan), "wanted finite numbers, got NaN or infinity"),
        (np.array([["a", "b", "c"]] * 2), "got (2, 3) <U1"),
        (
            np.array([[None] * 3] * 2),
            "000001.npy: wanted (2, 3) finite numbers, the least and greatest corner, got: ",
        ),
    ],
)
def test_damaged_hulls(actor_folder, array, message):
    """Hulls of another shape, type or with NaN are refused; pickled objects are not unpacked."""
    write_extras(actor_folder)
    np.save(actor_folder / "vhull" / "000001.npy", array, allow_pickle=True)
    assert message in refusal(actor_folder)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda f: [shutil.rmtree(f / "images" / name) for name in ("01", "02")],
            "got none for 01, 02, only for",
        ),
        (
            lambda f: (f / "images" / "01" / "000001.png").unlink(),
            "wanted one frame count for all cameras, got 00 2, 01 1, 02 2",
        ),
        (
            lambda f: (f / "images" / "01" / "000001.png").write_bytes(b"x"),
            "000001.png: wanted an image",
        ),
        (lambda f: (f / "extri.yml").unlink(), "not enerf-outdoor: no extri.yml"),
        (lambda f: shutil.rmtree(f / "images"), "not enerf-outdoor: no folders images/XX/"),
        (
            lambda f: write_extras(f) or (f / "bkgd" / "01.png").unlink(),
            "wanted a background of every camera, none of 01",
        ),
        (
            lambda f: write_extras(f) or (f / "mask" / "02" / "000000.png").unlink(),
            "one mask of 02 per frame, got 1 for 2",
        ),
    ],
)
def test_files_that_do_not_fit(actor_folder, change, message):
    """Missing folders, frames, backgrounds and masks are told by name."""
    change(actor_folder)
    assert message in refusal(actor_folder)


@pytest.mark.parametrize(
    ("intri", "extri", "drop", "message"),
    [
        ({}, {}, ("K_01",), "intri.yml: wanted an entry K_01, got none"),
        ({}, {}, ("T_02",), "extri.yml: wanted an entry T_02, got none"),
        ({}, {}, ("R_02", "Rot_02"), "extri.yml: wanted an entry Rot_02, got none"),
        (
            {},
            {},
            ("R_02", "Rot_02", "T_02", "R_01", "Rot_01", "T_01"),
            "got 00 (01, 02 left out: not placed in extri.yml)",
        ),
        ({"K_01": np.eye(2)}, {}, (), "intri.yml: wanted 3 x 3 numbers in K_01, got 2 x 2"),
        ({"K_01": np.full((3, 3), np.nan)}, {}, (), "intri.yml: wanted finite numbers in K_01"),
        (
            {"K_01": np.eye(3).T * 5},
            {},
            (),
            "intri.yml: 01: lens: K must be fx 0 cx / 0 fy cy / 0 0 1",
        ),
        (
            {"K_01": "text"},
            {},
            (),
            "wanted !!opencv-matrix with rows, cols, dt and data in K_01, got",
        ),
        (
            {"dist_01": np.zeros((1, 3))},
            {},
            (),
            "intri.yml: 01: lens: the opencv model wants 4 or 5",
        ),
        ({"W_01": -4}, {}, (), "wanted a positive number W_01, got -4"),
        (
            {},
            {"R_01": np.array([[np.inf], [0], [0]])},
            (),
            "extri.yml: wanted finite numbers in R_01",
        ),
        ({}, {"R_01": np.zeros((4, 1))}, (), "extri.yml: wanted 3 x 1 numbers in R_01, got 4 x 1"),
        (
            {},
            {"Rot_01": 2 * np.eye(3)},
            ("R_01",),
            "extri.yml: camera 01: the rotation must be orthonormal",
        ),
        (
            {},
            {"n_01": 5.0, "f_01": 4.0},
            (),
            "extri.yml: camera 01: depth range must satisfy 0 < near < far",
        ),
    ],
)
def test_damaged_entries(actor_folder, intri, extri, drop, message):
    """Entries that are missing, misshapen, not finite or no camera are told with file and key."""
    assert message in refusal(rewrite(actor_folder, intri, extri, drop))


@pytest.mark.parametrize(
    ("pattern", "replacement", "message"),
    [
        ("%YAML.*", "%JSON", "wanted OpenCV YAML, which begins with %YAML:1.0, got '%JSON'"),
        (
            "names:(.|\n)*?K_00",
            "K_00",
            "wanted names: a sequence of different camera names, got none",
        ),
        ('- "01"', '- "00"', "wanted names: a sequence of different camera names, got 00, 00, 02"),
        ("rows: 3", "rows: 2000000000", "wanted rows and cols of K_00, got 2000000000 x 3"),
        ("rows: 3", "rows: -3", "wanted rows and cols of K_00, got -3 x 3"),
        ("rows: 3", "rows: 4", "wanted 4 x 3 numbers in K_00, got 9"),
        ("dt: d", "dt: q", "wanted one number per element in K_00, such as dt: d, got dt: q"),
        (
            "data: .*",
            "data: !!binary |",
            "wanted !!opencv-matrix with rows, cols, dt and data in K_00",
        ),
        (
            "!!opencv-matrix",
            "!!python/object/apply:os.system",
            "wanted !!opencv-matrix with rows, cols, dt and data in K_00",
        ),
        ("K_01", "K_00", "wanted every key once, got K_00 twice"),
        (
            "K_01",
            "&anchor K_01",
            "wanted lines of the form 'key: value', got '&anchor K_01: !!opencv-matrix'",
        ),
        ("H_00: .*", "H_00: " + "[" * 300000, "wanted a positive number H_00, got [[["),
        ("H_00: .*", "H_00: 1e999", "wanted a positive number H_00, got 1e999"),
    ],
)
def test_hostile_yaml(actor_folder, pattern, replacement, message):
    """Tags, anchors, nesting and sizes beyond all measure are refused in one line; nothing of them
    is followed.
    """
    file = actor_folder / "intri.yml"
    text, count = re.subn(pattern, lambda _: replacement, file.read_text(), count=1)
    assert count == 1
    file.write_text(text)
    assert message in refusal(actor_folder)


@pytest.mark.parametrize(
    "content", [b"", b"\xff\xfe\x00", b"\x00" * 100, b"a: 1\n", b"x" * 5_000_000], ids=len
)
def test_files_that_are_no_yaml(actor_folder, content):
    """Empty, binary, foreign and huge files are refused, naming the file."""
    (actor_folder / "extri.yml").write_bytes(content)
    assert "extri.yml: wanted " in refusal(actor_folder)


def test_more_lenses_than_placed_cameras(tmp_path):
    """A camera without a pose, one without frames, and frames of no camera are left out and noted;
    the others stay.
    """
    names = ("00", "01", "02", "03", "04")
    folder = write_easymocap(tmp_path / "scene")
    shutil.copytree(folder / "images" / "00", folder / "images" / "09")
    intri, extri = storage_entries(names)
    write_storage(folder / "intri.yml", intri, names)
    write_storage(
        folder / "extri.yml",
        {key: value for key, value in extri.items() if not key.endswith("_04")},
        names[:-1],
    )
    read = open_capture(folder)
    assert read.camera_names == NUMBERS
    np.testing.assert_allclose(
        read.cameras[2].world_to_camera, make_rig(names)[2].world_to_camera, atol=1e-9
    )
    assert [note.partition(" left out")[0] for note in read.notes if "left out" in note] == [
        "03",
        "04",
        "09",
    ]


def test_videos_in_place_of_folders(tmp_path):
    """EasyMocap begins with videos/XX.mp4; nobody has to cut them into pictures."""
    folder = write_easymocap(tmp_path / "scene")
    for index, name in enumerate(NUMBERS):
        write_video(
            folder / "videos" / f"{name}.mp4",
            (make_image(index, frame) for frame in range(N_INSTANTS)),
            25.0,
        )
    shutil.rmtree(folder / "images")
    read = open_capture(folder)
    assert (read.layout, read.camera_names, read.n_frames, read.fps) == (
        "enerf-outdoor",
        NUMBERS,
        N_INSTANTS,
        25.0,
    )
    assert np.abs(read.frame("02", 1).astype(int) - make_image(2, 1)).max() < 12
