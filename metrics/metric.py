"""Metrics as objects: definition, scorer of a view, pooling of the number, and place in the
tables.
"""

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8, Mask
from ggvs_eval.metric_choices import MetricChoices
from ggvs_eval.statistics.pooling import MEAN, Pooling

Kind = Literal["frame", "pair", "view", "rig", "path", "depth"]
ColourMap = NDArray[np.float64]  # (3, 4): true colour is about map @ (r, g, b, 1), all in [0, 1]
Value = tuple[str, int | None, float]  # metric, frame or pose (None: the whole view or path), value
# view (None: the whole rig), frame (-1: the whole sequence), value
Row = tuple[str | None, int, float]
T = TypeVar("T")


@dataclass(frozen=True)
class Group:
    """A table of a report: metrics of one group are its columns, in the order in which a protocol
    names them.
    """

    key: str
    title: str


QUALITY = Group("quality", "Image quality")
CONSISTENCY = Group("consistency", "Temporal and view consistency")
REGION = Group("regions", "Quality by region")
NO_REFERENCE = Group("no_reference", "Stability without reference, with sharpness")
ALONG_PATH = Group("path", "View consistency along the camera path, without reference")
FURTHER = Group("further", "Further measures")


@dataclass(frozen=True, kw_only=True)
class MetricOptions(MetricChoices):
    """Metric options of a protocol, and the measured part of the frames.

    Attributes:
        first_frame: number, counted from the protocol's first one, of the frame that is measured
            first.
        device: where metrics compute that can (`ViewMetric.on_device`); no choice of the
            protocol's.
    """

    first_frame: int = 0
    device: str = "cpu"


class TruthFrame:
    """A captured frame, with everything derived from it alone computed once for all methods.

    SSIM's moments of the truth are not kept: the kernel filters four maps while they are in cache,
    and keeping one of them would save at most a quarter of its 8.8 ms at 1352x1014, less than the
    2.7 ms of reading 33 MB of moments back.

    Attributes:
        image: the frame, (H, W, 3).
        previous: the captured frame before; None for the first.
        disoccluded: where no source camera sees the view, (H, W); None if that is unknown.
        renderings: frames of all methods that will be compared with it, so that a metric can look
            at them in one pass.
    """

    def __init__(
        self,
        image: Image8,
        previous: Image8 | None = None,
        disoccluded: Mask | None = None,
        renderings: Sequence[Image8] = (),
    ) -> None:
        self.image = image
        self.previous = previous
        self.disoccluded = disoccluded
        self.renderings = tuple(renderings)
        self._derived: dict[Hashable, Any] = {}

    def once(self, key: Hashable, compute: Callable[[], T]) -> T:
        """Return the result of `compute`, which depends on the truth alone: the first one under
        this key.
        """
        if key not in self._derived:
            self._derived[key] = compute()
        result: T = self._derived[key]
        return result


@dataclass(frozen=True)
class FramePair:
    """A rendered and a captured frame, for a metric of a part of them.

    Attributes:
        index: which frame of those that are measured.
        rendered: (H, W, 3).
        previous: the rendered frame before; None for the first.
        colour_map: of the view where colours are corrected per view.
    """

    index: int
    rendered: Image8
    truth: TruthFrame
    previous: Image8 | None
    options: MetricOptions
    colour_map: ColourMap | None = None

    def once(self, key: Hashable, compute: Callable[[], T]) -> T:
        """Return the result of `compute`, which depends on both frames: the first one under this
        key; see `shared_by_parts`.
        """
        return shared_by_parts(self.rendered, self.truth, key, compute)


def shared_by_parts(
    rendered: NDArray[Any], truth: TruthFrame, key: Hashable, compute: Callable[[], T]
) -> T:
    """Return a quantity that a metric and its parts derive from the same two frames, kept as long
    as the captured frame lives.
    """
    # The frame is kept with the result, so that no other one can come to have its identity.
    return truth.once((key, id(rendered)), lambda: (rendered, compute()))[1]


class Scorer(Protocol):
    """One or several metrics of a view, fed frame by frame.

    What it raises as `MetricError` is the reason for their absence.
    """

    @property
    def names(self) -> Sequence[str]:
        """The metrics it computes."""

    def add(self, index: int, rendered: Image8, truth: TruthFrame) -> list[Value]:
        """Take the next frame and return the values it completes."""

    def finish(self) -> list[Value]:
        """Return the values of the whole view."""


class FrameScorer:
    """A metric of single frames."""

    def __init__(self, name: str, function: Callable[[Image8, Image8], float]) -> None:
        self.names = (name,)
        self._function = function

    def add(self, index: int, rendered: Image8, truth: TruthFrame) -> list[Value]:
        """See `Scorer`."""
        return [(self.names[0], index, self._function(rendered, truth.image))]

    def finish(self) -> list[Value]:
        """See `Scorer`."""
        return []


def mean_of_values(_: MetricOptions) -> Pooling:
    """Pooling of most metrics: the mean over frames, then views, of the metric's own values."""
    return MEAN


def as_described(_: MetricOptions) -> str:
    """Note of most metrics: none."""
    return ""


@dataclass(frozen=True, kw_only=True)
class Metric:
    """One metric, whole; `registry.METRICS` collects them.

    Attributes:
        name: as in protocols and tables.
        kind: what one value belongs to: a ``frame``, a ``pair`` of neighbouring frames, a ``view``
            (all its frames), or the ``rig`` (all views), a camera ``path`` without truth, or a
            ``depth`` video.
        function: its definition, images (or for deviations errors) in, numbers out.
        unit: unit of a value, empty if it has none.
        higher_is_better: direction of the arrow in tables.
        group: table that it belongs to.
        decimals: digits after the point in tables; None for four significant ones.
        pooling: how its number on a scene comes from values per view and frame. Where that is no
            mean of its values it names parts that are in the table too: what its scorer returns in
            addition, or another metric.
        describe: one line for a reader who meets the metric for the first time.
        note: what a protocol's options add to that line.
        reference: where it is defined.
        has_ceiling: whether perfect renderings are scored with it, see `ceilings`.
        beside: companion metric, always measured and reported with it: the
            sharpness of what blur would make steadier. Empty if it can be read alone.
    """

    name: str
    kind: Kind
    function: Callable[..., Any]
    unit: str = ""
    higher_is_better: bool
    group: Group = FURTHER
    decimals: int | None = None
    pooling: Callable[[MetricOptions], Pooling] = mean_of_values
    describe: str
    note: Callable[[MetricOptions], str] = as_described
    reference: str
    has_ceiling: bool = False
    beside: str = ""

    @property
    def modules(self) -> tuple[str, ...]:
        """Names of the modules that define it.

        What these import, and nothing else, decides its values.
        """
        decisive = (
            value for name, value in vars(self).items() if callable(value) and name != "note"
        )
        functions = (getattr(function, "func", function) for function in decisive)  # of partials
        return tuple(sorted({function.__module__ for function in functions}))


# The metric of the pixels inside a mask (H, W); None if it does not look at this frame. Too small a
# mask is a `MetricError`.
Inside = Callable[[FramePair, Mask], float | None]


@dataclass(frozen=True)
class Series:
    """A metric's form without truth: of neighbouring frames of one video alone.

    Attributes:
        n_frames: how many of them it takes.
        function: (these frames, in order, and where the scene is static, (H, W), or None for
            everywhere) -> value.
    """

    n_frames: int
    function: Callable[[Sequence[Any], Mask | None], float]


ScorerFactory = Callable[[Sequence[str], MetricOptions, ColourMap | None], Scorer]


@dataclass(frozen=True, kw_only=True)
class ViewMetric(Metric):
    """A metric of rendered frames against the captured ones of a view.

    Attributes:
        scorer: makes the scorer of a view from the names that are asked for, the options and the
            colour map of the view; metrics with one factory share a scorer. None calls `function`
            on each frame.
        inside: the metric of a part of the image, of which `regions.metrics_of_parts` makes one
            metric for each part; None where there is none.
        inside_note: what that adds to the line that describes the part.
        corrects_colours: whether it wants that colour map.
        weights: file of trained weights that it needs; None if it needs none.
        on_device: whether it computes on `MetricOptions.device`, so that its values are those of a
            device.
        series: the metric of a video without truth; None if it compares with one.
    """

    scorer: ScorerFactory | None = None
    inside: Inside | None = None
    inside_note: str = ""
    corrects_colours: bool = False
    weights: Callable[[MetricOptions], Path] | None = None
    on_device: bool = False
    series: Series | None = None


@dataclass(frozen=True, kw_only=True)
class TableMetric(Metric):
    """A metric that comes from another metric's values of all frames, or of all views and frames,
    and sees no image.

    Attributes:
        part: name of that metric, one value per frame.
        rows: (view -> frame -> value of the part, options) -> values; raises `MetricError` where
            there can be none.
    """

    part: str
    rows: Callable[[Mapping[str, Mapping[int, float]], MetricOptions], list[Row]]


@dataclass(frozen=True, kw_only=True)
class DepthMetric(Metric):
    """A metric of depth videos, without truth.

    No protocol names it, see `series_scores.score_depths`.

    Attributes:
        series: measures it.
    """

    kind: Kind = "depth"
    group: Group = NO_REFERENCE
    series: Series
