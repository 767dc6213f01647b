"""Temporal change consistency of a view."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from ggvs_eval.arrays import Image8, Mask
from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.image.ssim import device_ssim, ssim_per_channel, windows_inside
from ggvs_eval.metrics.inputs import Image, check_pair, require_finite, same_kind
from ggvs_eval.metrics.metric import (
    CONSISTENCY,
    ColourMap,
    FramePair,
    MetricOptions,
    TruthFrame,
    Value,
    ViewMetric,
)

if TYPE_CHECKING:
    import torch


def tcc(rendered: Sequence[Image] | Image, truth: Sequence[Image] | Image) -> float:
    """Temporal change consistency of one view (Eq. 8, after Zhang et al. 2019, on colour).

    Args:
        rendered: synthesised frames, T of (H, W, 3), uint8 in 0..255 or float in [0, 1], T >= 2.
        truth: captured frames of the same view and times.

    Returns:
        Mean of `temporal_change_ssim` over the T - 1 neighbouring pairs, 0 to 1; higher is better.

    Raises:
        MetricError: shapes or kinds differ, or fewer than 2 frames.

    Example:
        >>> import numpy as np
        >>> truth = [np.full((16, 16, 3), level, np.uint8) for level in (100, 110, 120)]
        >>> brighter = [frame + 5 for frame in truth]  # a constant error does not change
        >>> tcc(brighter, truth), round(tcc(truth[:1] * 3, truth), 2)
        (1.0, 0.06)

    Reading:
        The sensor noise of the truth is part of its change: a perfect but noise-free rendering does
        not reach 1, and flicker as strong as that noise is not penalised. Read it with STED.
    """
    if len(rendered) != len(truth):
        raise MetricError(
            f"TCC: {len(rendered)} rendered frames, {len(truth)} true frames; score the same frames"
        )
    if len(truth) < 2:
        raise MetricError(f"TCC compares neighbouring frames: {len(truth)} frame; needs 2")
    changes = (
        temporal_change_ssim(rendered[t], rendered[t + 1], truth[t], truth[t + 1])
        for t in range(len(truth) - 1)
    )
    return float(np.mean(list(changes)))


def temporal_change_ssim(
    rendered: Image, rendered_next: Image, truth: Image, truth_next: Image
) -> float:
    """SSIM of the absolute colour changes between two neighbouring frames, one term of Eq. 8.

    Args:
        rendered: synthesised frame at t, (H, W, 3), uint8 in 0..255 or float in [0, 1].
        rendered_next: synthesised frame at t + 1.
        truth_next: captured frame at t + 1.

    Returns:
        Similarity of |rendered_next - rendered| and |truth_next - truth|, 0 to 1.

    Raises:
        MetricError: shapes or kinds differ, or an image is smaller than the window of `ssim`.

    Reading:
        The paper names no SSIM. Taken as its authors' earlier released code does it for depth: the
        window of `ssim`, data range 1 (the changes are not rescaled), the mean of each channel cut
        off at 0, then the mean of the channels.
    """
    check_pair(rendered, rendered_next)
    check_pair(truth, truth_next)
    changes = (_change(rendered, rendered_next), _change(truth, truth_next))
    return require_finite(float(np.maximum(ssim_per_channel(*changes), 0.0).mean()), "TCC")


def device_change_ssim(
    rendered: "torch.Tensor",
    rendered_next: "torch.Tensor",
    truth: "torch.Tensor",
    truth_next: "torch.Tensor",
) -> float:
    """Compute `temporal_change_ssim` in double precision where the frames are, (H, W, 3) uint8."""
    change, true_change = (
        a.maximum(b) - a.minimum(b) for a, b in ((rendered, rendered_next), (truth, truth_next))
    )
    return float(np.maximum(device_ssim(change, true_change), 0.0).mean())


def _change(first: Image, second: Image) -> Image:
    """Return the absolute difference in the kind of the images; 8-bit ones do not wrap around."""
    return cv2.absdiff(*same_kind(first, second))


def _inside(pair: FramePair, mask: Mask) -> float | None:
    """Return the term of the frame and the one before over the windows inside a mask."""
    if pair.previous is None or pair.truth.previous is None:
        return None
    changes = _change(pair.previous, pair.rendered), _change(pair.truth.previous, pair.truth.image)
    return float(
        np.maximum(windows_inside(*changes, mask).mean(axis=0, dtype=np.float64), 0.0).mean()
    )


class ChangeScorer:
    """TCC; keeps the frame before."""

    names = ("TCC",)

    def __init__(
        self, _names: Sequence[str], options: MetricOptions, _colour_map: ColourMap | None
    ) -> None:
        self._device = options.device
        self._previous: Any = None  # rendered and captured, in memory or on the device
        self._pairs = 0

    def add(self, index: int, rendered: Image8, truth: TruthFrame) -> list[Value]:
        """See `Scorer`."""
        frames = self._frames(rendered, truth)
        previous, self._previous = self._previous, frames
        if previous is None:
            return []
        self._pairs += 1
        return [("TCC", index - 1, self._term(previous, frames))]

    def _frames(self, rendered: Image8, truth: TruthFrame) -> Any:
        if self._device == "cpu":
            return rendered, truth.image
        from ggvs_eval.metrics.on_device import upload_pair

        return upload_pair(rendered, truth, self._device)

    def _term(self, before: Any, after: Any) -> float:
        compute = temporal_change_ssim if self._device == "cpu" else device_change_ssim
        return compute(before[0], after[0], before[1], after[1])

    def finish(self) -> list[Value]:
        """See `Scorer`."""
        if self._pairs < 1:
            raise MetricError("1 frame; needs 2")
        return []


TCC = ViewMetric(
    name="TCC",
    kind="pair",
    function=tcc,
    higher_is_better=True,
    group=CONSISTENCY,
    decimals=3,
    describe="SSIM of the colour changes between neighbouring frames",
    reference="Ha et al. 2025, Eq. 8",
    has_ceiling=True,
    scorer=ChangeScorer,
    on_device=True,
    inside=_inside,
    inside_note=" in windows wholly inside it",
)
