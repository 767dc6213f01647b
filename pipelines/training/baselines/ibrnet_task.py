"""What IBRNet learns: density along rays and how views blend there, from pictures alone."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from ggvs_eval.baselines.ibrnet.network import Networks
from ggvs_eval.baselines.ibrnet.rendering import depth_range, rays_at_once, render_passes, render_rays
from ggvs_eval.baselines.ibrnet.views import see
from ggvs_eval.method import Instant
from ggvs_eval.pipelines.training.baselines.baseline_task import BaselineTask, truth_of
from ggvs_eval.training.instant_samples import InstantSample

JUDGED_STEP = 4  # pixels


@dataclass(frozen=True)
class IbrnetTask(BaselineTask):
    """The training of IBRNet.

    Attributes:
        rays: drawn from each crop.

    Reading:
        The authors' loss, the squared error of both passes, of rays drawn from a window instead of the whole view, so that the
        sources need not be seen whole. Depth is not used.
    """

    crop_width: int = 160
    crop_height: int = 120
    rays: int = 320

    @property
    def name(self) -> str:
        """Names the weights."""
        return "ibrnet"

    def fresh_network(self) -> nn.Module:
        """Networks with random weights."""
        return Networks(self.configuration)

    def sample_loss(self, network: nn.Module, sample: InstantSample, step: int) -> tuple[Tensor, dict[str, Tensor]]:
        """Squared error of both passes."""
        assert isinstance(network, Networks)
        target, truth = sample.instant.target, truth_of(sample).flatten(1).T  # (H * W, 3)
        drawn = torch.as_tensor(np.random.default_rng([self.seed, step, 1]).choice(len(truth), self.rays, replace=False))
        centre = torch.as_tensor(target.centre).float()
        rays = torch.as_tensor(target.rays().reshape(-1, 3)).float()[drawn]
        views = see(network, sample.instant.sources)
        rough, (colours, _, _) = render_passes(network, views, centre, rays, *depth_range(sample.instant))
        terms = {
            "coarse_loss": (rough - truth[drawn]).square().mean(),
            "fine_loss": (colours - truth[drawn]).square().mean(),
        }
        return terms["coarse_loss"] + terms["fine_loss"], terms

    @property
    def evaluated_on(self) -> str:
        """What `validate` measures."""
        grid = f"each {JUDGED_STEP}th pixel of each {JUDGED_STEP}th row"
        return f"PSNR (dB) of {grid}, for whole views take minutes; means of single instants: {self.validation.data}."

    def validate(self, network: nn.Module) -> Mapping[str, float]:
        """PSNR of the mean squared error over pixels on a grid, mean of the views; without their neighbours there is no SSIM."""
        assert isinstance(network, Networks)
        network.eval()
        total = 0.0
        for index in range(len(self.validation)):
            sample = self.validation.read(index)
            rays = sample.instant.target.rays()[::JUDGED_STEP, ::JUDGED_STEP].reshape(-1, 3)
            with torch.inference_mode():
                colours = _colours(network, sample.instant, torch.as_tensor(rays).float())
            truth = sample.truth[::JUDGED_STEP, ::JUDGED_STEP].reshape(-1, 3) / np.float32(255)
            total += -10 * float(np.log10(np.mean((colours.numpy(force=True) - truth) ** 2)))
        return {"psnr_db": total / len(self.validation)}

    def whole_view(self, network: nn.Module, instant: Instant) -> Tensor:
        """The target view."""
        assert isinstance(network, Networks)
        target = instant.target
        colours = _colours(network, instant, torch.as_tensor(target.rays().reshape(-1, 3)).float())
        return colours.T.reshape(3, target.height, target.width)


def _colours(network: Networks, instant: Instant, rays: Tensor) -> Tensor:
    """Colours (N, 3) in [0, 1] of rays (N, 3)."""
    views = see(network, instant.sources)
    centre = torch.as_tensor(instant.target.centre).float()
    chunks = rays.split(rays_at_once(len(views), network.config.samples))
    parts = [render_rays(network, views, centre, chunk, *depth_range(instant))[0] for chunk in chunks]
    return torch.cat(parts).clamp(0, 1)
