"""`ggvs-eval compare`: planted differences are found, chance is not taken for one, and what does
not compare is refused.
"""

import csv
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.protocol import Frames
from ggvs_eval.reports.model.measured import METHODS_FILE, read_scores
from ggvs_eval.reports.tables.compare_runs import differences, method_sides, run_sides
from ggvs_eval.reports.tables.verdict import judge_runs
from ggvs_eval.results import Results
from ggvs_eval.run_folder import read_json, write_json
from ggvs_eval.statistics.paired import Pair, compare, decide
from helpers.command_line import refusal
from helpers.run_folders import RunShape, write_run

SHAPE = RunShape(
    tuple(f"cam{view:02}" for view in range(6)),
    Frames(0, 32),
    16,
    16,
    0,
    metrics=("PSNR", "SSIM", "L1"),
)
BETTER_DB = 0.5


def write_values(
    root: Path, better_db: float = 0.0, seed: int = 0, shape: RunShape = SHAPE
) -> Path:
    """A run in which views differ by decibels, frames by noise; `seed` moves the noise, `better_db`
    the PSNR of all methods.
    """
    write_run(root, shape, lambda label, view, index: np.full((16, 16, 3), 90, np.uint8))
    found, own = Results.read(root), np.random.default_rng(seed)
    view = found.table["view"].str.slice(3).astype(int).to_numpy()
    noise = own.standard_normal(len(found.table))
    psnr = found.table["metric"].to_numpy() == "PSNR"
    values = np.where(
        psnr, 28.0 + 1.5 * view + better_db + 0.1 * noise, 0.5 + 0.01 * view + 0.001 * noise
    )
    Results(found.table.assign(value=values), found.provenance, found.not_computed).write(root)
    return root


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> dict[str, Path]:
    """A run, the same again under other noise, one that is better, and one of another protocol;
    nobody changes them.
    """
    root = tmp_path_factory.mktemp("compare")
    other = replace(SHAPE, frames=Frames(0, 31))
    return {
        "plain": write_values(root / "plain"),
        "again": write_values(root / "again", seed=1),
        "better": write_values(root / "better", BETTER_DB, seed=2),
        "other": write_values(root / "other", shape=other),
    }


def test_a_planted_difference_is_significant_in_the_mean_and_in_each_view(runs):
    """Half a decibel under a tenth of noise is told from chance, in all views together and in each
    of the six.
    """
    (one, other), *rest = run_sides(runs["plain"], runs["better"])
    assert len(rest) == 2
    psnr = [found for found in differences(one, other, runs["plain"]) if found.metric == "PSNR"]
    assert [found.view for found in psnr] == ["", *SHAPE.views]
    for found in psnr:
        assert found.comparison.difference == pytest.approx(-BETTER_DB, abs=0.15)
        assert found.comparison.low <= -BETTER_DB + 0.1
        assert found.comparison.high < 0.0
        assert (found.is_significant, found.verdict) == (True, "second better")


def test_chance_is_not_taken_for_a_difference(runs):
    """Two runs that differ by noise alone cannot be told apart, in whatever metric."""
    one, other = run_sides(runs["plain"], runs["again"])[0]
    whole = [found for found in differences(one, other, runs["plain"]) if not found.view]
    assert [found.metric for found in whole] == ["PSNR", "SSIM", "L1"]
    assert {found.verdict for found in whole} == {"not significantly different"}
    itself = run_sides(runs["plain"], runs["plain"])[0]
    assert {row.verdict for row in differences(*itself, runs["plain"])} == {"equal"}


def test_methods_of_one_run_are_compared_by_the_statistics_package(runs):
    """Difference, bounds and p value are those of `statistics.paired.compare`; what its table has
    decided stays so.
    """
    labels = ("no-blending", "ours-geometric+no-temporal")
    rows = [
        row
        for row in differences(*method_sides(runs["plain"], *labels), runs["plain"])
        if not row.view
    ]
    measured = read_scores(runs["plain"])
    (standings,) = judge_runs([measured], measured.results).values()
    decided = standings.decide(Pair(row.metric, *labels) for row in rows)
    for row in rows:
        undecided = replace(row.comparison, corrected=None, short="", outcome="untested")
        better_when = row.note.higher_is_better
        assert undecided == compare(
            measured.results, row.metric, *labels, "Demo room", higher_is_better=better_when
        )
        pair = Pair(row.metric, *labels)
        assert row.comparison == decided[pair]
        assert row.comparison.corrected >= min(1.0, len(rows) * row.comparison.p_value)
        for best in {pair.first, pair.second} & {standings.judgements[row.metric].best}:
            against = standings.judgements[row.metric].comparisons[
                ({pair.first, pair.second} - {best}).pop()
            ]
            assert row.comparison in (against, against.reversed)


def test_two_methods_behind_the_best_are_judged_over_all_their_metrics(tmp_path):
    """Where a third method is best by far, the p values of the two others are corrected for each
    other's metrics too.
    """
    run = write_values(tmp_path / "run")
    write_json(run / METHODS_FILE, read_json(run / METHODS_FILE) | {"ours": []})
    results = Results.read(run)
    is_best = results.table["method"] == "no-blending"
    direction = np.where(results.table["metric"] == "L1", -1.0, 1.0)
    values = np.where(is_best, results.table["value"] + 0.4 * direction, results.table["value"])
    Results(results.table.assign(value=values), results.provenance, results.not_computed).write(run)
    rows = differences(*method_sides(run, "ours-geometric", "ours-geometric+no-temporal"), run)
    means = [row.comparison for row in rows if not row.view]
    smallest = min(means, key=lambda comparison: comparison.p_value)
    assert len(means) == 3
    assert smallest.corrected >= min(1.0, 3 * smallest.p_value)


def test_direction_is_the_metrics(runs):
    """Of two methods the one with less L1 is better, and the one with more PSNR."""
    for metric, better in (("PSNR", "first better"), ("L1", "second better")):
        (one, other), *_ = run_sides(runs["better"], runs["plain"])
        whole = next(
            found
            for found in differences(one, other, runs["plain"])
            if found.metric == metric and not found.view
        )
        comparison = replace(whole.comparison, difference=1.0, p_value=0.001)
        decided = decide({"": comparison})[""]
        assert replace(whole, comparison=decided).verdict == better


def test_one_frame_gives_a_difference_without_significance(tmp_path):
    """A single frame has a difference, no interval, and the verdict says why it was not tested."""
    run = write_values(
        tmp_path / "run", shape=replace(SHAPE, frames=Frames(0, 1), metrics=("PSNR",))
    )
    found = differences(*method_sides(run, "no-blending", "ours-geometric"), run)
    assert all(
        one.comparison.corrected is None and not one.is_significant for one in found if one.view
    )
    assert "not tested: 1 frame; an interval needs 2" in found[1].verdict


def test_other_captured_frames_are_refused(runs, tmp_path):
    """Runs of different captured frames or protocols do not compare; the line names both hashes and
    what differs.
    """
    other = write_values(tmp_path / "other")
    found = Results.read(other)
    Results(found.table, found.provenance | {"inputs": {"room/cam00": "cd34"}}).write(other)
    assert "not of the same captured frames: room/cam00" in refusal("compare", runs["plain"], other)
    line = refusal("compare", runs["plain"], runs["other"])
    assert "different protocols" in line
    assert "frames.count 32 and 31" in line
    for run in ("plain", "other"):
        assert Results.read(runs[run]).provenance["protocol_sha256"][:12] in line


def test_what_is_not_there_is_refused(runs):
    """A label without a run, an unknown label, and a method against itself say what was wanted."""
    assert "add --run RUN" in refusal("compare", "ours", "no-blending")
    line = refusal("compare", "nobody", "no-blending", "--run", runs["plain"])
    assert "no values of method 'nobody'; it has no-blending, ours-geometric" in line
    assert "wanted two methods" in refusal(
        "compare", "no-blending", "no-blending", "--run", runs["plain"]
    )


@pytest.mark.slow
def test_command_line_tells_what_differs(runs, tmp_path, capsys):
    """The table has a line per metric, the CSV one per view besides, unrounded; equal versions are
    not worth a line.
    """
    run_command(
        [
            "compare",
            str(runs["plain"]),
            str(runs["better"]),
            "--csv",
            str(tmp_path / "out" / "d.csv"),
        ]
    )
    printed = capsys.readouterr().out
    assert printed.count("PSNR (dB)") == 3
    assert printed.count("second better") == 3
    assert "version of" not in printed
    lines = list(csv.DictReader((tmp_path / "out" / "d.csv").open(encoding="utf-8")))
    assert len(lines) == 3 * 3 * (1 + 6)
    for line in lines:
        assert float(line["difference"]) == pytest.approx(
            float(line["first"]) - float(line["second"]), abs=1e-9
        )
        assert (line["significant"] == "True") == (
            float(line["p_value"]) < 0.05 and "too short" not in line["verdict"]
        )


@pytest.mark.slow
def test_renders_are_compared_as_score_takes_them(tmp_path, capsys, monkeypatch):
    """Two folders of renders and their capture need no run: the difference is that of their
    scores.
    """
    monkeypatch.chdir(tmp_path)
    run_command(["demo", "quick", "--quick"])
    terms = Path("quick/quick.toml").read_text(encoding="utf-8")
    terms = re.sub(r"metrics = \[[^\]]*\]", 'metrics = ["PSNR"]', terms)
    terms = re.sub(r"test = \[[^\]]*\]", 'test = ["cam00"]', terms)
    Path("psnr.toml").write_text(terms, encoding="utf-8")
    capsys.readouterr()
    run_command(
        [
            "compare",
            "quick/fixed",
            "quick/late",
            "--capture",
            "quick/room",
            "--protocol",
            "psnr.toml",
        ]
    )
    printed = capsys.readouterr().out
    assert re.search(r"PSNR \(dB\) +all +31\.92 +27\.91 +\+4\.01", printed)
    assert (
        "late shows every frame one instant late" in printed
        or "second shows every frame one instant late" in printed
    )
    assert not Path("scores").exists()


def test_one_capture_in_folders_of_two_names_compares(tmp_path):
    """A scene is what was captured, not what its folder is called: equal frames under two names are
    the same scene.
    """
    shape = replace(SHAPE, content="equal", metrics=("PSNR",))
    one = write_values(tmp_path / "one", shape=shape)
    other = write_values(tmp_path / "other", BETTER_DB, seed=2, shape=replace(shape, scene="moved"))
    (pair, *_) = run_sides(one, other)
    (whole,) = [each for each in differences(*pair, one) if each.metric == "PSNR" and not each.view]
    assert whole.comparison.difference == pytest.approx(-BETTER_DB, abs=0.05)
    assert whole.verdict == "second better"
