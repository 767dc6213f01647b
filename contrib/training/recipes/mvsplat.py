"""Training task of MVSplat: Gaussians whose picture is the target's, and depth that agrees with
what stereo found.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from ggvs_eval.baselines.fitted.optimiser import structural_loss
from ggvs_eval.contrib.more_baselines.mvsplat.gaussians import pixel_cloud
from ggvs_eval.contrib.more_baselines.mvsplat.method import instant_cloud
from ggvs_eval.contrib.more_baselines.mvsplat.network import MvsplatNetwork
from ggvs_eval.contrib.more_baselines.mvsplat.views import Views, see_views
from ggvs_eval.contrib.training.instant_samples import InstantSample
from ggvs_eval.contrib.training.recipes.recipe import TrainingRecipe
from ggvs_eval.gaussians.render import render_gaussians
from ggvs_eval.method import Instant

DEPTH_STEPS = 60  # at first


@dataclass(frozen=True)
class MvsplatRecipe(TrainingRecipe[MvsplatNetwork]):
    """The training of MVSplat.

    Reading:
        Its authors minimise the squared error and 0.05 times a distance of features of VGG16, and
        begin with features and attention that another training had taught to find depth. No weights
        of VGG ship here: 1 - SSIM replaces it. In place of the other training, the first
        `DEPTH_STEPS` steps teach coarse depth alone, at a third of the cost, and 0.3 times the mean
        absolute error of both inverse depths (1 at the nearest depth) stays in the loss, where the
        depth that other baselines are given is known; rendering is given none.
    """

    crop_width: int = 96
    crop_height: int = 80
    batch_size: ClassVar[int] = 2
    network_class = MvsplatNetwork
    term_weights: ClassVar = {"squared_loss": 1.0, "ssim_loss": 0.05, "disparity_loss": 0.3}

    def weights(self, step: int) -> Mapping[str, float]:
        """Return the inverse depth alone at first."""
        return {"disparity_loss": 1.0} if step < DEPTH_STEPS else self.term_weights

    def terms(self, network: MvsplatNetwork, sample: InstantSample, step: int) -> dict[str, Tensor]:
        """Return the squared error, structure, and inverse depth; the latter alone at first."""
        instant, truth = sample.instant, sample.truth_tensor
        views = see_views(instant, network.config.size_multiple)
        if step < DEPTH_STEPS:
            together, _ = network.backbone(views.images, network.config.window)
            coarse, _ = network.depth_predictor.search(together, views)
            error = _disparity_error([coarse], views, instant)
            return {
                "squared_loss": torch.zeros(()),
                "ssim_loss": torch.zeros(()),
                "disparity_loss": error,
            }
        pixels = network(views)
        # few bits of a depth would move Gaussians
        with torch.autocast(views.images.device.type, enabled=False):
            cloud = pixel_cloud(pixels, views, network.config.published)
            image = render_gaussians(cloud, instant.target, near=instant.near_plane).image.permute(
                2, 0, 1
            )
            return {
                "squared_loss": (image - truth).square().mean(),
                "ssim_loss": structural_loss(image[None], truth[None]),
                "disparity_loss": _disparity_error(
                    [pixels.coarse_disparity, pixels.disparity], views, instant
                ),
            }

    def rendered(self, network: MvsplatNetwork, instant: Instant) -> Tensor:
        """Return the target view."""
        picture = render_gaussians(
            instant_cloud(network, instant), instant.target, near=instant.near_plane
        )
        return picture.image.permute(2, 0, 1)


def _disparity_error(disparities: Sequence[Tensor], views: Views, instant: Instant) -> Tensor:
    """Return the mean absolute error of inverse depths (K, 1, H, W) where the sources' depth is
    known, 0 if it nowhere is.
    """
    errors = []
    for number, source in enumerate(instant.sources):
        height, width = source.depth.shape
        depth = torch.as_tensor(np.ascontiguousarray(source.depth))
        mask = depth > 0
        truth = 1 / (views.unit * depth[mask])
        errors += [(maps[number, 0, :height, :width][mask] - truth).abs() for maps in disparities]
    every = torch.cat(errors)
    return every.sum() / max(len(every), 1)
