"""One step of a 4DGS fit: the deformation field by its kernel, against its torch twin in the same
run.

``python -m benchmarks.bench_fit`` prints the figures and the load of the machine: fastest steps,
the kernel's and the twin's in turn, on the cloud and camera of `bench_gaussians`, with harmonics of
degree 1 as in fits. The twin has one thread, as there.
"""

import os
import time
from collections.abc import Sequence
from contextlib import nullcontext
from typing import Any
from unittest.mock import patch

import torch
from torch import Tensor, nn

from benchmarks.bench_gaussians import make_cloud
from ggvs_eval.baselines.fitted import hexplane
from ggvs_eval.baselines.fitted.optimiser import photometric_loss
from ggvs_eval.baselines.fitted.scene import HexPlaneMotion
from ggvs_eval.baselines.fitted.state import FitState, box_of
from ggvs_eval.camera import Camera
from ggvs_eval.compute_device import one_thread
from ggvs_eval.gaussians import GaussianCloud, render_gaussians
from ggvs_eval.kernels import get_threads

TERMS, INSTANTS, REPEATS = 4, 24, 9
COMMAND = "python -m benchmarks.bench_fit"


def measure() -> dict[str, dict[str, Any]]:
    """Return the milliseconds of the field and for the whole step, name -> figure."""
    cloud, camera = make_cloud()
    torch.manual_seed(0)
    gaussians = {**cloud.parameters(), "sh_base": cloud.sh[:, :1], "sh_rest": cloud.sh[:, 1:TERMS]}
    del gaussians["sh"]
    network = hexplane.DeformationNetwork(box_of(cloud.means), hexplane.compact(INSTANTS, 1))
    state = FitState(gaussians, HexPlaneMotion(network))
    times: dict[str, list[tuple[float, float]]] = {"kernel": [], "twin": []}
    with one_thread():
        for _ in range(REPEATS):
            for name, each in times.items():
                with (
                    patch.object(hexplane, "field_outputs", _twin)
                    if name == "twin"
                    else nullcontext()
                ):
                    each.append(_step_ms(state, camera))
    (field, step), (twin_field, twin_step) = (
        tuple(map(min, zip(*each, strict=True))) for each in times.values()
    )
    return {"fit_field": _figure(field, twin_field), "fit_step": _figure(step, twin_step)}


def _twin(
    grid: hexplane.PlaneGrid,
    trunk: nn.Linear,
    heads: Sequence[nn.Sequential],
    points: Tensor,
    at: float,
) -> tuple[Tensor, ...]:
    """Compute `hexplane.field_outputs` without the kernel."""
    features = trunk(grid(points, at))
    return tuple(head(features) for head in heads)


def _step_ms(state: FitState, camera: Camera) -> tuple[float, float]:
    """Return the milliseconds of the field forward and backward, and for the step that it is part
    of.
    """
    truth = torch.full((camera.height, camera.width, 3), 0.5)
    times = [time.perf_counter()]
    cloud = state.motion.cloud(state.gaussians, 0.4)
    times.append(time.perf_counter())
    cut = {name: tensor.detach().requires_grad_() for name, tensor in cloud.parameters().items()}
    photometric_loss(render_gaussians(GaussianCloud(**cut), camera).image, truth).backward()
    times.append(time.perf_counter())
    state.optimiser.zero_grad(set_to_none=True)
    outputs = [(tensor, cut[name].grad) for name, tensor in cloud.parameters().items()]
    torch.autograd.backward(*zip(*outputs, strict=True))
    times.append(time.perf_counter())
    state.motion.penalty().backward()
    state.optimiser.step()
    start, moved, rendered, returned, stepped = (
        1000 * each for each in (*times, time.perf_counter())
    )
    return moved - start + returned - rendered, stepped - start


def _figure(value: float, twin: float) -> dict[str, Any]:
    entry = {
        "value": value,
        "unit": "ms",
        "target": None,
        "higher_is_better": False,
        "command": COMMAND,
    }
    return entry | {"peer": "torch twin, same run", "peer_value": twin, "ratio": twin / value}


if __name__ == "__main__":
    print(
        f"{get_threads()} threads, load {', '.join(f'{load:.1f}' for load in os.getloadavg())} "
        f"before"
    )
    for name, figure in measure().items():
        print(
            f"{name}: {figure['value']:.4g} ms; {figure['peer']}: {figure['peer_value']:.4g}, "
            f"ratio {figure['ratio']:.3g}"
        )
