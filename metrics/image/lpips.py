"""LPIPS v0.1, learned perceptual similarity (Zhang et al. 2018), on VGG16 or AlexNet."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8, Mask
from ggvs_eval.errors import MetricError, WeightsError
from ggvs_eval.metrics.image.fetch_lpips import FETCH_COMMAND, weights_path
from ggvs_eval.metrics.inputs import Image, check_pair, count_inside, require_finite, white_level
from ggvs_eval.metrics.metric import (
    QUALITY,
    ColourMap,
    FramePair,
    LpipsNet,
    MetricOptions,
    TruthFrame,
    Value,
    ViewMetric,
    shared_by_parts,
)

if TYPE_CHECKING:
    import torch

# Mean and spread of ImageNet's colours for images in [-1, 1], per channel.
COLOUR_SHIFT = (-0.030, -0.088, -0.188)
COLOUR_SCALE = (0.458, 0.448, 0.450)


@dataclass(frozen=True)
class Layer:
    """One convolution with its ReLU; `pool` is the (size, stride) of a maximum filter before it, `tap` marks a compared layer."""

    pool: tuple[int, int] | None = None
    stride: int = 1
    padding: int = 1
    tap: bool = False


_VGG_POOL = (2, 2)
_ALEX_POOL = (3, 2)
_VGG = (
    *(Layer(), Layer(tap=True)),
    *(Layer(_VGG_POOL), Layer(tap=True)),
    *(Layer(_VGG_POOL), Layer(), Layer(tap=True)),
    *(Layer(_VGG_POOL), Layer(), Layer(tap=True)),
    *(Layer(_VGG_POOL), Layer(), Layer(tap=True)),
)
LAYERS: dict[LpipsNet, tuple[Layer, ...]] = {
    "vgg": _VGG,
    "vgg-bf16": _VGG,
    "alex": (
        Layer(stride=4, padding=2, tap=True),
        Layer(_ALEX_POOL, padding=2, tap=True),
        Layer(_ALEX_POOL, tap=True),
        Layer(tap=True),
        Layer(tap=True),
    ),
}
ROWS_AT_ONCE = 16  # of a feature map, so that the comparison stays in cache
MIN_SIDE_PX: dict[LpipsNet, int] = {"vgg": 16, "vgg-bf16": 16, "alex": 31}  # below, the last layer has no pixel
# Of truths whose features a process remembers from one run to the next; four of 480 x 360 pixels.
REMEMBERED_BYTES = 400_000_000


def lpips(rendered: Image, truth: Image, net: LpipsNet = "vgg") -> float:
    """Learned perceptual distance of two frames.

    Args:
        rendered: (H, W, 3), uint8 in 0..255 or float in [0, 1].
        truth: captured frame, same shape and kind.
        net: ``vgg``, ``alex`` or ``vgg-bf16``; their values do not compare.

    Returns:
        Distance, 0 for equal frames; lower is better.

    Raises:
        MetricError: shapes or kinds differ, the frames are too small, or no such network.
        WeightsError: the weights have not been fetched, or the file is damaged.

    Example:
        >>> import numpy as np
        >>> truth = np.full((16, 16, 3), 100, np.uint8)
        >>> lpips(truth, truth)  # doctest: +SKIP
        0.0

    Reading:
        The paper names no network. VGG is taken: the evaluators of its baselines use it, and 0.191 at 31 dB fits VGG, not
        AlexNet. Frames enter in [-1, 1], as the metric was trained; several code bases feed [0, 1] and get other values.
        ``vgg-bf16`` multiplies in bfloat16 and compares in single precision: about 1.75 times as fast where the processor has
        such instructions, and 6e-5 to 9e-5 lower on renders of the demo room.
    """
    check_pair(rendered, truth)
    return lpips_between(lpips_features(rendered, net), lpips_features(truth, net), net)


def lpips_features(image: Image, net: LpipsNet, device: str = "cpu") -> "list[torch.Tensor]":
    """Compute the LPIPS features of a frame, so that one truth can be compared with several renders at the cost of one.

    Args:
        image: (H, W, 3), uint8 in 0..255 or float in [0, 1].
        net: ``vgg``, ``alex`` or ``vgg-bf16``.

    Returns:
        Feature maps of the compared layers, each (1, C, H', W'), float32.
    """
    import torch

    if net not in LAYERS:
        raise MetricError(f"LPIPS: no network {net!r}; there are {', '.join(LAYERS)}")
    if min(image.shape[:2]) < MIN_SIDE_PX[net]:
        raise MetricError(f"LPIPS-{net} needs at least {MIN_SIDE_PX[net]} pixels a side, got {image.shape[:2]}")
    weights = load_weights(net, device)
    # On a GPU without rounded factors, and with equal bits from call to call.
    with torch.inference_mode(), torch.backends.cudnn.flags(enabled=True, deterministic=True, allow_tf32=False):
        features = network_input(image, device)[None].to(weights["conv0.weight"]).contiguous(memory_format=torch.channels_last)
        return [tap.float() for tap in tapped_layers(features, LAYERS[net], weights)]


@dataclass(frozen=True)
class LpipsDistance:
    """LPIPS of two frames.

    Attributes:
        maps: of each compared layer the distance at every place of its own size, (H', W'); the sum of their means is the value.
    """

    value: float
    maps: tuple[NDArray[np.float32], ...]

    def inside(self, mask: Mask) -> float:
        """Distance of a part of the frame, (H, W) bool; a place of a layer counts by the share of its pixels that lie inside."""
        count_inside(mask, mask.shape)
        weight = mask.astype(np.float32)
        total = 0.0
        for distances in self.maps:
            share = cv2.resize(weight, distances.shape[::-1], interpolation=cv2.INTER_AREA)
            total += float((distances * share).sum(dtype=np.float64) / share.sum(dtype=np.float64))
        return total


def lpips_between(rendered: "list[torch.Tensor]", truth: "list[torch.Tensor]", net: LpipsNet) -> float:
    """`compare_features`, the value alone."""
    return compare_features(rendered, truth, net).value


def compare_features(rendered: "list[torch.Tensor]", truth: "list[torch.Tensor]", net: LpipsNet) -> LpipsDistance:
    """LPIPS of two frames from their `lpips_features`; those of an 8-bit truth serve float renders too."""
    import torch

    if [layer.shape for layer in rendered] != [layer.shape for layer in truth]:
        raise MetricError(f"LPIPS-{net}: the frames differ in size; resize or render again, metrics never resample")
    weights = load_weights(net, str(truth[0].device))
    with torch.inference_mode():
        pairs = enumerate(zip(rendered, truth, strict=True))
        layers = [_feature_distance(ours, theirs, weights[f"head{i}.weight"]) for i, (ours, theirs) in pairs]
    value = require_finite(sum(distance for distance, _ in layers), f"LPIPS-{net}")
    return LpipsDistance(value, tuple(distances for _, distances in layers))


@lru_cache(maxsize=2)
def load_weights(net: LpipsNet, device: str = "cpu") -> "dict[str, torch.Tensor]":
    """The tensors of a network from the cache folder, read once per process; those of convolutions as the network computes."""
    import torch
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    path = weights_path(net)
    if not path.is_file():
        raise WeightsError(f"LPIPS-{net}: no weights at {path}; run `{FETCH_COMMAND}` with network access")
    try:
        tensors = load_file(path)
    except SafetensorError as error:
        raise WeightsError(f"{path}: damaged ({error}); delete it and run `{FETCH_COMMAND}`") from error
    convolutions, heads = len(LAYERS[net]), sum(layer.tap for layer in LAYERS[net])
    convolution_names = {f"conv{i}.{part}" for i in range(convolutions) for part in ("weight", "bias")}
    if set(tensors) != convolution_names | {f"head{i}.weight" for i in range(heads)}:
        raise WeightsError(f"{path}: holds the tensors of another network; delete it and run `{FETCH_COMMAND}`")
    dtype = torch.bfloat16 if net == "vgg-bf16" else torch.float32
    with torch.inference_mode(False):  # whatever asks first, as a training may learn by them later
        return {
            name: tensor.to(device, copy=True) if name.startswith("head") else _kernel(tensor.to(device, dtype, copy=True))
            for name, tensor in tensors.items()
        }


def _kernel(tensor: "torch.Tensor") -> "torch.Tensor":
    """A convolution's kernel as it lies in memory when it is fastest; its bias stays as it is."""
    import torch

    return tensor.contiguous(memory_format=torch.channels_last) if tensor.ndim == 4 else tensor


def network_input(image: Image, device: str = "cpu") -> "torch.Tensor":
    """A frame as the networks were trained on it, (3, H, W) float32; bytes are uploaded, not the floats that they become."""
    import torch

    levels = image if image.dtype == np.uint8 else image.astype(np.float32)
    signed = torch.from_numpy(np.ascontiguousarray(levels)).to(device).float() * (2.0 / white_level(image)) - 1.0
    shift, scale = (torch.tensor(each, device=device) for each in (COLOUR_SHIFT, COLOUR_SCALE))
    return ((signed - shift) / scale).permute(2, 0, 1)


def network_input_of(images: "torch.Tensor") -> "torch.Tensor":
    """`network_input` of a batch (B, 3, H, W) in [0, 1], through which gradients flow."""
    import torch

    shift, scale = (torch.tensor(each, device=images.device)[:, None, None] for each in (COLOUR_SHIFT, COLOUR_SCALE))
    return (images * 2 - 1 - shift) / scale


def tapped_layers(
    features: "torch.Tensor", layers: tuple[Layer, ...], weights: "dict[str, torch.Tensor]"
) -> "list[torch.Tensor]":
    """Run `network_input` of frames (B, 3, H, W) through the network and keep the compared layers."""
    from torch.nn import functional

    taps: list[torch.Tensor] = []
    for i, layer in enumerate(layers):
        if layer.pool:
            features = functional.max_pool2d(features, *layer.pool)
        kernel, bias = weights[f"conv{i}.weight"], weights[f"conv{i}.bias"]
        features = functional.conv2d(features, kernel, bias, layer.stride, layer.padding).relu_()
        if layer.tap:
            taps.append(features)
    return taps


def _feature_distance(
    rendered: "torch.Tensor", truth: "torch.Tensor", channel_weights: "torch.Tensor"
) -> tuple[float, NDArray[np.float32]]:
    """Weighted squared difference of the unit feature vectors of two frames (1, C, H, W): mean over the pixels, and (H, W)."""
    import torch

    rows_at_once = ROWS_AT_ONCE if truth.device.type == "cpu" else truth.shape[2]
    sums, maps = [], []  # downloaded at the end: a device is not waited for in between
    for rows in zip(rendered.split(rows_at_once, dim=2), truth.split(rows_at_once, dim=2), strict=True):
        ours, theirs = (row / (torch.linalg.vector_norm(row, dim=1, keepdim=True) + 1e-10) for row in rows)
        squared = (ours - theirs).square_()  # (1, C, rows, W)
        sums.append(torch.einsum("nchw,c->", squared, channel_weights))
        maps.append(torch.einsum("nchw,c->hw", squared, channel_weights))
    return sum(map(float, sums)) / (truth.shape[2] * truth.shape[3]), torch.cat(maps).numpy(force=True)


def truth_features(truth: TruthFrame, options: MetricOptions) -> "list[torch.Tensor]":
    """`lpips_features` of a captured frame, once for all methods and metrics, and for runs scored one after another."""
    net, device = options.lpips_net, options.device
    return truth.once((lpips_features, net), lambda: _remembered.features(truth.image, net, device))


class _Remembered:
    """Features of the truths that were seen last, up to a number of bytes."""

    def __init__(self, most_bytes: int) -> None:
        self._most_bytes = most_bytes
        self._kept: dict[tuple[str, LpipsNet, str], list[torch.Tensor]] = {}

    def features(self, image: Image8, net: LpipsNet, device: str) -> "list[torch.Tensor]":
        """`lpips_features` of an image."""
        key = hashlib.sha256(str(image.shape).encode() + image.tobytes()).hexdigest(), net, device
        features = self._kept.pop(key, None) or lpips_features(image, net, device)
        self._kept[key] = features  # the last to go
        sizes = [sum(layer.nbytes for layer in layers) for layers in self._kept.values()]
        while sum(sizes) > self._most_bytes:
            del self._kept[next(iter(self._kept))], sizes[0]
        return features


_remembered = _Remembered(REMEMBERED_BYTES)


def is_looked_at(index: int, options: MetricOptions) -> bool:
    """Tell whether LPIPS is computed for the frame at this index: it costs as much as all other metrics on many frames."""
    return (options.first_frame + index) % options.lpips_every == 0


def frames_note(options: MetricOptions) -> str:
    """Note on sampling and precision."""
    precision = ", in bfloat16" if options.lpips_net == "vgg-bf16" else ""
    return precision + (f", of one frame in {options.lpips_every}" if options.lpips_every > 1 else "")


def distance_to_truth(rendered: Image, truth: TruthFrame, options: MetricOptions) -> LpipsDistance:
    """LPIPS of a frame, once for the metric and its parts."""

    def compute() -> LpipsDistance:
        features = lpips_features(rendered, options.lpips_net, options.device)
        return compare_features(features, truth_features(truth, options), options.lpips_net)

    return shared_by_parts(rendered, truth, (compare_features, options.lpips_net), compute)


def _inside(pair: FramePair, mask: Mask) -> float | None:
    if not is_looked_at(pair.index, pair.options):
        return None
    return distance_to_truth(pair.rendered, pair.truth, pair.options).inside(mask)


class LpipsScorer:
    """LPIPS; the truth's features are shared by all methods."""

    names = ("LPIPS",)

    def __init__(self, _names: Sequence[str], options: MetricOptions, _colour_map: ColourMap | None) -> None:
        self._options = options

    def add(self, index: int, rendered: Image8, truth: TruthFrame) -> list[Value]:
        """See `Scorer`."""
        if not is_looked_at(index, self._options):
            return []
        return [("LPIPS", index, distance_to_truth(rendered, truth, self._options).value)]

    def finish(self) -> list[Value]:
        """See `Scorer`."""
        return []


def weights_file(options: MetricOptions) -> Path:
    """The weights that a protocol's LPIPS needs."""
    return weights_path(options.lpips_net)


LPIPS = ViewMetric(
    name="LPIPS",
    kind="frame",
    function=lpips,
    higher_is_better=False,
    group=QUALITY,
    decimals=3,
    describe="learned perceptual distance, v0.1",
    note=frames_note,
    reference="Zhang et al. 2018",
    scorer=LpipsScorer,
    inside=_inside,
    inside_note=", by the features whose pixels lie in it",
    weights=weights_file,
    on_device=True,
)
