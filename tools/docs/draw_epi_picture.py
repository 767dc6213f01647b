"""Draw a good EPI and bad ones with their numbers, docs/images/epi_good_bad.jpg: ``python
tools/docs/draw_epi_picture.py``.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont

from ggvs_eval.camera import nearest_cameras
from ggvs_eval.contrib.worlds.film.film import Footage, lit_room
from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.contrib.worlds.film.raycast import rig
from ggvs_eval.contrib.worlds.film.shots import path_shots
from ggvs_eval.files.images import quantise
from ggvs_eval.geometry.warp import warp
from ggvs_eval.metrics.path.rendered_path import PathPose
from ggvs_eval.metrics.path.view_consistency import switch_steps
from ggvs_eval.metrics.path_scores import score_path

PICTURE = Path(__file__).parent / "images" / "epi_good_bad.jpg"
OPTIONS = DemoOptions(width=480, height=360, path_poses=48)
K_NEAREST = 4
GAIN, WOBBLE, BLUR_PX = 0.06, 0.03, 2.0
ROWS_PER_POSE, WIDTH, TITLE_HEIGHT, GAP, MARGIN = 2, 720, 24, 10, 8
SHOWN = {
    "coherence": "EPI_coherence",
    "line texture": "EPI_line_texture",
    "slope error": "EPI_slope_error",
    "agreeing": "EPI_slope_agreeing",
    "reprojection": "reprojection",
    "switch": "switch_ratio",
}


def main() -> None:
    """A frame with the row that is cut out, then the EPI of each rendering with its title and
    numbers.
    """
    truth = film_path()
    row = int(np.argmax(np.abs(np.diff(truth[24].image.astype(float), axis=1)).mean(axis=(1, 2))))
    renderings: dict[str, list[PathPose]] = {
        "Good: the true images": truth,
        "Bad: colours jump when the source cameras switch": changed(truth, gain_of_sources(truth)),
        "Bad: the depth wobbles by 3 % from pose to pose": wobbling(truth),
        "Bad: one frozen image": changed(truth, lambda pose, image: truth[24].image / 255.0),
        "Blurred: consistent, and told by line texture": changed(
            truth, lambda _, image: cv2.GaussianBlur(image, (0, 0), BLUR_PX)
        ),
    }
    panels = [frame_panel(truth[24].image, row)]
    panels += [epi_panel(title, poses, row) for title, poses in renderings.items()]
    height = sum(panel.height + GAP for panel in panels) + GAP
    canvas = Image.new("RGB", (WIDTH + 2 * MARGIN, height), "white")
    top = GAP
    for panel in panels:
        canvas.paste(panel, (MARGIN, top))
        top += panel.height + GAP
    canvas.save(PICTURE, quality=58, optimize=True)
    print(PICTURE, PICTURE.stat().st_size, "bytes")


def film_path() -> list[PathPose]:
    """The demo's true camera path with exact depth.

    Each pose names its nearest cameras, as a method would use them.
    """
    instant = lit_room(OPTIONS.seed).at(OPTIONS.path_frame / OPTIONS.fps)
    cameras = rig(OPTIONS.seed, OPTIONS.width, OPTIONS.height, OPTIONS.cameras_per_row)
    poses = []
    for shot in path_shots(OPTIONS):
        frame = next(Footage(OPTIONS, replace(shot, instants=(0,)), lambda _: instant).frames())
        near, far = np.percentile(frame.depth[frame.depth > 0], [1.0, 99.9])
        sources = [camera.name for camera in nearest_cameras(shot.camera, cameras, K_NEAREST)]
        poses.append(
            PathPose(replace(shot.camera, near=near, far=far), frame.image, frame.depth, sources)
        )
    return poses


def changed(
    poses: list[PathPose], change: Callable[[int, np.ndarray], np.ndarray]
) -> list[PathPose]:
    """The same poses with other images in [0, 1]."""
    return [
        replace(pose, image=quantise(change(index, pose.image / 255.0)))
        for index, pose in enumerate(poses)
    ]


def gain_of_sources(poses: list[PathPose]) -> Callable[[int, np.ndarray], np.ndarray]:
    """Brightness that alternates with every change of the source cameras, as when their exposures
    differ.
    """
    level = np.concatenate([[0], np.cumsum(switch_steps([pose.sources for pose in poses]))])
    return lambda pose, image: image * (1 + GAIN * (-1) ** level[pose])


def wobbling(poses: list[PathPose]) -> list[PathPose]:
    """Every pose rendered from the first pose's image with a depth that is wrong by another
    factor.
    """
    factors = 1 + WOBBLE * np.random.default_rng(0).uniform(-1, 1, len(poses))
    first, colours = poses[0], poses[0].image.astype(np.float32) / 255

    def render(index: int, image: np.ndarray) -> np.ndarray:
        pose = poses[index]
        depth = np.asarray(pose.depth, np.float32) * np.float32(factors[index])
        first_depth = np.asarray(first.depth, np.float32)
        warped = warp(
            pose.camera,
            depth,
            first.camera,
            colours,
            first_depth,
            0.1 * float(np.median(depth)),
            bicubic=True,
        )
        return np.where(warped.visibility[..., None] > 0.5, warped.colour, image)

    return changed(poses, render)


def frame_panel(image: np.ndarray, row: int) -> Image.Image:
    """The middle pose, with the row that the EPIs show."""
    frame = Image.fromarray(image)
    ImageDraw.Draw(frame).line([(0, row), (frame.width, row)], fill=(255, 230, 0), width=2)
    frame = frame.crop((0, max(row - 70, 0), frame.width, max(row - 70, 0) + 140)).resize(
        (WIDTH, WIDTH * 140 // frame.width)
    )
    return titled("The row that is cut out of every pose, in the middle pose", "", frame)


def epi_panel(title: str, poses: list[PathPose], row: int) -> Image.Image:
    """The EPI of a rendering, poses from top to bottom, and its numbers."""
    scores = score_path(poses)
    values = {name: value for name, pose, value in scores.values if pose is None}
    numbers = "   ".join(
        f"{label} {values[name]:.2f}" for label, name in SHOWN.items() if name in values
    )
    print(
        title,
        {name: round(value, 3) for name, value in values.items()},
        scores.n_switches,
        scores.not_computed,
    )
    epi = Image.fromarray(np.stack([pose.image[row] for pose in poses]))
    return titled(
        title, numbers, epi.resize((WIDTH, len(poses) * ROWS_PER_POSE), Image.Resampling.NEAREST)
    )


def titled(title: str, numbers: str, picture: Image.Image) -> Image.Image:
    """A picture under a title and a line of numbers."""
    bold, plain = (
        ImageFont.truetype(
            font_manager.findfont(font_manager.FontProperties(family="DejaVu Sans", weight=weight)),
            size,
        )
        for weight, size in (("bold", 14), ("normal", 12))
    )
    top = TITLE_HEIGHT + (20 if numbers else 0)
    panel = Image.new("RGB", (picture.width, picture.height + top), "white")
    draw = ImageDraw.Draw(panel)
    draw.text((0, 3), title, fill="black", font=bold)
    draw.text((0, TITLE_HEIGHT), numbers, fill="black", font=plain)
    panel.paste(picture, (0, top))
    return panel


if __name__ == "__main__":
    main()
