"""Confidence intervals of the numbers in a table, from variation over time, views and scenes."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.errors import ResultsError
from ggvs_eval.results import Results
from ggvs_eval.statistics.autocorrelation import (
    ErrorOfMean,
    correlation_posterior,
    describe_short,
    total_half_width,
    total_tail,
)
from ggvs_eval.statistics.pooled import PooledScene, PooledTable, pool_table

LEVEL = 0.95
FEWEST = 5  # views or scenes from which others can be concluded; fewer are taken as given
CLEAR = 3.0  # intervals of the strongest correlation beyond which even a short clip suffices
NUDGE = 1e-4
ROUNDING = 1e-12


@dataclass(frozen=True)
class Interval:
    """A number and how sure it is.

    Attributes:
        value: the number of the whole table, as `ggvs_eval.results.Results.summary` has it.
        low: lower bound; None if there is no interval.
        high: upper bound, as far above the value as `low` is below; None where `low` is.
        note: what the interval takes as given (``given this scene, these 3 views``; empty if
            nothing), and that a clip is too short for it; or why there is none.
        is_short: whether the clip is too short for the interval: it covers less than its level
            says.
        conditions: what the interval takes as given, as ``these 3 views``.
    """

    value: float
    low: float | None
    high: float | None
    note: str
    is_short: bool = False
    conditions: tuple[str, ...] = ()

    @property
    def half_width(self) -> float | None:
        """Distance of either bound from the value; None if there is no interval."""
        return None if self.high is None else self.high - self.value


@dataclass(frozen=True)
class Spread:
    """A number and its random error.

    Attributes:
        parts: independent errors that add up: of each scene over time, and over views; or over
            scenes.
        conditions: what was taken as it is.
    """

    value: float
    parts: tuple[ErrorOfMean, ...]
    conditions: tuple[str, ...]

    @property
    def note(self) -> str:
        """Caveats in words: assumptions, and a clip that is too short; empty if there are none."""
        return "; ".join(
            filter(
                None, (f"given {', '.join(self.conditions)}" if self.conditions else "", self.short)
            )
        )

    @property
    def short(self) -> str:
        """Reason why the interval is perhaps too narrow, where its error over time is the greatest.

        Else empty.
        """
        return self._greatest.short if self._greatest else ""

    @cached_property
    def _greatest(self) -> ErrorOfMean | None:
        varying = [part for part in self.parts if part.scales.any()]
        if len(varying) == 1:
            return varying[0]
        return max(varying, key=lambda part: part.half_width(1.0 - LEVEL), default=None)

    def half_width(self) -> float:
        """Deviation that is exceeded, up or down, with probability 0.05."""
        return total_half_width(self.parts, 1.0 - LEVEL)

    @property
    def worth(self) -> float:
        """Independent frames that the clip is worth where its error over time is the greatest.

        Infinite where it is not.
        """
        return self._greatest.worth if self._greatest else math.inf

    def too_short(self, tail: float, worth: float) -> str:
        """Return why the sign is open though the p value may be small: the clip is too short.

        Empty if it is not.

        Args:
            tail: probability of a false alarm, of all the comparisons that it is decided with.
            worth: independent frames that the clip is worth by all that is compared in it, see
                `typical_worth`.

        Reading:
            A short clip seldom shows its own correlation: of 7 equal pairs of 12 frames at a
            correlation of 0.9 one seemed to be worth 8 frames in every fourth table. So the clip is
            worth the geometric mean of what this number and all of them say. Fewer than 10
            independent frames may as well be 2, and then intervals cover 85 % or less. Such a
            number counts as other than 0 only beyond three times the interval of the strongest
            correlation thought of, half a frame: a drift of a tenth of a decibel does not hide a
            difference of two. At twice, of two equal methods one was called better in up to 12 % of
            clips of 4 frames with a correlation of 0.95.
        """
        widest = CLEAR * math.hypot(*(part.greatest_half_width(tail) for part in self.parts))
        if self._greatest is None or math.isinf(self.worth) or widest < abs(self.value):
            return ""
        return describe_short(self._greatest.frames, math.sqrt(self.worth * worth))

    def p_value(self) -> float:
        """Return the two-sided p value of the number being 0."""
        return total_tail(self.parts, abs(self.value))


def typical_worth(spreads: Iterable[Spread]) -> float:
    """Return the geometric mean of the independent frames that a clip is worth by several numbers.

    Infinite if none tells.
    """
    worths = [spread.worth for spread in spreads if math.isfinite(spread.worth)]
    return float(np.exp(np.mean(np.log(worths)))) if worths else math.inf


def intervals(results: Results, metric: str, dataset: str) -> dict[str, Interval]:
    """Return the interval of one metric's number for every method: the mean over frames, then
    views, then scenes.

    Args:
        metric: name as in the table; of what is no mean, the influence of each view and frame is
            taken, see `pooling.Pooling`.

    Returns:
        Label (``method`` or ``method+variant``) -> interval, or the reason why there is none; equal
        inputs give equal bits.
    """
    return table_intervals(pool_table(results, metric, dataset))


def table_intervals(table: PooledTable) -> dict[str, Interval]:
    """Return the same of a metric that is pooled already."""
    bounded = {}
    for label, value in table.values.items():
        try:
            if table.no_interval:
                raise ResultsError(table.no_interval)
            spread = measure_spread(table.scenes_of(label))
            half = spread.half_width()
            bounded[label] = Interval(
                value=value,
                low=value - half,
                high=value + half,
                note=spread.note,
                is_short=bool(spread.short),
                conditions=spread.conditions,
            )
        except ResultsError as refusal:
            bounded[label] = Interval(value=value, low=None, high=None, note=str(refusal))
    return bounded


def measure_spread(scenes: Sequence[PooledScene]) -> Spread:
    """Find out how far the mean over scenes of a number may be off by chance.

    Reading:
        With five scenes or more, scenes are a sample: their spread holds that of the views and
        frames in them, and counting those again would count it twice (Davison & Hinkley 1997,
        section 3.8). With fewer, scenes are taken as given and views and frames count within each.
        Five test views or more count as a sample of the places where a camera could be, fewer are
        taken as given too.
    """
    numbers = np.array([scene.value for scene in scenes])
    value = float(numbers.mean())
    if len(scenes) >= FEWEST:
        return Spread(value, (ErrorOfMean.of_sample(numbers),), ())
    parts = tuple(part for scene in scenes for part in _errors_of_scene(scene, len(scenes)))
    conditions = ["this scene" if len(scenes) == 1 else f"these {len(scenes)} scenes"]
    for scene in scenes:
        conditions += (
            []
            if _samples_views(scene) or scene.views == (None,)
            else [f"these {len(scene.views)} views"]
        )
    return Spread(value, parts, tuple(dict.fromkeys(conditions)))


def _errors_of_scene(scene: PooledScene, scenes: int) -> list[ErrorOfMean]:
    """Error over time, the same in all views because the cameras run together, and with enough
    views the error over those.

    What is neither of a view nor of an instant is in both; it is taken out of the error over time,
    so that it counts once (Cameron, Gelbach & Miller 2011).

    Reading:
        A number that is no mean is to first order the mean of what each frame moves (its
        influence), and also over views. Its interval is of the number that such clips have on
        average, at this length: SDT of a longer clip is larger.
    """
    by_view, by_time = _samples_views(scene), len(scene.frames) > 1
    _check_enough(scene, by_view, by_time)
    views, frames = scene.even()
    errors = []
    if by_view:
        errors.append(
            ErrorOfMean.of_sample(
                _influence(scene, views, lambda nudged: scene.pool(nudged, frames)), scenes
            )
        )
    if by_time:
        of_frames = _influence(scene, frames, partial(scene.pool, views))
        errors.append(
            ErrorOfMean.of_series(
                of_frames, _rest(scene) if by_view else 0.0, scenes, scene.squares
            )
        )
    return errors


def _samples_views(scene: PooledScene) -> bool:
    """Return whether its views are a sample that represents others."""
    return len(scene.views) >= FEWEST and not scene.views_given


def _rest(scene: PooledScene) -> Array:
    """Variance of the number due to what is neither of a view nor of an instant, under each model
    of correlation, (G,).
    """
    views, frames = scene.even()
    count = views.shape[1]
    of_view = []
    for view in (1.0 - NUDGE) * views + NUDGE * np.eye(count):
        of_view.append(_influence(scene, frames, partial(scene.pool, view[None])))
    moved = np.array(of_view) / NUDGE
    scales = correlation_posterior(moved - moved.mean(axis=0)).scales  # (V, G)
    return np.asarray(np.square(scales).sum(axis=0) / (count * (count - 1)))


def _check_enough(scene: PooledScene, by_view: bool, by_time: bool) -> None:
    """Refuse what does not vary over anything that counts as a sample."""
    if len(scene.views) == 1 and scene.views[0] is not None:
        raise ResultsError("1 view; an interval needs 2")
    if by_time or (by_view and scene.frames[0] < 0):
        return
    if scene.frames[0] >= 0:
        raise ResultsError("1 frame; an interval needs 2")
    contents = (
        "one value for the whole rig"
        if scene.views == (None,)
        else f"one value for each of {len(scene.views)} views"
    )
    raise ResultsError(f"{contents}; an interval needs values along time, or {FEWEST} views")


def _influence(scene: PooledScene, even: Array, pool: Callable[[Array], Array]) -> Array:
    """Return the influence of each view or frame, how the number moves when it counts more,
    (count,); mean 0 to first order.
    """
    nudged = (1.0 - NUDGE) * even + NUDGE * np.eye(even.shape[1])
    moved = np.asarray((pool(nudged) - pool(even)) / NUDGE)
    if not np.isfinite(moved).all():
        raise ResultsError("the number is not finite, such as a ratio to 0; no interval")
    return np.where(np.abs(moved) > ROUNDING / NUDGE * max(1.0, abs(scene.value)), moved, 0.0)
