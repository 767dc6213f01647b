"""Coverage of 95 % intervals of means of correlated clips, their width, and how often equal methods
are distinguished.

    python -m benchmarks.interval_coverage [--repetitions 4000] [--package-repetitions 1000]
    [--tables 200]

First the methods in question on one series, then the package's own on views and on pairs of
methods, then tables of several methods and metrics.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import tyro
from numpy.lib.stride_tricks import sliding_window_view
from scipy import stats
from scipy.fft import dct
from scipy.signal import lfilter

from ggvs_eval.arrays import Array
from ggvs_eval.results import Results, make_table
from ggvs_eval.statistics.autocorrelation import (
    FEWEST_WORTH,
    Posterior,
    correlation_posterior,
    tail_probability,
)
from ggvs_eval.statistics.intervals import measure_spread
from ggvs_eval.statistics.paired import Pair, Ranking, judge
from ggvs_eval.statistics.pooled import PooledScene
from ggvs_eval.statistics.pooling import MEAN, Pool, pool_mean, pool_sdt

FRAMES = (24, 100, 300)
CORRELATIONS = (0.0, 0.3, 0.5, 0.7, 0.9)
LEVEL = 0.95
UPPER = 0.975
SETTLING = 300  # frames before a clip begins
WIDTHS = 200  # clips of which widths are averaged where each costs a search
RESAMPLES = 400
LARGEST = 0.97
REFERENCE = 20000  # clips by which the true deviation of a mean is measured

Generator = np.random.Generator
HalfWidths = Callable[[Array], Array]  # series (R, T) -> half widths (R,)


@dataclass(frozen=True)
class Options:
    """Numbers of repetitions, which set how long it takes.

    Attributes:
        repetitions: clips of each kind for the methods in question.
        package_repetitions: clips of each kind for the package's own functions.
        tables: of each kind, of which the winners are counted.
    """

    repetitions: int = 4000
    package_repetitions: int = 1000
    tables: int = 200


def autoregressive(
    generator: Generator, count: int, frames: int, correlation: float, heavy: bool = False
) -> Array:
    """(count, frames) of mean 0 and variance 1.

    Heavy tails are Student's with 3 degrees of freedom.
    """
    size = (count, frames + SETTLING)
    noise = (
        generator.standard_t(3, size) / np.sqrt(3.0) if heavy else generator.standard_normal(size)
    )
    return np.asarray(
        lfilter([np.sqrt(1.0 - correlation**2)], [1.0, -correlation], noise, axis=1)[:, SETTLING:]
    )


def normal(generator: Generator, count: int, frames: int, correlation: float) -> Array:
    """Return an autoregression with normal noise."""
    return autoregressive(generator, count, frames, correlation)


def heavy(generator: Generator, count: int, frames: int, correlation: float) -> Array:
    """Return an autoregression with heavy-tailed noise."""
    return autoregressive(generator, count, frames, correlation, heavy=True)


def frame_noise(generator: Generator, count: int, frames: int, correlation: float) -> Array:
    """Return half of the variance correlated, half noise of each frame: longer memory than the
    lag-1 correlation shows.
    """
    return (
        autoregressive(generator, count, frames, correlation)
        + generator.standard_normal((count, frames))
    ) / np.sqrt(2.0)


def slow(generator: Generator, count: int, frames: int, correlation: float) -> Array:
    """Return an autoregression on a slow wave of random phase, whose period is half of the clip,
    and a fifth of the variance.
    """
    phase = generator.uniform(0.0, 2.0 * np.pi, (count, 1))
    wave = np.sqrt(0.4) * np.sin(phase + 4.0 * np.pi * np.arange(frames) / frames)
    return np.sqrt(0.8) * autoregressive(generator, count, frames, correlation) + wave


KINDS = {"normal": normal, "heavy tails": heavy, "noise of frames": frame_noise, "slow wave": slow}


def white(series: Array) -> Array:
    """Student's t, as if frames were independent."""
    frames = series.shape[1]
    return np.asarray(stats.t.ppf(UPPER, frames - 1) * series.std(axis=1, ddof=1) / np.sqrt(frames))


def moving_blocks(series: Array) -> Array:
    """Moving-block bootstrap with blocks of the root of T, corrected for the number of blocks."""
    count, frames = series.shape
    length, generator = int(np.ceil(np.sqrt(frames))), np.random.default_rng(0)
    sums = sliding_window_view(series, length, axis=1).mean(axis=2)
    blocks = frames / length
    starts = generator.integers(0, sums.shape[1], (RESAMPLES, round(blocks)))
    factor = np.sqrt(blocks / generator.chisquare(blocks - 1.0, RESAMPLES))
    halves = [
        np.quantile(np.abs((one[starts].mean(axis=1) - one.mean()) * factor), LEVEL) for one in sums
    ]
    return np.array(halves).reshape(count)


def bartlett(series: Array) -> Array:
    """Newey-West with 1.3 T^(1/2) lags and fixed-b critical values (Kiefer & Vogelsang 2005;
    Lazarus et al. 2018).
    """
    frames = series.shape[1]
    share = 1.3 / np.sqrt(frames)
    centred = series - series.mean(axis=1, keepdims=True)
    lags = range(1, int(np.ceil(share * frames)))
    products = [
        (1.0 - lag / (share * frames)) * (centred[:, lag:] * centred[:, :-lag]).sum(axis=1)
        for lag in lags
    ]
    variance = (np.square(centred).sum(axis=1) + 2.0 * sum(products)) / frames
    critical = 1.96 + 2.9694 * share + 0.4160 * share**2 - 0.5324 * share**3
    return np.asarray(critical * np.sqrt(variance / frames))


def cosines(series: Array) -> Array:
    """Equally weighted cosines, 0.4 T^(2/3) of them, with Student's critical values (Lazarus et al.
    2018).
    """
    frames = series.shape[1]
    used = max(2, round(0.4 * frames ** (2 / 3)))
    coefficients = dct(series - series.mean(axis=1, keepdims=True), axis=1, norm="ortho")[
        :, 1 : 1 + used
    ]
    return np.asarray(
        stats.t.ppf(UPPER, used) * np.sqrt(np.square(coefficients).mean(axis=1) / frames)
    )


def prewhitened(series: Array) -> Array:
    """Return the same of what an autoregression leaves, coloured again (Andrews & Monahan 1992),
    with Kendall's correction.
    """
    correlation = corrected_correlation(series)[:, None]
    centred = series - series.mean(axis=1, keepdims=True)
    return cosines(centred[:, 1:] - correlation * centred[:, :-1]) / (1.0 - correlation[:, 0])


def effective_size(series: Array) -> Array:
    """Student's t with the effective sample size of one corrected correlation."""
    frames, correlation = series.shape[1], np.maximum(corrected_correlation(series), 0.0)
    size = frames * (1.0 - correlation) / (1.0 + correlation)
    freedom = np.maximum(2.0 * frames / (2.0 + 4.0 / (1.0 - correlation**2)), 1.0)
    variance = series.var(axis=1) / np.maximum(1.0 - 1.0 / size, 0.2)
    return np.asarray(stats.t.ppf(UPPER, freedom) * np.sqrt(variance / size))


def corrected_correlation(series: Array) -> Array:
    """Lag-1 correlation without most of its bias (Kendall 1954)."""
    frames = series.shape[1]
    centred = series - series.mean(axis=1, keepdims=True)
    plain = (
        (centred[:, 1:] * centred[:, :-1]).sum(axis=1)
        / np.square(centred).sum(axis=1)
        * frames
        / (frames - 1)
    )
    return np.asarray(np.clip(plain + (1.0 + 3.0 * plain) / frames, -0.9, LARGEST))


METHODS: dict[str, HalfWidths] = {
    "white": white,
    "blocks": moving_blocks,
    "Bartlett": bartlett,
    "cosines": cosines,
    "prewhitened": prewhitened,
    "effective": effective_size,
}


def posterior_half_widths(posterior: Posterior) -> Array:
    """Return half widths (R,) of the package's method, by bisection of all at once."""
    low, high = (
        np.zeros(len(posterior.scales)),
        posterior.scales.max(axis=1) * stats.t.ppf(UPPER, posterior.freedom),
    )
    for _ in range(30):
        middle = (low + high) / 2.0
        inside = (
            tail_probability(middle, posterior.weights, posterior.scales, posterior.freedom)
            > 1.0 - LEVEL
        )
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    return high


def compare_methods(repetitions: int) -> Iterator[str]:
    """Yield the coverage in % and mean width, over that of the 95 % interval of who knows the
    process, of every method.
    """
    yield f"| frames | clip | c | {' | '.join(METHODS)} | ours | too short |"
    yield "| ---: | --- | ---: |" + " ---: |" * (len(METHODS) + 2)
    for frames in FRAMES:
        for kind, make in KINDS.items():
            for correlation in CORRELATIONS:
                generator = np.random.default_rng([frames, int(10 * correlation)])
                series = make(generator, repetitions, frames, correlation)
                means, ideal = (
                    series.mean(axis=1),
                    1.96 * make(generator, REFERENCE, frames, correlation).mean(axis=1).std(),
                )
                halves = {name: method(series) for name, method in METHODS.items()}
                cells = [
                    f"{100 * (np.abs(means) <= half).mean():.1f} / {half.mean() / ideal:.2f}"
                    for half in halves.values()
                ]
                posterior = correlation_posterior(series)
                tails = tail_probability(
                    means, posterior.weights, posterior.scales, posterior.freedom
                )
                some = Posterior(
                    posterior.weights[:WIDTHS],
                    posterior.scales[:WIDTHS],
                    posterior.freedom,
                    posterior.worth,
                )
                width = posterior_half_widths(some).mean() / ideal
                cells.append(f"**{100 * (tails >= 1.0 - LEVEL).mean():.1f} / {width:.2f}**")
                short = 100 * (posterior.worth < FEWEST_WORTH).mean()
                yield (
                    f"| {frames} | {kind} | {correlation:.1f} | {' | '.join(cells)} | {short:.0f} |"
                )


def scene(values: Array, pool: Pool, squares: bool = False) -> PooledScene:
    """Return a number of (V, T) values; one view represents the whole rig."""
    views = tuple(f"cam{view}" for view in range(len(values))) if len(values) > 1 else (None,)
    return PooledScene("room", views, tuple(range(values.shape[1])), pool, squares=squares)


def rig(
    generator: Generator, views: int, frames: int, correlation: float, heavy_tails: bool
) -> Array:
    """Return the errors of views that see the same instant: half of the variance in common.

    With nine, views also differ.
    """
    common = autoregressive(generator, 1, frames, correlation, heavy_tails)
    own = autoregressive(generator, views, frames, correlation, heavy_tails)
    of_view = 0.5 * generator.standard_normal((views, 1)) if views > 4 else 0.0
    return np.asarray(np.sqrt(0.5) * (common + own) + of_view)


def check_package(repetitions: int) -> Iterator[str]:
    """Yield the coverage of means and of SDT, which is not shown, and false alarms of paired
    comparisons of both, all in %.
    """
    yield (
        "\n| frames | views | tails | c | mean | SDT | false alarms, mean | false alarms, SDT | "
        "too short |"
    )
    yield "| ---: | ---: | --- |" + " ---: |" * 6
    cases = [
        (t, v, h, c)
        for t in FRAMES
        for v in (1, 3, 9)
        for h in (False, True)
        for c in (0.0, 0.7, 0.9)
        if not h or v == 3
    ]
    for frames, views, tails, correlation in cases:
        generator = np.random.default_rng([frames, views, tails, int(10 * correlation)])
        held, alarms, of_sdt, short = [], [], [], []
        deviations, halves = [], []
        for _ in range(repetitions):
            shared, first, second = (
                rig(generator, views, frames, correlation, tails) for _ in range(3)
            )
            held.append(measure_spread([scene(first, pool_mean(first))]).p_value() >= 1.0 - LEVEL)
            own = measure_spread([scene(first, pool_sdt(first), squares=True)])
            deviations.append(own.value)
            halves.append(own.half_width())
            one, other = shared + first, shared + second
            pools = ((pool_mean, False), (pool_sdt, True))
            pairs = [
                (scene(one, pool(one), squares), scene(other, pool(other), squares))
                for pool, squares in pools
            ]
            mean, deviation = (measure_spread([ours.minus(theirs)]) for ours, theirs in pairs)
            short.append(bool(mean.short))
            alarms.append(
                mean.p_value() < 1.0 - LEVEL and not mean.too_short(1.0 - LEVEL, mean.worth)
            )
            of_sdt.append(
                deviation.p_value() < 1.0 - LEVEL
                and not deviation.too_short(1.0 - LEVEL, deviation.worth)
            )
        sdt_held = np.abs(np.array(deviations) - np.mean(deviations)) <= halves
        shares = [100 * float(np.mean(each)) for each in (held, sdt_held, alarms, of_sdt, short)]
        yield (
            f"| {frames} | {views} | {'heavy' if tails else 'normal'} | {correlation:.1f} | "
            f"{' | '.join(f'{share:.1f}' for share in shares)} |"
        )


# Equal methods, metrics, views, frames, correlation, heavy tails; and how far another method is
# ahead of them.
TABLES = (
    *(
        (2, 1, 3, 12, 0.9, False, 0.0),
        (2, 1, 3, 6, 0.95, False, 0.0),
        (2, 7, 3, 4, 0.95, True, 0.0),
    ),
    *(
        (2, 7, 3, 24, 0.0, False, 0.0),
        (2, 7, 3, 24, 0.9, True, 0.0),
        (2, 7, 9, 24, 0.5, False, 0.0),
    ),
    *(
        (2, 7, 3, 100, 0.8, False, 0.0),
        (3, 7, 3, 24, 0.5, False, 0.0),
        (6, 7, 3, 24, 0.5, True, 0.0),
    ),
    *(
        (6, 3, 9, 100, 0.8, False, 0.0),
        (2, 7, 3, 24, 0.5, False, 50.0),
        (2, 7, 3, 100, 0.8, False, 50.0),
    ),
)


def check_tables(repetitions: int) -> Iterator[str]:
    """Yield the share of tables of equal methods in which any metric has a winner, of the table or
    of a pair, in %.
    """
    yield (
        "\n| methods | metrics | views | frames | c | tails | one ahead by | winner in the table | "
        "winner of a pair |"
    )
    yield "| ---: | ---: | ---: | ---: | ---: | --- | ---: | ---: | ---: |"
    for count, n_metrics, views, frames, correlation, tails, ahead in TABLES:
        generator = np.random.default_rng([count, n_metrics, views, frames, int(ahead)])
        metrics = [f"metric {at}" for at in range(n_metrics)]
        equal = [f"method {at}" for at in range(count)]
        winners, pairs_called = 0, 0
        for _ in range(repetitions):
            results = equal_methods(
                generator, equal, metrics, (views, frames, correlation, tails), ahead
            )
            standings = judge(
                results, [Ranking(metric, higher_is_better=True) for metric in metrics], "room"
            )
            winners += any(judgement.winner in equal for judgement in standings.judgements.values())
            decided = standings.decide(Pair(metric, equal[0], equal[1]) for metric in metrics)
            pairs_called += any(
                comparison.outcome in ("better", "worse") for comparison in decided.values()
            )
        shares = " | ".join(
            f"{100 * number / repetitions:.1f}" for number in (winners, pairs_called)
        )
        kind = "heavy" if tails else "normal"
        yield (
            f"| {count} | {n_metrics} | {views} | {frames} | {correlation:.2f} | {kind} | "
            f"{ahead:g} | {shares} |"
        )


def equal_methods(
    generator: Generator,
    equal: list[str],
    metrics: list[str],
    shape: tuple[int, int, float, bool],
    ahead: float,
) -> Results:
    """Return results of methods that are equal but for their errors.

    If ``ahead`` is not 0, of another before them.
    """
    rows = []
    for metric in metrics:
        shared = rig(generator, *shape)
        for method in [*equal, "ahead"] if ahead else equal:
            values = shared + rig(generator, *shape) + (ahead if method == "ahead" else 0.0)
            for (view, frame), value in np.ndenumerate(values):
                rows.append(("room", "room", method, "", f"cam{view:02}", frame, metric, value))
    pooling = dict.fromkeys(metrics, MEAN.record())
    return Results(make_table(rows), {"protocol_sha256": "", "pooling": pooling})


def main(options: Options) -> None:
    """Print all tables."""
    for line in compare_methods(options.repetitions):
        print(line, flush=True)
    for line in check_package(options.package_repetitions):
        print(line, flush=True)
    for line in check_tables(options.tables):
        print(line, flush=True)


if __name__ == "__main__":
    main(tyro.cli(Options))
