"""Recipes: what a learned baseline adds to the training that all of them share, and which baselines
have one.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

from ggvs_eval.baselines.registry import LEARNED_BASELINES
from ggvs_eval.method import Instant
from ggvs_eval.plugins import Registry

if TYPE_CHECKING:
    from torch import Tensor, nn

    from ggvs_eval.contrib.training.instant_samples import InstantSample

Network = TypeVar("Network", bound="nn.Module")
_HERE = "ggvs_eval.contrib.training.recipes"
# Name of a learned baseline -> class of its `TrainingRecipe`.
RECIPES: "Registry[Callable[[str, int], TrainingRecipe[Any]]]" = Registry(
    "recipes of training",
    {
        "fwd": f"{_HERE}.fwd:FwdRecipe",
        "ibrnet": f"{_HERE}.ibrnet:IbrnetRecipe",
        "gps-gaussian": f"{_HERE}.gps_gaussian:GpsGaussianRecipe",
        "enerf": f"{_HERE}.enerf:EnerfRecipe",
        "mvsplat": f"{_HERE}.mvsplat:MvsplatRecipe",
    },
)
TRAINED_BASELINES = {name: LEARNED_BASELINES[name] for name in RECIPES if name in LEARNED_BASELINES}


@dataclass(frozen=True)
class TrainingRecipe(ABC, Generic[Network]):
    """The network that a baseline trains, its loss, and how its progress is seen.

    Samples, crops and scores are everybody's.

    Attributes:
        configuration: of the network.
        seed: of the weights and of what the loss draws.
        crop_width: of the target's crops, pixels.
        crop_height: of the crops.
        batch_size: crops of a step.
        validated_step: pixels between two that are validated, along rows and columns; 1 validates
            whole views.
        network_class: makes a network with random weights of a configuration.
        term_weights: of the terms of the loss, by name.
    """

    configuration: str = "compact"
    seed: int = 0
    crop_width: int = 320
    crop_height: int = 240
    batch_size: ClassVar[int] = 1
    validated_step: ClassVar[int] = 1
    network_class: "ClassVar[Callable[[str], nn.Module]]"
    term_weights: ClassVar[Mapping[str, float]]

    @property
    def crop_pixels(self) -> int:
        """Pixels of a crop that the loss looks at."""
        return self.crop_width * self.crop_height

    def network(self) -> "nn.Module":
        """Return a network with random weights, of the configuration."""
        return type(self).network_class(self.configuration)

    def weights(self, step: int) -> Mapping[str, float]:
        """Return the weight of each term of the loss at a step."""
        return self.term_weights

    def sample_loss(
        self, network: Network, sample: "InstantSample", step: int
    ) -> "tuple[Tensor, dict[str, Tensor]]":
        """Return the loss of one crop, the weighted sum of its terms, and these for the log.

        Arguments as of `terms`.
        """
        terms = self.terms(network, sample, step)
        first, *terms_left = (weight * terms[name] for name, weight in self.weights(step).items())
        return sum(terms_left, first), terms

    @abstractmethod
    def terms(self, network: Network, sample: "InstantSample", step: int) -> "dict[str, Tensor]":
        """Return the terms of the loss of one crop.

        Args:
            network: in training mode.
            sample: its target is the crop, its sources are what the crop can show of them.
            step: number of the step, a seed for what the loss draws.
        """

    def refusal(self, instant: Instant) -> str | None:
        """Return the reason why the method cannot render an instant, regardless of the network.

        None if it can.
        """
        return None

    @abstractmethod
    def rendered(self, network: Network, instant: Instant) -> "Tensor":
        """Return the target view, every `validated_step`-th pixel of it, (3, h, w)."""

    def validated_view(self, network: Network, instant: Instant) -> "Tensor":
        """Return the target view by a network in evaluation mode, (3, h, w) in [0, 1]."""
        return self.rendered(network, instant).clamp(0, 1)
