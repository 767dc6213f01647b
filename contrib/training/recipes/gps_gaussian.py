"""Training task of GPS-Gaussian: shapes and opacities of Gaussians whose positions and colours are
given.
"""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from ggvs_eval.baselines.fitted.optimiser import structural_loss
from ggvs_eval.baselines.gps_gaussian.method import choose_pairs, instant_gaussians
from ggvs_eval.baselines.gps_gaussian.network import CONFIGURATIONS, GpsGaussianNetwork
from ggvs_eval.baselines.gps_gaussian.rendering import blend_gaussians
from ggvs_eval.contrib.training.instant_samples import InstantSample
from ggvs_eval.contrib.training.recipes.recipe import TrainingRecipe
from ggvs_eval.errors import RenderError, TrainingError
from ggvs_eval.method import Instant


@dataclass(frozen=True)
class GpsGaussianRecipe(TrainingRecipe[GpsGaussianNetwork]):
    """The training of GPS-Gaussian with given depth.

    Reading:
        The authors' second stage: 0.8 times the mean absolute error and 0.2 times 1 - SSIM. Their
        first stage teaches a stereo network, which takes longer than all else here: it is given the
        depth that the others get instead. Two pairs are rendered, so that it sees as many views as
        the others.
    """

    crop_width: int = 96
    crop_height: int = 80
    network_class = GpsGaussianNetwork
    term_weights: ClassVar = {"l1_loss": 0.8, "ssim_loss": 0.2}

    def __post_init__(self) -> None:
        """Refuse a configuration part of which would not be taught."""
        if CONFIGURATIONS[self.configuration].stereo:
            raise TrainingError(
                f"gps-gaussian: {self.configuration} has a stereo network, which cannot be trained "
                f"here; use compact"
            )

    def terms(
        self, network: GpsGaussianNetwork, sample: InstantSample, step: int
    ) -> dict[str, Tensor]:
        """Return the mean absolute error and structure."""
        image, truth = self.rendered(network, sample.instant), sample.truth_tensor
        return {
            "l1_loss": (image - truth).abs().mean(),
            "ssim_loss": structural_loss(image[None], truth[None]),
        }

    def refusal(self, instant: Instant) -> str | None:
        """Sources none of whose pairs can be rectified, as a camera that walks straight ahead makes
        them.
        """
        try:
            choose_pairs(
                instant.target,
                [source.camera for source in instant.sources],
                CONFIGURATIONS[self.configuration].pairs,
            )
        except RenderError as error:
            return str(error)
        return None

    def rendered(self, network: GpsGaussianNetwork, instant: Instant) -> Tensor:
        """Return the target view."""
        config = network.config
        gaussians = instant_gaussians(network, instant, "given", config.pairs, config.rotations_in)
        device = next(network.parameters()).device.type
        with torch.autocast(device, enabled=False):  # few bits of a distance would move Gaussians
            return blend_gaussians(gaussians, instant.target, instant.near_plane)[..., :3].permute(
                2, 0, 1
            )
