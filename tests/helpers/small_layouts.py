"""Tiny valid captures of the layouts with a lens: the rig of `captures`, written as their authors
lay them out.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ggvs_eval.camera import Camera
from ggvs_eval.files.images import write_image
from ggvs_eval.files.video import write_video
from ggvs_eval.lens import Lens
from helpers.captures import FPS, HEIGHT, NAMES, WIDTH, make_image, make_rig, write_colmap_model
from helpers.lens_pictures import through_lens

N_INSTANTS = 2
NUMBERS = ("00", "01", "02")


def write_frames(folder: Path, camera: int, lens: Lens | None = None, first: int = 0) -> None:
    """Two frames: the camera's picture, or what the lens makes of the pattern."""
    for frame in range(N_INSTANTS):
        image = make_image(camera, frame) if lens is None else through_lens(lens, 1 / (1 + frame))
        write_image(folder / f"{first + frame:06d}.png", image)


def write_storage(file: Path, entries: dict[str, Any], names: Sequence[str] = ()) -> None:
    """A file by OpenCV itself."""
    storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_WRITE)
    if names:
        storage.startWriteStruct("names", cv2.FileNode_SEQ)
        for name in names:
            storage.write("", name)
        storage.endWriteStruct()
    for key, value in entries.items():
        storage.write(key, value)
    storage.release()


def opencv_K(camera: Camera) -> np.ndarray:
    """K with the centre of the first pixel at (0, 0)."""
    K = camera.K.copy()
    K[:2, 2] -= 0.5
    return K


def storage_entries(
    names: Sequence[str] = NUMBERS, coefficients: Sequence[float] = ()
) -> tuple[dict[str, Any], dict[str, Any]]:
    """intri.yml and extri.yml of the rig."""
    intri: dict[str, Any] = {}
    extri: dict[str, Any] = {}
    for name, camera in zip(names, make_rig(names), strict=True):
        intri[f"K_{name}"] = opencv_K(camera)
        if coefficients:
            intri[f"dist_{name}"] = np.array(coefficients).reshape(-1, 1)
        intri[f"H_{name}"], intri[f"W_{name}"] = HEIGHT, WIDTH
        extri[f"R_{name}"] = cv2.Rodrigues(camera.rotation)[0]
        extri[f"Rot_{name}"] = camera.rotation
        extri[f"T_{name}"] = camera.translation.reshape(3, 1)
    return intri, extri


def write_easymocap(folder: Path, coefficients: Sequence[float] = ()) -> Path:
    """intri.yml, extri.yml and images/XX/; with coefficients the frames are the pattern as the lens
    shows it.
    """
    for index, camera in enumerate(make_rig(NUMBERS)):
        lens = (
            Lens(camera.K, "opencv", tuple(coefficients), WIDTH, HEIGHT) if coefficients else None
        )
        write_frames(folder / "images" / camera.name, index, lens)
    intri, extri = storage_entries(coefficients=coefficients)
    write_storage(folder / "intri.yml", intri, NUMBERS)
    write_storage(folder / "extri.yml", extri, NUMBERS)
    return folder


def write_multipleview(folder: Path, model: str = "PINHOLE", distortion: str = "") -> Path:
    """4D Gaussian Splatting's layout: cam01/frame_00001.png and sparse_/ with image1.png."""
    for index in range(len(NAMES)):
        for frame in range(N_INSTANTS):
            write_image(
                folder / f"cam{index + 1:02d}" / f"frame_{frame + 1:05d}.png",
                make_image(index, frame),
            )
    write_colmap_model(
        folder / "sparse_",
        [f"image{index + 1}.png" for index in range(len(NAMES))],
        model,
        distortion,
    )
    return folder


def transforms(names: Sequence[str] = NAMES) -> dict[str, Any]:
    """transforms.json of the rig: camera-to-world, OpenGL axes."""
    rig = make_rig(names)
    K = rig[0].K
    frames = []
    for camera in rig:
        camera_to_world = np.linalg.inv(camera.world_to_camera)
        camera_to_world[:3, 1:3] *= -1  # y up, z backwards
        frames.append(
            {"file_path": f"images/{camera.name}.png", "transform_matrix": camera_to_world.tolist()}
        )
    intrinsics = {
        "fl_x": K[0, 0],
        "fl_y": K[1, 1],
        "cx": K[0, 2],
        "cy": K[1, 2],
        "w": WIDTH,
        "h": HEIGHT,
    }
    return {"camera_model": "OPENCV", **intrinsics, "frames": frames}


def write_nerfstudio(folder: Path, values: dict[str, Any] | None = None) -> Path:
    """transforms.json with one image per camera."""
    for index, name in enumerate(NAMES):
        write_image(folder / "images" / f"{name}.png", make_image(index, 0))
    (folder / "transforms.json").write_text(json.dumps(values or transforms()))
    return folder


def camera_toml(camera: Camera, frames: str, more: str = "") -> str:
    """One [[camera]] of a capture.toml."""
    rows = "".join(
        f"\n{key} = {matrix.tolist()}"
        for key, matrix in (("K", camera.K), ("world_to_camera", camera.world_to_camera))
    )
    size = f"width = {camera.width}\nheight = {camera.height}"
    return f'\n[[camera]]\nname = "{camera.name}"\nframes = "{frames}"\n{size}{rows}\n{more}\n'


def write_capture_toml(folder: Path, head: str = "") -> Path:
    """capture.toml with a video, two folders of images and a video again."""
    text = head
    for index, camera in enumerate(make_rig()):
        frames = f"frames/{camera.name}" if index in (1, 2) else f"videos/{camera.name}.mp4"
        if index in (1, 2):
            write_frames(folder / frames, index)
        else:
            write_video(
                folder / frames, (make_image(index, frame) for frame in range(N_INSTANTS)), FPS
            )
        text += camera_toml(camera, frames)
    (folder / "capture.toml").write_text(text)
    return folder
