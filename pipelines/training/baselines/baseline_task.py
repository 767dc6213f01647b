"""What is common to the trainings of the baselines: samples, crops, validation; each adds its network and its loss."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor, nn

from ggvs_eval.files.images import quantise
from ggvs_eval.method import Instant
from ggvs_eval.metrics.image import psnr, ssim
from ggvs_eval.pipelines.training.samples.samples import Samples, require_room
from ggvs_eval.training.instant_samples import InstantSample
from ggvs_eval.training.task import Schedule

LEARNING_RATE = 1e-3  # ours has the same: what a rate for a GPU's day would learn in an hour of one core is little


def compact_schedule() -> Schedule:
    """The schedule of the blending network's training."""
    return Schedule(LEARNING_RATE, weight_decay=1e-5, warm_up=100, cool_down=0.4)


@dataclass(frozen=True)
class BaselineTask(ABC):
    """The training of a method that the paper compares itself with.

    Attributes:
        training: samples to learn from; their `prepare` makes them.
        validation: samples that are never learned from.
        configuration: of the network.
        seed: of the weights and the crops.
        crop_width: of the target's crops, pixels.
        crop_height: of the crops.
        batch_size: crops per step.
        schedule: see `Schedule`.
    """

    training: Samples[InstantSample]
    validation: Samples[InstantSample]
    configuration: str = "compact"
    seed: int = 0
    crop_width: int = 320
    crop_height: int = 240
    batch_size: int = 1
    schedule: Schedule = field(default_factory=compact_schedule)

    def __post_init__(self) -> None:
        """Refuse what does not fit together."""
        require_room(self.training, self.crop_width, self.crop_height)

    @property
    @abstractmethod
    def name(self) -> str:
        """Names the weights."""

    @property
    def data(self) -> str:
        """What it learns from."""
        return f"{self.training.data}; the targets and sources of the blending network's training"

    @property
    def evaluated_on(self) -> str:
        """What `validate` measures."""
        return f"PSNR (dB) and SSIM, means of whole views, single instants: {self.validation.data}."

    def network(self) -> nn.Module:
        """A fresh network."""
        torch.manual_seed(self.seed)
        return self.fresh_network()

    @abstractmethod
    def fresh_network(self) -> nn.Module:
        """A network with random weights, of the task's configuration."""

    @abstractmethod
    def sample_loss(self, network: nn.Module, sample: InstantSample, step: int) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss of one crop, and its terms for the log.

        Args:
            network: in training mode.
            sample: its target is the crop, its sources are what the crop can show of them.
            step: number of the step, a seed for what the loss draws.
        """

    @abstractmethod
    def whole_view(self, network: nn.Module, instant: Instant) -> Tensor:
        """The target view, (3, H, W) in [0, 1], by a network in evaluation mode."""

    def batch(self, step: int) -> dict[str, Tensor]:
        """Which crops a step learns from.

        Returns:
            ``samples``: numbers, (B,). ``places``: of the windows, as shares of the room that each sample leaves to its right
            and below, (B, 2), in [0, 1). ``colours``: their order, (B, 3). ``step``: its number, ().
        """
        rng = np.random.default_rng([self.seed, step])
        drawn = {
            "samples": rng.integers(len(self.training), size=self.batch_size),
            "places": rng.random((self.batch_size, 2)),
            "colours": np.stack([rng.permutation(3) for _ in range(self.batch_size)]),
            "step": np.array(step),
        }
        return {name: torch.as_tensor(values) for name, values in drawn.items()}

    def loss(self, network: nn.Module, batch: Mapping[str, Tensor]) -> tuple[Tensor, Mapping[str, float]]:
        """Mean over the crops."""
        network.train()
        losses, figures = [], []
        for number, place, order in zip(*(batch[name].tolist() for name in ("samples", "places", "colours")), strict=True):
            sample = self._crop(self.training.read(number), place)
            loss, terms = self.sample_loss(network, sample.focused().recoloured(tuple(order)), int(batch["step"]))
            losses.append(loss)
            figures.append({name: float(term.detach()) for name, term in terms.items()})
        means = {name: sum(each[name] for each in figures) / len(figures) for name in figures[0]}
        return torch.stack(losses).mean(), means

    def _crop(self, sample: InstantSample, place: Sequence[float]) -> InstantSample:
        """The window at a place of a sample, whatever the sample's size."""
        width, height = sample.instant.target.size
        left, top = int(place[0] * (width - self.crop_width + 1)), int(place[1] * (height - self.crop_height + 1))
        return sample.cropped(left, top, self.crop_width, self.crop_height)

    def validate(self, network: nn.Module) -> Mapping[str, float]:
        """Scores as an evaluation would measure them."""
        network.eval()
        sums = {"psnr_db": 0.0, "ssim": 0.0}
        for index in range(len(self.validation)):
            sample = self.validation.read(index)
            with torch.inference_mode():
                image = quantise(self.whole_view(network, sample.instant).float().permute(1, 2, 0).numpy(force=True))
            sums["psnr_db"] += psnr(image, sample.truth)
            sums["ssim"] += ssim(image, sample.truth)
        return {name: value / len(self.validation) for name, value in sums.items()}


def truth_of(sample: InstantSample) -> Tensor:
    """What the target's camera saw, (3, H, W) in [0, 1]."""
    return torch.as_tensor(np.ascontiguousarray(np.moveaxis(sample.truth, 2, 0))).float() / 255
