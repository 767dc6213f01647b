"""ST-RRED, the paper's STED: entropy differences over space and time (Soundararajan & Bovik
2013).
"""

import ast
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array, Image8
from ggvs_eval.errors import MetricError
from ggvs_eval.metric_choices import StedPairing, StedPooling
from ggvs_eval.metrics.metric import (
    CONSISTENCY,
    ColourMap,
    MetricOptions,
    TruthFrame,
    Value,
    ViewMetric,
)
from ggvs_eval.statistics.pooling import Pooling, powers_of_means

if TYPE_CHECKING:
    import torch

MIN_SIDE_PX = 48  # two 3 x 3 blocks in a band of one eighth of the size; fewer have no statistics
BLOCK = 3
NEURAL_NOISE_VARIANCE = 0.1
# grey levels squared; float64 leaves 1e-25 where nothing is, one pixel one level off 1e-10
ROUNDING_VARIANCE = 1e-12
BAND_LEVEL = 4
LUMA_WEIGHTS = (0.2989, 0.5870, 0.1140)


class Entropies(NamedTuple):
    """Scaled block entropies of a pair of frames, each (h // 3, w // 3) of the band: what is sent
    as reduced reference.
    """

    spatial: Array
    temporal: Array


class PairDifference(NamedTuple):
    """Entropy differences between a rendered pair of frames and the true one.

    `single` pools before the absolute value.
    """

    spatial: float
    temporal: float
    spatial_single: float
    temporal_single: float


@dataclass(frozen=True)
class StRred:
    """The scores of one view.

    Attributes:
        strred: spatial and temporal differences pooled as `pool` was asked to, the paper's STED;
            lower is better.
        strred_ssn: the same from the single-number differences.
        pairs: differences of each pair, (P, 4), in the order of `PairDifference`.
    """

    strred: float
    strred_ssn: float
    pairs: Array


def strred(
    rendered: Sequence[NDArray],
    truth: Sequence[NDArray],
    pairing: StedPairing = "disjoint",
    pooling: StedPooling = "means",
) -> StRred:
    """Spatio-temporal reduced reference entropic difference of one view.

    Args:
        rendered: synthesised frames, T of (H, W, 3) uint8, or of luma (H, W) on the scale 0..255; T
            >= 2, sides >= 48.
        truth: captured frames of the same view and times.
        pairing: ``disjoint`` takes frames (0, 1), (2, 3), ... and leaves a last odd frame out;
            ``consecutive`` takes every neighbouring pair and the spatial part of the later frame.
        pooling: see `pool`.

    Raises:
        MetricError: shapes differ, fewer than 2 frames, frames too small, or values that are not
            finite.

    Example:
        >>> import numpy as np
        >>> truth = np.random.default_rng(0).integers(0, 255, (2, 48, 48, 3), np.uint8)
        >>> strred(truth, truth).strred, strred(truth // 2, truth).strred > 1.0
        (0.0, True)

    Reading:
        The paper's STED is taken for the second value of scikit-video's ``strred`` on luma in
        0..255, per view: disjoint pairs, mean times mean. Its sizes (16 to 2796) exclude luma in
        0..1. Netflix's port takes ``consecutive`` and ``products``.
    """
    if len(rendered) != len(truth):
        raise MetricError(
            f"STED: {len(rendered)} rendered frames, {len(truth)} true frames; score the same "
            f"frames"
        )
    if len(truth) < 2:
        raise MetricError(f"STED compares changes between frames: {len(truth)} frame; needs 2")
    step = 2 if pairing == "disjoint" else 1
    bands = [
        tuple(spatial_band(_as_luma(frame)) for frame in frames)
        for frames in zip(rendered, truth, strict=True)
    ]
    neighbours = [(bands[t], bands[t + 1]) for t in range(0, len(bands) - 1, step)]
    differences = [
        pair_difference(
            *(reduced_references(*side, pairing) for side in zip(first, second, strict=True))
        )
        for first, second in neighbours
    ]
    return pool(differences, pooling)


def luma(rgb8: NDArray[np.uint8]) -> NDArray[np.float32]:
    """0.2989 R + 0.5870 G + 0.1140 B of an RGB image (H, W, 3), on the scale 0..255, not
    rounded.
    """
    if rgb8.dtype != np.uint8 or rgb8.ndim != 3:
        raise MetricError(
            f"STED: wanted RGB (H, W, 3) uint8 or luma (H, W) in 0..255, got {rgb8.shape} "
            f"{rgb8.dtype}"
        )
    weights = np.array([LUMA_WEIGHTS], dtype=np.float32)
    return np.asarray(cv2.transform(rgb8.astype(np.float32), weights), dtype=np.float32)


def spatial_band(luma_255: NDArray) -> Array:
    """Vertical-derivative band of the fourth level of a six-orientation steerable pyramid.

    Args:
        luma_255: (H, W) on the scale 0..255.

    Returns:
        (ceil(H / 8), ceil(W / 8)).

    Raises:
        MetricError: not a plane, a side below 48 pixels, or values that are not finite.
    """
    require_band(luma_255.shape)
    if not np.isfinite(luma_255).all():
        raise MetricError("STED: the frame holds values that are not finite; render it again")
    low = luma_255
    *halvings, band = band_kernels()
    for kernel in halvings:
        low = _correlate_halved(low, kernel)
    return _correlate(low, band)


def device_band(image: "torch.Tensor") -> Array:
    """Compute `spatial_band` of the luma of an image, (H, W, 3) uint8, on its device.

    The band comes back to the host.
    """
    from ggvs_eval.metrics.on_device import correlate

    require_band(tuple(image.shape[:2]))
    levels = image.float()
    low = (levels * levels.new_tensor(LUMA_WEIGHTS)).sum(dim=2).double()
    *halvings, band = band_kernels()
    for kernel in halvings:
        low = correlate(low, kernel, stride=2)
    return np.asarray(correlate(low, band).numpy(force=True), dtype=np.float64)


def require_band(shape: tuple[int, ...]) -> None:
    """Refuse planes that are too small for the band."""
    if len(shape) != 2 or min(shape) < MIN_SIDE_PX:
        raise MetricError(
            f"STED needs a plane of at least {MIN_SIDE_PX} x {MIN_SIDE_PX} pixels, got {shape}"
        )


def band_kernels() -> tuple[Array, ...]:
    """Kernels of `spatial_band` in their order: those after which every second row and column is
    left, and the band's own.
    """
    _, lowpass, band = _pyramid_kernels()
    return (_first_two_lowpasses(), *[lowpass] * (BAND_LEVEL - 2), band)


def block_entropies(band: Array) -> tuple[Array, Array]:
    """Entropy and local scale of each 3 x 3 block under a Gaussian scale mixture.

    Args:
        band: (h, w), a band of one frame or the difference of two.

    Returns:
        Entropy and scale, both (h // 3, w // 3); the entropy adds log2 and natural terms, as every
        released version does.

    Reading:
        Directions without variance carry nothing (eigenvalues at rounding level are left out of
        scale and entropy), so that static or low-rank content is 0 instead of singular.
    """
    rows, columns = (size // BLOCK for size in band.shape)
    cropped = band[: rows * BLOCK, : columns * BLOCK]
    # every offset
    patches = np.lib.stride_tricks.sliding_window_view(cropped, (BLOCK, BLOCK)).reshape(
        -1, BLOCK**2
    )
    variances, directions = np.linalg.eigh(np.cov(patches, rowvar=False, bias=True))
    is_significant = variances > ROUNDING_VARIANCE
    blocks = (
        cropped.reshape(rows, BLOCK, columns, BLOCK).swapaxes(1, 2).reshape(rows, columns, BLOCK**2)
    )
    coefficients = blocks @ directions[:, is_significant]  # (rows, columns, directions)
    scale = (coefficients**2 / variances[is_significant]).sum(axis=-1) / BLOCK**2
    information = np.log2(
        scale[..., None] * variances[is_significant] + NEURAL_NOISE_VARIANCE
    ) + math.log(2 * math.pi * math.e)
    return information.sum(axis=-1), scale


def reduced_references(
    first_band: Array, second_band: Array, pairing: StedPairing = "disjoint"
) -> Entropies:
    """Scaled entropies of a pair of neighbouring frames.

    Args:
        first_band: `spatial_band` of the earlier frame.
        pairing: the spatial part comes from the earlier frame when ``disjoint``, from the later one
            when ``consecutive``.
    """
    entropy, scale = block_entropies(first_band if pairing == "disjoint" else second_band)
    change_entropy, change_scale = block_entropies(second_band - first_band)
    spatial_weight = np.log2(1 + scale)
    return Entropies(
        entropy * spatial_weight, change_entropy * spatial_weight * np.log2(1 + change_scale)
    )


def pair_difference(rendered: Entropies, truth: Entropies) -> PairDifference:
    """Compare one rendered pair of frames with the true one."""
    if rendered.spatial.shape != truth.spatial.shape:
        raise MetricError(
            f"STED: {rendered.spatial.shape} rendered blocks, {truth.spatial.shape} true ones; "
            f"sizes must agree"
        )
    spatial, temporal = truth.spatial - rendered.spatial, truth.temporal - rendered.temporal
    return PairDifference(
        spatial=float(np.abs(spatial).mean()),
        temporal=float(np.abs(temporal).mean()),
        spatial_single=float(abs(spatial.mean())),
        temporal_single=float(abs(temporal.mean())),
    )


def pool(differences: Sequence[PairDifference], pooling: StedPooling = "means") -> StRred:
    """Return the scores of a view from the differences of its pairs.

    Args:
        differences: at least one.
        pooling: ``means`` averages each part over the pairs and multiplies the averages;
            ``products`` multiplies the parts of each pair and averages the products, as VMAF's
            tools do.
    """
    if pooling not in get_args(StedPooling):
        raise MetricError(
            f"STED: no pooling {pooling!r}; there are {', '.join(get_args(StedPooling))}"
        )
    if len(differences) == 0:
        raise MetricError("STED: no pair of frames to pool; needs 2 frames")
    pairs = np.array(differences, dtype=np.float64).reshape(-1, 4)
    if pooling == "products":
        full, single = (pairs[:, [0, 2]] * pairs[:, [1, 3]]).mean(axis=0)
    else:
        full, single = pairs[:, [0, 2]].mean(axis=0) * pairs[:, [1, 3]].mean(axis=0)
    return StRred(float(full), float(single), pairs)


def _as_luma(frame: NDArray) -> NDArray:
    return luma(frame) if frame.ndim == 3 else frame


def _correlate(image: Array, kernel: Array) -> Array:
    """Return the correlation of the image reflected at its border (the edge not repeated), same
    size.
    """
    return np.asarray(
        cv2.filter2D(image, cv2.CV_64F, kernel, borderType=cv2.BORDER_REFLECT_101), dtype=np.float64
    )


def _correlate_halved(image: NDArray, kernel: Array) -> Array:
    """`_correlate` at every second row and column, the others never computed: each phase of the
    image has its share of taps.
    """
    border = kernel.shape[0] // 2
    padded = cv2.copyMakeBorder(image, border, border, border, border, cv2.BORDER_REFLECT_101)
    rows, columns = ((size + 1) // 2 for size in image.shape)
    halved = np.zeros((rows, columns))
    for i, j in product(range(2), range(2)):
        taps, phase = (
            np.ascontiguousarray(kernel[i::2, j::2]),
            padded[i::2, j::2].astype(np.float64),
        )
        halved += cv2.filter2D(
            phase, cv2.CV_64F, taps, anchor=(0, 0), borderType=cv2.BORDER_CONSTANT
        )[:rows, :columns]
    return halved


@lru_cache(maxsize=1)
def _first_two_lowpasses() -> Array:
    """The first low-pass and the first halving's in one kernel (13 x 13).

    Both are symmetric, so that reflection commutes.
    """
    first_lowpass, lowpass, _ = _pyramid_kernels()
    padded = np.pad(first_lowpass, lowpass.shape[0] // 2)
    return np.asarray(
        cv2.filter2D(padded, cv2.CV_64F, lowpass, borderType=cv2.BORDER_CONSTANT), dtype=np.float64
    )


@lru_cache(maxsize=1)
def _pyramid_kernels() -> tuple[Array, Array, Array]:
    """First low-pass (5 x 5), low-pass (9 x 9, gain 2 included) and vertical band (7 x 7) of the
    set ``sp5Filters``.
    """
    filters = _sp5_filters()
    return (
        filters["lo0filt"],
        filters["lofilt"],
        np.ascontiguousarray(filters["bfilts"][::-1, 0].reshape(7, 7)),
    )


def _sp5_filters() -> dict[str, Array]:
    """The filters of that set from the source of pyrtools, whose import takes a second and loads
    scipy.signal and matplotlib.
    """
    package = find_spec("pyrtools")
    if package is None or package.origin is None:
        raise MetricError(
            "STED: wanted pyrtools for its filters, got none; run pip install pyrtools"
        )
    source = ast.parse(
        Path(package.origin)
        .with_name("pyramids")
        .joinpath("filters.py")
        .read_text(encoding="utf-8")
    )
    functions: list[ast.stmt] = [
        node
        for node in source.body
        if isinstance(node, ast.FunctionDef) and node.name == "_sp5_filters"
    ]
    names: dict[str, Any] = {"np": np}
    # it calls numpy alone
    exec(compile(ast.Module(functions, []), "pyrtools/pyramids/filters.py", "exec"), names)
    filters: dict[str, Array] = names["_sp5_filters"]()
    return filters


class StredScorer:
    """STED and STED_ssn; keeps the bands of the frame before."""

    def __init__(
        self, names: Sequence[str], options: MetricOptions, _colour_map: ColourMap | None
    ) -> None:
        self.names = names
        self._device = options.device
        self._pairing = options.sted_pairing
        self._pooling = options.sted_pooling
        self._previous: tuple[Array, Array] | None = None
        self._differences: list[PairDifference] = []

    def add(self, index: int, rendered: Image8, truth: TruthFrame) -> list[Value]:
        """See `Scorer`."""
        bands = self._bands(rendered, truth)
        previous, self._previous = self._previous, bands
        if previous is None or (self._pairing == "disjoint" and index % 2 == 0):
            return []
        rendered_reference, truth_reference = (
            partial(reduced_references, *pair, self._pairing)
            for pair in zip(previous, bands, strict=True)
        )
        difference = pair_difference(
            rendered_reference(), truth.once(reduced_references, truth_reference)
        )
        self._differences.append(difference)
        parts = (
            ("STED", "_spatial", difference.spatial),
            ("STED", "_temporal", difference.temporal),
            ("STED_ssn", "_spatial", difference.spatial_single),
            ("STED_ssn", "_temporal", difference.temporal_single),
        )
        return [
            (name + part, index - 1, value) for name, part, value in parts if name in self.names
        ]

    def _bands(self, rendered: Image8, truth: TruthFrame) -> tuple[Array, Array]:
        """Bands of both frames; the truth's once for all methods."""
        if self._device == "cpu":
            return spatial_band(luma(rendered)), truth.once(
                spatial_band, lambda: spatial_band(luma(truth.image))
            )
        from ggvs_eval.metrics.on_device import upload_pair

        rendered_frame, truth_frame = upload_pair(rendered, truth, self._device)
        return device_band(rendered_frame), truth.once(
            device_band, lambda: device_band(truth_frame)
        )

    def finish(self) -> list[Value]:
        """See `Scorer`."""
        if not self._differences:
            raise MetricError("1 frame; needs 2")
        pooled = pool(self._differences, self._pooling)
        scores = {"STED": pooled.strred, "STED_ssn": pooled.strred_ssn}
        return [(name, None, scores[name]) for name in self.names]


def _pooling(name: str, options: MetricOptions) -> Pooling:
    """From the parts of each pair, as `pool` does; then the mean over views."""
    parts = (f"{name}_spatial", f"{name}_temporal")
    return (
        powers_of_means(dict.fromkeys(parts, 1))
        if options.sted_pooling == "means"
        else Pooling("mean of products", parts)
    )


STED = ViewMetric(
    name="STED",
    kind="view",
    function=strred,
    higher_is_better=False,
    group=CONSISTENCY,
    pooling=partial(_pooling, "STED"),
    describe="ST-RRED, entropy differences over space and time",
    reference="Soundararajan & Bovik 2013",
    has_ceiling=True,
    scorer=StredScorer,
    on_device=True,
)
STED_SSN = ViewMetric(
    name="STED_ssn",
    kind="view",
    function=strred,
    higher_is_better=False,
    group=CONSISTENCY,
    pooling=partial(_pooling, "STED_ssn"),
    describe="ST-RRED from single-number differences",
    reference="Soundararajan & Bovik 2013",
    scorer=StredScorer,
    on_device=True,
)
