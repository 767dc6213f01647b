"""The differentiable splat of 3D Gaussians at 480 x 360, forward and backward, against its torch
twin in the same run.

``python -m benchmarks.bench_gaussians`` prints the figures and the load of the machine; ``--gpu``
takes the torch path on a GPU instead of the twin on the CPU, and how far its numbers are from the
kernel's.
"""

import os
import sys
import time
from collections.abc import Callable
from typing import Any

import torch

from benchmarks.bench_geometry import make_scene
from ggvs_eval.camera import Camera
from ggvs_eval.gaussians import GaussianCloud, render, torch_splat
from ggvs_eval.kernels import get_threads
from ggvs_eval.method import NEAR_M

GAUSSIANS, WIDTH, HEIGHT, DEGREE = 60_000, 480, 360, 3
TARGET_MS = 60.0  # forward and backward, 2 cores
COMMAND = "python -m benchmarks.bench_gaussians"
Splat = Callable[..., tuple[torch.Tensor, ...]]


def measure() -> dict[str, dict[str, Any]]:
    """Return the milliseconds of the kernel and of its twin on the CPU, name -> figure."""
    cloud, camera = make_cloud()
    ours, twin = (
        step_ms(render.splat_compiled, cloud, camera, 15),
        step_ms(torch_splat.splat, cloud, camera, 2),
    )
    return {
        "gaussians_forward": _figure(ours[0], None, twin[0]),
        "gaussians_forward_backward": _figure(sum(ours), TARGET_MS, sum(twin)),
    }


def make_cloud() -> tuple[GaussianCloud, Camera]:
    """Gaussians on the surfaces of a room as four cameras see them, about as large as their
    distance: an optimiser's, half way.

    Returns:
        The cloud, of mixed opacities and of axes that differ by factors of 2 or so, and a fifth
        camera.
    """
    draw = torch.Generator().manual_seed(0)
    scene = make_scene(WIDTH)
    picked = []
    for camera, depth in zip(scene.cameras, scene.depths, strict=True):
        points = (
            torch.from_numpy(camera.unproject(camera.pixel_centres(), depth.astype(float)))
            .float()
            .reshape(-1, 3)
        )
        picked.append(
            points[torch.randperm(len(points), generator=draw)[: GAUSSIANS // len(scene.cameras)]]
        )
    means = torch.cat(picked)
    # metres between neighbours
    spacing = (means.norm(dim=1) / scene.target.focal_px) * (WIDTH * HEIGHT / GAUSSIANS) ** 0.5
    cloud = GaussianCloud.of_points(
        means, torch.rand(GAUSSIANS, 3, generator=draw), scale=spacing, degree=DEGREE
    )
    cloud.log_scales.add_(0.5 * torch.randn(GAUSSIANS, 3, generator=draw))
    cloud.quaternions.copy_(torch.randn(GAUSSIANS, 4, generator=draw))
    cloud.opacity_logits.copy_(2 * torch.randn(GAUSSIANS, generator=draw))
    cloud.sh[:, 1:].copy_(0.1 * torch.randn(GAUSSIANS, (DEGREE + 1) ** 2 - 1, 3, generator=draw))
    target = scene.target
    return cloud, target.cropped(0, (target.height - HEIGHT) // 2, WIDTH, HEIGHT)


def step_ms(
    splat: Splat, cloud: GaussianCloud, camera: Camera, repeats: int
) -> tuple[float, float]:
    """Fastest forward and backward pass of some repeats, with the derivatives of all parameters and
    of the screen offsets.
    """
    device = cloud.means.device
    leaves = {
        name: tensor.detach().clone().requires_grad_()
        for name, tensor in cloud.parameters().items()
    }
    offsets = torch.zeros(len(cloud), 2, device=device, requires_grad=True)
    times = []
    for _ in range(repeats):
        for leaf in (*leaves.values(), offsets):
            leaf.grad = None
        start = _now(device)
        colour, transmittance, _, _ = splat(GaussianCloud(**leaves), camera, NEAR_M, offsets)
        middle = _now(device)
        (colour + transmittance[..., None]).mean().backward()
        times.append((middle - start, _now(device) - middle))
    return min(each[0] for each in times) * 1000, min(each[1] for each in times) * 1000


def gpu_figures() -> dict[str, dict[str, Any]]:
    """Return the milliseconds of the torch path on a GPU, next to the kernel's, and the largest
    difference of their images.
    """
    cloud, camera = make_cloud()
    there = cloud.to("cuda")
    ours, peer = (
        step_ms(render.splat_compiled, cloud, camera, 5),
        step_ms(torch_splat.splat, there, camera, 5),
    )
    images = [
        splat(each, camera, NEAR_M, None)[0]
        for splat, each in ((render.splat_compiled, cloud), (torch_splat.splat, there))
    ]
    difference = float((images[0] - images[1].cpu()).abs().max())
    return {
        "gaussians_forward_backward": _figure(
            sum(ours), TARGET_MS, sum(peer), torch.cuda.get_device_name()
        ),
        "gaussians_gpu_difference": _figure(difference, 1e-3, None) | {"unit": "of white"},
    }


def _now(device: torch.device) -> float:
    if device.type == "cuda":
        torch.cuda.synchronize(device)
    return time.perf_counter()


def _figure(
    value: float, target: float | None, peer_value: float | None, peer: str = "torch twin, same run"
) -> dict[str, Any]:
    entry = {
        "value": value,
        "unit": "ms",
        "target": target,
        "higher_is_better": False,
        "command": COMMAND,
    }
    ratio = None if peer_value is None else peer_value / value
    return entry | {"peer": peer if ratio else None, "peer_value": peer_value, "ratio": ratio}


if __name__ == "__main__":
    print(
        f"{get_threads()} threads, load {', '.join(f'{load:.1f}' for load in os.getloadavg())} "
        f"before"
    )
    for name, figure in (gpu_figures() if "--gpu" in sys.argv[1:] else measure()).items():
        peer = (
            f"; {figure['peer']}: {figure['peer_value']:.4g}, ratio {figure['ratio']:.3g}"
            if figure["peer"]
            else ""
        )
        print(f"{name}: {figure['value']:.4g} {figure['unit']}{peer}")
