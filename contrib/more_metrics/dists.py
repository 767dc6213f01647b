"""DISTS, deep structure and texture similarity (Ding et al. 2020), on the VGG16 that LPIPS uses."""

from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from ggvs_eval.arrays import Mask
from ggvs_eval.contrib.more_metrics.fetch_dists import CHANNELS, FETCH_COMMAND, dists_weights_path
from ggvs_eval.errors import MetricError, WeightsError
from ggvs_eval.metrics.image.lpips_network import (
    LAYERS,
    MIN_SIDE_PX,
    compiled_layers,
    load_weights,
    network_input,
    weights_path,
)
from ggvs_eval.metrics.inputs import Image, check_pair, count_inside, require_finite, white_level
from ggvs_eval.metrics.metric import (
    FURTHER,
    ColourMap,
    MetricOptions,
    TruthFrame,
    Value,
    ViewMetric,
)

if TYPE_CHECKING:
    import torch

STABILISER = 1e-6
Statistics = tuple["torch.Tensor", "torch.Tensor"]


def dists(rendered: Image, truth: Image, mask: Mask | None = None) -> float:
    """Return the distance of structure and texture of two frames, tolerant to textures that are
    sampled anew.

    Args:
        rendered: (H, W, 3), uint8 in 0..255 or float in [0, 1].
        truth: captured frame, same shape and kind.
        mask: (H, W), the part that counts; None for the whole frame.

    Returns:
        0 for equal frames, about 1 for unlike ones; lower is better.

    Raises:
        MetricError: shapes or kinds differ, or the frames or the part are too small.
        WeightsError: weights have not been fetched, or a file is damaged.

    Example:
        >>> import numpy as np
        >>> truth = np.full((16, 16, 3), 100, np.uint8)
        >>> round(dists(truth, truth), 6)  # doctest: +SKIP
        0.0

    Reading:
        The frame enters at its own size, as the authors' module takes it; their script shrinks
        photographs to 256 pixels first, which gives other values. In a part, a place of a layer
        counts by the share of its pixels that are inside.
    """
    check_pair(rendered, truth)
    return dists_between(dists_features(rendered), dists_features(truth), mask)


def dists_features(image: Image, device: str = "cpu") -> "list[torch.Tensor]":
    """Return the frame and its features after each of the five blocks of VGG16, 3 to 512 channels,
    (1, C, H', W') float32 each.

    Raises:
        MetricError: the frame is too small.
        WeightsError: LPIPS' weights of VGG16 have not been fetched, or the file is damaged.
    """
    import torch

    if min(image.shape[:2]) < MIN_SIDE_PX["vgg"]:
        raise MetricError(
            f"DISTS needs at least {MIN_SIDE_PX['vgg']} pixels a side, got {image.shape[:2]}"
        )
    weights = None if device == "cpu" else load_weights("vgg", device)
    with (
        torch.inference_mode(),
        torch.backends.cudnn.flags(enabled=True, deterministic=True, allow_tf32=False),
    ):
        unit = torch.from_numpy(np.ascontiguousarray(image, dtype=np.float32)) / white_level(image)
        stages = [unit.permute(2, 0, 1)[None].to(device)]
        features = network_input(image, device)[None].contiguous(memory_format=torch.channels_last)
        first = 0
        for last in (i + 1 for i, layer in enumerate(LAYERS["vgg"]) if layer.tap):
            features = _l2_pool(features) if first else features
            features = _block(features, first, last, weights)
            stages.append(features)
            first = last
    return stages


def _block(
    features: "torch.Tensor", first: int, last: int, weights: "dict[str, torch.Tensor] | None"
) -> "torch.Tensor":
    """Convolutions of VGG16 from `first` to `last`, with these weights or by the compiled
    kernel.
    """
    import torch
    from torch.nn import functional

    if weights is None:
        pixels = np.ascontiguousarray(features[0].permute(1, 2, 0).numpy())
        return torch.from_numpy(compiled_layers(pixels, first, last)[0]).permute(2, 0, 1)[None]
    for i in range(first, last):
        features = functional.conv2d(
            features, weights[f"conv{i}.weight"], weights[f"conv{i}.bias"], 1, 1
        ).relu_()
    return features


def _l2_pool(features: "torch.Tensor") -> "torch.Tensor":
    """Return the root of the squares under a Hann window of 3 x 3 at every second place, in the
    place of VGG's maximum.

    As sums of shifted slices, a tenth of the time of a convolution by channel.
    """
    from torch.nn import functional

    squares = functional.pad(features.square(), (1, 1, 1, 1))
    for axis in (2, 3):
        count = (squares.shape[axis] - 1) // 2
        first, second, third = (_every_second(squares, axis, start, count) for start in range(3))
        squares = (first + third).mul_(0.25).add_(second, alpha=0.5)
    return squares.add_(1e-12).sqrt_()


def _every_second(values: "torch.Tensor", axis: int, start: int, count: int) -> "torch.Tensor":
    return (
        values[:, :, start : start + 2 * count : 2]
        if axis == 2
        else values[..., start : start + 2 * count : 2]
    )


def dists_between(
    rendered: "list[torch.Tensor]", truth: "list[torch.Tensor]", mask: Mask | None = None
) -> float:
    """DISTS of two frames from their `dists_features`.

    Raises:
        MetricError: the frames differ in size, the part is too small, or values are not finite.
        WeightsError: the weights of DISTS have not been fetched, or the file is damaged.
    """
    import torch

    if [stage.shape for stage in rendered] != [stage.shape for stage in truth]:
        raise MetricError(
            "DISTS: the frames differ in size; resize or render again, metrics never resample"
        )
    similarity = 0.0
    with torch.inference_mode():
        weights = load_dists_weights(str(truth[0].device))
        for x, y, (texture, structure) in zip(rendered, truth, weights, strict=True):
            mean = _mean_over(x, mask)
            mean_x, mean_y = mean(x), mean(y)
            variances = mean((x - mean_x).square_()) + mean((y - mean_y).square_())
            covariance = mean(x * y) - mean_x * mean_y
            of_means = (2 * mean_x * mean_y + STABILISER) / (
                mean_x.square() + mean_y.square() + STABILISER
            )
            of_changes = (2 * covariance + STABILISER) / (variances + STABILISER)
            similarity += float(
                (texture * of_means.flatten() + structure * of_changes.flatten()).sum()
            )
    return require_finite(1 - similarity, "DISTS")


def _mean_over(stage: "torch.Tensor", mask: Mask | None) -> "partial[torch.Tensor]":
    """Return the mean over the places of a stage, (1, C, 1, 1), or over the shares of them that are
    inside a mask.
    """
    import torch

    if mask is None:
        return partial(torch.mean, dim=(2, 3), keepdim=True)
    count_inside(mask, mask.shape)
    share = torch.from_numpy(
        cv2.resize(
            mask.astype(np.float32), (stage.shape[3], stage.shape[2]), interpolation=cv2.INTER_AREA
        )
    )
    return partial(_weighted_mean, share=(share / share.sum()).to(stage.device))


def _weighted_mean(values: "torch.Tensor", share: "torch.Tensor") -> "torch.Tensor":
    import torch

    return torch.einsum("nchw,hw->nc", values, share)[..., None, None]


@lru_cache(maxsize=1)
def load_dists_weights(device: str = "cpu") -> "list[Statistics]":
    """Return the weights of texture and of structure of each stage, (C,) each.

    Together they sum to 1.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    path = dists_weights_path()
    if not path.is_file():
        raise WeightsError(
            f"DISTS: no weights at {path}; run `{FETCH_COMMAND}` with network access"
        )
    try:
        tensors = load_file(path, device=device)
    except SafetensorError as error:
        raise WeightsError(
            f"{path}: damaged ({error}); move it away and run `{FETCH_COMMAND}`"
        ) from error
    if {name: tuple(tensor.shape) for name, tensor in tensors.items()} != dict.fromkeys(
        ("alpha", "beta"), (sum(CHANNELS),)
    ):
        raise WeightsError(
            f"{path}: wanted the tensors of DISTS, got others; move it away and run "
            f"`{FETCH_COMMAND}`"
        )
    total = tensors["alpha"].sum() + tensors["beta"].sum()
    split = ((tensors[name] / total).split(CHANNELS) for name in ("alpha", "beta"))
    return list(zip(*split, strict=True))


class DistsScorer:
    """DISTS; the truth's features are shared by all methods and parts."""

    names = ("DISTS",)

    def __init__(
        self, _names: object, options: MetricOptions, _colour_map: ColourMap | None
    ) -> None:
        self._options = options

    def add(self, index: int, rendered: Image, truth: TruthFrame) -> list[Value]:
        """See `Scorer`."""
        return [("DISTS", index, _to_truth(rendered, truth, self._options.device))]

    def finish(self) -> list[Value]:
        """See `Scorer`."""
        return []


def _to_truth(rendered: Image, truth: TruthFrame, device: str, mask: Mask | None = None) -> float:
    load_dists_weights(device)  # before the networks' work
    truth_features = truth.once(dists_features, lambda: dists_features(truth.image, device))
    return dists_between(dists_features(rendered, device), truth_features, mask)


def _weights_file(_options: MetricOptions) -> Path:
    """Of the two files that it needs the one that is absent, if one is."""
    return min(weights_path("vgg"), dists_weights_path(), key=Path.is_file)


DISTS = ViewMetric(
    name="DISTS",
    kind="frame",
    function=dists,
    higher_is_better=False,
    group=FURTHER,
    decimals=4,
    describe="distance of deep structure and texture, tolerant to resampled textures",
    reference="Ding et al. 2020",
    scorer=DistsScorer,
    inside=lambda pair, mask: _to_truth(pair.rendered, pair.truth, pair.options.device, mask),
    inside_note=", by the features whose pixels are in it",
    weights=_weights_file,
    on_device=True,
)
