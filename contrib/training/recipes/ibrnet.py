"""Training task of IBRNet: density along rays and blending of the views there, learned from images
alone.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from ggvs_eval.baselines.ibrnet.network import Networks
from ggvs_eval.baselines.ibrnet.rendering import (
    depth_range,
    rays_at_once,
    render_passes,
    render_rays,
    see,
)
from ggvs_eval.contrib.training.instant_samples import InstantSample
from ggvs_eval.contrib.training.recipes.recipe import TrainingRecipe
from ggvs_eval.method import Instant


@dataclass(frozen=True)
class IbrnetRecipe(TrainingRecipe[Networks]):
    """The training of IBRNet.

    Reading:
        The authors' loss, the squared error of both passes, of rays drawn from a window instead of
        the whole view, so that the sources need not be seen whole. Depth is not used. Every ray
        counts; the authors leave out those with at most eight samples that two sources see, which
        are few here: sources surround their target.
    """

    crop_width: int = 160
    crop_height: int = 120
    rays: int = 320
    validated_step: ClassVar[int] = 4
    network_class = Networks
    term_weights: ClassVar = {"coarse_loss": 1.0, "fine_loss": 1.0}

    @property
    def crop_pixels(self) -> int:
        """Pixels of a crop that the loss looks at: one per ray."""
        return self.rays

    def terms(self, network: Networks, sample: InstantSample, step: int) -> dict[str, Tensor]:
        """Return the squared error of both passes."""
        target, truth = sample.instant.target, sample.truth_tensor.flatten(1).T  # (H * W, 3)
        pixels = torch.as_tensor(
            np.random.default_rng([self.seed, step, 1]).choice(len(truth), self.rays, replace=False)
        )
        centre = torch.as_tensor(target.centre).float()
        rays = torch.as_tensor(target.rays().reshape(-1, 3)).float()[pixels]
        views = see(network, sample.instant.sources)
        rough, (colours, _, _) = render_passes(
            network, views, centre, rays, *depth_range(sample.instant)
        )
        return {
            "coarse_loss": (rough - truth[pixels]).square().mean(),
            "fine_loss": (colours - truth[pixels]).square().mean(),
        }

    def rendered(self, network: Networks, instant: Instant) -> Tensor:
        """Return the pixels of the target view on a grid; whole views would take minutes."""
        step = self.validated_step
        # (h, w, 3)
        rays = torch.as_tensor(np.ascontiguousarray(instant.target.rays()[::step, ::step])).float()
        views = see(network, instant.sources)
        centre = torch.as_tensor(instant.target.centre).float()
        chunks = rays.view(-1, 3).split(rays_at_once(len(views), network.config.samples))
        parts = [
            render_rays(network, views, centre, chunk, *depth_range(instant))[0] for chunk in chunks
        ]
        return torch.cat(parts).view(rays.shape).permute(2, 0, 1)
