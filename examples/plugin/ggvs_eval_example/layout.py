"""A layout: rig.json with K and world_to_camera of each camera, and a video CAM.mp4 of each."""

import json

import numpy as np

from ggvs_eval.camera import Camera
from ggvs_eval.datasets import DatasetSpec
from ggvs_eval.datasets.assemble import assemble_capture
from ggvs_eval.datasets.units import choose_units
from ggvs_eval.files.video import VideoFrames


def refuse(path):
    """Return the reason why a folder is not of this layout; None if it is."""
    return None if (path / "rig.json").is_file() else "no rig.json"


def load(path, units):
    """Open such a folder; `units` is what the user knows of the world's scale."""
    rig = json.loads((path / "rig.json").read_text())
    videos = {name: VideoFrames(path / f"{name}.mp4") for name in rig}
    cameras = [
        Camera(
            name,
            np.array(of["K"]),
            np.array(of["world_to_camera"]),
            *videos[name].size,
            of["near"],
            of["far"],
        )
        for name, of in rig.items()
    ]
    return assemble_capture(
        path, "rig-json", cameras, list(videos.values()), choose_units(path, units, cameras)
    )


RIG_JSON = DatasetSpec("rig.json with CAM.mp4", refuse, load, marks=("rig.json",))
