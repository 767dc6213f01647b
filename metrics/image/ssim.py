"""Structural similarity of a frame: by the fast kernel, and other SSIMs in use, by name.

These are one formula with other windows, borders and ranges, and numbers up to 0.1 apart on the
same frame.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval import kernels
from ggvs_eval.arrays import Image8, Mask
from ggvs_eval.errors import MetricError
from ggvs_eval.metric_choices import SsimName
from ggvs_eval.metrics.inputs import Image, check_mask, check_pair, require_finite, white_level
from ggvs_eval.metrics.metric import (
    QUALITY,
    ColourMap,
    MetricOptions,
    TruthFrame,
    Value,
    ViewMetric,
)

if TYPE_CHECKING:
    import torch

SSIM_WINDOW_PX = 11
Plane = NDArray[np.float32]
SIGMA_PX = 1.5
ROWS_AT_ONCE = 32  # so that the planes in between stay in cache


def ssim(rendered: Image, truth: Image) -> float:
    """Return the structural similarity of one frame (Wang et al. 2004), mean over the RGB channels.

    Args:
        rendered: (H, W, 3), uint8 in 0..255 or float in [0, 1].
        truth: captured frame, same shape and kind.

    Returns:
        Mean similarity, at most 1; higher is better. Equal to scikit-image's
        ``structural_similarity`` with ``gaussian_weights=True, sigma=1.5,
        use_sample_covariance=False, data_range=1`` within 1e-6.

    Raises:
        MetricError: shapes or kinds differ, or an image is smaller than the window.

    Example:
        >>> import numpy as np
        >>> truth = np.full((16, 16, 3), 100, np.uint8)
        >>> ssim(truth, truth), round(ssim(truth // 2, truth), 2)
        (1.0, 0.8)

    Reading:
        The paper names no variant. Taken: 11 x 11 Gaussian window, sigma 1.5, valid positions only,
        K = (0.01, 0.03), data range 1. Zero padding, a uniform window or data range 2, all in use,
        score 0.01 to 0.08 more on the same frame.
    """
    return require_finite(float(ssim_per_channel(rendered, truth).mean()), "SSIM")


def ssim_per_channel(rendered: Image, truth: Image) -> NDArray[np.float64]:
    """SSIM of each channel, (3,), as `ssim` defines it."""
    from ggvs_eval.kernels import _ssim

    check_pair(rendered, truth)
    height, width = truth.shape[:2]
    if min(height, width) < SSIM_WINDOW_PX:
        raise MetricError(
            f"SSIM needs {SSIM_WINDOW_PX} x {SSIM_WINDOW_PX} pixels for its window, got {height} x "
            f"{width}"
        )
    dtype = np.uint8 if truth.dtype == np.uint8 else np.float32
    first, second = (np.ascontiguousarray(image, dtype=dtype) for image in (rendered, truth))
    return _ssim.channel_means(
        first, second, kernels.get_threads(), kernels.SIMD_LEVELS.index(kernels.get_simd_level())
    )


@dataclass(frozen=True)
class SsimVariant:
    """One SSIM.

    Attributes:
        is_gaussian: Gaussian of sigma 1.5, or uniform.
        pads_with_zeros: whether windows reach over the border into black, or are inside the image.
        data_range: what the formula takes for white, images being in [0, 1].
        unbiased: whether variances are divided by N - 1.
    """

    window_px: int
    is_gaussian: bool
    pads_with_zeros: bool
    data_range: float
    unbiased: bool
    describe: str

    def taps(self) -> NDArray[np.float64]:
        """Return the window along one axis, sum 1."""
        radius = self.window_px // 2
        offsets = np.arange(-radius, radius + 1)
        weights = (
            np.exp(-0.5 * (offsets / SIGMA_PX) ** 2)
            if self.is_gaussian
            else np.ones(self.window_px)
        )
        return np.asarray(weights / weights.sum(), dtype=np.float64)

    def require_window(self, height: int, width: int) -> None:
        """Refuse images that are smaller than the window."""
        if min(height, width) < self.window_px:
            raise MetricError(
                f"SSIM needs {self.window_px} x {self.window_px} pixels for its window, got "
                f"{height} x {width}"
            )


SSIM_VARIANTS: dict[SsimName, SsimVariant] = {
    "gaussian-valid": SsimVariant(
        window_px=11,
        is_gaussian=True,
        pads_with_zeros=False,
        data_range=1.0,
        unbiased=False,
        describe="Wang et al. 2004; this project's default",
    ),
    "gaussian-zero": SsimVariant(
        window_px=11,
        is_gaussian=True,
        pads_with_zeros=True,
        data_range=1.0,
        unbiased=False,
        describe="3D Gaussian splatting and derivatives",
    ),
    "uniform7": SsimVariant(
        window_px=7,
        is_gaussian=False,
        pads_with_zeros=False,
        data_range=1.0,
        unbiased=True,
        describe="scikit-image's defaults with data_range=1",
    ),
    "uniform7-range2": SsimVariant(
        window_px=7,
        is_gaussian=False,
        pads_with_zeros=False,
        data_range=2.0,
        unbiased=True,
        describe="ENeRF's and EasyVolcap's evaluators; too large a range",
    ),
}


def ssim_map(
    rendered: Image, truth: Image, name: SsimName = "gaussian-valid"
) -> NDArray[np.float32]:
    """SSIM of every window.

    Args:
        rendered: (H, W, 3), uint8 in 0..255 or float in [0, 1].

    Returns:
        (H, W, 3) where the border is padded, else (H - window + 1, W - window + 1, 3), one value
        per window, each within 1e-4 of the formula in float64 and together within 1e-6.
    """
    check_pair(rendered, truth)
    if name not in SSIM_VARIANTS:
        raise MetricError(f"SSIM: no variant {name!r}; there are {', '.join(SSIM_VARIANTS)}")
    variant = SSIM_VARIANTS[name]
    variant.require_window(*truth.shape[:2])
    x, y = (_unit_range(image, variant) for image in (rendered, truth))
    values = np.empty(
        (len(x) - variant.window_px + 1, x.shape[1] - variant.window_px + 1, 3), dtype=np.float32
    )
    for start in range(0, len(values), ROWS_AT_ONCE):
        rows = slice(start, start + ROWS_AT_ONCE + variant.window_px - 1)
        values[start : start + ROWS_AT_ONCE] = similarity(x[rows], y[rows], variant, _window_means)
    return values


def ssim_variant(rendered: Image, truth: Image, name: SsimName) -> float:
    """Return the mean of `ssim_map` over windows and channels.

    The fast kernel where the variant is its own.

    Raises:
        MetricError: as of `ssim_map`, or values that are not finite.

    Example:
        >>> import numpy as np
        >>> truth = np.full((16, 16, 3), 100, np.uint8)
        >>> round(ssim_variant(truth // 2, truth, "gaussian-zero"), 3)
        0.688
    """
    if name == "gaussian-valid":
        return ssim(rendered, truth)
    return require_finite(float(ssim_map(rendered, truth, name).mean(dtype=np.float64)), "SSIM")


def device_ssim(
    rendered: "torch.Tensor", truth: "torch.Tensor", name: SsimName = "gaussian-valid"
) -> NDArray[np.float64]:
    """SSIM of each channel, (3,), as `ssim_map` defines it, computed in double precision where the
    frames are.

    Args:
        rendered: (H, W, 3) uint8.
    """
    from ggvs_eval.metrics.on_device import unit_range, window_means

    variant = SSIM_VARIANTS[name]
    variant.require_window(*truth.shape[:2])
    border = variant.window_px // 2 if variant.pads_with_zeros else 0
    taps = variant.taps().tolist()
    x, y = (unit_range(image, border) for image in (rendered, truth))
    values = similarity(x, y, variant, lambda planes, _: window_means(planes, taps))
    return np.asarray(values.mean(dim=(0, 1)).numpy(force=True), dtype=np.float64)


def masked_ssim(
    rendered: Image, truth: Image, mask: Mask, name: SsimName = "gaussian-valid"
) -> float:
    """SSIM over the windows that are wholly inside a mask.

    Windows that reach outside would compare what is not asked about, and windows in a blackened
    outside score 1: at 5 % coverage that turns 0.87 into 0.99.

    Args:
        rendered: (H, W, 3), uint8 in 0..255 or float in [0, 1].
        truth: same shape and kind.
        mask: (H, W).
        name: which SSIM; windows that reach over the border of the image are left out of any of
            them.

    Raises:
        MetricError: images or mask do not fit each other, or no window inside.

    Example:
        >>> import numpy as np
        >>> truth = np.full((32, 32, 3), 100, np.uint8)
        >>> rendered, left = truth.copy(), np.arange(32) < 16
        >>> rendered[:, ~left] = 0
        >>> masked_ssim(rendered, truth, np.tile(left, (32, 1)))
        1.0
    """
    return require_finite(
        float(windows_inside(rendered, truth, mask, name).mean(dtype=np.float64)), "SSIM"
    )


def windows_inside(
    rendered: Image, truth: Image, mask: Mask, name: SsimName = "gaussian-valid"
) -> NDArray[np.float32]:
    """SSIM of each window that is wholly inside a mask, (N, 3); arguments as of `masked_ssim`."""
    check_pair(rendered, truth)
    check_mask(mask, truth.shape[:2])
    box = _bounding_box(mask)  # no window outside it counts
    if min(mask[box].shape) < SSIM_VARIANTS[name].window_px:
        raise _no_window(name)
    return _chosen(ssim_map(rendered[box], truth[box], name), mask[box], name)


def _chosen(values: Plane, mask: Mask, name: SsimName) -> Plane:
    """Return the values of a map whose windows are inside a mask, (N, 3)."""
    variant = SSIM_VARIANTS[name]
    check_mask(
        mask,
        tuple(
            size if variant.pads_with_zeros else size + variant.window_px - 1
            for size in values.shape[:2]
        ),
    )
    window, radius = (
        np.ones((variant.window_px, variant.window_px), np.uint8),
        variant.window_px // 2,
    )
    inside = (
        cv2.erode(mask.astype(np.uint8), window, borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0
    )
    window_values = values[
        inside if variant.pads_with_zeros else inside[radius:-radius, radius:-radius]
    ]
    if not window_values.size:
        raise _no_window(name)
    return window_values


def _no_window(name: SsimName) -> MetricError:
    side = SSIM_VARIANTS[name].window_px
    return MetricError(f"no window of {side} x {side} pixels is wholly inside the region")


def _bounding_box(mask: Mask) -> tuple[slice, slice]:
    """Return the rows and columns of the smallest rectangle around what is true.

    Empty if nothing is.
    """
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    if not rows.size:
        return slice(0, 0), slice(0, 0)
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def _unit_range(image: Image, variant: SsimVariant) -> Plane:
    """Return the frame as floats in [0, 1], with the black border that the variant wants."""
    unit = image.astype(np.float32) / np.float32(white_level(image))
    border = variant.window_px // 2 if variant.pads_with_zeros else 0
    return np.pad(unit, ((border, border), (border, border), (0, 0)))


def similarity(
    x: Any, y: Any, variant: SsimVariant, window_means: Callable[[Any, SsimVariant], Any]
) -> Any:
    """SSIM of the windows inside two images (H, W, 3) in [0, 1], arrays or tensors.

    Written in the sum a and the difference d of the images: mean(x)^2 + mean(y)^2 is half of
    mean(a)^2 + mean(d)^2, and the same holds for variances. Nothing small is then the difference of
    large numbers, so that float32 suffices.
    """
    unbias = variant.window_px**2 / (variant.window_px**2 - 1) if variant.unbiased else 1.0
    c1, c2 = ((k * variant.data_range) ** 2 for k in (0.01, 0.03))
    total, difference = x + y - 1, x - y  # the sum is centred, which its variance does not see
    mean_total, mean_difference = window_means(total, variant), window_means(difference, variant)
    squared_difference = mean_difference * mean_difference
    variance_total = (window_means(total * total, variant) - mean_total * mean_total) * unbias
    variance_difference = (
        window_means(difference * difference, variant) - squared_difference
    ) * unbias
    luminance = 1 - squared_difference / (((mean_total + 1) ** 2 + squared_difference) / 2 + c1)
    contrast = 1 - variance_difference / ((variance_total + variance_difference) / 2 + c2)
    return luminance * contrast


def _window_means(image: Plane, variant: SsimVariant) -> Plane:
    taps, radius = variant.taps(), variant.window_px // 2
    means = cv2.sepFilter2D(image, cv2.CV_32F, taps, taps, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(means[radius:-radius, radius:-radius], dtype=np.float32)


class SsimScorer:
    """SSIM of each frame, on the device that is asked for."""

    names = ("SSIM",)

    def __init__(
        self, _names: Sequence[str], options: MetricOptions, _colour_map: ColourMap | None
    ) -> None:
        self._variant, self._device = options.ssim, options.device

    def add(self, index: int, rendered: Image8, truth: TruthFrame) -> list[Value]:
        """See `Scorer`."""
        return [("SSIM", index, self._value(rendered, truth))]

    def finish(self) -> list[Value]:
        """See `Scorer`."""
        return []

    def _value(self, rendered: Image8, truth: TruthFrame) -> float:
        if self._device == "cpu":
            return ssim_variant(rendered, truth.image, self._variant)
        from ggvs_eval.metrics.on_device import upload_pair

        return float(device_ssim(*upload_pair(rendered, truth, self._device), self._variant).mean())


SSIM = ViewMetric(
    name="SSIM",
    kind="frame",
    function=ssim,
    higher_is_better=True,
    group=QUALITY,
    decimals=3,
    describe="structural similarity, 11 x 11 Gaussian window, RGB mean",
    reference="Wang et al. 2004",
    has_ceiling=True,
    scorer=SsimScorer,
    on_device=True,
    inside=lambda pair, mask: masked_ssim(pair.rendered, pair.truth.image, mask),
    inside_note=" in windows wholly inside it",
)
