"""Tiny valid captures of every layout, written as their authors lay them out."""

import struct
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.arrays import Image8
from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.datasets import open_capture
from ggvs_eval.datasets.llff import llff_pose, write_llff_poses
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.images import write_image
from ggvs_eval.files.video import write_video

WIDTH, HEIGHT, N_FRAMES, FPS = 64, 48, 5, 30.0
NAMES = ("cam00", "cam01", "cam02", "cam03")


def make_image(camera: int, frame: int, width: int = WIDTH, height: int = HEIGHT) -> Image8:
    """A smooth picture whose mean colour tells the frame (red), the camera (green) and whose blue
    runs from left to right.
    """
    image = np.empty((height, width, 3), np.uint8)
    image[..., 0] = 30 + 20 * frame
    image[..., 1] = 30 + 20 * camera
    image[..., 2] = np.linspace(40, 200, width)
    return image


def make_rig(
    names: Sequence[str] = NAMES, width: int = WIDTH, height: int = HEIGHT
) -> list[Camera]:
    """Cameras in a row, each turned a little, near 2 and far 8."""
    cameras = []
    for index, name in enumerate(names):
        angle_rad = 0.05 * (index - 1)
        world_to_camera = np.eye(4)
        cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
        world_to_camera[:3, :3] = [[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]]
        world_to_camera[:3, 3] = -world_to_camera[:3, :3] @ [0.3 * index, 0.1 * index, 0.0]
        K = np.array([[0.9 * width, 0, width / 2], [0, 0.9 * width, height / 2], [0, 0, 1.0]])
        cameras.append(Camera(name, K, world_to_camera, width, height, 2.0, 8.0))
    return cameras


def write_poses(folder: Path, cameras: Sequence[Camera]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    write_llff_poses(folder / "poses_bounds.npy", [llff_pose(camera) for camera in cameras])


def write_videos(folder: Path, names: Sequence[str] = NAMES, n_frames: int = N_FRAMES) -> None:
    for index, name in enumerate(names):
        write_video(
            folder / f"{name}.mp4", (make_image(index, frame) for frame in range(n_frames)), FPS
        )


def write_timed_video(path: Path, images: list[np.ndarray], ticks: Sequence[int]) -> None:
    """A video whose frames are shown at these 600ths of a second."""
    import av

    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt, stream.options = (
            WIDTH,
            HEIGHT,
            "yuv420p",
            {"bf": "0"},
        )
        stream.codec_context.time_base = Fraction(1, 600)
        for image, tick in zip(images, ticks, strict=True):
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts, frame.time_base = tick, Fraction(1, 600)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def write_folders(
    folder: Path, names: Sequence[str] = NAMES, pattern: str = "{}/images", first: int = 0
) -> Path:
    for index, name in enumerate(names):
        for frame in range(N_FRAMES):
            write_image(
                folder / pattern.format(name) / f"{first + frame:04d}.png", make_image(index, frame)
            )
    return folder


def write_dynerf(folder: Path, names: Sequence[str] = NAMES) -> Path:
    """The original layout: one video per camera, poses in the order of names."""
    write_videos(folder, names)
    write_poses(folder, make_rig(names))
    return folder


def write_colmap_model(
    folder: Path, image_names: Sequence[str], model: str = "PINHOLE", distortion: str = ""
) -> None:
    """A sparse model in COLMAP's text form: the rig above, one shared camera, 60 points that every
    image sees.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rig = make_rig(image_names)
    K = rig[0].K
    focal = f"{K[0, 0]} {K[1, 1]}" if model == "PINHOLE" else f"{K[0, 0]}"
    camera_line = f"1 {model} {WIDTH} {HEIGHT} {focal} {K[0, 2]} {K[1, 2]} {distortion}"
    (folder / "cameras.txt").write_text(
        f"# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n{camera_line}\n"
    )
    points_world = np.random.default_rng(0).uniform((-0.5, -0.5, 3.0), (1.0, 0.5, 6.0), (60, 3))
    image_lines, tracks = [], " ".join(f"{image + 1} {{0}}" for image in range(len(rig)))
    for image, camera in enumerate(rig):
        numbers = " ".join(
            f"{value:.17g}" for value in (*_quaternion_wxyz(camera), *camera.translation)
        )
        uv = camera.project(points_world)[0]
        seen = " ".join(f"{u:.6f} {v:.6f} {point + 1}" for point, (u, v) in enumerate(uv))
        image_lines += [f"{image + 1} {numbers} 1 {image_names[image]}", seen]
    (folder / "images.txt").write_text("\n".join(image_lines) + "\n")
    point_lines = [
        f"{i + 1} {x:.9f} {y:.9f} {z:.9f} 9 9 9 0.5 {tracks.format(i)}"
        for i, (x, y, z) in enumerate(points_world)
    ]
    (folder / "points3D.txt").write_text("\n".join(point_lines) + "\n")


def write_colmap(folder: Path, names: Sequence[str] = NAMES) -> Path:
    """A COLMAP project of one instant: sparse/0 and one image per camera."""
    write_colmap_model(folder / "sparse" / "0", [f"{name}.png" for name in names])
    for index, name in enumerate(names):
        write_image(folder / "images" / f"{name}.png", make_image(index, 0))
    return folder


MODEL_NUMBERS = {"SIMPLE_PINHOLE": 0, "PINHOLE": 1, "SIMPLE_RADIAL": 2, "RADIAL": 3, "OPENCV": 4}


def make_binary(model_folder: Path) -> None:
    """Turn a text model into a binary one."""
    rows = {}
    for name in ("cameras", "images", "points3D"):
        file = model_folder / f"{name}.txt"
        rows[name] = [
            line.split() for line in file.read_text().splitlines() if not line.startswith("#")
        ]
        file.unlink()
    content = struct.pack("<Q", len(rows["cameras"]))
    for number, model, width, height, *params in rows["cameras"]:
        content += struct.pack("<iiQQ", int(number), MODEL_NUMBERS[model], int(width), int(height))
        content += struct.pack(f"<{len(params)}d", *map(float, params))
    (model_folder / "cameras.bin").write_bytes(content)
    content = struct.pack("<Q", len(rows["images"]) // 2)
    for image, sights in zip(rows["images"][::2], rows["images"][1::2], strict=True):
        content += (
            struct.pack("<i7di", int(image[0]), *map(float, image[1:8]), int(image[8]))
            + image[9].encode()
            + b"\0"
        )
        content += struct.pack("<Q", len(sights) // 3)
        for u, v, point in zip(sights[::3], sights[1::3], sights[2::3], strict=True):
            content += struct.pack("<ddq", float(u), float(v), int(point))
    (model_folder / "images.bin").write_bytes(content)
    content = struct.pack("<Q", len(rows["points3D"]))
    for point in rows["points3D"]:
        content += struct.pack(
            "<Q3d3BdQ",
            int(point[0]),
            *map(float, point[1:4]),
            *map(int, point[4:7]),
            float(point[7]),
            len(point[8:]) // 2,
        )
        content += struct.pack(f"<{len(point[8:])}i", *map(int, point[8:]))
    (model_folder / "points3D.bin").write_bytes(content)


def _quaternion_wxyz(camera: Camera) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(camera.rotation).as_quat()[[3, 0, 1, 2]]


def read_all(path: Path, layout: str | None) -> None:
    capture = open_capture(path, layout)
    for name in capture.camera_names:
        list(capture.frames(name))


def refusal(path: Path, layout: str | None = None) -> str:
    """The one line with which the capture, or one of its frames, is refused."""
    with pytest.raises(CaptureError) as caught:
        read_all(path, layout)
    message = str(caught.value)
    assert "\n" not in message
    assert str(path) in message
    return message


def mean_colours(capture: Capture, name: str) -> list[tuple[int, ...]]:
    """(frame, camera) as the pictures themselves tell them."""
    return [
        tuple(round((float(image[..., c].mean()) - 30) / 20) for c in (0, 1))
        for image in capture.frames(name)
    ]
