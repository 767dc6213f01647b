"""The layouts in which the demo can be written."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ggvs_eval.camera import Camera
from ggvs_eval.contrib.worlds.film.film import Footage
from ggvs_eval.contrib.worlds.film.options import DemoOptions, LayoutName
from ggvs_eval.contrib.worlds.film.raycast import UNITS_PER_METRE
from ggvs_eval.contrib.worlds.film.shots import (
    Shot,
    distorted_shots,
    fisheye_shots,
    hand_held_shots,
    rig_and_path_shots,
    rig_shots,
)
from ggvs_eval.contrib.worlds.layouts.enerf import enerf_files, finish_enerf, write_enerf
from ggvs_eval.contrib.worlds.layouts.pictures import (
    d3dmv_files,
    finish_d3dmv,
    finish_panoptic,
    finish_rgbd,
    finish_technicolor,
    panoptic_files,
    rgbd_files,
    technicolor_files,
    write_d3dmv,
    write_panoptic,
    write_rgbd,
    write_technicolor,
)
from ggvs_eval.contrib.worlds.layouts.videos import (
    colmap_files,
    dynerf_files,
    finish_colmap,
    finish_dynerf,
    finish_immersive,
    finish_meetroom,
    immersive_files,
    meetroom_files,
    write_colmap,
    write_dynerf,
    write_immersive,
    write_meetroom,
)


@dataclass(frozen=True)
class Layout:
    """Writer of one layout.

    Attributes:
        units_per_metre: world units of its calibration per metre.
        shots: what is rendered, in the order of the calibration.
        write_shot: writes the frames of one shot into the folder, in any process; gives the camera
            as it is to be noted.
        finish: writes what wants all cameras, once all shots are written.
        files: names of files that every complete demo has.
    """

    units_per_metre: float
    shots: Callable[[DemoOptions], list[Shot]]
    write_shot: Callable[[Path, Footage], Camera]
    finish: Callable[[Path, DemoOptions, Sequence[Camera]], None]
    files: Callable[[DemoOptions], list[str]]


LAYOUTS: dict[LayoutName, Layout] = {
    "dynerf": Layout(
        units_per_metre=UNITS_PER_METRE,
        shots=rig_and_path_shots,
        write_shot=write_dynerf,
        finish=finish_dynerf,
        files=dynerf_files,
    ),
    "enerf-outdoor": Layout(
        units_per_metre=1.0,
        shots=distorted_shots,
        write_shot=write_enerf,
        finish=finish_enerf,
        files=enerf_files,
    ),
    "d3dmv": Layout(
        units_per_metre=UNITS_PER_METRE,
        shots=rig_shots,
        write_shot=write_d3dmv,
        finish=finish_d3dmv,
        files=d3dmv_files,
    ),
    "colmap": Layout(
        units_per_metre=UNITS_PER_METRE,
        shots=rig_and_path_shots,
        write_shot=write_colmap,
        finish=finish_colmap,
        files=colmap_files,
    ),
    "rgbd": Layout(
        units_per_metre=1.0,
        shots=hand_held_shots,
        write_shot=write_rgbd,
        finish=finish_rgbd,
        files=rgbd_files,
    ),
    "meetroom": Layout(
        units_per_metre=UNITS_PER_METRE,
        shots=rig_shots,
        write_shot=write_meetroom,
        finish=finish_meetroom,
        files=meetroom_files,
    ),
    "technicolor": Layout(
        units_per_metre=UNITS_PER_METRE,
        shots=rig_shots,
        write_shot=write_technicolor,
        finish=finish_technicolor,
        files=technicolor_files,
    ),
    "immersive": Layout(
        units_per_metre=1.0,
        shots=fisheye_shots,
        write_shot=write_immersive,
        finish=finish_immersive,
        files=immersive_files,
    ),
    "panoptic": Layout(
        units_per_metre=1.0,
        shots=rig_shots,
        write_shot=write_panoptic,
        finish=finish_panoptic,
        files=panoptic_files,
    ),
}
