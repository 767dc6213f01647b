"""Google Spaces: models.json with the cameras of a rig at several positions, one image each."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from ggvs_eval.datasets import open_capture
from helpers.captures import make_image, refusal

N_POSITIONS, N_CAMERAS = 2, 3
# Sizes in the file are seldom whole numbers; images on disk are.
WIDTH, HEIGHT, IMAGE_SIZE = 80.0, 47.6, (80, 48)
NAMES = tuple(
    f"pos{position:02d}_cam{camera:02d}"
    for position in range(N_POSITIONS)
    for camera in range(N_CAMERAS)
)


def make_models() -> list[list[dict]]:
    """Cameras 0.1 m apart in a row, the second position 0.05 m lower and turned by a right angle
    about the vertical.
    """
    return [
        [
            {
                "principal_point": [39.5, 24.25],
                "pixel_aspect_ratio": 1.02,
                "focal_length": 22.5,
                "position": [0.1 * camera, 0.05 * position, 0.0],
                "orientation": [0.0, position * np.pi / 2, 0.0],
                "width": WIDTH,
                "height": HEIGHT,
                "relative_path": f"cam_{camera:02d}/image_{position:03d}.JPG",
            }
            for camera in range(N_CAMERAS)
        ]
        for position in range(N_POSITIONS)
    ]


def write_scene(folder: Path, size: tuple[int, int] = IMAGE_SIZE) -> Path:
    """A scene as it is distributed."""
    for camera in range(N_CAMERAS):
        (folder / f"cam_{camera:02d}").mkdir(parents=True)
        for position in range(N_POSITIONS):
            image = make_image(camera, position, *size)
            cv2.imwrite(
                str(folder / f"cam_{camera:02d}" / f"image_{position:03d}.JPG"), image[..., ::-1]
            )
    (folder / "models.json").write_text(json.dumps(make_models()))
    return folder


@pytest.fixture(scope="module")
def intact_scene(tmp_path_factory):
    return write_scene(tmp_path_factory.mktemp("spaces") / "scene_000")


@pytest.fixture
def scene(intact_scene, tmp_path) -> Path:
    """An intact scene to read or to damage."""
    return Path(shutil.copytree(intact_scene, tmp_path / "scene_000"))


def damage(scene: Path, change: Callable[[list], object]) -> None:
    """Write models.json again after something was done to its content."""
    models = make_models()
    changed = change(models)
    (scene / "models.json").write_text(json.dumps(models if changed is None else changed))


def test_opens_every_camera_at_every_position(scene):
    """Each camera at each position is one camera of a single instant, with its own image and metric
    units.
    """
    capture = open_capture(scene)
    assert (capture.layout, capture.scene, capture.camera_names) == ("spaces", "scene_000", NAMES)
    assert (capture.n_frames, capture.fps) == (1, 0.0)
    assert (capture.units_per_metre, capture.units_origin) == (
        1.0,
        "assumed of its form, which is that of a metric data set",
    )
    for index, name in enumerate(NAMES):
        position, camera = divmod(index, N_CAMERAS)
        file = scene / f"cam_{camera:02d}" / f"image_{position:03d}.JPG"
        assert np.array_equal(capture.frame(name, 0), cv2.imread(str(file))[..., ::-1])
        np.testing.assert_allclose(
            capture.camera(name).centre, [0.1 * camera, 0.05 * position, 0.0], atol=1e-12
        )


def test_projects_as_the_file_says(scene):
    """A point half a metre to the right and 0.1 m down at 2 m lies at f x/z + cx and f a y/z + cy,
    on the image's own size.
    """
    capture = open_capture(scene)
    u, v = 22.5 * 0.25 + 39.5, (22.5 * 1.02 * 0.05 + 24.25) * 48 / 47.6
    straight, turned = capture.camera("pos00_cam01"), capture.camera("pos01_cam01")
    for camera, point_world in ((straight, [0.6, 0.1, 2.0]), (turned, [0.1 - 2.0, 0.15, 0.5])):
        uv, depth = camera.project(np.array(point_world))
        np.testing.assert_allclose(uv, (u, v), rtol=1e-12)
        assert depth == pytest.approx(2.0)


def test_intrinsics_follow_the_size_on_disk(tmp_path):
    """Images at half the size of the file have half the focal length and principal point."""
    camera = open_capture(write_scene(tmp_path / "scene", (40, 24))).cameras[0]
    assert camera.size == (40, 24)
    np.testing.assert_allclose(camera.K[0], [11.25, 0, 19.75])
    np.testing.assert_allclose(camera.K[1], [0, 22.95 * 24 / 47.6, 24.25 * 24 / 47.6])


def test_paths_are_optional(scene):
    """Where a camera names no image, the usual place is taken."""
    expected = [open_capture(scene).digest(name) for name in NAMES]
    damage(
        scene,
        lambda models: [[camera.pop("relative_path") for camera in at] for at in models] and models,
    )
    assert [open_capture(scene).digest(name) for name in NAMES] == expected


@pytest.mark.parametrize(
    "path",
    [
        "../other/image.JPG",
        "cam_00/../../secret.JPG",
        "/etc/hostname",
        "",
        7,
        None,
        "C:image.JPG",
        "..\\image.JPG",
        "cam_00/\0",
    ],
)
def test_paths_out_of_the_scene(scene, path):
    """A file that names images elsewhere is refused, even where there is one."""
    for place in ("other/image.JPG", "secret.JPG"):
        (scene.parent / place).parent.mkdir(exist_ok=True)
        shutil.copy(scene / "cam_00" / "image_000.JPG", scene.parent / place)
    damage(scene, lambda models: models[1][2].update(relative_path=path))
    assert "wanted relative_path of camera 2 of rig position 1 within the scene, got " in refusal(
        scene
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda models: models[0][1].update(focal_length=None),
            "focal_length of camera 1 of rig position 0, got None",
        ),
        (
            lambda models: models[0][1].update(position=[0, 0]),
            "3 finite numbers as position of camera 1 of rig position 0",
        ),
        (
            lambda models: models[0][1].update(orientation=[0, "1", 0]),
            "3 finite numbers as orientation",
        ),
        (
            lambda models: models[0][1].update(orientation=[0, float("nan"), 0]),
            "3 finite numbers as orientation",
        ),
        (lambda models: models[0][1].update(width=True), "a finite number as width"),
        (lambda models: models[0][1].update(width=float("inf")), "a finite number as width"),
        (lambda models: models[0][1].update(width=10**400), "a finite number as width"),
        (
            lambda models: models[0][1].update(height=0),
            "wanted a size of camera 1 of rig position 0, got 80 x 0",
        ),
        (
            lambda models: models[0][1].update(height=50.0),
            "image_000.JPG: frames of 80 x 48 have another shape than the 80 x 50",
        ),
        (lambda models: models[0][1].update(focal_length=-3.0), "pos00_cam01: lens: K must be"),
        (
            lambda models: models[0].append("camera"),
            "camera 3 of rig position 0, got 'camera' for the camera",
        ),
        (lambda models: [], "wanted a list over rig positions of lists of cameras"),
        (
            lambda models: {"positions": models},
            "wanted a list over rig positions of lists of cameras",
        ),
        (lambda models: [*models, []], "wanted a list over rig positions of lists of cameras"),
        (lambda models: [*models, models[0][:1]], None),
    ],
)
def test_models_that_make_no_sense(scene, change, message):
    """Whatever is wrong with a camera is said with its key and place; a position with fewer cameras
    is none of it.
    """
    damage(scene, change)
    if message is None:
        assert open_capture(scene).camera_names == (*NAMES, "pos02_cam00")
    else:
        assert message in refusal(scene)


def test_images_that_cannot_be_read(scene):
    """A missing, an empty and a truncated image are named."""
    file = scene / "cam_01" / "image_001.JPG"
    content = file.read_bytes()
    file.write_bytes(content[: len(content) // 2])
    assert "image_001.JPG: wanted an image, got " in refusal(scene)
    file.write_bytes(b"")
    assert "image_001.JPG: wanted an image, got 0 bytes" in refusal(scene)
    file.unlink()
    assert (
        "image_001.JPG: wanted the image of camera 1 of rig position 1, got none; restore it"
        in refusal(scene)
    )
