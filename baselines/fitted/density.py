"""Density control: Gaussians are added where the image still pulls at them, and taken away where they are invisible."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ggvs_eval.baselines.fitted.state import FitState
from ggvs_eval.camera import Camera

SHRINK = 1.6  # a Gaussian that is split leaves two, smaller by this


@dataclass(frozen=True)
class DensityOptions:
    """Density control, by which Gaussians are added and taken away; the published values of 3D Gaussian splatting.

    Attributes:
        first: step of the first round.
        last: no round after this step.
        gradient: mean norm of the screen gradient, in units of half the image, from which on a Gaussian is not enough.
        large: largest standard deviation, in extents of the rig, from which on it is split instead of cloned.
        least_opacity: below it a Gaussian is taken away.
        most: Gaussians at most; those that the image pulls at most come first.
    """

    every: int = 100
    first: int = 500
    last: int = 4000
    gradient: float = 2e-4
    large: float = 0.01
    least_opacity: float = 0.005
    most: int = 60_000

    def is_due(self, step: int) -> bool:
        """Tell whether a round follows that many steps."""
        return self.first <= step <= self.last and step % self.every == 0


def watch_gradients(state: FitState, gradient_px: Tensor, radii: Tensor, camera: Camera) -> None:
    """Add what one view says to the statistic.

    Args:
        gradient_px: of the loss by the centres in the image, pixels, (M, 2) with M >= N; the fit's own come first.
        radii: in the image, 0 where not visible, (M,).
    """
    halves = torch.tensor(camera.size, dtype=torch.float32) / 2
    visible = (radii[: len(state)] > 0).float()
    state.gradient_sum += visible * (gradient_px[: len(state)] * halves.to(gradient_px)).norm(dim=1)
    state.visits += visible


def control_density(state: FitState, extent: float, options: DensityOptions, seed: int) -> None:
    """Clone small Gaussians and split large ones where the gradient is high; prune what is transparent.

    Args:
        extent: of the rig, world units.
    """
    with torch.no_grad():
        pull = state.gradient_sum / state.visits.clamp(min=1)
        opaque = torch.sigmoid(state.gaussians["opacity_logits"]) >= options.least_opacity
        dense = opaque & (pull >= options.gradient)
        room = max(0, options.most - int(opaque.sum()))
        if int(dense.sum()) > room:
            strongest = torch.sort(torch.where(dense, pull, -1), descending=True, stable=True).indices[:room]
            dense = torch.zeros_like(dense).index_fill_(0, strongest, value=True)
        large = state.gaussians["log_scales"].exp().amax(dim=1) > options.large * extent
        kept, cloned, split = (torch.nonzero(rows)[:, 0] for rows in (opaque & ~(dense & large), dense & ~large, dense & large))
        rows = torch.cat([kept, cloned, split, split])
        fresh = torch.arange(len(rows), device=rows.device) >= len(kept)
        state.take(rows, fresh)
        _scatter(state, 2 * len(split), seed)


def _scatter(state: FitState, count: int, seed: int) -> None:
    """Place the last Gaussians anew, each at random within itself, and shrink them."""
    if not count:
        return
    means, log_scales, quaternions = (state.gaussians[name].data[-count:] for name in ("means", "log_scales", "quaternions"))
    noise = torch.from_numpy(np.random.default_rng(seed).standard_normal((count, 3), dtype=np.float32)).to(means)
    means += rotated(quaternions, noise * log_scales.exp())
    log_scales -= float(np.log(SHRINK))


def rotated(quaternions: Tensor, vectors: Tensor) -> Tensor:
    """Vectors (N, 3) turned by quaternions of any length, w first, (N, 4): v + 2 w (q x v) + 2 q x (q x v)."""
    unit = torch.nn.functional.normalize(quaternions, dim=1)
    across = torch.linalg.cross(unit[:, 1:], vectors, dim=1)
    return vectors + 2 * (unit[:, :1] * across + torch.linalg.cross(unit[:, 1:], across, dim=1))
