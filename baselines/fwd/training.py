"""Training task of FWD: decode the target image from source features that given depth warps there."""

from dataclasses import dataclass

from torch import Tensor

from ggvs_eval.baselines.fwd.network import FwdNetwork
from ggvs_eval.baselines.fwd.rendering import decode_views, warp_views
from ggvs_eval.baselines.learned import TrainingRecipe
from ggvs_eval.method import Instant
from ggvs_eval.training.instant_samples import InstantSample
from ggvs_eval.training.losses import structural_loss

SQUARED_WEIGHT, STRUCTURE_WEIGHT = 5.0, 0.2


@dataclass(frozen=True)
class FwdRecipe(TrainingRecipe[FwdNetwork]):
    """The training of FWD with given depth.

    Reading:
        Its authors minimise five times the squared error of colours in [-1, 1] and a distance of features of VGG19. No weights
        of VGG19 ship here: 1 - SSIM stands in for that, weighted as in our own loss. Depth is not completed: the sources see
        what is missing in each other.
    """

    crop_width: int = 192
    crop_height: int = 160

    def network(self) -> FwdNetwork:
        """A network with random weights."""
        return FwdNetwork(configuration=self.configuration)

    def sample_loss(self, network: FwdNetwork, sample: InstantSample, step: int) -> tuple[Tensor, dict[str, Tensor]]:
        """Squared error and structure."""
        image, truth = _render(network, sample.instant), sample.truth_tensor
        squared = (2 * image - 2 * truth).square().mean()
        structure = structural_loss(image[None], truth[None])
        return SQUARED_WEIGHT * squared + STRUCTURE_WEIGHT * structure, {"squared_loss": squared, "ssim_loss": structure}

    def validated_view(self, network: FwdNetwork, instant: Instant) -> Tensor:
        """The target view."""
        return _render(network, instant).clamp(0, 1)


def _render(network: FwdNetwork, instant: Instant) -> Tensor:
    return decode_views(network, instant, warp_views(network, instant))
