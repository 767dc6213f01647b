"""D3DMV captures: one HDF5 file per scene with its poses, or folders of frames with backgrounds."""

import shutil
import tracemalloc
from pathlib import Path

import h5py
import numpy as np
import pytest

from ggvs_eval.datasets import d3dmv, open_capture
from ggvs_eval.datasets.h5_frames import H5File, H5Frames
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.images import write_image
from helpers.captures import make_image, refusal
from helpers.refusals import refused

N_CAMERAS, N_FRAMES, WIDTH, HEIGHT = 3, 4, 64, 36
NAMES = ("cam00", "cam01", "cam02")
# The size before compression: a field of view of 90 degrees, f = W / 2.
FULL_WIDTH, FULL_HEIGHT = 192, 108


def pose_rows(n_cameras: int = N_CAMERAS) -> np.ndarray:
    """Unturned cameras 0.3 apart: axes down, right, backwards, then centre, then height, width,
    focal length; near and far.
    """
    rows = []
    for index in range(n_cameras):
        down, right, backwards = (0, 1, 0), (1, 0, 0), (0, 0, -1)
        matrix = np.stack(
            [
                down,
                right,
                backwards,
                (0.3 * index, 0, 0),
                (FULL_HEIGHT, FULL_WIDTH, FULL_WIDTH / 2),
            ],
            axis=1,
        )
        rows.append([*matrix.ravel(), 1.5 + index, 40.0 + index])
    return np.array(rows, dtype=np.float64)


def make_frames() -> np.ndarray:
    """All frames, (cameras, frames, H, W, 3)."""
    return np.stack(
        [
            [make_image(camera, frame, WIDTH, HEIGHT) for frame in range(N_FRAMES)]
            for camera in range(N_CAMERAS)
        ]
    )


def make_alpha() -> np.ndarray:
    """A foreground that differs in every frame, (cameras, frames, H, W)."""
    return np.random.default_rng(0).integers(
        0, 256, (N_CAMERAS, N_FRAMES, HEIGHT, WIDTH), dtype=np.uint8
    )


def write_h5(file: Path) -> Path:
    """A scene as it is distributed: rgb, fg_rgb (RGBA) and bg_rgb, lzf with shuffle, one frame per
    chunk.
    """
    rgb = make_frames()
    file.parent.mkdir(parents=True, exist_ok=True)
    with h5py.File(file, "w") as h5:
        options = {"chunks": (1, 1, HEIGHT, WIDTH, 3), "compression": "lzf", "shuffle": True}
        h5.create_dataset("rgb", data=rgb, **options)
        rgba = np.concatenate([rgb, make_alpha()[..., None]], axis=-1)
        h5.create_dataset("fg_rgb", data=rgba, **options | {"chunks": (1, 1, HEIGHT, WIDTH, 4)})
        h5.create_dataset("bg_rgb", data=255 - rgb[:, 0])
    np.save(file.with_name(f"{file.stem}_pb.npy"), pose_rows())
    return file


def write_frames(folder: Path, parent: str = "frames", background: str | None = ".png") -> Path:
    """The folders that the authors' own demo reads."""
    for index, name in enumerate(NAMES):
        for frame in range(N_FRAMES):
            write_image(
                folder / parent / name / f"{frame:05d}.png", make_image(index, frame, WIDTH, HEIGHT)
            )
        if background:
            write_image(
                folder / "background" / f"{name}{background}",
                255 - make_image(index, 0, WIDTH, HEIGHT),
            )
    np.save(folder / "poses_bounds.npy", pose_rows())
    return folder


@pytest.fixture(scope="module")
def h5_scene(tmp_path_factory):
    return write_h5(tmp_path_factory.mktemp("d3dmv") / "scene007.h5")


@pytest.fixture
def scene(h5_scene, tmp_path) -> Path:
    """The file of an intact scene, to read or to damage."""
    shutil.copy(h5_scene.with_name("scene007_pb.npy"), tmp_path)
    return Path(shutil.copy(h5_scene, tmp_path))


def replace(scene: Path, name: str, **options: object) -> None:
    with h5py.File(scene, "a") as h5:
        del h5[name]
        if options:
            h5.create_dataset(name, **options)


@pytest.mark.parametrize("by_folder", [False, True])
def test_opens_a_compressed_scene(scene, by_folder):
    """The file, or a folder with no other, gives every frame, background and mask of every camera
    exactly.
    """
    capture = open_capture(scene.parent if by_folder else scene)
    assert (capture.layout, capture.scene, capture.camera_names) == (
        "d3dmv",
        scene.stem if not by_folder else "scene007",
        NAMES,
    )
    assert (capture.n_frames, capture.fps) == (N_FRAMES, 30.0)
    for index, name in enumerate(NAMES):
        assert np.array_equal(list(capture.frames(name)), make_frames()[index])
        assert np.array_equal(capture.background(name), 255 - make_image(index, 0, WIDTH, HEIGHT))
        masks = list(capture.extras_of(name).mask.frames(0, N_FRAMES))
        assert np.array_equal(masks, np.repeat(make_alpha()[index][..., None], 3, axis=-1))


def test_poses_are_those_before_compression(scene):
    """A point 1 to the right, 0.5 below and 2 ahead lands where f = 32 px, a third of the file's
    96, puts it.
    """
    for index, camera in enumerate(open_capture(scene).cameras):
        uv, depth = camera.project(np.array([0.3 * index + 1.0, 0.5, 2.0]))
        np.testing.assert_allclose(uv, (32 + 32 * 0.5, 18 + 32 * 0.25))
        assert depth == 2.0
        assert (camera.size, camera.near, camera.far) == (
            (WIDTH, HEIGHT),
            1.5 + index,
            40.0 + index,
        )


def test_frames_alone_are_enough(scene):
    """Backgrounds and foregrounds are optional."""
    replace(scene, "fg_rgb")
    assert open_capture(scene).extras_of("cam01").mask is None
    assert open_capture(scene).background("cam01") is not None
    replace(scene, "bg_rgb")
    assert open_capture(scene).background("cam01") is None


def test_several_scenes_in_a_folder(scene):
    """A folder with several scenes is refused with their names; naming one file opens it."""
    write_h5(scene.parent / "scene012.h5")
    assert "wanted one scene, got 2 (scene007.h5, scene012.h5); name one of these files" in refusal(
        scene.parent
    )
    assert open_capture(scene.parent / "scene012.h5").scene == "scene012"


def test_holds_one_frame_at_a_time(tmp_path):
    """Reading 60 frames takes the memory of a few of them."""
    frame = np.random.default_rng(0).integers(0, 256, (1, 1, 200, 300, 3), dtype=np.uint8)
    with h5py.File(tmp_path / "long.h5", "w") as h5:
        h5.create_dataset("rgb", data=np.repeat(frame, 60, axis=1), chunks=frame.shape)
    source = H5Frames(H5File(tmp_path / "long.h5"), "rgb", 0)
    next(source.frames(0, 1))
    tracemalloc.start()
    assert sum(1 for _ in source.frames(0, 60)) == 60
    assert tracemalloc.get_traced_memory()[1] < 5 * frame.nbytes
    tracemalloc.stop()


def test_frames_that_are_not_there(scene):
    """Asking for more frames than there are is refused with their number."""
    with refused(CaptureError, "2..4", "rgb", "has 4"):
        list(H5Frames(H5File(scene), "rgb", 0).frames(2, 5))


SHAPE = (N_CAMERAS, N_FRAMES, HEIGHT, WIDTH, 3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "wanted a dataset 'rgb', there is bg_rgb, fg_rgb"),
        ({"data": np.zeros(SHAPE, np.float32)}, "got float32 (3, 4, 36, 64, 3)"),
        (
            {"data": np.zeros(SHAPE[1:], np.uint8)},
            "uint8 (cameras, frames, H, W, 3), in this file, got uint8 (4, ",
        ),
        ({"data": np.zeros((*SHAPE[:4], 4), np.uint8)}, "got uint8 (3, 4, 36, 64, 4)"),
        (
            {"shape": (3, 4, 1, 1, 3), "dtype": h5py.special_dtype(vlen=bytes)},
            "got object (3, 4, 1, 1, 3)",
        ),
        ({"shape": (3, 0, 36, 64, 3), "dtype": "u1"}, "got shape (3, 0, 36, 64, 3)"),
        (
            {"shape": (3, 2**40, 36, 64, 3), "dtype": "u1", "chunks": (1, 1, 36, 64, 3)},
            "got 0 of 3298534883328 chunks",
        ),
        (
            {"shape": (3, 4, 2**20, 2**20, 3), "dtype": "u1", "chunks": (1, 1, 64, 64, 3)},
            "got shape (3, 4, 1048576, 1048576, 3)",
        ),
        (
            {"shape": (3, 2**20, 36, 64, 3), "dtype": "u1", "chunks": (1, 2**18, 36, 64, 3)},
            "in chunks of (1, 262144, 36, 64, 3)",
        ),
        ({"shape": (3, 2**30, 36, 64, 3), "dtype": "u1"}, "bytes in a smaller file"),
        (
            {"data": np.zeros(SHAPE, np.uint8), "chunks": (1, 1, 36, 64, 3), "scaleoffset": 0},
            "got the unknown compression 6",
        ),
        (
            {"shape": SHAPE, "dtype": "u1", "external": [("/etc/hostname", 0, 2**20)]},
            "got data that are stored in another file",
        ),
        (
            {"data": np.zeros((2, *SHAPE[1:]), np.uint8)},
            "wanted fg_rgb of (cameras, frames) (2, 4) of rgb, got (3, 4)",
        ),
        (
            {"data": np.zeros((3, 3, *SHAPE[2:]), np.uint8)},
            "wanted fg_rgb of (cameras, frames) (3, 3) of rgb, got (3, 4)",
        ),
    ],
    ids=lambda value: value[:24] if isinstance(value, str) else "",
)
def test_dataset_that_is_not_what_its_name_promises(scene, options, message):
    """Wrong types, shapes, counts, absurd sizes, foreign data and unknown compression are refused
    by the header alone.
    """
    replace(scene, "rgb", **options)
    assert message in refusal(scene)


@pytest.mark.parametrize("kind", ["external", "soft", "group", "virtual"])
def test_data_elsewhere_are_never_read(scene, kind):
    """Links and virtual datasets are refused even where what they point to is whole."""
    write_h5(scene.parent / "elsewhere" / "other.h5")
    layout = h5py.VirtualLayout(SHAPE, "u1")
    layout[:] = h5py.VirtualSource("elsewhere/other.h5", "rgb", SHAPE)
    with h5py.File(scene, "a") as h5:
        h5.move("rgb", "kept")
        if kind == "virtual":
            h5.create_virtual_dataset("rgb", layout)
        elif kind == "group":
            h5.create_group("rgb")
        else:
            h5["rgb"] = (
                h5py.ExternalLink("elsewhere/other.h5", "/rgb")
                if kind == "external"
                else h5py.SoftLink("/kept")
            )
    found = "data that are stored in another file" if kind == "virtual" else "a link or group"
    assert f"got {found}; convert the scene again" in refusal(scene)


@pytest.mark.parametrize("kept", [0, 7, 600, -1, -5000])
def test_truncated_file(scene, kept):
    """A file that ends early is refused, naming it."""
    scene.write_bytes(scene.read_bytes()[:kept])
    assert "scene007.h5: wanted an HDF5 file of D3DMV, got damage: " in refusal(scene)


def test_unfinished_file(scene):
    """A scene whose conversion stopped between two frames has fewer chunks than frames and is
    refused.
    """
    with h5py.File(scene, "a") as h5:
        del h5["rgb"]
        stored = h5.create_dataset("rgb", SHAPE, "u1", chunks=(1, 1, HEIGHT, WIDTH, 3))
        stored[:2] = make_frames()[:2]
    assert "got 8 of 12 chunks, an unfinished file; convert the scene again" in refusal(scene)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda rows: np.where(np.arange(3)[:, None] == 1, np.nan, rows),
            "got NaN or infinity in row 1 (from 0)",
        ),
        (lambda rows: rows.astype(object), "allow_pickle=False"),
        (
            lambda rows: rows * np.where(np.arange(17) == 4, 0.5, 1.0),
            "another shape than the 192 x 54",
        ),
    ],
    ids=["NaN", "pickled", "shape"],
)
def test_poses_that_do_not_fit(scene, change, message):
    """Poses that are damaged, or made for other cameras or images, are refused."""
    np.save(scene.with_name("scene007_pb.npy"), change(pose_rows()))
    assert message in refusal(scene.parent)


@pytest.mark.parametrize(
    ("parent", "background"), [("frames", ".png"), ("frames", ".jpg"), (".", ".png"), (".", None)]
)
def test_opens_frame_folders(tmp_path, parent, background):
    """Frames in folders, with or without backgrounds beside them, open to the same cameras and
    images.
    """
    capture = open_capture(write_frames(tmp_path / "scene003", parent, background))
    assert (capture.layout, capture.scene, capture.camera_names) == ("d3dmv", "scene003", NAMES)
    assert (capture.n_frames, capture.fps) == (N_FRAMES, 30.0)
    for index, camera in enumerate(capture.cameras):
        assert np.array_equal(list(capture.frames(camera.name)), make_frames()[index])
        np.testing.assert_allclose(camera.K, [[32, 0, 32], [0, 32, 18], [0, 0, 1]])
        np.testing.assert_allclose(camera.centre, [0.3 * index, 0, 0])
        found = capture.background(camera.name)
        assert (found is None) == (background is None)
        assert found is None or np.array_equal(found, 255 - make_image(index, 0, WIDTH, HEIGHT))


def test_frames_without_background_are_dynerf(tmp_path):
    """frames/camXX without backgrounds is the arrangement that DyNeRF's frames have."""
    write_frames(tmp_path, background=None)
    assert "neither frames/camXX/ with background/ nor camXX/*.jpg" in d3dmv.refuse(tmp_path)
    assert open_capture(tmp_path).layout == "dynerf"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda folder: (folder / "background" / "cam01.png").unlink(),
            "wanted a background of every camera, none of cam01",
        ),
        (
            lambda folder: (folder / "frames" / "cam01" / "00003.png").unlink(),
            "got cam00 4, cam01 3, cam02 4",
        ),
    ],
    ids=["background", "frame"],
)
def test_folders_that_are_not_whole(tmp_path, change, message):
    """Missing backgrounds, cameras and frames are named."""
    change(write_frames(tmp_path / "scene"))
    assert message in refusal(tmp_path / "scene", "d3dmv")
