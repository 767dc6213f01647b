"""Learned baselines: the registry entry of each, and what it adds to the training that all of them share."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

from ggvs_eval.method import Instant, Method

if TYPE_CHECKING:
    from torch import Tensor, nn

    from ggvs_eval.training.instant_samples import InstantSample

FULL = "full"  # the authors' configuration; a file of weights that names none is of it
Network = TypeVar("Network", bound="nn.Module")


@dataclass(frozen=True)
class Rendition:
    """One of the ways in which a learned baseline renders, each with a label of its own.

    Attributes:
        describe: one line for the help and the report.
        retrained: configuration of the weights that ship for it; empty where the user has to give a checkpoint.
        variant: what its label has behind the baseline's name and a ``+``.
        options: arguments of the baseline's method.
        uses_depth: whether it looks at the depth of its sources.
    """

    title: str
    describe: str
    retrained: str = ""
    variant: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    uses_depth: bool = False


@dataclass(frozen=True)
class LearnedBaseline:
    """A network that the paper's is compared with: all that the package knows of it outside its folder.

    Classes are named by ``module:class``, so that a list of baselines loads no network.

    Attributes:
        name: of the baseline in labels, of its training and of its files of weights.
        title: how its authors call it.
        source: authors and venue of its paper.
        checkpoint: the authors' file that it can render with.
        method: class of its `Method`; takes the file of weights and ``device`` beside the options of a rendition.
        renditions: the ways in which it renders.
        recipe: class of its `TrainingRecipe`; empty where its authors' weights are to be had and none are learned here.
        takes_depth: whether it learns from sources with depth; without, no sample waits for depth.
    """

    name: str
    title: str
    source: str
    checkpoint: str
    method: str
    renditions: tuple[Rendition, ...]
    recipe: str = ""
    takes_depth: bool = False

    @property
    def weights(self) -> str:
        """Name of the file of weights that ships, if one does."""
        return f"{self.name}.safetensors"

    def label(self, rendition: Rendition) -> str:
        """Return the label of a rendition, on the command line and in folders."""
        return f"{self.name}+{rendition.variant}" if rendition.variant else self.name

    def make_method(self, weights: Path, **options: Any) -> Method:
        """A fresh object that renders one sequence.

        Args:
            weights: the authors' checkpoint, or what our training wrote.
            options: ``device``, and others of the method.
        """
        method: Callable[..., Method] = resolve_name(self.method)
        return method(weights, **options)

    def make_recipe(self, configuration: str = "compact", seed: int = 0) -> "TrainingRecipe[Any]":
        """Make the training recipe of a configuration of its network.

        Raises:
            TrainingError: a configuration that cannot be trained here.
        """
        recipe: Callable[..., TrainingRecipe[Any]] = resolve_name(self.recipe)
        return recipe(configuration, seed)


@dataclass(frozen=True)
class TrainingRecipe(ABC, Generic[Network]):
    """The network that a baseline trains, its loss, and how its progress is seen; samples, crops and scores are everybody's.

    Attributes:
        configuration: of the network.
        seed: of the weights and of what the loss draws.
        crop_width: of the target's crops, pixels.
        crop_height: of the crops.
        batch_size: crops of a step.
        validated_step: pixels between two that are validated, along rows and columns; 1 validates whole views.
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
        """A network with random weights, of the configuration."""
        return type(self).network_class(self.configuration)

    def weights(self, step: int) -> Mapping[str, float]:
        """Weight of each term of the loss at a step."""
        return self.term_weights

    def sample_loss(self, network: Network, sample: "InstantSample", step: int) -> "tuple[Tensor, dict[str, Tensor]]":
        """The loss of one crop, the weighted sum of its terms, and these for the log; arguments as of `terms`."""
        terms = self.terms(network, sample, step)
        first, *others = (weight * terms[name] for name, weight in self.weights(step).items())
        return sum(others, first), terms

    @abstractmethod
    def terms(self, network: Network, sample: "InstantSample", step: int) -> "dict[str, Tensor]":
        """The terms of the loss of one crop.

        Args:
            network: in training mode.
            sample: its target is the crop, its sources are what the crop can show of them.
            step: number of the step, a seed for what the loss draws.
        """

    def refusal(self, instant: Instant) -> str | None:
        """Reason why the method cannot render an instant, whatever the network; None where it can."""
        return None

    @abstractmethod
    def rendered(self, network: Network, instant: Instant) -> "Tensor":
        """The target view, every `validated_step`-th pixel of it, (3, h, w)."""

    def validated_view(self, network: Network, instant: Instant) -> "Tensor":
        """The target view by a network in evaluation mode, (3, h, w) in [0, 1]."""
        return self.rendered(network, instant).clamp(0, 1)
