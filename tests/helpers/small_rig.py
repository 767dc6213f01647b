"""Six cameras before boards, some of which move, as a capture of their own; and faults of cameras
planted in their frames.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.camera import Camera
from ggvs_eval.datasets.llff import llff_pose, write_llff_poses
from ggvs_eval.files.images import quantise, round_levels
from ggvs_eval.files.video import write_video
from ggvs_eval.pipelines.inspection.capture.records import CameraRecord, Recorder

Frames = list[Image8]
WIDTH, HEIGHT, N_FRAMES, COLUMNS = 320, 240, 24, 3

NAMES = tuple(f"cam{number:02d}" for number in range(2 * COLUMNS))
# Corner, width vector, height vector, and how the corner moves per second: x, y, z in units.
Board = tuple[Sequence[float], Sequence[float], Sequence[float], Callable[[float], Sequence[float]]]


def still(_: float) -> Sequence[float]:
    return (0.0, 0.0, 0.0)


BOARDS: list[Board] = [
    ((-9, -6, 10), (18, 0, 0), (0, 12, 0), still),
    ((-7, 2.2, 4), (14, 0, 0), (0, 1.5, 6), still),
    ((-4.5, -2.5, 8), (2.5, 0, 1.2), (0, 3, 0), still),
    ((1.5, -2.2, 7), (2.4, 0, -1.0), (0, 3, 0.4), still),
    ((-1.4, -0.5, 6), (1.8, 0.2, 0.5), (0, 2, 0), still),
    (
        (-3.0, 0.4, 6),
        (1.0, 0, 0),
        (0, 1, 0),
        lambda t: (0.5 * np.sin(9 * t), 0.3 * np.sin(5 * t + 1), 0),
    ),
    (
        (1.2, 0.6, 5.5),
        (0.9, 0, 0.2),
        (0, 0.9, 0),
        lambda t: (0.2 * np.cos(7 * t), 0.6 * np.sin(8 * t), 0),
    ),
    (
        (-0.4, -2.0, 6.5),
        (1.1, 0, 0),
        (0, 0.8, 0),
        lambda t: (0.7 * np.sin(6 * t + 2), 0.4 * np.sin(11 * t), 0.3 * np.sin(4 * t)),
    ),
]


def texture(seed: int, size: tuple[int, int]) -> Image8:
    """Coloured blots of several sizes, (height, width, 3)."""
    rng = np.random.default_rng(seed)
    image = np.zeros((size[1], size[0], 3), np.float32)
    for cell, weight in ((60, 0.6), (26, 0.9)):
        coarse = rng.random((size[1] // cell + 2, size[0] // cell + 2, 3), np.float32) - 0.5
        image += weight * cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC)
    return quantise(0.5 + 0.55 * image)


TEXTURES = [texture(index, (900, 600) if index < 2 else (240, 220)) for index in range(len(BOARDS))]


def make_cameras() -> list[Camera]:
    """Two rows of three that look at one point, each a little off."""
    rng = np.random.default_rng(3)
    cameras = []
    for index, name in enumerate(NAMES):
        centre = np.array(
            [1.1 * (index % COLUMNS - 1.0), 0.9 * (index // COLUMNS - 0.5), 0.0]
        ) + rng.normal(0, 0.06, 3)
        forward = np.array([0.0, 0.0, 7.0]) + rng.normal(0, 0.15, 3) - centre
        forward /= np.linalg.norm(forward)
        right = np.cross([0.0, 1.0, 0.0], forward)
        right /= np.linalg.norm(right)
        world_to_camera = np.eye(4)
        world_to_camera[:3, :3] = np.stack([right, np.cross(forward, right), forward])
        world_to_camera[:3, 3] = -world_to_camera[:3, :3] @ centre
        K = np.array([[0.6 * WIDTH, 0, WIDTH / 2], [0, 0.6 * WIDTH, HEIGHT / 2], [0, 0, 1.0]])
        cameras.append(Camera(name, K, world_to_camera, WIDTH, HEIGHT, 3.5, 12.0))
    return cameras


def draw(
    boards: Sequence[Board],
    pictures: Sequence[Image8],
    camera: Camera,
    time_s: float,
    image: Image8,
) -> None:
    """Boards from back to front onto a picture, each by its homography."""
    for (corner, across, down, moves), picture in zip(boards, pictures, strict=True):
        height, width = picture.shape[:2]
        origin = np.asarray(corner, float) + moves(time_s)
        # texture pixel to world
        plane = np.stack([np.asarray(across) / width, np.asarray(down) / height, origin], axis=1)
        plane = camera.rotation @ plane
        plane[:, 2] += camera.translation
        # OpenCV counts from the centre of the first pixel
        half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
        homography = np.linalg.inv(half) @ camera.K @ plane @ half
        seen = cv2.warpPerspective(
            np.ones((height, width), np.uint8), homography, (WIDTH, HEIGHT), flags=cv2.INTER_NEAREST
        )
        warped = cv2.warpPerspective(
            picture, homography, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REPLICATE
        )
        image[seen > 0] = warped[seen > 0]


def film(camera: Camera, first: int = 0) -> Frames:
    """What a camera records from frame `first` on."""
    rng = np.random.default_rng([7, NAMES.index(camera.name)])
    n_still = sum(moves is still for *_, moves in BOARDS)  # which stand behind those that move
    background = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    draw(BOARDS[:n_still], TEXTURES[:n_still], camera, 0.0, background)
    frames = []
    for index in range(first, first + N_FRAMES):
        image = background.copy()
        draw(BOARDS[n_still:], TEXTURES[n_still:], camera, index / 30, image)
        frames.append(quantise(image / 255 + rng.normal(0, 1.5 / 255, image.shape)))
    return frames


def write_rig(folder: Path, cameras: Sequence[Camera], frames: Mapping[str, Frames]) -> Path:
    """A capture in the layout of DyNeRF."""
    for camera in cameras:
        write_video(folder / f"{camera.name}.mp4", frames[camera.name], 30.0, crf=6)
    write_llff_poses(folder / "poses_bounds.npy", [llff_pose(camera) for camera in cameras])
    return folder


def recorded(frames: Frames, name: str) -> CameraRecord:
    """The record of a camera with these frames, which no encoder has seen."""
    recorder = Recorder(name, len(frames))
    for index, frame in enumerate(frames):
        recorder.add(index, frame)
    return recorder.record()


def brighten(frame: Image8, gain: object) -> Image8:
    """Multiply sRGB values."""
    levels = np.broadcast_to(np.arange(256)[:, None] * np.asarray(gain), (256, 3))
    return np.asarray(cv2.LUT(frame, round_levels(levels)[None]), np.uint8)


def warp(frame: Image8, right: float = 0.0, down: float = 0.0, zoom: float = 1.0) -> Image8:
    """The picture displaced, and enlarged about its middle."""
    height, width = frame.shape[:2]
    move = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), 0, zoom)
    move[:, 2] += [right, down]
    return cv2.warpAffine(
        frame, move, (width, height), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
    )


def bump(right: float, down: float, at: int) -> Callable[[Frames], Frames]:
    """The camera is pushed at a frame."""
    return lambda frames: [*frames[:at], *(warp(frame, right, down) for frame in frames[at:])]


def expose(last: float) -> Callable[[Frames], Frames]:
    """The exposure grows from 1 to `last`."""
    return lambda frames: [
        brighten(frame, gain)
        for frame, gain in zip(frames, np.linspace(1, last, len(frames)), strict=True)
    ]


def lose(at: int) -> Callable[[Frames], Frames]:
    """A frame is missing; the last one comes again, so that the count stays."""
    return lambda frames: [*frames[:at], *frames[at + 1 :], frames[-1]]
