"""Training task of GPS-Gaussian: shapes and opacities of Gaussians whose positions and colours are given."""

from dataclasses import dataclass

import torch
from torch import Tensor

from ggvs_eval.baselines.gps_gaussian.method import instant_gaussians
from ggvs_eval.baselines.gps_gaussian.network import CONFIGURATIONS, GpsGaussianNetwork
from ggvs_eval.baselines.gps_gaussian.rectification import choose_pairs
from ggvs_eval.baselines.gps_gaussian.rendering import blend_gaussians
from ggvs_eval.baselines.learned import TrainingRecipe
from ggvs_eval.errors import RenderError, TrainingError
from ggvs_eval.method import Instant
from ggvs_eval.training.instant_samples import InstantSample
from ggvs_eval.training.losses import structural_loss

L1_WEIGHT, STRUCTURE_WEIGHT = 0.8, 0.2


@dataclass(frozen=True)
class GpsGaussianRecipe(TrainingRecipe[GpsGaussianNetwork]):
    """The training of GPS-Gaussian with given depth.

    Reading:
        The authors' second stage: 0.8 times the mean absolute error and 0.2 times 1 - SSIM. Their first stage teaches a stereo
        network, which takes longer than all else here: it is given the depth that the others get instead. Two pairs are
        rendered, so that it sees as many views as the others.
    """

    crop_width: int = 96
    crop_height: int = 80

    def __post_init__(self) -> None:
        """Refuse a configuration part of which would not be taught."""
        if CONFIGURATIONS[self.configuration].stereo:
            raise TrainingError(
                f"gps-gaussian: {self.configuration} has a stereo network, which is not taught here; take compact"
            )

    def network(self) -> GpsGaussianNetwork:
        """A network with random weights."""
        return GpsGaussianNetwork(self.configuration)

    def sample_loss(self, network: GpsGaussianNetwork, sample: InstantSample, step: int) -> tuple[Tensor, dict[str, Tensor]]:
        """Mean absolute error and structure."""
        image, truth = _render(network, sample.instant), sample.truth_tensor
        absolute = (image - truth).abs().mean()
        structure = structural_loss(image[None], truth[None])
        return L1_WEIGHT * absolute + STRUCTURE_WEIGHT * structure, {"l1_loss": absolute, "ssim_loss": structure}

    def refusal(self, instant: Instant) -> str | None:
        """Sources none of whose pairs can be rectified, as a camera that walks straight ahead makes them."""
        try:
            choose_pairs(instant.target, [source.camera for source in instant.sources], CONFIGURATIONS[self.configuration].pairs)
        except RenderError as error:
            return str(error)
        return None

    def validated_view(self, network: GpsGaussianNetwork, instant: Instant) -> Tensor:
        """The target view."""
        return _render(network, instant).clamp(0, 1)


def _render(network: GpsGaussianNetwork, instant: Instant) -> Tensor:
    """(3, H, W)."""
    config = network.config
    gaussians = instant_gaussians(network, instant, "given", config.pairs, config.rotations_in)
    with torch.autocast(next(network.parameters()).device.type, enabled=False):  # few bits of a distance would move Gaussians
        return blend_gaussians(gaussians, instant.target, instant.near_plane)[..., :3].permute(2, 0, 1)
