"""The one optimiser of all fitted methods: image by image, Adam on Gaussians and their motion, with density control."""

from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter

import numpy as np
import torch

from ggvs_eval.baselines.fitted.density import DensityOptions, control_density, watch_gradients
from ggvs_eval.baselines.fitted.motion import canonical
from ggvs_eval.baselines.fitted.photometric import STRUCTURE, photometric_loss
from ggvs_eval.baselines.fitted.shots import Shot, Shots
from ggvs_eval.baselines.fitted.state import RATES, SHARED, FitState
from ggvs_eval.baselines.fitted.training_log import TrainingLog, draw_curves
from ggvs_eval.errors import RenderError
from ggvs_eval.gaussians.render import render_gaussians
from ggvs_eval.scene_fitter import Progress, SceneFitter

LAST_LENGTH_RATE, LAST_SHARED_RATE = 0.01, 0.1  # of the first one, at the last step: of lengths, and of what all share
WATCHED = 4  # training images whose PSNR is the curve


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
        """Refuse options that must be 1 or more and are not, and spherical harmonics of no degree from 0 to 3.

        Args:
            names: of the options that count, beside those that all have.
        """
        for each in (*names, "points", "most", "save_every"):
            if getattr(self, each) < 1:
                raise RenderError(f"{self.name}: {each} must be 1 or more, got {getattr(self, each)}")
        if self.degree not in range(4):
            raise RenderError(f"{self.name}: degree must be 0, 1, 2 or 3, got {self.degree}")


@dataclass(frozen=True)
class OptimiserOptions:
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
    density: DensityOptions | None = field(default_factory=DensityOptions)
    structure: float = STRUCTURE
    save_every: int = 500
    measure_every: int = 500


def clip_options(steps: int, coarse_steps: int, most: int, structure: float, save_every: int) -> OptimiserOptions:
    """Options of a fit from first points to the end: density control in the first half, less often only in long fits.

    Args:
        coarse_steps: of these, without motion.
        most: Gaussians at most.
        structure: share of 1 - SSIM in the loss.
    """
    density = DensityOptions(every=max(1, min(100, steps // 40)), first=min(500, steps // 10), last=steps // 2, most=most)
    return OptimiserOptions(steps, coarse_steps, density=density, structure=structure, save_every=save_every)


class Journal:
    """Progress and curve of a fit, which may be made of several, one after the other.

    Args:
        folder: gets ``log.csv``, ``validation.csv`` and the picture.
    """

    def __init__(self, folder: Path, name: str, steps: int, before: int, done: int, progress: Progress) -> None:
        self._folder, self._name, self._steps, self._progress = folder, name, steps, progress
        self._before = before
        self._log = TrainingLog(folder, before + done)

    def step(self, step: int, loss: float, count: int, seconds: float) -> None:
        """Note one step."""
        self._log.step(self._before + step, {"loss": loss, "gaussians": count, "seconds": seconds})
        self._progress(self._before + step + 1, self._steps)

    def measure(self, state: FitState, shots: Shots) -> None:
        """Note the PSNR of a few training images, and draw the curve."""
        errors = [_squared_error(state, shot, shots.near) for shot in shots.evenly(min(WATCHED, len(shots)))]
        figures = {"PSNR_training_dB": -10 * float(np.log10(np.mean(errors))), "gaussians": float(len(state))}
        self._log.validation(self._before + state.step, figures)
        draw_curves(self._folder, self._name)


def optimise(state: FitState, shots: Shots, options: OptimiserOptions, journal: Journal, checkpoint: Path | None) -> None:
    """Do the steps that a fit still lacks.

    Args:
        state: of the fit, changed in place.
        checkpoint: file of the state, for going on after a kill; None where the fit is too short to be worth one.
    """
    while state.step < options.steps:
        started = perf_counter()
        shot = shots.at(state.step)
        loss = _step(state, shot, options, shots.extent, shots.near)
        journal.step(state.step, loss, len(state), perf_counter() - started)
        state.step += 1
        if options.density is not None and options.density.is_due(state.step):
            seed = int(np.random.default_rng([shots.footage.seed, shots.salt, state.step]).integers(2**62))
            control_density(state, shots.extent, options.density, seed)
        last = state.step == options.steps
        if options.measure_every and (last or state.step % options.measure_every == 0):
            journal.measure(state, shots)
        if checkpoint is not None and (last or state.step % options.save_every == 0):
            state.write(checkpoint)


def _step(state: FitState, shot: Shot, options: OptimiserOptions, extent: float, near: float) -> float:
    """Look at one image and move everything once; the loss of it."""
    _set_rates(state, options, extent)
    is_coarse = state.motion.has_coarse_stage and state.step < options.coarse_steps
    cloud = canonical(state.gaussians) if is_coarse else state.motion.cloud(state.gaussians, shot.time)
    offsets = torch.zeros(len(cloud), 2, requires_grad=True)
    picture = render_gaussians(cloud, shot.camera, screen_offsets=offsets, near=near)
    loss = photometric_loss(picture.image, shot.image, options.structure)
    total = loss if is_coarse else loss + state.motion.penalty()
    state.optimiser.zero_grad(set_to_none=True)
    total.backward()
    if bool(torch.isfinite(total)):  # one bad step must not spoil the Gaussians for ever; the log shows it
        if offsets.grad is not None:
            watch_gradients(state, offsets.grad, picture.radii, shot.camera)
        state.optimiser.step()
    return float(loss.detach())


def _set_rates(state: FitState, options: OptimiserOptions, extent: float) -> None:
    """Learning rates of a step: lengths count in extents, and fall log-linearly with what all Gaussians share."""
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
    image = render_gaussians(state.motion.cloud(state.gaussians, shot.time), shot.camera, near=near).image
    return float((image.clamp(max=1) - shot.image).square().mean())
