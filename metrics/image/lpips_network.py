"""The networks of LPIPS and DISTS: their weights, and features of frames by torch or by a compiled
kernel.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.errors import WeightsError
from ggvs_eval.files.download import cache_folder
from ggvs_eval.kernels import SIMD_LEVELS, _features, get_simd_level, get_threads
from ggvs_eval.metric_choices import LpipsNet
from ggvs_eval.metrics.inputs import Image, white_level

if TYPE_CHECKING:
    import torch

# Mean and spread of ImageNet's colours for images in [-1, 1], per channel.
COLOUR_SHIFT = (-0.030, -0.088, -0.188)
COLOUR_SCALE = (0.458, 0.448, 0.450)
FETCH_COMMAND = "python -m ggvs_eval.metrics.image.fetch_lpips"


def weights_path(net: LpipsNet) -> Path:
    """Return the safetensors file of a network, present or not."""
    return cache_folder() / f"lpips-v0.1-{net.removesuffix('-bf16')}.safetensors"


@dataclass(frozen=True)
class Layer:
    """One convolution with its ReLU.

    `pool` is the (size, stride) of a maximum filter before it, `tap` marks a compared layer.
    """

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
# Of VGG the layers and levels that `compiled_bands` takes; deeper, filters outgrow maps, and a band
# would share them too little.
BANDED_LAYERS, BANDED_LEVELS = 7, 3
# below, the last layer has no pixel
MIN_SIDE_PX: dict[LpipsNet, int] = {"vgg": 16, "vgg-bf16": 16, "alex": 31}


def load_weights(net: LpipsNet, device: str = "cpu") -> "dict[str, torch.Tensor]":
    """The tensors of a network from the cache folder, read once per process.

    Those of convolutions as torch is fastest with them.

    Raises:
        WeightsError: absent, damaged, or tensors of another network.
    """
    return _torch_weights(weights_path(net), net, device)


def load_heads(
    net: LpipsNet, device: str = "cpu"
) -> "list[NDArray[np.float32]] | list[torch.Tensor]":
    """Weights of channel differences, (C,) per compared layer: arrays, or tensors on a device other
    than the CPU.

    Errors are those of `load_weights`.
    """
    return _heads(weights_path(net), net, device)


@lru_cache(maxsize=2)
def _torch_weights(path: Path, net: LpipsNet, device: str) -> "dict[str, torch.Tensor]":
    import torch

    dtype = torch.bfloat16 if net == "vgg-bf16" else torch.float32
    with torch.inference_mode(False):  # anyone who asks first, a training may learn by them later
        return {
            name: _kernel(
                torch.tensor(
                    array, dtype=torch.float32 if name.startswith("head") else dtype, device=device
                )
            )
            for name, array in _read_arrays(path, net).items()
        }


@lru_cache(maxsize=1)
def _packed_layers(path: Path) -> list[tuple[NDArray[np.float32], NDArray[np.float32], bool]]:
    """VGG's filters, biases and marks of compared layers as the compiled kernel takes them:
    235 MB.
    """
    arrays = _read_arrays(path, "vgg")
    return [
        (
            _features.pack_filters(arrays[f"conv{i}.weight"], get_threads()),
            arrays[f"conv{i}.bias"],
            layer.tap,
        )
        for i, layer in enumerate(LAYERS["vgg"])
    ]


@lru_cache(maxsize=4)
def _heads(
    path: Path, net: LpipsNet, device: str
) -> "list[NDArray[np.float32]] | list[torch.Tensor]":
    arrays = _read_arrays(path, net)
    heads = [
        arrays[f"head{i}.weight"].reshape(-1)
        for i in range(sum(layer.tap for layer in LAYERS[net]))
    ]
    if device == "cpu":
        return heads
    import torch

    return [torch.from_numpy(head).to(device) for head in heads]


def _read_arrays(path: Path, net: LpipsNet) -> dict[str, NDArray[np.float32]]:
    """Return the arrays of a network's file, by their names."""
    from safetensors import SafetensorError
    from safetensors.numpy import load_file

    if not path.is_file():
        raise WeightsError(
            f"LPIPS-{net}: no weights at {path}; run `{FETCH_COMMAND}` with network access"
        )
    try:
        arrays = load_file(path)
    except SafetensorError as error:
        raise WeightsError(
            f"{path}: damaged ({error}); move it away and run `{FETCH_COMMAND}`"
        ) from error
    convolutions, heads = len(LAYERS[net]), sum(layer.tap for layer in LAYERS[net])
    convolution_names = {
        f"conv{i}.{part}" for i in range(convolutions) for part in ("weight", "bias")
    }
    if set(arrays) != convolution_names | {f"head{i}.weight" for i in range(heads)}:
        raise WeightsError(
            f"{path}: wanted the tensors of {net}, got those of another network; move it away and "
            f"run `{FETCH_COMMAND}`"
        )
    return arrays


def _kernel(tensor: "torch.Tensor") -> "torch.Tensor":
    """Return a convolution's kernel in the fastest memory layout; its bias stays as it is."""
    import torch

    return tensor.contiguous(memory_format=torch.channels_last) if tensor.ndim == 4 else tensor


def network_input(image: Image, device: str = "cpu") -> "torch.Tensor":
    """A frame as the networks were trained on it, (3, H, W) float32.

    Bytes are uploaded, not the floats that they become.
    """
    import torch

    levels = image if image.dtype == np.uint8 else image.astype(np.float32)
    signed = (
        torch.from_numpy(np.ascontiguousarray(levels)).to(device).float()
        * (2.0 / white_level(image))
        - 1.0
    )
    shift, scale = (torch.tensor(values, device=device) for values in (COLOUR_SHIFT, COLOUR_SCALE))
    return ((signed - shift) / scale).permute(2, 0, 1)


def compiled_input(image: Image) -> NDArray[np.float32]:
    """`network_input` as `compiled_layers` takes it, with the same bits: an array, (H, W, 3)."""
    signed = image.astype(np.float32) * np.float32(2.0 / white_level(image)) - np.float32(1)
    shift, scale = (np.array(values, np.float32) for values in (COLOUR_SHIFT, COLOUR_SCALE))
    return np.asarray((signed - shift) / scale, np.float32)


def network_input_of(images: "torch.Tensor") -> "torch.Tensor":
    """`network_input` of a batch (B, 3, H, W) in [0, 1], through which gradients flow."""
    import torch

    shift, scale = (
        torch.tensor(values, device=images.device)[:, None, None]
        for values in (COLOUR_SHIFT, COLOUR_SCALE)
    )
    return (images * 2 - 1 - shift) / scale


def tapped_layers(
    features: "torch.Tensor", layers: tuple[Layer, ...], weights: "dict[str, torch.Tensor]"
) -> "list[torch.Tensor]":
    """Run `network_input` of frames (B, 3, H, W) through the network and keep what is compared."""
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


def compiled_layers(
    features: NDArray[np.float32], first: int = 0, last: int | None = None
) -> list[NDArray[np.float32]]:
    """Some of VGG's layers by the compiled kernel, which takes half of torch's time and none to
    load it.

    Args:
        features: (H, W, C) what enters the first of them; `compiled_input` enters layer 0.
        first: of `LAYERS`.
        last: the one that is no longer taken.

    Returns:
        Those that are compared, (H', W', C') each, within 1e-5 of the largest of torch's.
    """
    layers = _packed_layers(weights_path("vgg"))[first:last]
    return list(
        _features.feature_maps(features, layers, get_threads(), SIMD_LEVELS.index(get_simd_level()))
    )


def compiled_bands(
    frames: Sequence[NDArray[np.float32]], heads: Sequence[NDArray[np.float32]]
) -> tuple[list[NDArray[np.float32]], list[list[NDArray[np.float32]]]]:
    """Run frames through VGG's first layers together, by bands of rows, and compare all with the
    first one.

    Args:
        frames: `compiled_input`, of one size.
        heads: see `load_heads`.

    Returns:
        What layer `BANDED_LAYERS` takes of each frame, and of each but the first its distances at
        the levels before, (H', W') each; their bits are those of whole maps.
    """
    layers, level = (
        _packed_layers(weights_path("vgg"))[:BANDED_LAYERS],
        SIMD_LEVELS.index(get_simd_level()),
    )
    return _features.compare_banded(frames, layers, heads[:BANDED_LEVELS], get_threads(), level)
