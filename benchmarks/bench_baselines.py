"""Time of a baseline's compiled part against torch: ``python -m benchmarks.bench_baselines``.

Both are timed by turns in one run on one thread, and the fastest call counts.
"""

import copy
import json
import time
from typing import Any

import numpy as np
import torch

from ggvs_eval.baselines.ibrnet.network import load_ibrnet
from ggvs_eval.baselines.ibrnet.rendering import depth_range, render_rays, see
from ggvs_eval.camera import Camera
from ggvs_eval.compute_device import one_thread
from ggvs_eval.method import Instant, SourceView
from ggvs_eval.pipelines.methods.spec import shipped

WIDTH, HEIGHT, K, RAYS, ROUNDS = 480, 360, 4, 512, 3
BASELINE_M, NEAR, FAR = 0.2, 2.0, 6.0
Figure = dict[str, Any]


def measure() -> dict[str, Figure]:
    """Return the seconds that IBRNet, compact, needs for a 480x360 picture from four views, from a
    strip of its rays.
    """
    compiled = load_ibrnet(shipped("ibrnet.safetensors"))
    # gradients are what the compiled network has not
    of_torch = copy.deepcopy(compiled).requires_grad_(True)
    instant = _instant()
    centre = torch.from_numpy(instant.target.centre).float()
    rays = torch.from_numpy(
        instant.target.rays().reshape(-1, 3)[: WIDTH * HEIGHT // 2 + RAYS][-RAYS:]
    ).float()
    seconds = {"compiled": np.inf, "torch": np.inf}
    with one_thread():
        with torch.no_grad():
            views = see(compiled, instant.sources)
        for _ in range(ROUNDS):
            for name, networks in (("compiled", compiled), ("torch", of_torch)):
                begun_s = time.perf_counter()
                render_rays(networks, views, centre, rays, *depth_range(instant))
                seconds[name] = min(
                    seconds[name], (time.perf_counter() - begun_s) * WIDTH * HEIGHT / RAYS
                )
    peer = {
        "peer": "torch, with gradients",
        "peer_value": seconds["torch"],
        "ratio": seconds["torch"] / seconds["compiled"],
    }
    figure = {"value": seconds["compiled"], "unit": "s", "higher_is_better": False}
    return {"baselines.ibrnet_480x360_s": figure | peer}


def _instant() -> Instant:
    """Return the noise, seen by cameras in a row."""
    rng = np.random.default_rng(0)
    focal = 1.2 * WIDTH
    intrinsics = np.array([[focal, 0, WIDTH / 2], [0, focal, HEIGHT / 2], [0, 0, 1]])
    cameras = []
    for number in range(K + 1):
        pose = np.eye(4)
        pose[0, 3] = -BASELINE_M * (number - K / 2)
        cameras.append(Camera(f"cam{number}", intrinsics, pose, WIDTH, HEIGHT, NEAR, FAR))
    target = cameras.pop(K // 2)
    unknown = np.zeros((HEIGHT, WIDTH), np.float32)
    sources = [
        SourceView(each, rng.integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8), unknown, unknown)
        for each in cameras
    ]
    return Instant(0, target, tuple(sources), 1.0)


if __name__ == "__main__":
    print(json.dumps(measure(), indent=1))
