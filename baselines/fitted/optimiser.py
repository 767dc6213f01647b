"""The one optimiser of all fitted methods: image by image, Adam on Gaussians and their motion, with
density control.

The loss is 0.8 L1 + 0.2 (1 - SSIM), its gradient in closed form on a CPU. Gaussians are added where
the image still pulls at them, and taken away where they are invisible.
"""

from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ggvs_eval.baselines.fitted.scene import canonical
from ggvs_eval.baselines.fitted.shots import Shot, Shots
from ggvs_eval.baselines.fitted.state import RATES, SHARED, FitState
from ggvs_eval.baselines.fitted.training_log import TrainingLog, draw_curves
from ggvs_eval.camera import Camera
from ggvs_eval.errors import RenderError
from ggvs_eval.gaussians.render import render_gaussians
from ggvs_eval.scene_fitter import Progress, SceneFitter

STRUCTURE = 0.2  # its share in the loss
WINDOW, SIGMA_PX = 11, 1.5
MARGIN = WINDOW // 2
C1, C2 = 0.01**2, 0.03**2
# standard deviation, in extents of the rig, from which on a Gaussian is split instead of cloned
LARGE = 0.01
SHRINK = 1.6  # a Gaussian that is split leaves two, smaller by this
# of the first one, at the last step: of lengths, and of what all share
LAST_LENGTH_RATE, LAST_SHARED_RATE = 0.01, 0.1
WATCHED = 4  # training images whose PSNR is the curve


def photometric_loss(image: Tensor, truth: Tensor, share: float = STRUCTURE) -> Tensor:
    """Return the mean absolute difference, mixed with 1 - SSIM.

    Args:
        image: rendered, (H, W, 3), at least 11 x 11.
        truth: captured, same shape, in [0, 1].
        share: of 1 - SSIM.

    Reading:
        SSIM is that of the metric (11 x 11 Gaussian window, whole windows only), where the
        published codes pad with zeros.
    """
    difference = (image - truth).abs().mean()
    if not share:
        return difference
    if image.device.type == "cpu":
        structure = 1 - _MeanSsim.apply(image, truth)
    else:
        structure = structural_loss(image.permute(2, 0, 1)[None], truth.permute(2, 0, 1)[None])
    return (1 - share) * difference + share * structure


def structural_loss(image: Tensor, truth: Tensor) -> Tensor:
    """1 - SSIM, with the window and constants of the metric `ggvs_eval.metrics.image.ssim`.

    Args:
        image: (B, 3, H, W), at least 11 x 11.
    """
    from kornia.metrics import ssim

    return 1 - ssim(image, truth, window_size=11, max_val=1.0, eps=0.0, padding="valid").mean()


class _MeanSsim(torch.autograd.Function):
    """Mean SSIM of two images with its derivative by the first: five times as fast as through
    torch's convolutions.

    With x, y the images, G the window's blur and mx = G x, my = G y, exx = G x^2, eyy = G y^2, exy
    = G xy: S = (2 mx my + C1) (2 (exy - mx my) + C2) / ((mx^2 + my^2 + C1) (exx - mx^2 + eyy - my^2
    + C2)).
    """

    @staticmethod
    def forward(ctx: Any, image: Tensor, truth: Tensor) -> Tensor:
        """Return the mean, and keep its derivative."""
        x, y = image.detach().numpy(), truth.numpy()
        mx, my, exy = _blurred(x), _blurred(y), _blurred(x * y)
        squares = _blurred(x * x + y * y)
        means = mx * mx + my * my
        a1, a2 = 2 * mx * my + C1, 2 * (exy - mx * my) + C2
        b1, b2 = means + C1, squares - means + C2
        ssim = a1 * a2 / (b1 * b2)
        inside = (slice(MARGIN, -MARGIN),) * 2
        share = np.zeros_like(ssim)
        share[inside] = 1 / ssim[inside].size
        by_mean = share * (2 * my * (a2 - a1) / (b1 * b2) - 2 * mx * ssim * (1 / b1 - 1 / b2))
        by_square, by_product = share * (-ssim / b2), share * (2 * a1 / (b1 * b2))
        gradient = _blurred(by_mean) + 2 * x * _blurred(by_square) + y * _blurred(by_product)
        ctx.save_for_backward(torch.from_numpy(gradient))
        return torch.tensor(ssim[inside].mean(dtype=np.float64), dtype=torch.float32)

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None]:
        """Return the derivative times what comes from above."""
        (gradient,) = ctx.saved_tensors
        return upstream * gradient, None


def _blurred(image: NDArray[np.floating]) -> NDArray[np.floating]:
    return cv2.GaussianBlur(
        np.ascontiguousarray(image), (WINDOW, WINDOW), SIGMA_PX, borderType=cv2.BORDER_CONSTANT
    )


@dataclass(frozen=True)
class DensitySchedule:
    """Density control, by which Gaussians are added and taken away.

    The published values of 3D Gaussian splatting.

    Attributes:
        first: step of the first round.
        last: no round after this step.
        gradient: mean norm of the screen gradient, in units of half the image, from which on a
            Gaussian is not enough.
        least_opacity: below it a Gaussian is taken away.
        most: Gaussians at most; those that the image pulls at most come first.
    """

    every: int = 100
    first: int = 500
    last: int = 4000
    gradient: float = 2e-4
    least_opacity: float = 0.005
    most: int = 60_000

    def is_due(self, step: int) -> bool:
        """Return whether a round follows that many steps."""
        return self.first <= step <= self.last and step % self.every == 0


def watch_gradients(state: FitState, gradient_px: Tensor, radii: Tensor, camera: Camera) -> None:
    """Add what one view says to the statistic.

    Args:
        gradient_px: of the loss by the centres in the image, pixels, (M, 2) with M >= N; the fit's
            own come first.
        radii: in the image, 0 where not visible, (M,).
    """
    halves = torch.tensor(camera.size, dtype=torch.float32) / 2
    visible = (radii[: len(state)] > 0).float()
    state.gradient_sum += visible * (gradient_px[: len(state)] * halves.to(gradient_px)).norm(dim=1)
    state.visits += visible


def control_density(state: FitState, extent: float, options: DensitySchedule, seed: int) -> None:
    """Clone small Gaussians and split large ones where the gradient is high.

    Prune what is transparent.

    Args:
        extent: of the rig, world units.
    """
    with torch.no_grad():
        pull = state.gradient_sum / state.visits.clamp(min=1)
        opaque = torch.sigmoid(state.gaussians["opacity_logits"]) >= options.least_opacity
        dense = opaque & (pull >= options.gradient)
        room = max(0, options.most - int(opaque.sum()))
        if int(dense.sum()) > room:
            strongest = torch.sort(
                torch.where(dense, pull, -1), descending=True, stable=True
            ).indices[:room]
            dense = torch.zeros_like(dense).index_fill_(0, strongest, value=True)
        large = state.gaussians["log_scales"].exp().amax(dim=1) > LARGE * extent
        unsplit, cloned, split = (
            torch.nonzero(rows)[:, 0]
            for rows in (opaque & ~(dense & large), dense & ~large, dense & large)
        )
        rows = torch.cat([unsplit, cloned, split, split])
        fresh = torch.arange(len(rows), device=rows.device) >= len(unsplit)
        state.take(rows, fresh)
        _scatter(state, 2 * len(split), seed)


def _scatter(state: FitState, count: int, seed: int) -> None:
    """Place the last Gaussians anew, each at random within itself, and shrink them."""
    if not count:
        return
    means, log_scales, quaternions = (
        state.gaussians[name].data[-count:] for name in ("means", "log_scales", "quaternions")
    )
    noise = torch.from_numpy(
        np.random.default_rng(seed).standard_normal((count, 3), dtype=np.float32)
    ).to(means)
    means += rotated(quaternions, noise * log_scales.exp())
    log_scales -= float(np.log(SHRINK))


def rotated(quaternions: Tensor, vectors: Tensor) -> Tensor:
    """Return the vectors (N, 3) turned by quaternions of any length, w first, (N, 4): v + 2 w (q x
    v) + 2 q x (q x v).
    """
    unit = torch.nn.functional.normalize(quaternions, dim=1)
    across = torch.linalg.cross(unit[:, 1:], vectors, dim=1)
    return vectors + 2 * (unit[:, :1] * across + torch.linalg.cross(unit[:, 1:], across, dim=1))


@dataclass(frozen=True, kw_only=True)
class GaussianFitter(SceneFitter):
    """A fitter of Gaussians, with the options that all of them share.

    Attributes:
        points: first points at most.
        most: Gaussians at most.
        structure: share of 1 - SSIM in the loss; 0 for L1 alone, as the authors of 4DGS.
        device: where it is fitted and rendered.
    """

    points: int = 30_000
    most: int = 60_000
    degree: int = 1
    structure: float = STRUCTURE
    save_every: int = 500
    device: str = "cpu"

    def require_counts(self, *names: str) -> None:
        """Refuse options that must be 1 or more and are not, and spherical harmonics of no degree
        from 0 to 3.

        Args:
            names: of the options that count, besides the common ones.
        """
        for name in (*names, "points", "most", "save_every"):
            if getattr(self, name) < 1:
                raise RenderError(
                    f"{self.name}: {name} must be 1 or more, got {getattr(self, name)}"
                )
        if self.degree not in range(4):
            raise RenderError(f"{self.name}: degree must be 0, 1, 2 or 3, got {self.degree}")


@dataclass(frozen=True)
class FitSchedule:
    """Schedule of one fit.

    Attributes:
        steps: images that are looked at.
        coarse_steps: of these, without motion, where the motion has a coarse stage.
        density: when Gaussians are added and taken away; None for never.
        structure: share of 1 - SSIM in the loss; the rest is L1, all of it where this is 0.
        measure_every: steps between points of the curve; 0 for none.
    """

    steps: int
    coarse_steps: int = 0
    rate: float = 1.0
    density: DensitySchedule | None = field(default_factory=DensitySchedule)
    structure: float = STRUCTURE
    save_every: int = 500
    measure_every: int = 500


def clip_schedule(
    steps: int, coarse_steps: int, most: int, structure: float, save_every: int
) -> FitSchedule:
    """Return the schedule of a fit from first points to the end: density control in the first half,
    less often only in long fits.

    Args:
        coarse_steps: of these, without motion.
        most: Gaussians at most.
        structure: share of 1 - SSIM in the loss.
    """
    density = DensitySchedule(
        every=max(1, min(100, steps // 40)), first=min(500, steps // 10), last=steps // 2, most=most
    )
    return FitSchedule(
        steps, coarse_steps, density=density, structure=structure, save_every=save_every
    )


class Journal:
    """Progress and curve of a fit, which may be made of several, one after the other.

    Args:
        folder: gets ``log.csv``, ``validation.csv`` and the picture.
    """

    def __init__(
        self, folder: Path, name: str, steps: int, before: int, n_done: int, progress: Progress
    ) -> None:
        self._folder, self._name, self._steps, self._progress = folder, name, steps, progress
        self._before = before
        self._log = TrainingLog(folder, before + n_done)

    def step(self, step: int, loss: float, count: int, seconds: float) -> None:
        """Note one step."""
        self._log.step(self._before + step, {"loss": loss, "gaussians": count, "seconds": seconds})
        self._progress(self._before + step + 1, self._steps)

    def measure(self, state: FitState, shots: Shots) -> None:
        """Note the PSNR of a few training images, and draw the curve."""
        errors = [
            _squared_error(state, shot, shots.near)
            for shot in shots.evenly(min(WATCHED, len(shots)))
        ]
        figures = {
            "PSNR_training_dB": -10 * float(np.log10(np.mean(errors))),
            "gaussians": float(len(state)),
        }
        self._log.validation(self._before + state.step, figures)
        draw_curves(self._folder, self._name)


def optimise(
    state: FitState, shots: Shots, options: FitSchedule, journal: Journal, checkpoint: Path | None
) -> None:
    """Do the steps that a fit still lacks.

    Args:
        state: of the fit, changed in place.
        checkpoint: file of the state, for continuing after a kill; None if the fit is too short to
            be worth one.
    """
    while state.step < options.steps:
        started = perf_counter()
        shot = shots.at(state.step)
        loss = _step(state, shot, options, shots.extent, shots.near)
        journal.step(state.step, loss, len(state), perf_counter() - started)
        state.step += 1
        if options.density is not None and options.density.is_due(state.step):
            seed = int(
                np.random.default_rng([shots.footage.seed, shots.salt, state.step]).integers(2**62)
            )
            control_density(state, shots.extent, options.density, seed)
        last = state.step == options.steps
        if options.measure_every and (last or state.step % options.measure_every == 0):
            journal.measure(state, shots)
        if checkpoint is not None and (last or state.step % options.save_every == 0):
            state.write(checkpoint)


def _step(state: FitState, shot: Shot, options: FitSchedule, extent: float, near: float) -> float:
    """Look at one image and move everything once; the loss of it."""
    _set_rates(state, options, extent)
    is_coarse = state.motion.has_coarse_stage and state.step < options.coarse_steps
    cloud = (
        canonical(state.gaussians) if is_coarse else state.motion.cloud(state.gaussians, shot.time)
    )
    offsets = torch.zeros(len(cloud), 2, requires_grad=True)
    picture = render_gaussians(cloud, shot.camera, screen_offsets=offsets, near=near)
    loss = photometric_loss(picture.image, shot.image, options.structure)
    total = loss if is_coarse else loss + state.motion.penalty()
    state.optimiser.zero_grad(set_to_none=True)
    total.backward()
    # one bad step must not spoil the Gaussians for ever; the log shows it
    if bool(torch.isfinite(total)):
        if offsets.grad is not None:
            watch_gradients(state, offsets.grad, picture.radii, shot.camera)
        state.optimiser.step()
    return float(loss.detach())


def _set_rates(state: FitState, options: FitSchedule, extent: float) -> None:
    """Learning rates of a step: lengths count in extents, and fall log-linearly with what all
    Gaussians share.
    """
    share = state.step / max(1, options.steps - 1)
    for group in state.optimiser.param_groups:
        name = group["name"]
        if name.startswith(SHARED):
            rate = state.motion.shared_rate(name) * LAST_SHARED_RATE**share
        else:
            rate = (RATES | dict(state.motion.rates))[name]
            if name == "means" or name in state.motion.lengths:
                rate *= extent * LAST_LENGTH_RATE**share
        group["lr"] = options.rate * rate


@torch.no_grad()
def _squared_error(state: FitState, shot: Shot, near: float) -> float:
    image = render_gaussians(
        state.motion.cloud(state.gaussians, shot.time), shot.camera, near=near
    ).image
    return float((image.clamp(max=1) - shot.image).square().mean())
