"""The blending network: what its outputs mean, and the composition of Eqs. 4-5 that gradients flow
through; its weights files.

Weights ship, one file per guidance, or are a file of the user.

Its U-Net runs in torch, which training differentiates, and by compiled kernels with equal bits;
these take layers packed once for as long as a network keeps its weights.
"""

from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import TypeVar
from weakref import WeakKeyDictionary

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from ggvs_eval.arrays import Map
from ggvs_eval.errors import WeightsError
from ggvs_eval.files.weights_file import load_strict, read_tensors, require_shapes
from ggvs_eval.kernels import SIMD_LEVELS, get_simd_level, get_threads
from ggvs_eval.pipelines.online.network_inputs import GUIDED, Guidance, channel_count
from ggvs_eval.pipelines.online.refiner import EVIDENCE, NO_WEIGHT, STATISTICS, Refiner, evidence

Packed = TypeVar("Packed")
_kept: WeakKeyDictionary[nn.Module, tuple[Hashable, object]] = WeakKeyDictionary()
LEVELS = 4
SIZE_MULTIPLE = 2**LEVELS
# the coarsest level must be two cells wide, or there is nothing to reflect
LEAST_SIZE_PX = 2 * SIZE_MULTIPLE
BEYOND_VIEWS = 4  # outputs besides one per view: weight of the background and change of its colour
WIDTHS = {"small": 8, "standard": 16, "large": 32}  # of named sizes; the standard one ships
SURE = 0.02  # the background's weight starts between this and 1 - this
NETWORK = "a blending network"  # in messages
CPU = torch.device("cpu")
MOST_SCALE = 8  # of a weights file, lest a wrong one asks for anything
SUFFIXES: dict[Guidance, str] = {
    "registered": "",
    "channels": "-as-printed",
    "none": "-no-tsdf",
    "naive": "-naive",
}


@dataclass(frozen=True)
class BlendNetworkShape:
    """Shape of a blending network.

    Attributes:
        views: the most source views it takes; fewer are fine.
        guidance: what it sees of the fused depth: ``registered`` views, its ``channels`` as the
            paper prints them, or ``none`` (ablation 'No TSDF Guidance'); ``naive``: no depth at
            all.
        width: channels of the U-Net's first level.
        scale: the U-Net works on N times fewer pixels per side; only its weights are enlarged.
        features: channels that the U-Net hands to a `Refiner` at full size; none, and no refiner,
            with 0.

    Reading:
        The paper's network works at full size, on a GPU with TensorRT. Weights are smooth but where
        a view is occluded, and there the coverage, which stays at full size, has the edge, as has
        the refiner: at a quarter of the size the U-Net costs a sixteenth.
    """

    views: int = 6
    guidance: Guidance = "registered"
    width: int = 16
    scale: int = 4
    features: int = 8

    @property
    def inputs(self) -> int:
        """Channels of the input."""
        return channel_count(self.views, self.guidance)

    @property
    def outputs(self) -> int:
        """Channels of the output."""
        return self.views + BEYOND_VIEWS + self.features


class BlendNetwork(nn.Module):
    """The U-Net between the input channels and the outputs that `read_outputs` understands, and the
    refiner behind them.
    """

    def __init__(self, config: BlendNetworkShape) -> None:
        super().__init__()
        self.config = config
        # is in the weights file: no shape reveals it
        self.register_buffer("scale", torch.tensor(config.scale))
        self.unet = UNet(config.inputs, config.outputs, config.width)
        for parameter in self.unet.last.parameters():
            nn.init.zeros_(parameter)  # so it begins as geometric weights and learns what to change
        self.refiner = Refiner(config.features) if config.features else None

    @staticmethod
    def completed(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Give earlier weights the refiner's `condition` that they lack: zeros, by which no bit
        changes.
        """
        taps = tensors.get("refiner.taps.weight")
        if taps is None or taps.ndim != 4 or "refiner.condition.weight" in tensors:
            return dict(tensors)
        width = 3 * taps.shape[1]
        zeros = {
            "refiner.condition.weight": taps.new_zeros(width, STATISTICS),
            "refiner.condition.bias": taps.new_zeros(width),
        }
        return {**tensors, **zeros}

    def forward(self, channels: Tensor) -> Tensor:
        """Return the input channels (B, inputs, h, w) to raw outputs (B, views + 4 + features, h,
        w).
        """
        return self.unet(channels)

    def refine(
        self, picture: Tensor, outputs: "BlendOutputs", views: Mapping[str, Tensor]
    ) -> Tensor:
        """Return the composed picture with the refiner's changes, if the network has one.

        Args:
            picture: what the outputs compose, (B, 3, H, W).
            views: ``colours`` (B, K, 3, H, W), ``coverage`` (B, K, H, W) and ``fused_depth`` (B, H,
                W).

        Returns:
            (B, 3, H, W), not limited to [0, 1].
        """
        if self.refiner is None:
            return picture
        coverage, depth = views["coverage"], views["fused_depth"]
        guide = depth if self.config.guidance in GUIDED else torch.zeros_like(depth)
        evidence_maps = evidence(
            picture, views["colours"], outputs.weights * coverage, coverage, guide
        )
        return self.refiner(picture, evidence_maps, outputs.features)


@dataclass(frozen=True, eq=False)
class BlendOutputs:
    """Outputs of the network for every pixel.

    Attributes:
        weights: w_k, (B, K, H, W), positive, sum 1 over the views.
        background_weight: w_BG, (B, H, W), in [0, 1].
        background: I_BG, (B, 3, H, W), in [0, 1].
        features: for the refiner, (B, F, H, W).
    """

    weights: Tensor
    background_weight: Tensor
    background: Tensor
    features: Tensor


def read_outputs(raw: Tensor, start: Mapping[str, Tensor], most_views: int) -> BlendOutputs:
    """Raw outputs (B, N + 4 + F, h, w) as weights, background and features at full size, float32.

    Args:
        start: where it starts from: ``weights`` (B, K), the geometric weight of each view,
            ``unseen`` (B, H, W), how little of what the target sees is shown, ``background`` (B, 3,
            H, W), the picture filled from its surroundings.
        most_views: N, how many views the network takes; K of them are there.

    Reading:
        The paper names no activations: a softmax over the views, whose ratios alone matter, a
        sigmoid for the background's weight. Outputs are changes to geometric weights and to a
        filled picture, so that an untrained network is the geometric blender and training starts
        there.
    """
    views, small = start["weights"].shape[1], small_outputs(raw, start["weights"], most_views)
    height, width = start["unseen"].shape[1:]
    scale = -(-height // small.shape[2])
    if scale > 1:
        small = functional.interpolate(
            small, scale_factor=scale, mode="bilinear", align_corners=False
        )[..., :height, :width]
    return BlendOutputs(
        weights=small[:, :views],
        background_weight=torch.sigmoid(
            small[:, views] + torch.logit(start["unseen"].clamp(SURE, 1 - SURE))
        ),
        background=(start["background"] + small[:, views + 1 : views + BEYOND_VIEWS]).clamp(0, 1),
        features=small[:, views + BEYOND_VIEWS :],
    )


def small_outputs(raw: Tensor, weights: Tensor, most_views: int) -> Tensor:
    """Return what `read_outputs` enlarges, (B, K + 4 + F, h, w): w_k, changes to background weight
    and colour, features.
    """
    views = weights.shape[1]
    values = raw.float()
    logits = values[:, :views] + weights.clamp_min(NO_WEIGHT).log()[:, :, None, None]
    sure, colour, features = values[:, most_views:].split(
        [1, 3, values.shape[1] - most_views - BEYOND_VIEWS], dim=1
    )
    return torch.cat([torch.softmax(logits, dim=1), sure, torch.tanh(colour), features], dim=1)


def compose_tensors(outputs: BlendOutputs, colours: Tensor, coverage: Tensor) -> Tensor:
    """Return the views over the background (Eqs. 4-5).

    Args:
        colours: the views, (B, K, 3, H, W).
        coverage: the factors of their weights, (B, K, H, W).

    Returns:
        Images, (B, 3, H, W).

    Reading:
        The denominator of Eq. 4 lacks its sum over k as printed; the normalised sum is meant.
    """
    foreground = weighted_mean_tensor(colours, outputs.weights * coverage)
    return foreground + outputs.background_weight[:, None] * (outputs.background - foreground)


def weighted_mean_tensor(values: Tensor, weights: Tensor) -> Tensor:
    """Return the mean over the views, 0 if no view has weight.

    Args:
        values: (B, K, C, H, W).
        weights: (B, K, H, W).
    """
    total = weights.sum(dim=1, keepdim=True).clamp_min(NO_WEIGHT)  # (B, 1, H, W)
    return (weights[:, :, None] * values).sum(dim=1) / total


class UNet(nn.Module):
    """Four levels of two convolutions each, a bottleneck, and back again with skips.

    Args:
        inputs: channels.
        outputs: channels, without a final activation.
        width: channels of the first level; every further level doubles them, the bottleneck has 16
            times as many.

    Reading:
        The paper says "four-layer U-Net" and gives no width. With 32 channels the multiplications
        per frame fit its timings; its blocks are taken after common practice for depth fusion:
        reflection padding and one normalisation group.
    """

    def __init__(self, inputs: int, outputs: int, width: int) -> None:
        super().__init__()
        widths = [width << level for level in range(LEVELS + 1)]
        befores = [inputs, *widths[:-1]]
        self.down = nn.ModuleList(
            _block(before, after) for before, after in zip(befores, widths, strict=True)
        )
        self.up = nn.ModuleList(
            _block(3 * level_width, level_width) for level_width in reversed(widths[:-1])
        )
        self.pool = nn.MaxPool2d(3, 2, 1)
        self.last = nn.Conv2d(width, outputs, 1)

    def forward(self, features: Tensor) -> Tensor:
        """Return the channels in, (B, inputs, H, W), to channels out, (B, outputs, H, W).

        Any size of at least one pixel.
        """
        height, width = features.shape[2:]
        added = (*margins(width), *margins(height))
        features = functional.pad(features, added, mode="replicate")
        skips: list[Tensor] = []
        for level, block in enumerate(self.down):
            features = block(self.pool(features) if level else features)
            skips.append(features)
        skips.pop()  # the bottleneck
        for block in self.up:
            enlarged = functional.interpolate(
                features, scale_factor=2, mode="bilinear", align_corners=False
            )
            features = block(torch.cat([skips.pop(), enlarged], dim=1))
        return self.last(features[..., added[2] : added[2] + height, added[0] : added[0] + width])


def _block(before: int, after: int) -> nn.Sequential:
    """Return two times padding by reflection, 3 x 3 convolution, normalisation over all channels
    and pixels, ReLU.
    """
    layers: list[nn.Module] = []
    for channels in (before, after):
        layers.append(nn.Conv2d(channels, after, 3, padding=1, padding_mode="reflect"))
        layers.append(nn.GroupNorm(1, after))
        layers.append(nn.ReLU(inplace=True))
    return nn.Sequential(*layers)


def margins(size: int) -> tuple[int, int]:
    """Return the pixels to add before and behind a side, so that every level divides it."""
    missing = max(LEAST_SIZE_PX - size, -size % SIZE_MULTIPLE)
    return missing // 2, missing - missing // 2


def unet_outputs(unet: UNet, channels: Map, indices: NDArray[np.intp] | None = None) -> Map:
    """Evaluate a U-Net on channels (inputs, H, W): (outputs, H, W), float32.

    Args:
        unet: its weights.
        channels: its inputs, or some of them.
        indices: numbers of the inputs that `channels` are, ascending, all unless given. The others
            are 0: sums are the same bits without them.

    `UNet.forward` is what training differentiates, and defines this in the tests. Torch would need
    one thread for equal bits: its convolutions sum in another order with more.

    Raises:
        TypeError: another number of channels than the first layer takes.
    """
    from ggvs_eval.kernels import _core

    key = None if indices is None else tuple(indices.tolist())
    layers = packed_once(unet, key, lambda: _layers(unet, indices))
    last = (
        np.ascontiguousarray(parameter_map(unet.last, "weight")[:, :, 0, 0]),
        parameter_map(unet.last, "bias"),
    )
    epsilon = next(module.eps for module in unet.modules() if isinstance(module, nn.GroupNorm))
    inputs = np.ascontiguousarray(channels, np.float32)
    return _core.unet(
        inputs, layers, last, epsilon, get_threads(), SIMD_LEVELS.index(get_simd_level())
    )


def _layers(unet: UNet, indices: NDArray[np.intp] | None) -> list[tuple[Map, Map, Map, Map]]:
    """Packed filters and bias, gain and shift of all convolutions and the normalisations behind
    them, in order of use.
    """
    from ggvs_eval.kernels import _core

    modules = [module for block in (*unet.down, *unet.up) for module in block.modules()]
    convolutions = [module for module in modules if isinstance(module, nn.Conv2d)]
    norms = [module for module in modules if isinstance(module, nn.GroupNorm)]
    layers: list[tuple[Map, Map, Map, Map]] = []
    for convolution, norm in zip(convolutions, norms, strict=True):
        weights, bias = parameter_map(convolution, "weight"), parameter_map(convolution, "bias")
        if indices is not None and not layers:
            weights = weights[:, indices]
        layers.append(
            (
                *_core.pack_filters(weights, bias),
                parameter_map(norm, "weight"),
                parameter_map(norm, "bias"),
            )
        )
    return layers


def packed_once(module: nn.Module, key: Hashable, pack: Callable[[], Packed]) -> Packed:
    """Return the packed layers of a module, cached.

    Packed again when a parameter or the key changes.

    Args:
        module: whose parameters `pack` reads.
        key: anything else it depends on.
        pack: makes what is kept.
    """
    state = (
        key,
        tuple(
            (parameter.data_ptr(), parameter.stride(), _version(parameter))
            for parameter in module.parameters()
        ),
    )
    cached = _kept.get(module)
    if cached is None or cached[0] != state:
        cached = _kept[module] = state, pack()
    return cached[1]  # type: ignore[return-value]


def _version(parameter: nn.Parameter) -> int:
    """Return the number of writes to a tensor.

    Inference tensors, which nothing trains, do not count.
    """
    return -1 if parameter.is_inference() else parameter._version


def parameter_map(module: nn.Module, name: str) -> Map:
    """Return a parameter as a float32 array."""
    return module.get_parameter(name).detach().float().cpu().numpy()


def weights_name(guidance: Guidance) -> str:
    """Return the name of a network's weights, without file suffix."""
    return f"blend{SUFFIXES[guidance]}"


def shipped_blend_weights(guidance: Guidance = "registered") -> Path:
    """Return the file of the weights that ship.

    Raises:
        WeightsError: none ship for that guidance.
    """
    folder = Path(str(resources.files("ggvs_eval.pipelines") / "weights"))
    path = folder / f"{weights_name(guidance)}.safetensors"
    if not path.is_file():
        file_names = (
            ", ".join(sorted(file.name for file in folder.glob("blend*.safetensors"))) or "none"
        )
        raise WeightsError(
            f"no blending network with {guidance} guidance ships (wanted {path.name}, there are: "
            f"{file_names}); train one (ggvs-eval train blend)"
        )
    return path


@lru_cache(maxsize=4)
def load_blend_network(path: Path, device: torch.device = CPU) -> BlendNetwork:
    """Return the network of a weights file, in evaluation mode.

    Its configuration is known from the tensors' shapes.

    Args:
        path: safetensors, or a torch checkpoint that is a state dict.
        device: of the network.

    Raises:
        WeightsError: absent, damaged, or tensors of no blending network.
    """
    tensors = BlendNetwork.completed(read_tensors(path, model=NETWORK))
    network = BlendNetwork(_configuration(tensors, path))
    load_strict(tensors, network, path, NETWORK)
    if device.type != "cpu":
        return network.eval().to(device)
    # Channels side by side are convolved twice as fast.
    return network.eval().to(memory_format=torch.channels_last)  # type: ignore[call-overload]


def _configuration(tensors: Mapping[str, torch.Tensor], path: Path) -> BlendNetworkShape:
    """Return the configuration whose parameters these are: by names, shapes and the scale that is
    kept among them.
    """
    shapes = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
    first, last = shapes.get("unet.down.0.0.weight", ()), shapes.get("unet.last.weight", ())
    scale = int(tensors["scale"]) if shapes.get("scale") == () else 0
    if len(first) != 4 or len(last) != 4 or not 1 <= scale <= MOST_SCALE:
        raise WeightsError(
            f"{path}: {len(shapes)} tensors of no blending network; give weights that `train "
            f"blend` wrote"
        )
    looks = shapes.get("refiner.looks.0.weight", ())
    features = looks[1] - EVIDENCE if len(looks) == 4 else 0
    views = last[0] - BEYOND_VIEWS - features
    for guidance in SUFFIXES:
        config = BlendNetworkShape(
            views=views, guidance=guidance, width=first[0], scale=scale, features=features
        )
        if views > 0 and config.inputs == first[1]:
            with torch.device("meta"):  # a wrong file may ask for any width
                network = BlendNetwork(config)
            require_shapes(tensors, network, path, f"{NETWORK} of width {config.width}")
            return config
    raise WeightsError(
        f"{path}: {last[0]} outputs, {views} views, want {channel_count(views, 'registered')} "
        f"inputs, {channel_count(views, 'channels')} as printed, {channel_count(views, 'none')} "
        f"without TSDF guidance or {channel_count(views, 'naive')} without depth, got {first[1]}; "
        "give weights that `train blend` wrote"
    )
