"""Paired comparisons: what both methods share cancels, ties are marked, many comparisons raise the bar."""

import re

import numpy as np
import pytest

from ggvs_eval.errors import ResultsError
from ggvs_eval.statistics.intervals import intervals
from ggvs_eval.statistics.paired import compare, holm, rank_methods
from helpers.refusals import refused
from helpers.tidy_tables import autoregressive, make_results, make_rows, make_spread_rows, make_sted_rows


def make_shared(seed: int = 0, views: int = 6, frames: int = 60):
    """What a scene does to every method: hard views, a slow change in time, (V, T)."""
    generator = np.random.default_rng(seed)
    return 30.0 + 2.0 * generator.standard_normal((views, 1)) + autoregressive(generator, views, frames, 0.8)


def make_noise(seed: int, size: float, shape=(6, 60)):
    return size * autoregressive(np.random.default_rng(seed), shape[0], shape[1], 0.5)


@pytest.fixture
def results():
    """Three methods on the same hard views: two of them equal but for noise, the third 0.2 dB worse."""
    shared = make_shared()
    values = {"a": shared + make_noise(1, 0.1), "b+fast": shared + make_noise(2, 0.1), "c": shared - 0.2 + make_noise(3, 0.1)}
    return make_results([row for label, matrix in values.items() for row in make_rows(label, "PSNR", matrix)])


def test_pairing_sees_what_the_intervals_hide(results):
    """0.2 dB is far inside either method's interval, because views differ by more, and yet the difference is sure."""
    alone = intervals(results, "PSNR", "Demo")
    found = compare(results, "PSNR", "a", "c", "Demo")
    assert alone["a"].low < alone["c"].value < alone["a"].high
    assert found.difference == pytest.approx(alone["a"].value - alone["c"].value)
    assert 0.0 < found.low < 0.2 < found.high
    assert found.p_value < 0.01


def test_equal_methods_tie(results):
    """Two methods that differ by noise tie, and a method ties with itself with p = 1."""
    found = compare(results, "PSNR", "a", "b+fast", "Demo")
    assert found.low <= 0.0 <= found.high
    assert found.p_value > 0.05
    itself = compare(results, "PSNR", "a", "a", "Demo")
    assert (itself.difference, itself.low, itself.high, itself.p_value) == (0.0, 0.0, 0.0, 1.0)


def test_comparison_is_antisymmetric(results):
    """Swapping the methods turns the difference and its bounds round and leaves p."""
    there, back = compare(results, "PSNR", "a", "c", "Demo"), compare(results, "PSNR", "c", "a", "Demo")
    assert (there.difference, there.low, there.high) == pytest.approx((-back.difference, -back.high, -back.low))
    assert there.p_value == back.p_value


def test_best_and_ties(results):
    """The best and what cannot be told from it are found in either direction."""
    assert rank_methods(results, "PSNR", True, "Demo").ties == {"a", "b+fast"}
    assert rank_methods(results, "PSNR", False, "Demo").ties == {"c"}
    standing = rank_methods(results, "PSNR", True, "Demo")
    assert len(standing.best) == 1
    assert standing.untested == {}
    assert set(standing.comparisons) == {"a", "b+fast", "c"} - standing.best


def test_false_alarms_are_as_rare_as_promised():
    """Of two methods equal but for autocorrelated noise, one is called better in 1 to 9 % of the cases, naively in a third."""
    wrong = naive = 0
    for seed in range(150):
        first, second = make_noise(2 * seed, 1.0, (3, 100)), make_noise(2 * seed + 1, 1.0, (3, 100))
        pair = make_results(make_rows("a", "PSNR", first) + make_rows("b", "PSNR", second))
        found = compare(pair, "PSNR", "a", "b", "Demo")
        wrong += not found.low <= 0.0 <= found.high
        rest = first - second
        naive += abs(rest.mean()) > 1.96 * rest.std(ddof=1) / np.sqrt(rest.size)
    assert 0.01 <= wrong / 150 <= 0.09
    assert naive / 150 > 0.2


def make_slow_pair(better_db: float):
    """24 frames of two methods whose difference drifts by tenths of a decibel through the whole clip."""
    drift = np.linspace(-0.3, 0.3, 24) + 0.01 * np.random.default_rng(3).standard_normal(24)
    better = make_rows("a", "PSNR", 30.0 + better_db + np.tile(drift, (3, 1)))
    return make_results(better + make_rows("b", "PSNR", np.full((3, 24), 30.0)))


def test_a_clip_too_short_for_its_correlation_names_no_winner():
    """A difference that drifts through the clip keeps its numbers; where the drift may be all of it the two tie, as is said."""
    slow = make_slow_pair(0.3)
    found = compare(slow, "PSNR", "a", "b", "Demo")
    assert found.difference == pytest.approx(0.3, abs=0.01)
    assert found.low < found.difference < found.high
    assert found.p_value < 0.05
    assert re.fullmatch(r"clip too short: .* 24 frames say no more than [123] independent ones?, wanted 4", found.short)
    assert found.short in found.note
    standing = rank_methods(slow, "PSNR", True, "Demo")
    assert (standing.best, standing.ties, standing.short) == ({"a"}, {"a", "b"}, found.short)
    clear = rank_methods(make_slow_pair(2.0), "PSNR", True, "Demo")
    assert (clear.ties, clear.short) == ({"a"}, "")


def test_numbers_that_are_no_means_are_compared_too():
    """SDT, SDV and STED of a steadier method are told from those of a less steady one on the same frames."""
    base = make_noise(4, 1.0) + np.arange(6.0)[:, None] + 10.0
    rows = make_spread_rows("steady", base) + make_spread_rows("shaky", 10.0 + 1.6 * (base - 10.0) + make_noise(5, 0.2))
    rows += make_sted_rows("steady", base, base) + make_sted_rows("shaky", 1.3 * base, 1.3 * base)
    results = make_results(rows)
    for metric in ("SDT", "SDV", "STED"):
        found = compare(results, metric, "shaky", "steady", "Demo")
        assert found.low > 0.0
        assert found.difference > 0.0
        assert rank_methods(results, metric, False, "Demo").ties == {"steady"}


def test_holm_corrects_for_the_number_of_comparisons():
    """Holm's corrected values by hand: 0.01 x 3, 0.02 x 2, then never less than the one before."""
    assert holm([0.02, 0.01, 0.03]) == pytest.approx([0.04, 0.03, 0.04])
    assert holm([0.9, 0.6]) == [1.0, 1.0]
    assert holm([]) == []


def test_more_rivals_make_ties_more_likely(results):
    """The p value against the best grows with the number of methods in the table."""
    alone = rank_methods(results, "PSNR", True, "Demo")
    rivals = [row for seed in range(4) for row in make_rows(f"d{seed}", "PSNR", make_shared() - 0.1 + make_noise(9 + seed, 0.6))]
    crowd = rank_methods(
        make_results([tuple(row) for row in results.table.itertuples(index=False)] + rivals), "PSNR", True, "Demo"
    )
    assert crowd.best == alone.best
    assert crowd.p_values["c"] > alone.p_values["c"]


def test_methods_on_other_frames_are_not_compared():
    """Methods that were not measured alike have a reason instead of a p value, and only an equal number is a tie."""
    values = make_noise(1, 1.0)
    rows = make_rows("a", "PSNR", values + 1.0) + make_rows("b", "PSNR", values[:, :50]) + make_rows("c", "PSNR", values + 1.0)
    rows += make_rows("d", "PSNR", values, scene="hall")
    standing = rank_methods(make_results(rows), "PSNR", True, "Demo")
    assert standing.ties == {"a", "c"}
    assert "not the same views and frames (6 x 50 and 6 x 60)" in standing.untested["b"]
    assert "not measured on the same scenes" in standing.untested["d"]
    found = standing.comparisons["b"]
    assert (found.low, found.high, found.p_value) == (None, None, None)


def test_a_single_frame_has_no_test():
    """With one frame the best is known and nothing else; two infinite values are equal, not NaN."""
    rows = make_rows("a", "PSNR", [[30.0], [31.0]]) + make_rows("b", "PSNR", [[29.0], [31.0]])
    standing = rank_methods(make_results(rows), "PSNR", True, "Demo")
    assert (standing.ties, standing.untested) == ({"a"}, {"b": "1 frame; an interval needs 2"})
    perfect = make_results(make_rows("a", "PSNR", [[np.inf, 1.0]]) + make_rows("b", "PSNR", [[np.inf, 2.0]]))
    assert compare(perfect, "PSNR", "a", "b", "Demo").difference == 0.0
    assert rank_methods(perfect, "PSNR", True, "Demo").ties == {"a", "b"}


def test_unknown_names_are_refused(results):
    """A method, metric or data set that has no values is named."""
    with refused(ResultsError, "PSNR of x", "Demo", "a, b+fast, c"):
        compare(results, "PSNR", "a", "x", "Demo")
    with refused(ResultsError, "SSIM", "Demo"):
        rank_methods(results, "SSIM", True, "Demo")
