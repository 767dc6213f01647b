"""Confidence intervals of the numbers in a table, by a block bootstrap over time, views and scenes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.errors import ResultsError
from ggvs_eval.results import Results
from ggvs_eval.statistics.blocks import block_length, block_weights, unit_weights
from ggvs_eval.statistics.pooled import PooledScene
from ggvs_eval.statistics.pooled_table import pool_table

LEVEL = 0.95
RESAMPLES = 2000
SEED = 20250611
FEWEST = 5  # views or scenes from which others can be concluded; fewer are taken as given
NUDGE = 1e-4
ROUNDING = 1e-12


@dataclass(frozen=True)
class Interval:
    """A number and how sure it is.

    Attributes:
        value: the number of the whole table, as `ggvs_eval.results.Results.summary` has it.
        low: lower bound; None where there is no interval.
        high: upper bound, as far above the value as `low` is below; None likewise.
        note: what the interval takes as given (``given this scene, these 3 views``; empty where nothing), or why there is none.
    """

    value: float
    low: float | None
    high: float | None
    note: str

    @property
    def half_width(self) -> float | None:
        """Distance of either bound from the value; None where there is no interval."""
        return None if self.high is None else self.high - self.value


@dataclass(frozen=True)
class Spread:
    """What the bootstrap says about a number.

    Attributes:
        value: the number.
        deviations: (R,), how far it may be off by chance.
        given: what was not resampled.
    """

    value: float
    deviations: Array
    given: tuple[str, ...]

    @property
    def note(self) -> str:
        """What is taken as given, in words; empty where nothing is."""
        return f"given {', '.join(self.given)}" if self.given else ""

    def half_width(self, level: float) -> float:
        """Deviation that is exceeded, up or down, with probability 1 - level."""
        return float(np.quantile(np.abs(self.deviations), level, method="higher"))


def intervals(
    results: Results, metric: str, dataset: str, level: float = LEVEL, resamples: int = RESAMPLES
) -> dict[str, Interval]:
    """Interval of one metric's number for every method: the mean over frames, then views, then scenes.

    Args:
        results: every measured value.
        metric: name as in the table; what is no mean is computed anew from each resample, see `pooling.Pooling`.
        dataset: which data set of the table.
        level: confidence.
        resamples: of the bootstrap.

    Returns:
        Label (``method`` or ``method+variant``) -> interval, or the reason why there is none; equal inputs give equal bits.
    """
    table, found = pool_table(results, metric, dataset), {}
    for label, value in table.values.items():
        try:
            spread = resample(table.scenes_of(label), resamples)
            half = spread.half_width(level)
            found[label] = Interval(value, value - half, value + half, spread.note)
        except ResultsError as refusal:
            found[label] = Interval(value, None, None, str(refusal))
    return found


def resample(scenes: Sequence[PooledScene], resamples: int = RESAMPLES, seed: int = SEED) -> Spread:
    """Bootstrap the mean over scenes of a number.

    Args:
        scenes: the number on each scene.
        resamples: R.
        seed: of the random numbers; two calls with scenes of equal size and equal block lengths draw the same resamples.

    Raises:
        ResultsError: there is nothing to resample: one frame, one view.

    Reading:
        With five scenes or more, scenes are drawn whole: their spread holds that of the views and frames in them, and drawing
        those again would count it twice (Davison & Hinkley 1997, section 3.8). With fewer, scenes are taken as given and views
        and frames are drawn within each. Five test views or more count as a sample of the places where a camera could stand,
        fewer are taken as given too.
    """
    value = float(np.mean([scene.value for scene in scenes]))
    if len(scenes) >= FEWEST:
        generator = np.random.default_rng([seed, len(scenes)])
        numbers = np.array([scene.value for scene in scenes])
        deviations = _centred(unit_weights(generator, resamples, len(scenes)) @ numbers)
        return _spread(value, deviations * _small_sample(generator, resamples, len(scenes)), ())
    within = [_resample_scene(scene, resamples, np.random.default_rng([seed, at])) for at, scene in enumerate(scenes)]
    given = ["this scene" if len(scenes) == 1 else f"these {len(scenes)} scenes", *(name for one in within for name in one.given)]
    return _spread(value, np.mean([one.deviations for one in within], axis=0), tuple(dict.fromkeys(given)))


def _resample_scene(scene: PooledScene, resamples: int, generator: np.random.Generator) -> Spread:
    """Draw blocks of frames, the same in all views because the cameras run together, and with enough views those too.

    The two deviations are added, and scaled so that the rest, which is in both, counts once: the variance of views + that of
    frames - that of the rest (Cameron, Gelbach & Miller 2011). Drawing frames within drawn views instead would count the rest
    up to three times (Owen 2007), and other frames in each view would miss what happens to all views at once.
    """
    views, frames = len(scene.views), len(scene.frames)
    by_view, by_time = views >= FEWEST, frames > 1
    _check_enough(scene, by_view, by_time)
    even_views, even_frames = scene.even()
    of_view = of_time = np.zeros(resamples)
    view_scale = time_scale = np.ones(resamples)
    share = 1.0
    if by_time:
        length = block_length(_influence(scene))
        frame_weights = block_weights(generator, resamples, frames, length)
        of_time = _centred(scene.pool(even_views, frame_weights))
        time_scale = _small_sample(generator, resamples, frames / length)
    if by_view:
        view_weights = unit_weights(generator, resamples, views)
        of_view = _centred(scene.pool(view_weights, even_frames))
        view_scale = _small_sample(generator, resamples, views)
    if by_time and by_view:
        share = _share_counted_once(of_view, of_time, _centred(scene.pool(view_weights, frame_weights)))
    deviations = share * (of_view * view_scale + of_time * time_scale)
    given = () if by_view or scene.views == (None,) else (f"these {views} views",)
    return _spread(scene.value, deviations, given)


def _check_enough(scene: PooledScene, by_view: bool, by_time: bool) -> None:
    """Refuse what cannot be resampled in a meaningful way."""
    if len(scene.views) == 1 and scene.views[0] is not None:
        raise ResultsError("1 view; an interval needs 2")
    if by_time or (by_view and scene.frames[0] < 0):
        return
    if scene.frames[0] >= 0:
        raise ResultsError("1 frame; an interval needs 2")
    what = "one value for the whole rig" if scene.views == (None,) else f"one value for each of {len(scene.views)} views"
    raise ResultsError(f"{what}; an interval needs values along time, or {FEWEST} views")


def _influence(scene: PooledScene) -> Array:
    """The series whose mean the number is to first order: what each frame moves when it counts a little more."""
    views, frames = scene.even()
    count = frames.shape[1]
    nudged = (1.0 - NUDGE) * frames + NUDGE * np.eye(count)
    moved = np.asarray((scene.pool(views, nudged) - scene.pool(views, frames)) / NUDGE)
    return np.where(np.abs(moved) > ROUNDING / NUDGE * max(1.0, abs(scene.value)), moved, 0.0)


def _share_counted_once(of_view: Array, of_time: Array, of_both: Array) -> float:
    """Factor that takes the rest out of the sum of two deviations that both hold it, and never more than that."""
    views, frames, rest = of_view.var(), of_time.var(), (of_both - of_view - of_time).var()
    if views + frames == 0.0:
        return 1.0
    return float(np.sqrt(max(views + frames - rest, views, frames) / (views + frames)))


def _small_sample(generator: np.random.Generator, resamples: int, units: float) -> Array:
    """Random factors (R,) that turn a deviation of few units into Student's: the bootstrap alone has too thin tails."""
    if units <= 1.0:
        raise ResultsError(f"{units:.0f} unit to resample; an interval needs 2")
    freedom = units - 1.0
    return np.sqrt(units / freedom) * np.sqrt(freedom / generator.chisquare(freedom, size=resamples))


def _centred(values: Array) -> Array:
    """Deviations from the mean resample: draws with repetition shift a standard deviation, which is no error of the number.

    Raises:
        ResultsError: a resample has no finite number.
    """
    if not np.isfinite(values).all():
        raise ResultsError("a resample has no finite number, such as a ratio to 0; no interval")
    return np.asarray(values - values.mean())


def _spread(value: float, deviations: Array, given: tuple[str, ...]) -> Spread:
    """Deviations at the level of rounding are none."""
    return Spread(value, np.where(np.abs(deviations) > ROUNDING * abs(value), deviations, 0.0), given)
