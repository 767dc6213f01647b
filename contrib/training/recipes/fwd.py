"""Training task of FWD: decode the target image from source features that given depth warps
there.
"""

from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor

from ggvs_eval.baselines.fitted.optimiser import structural_loss
from ggvs_eval.baselines.fwd.method import decode_views, warp_views
from ggvs_eval.baselines.fwd.network import FwdNetwork
from ggvs_eval.contrib.training.instant_samples import InstantSample
from ggvs_eval.contrib.training.recipes.recipe import TrainingRecipe
from ggvs_eval.method import Instant


@dataclass(frozen=True)
class FwdRecipe(TrainingRecipe[FwdNetwork]):
    """The training of FWD with given depth.

    Reading:
        Its authors minimise five times the squared error of colours in [-1, 1] and a distance of
        features of VGG19. No weights of VGG19 ship here: 1 - SSIM replaces it, weighted as in the
        loss of GGVS here. Depth is not completed: the sources see what is missing in each other.
    """

    crop_width: int = 192
    crop_height: int = 160
    network_class = FwdNetwork
    term_weights: ClassVar = {"squared_loss": 5.0, "ssim_loss": 0.2}

    def terms(self, network: FwdNetwork, sample: InstantSample, step: int) -> dict[str, Tensor]:
        """Return the squared error and structure."""
        image, truth = self.rendered(network, sample.instant), sample.truth_tensor
        return {
            "squared_loss": (2 * image - 2 * truth).square().mean(),
            "ssim_loss": structural_loss(image[None], truth[None]),
        }

    def rendered(self, network: FwdNetwork, instant: Instant) -> Tensor:
        """Return the target view."""
        return decode_views(network, instant, warp_views(network, instant))
