"""Eight cameras of the demo room as a capture of their own, and faults of cameras planted in their videos."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path

import cv2
import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.camera import Camera
from ggvs_eval.datasets import open_capture
from ggvs_eval.datasets.llff import llff_pose, write_llff_poses
from ggvs_eval.datasets.units import DEMO_NOTES
from ggvs_eval.files.video import write_video
from ggvs_eval.synthetic.shipped import write_room

Frames = list[Image8]
# Neighbours of two rows; a person walks and things move before them.
NAMES = ("cam03", "cam04", "cam05", "cam06", "cam15", "cam16", "cam17", "cam18")


def film_rig(folder: Path) -> tuple[list[Camera], dict[str, Frames]]:
    """Cameras and frames of the eight, their gains divided out, so that all are equally bright."""
    demo = open_capture(write_room(folder))
    gains = json.loads((folder / DEMO_NOTES).read_text(encoding="utf-8"))["camera_gains"]
    frames = {}
    for name in NAMES:
        gain = gains[demo.camera_names.index(name)]
        frames[name] = [brighten(frame, 1 / np.array(gain)) for frame in demo.frames(name)]
    return [demo.camera(name) for name in NAMES], frames


def write_rig(folder: Path, cameras: list[Camera], frames: Mapping[str, Frames]) -> Path:
    """A capture in the layout of DyNeRF."""
    for camera in cameras:
        write_video(folder / f"{camera.name}.mp4", frames[camera.name], 30.0, crf=6)
    write_llff_poses(folder / "poses_bounds.npy", [llff_pose(camera) for camera in cameras])
    return folder


def brighten(frame: Image8, gain: object) -> Image8:
    """Multiply sRGB values."""
    levels = np.broadcast_to(np.arange(256)[:, None] * np.asarray(gain), (256, 3))
    return np.asarray(cv2.LUT(frame, np.clip(np.rint(levels), 0, 255).astype(np.uint8)[None]), np.uint8)


def warp(frame: Image8, right: float = 0.0, down: float = 0.0, zoom: float = 1.0) -> Image8:
    """The picture displaced, and enlarged about its middle."""
    height, width = frame.shape[:2]
    move = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), 0, zoom)
    move[:, 2] += [right, down]
    return cv2.warpAffine(frame, move, (width, height), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)


def bump(right: float, down: float, at: int) -> Callable[[Frames], Frames]:
    """The camera is pushed at a frame."""
    return lambda frames: [*frames[:at], *(warp(frame, right, down) for frame in frames[at:])]


def expose(last: float) -> Callable[[Frames], Frames]:
    """The exposure grows from 1 to `last`."""
    return lambda frames: [brighten(frame, gain) for frame, gain in zip(frames, np.linspace(1, last, len(frames)), strict=True)]


def lose(at: int) -> Callable[[Frames], Frames]:
    """A frame is missing; the last one comes again, so that the count stays."""
    return lambda frames: [*frames[:at], *frames[at + 1 :], frames[-1]]
