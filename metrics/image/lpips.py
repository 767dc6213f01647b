"""LPIPS v0.1, learned perceptual similarity (Zhang et al. 2018), on VGG16 or AlexNet."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8, Mask
from ggvs_eval.errors import MetricError
from ggvs_eval.kernels import SIMD_LEVELS, _features, get_simd_level, get_threads
from ggvs_eval.metric_choices import LpipsNet
from ggvs_eval.metrics.image.lpips_network import (
    BANDED_LAYERS,
    LAYERS,
    MIN_SIDE_PX,
    compiled_bands,
    compiled_input,
    compiled_layers,
    load_heads,
    load_weights,
    network_input,
    tapped_layers,
    weights_path,
)
from ggvs_eval.metrics.inputs import Image, check_pair, count_inside, require_finite
from ggvs_eval.metrics.metric import (
    QUALITY,
    ColourMap,
    FramePair,
    MetricOptions,
    TruthFrame,
    Value,
    ViewMetric,
    shared_by_parts,
)

if TYPE_CHECKING:
    import torch

Features: TypeAlias = "list[NDArray[np.float32]] | list[torch.Tensor]"  # of the compared layers
# Of truths whose features a process remembers from one run to the next; four of 480 x 360 pixels.
REMEMBERED_BYTES = 400_000_000
PIXEL_BYTES = 488  # of VGG's compared layers
MOST_AT_ONCE = 8  # renders that are compared in bands together: at 1352 x 1014 each takes 80 MB


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
        The paper names no network. VGG is taken: the evaluators of its baselines use it, and 0.191
        at 31 dB fits VGG, not AlexNet. Frames enter in [-1, 1], as the metric was trained; several
        code bases feed [0, 1] and get other values. ``vgg`` on the CPU is computed by a compiled
        kernel, within 1e-6 of torch and in half of its time. ``vgg-bf16`` multiplies in bfloat16 by
        torch and compares in single precision, and is 6e-5 to 9e-5 lower on renders of the demo
        room.
    """
    check_pair(rendered, truth)
    if net == "vgg":
        (maps,) = compare_in_bands(truth, [rendered])
        return _distance(maps, net).value
    return lpips_between(lpips_features(rendered, net), lpips_features(truth, net), net)


def lpips_features(image: Image, net: LpipsNet, device: str = "cpu") -> Features:
    """Compute the LPIPS features of a frame, so that one truth can be compared with several renders
    at the cost of one.

    Args:
        image: (H, W, 3), uint8 in 0..255 or float in [0, 1].
        net: ``vgg``, ``alex`` or ``vgg-bf16``.

    Returns:
        Feature maps of the compared layers, float32: arrays (H', W', C) of ``vgg`` on the CPU,
        which needs no torch, else tensors (1, C, H', W').
    """
    if net not in LAYERS:
        raise MetricError(f"LPIPS: wanted a network of {', '.join(LAYERS)}, got {net!r}")
    _require_side(image, net)
    if net == "vgg" and device == "cpu":
        return compiled_layers(compiled_input(image))
    import torch

    weights = load_weights(net, device)
    # On a GPU without rounded factors, and with equal bits from call to call.
    with (
        torch.inference_mode(),
        torch.backends.cudnn.flags(enabled=True, deterministic=True, allow_tf32=False),
    ):
        features = (
            network_input(image, device)[None]
            .to(weights["conv0.weight"])
            .contiguous(memory_format=torch.channels_last)
        )
        return [tap.float() for tap in tapped_layers(features, LAYERS[net], weights)]


def _require_side(image: Image, net: LpipsNet) -> None:
    if min(image.shape[:2]) < MIN_SIDE_PX[net]:
        raise MetricError(
            f"LPIPS-{net} needs at least {MIN_SIDE_PX[net]} pixels a side, got {image.shape[:2]}"
        )


@dataclass(frozen=True)
class LpipsDistance:
    """LPIPS of two frames.

    Attributes:
        maps: of each compared layer the distance at every place of the layer, (H', W'); the sum of
            their means is the value.
    """

    value: float
    maps: tuple[NDArray[np.float32], ...]

    def inside(self, mask: Mask) -> float:
        """Distance of a part of the frame, (H, W) bool.

        A place of a layer counts by the share of its pixels that are inside.
        """
        count_inside(mask, mask.shape)
        weight = mask.astype(np.float32)
        total = 0.0
        for distances in self.maps:
            share = cv2.resize(weight, distances.shape[::-1], interpolation=cv2.INTER_AREA)
            total += float((distances * share).sum(dtype=np.float64) / share.sum(dtype=np.float64))
        return total


def lpips_between(rendered: Features, truth: Features, net: LpipsNet) -> float:
    """`compare_features`, the value alone."""
    return compare_features(rendered, truth, net).value


def compare_features(rendered: Features, truth: Features, net: LpipsNet) -> LpipsDistance:
    """LPIPS of two frames from their `lpips_features`.

    Those of an 8-bit truth serve float renders too.
    """
    if [layer.shape for layer in rendered] != [layer.shape for layer in truth]:
        raise MetricError(
            f"LPIPS-{net}: the frames differ in size; resize or render again, metrics never "
            f"resample"
        )
    device = "cpu" if isinstance(truth[0], np.ndarray) else str(truth[0].device)
    distance: Callable[..., NDArray[np.float32]] = (
        _compiled_distances if device == "cpu" else _device_distances
    )
    return _distance(
        [distance(*layer) for layer in zip(rendered, truth, load_heads(net, device), strict=True)],
        net,
    )


def _distance(maps: Sequence[NDArray[np.float32]], net: LpipsNet) -> LpipsDistance:
    """Return the distance whose maps these are."""
    value = require_finite(
        sum(float(layer.mean(dtype=np.float64)) for layer in maps), f"LPIPS-{net}"
    )
    return LpipsDistance(value, tuple(maps))


def compare_in_bands(truth: Image, renderings: Sequence[Image]) -> list[list[NDArray[np.float32]]]:
    """Compare frames with one truth by VGG on the CPU: the maps of `compare_features`, bit by bit,
    in a fraction of its memory.

    Whole features of large frames are never kept: those of 1352 x 1014 pixels are 660 MB a frame.
    """
    _require_side(truth, "vgg")
    heads: Any = load_heads("vgg")
    halved, distances = compiled_bands(
        [compiled_input(image) for image in (truth, *renderings)], heads
    )
    truth_layers = compiled_layers(halved.pop(0), BANDED_LAYERS)
    for maps in distances:
        layers = compiled_layers(halved.pop(0), BANDED_LAYERS)
        maps += [
            _compiled_distances(*layer)
            for layer in zip(layers, truth_layers, heads[len(maps) :], strict=True)
        ]
    return distances


def _compiled_distances(
    rendered: Any, truth: Any, weights: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return the weighted squared difference of the unit feature vectors of two frames, (H, W)."""
    features, truth_features = map(_as_array, (rendered, truth))
    return _features.compare_features(
        features, truth_features, weights, get_threads(), SIMD_LEVELS.index(get_simd_level())
    )


def _as_array(layer: "NDArray[np.float32] | torch.Tensor") -> NDArray[np.float32]:
    """Return the features (H, W, C) of an array, or of a tensor (1, C, H, W) on the CPU."""
    return (
        layer
        if isinstance(layer, np.ndarray)
        else np.ascontiguousarray(layer[0].permute(1, 2, 0).numpy())
    )


def _device_distances(
    rendered: "torch.Tensor", truth: "torch.Tensor", weights: "torch.Tensor"
) -> NDArray[np.float32]:
    """`_compiled_distances` on a device."""
    import torch

    with torch.inference_mode():
        features, truth_features = (
            vectors / (torch.linalg.vector_norm(vectors, dim=1, keepdim=True) + 1e-10)
            for vectors in (rendered, truth)
        )
        return torch.einsum("nchw,c->hw", (features - truth_features).square_(), weights).numpy(
            force=True
        )


def truth_features(truth: TruthFrame, options: MetricOptions) -> Features:
    """`lpips_features` of a captured frame, once for all methods and metrics, and for runs scored
    one after another.
    """
    net, device = options.lpips_net, options.device
    return truth.once((lpips_features, net), lambda: _remembered.features(truth.image, net, device))


class _Remembered:
    """Features of the truths that were seen last, up to a number of bytes."""

    def __init__(self, most_bytes: int) -> None:
        self._most_bytes = most_bytes
        self._kept: dict[tuple[str, LpipsNet, str], Features] = {}

    def features(self, image: Image8, net: LpipsNet, device: str) -> Features:
        """`lpips_features` of an image."""
        key = hashlib.sha256(str(image.shape).encode() + image.tobytes()).hexdigest(), net, device
        features = self._kept.pop(key, None) or lpips_features(image, net, device)
        self._kept[key] = features  # the last to go
        sizes = [sum(layer.nbytes for layer in layers) for layers in self._kept.values()]
        while sum(sizes) > self._most_bytes:
            del self._kept[next(iter(self._kept))], sizes[0]
        return features


_remembered = _Remembered(REMEMBERED_BYTES)


def _bands_of(rendered: Image, truth: TruthFrame) -> list[NDArray[np.float32]]:
    """`compare_in_bands` of a frame, together with others of `TruthFrame.renderings` where it is
    one of them.
    """
    renderings = truth.renderings
    at = next((n for n, rendering in enumerate(renderings) if rendering is rendered), None)
    if at is None:
        return compare_in_bands(truth.image, [rendered])[0]
    first = at - at % MOST_AT_ONCE
    together = renderings[first : first + MOST_AT_ONCE]
    return truth.once((compare_in_bands, first), lambda: compare_in_bands(truth.image, together))[
        at - first
    ]


def is_looked_at(index: int, options: MetricOptions) -> bool:
    """Return whether LPIPS is computed for the frame at this index: it costs as much as all other
    metrics on many frames.
    """
    return (options.first_frame + index) % options.lpips_every == 0


def frames_note(options: MetricOptions) -> str:
    """Note on sampling and precision."""
    precision = ", in bfloat16" if options.lpips_net == "vgg-bf16" else ""
    return precision + (
        f", of one frame in {options.lpips_every}" if options.lpips_every > 1 else ""
    )


def distance_to_truth(rendered: Image, truth: TruthFrame, options: MetricOptions) -> LpipsDistance:
    """LPIPS of a frame, once for the metric and its parts."""
    net, pixels = options.lpips_net, truth.image.shape[0] * truth.image.shape[1]

    def compute() -> LpipsDistance:
        if net == "vgg" and options.device == "cpu" and pixels * PIXEL_BYTES > REMEMBERED_BYTES:
            return _distance(_bands_of(rendered, truth), net)
        return compare_features(
            lpips_features(rendered, net, options.device), truth_features(truth, options), net
        )

    return shared_by_parts(rendered, truth, (compare_features, net), compute)


def _inside(pair: FramePair, mask: Mask) -> float | None:
    if not is_looked_at(pair.index, pair.options):
        return None
    return distance_to_truth(pair.rendered, pair.truth, pair.options).inside(mask)


class LpipsScorer:
    """LPIPS; the truth's features are shared by all methods."""

    names = ("LPIPS",)

    def __init__(
        self, _names: Sequence[str], options: MetricOptions, _colour_map: ColourMap | None
    ) -> None:
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
    """Return the weights that a protocol's LPIPS needs."""
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
    inside_note=", by the features whose pixels are in it",
    weights=weights_file,
    on_device=True,
)
