"""Temporal variation of a rendering, without truth: mTV of OR2, and the same of second
differences.
"""

from collections import deque
from collections.abc import Sequence
from functools import partial

import cv2
import numpy as np

from ggvs_eval.arrays import Image8, Mask
from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.image.regions import region_mask
from ggvs_eval.metrics.image.sharpness import PERCENT, SHARPNESS
from ggvs_eval.metrics.inputs import (
    Image,
    check_pair,
    count_inside,
    require_finite,
    same_kind,
    white_level,
)
from ggvs_eval.metrics.metric import (
    NO_REFERENCE,
    ColourMap,
    MetricOptions,
    Series,
    TruthFrame,
    Value,
    ViewMetric,
)

NAMES = ("mTV", "mTV2")


def mtv(later: Image, earlier: Image, static: Mask | None = None) -> float:
    """Mean absolute change of a rendering from one frame to the next inside a static mask, times
    100 (OR2, SIGGRAPH 2025).

    Args:
        later: rendered frame at t + 1, (H, W, 3), uint8 in 0..255 or float in [0, 1].
        earlier: rendered frame at t.
        static: (H, W), where the scene is static; None for the whole image.

    Returns:
        Mean over pixels and channels, per cent of white: what the literature prints as mTV x 100. 0
        for a steady rendering, and for a frozen or a grey one: read it with `sharpness`.

    Raises:
        MetricError: frames or mask do not fit each other, or fewer than 64 pixels inside.

    Example:
        >>> import numpy as np
        >>> frame = np.full((16, 16, 3), 100, np.uint8)
        >>> mtv(frame + 51, frame)
        20.0

    Reading:
        OR2 takes one mask per scene, rectangles of cam00 drawn by hand. Taken in runs: the pixels
        in which the paper's Eq. 1 finds no motion between the two captured frames, so that any view
        of any capture has a mask.
    """
    return _variation((later, earlier), static)


def mtv2(frames: Sequence[Image], static: Mask | None = None) -> float:
    """Return the mean absolute second difference of a rendering over time, times 100: even and slow
    motion cancels.

    Args:
        frames: three rendered frames in order, each (H, W, 3), uint8 in 0..255 or float in [0, 1].
        static: (H, W), where the scene is static; None for the whole image.

    Returns:
        Mean over pixels and channels of ``|I(t + 1) - 2 I(t) + I(t - 1)|``, per cent of white; 0
        for a steady rendering, and for a frozen or a grey one: read it with `sharpness`.

    Raises:
        MetricError: not three frames, or as `mtv`.

    Example:
        >>> import numpy as np
        >>> mtv2(
        ...     [np.full((16, 16, 3), level, np.uint8) for level in (0, 51, 102)]
        ... )  # an even change has none
        0.0

    Reading:
        Not in the paper. For cameras that move: the picture then has change everywhere and no part
        of it is static. Texture finer than its motion per frame does not cancel.
    """
    if len(frames) != 3:
        raise MetricError(f"mTV2 is a second difference: got {len(frames)} frames; needs 3")
    return _variation(frames, static)


def _variation(frames: Sequence[Image], static: Mask | None) -> float:
    """Return the first or second absolute difference of two or three frames, mean inside the mask,
    per cent of white.
    """
    for frame in frames:
        check_pair(frame, frame)
        if frame.shape != frames[0].shape or frame.dtype != frames[0].dtype:
            first, second = (f"{image.shape} {image.dtype}" for image in (frames[0], frame))
            raise MetricError(
                f"one frame is {first}, another {second}; the frames of a video have one size and "
                f"kind"
            )
    height, width, channels = frames[0].shape
    n_pixels = height * width if static is None else count_inside(static, (height, width))
    inside = None if static is None else static.astype(np.uint8)
    total = cv2.norm(
        *_differing(*(same_kind(frame, frame)[0] for frame in frames)), cv2.NORM_L1, inside
    )
    return require_finite(
        PERCENT * float(total) / (channels * n_pixels * white_level(frames[0])),
        NAMES[len(frames) - 2],
    )


def _differing(first: Image, second: Image, third: Image | None = None) -> tuple[Image, Image]:
    """Return two images whose difference is the first, or second, difference of the frames, in a
    type that holds it.
    """
    if third is None:
        return first, second
    wide = cv2.CV_16S if first.dtype == np.uint8 else cv2.CV_64F
    return cv2.add(first, third, dtype=wide), cv2.add(second, second, dtype=wide)


class VariationScorer:
    """First or second difference of a view where its captured frames are static.

    Each value belongs to its first frame.
    """

    def __init__(
        self,
        n_frames: int,
        names: Sequence[str],
        _options: MetricOptions,
        _colour_map: ColourMap | None,
    ) -> None:
        self.names = names
        self._n_frames = n_frames
        self._frames: deque[Image8] = deque(maxlen=n_frames)
        self._masks: deque[Mask] = deque(maxlen=n_frames - 1)  # between a frame and the one before
        self._reason = ""
        self._is_measured = False

    def add(self, index: int, rendered: Image8, truth: TruthFrame) -> list[Value]:
        """See `Scorer`; frames of which too little is static have no value."""
        self._frames.append(rendered)
        if (static := region_mask(truth, "static")) is not None:
            self._masks.append(static)
        if len(self._frames) < self._n_frames:
            return []
        try:
            value = _variation(list(self._frames), np.logical_and.reduce(self._masks))
        except MetricError as error:
            self._reason = str(error)
            return []
        self._is_measured = True
        return [(self.names[0], index + 1 - self._n_frames, value)]

    def finish(self) -> list[Value]:
        """See `Scorer`."""
        if not self._is_measured:
            raise MetricError(self._reason or f"{len(self._frames)} frames; needs {self._n_frames}")
        return []


MTV = ViewMetric(
    name="mTV",
    kind="pair",
    function=mtv,
    unit="% of white",
    higher_is_better=False,
    group=NO_REFERENCE,
    decimals=3,
    describe="mean absolute change of the rendering where the scene is static, x 100; blur lowers "
    "it",
    reference="OR2, SIGGRAPH 2025, arXiv 2505.01235",
    scorer=partial(VariationScorer, 2),
    series=Series(2, _variation),
    beside=SHARPNESS.name,
)
MTV2 = ViewMetric(
    name="mTV2",
    kind="pair",
    function=mtv2,
    unit="% of white",
    higher_is_better=False,
    group=NO_REFERENCE,
    decimals=3,
    describe="mean absolute second difference over time of the rendering where the scene is "
    "static, x 100; blur lowers it",
    reference="docs/metrics.md",
    scorer=partial(VariationScorer, 3),
    series=Series(3, _variation),
    beside=SHARPNESS.name,
)
