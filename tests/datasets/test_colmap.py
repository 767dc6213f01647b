"""COLMAP captures: a sparse model with one image, image folder or video per camera."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.datasets import open_capture
from ggvs_eval.files.images import write_image
from helpers.captures import (
    FPS,
    HEIGHT,
    N_FRAMES,
    NAMES,
    WIDTH,
    make_binary,
    make_image,
    make_rig,
    mean_colours,
    refusal,
    write_colmap,
    write_colmap_model,
    write_folders,
    write_videos,
)
from helpers.lens_pictures import psnr, straight, through_lens


@pytest.fixture(scope="module")
def colmap_rig(tmp_path_factory):
    return write_colmap(tmp_path_factory.mktemp("captures") / "rig")


@pytest.fixture
def colmap(colmap_rig, tmp_path) -> Path:
    """An intact capture to read or to damage."""
    return Path(shutil.copytree(colmap_rig, tmp_path / "rig"))


@pytest.mark.parametrize(
    ("place", "binary"), [("sparse/0", False), ("sparse", True), ("colmap/sparse/0", True)]
)
def test_opens_as_calibrated(tmp_path, place, binary):
    """Text and binary models at each usual place give the cameras that were written, in the order
    of names.
    """
    write_colmap(tmp_path / "rig")
    model = shutil.move(tmp_path / "rig" / "sparse" / "0", tmp_path / "model")
    shutil.rmtree(tmp_path / "rig" / "sparse")
    model = Path(shutil.copytree(model, tmp_path / "rig" / place))
    if binary:
        make_binary(model)
    capture = open_capture(tmp_path / "rig")
    assert (capture.layout, capture.camera_names, capture.n_frames, capture.fps) == (
        "colmap",
        NAMES,
        1,
        0.0,
    )
    for index, (camera, truth) in enumerate(zip(capture.cameras, make_rig(), strict=True)):
        np.testing.assert_allclose(camera.world_to_camera, truth.world_to_camera, atol=1e-9)
        np.testing.assert_allclose(camera.K, truth.K)
        assert np.array_equal(capture.frame(camera.name, 0), make_image(index, 0))


def test_depth_range_and_units_follow_the_points(colmap):
    """Near and far are 0.8 and 1.2 times the 1st and 99th percentile of the points' depth, 2 metres
    their median.
    """
    capture = open_capture(colmap)
    points_world = np.random.default_rng(0).uniform((-0.5, -0.5, 3.0), (1.0, 0.5, 6.0), (60, 3))
    depths = [camera.project(points_world)[1] for camera in make_rig()]
    for camera, depth in zip(capture.cameras, depths, strict=True):
        assert (camera.near, camera.far) == pytest.approx(
            (0.8 * np.percentile(depth, 1), 1.2 * np.percentile(depth, 99))
        )
    assert capture.units_per_metre == pytest.approx(
        np.median([np.median(depth) for depth in depths]) / 2
    )
    assert capture.units_origin == "guess: median scene depth taken for 2 m"


@pytest.mark.parametrize("pattern", ["{}/images", "images/{}", "{}/images_scaled_2", "{}"])
def test_image_folders(tmp_path, pattern):
    """One folder of frames per camera opens under the names of the model; images_scaled_2 is as
    QUEEN keeps Google Immersive.
    """
    write_colmap_model(tmp_path / "sparse", [f"{name}.png" for name in NAMES])
    write_folders(tmp_path, NAMES, pattern)
    capture = open_capture(tmp_path)
    assert (capture.camera_names, capture.n_frames) == (NAMES, N_FRAMES)
    assert np.array_equal(capture.frame("cam02", 3), make_image(2, 3))


@pytest.mark.parametrize("place", ["", "videos"])
def test_videos(tmp_path, place):
    """One video per camera opens, also where the model's images are named after a folder per
    camera.
    """
    write_colmap_model(tmp_path / "sparse", [f"{name}/0000.png" for name in NAMES])
    write_videos(tmp_path / place)
    capture = open_capture(tmp_path)
    assert (capture.camera_names, capture.n_frames, capture.fps) == (NAMES, N_FRAMES, FPS)
    assert mean_colours(capture, "cam03")[4] == (4, 3)


def test_simple_pinhole(colmap):
    """A camera with a single focal length is a pinhole camera too."""
    write_colmap_model(colmap / "sparse" / "0", [f"{name}.png" for name in NAMES], "SIMPLE_PINHOLE")
    np.testing.assert_allclose(open_capture(colmap).cameras[0].K, make_rig()[0].K)


def test_scaled_images(colmap):
    """Images of half the calibrated size scale the intrinsics."""
    for index, name in enumerate(NAMES):
        write_image(
            colmap / "images" / f"{name}.png", make_image(index, 0, WIDTH // 2, HEIGHT // 2)
        )
    assert open_capture(colmap).cameras[1].K[0, 0] == pytest.approx(make_rig()[1].K[0, 0] / 2)


def test_cropped_images(colmap):
    """Images of another shape than the calibrated one are refused."""
    write_image(colmap / "images" / "cam01.png", make_image(1, 0, WIDTH, HEIGHT - 4))
    assert "cam01.png: frames of 64 x 44 have another shape than the 64 x 48" in refusal(colmap)


# Parameters after the size, in COLMAP's order, and where pycolmap 3.12 sees the RAYS with them.
DISTORTED = {
    "SIMPLE_RADIAL": ("57 32 24 -0.1", [[4.469, 40.5186], [54.344, 12.828]]),
    "RADIAL": ("57 31 25 -0.15 0.03", [[3.854662, 41.2872028], [53.14336, 13.92832]]),
    "OPENCV": ("57 58 31 25 -0.15 0.03 0.01 -0.02", [[2.726062, 42.2225432], [52.45936, 14.08208]]),
    "FULL_OPENCV": (
        "57 58 31 25 -0.15 0.03 0.01 -0.02 0.01 0.02 0.01 -0.003",
        [[2.9260603, 42.100439], [52.3646989, 14.1302409]],
    ),
    "SIMPLE_RADIAL_FISHEYE": ("57 32 24 -0.05", [[6.557459, 39.2655246], [53.2502479, 13.3748761]]),
    "RADIAL_FISHEYE": ("57 31 25 -0.05 0.01", [[5.5374212, 40.2775473], [52.2569533, 14.3715233]]),
    "OPENCV_FISHEYE": (
        "57 58 31 25 -0.05 0.01 0.003 -0.001",
        [[5.5359016, 40.5465022], [52.2572881, 14.1848885]],
    ),
}
RAYS = np.array([[-0.5, 0.3], [0.4, -0.2]])


def rewrite_cameras(folder: Path, model: str, params: str) -> None:
    """All images of one camera of this model."""
    (folder / "sparse" / "0" / "cameras.txt").write_text(f"1 {model} {WIDTH} {HEIGHT} {params}\n")


@pytest.mark.parametrize("model", DISTORTED)
def test_distorted_models(colmap, model):
    """Every model that OpenCV can express bends rays as pycolmap does, and frames come back as the
    pinhole images.
    """
    params, by_pycolmap = DISTORTED[model]
    rewrite_cameras(colmap, model, params)
    capture = open_capture(colmap)
    lens, pinhole = capture.sources[2].lens, capture.cameras[2].K
    np.testing.assert_allclose(
        lens.distort(RAYS * pinhole[[0, 1], [0, 1]] + pinhole[:2, 2], pinhole),
        by_pycolmap,
        atol=1e-6,
    )
    write_image(colmap / "images" / "cam02.png", through_lens(lens))
    assert psnr(open_capture(colmap).frame("cam02", 0), straight(lens, pinhole)) > 40


@pytest.mark.parametrize(
    ("model", "params"),
    [("FOV", "57 58 32 24 0.2"), ("THIN_PRISM_FISHEYE", "57 58 32 24 0.1 0 0 0 0 0 0.01 0.01")],
)
def test_models_without_an_equivalent(colmap, model, params):
    """Models that OpenCV cannot express are refused with the command that undistorts."""
    rewrite_cameras(colmap, model, params)
    message = refusal(colmap)
    assert f"got {model}; undistort images and model by 'colmap image_undistorter' first" in message
    assert "cam00.png: wanted one of SIMPLE_PINHOLE, PINHOLE," in message


@pytest.mark.parametrize(
    ("params", "message"),
    [
        ("57 58 32 24 nan 0 0 0", "wanted 8 finite parameters of OPENCV"),
        ("-57 58 32 24 0 0 0 0", "K must be fx 0 cx / 0 fy cy / 0 0 1"),
        ("57 58 32 24 500 0 0 0", "leave blank pixels even at 4 times"),
        ("57 58 32 24 0 0 0", "wanted 8 finite parameters of OPENCV"),
    ],
)
def test_damaged_parameters(colmap, params, message):
    """Parameters that make no lens are refused in one line."""
    rewrite_cameras(colmap, "OPENCV", params)
    assert message in refusal(colmap)


@pytest.mark.parametrize("arrangement", ["single", "images/{}", "{}/images", "{}", "videos"])
def test_frames_that_the_model_does_not_register(tmp_path, arrangement):
    """What lies beside the frames of the registered cameras is left out and noted."""
    write_colmap_model(tmp_path / "sparse", [f"{name}.png" for name in NAMES[:3]])
    if arrangement == "single":
        for index, name in enumerate(NAMES):
            write_image(tmp_path / "images" / f"{name}.png", make_image(index, 0))
    elif arrangement == "videos":
        write_videos(tmp_path / "videos")
    else:
        write_folders(tmp_path, NAMES, arrangement)
    capture = open_capture(tmp_path)
    assert capture.camera_names == NAMES[:3]
    assert capture.notes == ("cam03 omitted: on disk, but not registered in the COLMAP model",)


def test_nothing_is_noted_where_all_is_registered(colmap):
    """Other folders beside the frames are no cameras; they are listed, once and without texts for
    people.
    """
    assert open_capture(colmap).notes == ()
    shutil.copytree(colmap / "images", colmap / "masks")
    for name in ("points.xyz", "README.md", "LICENSE"):
        (colmap / name).write_text("?")
    assert open_capture(colmap).notes == ("not used: masks/, points.xyz",)


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize(
    "name",
    ["../secret.png", "..", "../secret/0.png", "cam/../../secret.png", "/ABSOLUTE", "x" * 5000],
)
def test_names_do_not_lead_out_of_the_capture(tmp_path, name, binary):
    """A hostile model finds no image, folder or video outside the capture; what no file system
    takes is not there.
    """
    write_image(tmp_path / "secret.png", make_image(0, 0))
    write_image(tmp_path / "secret" / "0.png", make_image(0, 0))
    name = name.replace("/ABSOLUTE", str(tmp_path / "secret.png"))
    write_colmap_model(tmp_path / "rig" / "sparse", [name])
    (tmp_path / "rig" / "images").mkdir()
    if binary:
        make_binary(tmp_path / "rig" / "sparse")
    assert "got none; put them in CAM.mp4" in refusal(tmp_path / "rig")


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin", "points3D.bin"])
def test_counts_beyond_all_measure(colmap, name):
    """A file that claims 2^60 entries is refused without counting them."""
    model = colmap / "sparse" / "0"
    make_binary(model)
    content = (model / name).read_bytes()
    (model / name).write_bytes((1 << 60).to_bytes(8, "little") + content[8:])
    assert "damaged COLMAP model" in refusal(colmap)


def test_image_missing_on_disk(colmap):
    """Cameras of the model without frames are listed."""
    (colmap / "images" / "cam01.png").unlink()
    (colmap / "images" / "cam03.png").unlink()
    assert "got none for cam01, cam03, only for" in refusal(colmap)


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin", "points3D.bin"])
@pytest.mark.parametrize("lost", [1, 60])
def test_truncated_binary_model(colmap, name, lost):
    """A binary model that lost any number of bytes is refused, also where pycolmap reads on and
    invents the rest.
    """
    model = colmap / "sparse" / "0"
    make_binary(model)
    content = (model / name).read_bytes()
    (model / name).write_bytes(content[:-lost])
    assert "damaged COLMAP model" in refusal(colmap)


def test_incomplete_model(colmap):
    """A model that lacks poses is refused, naming the file; points are for depth ranges alone."""
    (colmap / "sparse" / "0" / "images.txt").unlink()
    assert "no images.txt" in refusal(colmap)


@pytest.mark.parametrize(
    ("name", "text"), [("cameras.txt", "1 PINHOLE 64"), ("images.txt", "no model at all\n")]
)
def test_garbled_text_model(colmap, name, text):
    """A text model that cannot be parsed is refused in one line."""
    (colmap / "sparse" / "0" / name).write_text(text)
    assert "damaged COLMAP model" in refusal(colmap)


def test_several_images_of_one_camera(colmap):
    """A model made of several instants has several poses per camera and is refused."""
    write_colmap_model(
        colmap / "sparse" / "0", ["cam00/0.png", "cam00/1.png", "cam01/0.png", "cam01/1.png"]
    )
    assert "got several images of cam00, cam01; calibrate with one instant" in refusal(colmap)


def test_binary_and_text_that_differ(colmap):
    """The binary model is read; that the text files beside it say something else is noted, and
    nothing where they agree.
    """
    texts = shutil.copytree(colmap / "sparse" / "0", colmap.with_name("texts"))
    make_binary(colmap / "sparse" / "0")
    shutil.copytree(texts, colmap / "sparse" / "0", dirs_exist_ok=True)
    whole = open_capture(colmap)
    assert whole.notes == ()
    file = colmap / "sparse" / "0" / "images.txt"
    words = file.read_text().split(" ")
    file.write_text(" ".join([*words[:5], "0.3", *words[6:]]))
    capture = open_capture(colmap)
    assert np.array_equal(capture.cameras[0].K, whole.cameras[0].K)
    assert any(
        "sparse/0: cameras.bin is read; cameras.txt beside it" in note and "cam00" in note
        for note in capture.notes
    )


def test_rows_of_images_without_rows_of_points(colmap):
    """All cameras with their poses, and no camera is called unregistered."""
    whole = open_capture(colmap)
    file = colmap / "sparse" / "0" / "images.txt"
    file.write_text("".join(f"{row}\n" for row in file.read_text().splitlines()[::2]))
    capture = open_capture(colmap)
    assert capture.camera_names == whole.camera_names
    assert all(
        np.array_equal(a.world_to_camera, b.world_to_camera)
        for a, b in zip(capture.cameras, whole.cameras, strict=True)
    )
    assert not any("not registered" in note for note in capture.notes)


def test_of_several_models_that_of_most_images_is_taken(colmap):
    """The mapper leaves the others in folders of their own; they are noted."""
    shutil.move(colmap / "sparse" / "0", colmap / "sparse" / "1")
    write_colmap_model(colmap / "sparse" / "0", ["cam00.png", "cam01.png"])
    capture = open_capture(colmap)
    assert capture.camera_names == NAMES
    assert (
        "sparse/1 is taken, the model of most images (4); not read: sparse/0 (2)" in capture.notes
    )


def test_a_model_in_the_folder_itself(colmap):
    """Its files beside images/."""
    whole = open_capture(colmap)
    for file in (colmap / "sparse" / "0").iterdir():
        shutil.move(file, colmap / file.name)
    shutil.rmtree(colmap / "sparse")
    assert [camera.K.tolist() for camera in open_capture(colmap).cameras] == [
        camera.K.tolist() for camera in whole.cameras
    ]


def test_smaller_pictures_alone(colmap):
    """images_4/ without images/: K is that of these."""
    for index, name in enumerate(NAMES):
        write_image(colmap / "images_4" / f"{name}.png", make_image(index, 0, 16, 12))
    K = open_capture(colmap).cameras[0].K
    shutil.rmtree(colmap / "images")
    small = open_capture(colmap).cameras[0]
    assert small.size == (16, 12)
    assert small.K[:2] == pytest.approx(K[:2] / 4)


def test_quaternions_of_another_length_are_brought_to_one(colmap):
    """The rotation is the same, and the note says so."""
    whole = open_capture(colmap)
    file = colmap / "sparse" / "0" / "images.txt"
    rows = file.read_text().splitlines()
    for at in range(0, len(rows), 2):
        words = rows[at].split()
        rows[at] = " ".join(
            [words[0], *(f"{1.1 * float(word):.17g}" for word in words[1:5]), *words[5:]]
        )
    file.write_text("\n".join(rows) + "\n")
    capture = open_capture(colmap)
    for camera, true in zip(capture.cameras, whole.cameras, strict=True):
        assert camera.world_to_camera == pytest.approx(true.world_to_camera, abs=1e-12)
    assert any("have the length 1.1: brought to 1" in note for note in capture.notes)
