"""The online method behind a live rig: images and depth of every camera come in as arrays, one
picture goes out.

Put your own cameras and drivers where `camera_at` and `grab` are. The time of each picture is
printed, the last one is view.png:

    python examples/live_rig.py
"""

import time
from pathlib import Path

import numpy as np

from ggvs_eval import OnlineSynthesizer
from ggvs_eval.camera import Camera
from ggvs_eval.files.images import quantise, write_image

WIDTH, HEIGHT, FOCAL_PX, WALL_M = 320, 240, 300.0, 2.0
K = np.array([[FOCAL_PX, 0, WIDTH / 2], [0, FOCAL_PX, HEIGHT / 2], [0, 0, 1]])  # pixels


def camera_at(name: str, x_m: float) -> Camera:
    """Return the camera at (x, 0, 0) that looks along z."""
    world_to_camera = np.eye(4)
    world_to_camera[:3, 3] = -world_to_camera[:3, :3] @ [x_m, 0, 0]  # t = -R c
    return Camera(name, K, world_to_camera, WIDTH, HEIGHT, near=1.0, far=4.0)


rig = [camera_at(f"cam{number}", 0.2 * number) for number in range(4)]
wall = quantise(np.kron(np.random.default_rng(0).random((HEIGHT // 8, 60, 3)), np.ones((8, 8, 1))))


def grab() -> tuple[dict, dict]:
    """Current image and depth of each camera: call your drivers here."""
    lefts = {camera.name: round(FOCAL_PX * camera.centre[0] / WALL_M) for camera in rig}
    images = {name: wall[:, left : left + WIDTH] for name, left in lefts.items()}
    return images, {name: np.full((HEIGHT, WIDTH), WALL_M, np.float32) for name in lefts}


synthesizer = OnlineSynthesizer(rig, k=2, units_per_metre=1.0)
synthesizer.step(*grab(), camera_at("view", 0.3))  # warm up: the first step loads the network
synthesizer.restart()
for step in range(3):
    begun = time.perf_counter()
    rendering = synthesizer.step(*grab(), camera_at("view", 0.3 + 0.02 * step))
    picture = quantise(rendering.image)  # (240, 320, 3), RGB uint8: show it
    steps = {name: f"{1000 * s:.0f} ms" for name, s in rendering.seconds.items()}
    print(f"{time.perf_counter() - begun:.2f} s", steps)
write_image(Path("view.png"), picture)
