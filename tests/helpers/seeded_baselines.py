"""Seeded weights and a small turned rig, so that a test here and a run of another project elsewhere
see the same.
"""

from dataclasses import replace

import numpy as np
import torch

from ggvs_eval.camera import Camera
from ggvs_eval.method import Instant, SourceView
from helpers.scenes import camera_at, look
from helpers.seeded_networks import seeded_state

PLACES = ((-0.4, 0.1), (0.35, -0.2), (0.1, 0.4), (-0.2, -0.4), (0.6, 0.3))


def seed_weights(network: torch.nn.Module) -> torch.nn.Module:
    """Weights drawn by their names; what scales a normalised feature lies around one, so that
    signals pass through.
    """
    shapes = {name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}
    state = seeded_state(shapes)
    normalised = {
        name.rpartition(".")[0]
        for name, shape in shapes.items()
        if name.endswith(".weight") and len(shape) == 1
    }
    for name in (f"{module}.weight" for module in normalised):
        state[name] = state[name] + 1
    network.load_state_dict(state)
    return network.eval()


def turned(camera: Camera, yaw_rad: float) -> Camera:
    """The camera turned about its own vertical axis."""
    cosine, sine = np.cos(yaw_rad), np.sin(yaw_rad)
    turn = np.array([[cosine, 0, -sine, 0], [0, 1, 0, 0], [sine, 0, cosine, 0], [0, 0, 0, 1]])
    return replace(camera, world_to_camera=turn @ camera.world_to_camera)


def turned_rig(views: int, width: int = 96, height: int = 64) -> Instant:
    """What a method is shown of a wall and a square by cameras that look inwards."""
    target = turned(camera_at(0.05, 0.05, "target", width, height), 0.02)
    cameras = [
        turned(camera_at(x, y, f"cam{i}", width, height), 0.1 * x)
        for i, (x, y) in enumerate(PLACES[:views])
    ]
    seen = [(camera, *look(camera)) for camera in cameras]
    sources = tuple(
        SourceView(camera, image, depth, np.ones_like(depth)) for camera, image, depth in seen
    )
    return Instant(0, target, sources, units_per_metre=2.5)
