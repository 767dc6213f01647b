"""Decomposition and intervals: sums of squares that add up, intervals that cover, numbers that are
the summary's.
"""

from dataclasses import replace

import numpy as np
import pytest

from ggvs_eval.errors import ResultsError
from ggvs_eval.metrics.metric import MetricOptions
from ggvs_eval.metrics.stream import score_view
from ggvs_eval.metrics.time.deviations import sdt, sdv
from ggvs_eval.statistics.decomposition import decompose, decompose_metric
from ggvs_eval.statistics.intervals import Interval, intervals, measure_spread
from ggvs_eval.statistics.pooled import PooledScene
from ggvs_eval.statistics.pooling import (
    Pool,
    Pooling,
    pool_mean,
    pool_powers,
    pool_products,
    pool_sdt,
    pool_sdv,
    powers_of_means,
)
from helpers.refusals import refused
from helpers.tidy_tables import (
    autoregressive,
    make_results,
    make_rows,
    make_spread_rows,
    make_sted_rows,
)

CORRELATION = 0.6


def make_scene(values, pool: Pool | None = None) -> PooledScene:
    """The mean, or another number, of a matrix of views and frames."""
    views, frames = np.shape(values)
    names = tuple(f"cam{view:02}" for view in range(views))
    return PooledScene("room", names, tuple(range(frames)), pool or pool_mean(np.asarray(values)))


def coverage(make, truth: float, number=pool_mean, times: int = 250) -> float:
    """How often the 95 % interval of simulated matrices holds the truth."""
    generator = np.random.default_rng(7)
    spreads = (
        measure_spread([make_scene(values, number(values))])
        for values in (make(generator) for _ in range(times))
    )
    return float(np.mean([abs(spread.value - truth) <= spread.half_width() for spread in spreads]))


def table_interval(rows, metric: str, label: str = "ours", ddof: int = 1) -> Interval:
    return intervals(make_results(rows, ddof=ddof), metric, "Demo")[label]


@pytest.fixture
def matrix():
    """L1 of 4 views and 12 frames with effects of both."""
    generator = np.random.default_rng(3)
    return (
        5.0
        + generator.standard_normal((4, 1))
        + 0.5 * generator.standard_normal(12)
        + 0.3 * generator.random((4, 12))
    )


def test_squares_add_up(matrix):
    """Bias, view, time and rest hold the whole sum of squares, and their sum is the matrix."""
    parts = decompose(matrix)
    total = matrix.size * parts.mean**2 + parts.ss_view + parts.ss_time + parts.ss_rest
    assert total == pytest.approx(np.square(matrix).sum(), rel=1e-12)
    np.testing.assert_allclose(
        parts.mean + parts.view[:, None] + parts.time + parts.residual, matrix, rtol=1e-12
    )
    assert sum(parts.shares().values()) == pytest.approx(1.0)


def test_planted_effects_come_back():
    """A matrix made of a view effect alone has no time effect and no rest, and the other
    way round.
    """
    view, time = np.array([-1.0, 0.0, 1.0]), np.array([0.5, -0.5, 0.25, -0.25])
    parts = decompose(20.0 + view[:, None] + np.zeros(4))
    assert (parts.mean, parts.ss_view, parts.ss_time) == pytest.approx((20.0, 8.0, 0.0))
    assert decompose(20.0 + np.zeros((3, 1)) + time).shares() == pytest.approx(
        {"view": 0.0, "time": 1.0, "rest": 0.0}
    )
    assert decompose(np.full((2, 2), 7.0)).shares() == {"view": 0.0, "time": 0.0, "rest": 0.0}


@pytest.mark.parametrize("ddof", [0, 1])
def test_sdt_and_sdv_are_margins(matrix, ddof):
    """SDT and SDV follow from the parts: exactly, and squared they are the margin less the spread
    of the deviations.
    """
    parts = decompose(matrix)
    assert parts.sdt(ddof) == pytest.approx(sdt(matrix, ddof), rel=1e-12)
    assert parts.sdv(ddof) == pytest.approx(sdv(matrix, ddof), rel=1e-12)
    over_time, over_views = matrix.std(axis=1, ddof=ddof), matrix.std(axis=0, ddof=ddof)
    views, frames = matrix.shape
    of_time = (parts.ss_time + parts.ss_rest) / (views * (frames - ddof))
    of_views = (parts.ss_view + parts.ss_rest) / (frames * (views - ddof))
    assert of_time == pytest.approx(np.square(over_time).mean(), rel=1e-12)
    assert of_views == pytest.approx(np.square(over_views).mean(), rel=1e-12)
    assert sdt(matrix, ddof) ** 2 == pytest.approx(of_time - over_time.var(), rel=1e-12)
    assert sdv(matrix, ddof) ** 2 == pytest.approx(of_views - over_views.var(), rel=1e-12)


def test_bias_moves_no_deviation(matrix):
    """A constant error changes the mean alone; SDT is blind to the view effect and SDV to the time
    effect.
    """
    parts = decompose(matrix)
    shifted = decompose(matrix + 3.0)
    assert shifted.mean == pytest.approx(parts.mean + 3.0)
    assert shifted.shares() == pytest.approx(parts.shares())
    assert decompose(matrix + np.arange(4.0)[:, None]).sdt() == pytest.approx(parts.sdt())
    assert decompose(matrix + np.arange(12.0)).sdv() == pytest.approx(parts.sdv())


def test_decomposition_reads_the_table_and_refuses_holes(matrix):
    """The table's rows in any order give the matrix; a missing cell, an infinite one and a value
    per sequence are refused.
    """
    rows = make_spread_rows("ours+fast", matrix)
    read = {"scene": "room", "method": "ours", "variant": "fast"}
    assert decompose_metric(make_results(rows[::-1]), "L1", **read).ss_rest == pytest.approx(
        decompose(matrix).ss_rest
    )
    with refused(ResultsError, "L1 of ours+fast", "cam00 frame 7", "score"):
        decompose_metric(make_results(rows[:5] + rows[6:]), "L1", **read)
    with refused(ResultsError, "cam01 frame 2", "not finite"):
        decompose_metric(
            make_results(
                [(*row[:7], np.inf if row[4:6] == ("cam01", 2) else row[7]) for row in rows]
            ),
            "L1",
            **read,
        )
    with refused(ResultsError, "two values"):
        decompose_metric(make_results(rows + rows[:1]), "L1", **read)
    for metric in ("SDT", "SDV"):
        with refused(ResultsError, "each view and frame"):
            decompose_metric(make_results(rows), metric, **read)
    with refused(ResultsError, "no values"):
        decompose_metric(make_results(rows), "PSNR", **read)
    with refused(ResultsError, "row 0", "column 1", "nan"):
        decompose([[1.0, np.nan]])
    with refused(ResultsError, "ddof=1", "at least 2", "got 1"):
        decompose([[1.0, 2.0]]).sdv()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("views", "view_effect", "time_effect"),
    [(3, 0.0, 0.0), (9, 0.0, 0.0), (9, 1.0, 0.0), (9, 0.3, 0.5)],
)
def test_intervals_cover(views, view_effect, time_effect):
    """The 95 % interval holds the true mean 91 to 98 % of the time, whether views differ, flicker
    together, or neither.
    """

    def simulate(generator):
        common = time_effect * autoregressive(generator, 1, 100, CORRELATION)
        own = autoregressive(generator, views, 100, CORRELATION)
        return 30.0 + view_effect * generator.standard_normal((views, 1)) + common + own

    assert 0.91 <= coverage(simulate, 30.0) <= 0.98


def test_the_naive_interval_does_not_cover():
    """Standard deviation over the root of the number of frames misses the mean of the same series
    every third time.
    """
    generator = np.random.default_rng(7)
    simulated = [autoregressive(generator, 3, 100, CORRELATION) for _ in range(250)]
    assert (
        np.mean([abs(x.mean()) <= 1.96 * x.std(ddof=1) / np.sqrt(x.size) for x in simulated]) < 0.75
    )


def test_deviations_over_views_cover_and_deviations_over_time_say_why_not(matrix):
    """SDV of these views holds its true value as often as it says; SDT has no interval, for none
    would.
    """
    views = 2.0 * np.random.default_rng(0).standard_normal((9, 1))

    def simulate(generator):
        return 5.0 + views + 0.5 * autoregressive(generator, 9, 60, CORRELATION)

    many = (
        simulate(np.random.default_rng(1)),
        *(simulate(np.random.default_rng(seed)) for seed in range(2, 400)),
    )
    expected = np.mean([values.std(axis=0, ddof=1).mean() for values in many])
    generator = np.random.default_rng(7)
    spreads = [
        measure_spread([replace(make_scene(v, pool_sdv(v)), views_given=True)])
        for v in (simulate(generator) for _ in range(250))
    ]
    assert (
        0.91
        <= np.mean([abs(spread.value - expected) <= spread.half_width() for spread in spreads])
        <= 0.98
    )
    rows = make_spread_rows("ours", matrix)
    assert (table_interval(rows, "SDT").low, table_interval(rows, "SDV").low is None) == (
        None,
        False,
    )
    assert "too low coverage" in table_interval(rows, "SDT").note


@pytest.mark.parametrize("ddof", [0, 1])
def test_numbers_under_weights_are_those_of_the_repeated_matrix(matrix, ddof):
    """Weighting views and frames is the same as repeating rows and columns, for means, products and
    deviations.
    """
    views, frames = np.array([0, 0, 2, 3]), np.array([4, 4, 5, 6, 7, 0, 1, 2, 3, 9, 10, 11])
    weights = (
        np.bincount(views, minlength=4)[None] / 4,
        np.bincount(frames, minlength=12)[None] / 12,
    )
    drawn, other = matrix[views][:, frames], np.square(matrix)
    expected = {
        pool_mean(matrix): drawn.mean(),
        pool_powers(matrix, other, powers=(1, 1)): (
            drawn.mean(axis=1) * other[views][:, frames].mean(axis=1)
        ).mean(),
        pool_powers(matrix, other, powers=(1, -1)): (
            drawn.mean(axis=1) / other[views][:, frames].mean(axis=1)
        ).mean(),
        pool_powers(other, powers=(0.5,)): np.sqrt(other[views][:, frames].mean(axis=1)).mean(),
        pool_products(matrix, other): (drawn * other[views][:, frames]).mean(),
        pool_sdt(matrix, ddof): sdt(drawn, ddof),
        pool_sdv(matrix, ddof): sdv(drawn, ddof),
    }
    for pool, value in expected.items():
        assert pool(*weights)[0] == pytest.approx(value, rel=1e-9)


def test_intervals_stand_about_the_summary(matrix):
    """Every metric's interval is centred on the number of the summary: means, pairs, products and
    deviations.
    """
    rows = make_spread_rows("ours", matrix) + make_rows("ours", "TCC", matrix[:, 1:] / 10)
    rows += make_sted_rows("ours", matrix[:, ::2], matrix[:, 1::2])
    results = make_results(rows)
    for metric in ("L1", "TCC", "STED", "SDV"):
        found = intervals(results, metric, "Demo")["ours"]
        assert found.value == pytest.approx(
            results.summary().at[("Demo", "ours", ""), metric], rel=1e-12
        )
        assert found.low < found.value < found.high
        assert found.value - found.low == pytest.approx(found.high - found.value)
        assert found.note == "given this scene, these 4 views"


@pytest.mark.parametrize("pairing", ["disjoint", "consecutive"])
def test_what_the_score_step_writes_has_intervals(pairing):
    """Real scores of noisy frames, with the parts of STED per pair as they are written, get an
    interval in every metric.
    """
    generator = np.random.default_rng(1)
    rows = []
    for view in range(2):
        truth = generator.integers(0, 200, (7, 64, 64, 3)).astype(np.uint8)
        rendered = truth + generator.integers(0, 30, truth.shape).astype(np.uint8)
        names = ("PSNR", "TCC", "STED", "SDT", "L1")
        values = score_view(
            zip(rendered, truth, strict=True), names, MetricOptions(sted_pairing=pairing)
        ).values
        head = ("Demo", "room", "ours", "", f"cam{view}")
        rows += [
            (*head, -1 if frame is None else frame, name, value) for name, frame, value in values
        ]
    for metric in names:
        assert metric == "SDT" or table_interval(rows, metric).half_width > 0.0


def test_views_and_scenes_widen_the_interval_once_there_are_enough():
    """Five views count as a sample, four are taken as given; five scenes are a sample, and then
    nothing is given.
    """
    generator = np.random.default_rng(2)
    values = 30.0 + np.arange(5.0)[:, None] + 0.1 * generator.standard_normal((5, 40))
    few, enough = (
        table_interval(make_rows("ours", "PSNR", values[:count]), "PSNR") for count in (4, 5)
    )
    assert few.half_width < 0.1 < 1.0 < enough.half_width
    assert (few.note, enough.note) == ("given this scene, these 4 views", "given this scene")
    rows = [
        row
        for at in range(5)
        for row in make_rows("ours", "PSNR", values[:3] + 2.0 * at, scene=f"room{at}")
    ]
    assert table_interval(rows, "PSNR").note == ""
    assert table_interval(rows, "PSNR").half_width > 3.0
    two = [row for row in rows if row[1] in ("room0", "room1")]
    assert table_interval(two, "PSNR").note == "given these 2 scenes, these 3 views"


@pytest.mark.parametrize(
    ("rows", "metric", "reason"),
    [
        (make_rows("ours", "PSNR", np.ones((9, 1))), "PSNR", "1 frame; an interval needs 2"),
        (make_rows("ours", "PSNR", np.ones((1, 9))), "PSNR", "1 view; an interval needs 2"),
        (
            make_rows("ours", "PSNR", [[1.0, np.inf], [1.0, 2.0]]),
            "PSNR",
            "cam00 frame 3 not finite",
        ),
        (make_rows("ours", "PSNR", np.ones((2, 3)))[:-1], "PSNR", "cam01 frame 4 missing"),
        (make_spread_rows("ours", np.eye(3))[9:], "SDV", "no L1 per view and frame"),
        (
            make_rows("ours", "L1", np.eye(3)) + make_spread_rows("ours", 2 * np.eye(3))[9:],
            "SDV",
            "from its parts",
        ),
        (
            [("Demo", "room", "ours", "", None, -1, "EPI", 1.0)],
            "EPI",
            "one value for the whole rig",
        ),
        (
            [("Demo", "room", "ours", "", f"cam{v}", -1, "Flicker", 1.0) for v in range(4)],
            "Flicker",
            "each of 4 views",
        ),
        (
            make_sted_rows("ours", np.eye(3), np.eye(3))[-3:],
            "STED",
            "no STED_spatial, STED_temporal per view and frame",
        ),
    ],
)
def test_what_cannot_vary_says_why(rows, metric, reason):
    """Where there is nothing that varies, or cells are missing, there is a reason instead of
    bounds, and never NaN.
    """
    found = table_interval(rows, metric)
    assert (found.low, found.high, found.half_width) == (None, None, None)
    assert reason in found.note


def test_numbers_without_frames_have_intervals_over_views_or_time():
    """A value per view counts over five views or more, one per instant over time; a constant has an
    interval of no width.
    """
    per_view = [
        ("Demo", "room", "ours", "", f"cam{view}", -1, "Flicker", float(view)) for view in range(6)
    ]
    assert table_interval(per_view, "Flicker").half_width > 1.0
    per_instant = [
        ("Demo", "room", "ours", "", None, frame, "EPI", float(np.sin(frame**2)))
        for frame in range(30)
    ]
    assert table_interval(per_instant, "EPI").note == "given this scene"
    assert 0.05 < table_interval(per_instant, "EPI").half_width < 1.0
    found = table_interval(make_rows("ours", "PSNR", np.full((5, 8), 31.7)), "PSNR")
    assert found.low == found.high == found.value


def test_ddof_is_the_protocols(matrix):
    """Deviations are recomputed under the ddof that the protocol of the results names."""
    rows = make_spread_rows("ours", matrix, ddof=0)
    assert table_interval(rows, "SDV", ddof=0).half_width > 0.0
    assert "from its parts" in table_interval(rows, "SDV").note


def ratio_rows(above: np.ndarray, below: np.ndarray) -> list[tuple]:
    """Rows of a ratio of sums, as its scorer writes them: the parts of each frame, and one number
    per view.
    """
    rows = make_rows("ours", "Ratio_above", above) + make_rows("ours", "Ratio_below", below)
    with np.errstate(divide="ignore"):
        numbers = above.sum(axis=1) / below.sum(axis=1)
    return rows + [
        ("Demo", "room", "ours", "", f"cam{view:02}", -1, "Ratio", number)
        for view, number in enumerate(numbers)
    ]


def test_a_ratio_of_sums_has_the_interval_of_one(matrix):
    """The interval of a ratio comes from its parts: that of a constant ratio has no width, however
    much the parts vary.
    """
    pooling = {"Ratio": powers_of_means({"Ratio_above": 1, "Ratio_below": -1}).record()}

    def interval(above, below):
        return intervals(
            make_results(ratio_rows(above, below), {"pooling": pooling}), "Ratio", "Demo"
        )["ours"]

    constant, varying = interval(3.0 * matrix, matrix), interval(matrix[:, ::-1], matrix)
    assert (constant.value, constant.half_width) == pytest.approx((3.0, 0.0), abs=1e-9)
    assert varying.half_width > 0.01
    assert "not finite" in interval(matrix, 0.0 * matrix).note


def test_pooling_that_nobody_recorded_has_no_interval(matrix):
    """Results that do not say how a metric is pooled keep its number and get no interval by a
    guess; no rule is made up.
    """
    rows = make_rows("ours", "PSNR", matrix)
    found = intervals(make_results(rows, {"pooling": {}}), "PSNR", "Demo")["ours"]
    assert found.value == pytest.approx(matrix.mean())
    assert (found.half_width, found.note) == (
        None,
        "the results lack the pooling of PSNR; score again",
    )
    with refused(ResultsError, "'median'", "mean, "):
        Pooling("median")
