"""Training task of the blending network: to make the target's picture of splatted views and fused depth."""

from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import torch
from torch import Tensor, nn

from ggvs_eval.arrays import Map
from ggvs_eval.contrib.training.blend.blend_augmentation import Augmentation, augment
from ggvs_eval.contrib.training.blend.blend_loss import BlendLossWeights, blend_loss
from ggvs_eval.contrib.training.blend.perceptual_loss import require_perceptual
from ggvs_eval.contrib.training.samples.blend_samples import BlendSample, RawViews
from ggvs_eval.contrib.training.samples.samples import SamplePool, require_room
from ggvs_eval.contrib.training.task import Schedule
from ggvs_eval.errors import TrainingError
from ggvs_eval.files.images import quantise
from ggvs_eval.metrics.image.psnr import psnr
from ggvs_eval.metrics.image.ssim import ssim
from ggvs_eval.pipelines.online.blend_network import BlendNetwork, BlendNetworkOptions, compose_tensors, read_outputs
from ggvs_eval.pipelines.online.blend_weights import weights_name
from ggvs_eval.pipelines.online.network_blender import blend_by, blend_start
from ggvs_eval.pipelines.online.network_inputs import GUIDED, guide_depth, input_channels, reference_depth

Change = Callable[[RawViews, Map], tuple[RawViews, Map]]
LEARNING = Schedule(1e-3, weight_decay=1e-5, warm_up=100, cool_down=0.4)
FINE_TUNING = Schedule(3e-4, weight_decay=1e-5, warm_up=50, cool_down=0.5)  # of weights that have learned already


@dataclass(frozen=True)
class BlendTask:
    """The training of the blending network.

    Attributes:
        training: samples to learn from; their `prepare` makes them.
        validation: samples that are never learned from.
        seed: of the weights and the crops.
        crop_width: of the crops, pixels.
        augmentation: of the crops; None leaves them as they are but for mirroring and the order of colours.
        schedule: see `Schedule`; the weight decay is the paper's.

    Reading:
        The paper has 2e-4, for long trainings on a GPU. Ours lasts an hour of one core: at 1e-3 the refiner has most
        of what it can learn after 500 steps.
    """

    training: SamplePool[BlendSample]
    validation: SamplePool[BlendSample]
    config: BlendNetworkOptions = field(default_factory=BlendNetworkOptions)
    seed: int = 0
    crop_width: int = 320
    crop_height: int = 240
    batch_size: int = 4
    weights: BlendLossWeights = field(default_factory=BlendLossWeights)
    augmentation: Augmentation | None = field(default_factory=Augmentation)
    schedule: Schedule = LEARNING

    def __post_init__(self) -> None:
        """Refuse options that do not fit together."""
        for source in (*self.training.sources, *self.validation.sources):
            if source.most_views > self.config.views:
                raise TrainingError(
                    f"a network for {self.config.views} views cannot learn from samples of {source.most_views} views"
                )
        require_room(self.training, self.crop_width, self.crop_height)
        if self.weights.perceptual > 0:
            require_perceptual(self.crop_width, self.crop_height)

    @property
    def name(self) -> str:
        """Names the weights."""
        return weights_name(self.config.guidance)

    @property
    def summary(self) -> str:
        """Sentence of the model card on the network."""
        return "The training of the blending network."

    @property
    def data(self) -> str:
        """Sentence of the model card on the training data."""
        return f"{self.training.data}; the target takes no part in depth"

    @property
    def evaluated_on(self) -> str:
        """Sentence of the model card on the measures of `validate`."""
        return (
            f"PSNR (dB) and SSIM, means of whole views, single instants, and `geometric_`: of the geometric blender on the same "
            f"views: {self.validation.data}."
        )

    @property
    def step_pixels(self) -> int:
        """Pixels of target views that a step learns from."""
        return self.batch_size * self.crop_width * self.crop_height

    def network(self) -> nn.Module:
        """A fresh network."""
        torch.manual_seed(self.seed)
        return BlendNetwork(self.config)

    def settle(self, network: nn.Module) -> None:
        """Nothing: the network normalises by no statistics."""

    def batch(self, step: int) -> dict[str, Tensor]:
        """Channels (B, 9 K + 1, H, W), and the input of `blend_loss`."""
        rng = np.random.default_rng([self.seed, step])
        crops = [self._crop(rng) for _ in range(self.batch_size)]
        return {name: torch.from_numpy(np.stack([crop[name] for crop in crops])) for name in crops[0]}

    def loss(self, network: nn.Module, batch: Mapping[str, Tensor]) -> tuple[Tensor, Mapping[str, float]]:
        """Eq. 7 and its terms."""
        assert isinstance(network, BlendNetwork)
        outputs = read_outputs(network(batch["channels"]), batch, self.config.views)
        image = network.refine(compose_tensors(outputs, batch["colours"], batch["coverage"]), outputs, batch)
        return blend_loss(image, outputs, batch, self.weights, self.config.guidance in GUIDED)

    def validate(self, network: nn.Module) -> Mapping[str, float]:
        """Scores of the network and of the geometric blender, as an evaluation would measure them."""
        assert isinstance(network, BlendNetwork)
        network = deepcopy(network).cpu()  # where the kernels are
        sums = dict.fromkeys(("psnr_db", "ssim", "geometric_psnr_db", "geometric_ssim"), 0.0)
        guidance = self.config.guidance
        for index in range(len(self.validation)):
            sample = self.validation.read(index)
            images = {"": quantise(blend_by(network, sample.views.maps(guidance)).image), "geometric_": sample.geometric}
            for prefix, image in images.items():
                sums[f"{prefix}psnr_db"] += psnr(image, sample.truth)
                sums[f"{prefix}ssim"] += ssim(image, sample.truth)
        return {name: value / len(self.validation) for name, value in sums.items()}

    def _crop(self, rng: np.random.Generator) -> dict[str, Map]:
        """A random window of a random sample, perhaps mirrored, its colours in any order."""
        sample = self.training.read(int(rng.integers(len(self.training))))
        width, height = sample.views.target.size
        left, top = rng.integers(width - self.crop_width + 1), rng.integers(height - self.crop_height + 1)
        change = None if self.augmentation is None else partial(augment, rng=rng, options=self.augmentation)
        arrays = crop_arrays(sample, (int(left), int(top), self.crop_width, self.crop_height), self.config, change)
        return mirrored(recoloured(arrays, rng.permutation(3)), bool(rng.random() < 0.5))


def crop_arrays(
    sample: BlendSample, window: tuple[int, int, int, int], config: BlendNetworkOptions, change: Change | None = None
) -> dict[str, Map]:
    """Return the input of the network and its loss from a window (left, top, width, height) of a sample.

    Depths and distances are measured in the unit of the whole view, as they are when the network is used. Views that the sample
    does not have cover nothing. `change` may alter the crop's views and truth first.
    """
    left, top, width, height = window
    unit = reference_depth(guide_depth(sample.views.splatted, config.guidance), sample.views.target)
    views = sample.views.cropped(*window)
    truth = sample.truth[top : top + height, left : left + width].astype(np.float32) / np.float32(255)
    views, truth = (views, truth) if change is None else change(views, truth)
    maps = views.maps(config.guidance)
    of_views = {
        "colours": np.moveaxis(maps.colours, 3, 1),
        "coverage": maps.coverage,
        "alphas": np.stack(maps.alphas),
        "depths": np.stack(maps.depths) / np.float32(unit),
    }
    start = blend_start(maps)
    of_views |= {"weights": start.pop("weights")}
    return {
        "channels": input_channels(maps.reduced(config.scale), config.guidance, config.views, unit),
        **{name: _filled_up(array, config.views) for name, array in of_views.items()},
        **start,
        "fused_depth": maps.fused_depth / np.float32(unit),
        "truth": np.moveaxis(truth, 2, 0),
    }


def _filled_up(array: Map, views: int) -> Map:
    """Values per view, (K, ...), with zeros for the views that are not there."""
    return np.concatenate([array, np.zeros((views - len(array), *array.shape[1:]), np.float32)])


def recoloured(arrays: Mapping[str, Map], order: np.ndarray) -> dict[str, Map]:
    """The arrays of a crop with red, green and blue in another order."""
    colours = arrays["colours"][:, order]
    channels = arrays["channels"].copy()
    small = channels[: 3 * len(colours)].reshape(len(colours), 3, *channels.shape[1:])
    channels[: 3 * len(colours)] = small[:, order].reshape(-1, *channels.shape[1:])
    pictures = {name: arrays[name][order] for name in ("background", "truth")}
    return {**arrays, **pictures, "channels": channels, "colours": colours}


def mirrored(arrays: Mapping[str, Map], mirror: bool) -> dict[str, Map]:
    """The arrays of a crop, left and right swapped: no channel knows its side, angles and lengths stay what they are."""
    flipped = {name: array[..., ::-1] if mirror and array.ndim > 1 else array for name, array in arrays.items()}
    return {name: np.ascontiguousarray(array) for name, array in flipped.items()}
