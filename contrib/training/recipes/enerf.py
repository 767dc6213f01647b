"""Training task of ENeRF: locate surfaces and blend the views there, learned from images alone."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor
from torch.nn import functional

from ggvs_eval.baselines.enerf.network import Networks
from ggvs_eval.baselines.enerf.rendering import (
    COARSE_FACTOR,
    coarse_views,
    find_surface,
    refine_surface,
    render_coarsely,
    render_surface,
    search_coarsely,
    target_grid,
)
from ggvs_eval.baselines.enerf.views import TRAINED_NEAR, see, see_together
from ggvs_eval.baselines.fitted.optimiser import structural_loss
from ggvs_eval.contrib.training.instant_samples import InstantSample
from ggvs_eval.contrib.training.recipes.recipe import TrainingRecipe
from ggvs_eval.method import Instant


@dataclass(frozen=True)
class EnerfRecipe(TrainingRecipe[Networks]):
    """The training of ENeRF.

    Reading:
        Its authors minimise the squared error of both levels, the coarse one weighted by 0.1, and
        0.01 times a distance of features of VGG16. No weights of VGG ship here: 1 - SSIM replaces
        it. Depth is not used.
    """

    crop_width: int = 256
    crop_height: int = 192
    batch_size: ClassVar[int] = 2
    network_class = Networks
    term_weights: ClassVar = {"squared_loss": 1.0, "coarse_loss": 0.1, "ssim_loss": 0.01}

    def terms(self, network: Networks, sample: InstantSample, step: int) -> dict[str, Tensor]:
        """Return the squared error of both levels, and structure."""
        target, truth = sample.instant.target, sample.truth_tensor
        near, far = sample.instant.depth_range
        unit = TRAINED_NEAR / near
        views = see_together(network.feature_net, sample.instant.sources, unit)
        grid = target_grid(target, unit)
        coarse = search_coarsely(
            network, views, grid, near * unit, far * unit, network.coarse_planes
        )
        fine = refine_surface(network, views, grid, coarse)
        image, _ = render_surface(network, views, fine, target, unit, target.width * target.height)
        centre = torch.as_tensor(target.centre * unit).float()
        rays = torch.as_tensor(target.rays()[::COARSE_FACTOR, ::COARSE_FACTOR]).float()
        rough, _ = render_coarsely(network, coarse_views(views), coarse, centre, rays)
        coarse_truth = functional.avg_pool2d(truth, COARSE_FACTOR).flatten(1).T
        return {
            "squared_loss": (image - truth).square().mean(),
            "coarse_loss": (rough - coarse_truth).square().mean(),
            "ssim_loss": structural_loss(image[None], truth[None]),
        }

    def rendered(self, network: Networks, instant: Instant) -> Tensor:
        """Return the target view."""
        near, far = instant.depth_range
        unit = TRAINED_NEAR / near
        views = [see(network.feature_net, source, unit) for source in instant.sources]
        grid = target_grid(instant.target, unit)
        surface = find_surface(network, views, grid, near * unit, far * unit, network.coarse_planes)
        return render_surface(network, views, surface, instant.target, unit)[0]
