"""The layouts in which the demo can be written."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ggvs_eval.camera import Camera
from ggvs_eval.contrib.worlds.film.film import Footage
from ggvs_eval.contrib.worlds.film.options import DemoOptions, LayoutName
from ggvs_eval.contrib.worlds.film.rig import UNITS_PER_METRE
from ggvs_eval.contrib.worlds.film.shots import (
    Shot,
    distorted_shots,
    fisheye_shots,
    hand_held_shots,
    rig_and_path_shots,
    rig_shots,
)
from ggvs_eval.contrib.worlds.layouts import colmap, d3dmv, dynerf, enerf, immersive, meetroom, panoptic, rgbd, technicolor


@dataclass(frozen=True)
class Layout:
    """Writer of one layout.

    Attributes:
        units_per_metre: world units of its calibration per metre.
        shots: what is rendered, in the order of the calibration.
        write_shot: writes the frames of one shot into the folder, in any process; gives the camera as it is to be noted.
        finish: writes what wants all cameras, once all shots are written.
        files: names of files that every complete demo has.
    """

    units_per_metre: float
    shots: Callable[[DemoOptions], list[Shot]]
    write_shot: Callable[[Path, Footage], Camera]
    finish: Callable[[Path, DemoOptions, Sequence[Camera]], None]
    files: Callable[[DemoOptions], list[str]]


LAYOUTS: dict[LayoutName, Layout] = {
    "dynerf": Layout(UNITS_PER_METRE, rig_and_path_shots, dynerf.write_film, dynerf.finish, dynerf.files),
    "enerf-outdoor": Layout(1.0, distorted_shots, enerf.write_shot, enerf.finish, enerf.files),
    "d3dmv": Layout(UNITS_PER_METRE, rig_shots, d3dmv.write_shot, d3dmv.finish, d3dmv.files),
    "colmap": Layout(UNITS_PER_METRE, rig_and_path_shots, colmap.write_shot, colmap.finish, colmap.files),
    "rgbd": Layout(1.0, hand_held_shots, rgbd.write_shot, rgbd.finish, rgbd.files),
    "meetroom": Layout(UNITS_PER_METRE, rig_shots, meetroom.write_film, meetroom.finish, meetroom.files),
    "technicolor": Layout(UNITS_PER_METRE, rig_shots, technicolor.write_shot, technicolor.finish, technicolor.files),
    "immersive": Layout(1.0, fisheye_shots, immersive.write_film, immersive.finish, immersive.files),
    "panoptic": Layout(1.0, rig_shots, panoptic.write_shot, panoptic.finish, panoptic.files),
}
