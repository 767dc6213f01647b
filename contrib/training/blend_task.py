"""Training task of the blending network: to make the target's picture of splatted views and fused
depth.
"""

from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import partial

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from ggvs_eval.arrays import Map
from ggvs_eval.baselines.fitted.optimiser import structural_loss
from ggvs_eval.contrib.training.samples.sample_kinds import BlendSample, RawViews
from ggvs_eval.contrib.training.samples.samples import SamplePool, require_room
from ggvs_eval.contrib.training.task import Schedule
from ggvs_eval.errors import TrainingError
from ggvs_eval.files.images import quantise
from ggvs_eval.geometry.splat import COVERED_ALPHA
from ggvs_eval.metric_choices import LpipsNet
from ggvs_eval.metrics.image.lpips_network import (
    LAYERS,
    MIN_SIDE_PX,
    load_weights,
    network_input_of,
    tapped_layers,
)
from ggvs_eval.metrics.image.psnr import psnr
from ggvs_eval.metrics.image.ssim import ssim
from ggvs_eval.pipelines.online.blend_network import (
    BlendNetwork,
    BlendNetworkShape,
    BlendOutputs,
    compose_tensors,
    read_outputs,
    weighted_mean_tensor,
    weights_name,
)
from ggvs_eval.pipelines.online.network_blender import blend_by, blend_start
from ggvs_eval.pipelines.online.network_inputs import (
    GUIDED,
    guide_depth,
    input_channels,
    reference_depth,
)

NET: LpipsNet = "alex"  # a tenth of VGG's time, and not the network that tables score by
NOISE_255 = 3.0  # standard deviation of the truth's noise at which the term counts half
NORMAL_MEDIAN = 0.6745  # of the absolute value of a standard normal variable


def perceptual_loss(image: Tensor, truth: Tensor) -> Tensor:
    """LPIPS v0.1 between rendered and captured crops, less where the truth is noisy.

    Args:
        image: (B, 3, H, W), at least 31 x 31.
        truth: same shape, in [0, 1].

    Reading:
        Not in the paper, whose L1 and SSIM blur what they cannot place: trained on captures with
        noise and motion blur next to clean ones, the network became softer in clean rooms (LPIPS
        0.083 to 0.090). LPIPS asks for the truth's fine detail back, but of a noisy truth it asks
        for noise, which costs PSNR and can only be guessed; hence the weight.
    """
    weights = load_weights(NET, str(truth.device))
    with torch.no_grad():
        truth_layers = tapped_layers(network_input_of(truth), LAYERS[NET], weights)
    layers = tapped_layers(network_input_of(image.clamp(0, 1)), LAYERS[NET], weights)
    distances = torch.zeros(len(truth), device=truth.device)
    for layer, (features, truth_features) in enumerate(zip(layers, truth_layers, strict=True)):
        squared = (
            functional.normalize(features, eps=1e-10)
            - functional.normalize(truth_features, eps=1e-10)
        ).square()
        distances = (
            distances
            + torch.einsum("nchw,c->n", squared, weights[f"head{layer}.weight"])
            / squared[0, 0].numel()
        )
    return (distances / (1 + (noise_255(truth) / NOISE_255) ** 2)).mean()


def require_perceptual(width: int, height: int) -> None:
    """Refuse crops or weights the term cannot be computed with, before any work.

    Args:
        width: of the crops, pixels.
    """
    if min(width, height) < MIN_SIDE_PX[NET]:
        raise TrainingError(
            f"the perceptual term wants crops of at least {MIN_SIDE_PX[NET]} pixels a side, got "
            f"{width} x {height}; use larger crops, or perceptual=0"
        )
    load_weights(NET)


def noise_255(images: Tensor) -> Tensor:
    """Estimate the noise of images (B, 3, H, W) in [0, 1]: standard deviation of a channel, (B,),
    in levels of 255.

    By the median of a filter that planes and straight edges pass without a trace (Immerkær, Fast
    noise variance estimation, 1996), of the mean of the channels, whose noise is taken to be
    independent.
    """
    kernel = torch.tensor([[1.0, -2, 1], [-2, 4, -2], [1, -2, 1]], device=images.device)[None, None]
    filtered = functional.conv2d(images.mean(dim=1, keepdim=True), kernel).abs().flatten(1)
    return filtered.median(dim=1).values * (255 * 3**0.5 / (6 * NORMAL_MEDIAN))


@dataclass(frozen=True)
class BlendLossWeights:
    """Weights of the terms: the paper's four, and those added here.

    Attributes:
        l1: mean absolute error of the colour.
        ssim: 1 - SSIM.
        depth: `depth_loss`.
        mask: `mask_loss`.
        perceptual: `perceptual_loss`; 0 for the paper's loss.
    """

    l1: float = 0.8
    ssim: float = 0.2
    depth: float = 0.1
    mask: float = 0.1
    perceptual: float = 0.1


def blend_loss(
    image: Tensor,
    outputs: BlendOutputs,
    batch: Mapping[str, Tensor],
    weights: BlendLossWeights,
    tsdf_guidance: bool,
) -> tuple[Tensor, dict[str, float]]:
    """Eq. 7, and the perceptual term.

    Args:
        image: the synthesised view, (B, 3, H, W).
        batch: ``alphas`` (B, K, H, W) of the views and ``truth`` (B, 3, H, W) in [0, 1]; ``depths``
            (B, K, H, W) and ``fused_depth`` (B, H, W) in the scene's own unit of length, 0 where
            unknown.
        tsdf_guidance: without it there is no fused depth to follow: the depth term is left out.

    Returns:
        The loss, and its terms for the log.
    """
    terms = {
        "l1": (image - batch["truth"]).abs().mean(),
        "ssim": structural_loss(image, batch["truth"]),
        "mask": mask_loss(outputs.background_weight, batch["alphas"]),
    }
    if weights.perceptual > 0:
        terms["perceptual"] = perceptual_loss(image, batch["truth"])
    if tsdf_guidance:
        terms["depth"] = depth_loss(
            batch["depths"], batch["fused_depth"], outputs.weights * batch["alphas"]
        )
    loss = torch.stack([getattr(weights, name) * term for name, term in terms.items()]).sum()
    return loss, {f"{name}_loss": float(term.detach()) for name, term in terms.items()}


def depth_loss(depths: Tensor, fused_depth: Tensor, weights: Tensor) -> Tensor:
    """Measure the distance of the blended depth of the views from the fused one (Eq. 6).

    Args:
        depths: splatted depth of each view, (B, K, H, W), 0 where unknown.
        fused_depth: (B, H, W), 0 where unknown.
        weights: alpha_k w_k, (B, K, H, W).

    Reading:
        As printed the denominator lacks its sum over the views, and the sum over pixels is divided
        by H W K: kept, so the term weighs a K-th of what its factor says; K is the network's, views
        that a sample lacks included. Depth is measured in each scene's own unit
        (`reference_depth`), else the loss would depend on the scale of the world. Pixels count
        where the fused depth is known and a view has weight.
    """
    visible = weights * (depths > 0)
    blended = weighted_mean_tensor(depths[:, :, None], visible)[:, 0]
    counted = (fused_depth > 0) & (visible.sum(dim=1) > 1e-3)
    return ((blended - fused_depth).abs() * counted).mean() / depths.shape[1]


def mask_loss(background_weight: Tensor, alphas: Tensor) -> Tensor:
    """Measure how far the background's weight is from 1 if no view covers the pixel, and from 0
    elsewhere.

    Args:
        background_weight: w_BG, (B, H, W).
        alphas: coverage, (B, K, H, W).
    """
    empty = (alphas.amax(dim=1) < COVERED_ALPHA).float()
    return (background_weight - empty).abs().mean()


@dataclass(frozen=True)
class Augmentation:
    """Strengths of the augmentation of crops.

    Attributes:
        gain: standard deviation of the logarithm of one gain for sources and truth alike, per
            channel.
        view_gain: of one gain per view, ...
        view_gain_share: ... in this share of the crops.
        blur_px: largest standard deviation of a blur of one view, ...
        blur_share: ... in this share of the crops.
        shift_px: standard deviation by which each view is displaced, as wrong depth or a wrong pose
            would, ...
        shift_share: ... in this share of the crops.
    """

    gain: float = 0.1
    view_gain: float = 0.02
    view_gain_share: float = 0.3
    blur_px: float = 1.2
    blur_share: float = 0.15
    shift_px: float = 0.7
    shift_share: float = 0.25


def augment(
    views: RawViews, truth: Map, rng: np.random.Generator, options: Augmentation
) -> tuple[RawViews, Map]:
    """Return a crop as other cameras could have seen it.

    Args:
        truth: what the target's camera saw, (H, W, 3) in [0, 1].

    Returns:
        The changed views, and the truth with the common gain.
    """
    count = len(views.sources)
    common = np.exp(rng.normal(0, options.gain, 3))
    gain = (
        np.exp(rng.normal(0, options.view_gain, (count, 1)))
        if rng.random() < options.view_gain_share
        else np.ones((count, 1))
    )
    gains = (common * gain).astype(np.float32)[:, None, None]  # (K, 1, 1, 3)
    changed = replace(
        views, splats=np.clip(views.splats * gains, 0, 1), warps=np.clip(views.warps * gains, 0, 1)
    )
    if rng.random() < options.shift_share:
        changed = displaced(changed, rng.normal(0, options.shift_px, (count, 2)))
    if rng.random() < options.blur_share:
        changed = _blurred(
            changed, int(rng.integers(count)), float(rng.uniform(0.3, options.blur_px))
        )
    return changed, np.clip(truth * common.astype(np.float32), 0, 1)


def displaced(views: RawViews, shifts_px: NDArray[np.float64]) -> RawViews:
    """Return each view moved in the target view by (right, down) pixels, (K, 2).

    The border is repeated.
    """

    def moved(maps: Map) -> Map:
        return np.stack(
            [_moved(view_map, *shift) for view_map, shift in zip(maps, shifts_px, strict=True)]
        )

    return replace(
        views,
        splats=moved(views.splats),
        warps=moved(views.warps),
        alphas=moved(views.alphas),
        visibilities=moved(views.visibilities),
        depths=moved(views.depths),
    )


def _moved(image: Map, right: float, down: float) -> Map:
    matrix = np.array([[1, 0, right], [0, 1, down]], np.float64)
    size = image.shape[1::-1]
    nearest = image.ndim == 2  # depth and coverage: what is between two surfaces is neither
    flags = cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR
    return np.asarray(
        cv2.warpAffine(image, matrix, size, flags=flags, borderMode=cv2.BORDER_REPLICATE),
        np.float32,
    )


def _blurred(views: RawViews, index: int, sigma_px: float) -> RawViews:
    splats, warps = views.splats.copy(), views.warps.copy()
    for colours in (splats, warps):
        colours[index] = cv2.GaussianBlur(colours[index], (0, 0), sigma_px)
    return replace(views, splats=splats, warps=warps)


Change = Callable[[RawViews, Map], tuple[RawViews, Map]]
LEARNING = Schedule(1e-3, weight_decay=1e-5, warm_up=100, cool_down=0.4)
# of weights that have learned already
FINE_TUNING = Schedule(3e-4, weight_decay=1e-5, warm_up=50, cool_down=0.5)


@dataclass(frozen=True)
class BlendTask:
    """The training of the blending network.

    Attributes:
        training: samples to learn from; their `prepare` makes them.
        validation: samples that are never learned from.
        seed: of the weights and the crops.
        crop_width: of the crops, pixels.
        augmentation: of the crops; None leaves them as they are except for mirroring and the order
            of colours.
        schedule: see `Schedule`; the weight decay is the paper's.

    Reading:
        The paper has 2e-4, for long trainings on a GPU. The schedule here takes an hour of one
        core: at 1e-3 the refiner has most of what it can learn after 500 steps.
    """

    training: SamplePool[BlendSample]
    validation: SamplePool[BlendSample]
    config: BlendNetworkShape = field(default_factory=BlendNetworkShape)
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
                    f"a network for {self.config.views} views cannot learn from samples of "
                    f"{source.most_views} views"
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
        return f"{self.training.data}; depth excludes the target"

    @property
    def evaluated_on(self) -> str:
        """Sentence of the model card on the measures of `validate`."""
        return (
            "PSNR (dB) and SSIM, means of whole views, single instants, and `geometric_`: of the "
            f"geometric blender on the same views: {self.validation.data}."
        )

    @property
    def step_pixels(self) -> int:
        """Pixels of target views that a step learns from."""
        return self.batch_size * self.crop_width * self.crop_height

    def network(self) -> nn.Module:
        """Return a fresh network."""
        torch.manual_seed(self.seed)
        return BlendNetwork(self.config)

    def settle(self, network: nn.Module) -> None:
        """Nothing: the network normalises by no statistics."""

    def batch(self, step: int) -> dict[str, Tensor]:
        """Return the channels (B, 9 K + 1, H, W), and the input of `blend_loss`."""
        rng = np.random.default_rng([self.seed, step])
        crops = [self._crop(rng) for _ in range(self.batch_size)]
        return {
            name: torch.from_numpy(np.stack([crop[name] for crop in crops])) for name in crops[0]
        }

    def loss(
        self, network: nn.Module, batch: Mapping[str, Tensor]
    ) -> tuple[Tensor, Mapping[str, float]]:
        """Eq. 7 and its terms."""
        assert isinstance(network, BlendNetwork)
        outputs = read_outputs(network(batch["channels"]), batch, self.config.views)
        image = network.refine(
            compose_tensors(outputs, batch["colours"], batch["coverage"]), outputs, batch
        )
        return blend_loss(image, outputs, batch, self.weights, self.config.guidance in GUIDED)

    def validate(self, network: nn.Module) -> Mapping[str, float]:
        """Return the scores of the network and of the geometric blender, as an evaluation would
        measure them.
        """
        assert isinstance(network, BlendNetwork)
        network = deepcopy(network).cpu()  # where the kernels are
        sums = dict.fromkeys(("psnr_db", "ssim", "geometric_psnr_db", "geometric_ssim"), 0.0)
        guidance = self.config.guidance
        for index in range(len(self.validation)):
            sample = self.validation.read(index)
            images = {
                "": quantise(blend_by(network, sample.views.maps(guidance)).image),
                "geometric_": sample.geometric,
            }
            for prefix, image in images.items():
                sums[f"{prefix}psnr_db"] += psnr(image, sample.truth)
                sums[f"{prefix}ssim"] += ssim(image, sample.truth)
        return {name: value / len(self.validation) for name, value in sums.items()}

    def _crop(self, rng: np.random.Generator) -> dict[str, Map]:
        """Return a random window of a random sample, perhaps mirrored, its colours in any order."""
        sample = self.training.read(int(rng.integers(len(self.training))))
        width, height = sample.views.target.size
        left, top = (
            rng.integers(width - self.crop_width + 1),
            rng.integers(height - self.crop_height + 1),
        )
        change = (
            None
            if self.augmentation is None
            else partial(augment, rng=rng, options=self.augmentation)
        )
        arrays = crop_arrays(
            sample, (int(left), int(top), self.crop_width, self.crop_height), self.config, change
        )
        return mirrored(recoloured(arrays, rng.permutation(3)), bool(rng.random() < 0.5))


def crop_arrays(
    sample: BlendSample,
    window: tuple[int, int, int, int],
    config: BlendNetworkShape,
    change: Change | None = None,
) -> dict[str, Map]:
    """Return the input of the network and its loss from a window (left, top, width, height) of a
    sample.

    Depths and distances are measured in the unit of the whole view, as they are when the network is
    used. Views that the sample does not have cover nothing. `change` may alter the crop's views and
    truth first.
    """
    left, top, width, height = window
    unit = reference_depth(guide_depth(sample.views.splatted, config.guidance), sample.views.target)
    views = sample.views.cropped(*window)
    truth = sample.truth[top : top + height, left : left + width].astype(np.float32) / np.float32(
        255
    )
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
    """Return the values per view, (K, ...), with zeros for the views that are not there."""
    return np.concatenate([array, np.zeros((views - len(array), *array.shape[1:]), np.float32)])


def recoloured(arrays: Mapping[str, Map], order: np.ndarray) -> dict[str, Map]:
    """Return the arrays of a crop with red, green and blue in another order."""
    colours = arrays["colours"][:, order]
    channels = arrays["channels"].copy()
    small = channels[: 3 * len(colours)].reshape(len(colours), 3, *channels.shape[1:])
    channels[: 3 * len(colours)] = small[:, order].reshape(-1, *channels.shape[1:])
    pictures = {name: arrays[name][order] for name in ("background", "truth")}
    return {**arrays, **pictures, "channels": channels, "colours": colours}


def mirrored(arrays: Mapping[str, Map], mirror: bool) -> dict[str, Map]:
    """Return the arrays of a crop, left and right swapped: no channel knows its side, angles and
    lengths stay what they are.
    """
    flipped = {
        name: array[..., ::-1] if mirror and array.ndim > 1 else array
        for name, array in arrays.items()
    }
    return {name: np.ascontiguousarray(array) for name, array in flipped.items()}
