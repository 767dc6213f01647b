"""Paired comparisons: what both methods share cancels, ties are marked, many comparisons raise the
bar.
"""

import re
from dataclasses import replace

import numpy as np
import pytest

from ggvs_eval.errors import ResultsError
from ggvs_eval.results import without_labels
from ggvs_eval.statistics.intervals import intervals
from ggvs_eval.statistics.paired import Judgement, Pair, Ranking, compare, holm
from ggvs_eval.statistics.paired import judge as judge_table
from helpers.refusals import refused
from helpers.tidy_tables import (
    autoregressive,
    make_results,
    make_rows,
    make_spread_rows,
    make_sted_rows,
)


def judge(
    results, metric, higher_is_better, dataset, own_labels=(), incomparable=None
) -> Judgement:
    """The judgement of a table of one metric."""
    ranking = Ranking(metric, higher_is_better, incomparable=incomparable or {})
    return judge_table(results, [ranking], dataset, own_labels).judgements[metric]


def make_shared(seed: int = 0, views: int = 6, frames: int = 60):
    """What a scene does to every method: hard views, a slow change in time, (V, T)."""
    generator = np.random.default_rng(seed)
    return (
        30.0
        + 2.0 * generator.standard_normal((views, 1))
        + autoregressive(generator, views, frames, 0.8)
    )


def make_noise(seed: int, size: float, shape=(6, 60)):
    return size * autoregressive(np.random.default_rng(seed), shape[0], shape[1], 0.5)


@pytest.fixture
def results():
    """Three methods on the same hard views: two of them equal but for noise, the third 0.2 dB
    worse.
    """
    shared = make_shared()
    values = {
        "a": shared + make_noise(1, 0.1),
        "b+fast": shared + make_noise(2, 0.1),
        "c": shared - 0.2 + make_noise(3, 0.1),
    }
    return make_results(
        [row for label, matrix in values.items() for row in make_rows(label, "PSNR", matrix)]
    )


def test_pairing_sees_what_the_intervals_hide(results):
    """0.2 dB is far inside either method's interval, because views differ by more, and yet the
    difference is sure.
    """
    alone = intervals(results, "PSNR", "Demo")
    found = compare(results, "PSNR", "a", "c", "Demo")
    assert alone["a"].low < alone["c"].value < alone["a"].high
    assert found.difference == pytest.approx(alone["a"].value - alone["c"].value)
    assert 0.0 < found.low < 0.2 < found.high
    assert found.p_value < 0.01


def test_equal_methods_tie(results):
    """Methods that differ by noise tie, one ties with itself with p = 1; swapped, the difference
    turns round and p stays.
    """
    found = compare(results, "PSNR", "a", "b+fast", "Demo")
    assert found.low <= 0.0 <= found.high
    assert found.p_value > 0.05
    itself = compare(results, "PSNR", "a", "a", "Demo")
    assert (itself.difference, itself.low, itself.high, itself.p_value) == (0.0, 0.0, 0.0, 1.0)
    there, back = (
        compare(results, "PSNR", "a", "c", "Demo"),
        compare(results, "PSNR", "c", "a", "Demo"),
    )
    assert (there.difference, there.low, there.high) == pytest.approx(
        (-back.difference, -back.high, -back.low)
    )
    assert there.p_value == back.p_value


def test_best_and_ties(results):
    """The best and what cannot be told from it are found in either direction."""
    assert judge(results, "PSNR", True, "Demo").marked == {"a", "b+fast"}
    lowest = judge(results, "PSNR", False, "Demo")
    assert (lowest.marked, lowest.winner) == ({"c"}, "c")
    judgement = judge(results, "PSNR", True, "Demo")
    assert judgement.winner == ""
    assert judgement.having("as good") == tuple({"a", "b+fast"} - {judgement.best})
    assert judgement.having("worse") == ("c",)


@pytest.mark.slow
def test_false_alarms_are_as_rare_as_promised():
    """Of two methods equal but for autocorrelated noise, one is called better in 1 to 9 % of the
    cases, naively in a third.
    """
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
    """24 frames of two methods whose difference drifts by tenths of a decibel through the whole
    clip.
    """
    drift = np.linspace(-0.3, 0.3, 24) + 0.01 * np.random.default_rng(3).standard_normal(24)
    better = make_rows("a", "PSNR", 30.0 + better_db + np.tile(drift, (3, 1)))
    return make_results(better + make_rows("b", "PSNR", np.full((3, 24), 30.0)))


def test_a_clip_too_short_for_its_correlation_names_no_winner():
    """A difference that drifts through the clip keeps its numbers; where the drift may be all of it
    none wins and none ties.
    """
    slow = make_slow_pair(0.3)
    found = judge(slow, "PSNR", True, "Demo").comparisons["b"].reversed
    assert found.difference == pytest.approx(0.3, abs=0.01)
    assert found.low < found.difference < found.high
    assert found.p_value < 0.05
    assert re.fullmatch(r"clip too short: [123] independent frames?, .*", found.short)
    assert "interval perhaps too narrow: " in found.note
    open_ = judge(slow, "PSNR", True, "Demo")
    assert (open_.best, open_.winner, open_.having("too short"), open_.having("as good")) == (
        "a",
        "",
        ("b",),
        (),
    )
    assert (open_.undecided, open_.marked) == (found.short, frozenset())
    clear = judge(make_slow_pair(2.0), "PSNR", True, "Demo")
    assert (clear.winner, clear.marked, clear.undecided) == ("a", {"a"}, "")


def test_numbers_that_are_no_means_are_compared_too():
    """SDT, SDV and STED of a steadier method are told from those of a less steady one on the same
    frames.
    """
    base = make_noise(4, 1.0) + np.arange(6.0)[:, None] + 10.0
    rows = make_spread_rows("steady", base) + make_spread_rows(
        "shaky", 10.0 + 1.6 * (base - 10.0) + make_noise(5, 0.2)
    )
    rows += make_sted_rows("steady", base, base) + make_sted_rows("shaky", 1.3 * base, 1.3 * base)
    rows += make_rows("steady", "PSNR", 30.0 + base) + make_rows("shaky", "PSNR", 29.5 + base)
    results = make_results(rows)
    for metric in ("SDT", "SDV", "STED"):
        found = compare(results, metric, "shaky", "steady", "Demo")
        assert found.low > 0.0
        assert found.difference > 0.0
        assert judge(results, metric, False, "Demo").winner == "steady"


def test_what_does_not_compare_is_not_ranked(results):
    """A method that the caller rules out keeps its number and its reason, and the next one is the
    best.
    """
    judgement = judge(
        results,
        "PSNR",
        True,
        "Demo",
        incomparable={"a": "is of another camera", "b+fast": "is of another camera"},
    )
    assert (judgement.best, judgement.comparisons) == ("c", {})
    assert judgement.unranked == {"a": "is of another camera", "b+fast": "is of another camera"}
    assert judgement.interval("a").value > judgement.interval("c").value


def test_holm_corrects_for_the_number_of_comparisons():
    """Holm's corrected values by hand: 0.01 x 3, 0.02 x 2, then never less than the one before."""
    assert holm([0.02, 0.01, 0.03]) == pytest.approx([0.04, 0.03, 0.04])
    assert holm([0.9, 0.6]) == [1.0, 1.0]
    assert holm([]) == []


def test_methods_on_other_frames_are_not_compared():
    """Methods that were not measured alike are not ranked, and say so; compared by name they have a
    reason and no p value.
    """
    values = make_noise(1, 1.0)
    rows = (
        make_rows("a", "PSNR", values + 1.0)
        + make_rows("b", "PSNR", values[:, :50])
        + make_rows("c", "PSNR", values + 1.0)
    )
    results = make_results(rows)
    judgement = judge(results, "PSNR", True, "Demo")
    assert (judgement.best, judgement.having("equal"), judgement.winner) == ("a", ("c",), "")
    assert "other views or frames" in judgement.unranked["b"]
    found = compare(results, "PSNR", "b", "a", "Demo")
    assert (found.low, found.high, found.p_value) == (None, None, None)
    assert "not the same views and frames (6 x 50 and 6 x 60)" in found.note
    elsewhere = make_results(rows + make_rows("d", "PSNR", values, scene="hall"))
    assert "not measured on the same scenes" in compare(elsewhere, "PSNR", "d", "a", "Demo").note


def test_a_single_frame_has_no_test():
    """With one frame nothing is tested, so nothing is marked; two infinite values are equal, not
    NaN.
    """
    rows = make_rows("a", "PSNR", [[30.0], [31.0]]) + make_rows("b", "PSNR", [[29.0], [31.0]])
    judgement = judge(make_results(rows), "PSNR", True, "Demo")
    assert (judgement.best, judgement.winner, judgement.marked) == ("a", "", frozenset())
    assert judgement.undecided == "nothing could be compared (1 frame; an interval needs 2)"
    perfect = make_results(
        make_rows("a", "PSNR", [[np.inf, 1.0]]) + make_rows("b", "PSNR", [[np.inf, 2.0]])
    )
    assert compare(perfect, "PSNR", "a", "b", "Demo").difference == 0.0
    assert judge(perfect, "PSNR", True, "Demo").having("equal") == ("b",)


def test_variants_are_no_rivals_of_their_method():
    """An ablation is no rival, but what is better wins the column alone, as `compare` says; alone
    they compete.
    """
    shared = make_shared()
    values = {"x": shared - 0.5, "own": shared, "own+less": shared + 0.3}
    rows = [
        row
        for at, (label, one) in enumerate(values.items())
        for row in make_rows(label, "PSNR", one + make_noise(at, 0.1))
    ]
    judgement = judge(make_results(rows), "PSNR", True, "Demo", own_labels=("own", "own+less"))
    assert (judgement.best, judgement.rivals, judgement.winner, judgement.marked) == (
        "own",
        ("x",),
        "own+less",
        {"own+less"},
    )
    assert judgement.variants["own+less"].outcome == "better"
    alone = judge(
        make_results(rows[len(rows) // 3 :]), "PSNR", True, "Demo", own_labels=("own", "own+less")
    )
    assert (alone.winner, alone.variants) == ("own+less", {})


def test_a_certain_fault_wins_nowhere():
    """A faulty or partial method is not ranked, whatever its number; of these alone nothing is
    best.
    """
    rows = (
        make_rows("a", "PSNR", make_shared())
        + make_rows("late", "PSNR", make_shared() + 9)
        + make_rows("b", "PSNR", make_shared() - 1)
    )
    found = make_results(rows)
    fault = [
        "late",
        "room",
        "cam00",
        "frame offset",
        "certain",
        "frame t shows instant t-1",
        "renumber",
        "late",
    ]
    spoilt = replace(
        found,
        provenance=found.provenance
        | {"faults": [fault], "partial": {"b": "partial: 1 of 2 views"}},
    )
    judgement = judge(spoilt, "PSNR", True, "Demo")
    assert (judgement.best, judgement.winner, judgement.comparisons, judgement.marked) == (
        "a",
        "",
        {},
        frozenset(),
    )
    assert judgement.unranked == {
        "late": "shows every frame one instant late",
        "b": "is partial: 1 of 2 views",
    }
    nothing = judge(without_labels(spoilt, ["a"]), "PSNR", True, "Demo")
    assert (nothing.best, nothing.comparisons, nothing.marked, nothing.winner) == (
        "",
        {},
        frozenset(),
        "",
    )


def test_unknown_names_are_refused(results):
    """A method, metric or data set that has no values is named."""
    with refused(ResultsError, "PSNR of x", "Demo", "a, b+fast, c"):
        compare(results, "PSNR", "a", "x", "Demo")
    assert judge_table(results, [Ranking("SSIM", higher_is_better=True)], "Demo").judgements == {}


METRICS = tuple(f"metric {at}" for at in range(7))


def make_equals(generator, labels, metrics, views, frames, correlation):
    """Methods that are equal but for correlated errors, in metrics whose errors have nothing in
    common.
    """
    rows = []
    for metric in metrics:
        shared = generator.standard_normal((views, 1))
        for label in labels:
            rows += make_rows(
                label, metric, shared + 0.3 * autoregressive(generator, views, frames, correlation)
            )
    return make_results(rows)


@pytest.mark.slow
@pytest.mark.parametrize(("frames", "correlation"), [(12, 0.9), (24, 0.0), (24, 0.8), (60, 0.95)])
def test_of_equal_methods_no_metric_of_a_table_has_a_winner(frames, correlation):
    """Two equal methods in seven metrics: the table or `compare` names a winner in 5 % of cases,
    and what chance adds.
    """
    generator, tables, winners = np.random.default_rng(frames), 50, 0
    rankings = [Ranking(metric, higher_is_better=True) for metric in METRICS]
    for _ in range(tables):
        results = make_equals(
            generator, "ab", METRICS, views=3, frames=frames, correlation=correlation
        )
        standings = judge_table(results, rankings, "Demo")
        pairs = standings.decide(Pair(metric, "a", "b") for metric in METRICS)
        called = {
            pair.metric
            for pair, comparison in pairs.items()
            if comparison.outcome in ("better", "worse")
        }
        assert called == {
            metric for metric, judgement in standings.judgements.items() if judgement.winner
        }
        winners += bool(called)
    assert winners <= 5


def test_a_table_is_one_family_and_what_it_says_stays():
    """A p value is corrected for all metrics and methods; a pair that the table has not compared is
    decided with all of it.
    """
    results = make_equals(
        np.random.default_rng(1), "abc", METRICS[:2], views=3, frames=24, correlation=0.5
    )
    standings = judge_table(
        results, [Ranking(metric, higher_is_better=True) for metric in METRICS[:2]], "Demo"
    )
    assert len(standings.family) == 4
    smallest = min(standings.family.values(), key=lambda comparison: comparison.p_value)
    assert smallest.corrected == min(1.0, 4 * smallest.p_value)
    best = standings.judgements[METRICS[0]].best
    first, second = (label for label in "abc" if label != best)
    known, turned, further = (
        Pair(METRICS[0], first, best),
        Pair(METRICS[0], best, first),
        Pair(METRICS[0], first, second),
    )
    decided = standings.decide([known, turned, further])
    assert decided[known] == standings.family[known] == decided[turned].reversed
    assert decided[further].corrected >= decided[further].p_value
