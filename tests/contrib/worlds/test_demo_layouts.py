"""The demo in the layout of every data set: files as they are distributed, read back by plain
readers and by the adapters.
"""

import json
import shutil
from dataclasses import replace
from functools import cache

import cv2
import h5py
import numpy as np
import pytest

from ggvs_eval.camera import Camera
from ggvs_eval.contrib.worlds.demo import write_demo
from ggvs_eval.contrib.worlds.film.film import Footage, lit_room, read_exact_depth
from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.contrib.worlds.film.raycast import (
    UNITS_PER_METRE,
    WORLD_TO_ROOM,
    PixelGrid,
    in_metres,
    render_depth,
)
from ggvs_eval.contrib.worlds.film.shots import (
    FISHEYE_LENS,
    LENS,
    distorted_shots,
    hand_held_shots,
    rig_shots,
)
from ggvs_eval.contrib.worlds.layouts.layouts import LAYOUTS
from ggvs_eval.datasets import open_capture
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.images import quantise, read_image
from ggvs_eval.files.video import VideoFrames
from ggvs_eval.lens import Lens
from ggvs_eval.synthetic.d3dmv_scene import MEDIAN_FRAMES, median_background

TINY = DemoOptions(width=64, height=48, n_frames=3, cameras_per_row=2, path_poses=2)
# One instant; rgbd has two poses of it.
QUICK = replace(
    TINY, width=32, height=24, n_frames=1, supersampling=1, path_poses=1, noise_sigma_255=0.0
)
WRONG = {"calibration_error_px": 2.0, "focal_error": (("cam00", 1.05),)}
METRIC = ("enerf-outdoor", "rgbd", "immersive", "panoptic")
# Mean absolute difference, of 255 levels, between a frame of 64 x 48 as rendered and as the codec
# gives it back.
JPEG_LOSS, VIDEO_LOSS = 2.5, 5.0


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    root = tmp_path_factory.mktemp("demo")
    return lambda layout: write_demo(root / layout, tiny_options(layout), workers=1)


def tiny_options(layout):
    return replace(TINY, layout=layout, height=34 if layout == "technicolor" else TINY.height)


def quick_options(layout):
    shape = {"width": 64, "height": 34} if layout == "technicolor" else {}
    return replace(QUICK, layout=layout, n_frames=2 if layout == "rgbd" else 1, **WRONG, **shape)


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    """A demo of one instant with a wrong calibration in a layout, written once."""
    root = tmp_path_factory.mktemp("quick")
    return lambda layout: write_demo(root / layout, quick_options(layout), workers=1)


@cache
def recall(index):
    """The lit room at a frame of `TINY`."""
    return lit_room(TINY.seed).at(index / TINY.fps)


@cache
def rendered(layout):
    options = tiny_options(layout)
    return [list(Footage(options, shot, recall).frames()) for shot in shots_of(options)]


def shots_of(options):
    return [shot for shot in LAYOUTS[options.layout].shots(options) if shot.sensor is not None]


def noted_cameras(options):
    """The cameras that a demo writes down, in its units."""
    noted = [shot.noted for shot in shots_of(options)]
    return [in_metres(camera) for camera in noted] if options.layout in METRIC else noted


def mean_difference(image, other):
    return np.abs(image.astype(float) - other).mean()


def assert_same_cameras(cameras, others):
    for camera, other in zip(cameras, others, strict=True):
        assert camera.size == other.size
        np.testing.assert_allclose(camera.K, other.K, atol=1e-6)
        np.testing.assert_allclose(camera.world_to_camera, other.world_to_camera, atol=1e-6)


def contents(folder):
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    ("layout", "loss"),
    [
        ("dynerf", VIDEO_LOSS),
        pytest.param("meetroom", VIDEO_LOSS, marks=pytest.mark.proof),
        ("rgbd", JPEG_LOSS),
        pytest.param("panoptic", JPEG_LOSS, marks=pytest.mark.proof),
        ("d3dmv", 0),
        pytest.param("technicolor", 0, marks=pytest.mark.proof),
        pytest.param("colmap", VIDEO_LOSS, marks=pytest.mark.proof),
    ],
)
def test_reading_back_gives_the_same_images(demo, layout, loss):
    """Frame t of camera i is what was rendered, within the loss of the codec: none in HDF5
    and PNG.
    """
    capture = open_capture(demo(layout))
    for name, frames in zip(capture.camera_names, rendered(layout), strict=True):
        for image, frame in zip(capture.frames(name), frames, strict=True):
            assert mean_difference(image, frame.image) <= loss


@pytest.mark.slow
@pytest.mark.parametrize("layout", LAYOUTS)
def test_reading_back_gives_the_wrong_calibration_that_was_asked_for(quick, layout):
    """`open_capture` detects the layout and its unit, and a planted error of focal length and
    rotation is in what it reads.
    """
    wrong, true = quick_options(layout), shots_of(quick_options(layout))[0].camera
    capture = open_capture(quick(layout))
    cameras = capture.cameras

    assert capture.layout == layout
    assert capture.units_per_metre == (1.0 if layout in METRIC else UNITS_PER_METRE)
    assert_same_cameras(cameras, noted_cameras(wrong))
    assert cameras[0].focal_px == pytest.approx(1.05 * true.focal_px)
    assert np.abs(cameras[0].rotation - true.rotation).max() > 1e-3


@pytest.mark.proof
@pytest.mark.parametrize("layout", LAYOUTS)
def test_same_options_give_same_bytes_in_every_layout(quick, tmp_path, layout):
    """Written twice, all files are the same, and none is left that only the writing needed."""
    again = write_demo(tmp_path / "again", quick_options(layout), workers=1)

    assert contents(again) == contents(quick(layout))
    assert not (again / "parts").exists()
    assert json.loads((again / "demo.json").read_text())["options"]["layout"] == layout


@pytest.mark.slow
@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_demo_that_lost_a_file_is_not_taken_for_whole(quick, tmp_path, layout):
    """Whatever file of the layout is deleted, the error names it."""
    damaged = shutil.copytree(quick(layout), tmp_path / "damaged")
    lost = LAYOUTS[layout].files(quick_options(layout))[-1]
    (damaged / lost).unlink()

    with pytest.raises(CaptureError, match=f"lost {lost}"):
        write_demo(damaged, quick_options(layout), workers=1)


def read_yaml(path, names):
    """Node of an OpenCV file by name."""
    storage = cv2.FileStorage(str(path), cv2.FileStorage_READ)
    node = storage.getNode("names")
    assert [node.at(index).string() for index in range(node.size())] == names
    return storage.getNode


@pytest.mark.slow
def test_easymocap_files_hold_the_rig_in_metres(demo):
    """OpenCV reads of every camera K (the first pixel is at 0), distortion, size, rotation in both
    forms, and metres.
    """
    names = ["00", "01", "02", "03"]
    intrinsics, extrinsics = (
        read_yaml(demo("enerf-outdoor") / file, names) for file in ("intri.yml", "extri.yml")
    )
    for name, shot in zip(names, distorted_shots(TINY), strict=True):
        focal = shot.camera.focal_px
        np.testing.assert_array_equal(
            intrinsics(f"K_{name}").mat(), [[focal, 0, 31.5], [0, focal, 23.5], [0, 0, 1]]
        )
        np.testing.assert_array_equal(
            intrinsics(f"dist_{name}").mat(), np.array(shot.lens)[:, None]
        )
        assert (intrinsics(f"H_{name}").real(), intrinsics(f"W_{name}").real()) == (48, 64)
        np.testing.assert_allclose(
            cv2.Rodrigues(extrinsics(f"R_{name}").mat())[0], shot.camera.rotation, atol=1e-12
        )
        np.testing.assert_array_equal(extrinsics(f"Rot_{name}").mat(), shot.camera.rotation)
        np.testing.assert_allclose(
            extrinsics(f"T_{name}").mat(),
            shot.camera.translation[:, None] / UNITS_PER_METRE,
            atol=1e-12,
        )


@pytest.mark.slow
def test_easymocap_images_read_back_undistorted(demo):
    """The adapter's images are nearer to those of a pinhole than the images on disk are, at every
    camera and frame.
    """
    capture = open_capture(demo("enerf-outdoor"))
    for number, (name, frames) in enumerate(
        zip(capture.camera_names, rendered("d3dmv"), strict=True)
    ):
        for index, (image, frame) in enumerate(zip(capture.frames(name), frames, strict=True)):
            on_disk = read_image(
                demo("enerf-outdoor") / "images" / f"{number:02d}" / f"{index:06d}.jpg"
            )
            assert mean_difference(image, frame.image) < 0.5 * mean_difference(on_disk, frame.image)


@pytest.mark.slow
def test_fisheye_videos_read_back_undistorted(demo):
    """The adapter's images are nearer to those of a pinhole than the fisheye's on disk are, at
    every camera and frame.
    """
    capture = open_capture(demo("immersive"))
    for name, frames in zip(capture.camera_names, rendered("d3dmv"), strict=True):
        on_disk = VideoFrames(demo("immersive") / f"{name}.mp4").frames(0, TINY.n_frames)
        for image, fisheye, frame in zip(capture.frames(name), on_disk, frames, strict=True):
            assert mean_difference(image, frame.image) < 0.5 * mean_difference(fisheye, frame.image)


@pytest.fixture(scope="module")
def lens_camera():
    return rig_shots(replace(TINY, width=320, height=240))[0].camera


@pytest.mark.parametrize(("model", "coefficients"), [("opencv", LENS), ("fisheye", FISHEYE_LENS)])
def test_rays_of_the_lens_are_exact(lens_camera, model, coefficients):
    """Points on the rays of the distorted pixels are imaged by OpenCV's model at the centres of
    these pixels.
    """
    rays = (
        PixelGrid(lens_camera, coefficients).rays.astype(np.float64)
        @ WORLD_TO_ROOM[:3, :3]
        * UNITS_PER_METRE**2
    )
    uv, depth = lens_camera.project(lens_camera.centre + rays)
    lens = Lens(lens_camera.K, model, coefficients, *lens_camera.size)

    np.testing.assert_allclose(depth, 1.0, atol=1e-6)
    np.testing.assert_allclose(
        lens.distort(uv, lens_camera.K), lens_camera.pixel_centres().reshape(-1, 2), atol=1e-3
    )


@pytest.mark.slow
def test_masks_and_hulls_hold_what_moves(demo):
    """Frames differ from the background in the mask and hardly elsewhere; what moves lies in the
    frame's bounds, metres.
    """
    folder = demo("enerf-outdoor")
    image, background = (
        read_image(folder / name).astype(int) for name in ("images/00/000001.jpg", "bkgd/00.jpg")
    )
    mask = cv2.imread(str(folder / "mask/00/000001.png"), cv2.IMREAD_UNCHANGED)
    assert mask.shape == (48, 64)
    assert set(np.unique(mask)) == {0, 255}
    changed = np.abs(image - background).mean(axis=-1)
    assert changed[mask == 255].mean() > 5 * changed[mask == 0].mean()

    camera, bounds = (
        in_metres(distorted_shots(TINY)[0].camera),
        np.load(folder / "vhull/000001.npy"),
    )
    depth = read_exact_depth(folder, "cam00", 1).astype(np.float64)
    empty = render_depth(lit_room(TINY.seed).empty(), rig_shots(TINY)[0].camera) / UNITS_PER_METRE
    moving = camera.unproject(camera.pixel_centres(), depth)[depth < empty - 1e-3]
    assert bounds.shape == (2, 3)
    assert len(moving) > 50
    assert (moving > bounds[0] - 1e-5).all()
    assert (moving < bounds[1] + 1e-5).all()


@pytest.mark.slow
def test_background_points_lie_on_the_empty_room(demo):
    """The first camera's points project to its pixel centres at the depth of the room without what
    moves, in metres.
    """
    content = (demo("enerf-outdoor") / "background.ply").read_bytes()
    head, body = content.split(b"end_header\n", 1)
    count = int(head.split(b"element vertex ")[1].split()[0])
    points = np.frombuffer(body, np.dtype([("xyz", "<f4", 3), ("rgb", "u1", 3)]))
    assert len(points) == count == 4 * 48 * 64

    camera = rig_shots(TINY)[0].camera
    uv, depth = in_metres(camera).project(points["xyz"][: 48 * 64].astype(np.float64))
    np.testing.assert_allclose(uv, camera.pixel_centres().reshape(-1, 2), atol=1e-3)
    empty = render_depth(lit_room(TINY.seed).empty(), camera) / UNITS_PER_METRE
    np.testing.assert_allclose(depth, empty.ravel(), rtol=1e-5)


@pytest.mark.slow
def test_d3dmv_file_is_as_distributed(demo):
    """Frames lossless in chunks of one image, the foreground with its alpha, the median background;
    poses of twice the size.
    """
    with h5py.File(demo("d3dmv") / "scene000.h5") as file:
        chunks = {"rgb": (1, 1, 48, 64, 3), "fg_rgb": (1, 1, 48, 64, 4), "bg_rgb": (1, 48, 64, 3)}
        assert {key: data.chunks for key, data in file.items()} == chunks
        assert all(
            data.dtype == np.uint8 and data.shuffle and data.compression == "lzf"
            for data in file.values()
        )
        for row, frames in enumerate(rendered("d3dmv")):
            np.testing.assert_array_equal(file["rgb"][row], [frame.image for frame in frames])
            foreground = file["fg_rgb"][row]
            np.testing.assert_array_equal(
                foreground[..., 3], [quantise(frame.foreground) for frame in frames]
            )
            np.testing.assert_array_equal(
                foreground[..., :3], file["rgb"][row] * (foreground[..., 3:] > 0)
            )
            np.testing.assert_array_equal(file["bg_rgb"][row], np.median(file["rgb"][row], axis=0))
    sizes = np.load(demo("d3dmv") / "scene000_pb.npy")[:, :15].reshape(-1, 3, 5)[..., 4]
    np.testing.assert_allclose(
        sizes, [(96, 128, 2 * shot.camera.focal_px) for shot in rig_shots(TINY)]
    )


def test_median_of_long_films_takes_few_frames():
    """Of 65 frames every third is taken, so that memory has a bound, and the odd one out does not
    show.
    """
    frames = np.full((65, 2, 2, 3), 7, np.uint8)
    frames[1::3] = 200
    frames[0] = 90

    assert len(frames[::3]) <= MEDIAN_FRAMES
    np.testing.assert_array_equal(median_background(frames), np.full((2, 2, 3), 7))


def read_model(folder):
    """Cameras with their sightings {point: uv}, and points with their tracks, of a COLMAP model in
    text.
    """
    lines = {
        name: (folder / f"{name}.txt").read_text().splitlines()
        for name in ("cameras", "images", "points3D")
    }
    cameras = []
    for line, pose, sights in zip(
        lines["cameras"], lines["images"][::2], lines["images"][1::2], strict=True
    ):
        _, model, width, height, *intrinsics = line.split()
        assert model == "PINHOLE"
        _, w, x, y, z, *translation, _, name = pose.split()
        numbers = np.array(sights.split(), float).reshape(-1, 3)
        cameras.append(
            (
                name,
                (int(width), int(height), *map(float, intrinsics)),
                (w, x, y, z),
                translation,
                numbers,
            )
        )
    points = {int(line.split()[0]): line.split()[1:] for line in lines["points3D"]}
    return cameras, points


def depth_at(instant, camera: Camera, uv):
    """Exact depth along the ray through any position of the image."""
    return float(render_depth(instant, camera.cropped(uv[0] - 0.5, uv[1] - 0.5, 1, 1))[0, 0])


@pytest.mark.proof
def test_colmap_points_are_seen_where_the_model_says(demo):
    """Hundreds of points, each in at least two tracks; sightings are exact, and what is not sighted
    is hidden.
    """
    cameras, points = read_model(demo("colmap") / "sparse" / "0")
    place = {number: np.array(values[:3], float) for number, values in points.items()}
    assert 300 < len(points) <= 600
    assert all(len(values) >= 7 + 2 * 2 for values in points.values())
    instant = recall(0)
    for image, (shot, (name, _, _, _, sights)) in enumerate(
        zip(rig_shots(TINY), cameras, strict=True), 1
    ):
        assert name == f"{shot.camera.name}.png"
        for row, (u, v, number) in enumerate(sights):
            uv, depth = shot.camera.project(place[int(number)])
            np.testing.assert_allclose(uv, (u, v), atol=1e-6)
            assert depth_at(instant, shot.camera, uv) == pytest.approx(float(depth), rel=1e-3)
            track = np.array(points[int(number)][7:], int).reshape(-1, 2).tolist()
            assert [image, row] in track
        for number in sorted(set(place) - set(sights[:, 2].astype(int)))[:40]:
            uv, depth = shot.camera.project(place[number])
            inside = depth > 0 and (uv >= 0).all() and (uv < shot.camera.size).all()
            assert not inside or depth_at(instant, shot.camera, uv) < depth


@pytest.mark.slow
def test_colmap_error_is_that_of_the_wrong_cameras(demo, quick):
    """The points' reprojection error is 0 with the true calibration and about the planted error of
    2 with a wrong one.
    """
    models = [read_model(write("colmap") / "sparse" / "0") for write in (demo, quick)]
    errors_px = [np.mean([float(values[6]) for values in points.values()]) for _, points in models]

    assert errors_px[0] < 1e-9
    assert 1.0 < errors_px[1] < 6.0


@pytest.mark.slow
def test_rgbd_files_are_as_exported(demo):
    """Unpadded names, camera-to-world metres, 16-bit millimetres at the depth camera's own pixel
    centres, 4 x 4 intrinsics.
    """
    folder = demo("rgbd")
    depth_K, colour_K = (
        np.loadtxt(folder / "intrinsic" / f"intrinsic_{kind}.txt")[:3, :3]
        for kind in ("depth", "color")
    )
    np.testing.assert_allclose(np.diag([2, 2, 1]) @ depth_K, colour_K)
    for kind in ("depth", "color"):
        np.testing.assert_array_equal(
            np.loadtxt(folder / "intrinsic" / f"extrinsic_{kind}.txt"), np.eye(4)
        )
    for index, (shot, frames) in enumerate(
        zip(hand_held_shots(replace(TINY, layout="rgbd")), rendered("rgbd"), strict=True)
    ):
        pose = np.loadtxt(folder / "pose" / f"{index}.txt")
        np.testing.assert_allclose(
            pose, np.linalg.inv(in_metres(shot.camera).world_to_camera), atol=1e-9
        )
        millimetres = cv2.imread(str(folder / "depth" / f"{index}.png"), cv2.IMREAD_UNCHANGED)
        assert (millimetres.dtype, millimetres.shape) == (np.uint16, (24, 32))
        sensor = replace(shot.camera, K=depth_K, width=32, height=24)
        exact = render_depth(recall(0), sensor) * 1000 / UNITS_PER_METRE
        assert np.abs(millimetres - exact).max() < 0.51
        image = read_image(folder / "color" / f"{index}.jpg")
        assert mean_difference(image, frames[0].image) < JPEG_LOSS
