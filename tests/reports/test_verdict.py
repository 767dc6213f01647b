"""Who is best, in words and in a drawing: the first thing that the page says."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from ggvs_eval.protocol import Frames
from ggvs_eval.reports.model.measured import MeasuredRun, read_run
from ggvs_eval.reports.model.table import Cell, Row, Table
from ggvs_eval.reports.tables.error_budget import (
    CAUSES,
    budget_table,
    describe_absolute,
    describe_calibration,
    largest_cause,
)
from ggvs_eval.reports.tables.report_tables import main_tables
from ggvs_eval.reports.tables.verdict import Verdict, evaluate_verdict
from ggvs_eval.results import without_labels
from ggvs_eval.run_folder import read_json, write_json
from ggvs_eval.statistics.paired import compare
from helpers.run_folders import LABELS, NAMES, RunShape, write_run

SHAPE = RunShape(
    frames=Frames(0, 24), metrics=("SSIM", "PSNR", "LPIPS"), poses=0, width=16, height=16
)
WORST, MIDDLE, BEST = LABELS  # a baseline, a method of ours and its variant


@pytest.fixture(scope="module")
def measured_run(tmp_path_factory) -> MeasuredRun:
    """A run of three methods whose standing is clear; nobody changes it."""
    return read_run(write_run(tmp_path_factory.mktemp("verdict") / "run", SHAPE))


def verdict_of(
    run: MeasuredRun, edit: Callable[[pd.DataFrame], pd.DataFrame] = lambda table: table
) -> Verdict:
    """The verdict on a run whose table of values was edited."""
    results = replace(run.results, table=edit(run.results.table.copy()))
    run = replace(run, results=results)
    verdict = evaluate_verdict([run], results, main_tables([run], results))
    assert verdict is not None
    return verdict


def of(table: pd.DataFrame, label: str, metric: str = "PSNR") -> pd.Series:
    """Which rows are a method's values of a metric."""
    method, _, variant = label.partition("+")
    return (table["method"] == method) & (table["variant"] == variant) & (table["metric"] == metric)


def test_the_best_and_its_lead_with_the_paired_interval(measured_run):
    """The lead is the paired difference to the runner-up, with its interval; PSNR is the headline,
    listed first or not.
    """
    verdict = verdict_of(measured_run)
    difference = compare(measured_run.results, "PSNR", MIDDLE, WORST, "Demo room")
    assert verdict.column.name == "PSNR"
    assert verdict.headline == f"{NAMES[MIDDLE]} is best"
    numbers = [float(number) for number in re.findall(r"\d+\.\d+", verdict.margin)]
    assert numbers == pytest.approx(
        [difference.difference, difference.low, difference.high], abs=0.005
    )
    assert verdict.margin.startswith(
        f"{difference.difference:.2f} dB ahead of {NAMES[WORST]}, the next best "
        f"(95\N{NO-BREAK SPACE}% "
    )
    assert (verdict.others, verdict.tied) == ({NAMES[BEST]: ["SSIM", "LPIPS"]}, ())
    assert [one.label for one in verdict.contenders] == [MIDDLE, WORST]


def test_ablations_are_no_rivals(measured_run):
    """What each part is worth stands apart, as the paired difference to ours; ours alone compete
    with each other.
    """
    verdict = verdict_of(measured_run)
    (part,) = verdict.parts
    worth = compare(measured_run.results, "PSNR", BEST, MIDDLE, "Demo room")
    assert part.label == BEST
    assert [float(number) for number in re.findall(r"\d+\.\d+", part.worth)] == pytest.approx(
        [worth.difference, (worth.high - worth.low) / 2], abs=0.005
    )
    assert part.worth.startswith("+")

    alone = verdict_of(
        replace(measured_run, labels=LABELS[1:]), lambda table: table[~(table["method"] == WORST)]
    )
    assert [one.label for one in alone.contenders] == [BEST, MIDDLE]
    assert alone.parts == ()


def absolute_of(run: MeasuredRun, tables: list[Table], budgets: list[Table]) -> str:
    """What the page says of the first method's number."""
    verdict = evaluate_verdict([run], run.results, tables)
    best = verdict.contenders[0]
    return describe_absolute(best.name, best.cell, verdict.column, tables[0], budgets, [run])


def test_a_number_stands_beside_what_is_known(tmp_path):
    """The ceiling of the capture and the largest part of the error, which the shares give;
    published values of no other data.
    """
    measured = write_references(tmp_path / "run", {"PSNR": 40.5}, {"PSNR": 38.0})
    budget = budget_table(measured)
    tables = main_tables([measured], measured.results)
    absolute = absolute_of(measured, tables, [budget])
    assert "a perfect rendering without noise or codec would have 40.50 dB" in absolute
    assert "published" not in absolute
    row = next(row for row in budget.rows if row.name == NAMES[MIDDLE])
    assert [column.name for column in budget.columns[1:]] == [*CAUSES]
    *shares, rest = (cell.value or 0.0 for cell in row.cells[1:])
    said = largest_cause(NAMES[MIDDLE], [budget])
    assert (
        f"{max(shares):.0f} % of its squared error is "
        f"{[*CAUSES.values()][shares.index(max(shares))]}" in said
    )
    assert (f"{rest:.0f} % is unexplained" in said) == (rest > max(shares))
    assert largest_cause("nobody", [budget]) == largest_cause(NAMES[MIDDLE], []) == ""

    psnr = next(at for at, column in enumerate(tables[0].columns) if column.name == "PSNR")
    grey = [
        Row(name, (Cell("-"),) * psnr + (Cell(f"{db:.1f}", db),) + (Cell("-"),) * 2, "published")
        for name, db in (("a", 31.0), ("b", 29.5))
    ]
    beside = replace(tables[0], rows=(*tables[0].rows, *grey))
    absolute = absolute_of(measured, [beside], [])
    assert "published methods reach 29.5 to 31.0 dB on this data set" in absolute


def test_what_cameras_were_calibrated_from_is_stated(tmp_path):
    """Points and residual of the capture's calibration, as measured; without it no word."""
    run = read_run(write_run(tmp_path / "run", replace(SHAPE, frames=Frames(0, 4))))
    assert describe_calibration(run) == ""
    capture = tmp_path / "capture"
    write_json(capture / "calibration.json", {"n_points": 212, "mean_reprojection_error_px": 0.9})
    write_json(run.folder.root / "capture.json", run.capture | {"path": str(capture)})
    words = "The cameras were calibrated from 212 points, which leaves 0.90 px."
    assert describe_calibration(run) == words
    assert words in absolute_of(run, main_tables([run], run.results), [])


def test_a_tie_is_called_a_tie(measured_run):
    """Two methods whose values differ by noise about nothing tie; a name with a comma stands in
    quotation marks.
    """

    def tie(table: pd.DataFrame) -> pd.DataFrame:
        noise = np.random.default_rng(3).standard_normal(of(table, BEST).sum())
        table.loc[of(table, MIDDLE), "value"] = (
            table.loc[of(table, BEST), "value"].to_numpy() + noise - noise.mean() + 0.001
        )
        return table

    verdict = verdict_of(replace(measured_run, ours=frozenset()), tie)
    assert verdict.headline == f"{NAMES[MIDDLE]} and {NAMES[BEST]} tie"
    assert verdict.margin.startswith(
        f"0.00 dB between {NAMES[MIDDLE]} and “{NAMES[BEST]}” is not significant"
    )
    assert "interval −0." in verdict.margin
    assert verdict.others == {NAMES[BEST]: ["SSIM", "LPIPS"]}


def test_a_clip_too_short_for_its_correlation_has_no_winner(measured_run):
    """Where tables name nobody as the best, the verdict names nobody, and says why; metrics without
    a winner are told apart.
    """

    def wander(table: pd.DataFrame) -> pd.DataFrame:
        """Differences that drift over the whole clip are worth few frames."""
        for metric in SHAPE.metrics:
            own, other = of(table, MIDDLE, metric), of(table, WORST, metric)
            drift = np.tile(np.linspace(-1, 1.2, SHAPE.frames.count), len(SHAPE.views))
            table.loc[own, "value"] = table.loc[other, "value"].to_numpy() + drift
        return table

    verdict = verdict_of(measured_run, wander)
    assert f"{SHAPE.frames.count} frames of {len(SHAPE.views)} views" in verdict.headline
    assert "clip too short" in verdict.margin
    assert (verdict.others, verdict.tied) == ({}, ("SSIM", "LPIPS"))


def test_equal_numbers_are_equal(measured_run):
    """Methods that agree to the bit are equal, and nothing is estimated of their difference."""

    def copy(table: pd.DataFrame) -> pd.DataFrame:
        table.loc[of(table, MIDDLE), "value"] = table.loc[of(table, BEST), "value"].to_numpy()
        return table

    verdict = verdict_of(replace(measured_run, ours=frozenset()), copy)
    assert verdict.headline.endswith("are equal")
    assert verdict.margin.endswith("dB each.")


def test_one_frame_of_one_view_proves_nothing(tmp_path):
    """Where nothing can be resampled there is no winner; the words say how far the first is ahead
    and what is wanting.
    """
    shape = replace(SHAPE, frames=Frames(0, 1), views=("cam00",), metrics=("PSNR",))
    verdict = verdict_of(read_run(write_run(tmp_path / "run", shape)))
    assert verdict.headline == "No winner can be named from 1 frame of 1 view"
    assert re.match(rf"{re.escape(NAMES[MIDDLE])} is \d.* ahead of ", verdict.margin)
    assert verdict.margin.endswith("nothing could be compared (1 view; an interval needs 2).")
    assert all(one.span is None and one.place is not None for one in verdict.contenders)


def test_fewer_frames_name_no_more_winners(measured_run, tmp_path):
    """A clip cut to two frames, or to one, has no winner that the whole clip has not: what cannot
    be compared is not won.
    """
    whole = {NAMES[BEST]: ["SSIM", "LPIPS"]}  # an ablation, by the numbers of the table
    assert verdict_of(measured_run).others == whole
    for count in (1, 2):
        shape = replace(
            SHAPE, frames=Frames(0, count), metrics=(*SHAPE.metrics, "TCC", "STED", "SDT", "SDV")
        )
        cut = verdict_of(read_run(write_run(tmp_path / str(count), shape)))
        assert set(cut.others) <= set(whole)
        assert set(cut.others.get(NAMES[BEST], ())) <= {"SSIM", "LPIPS"}
        assert "STED" in cut.tied
        assert count > 1 or cut.others == {}


def test_one_method_alone_is_no_winner(tmp_path):
    """A single method is not called the best of anything; its value is told."""
    verdict = verdict_of(read_run(write_run(tmp_path / "run", replace(SHAPE, labels=(BEST,)))))
    assert verdict.headline == f"{NAMES[BEST]} is the only method measured"
    assert verdict.margin.endswith(" dB.")
    assert verdict.shown(replace(read_run(tmp_path / "run"))) == (BEST,)


def test_the_drawing_is_to_scale(measured_run):
    """Places are linear in the value, the best furthest to its better side, intervals around their
    values; infinity has none.
    """
    measured_run = replace(measured_run, ours=frozenset())
    verdict = verdict_of(measured_run)
    values = np.array([one.cell.value for one in verdict.contenders])
    places = np.array([one.place for one in verdict.contenders])
    assert np.diff(places)[0] / np.diff(places)[1] == pytest.approx(
        np.diff(values)[0] / np.diff(values)[1], abs=0.01
    )
    assert all(0 <= one.span[0] <= one.place <= one.span[1] <= 100 for one in verdict.contenders)

    def perfect(table: pd.DataFrame) -> pd.DataFrame:
        table.loc[of(table, WORST), "value"] = np.inf
        return table

    verdict = verdict_of(measured_run, perfect)
    assert (
        verdict.contenders[0].label,
        verdict.contenders[0].place,
        verdict.contenders[0].cell.text,
    ) == (WORST, None, "∞")


def test_ours_stands_beside_a_better_method(measured_run):
    """Shown are the best and the runner-up; where the best is not ours, ours; never a method
    without pictures.
    """
    assert verdict_of(measured_run).shown(measured_run) == (MIDDLE, WORST)

    def baseline_wins(table: pd.DataFrame) -> pd.DataFrame:
        table.loc[of(table, WORST), "value"] += 100.0
        return table

    verdict = verdict_of(measured_run, baseline_wins)
    assert verdict.shown(replace(measured_run, ours=frozenset({MIDDLE}))) == (WORST, MIDDLE)
    assert verdict.shown(replace(measured_run, ours=frozenset())) == (WORST, MIDDLE)
    assert verdict.shown(replace(measured_run, labels=(MIDDLE,))) == (MIDDLE,)


def test_where_nothing_is_ranked_the_verdict_says_what_happened_and_what_to_do(measured_run):
    """Without tables nothing was measured; of faulty and partial methods each is named, with the
    first step out.
    """
    nothing = evaluate_verdict([measured_run], measured_run.results, ())
    assert (nothing.headline, nothing.contenders) == (
        "Nothing is ranked: no metric was measured; score the run",
        (),
    )
    measured = replace(measured_run, labels=(WORST, MIDDLE))
    fault = [
        WORST,
        "room",
        "cam00",
        "frame offset",
        "certain",
        "frame t shows instant t-1: by motion",
        "renumber the frames by -1: b",
        "late",
    ]
    marks = {"faults": [fault], "partial": {MIDDLE: "partial in room: 1 of 2 views"}}
    own = without_labels(measured.results, [BEST])
    results = replace(own, provenance=own.provenance | marks)
    measured = replace(measured, results=results)
    verdict = evaluate_verdict([measured], results, main_tables([measured], results))
    assert verdict.headline == (
        f"Nothing is ranked: {NAMES[WORST]} shows every frame one instant late; {NAMES[MIDDLE]} is "
        f"partial in room: 1 of 2 views"
    )
    assert (
        verdict.margin
        == f"{NAMES[WORST]}: renumber the frames by -1. {NAMES[MIDDLE]}: render the missing frames "
        f"and score again."
    )


def write_references(root: Path, *values: dict[str, float | str]) -> MeasuredRun:
    """A run with noise ceilings of these values."""
    run = write_run(root, replace(SHAPE, frames=Frames(0, 4)))
    names = ("Ceiling: perfect", "Ceiling: second")
    entries = [
        {"group": "quality", "name": name, "note": f"{name}.", "values": one}
        for name, one in zip(names, values, strict=True)
    ]
    write_json(run / "references.json", entries)
    return read_run(run)


def test_a_ceiling_that_cannot_be_computed_is_one_line(tmp_path):
    """Two ceilings without a number are no rows; what they lack stands once below the table. With
    numbers they are rows.
    """
    lacking = {"PSNR": "cam00: 6 frames, wanted 8", "SSIM": "cam00: 6 frames, wanted 8"}
    run = write_references(tmp_path / "lacking", lacking, lacking)
    (table,) = main_tables([run], run.results)
    assert not [row for row in table.rows if row.kind == "reference"]
    assert " ".join(table.notes).count("6 frames, wanted 8") == 1
    assert (
        "Not computed for SSIM, PSNR: Ceiling: perfect, Ceiling: second (cam00: 6 frames, wanted "
        "8)." in table.notes
    )
    run = write_references(
        tmp_path / "partly", {"PSNR": 50.0, "SSIM": "no"}, {"PSNR": 40.0, "SSIM": "no"}
    )
    (table,) = main_tables([run], run.results)
    rows = [row for row in table.rows if row.kind == "reference"]
    assert [[cell.text for cell in row.cells] for row in rows] == [
        ["not computed", "50.00", "–"],
        ["not computed", "40.00", "–"],
    ]
    assert (
        "Ceiling: perfect: Ceiling: perfect. Ceiling: second: Ceiling: second. Not computed for "
        "SSIM: " in " ".join(table.notes)
    )


def test_a_ceiling_that_is_a_bound_says_so(tmp_path):
    """Behind a codec a perfect rendering scores at most so much; the cell says it, and the other
    row stays an estimate.
    """
    run = write_references(
        tmp_path / "bounded", {"PSNR": 40.5, "SSIM": 0.98}, {"PSNR": 40.0, "SSIM": 0.97}
    ).folder.root
    entries = read_json(run / "references.json")
    entries[0]["bounds"] = {"PSNR": "at most"}
    write_json(run / "references.json", entries)
    measured = read_run(run)
    (table,) = main_tables([measured], measured.results)
    rows = [[cell.shown for cell in row.cells] for row in table.rows if row.kind == "reference"]
    assert rows == [["0.980", "at most 40.50", "–"], ["0.970", "40.00", "–"]]
