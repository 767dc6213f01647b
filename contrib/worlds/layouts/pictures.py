"""Layouts of pictures: Technicolor's, Panoptic Sports', that of ScanNet's exporter, and Deep 3D
Mask Volume's single file.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.lib.format import open_memmap
from numpy.typing import NDArray

from ggvs_eval.arrays import Array, Image8
from ggvs_eval.camera import Camera
from ggvs_eval.contrib.worlds.film.film import PARTS, Footage, measured, misplaced
from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.contrib.worlds.film.raycast import UNITS_PER_METRE, in_metres, render_depth
from ggvs_eval.datasets.depth_range import DEPTH_RANGE_FILE, write_depth_range
from ggvs_eval.datasets.llff import llff_pose, write_llff_poses
from ggvs_eval.datasets.panoptic import IMAGES, METAS
from ggvs_eval.datasets.technicolor import CALIBRATED_SIZE, COLUMNS, PARAMETERS
from ggvs_eval.files.images import quantise, write_image
from ggvs_eval.synthetic.d3dmv_scene import SCENE, write_scene

# Full chroma resolution: what is lost is little and the same in every hue.
JPEG = [
    cv2.IMWRITE_JPEG_QUALITY,
    97,
    cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
    cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
]


def write_jpeg(path: Path, image: Image8) -> None:
    """Write an RGB image, (H, W, 3), as JPEG of quality 97 without chroma subsampling."""
    _write(path, cv2.cvtColor(image, cv2.COLOR_RGB2BGR), JPEG)


def write_grey_png(path: Path, image: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    """Write one channel of 8 or 16 bit, (H, W), as PNG."""
    _write(path, image, [])


def _write(path: Path, image: NDArray[np.uint8] | NDArray[np.uint16], flags: list[int]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    _, encoded = cv2.imencode(path.suffix, image, flags)
    path.write_bytes(encoded.tobytes())


TECHNICOLOR_SCENE = "Room"


def write_technicolor(folder: Path, footage: Footage) -> Camera:
    """Write the pictures of one camera and its exact depth; gives the camera to note."""
    camera = footage.noted_camera()
    for index, frame in enumerate(footage.frames_keeping_depth(folder)):
        write_image(folder / _picture(index, camera.name), frame.image)
    return camera


def finish_technicolor(folder: Path, options: DemoOptions, cameras: Sequence[Camera]) -> None:
    """Write ``cameras_parameters.txt``, and ``depth_range.toml``, since that has no depth.

    Reading:
        The file has no size: its numbers are those of pictures of 2048 x 1088, regardless of the
        demo's shape; the aspect ratio ar takes what the shape of the pictures leaves between focal
        lengths along rows and columns.
    """
    from scipy.spatial.transform import Rotation

    lines = [f"# {COLUMNS}"]
    for camera in cameras:
        scale_x, scale_y = np.array(CALIBRATED_SIZE) / camera.size
        fx, fy = camera.K[0, 0] * scale_x, camera.K[1, 1] * scale_y
        qx, qy, qz, qw = Rotation.from_matrix(camera.rotation).as_quat()
        row = [
            fx,
            camera.K[0, 2] * scale_x,
            camera.K[1, 2] * scale_y,
            fy / fx,
            0.0,
            qw,
            qx,
            qy,
            qz,
            *camera.translation,
        ]
        lines.append(" ".join(repr(float(value)) for value in row))
    write_depth_range(
        folder, min(camera.near for camera in cameras), max(camera.far for camera in cameras)
    )
    (folder / PARAMETERS).write_text("\n".join(lines) + "\n", encoding="utf-8")


def technicolor_files(options: DemoOptions) -> list[str]:
    """List the files that every complete demo has."""
    return [
        DEPTH_RANGE_FILE,
        PARAMETERS,
        *(
            _picture(index, name)
            for name in options.camera_names
            for index in range(options.n_frames)
        ),
    ]


def _picture(index: int, name: str) -> str:
    return f"{TECHNICOLOR_SCENE}_undist_{index + 1:05d}_{name.removeprefix('cam')}.png"


EVERY = 4  # one camera in this number is held out


def write_panoptic(folder: Path, footage: Footage) -> Camera:
    """Write the images of one camera and its exact depth; gives the camera to note, metres."""
    camera = in_metres(footage.noted_camera())
    for index, frame in enumerate(footage.frames_keeping_depth(folder, 1 / UNITS_PER_METRE)):
        write_jpeg(folder / IMAGES / _image(camera.name, index), frame.image)
    return camera


def finish_panoptic(folder: Path, options: DemoOptions, cameras: Sequence[Camera]) -> None:
    """Write both files, and ``depth_range.toml``, since they have no depth."""
    for file, is_test in zip(METAS, (False, True), strict=True):
        views = [camera for index, camera in enumerate(cameras) if (index % EVERY == 1) == is_test]
        (folder / file).write_text(json.dumps(_meta(views, options.n_frames)), encoding="utf-8")
    write_depth_range(
        folder, min(camera.near for camera in cameras), max(camera.far for camera in cameras)
    )


def panoptic_files(options: DemoOptions) -> list[str]:
    """List the files that every complete demo has."""
    images = [
        f"{IMAGES}/{_image(name, index)}"
        for name in options.camera_names
        for index in range(options.n_frames)
    ]
    return [DEPTH_RANGE_FILE, *METAS, *images]


def _meta(cameras: Sequence[Camera], n_frames: int) -> dict[str, Any]:
    return {
        "w": cameras[0].width if cameras else 0,
        "h": cameras[0].height if cameras else 0,
        "k": [[camera.K.tolist() for camera in cameras]] * n_frames,
        "w2c": [[camera.world_to_camera.tolist() for camera in cameras]] * n_frames,
        "fn": [[_image(camera.name, index) for camera in cameras] for index in range(n_frames)],
        "cam_id": [[_number(camera.name) for camera in cameras]] * n_frames,
    }


def _image(name: str, index: int) -> str:
    return f"{_number(name)}/{index:06d}.jpg"


def _number(name: str) -> int:
    return int(name.removeprefix("cam"))


MILLIMETRES_PER_UNIT = 1000 / UNITS_PER_METRE
LARGEST_MM = np.iinfo(np.uint16).max
# The exporter writes six decimals; these hold a pose to 1e-6 after its inversion too.
DECIMALS = "%.10f"


def write_rgbd(folder: Path, footage: Footage) -> Camera:
    """Write colour, depth and pose of one frame; gives the camera to note, metres.

    Reading:
        The depth camera has half the colour camera's resolution, its place and its view; its pixels
        are looked at by themselves.
    """
    camera, options = in_metres(footage.noted_camera()), footage.options
    write_jpeg(folder / "color" / f"{camera.name}.jpg", next(footage.frames()).image)
    sensor = misplaced(
        options, depth_camera(footage.shot.depth_pose or footage.shot.camera), options.width
    )
    depth = measured(options, render_depth(footage.instant(0), sensor), int(camera.name))
    millimetres = np.minimum(
        np.rint(depth.astype(np.float64) * MILLIMETRES_PER_UNIT), LARGEST_MM
    ).astype(np.uint16)
    write_grey_png(folder / "depth" / f"{camera.name}.png", millimetres)
    _write_matrix(folder / "pose" / f"{camera.name}.txt", _camera_to_world(camera))
    return camera


def finish_rgbd(folder: Path, options: DemoOptions, cameras: Sequence[Camera]) -> None:
    """Write ``intrinsic/``."""
    colour = cameras[0]
    for kind, camera in (("color", colour), ("depth", depth_camera(colour))):
        K = np.eye(4)
        K[:3, :3] = camera.K
        _write_matrix(folder / "intrinsic" / f"intrinsic_{kind}.txt", K)
        _write_matrix(folder / "intrinsic" / f"extrinsic_{kind}.txt", np.eye(4))


def depth_camera(colour: Camera) -> Camera:
    """Return the sensor of depth, of half the resolution."""
    return colour.resized(colour.width // 2, colour.height // 2)


def rgbd_files(options: DemoOptions) -> list[str]:
    """List the files that every complete demo has."""
    kinds = (("color", "jpg"), ("depth", "png"), ("pose", "txt"))
    frames = [
        f"{folder}/{index}.{kind}" for folder, kind in kinds for index in range(options.n_frames)
    ]
    return [
        *(
            f"intrinsic/{part}_{kind}.txt"
            for part in ("intrinsic", "extrinsic")
            for kind in ("color", "depth")
        ),
        *frames,
    ]


def _camera_to_world(camera: Camera) -> Array:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = camera.rotation.T, camera.centre
    return pose


def _write_matrix(path: Path, matrix: Array) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, matrix, fmt=DECIMALS)


SCENE_POSES = "scene000_pb.npy"
# The poses are those of the images before they were compressed, 1280 x 720 for 640 x 360.
POSE_SCALE = 2


def write_d3dmv(folder: Path, footage: Footage) -> Camera:
    """Write the frames of one camera to separate files and its exact depth.

    Gives the camera to note.
    """
    camera, options = footage.noted_camera(), footage.options
    size = (options.n_frames, options.height, options.width)
    rgb = open_memmap(_part(folder, camera, "rgb"), "w+", np.uint8, (*size, 3))
    alpha = open_memmap(_part(folder, camera, "alpha"), "w+", np.uint8, size)
    for index, frame in enumerate(footage.frames_keeping_depth(folder)):
        rgb[index], alpha[index] = frame.image, quantise(frame.foreground)
    return camera


def finish_d3dmv(folder: Path, options: DemoOptions, cameras: Sequence[Camera]) -> None:
    """Join the frames of all cameras in ``scene000.h5`` and write ``scene000_pb.npy``."""
    rgb, alpha = (
        [np.load(_part(folder, camera, key), mmap_mode="r") for camera in cameras]
        for key in ("rgb", "alpha")
    )
    write_scene(folder / SCENE, rgb, alpha)
    large = [
        camera.resized(POSE_SCALE * camera.width, POSE_SCALE * camera.height) for camera in cameras
    ]
    write_llff_poses(folder / SCENE_POSES, [llff_pose(camera) for camera in large])


def d3dmv_files(options: DemoOptions) -> list[str]:
    """List the files that every complete demo has."""
    return [SCENE, SCENE_POSES]


def _part(folder: Path, camera: Camera, key: str) -> Path:
    return folder / PARTS / f"{camera.name}_{key}.npy"
