"""A method's number by itself: ceiling, published values of the same data, what it was made from, and where its error lies."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ggvs_eval.depth_store import CONFIDENCE_STEPS, DepthStore
from ggvs_eval.files.images import read_image
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.model.table import Cell, Column, Table
from ggvs_eval.reports.tables.error_budget import BUDGET_KEY
from ggvs_eval.run_folder import frame_path, missing_frames, read_json

CAUSES = {
    "unseen": "places that no source camera sees",
    "colour": "colour and light, which a smooth colour map would remove: cameras that differ",
    "wrong surface": "wrong surfaces: what is missing, or stands in place of something else",
    "misplaced": "in the wrong place, by wrong depth, poses or motion",
    "detail": "detail: blur, noise, and small things that belong elsewhere",
}
GRADES = ("good", "fair", "poor")


class Condition(NamedTuple):
    """One thing that limits every method: its value, the values from which it is fair and poor, and the words for it."""

    value: float
    fair: float
    poor: float
    words: str

    @property
    def grade(self) -> int:
        """Place in `GRADES`."""
        return int(self.value > self.fair) + int(self.value > self.poor)


def describe_absolute(
    name: str, cell: Cell, column: Column, table: Table, budgets: Sequence[Table], runs: Sequence[MeasuredRun] = ()
) -> str:
    """A few sentences on a method's number by itself; empty where there is nothing to hold it against.

    Args:
        table: the main table, whose grey rows have the ceilings of the capture and values published of the same data set.
        budgets: error budgets of the group's runs; the cause is of the first.
        runs: of the group; what they were made from is that of the first of which it is known.

    Reading:
        Published values of other captures say nothing of this one, so only those count that stand in the table. The largest of
        the parts of the squared error is named as the cause.
    """
    unit, at = f" {column.unit}" if column.unit else "", table.columns.index(column)
    beside = []
    ceilings = [row.cells[at].shown for row in table.rows if row.kind == "reference" and row.cells[at].value is not None]
    if ceilings:
        beside.append(f"a perfect rendering would have {ceilings[0]}{unit} on this capture")
    published = [row.cells[at] for row in table.rows if row.kind == "published" and row.cells[at].value is not None]
    if published:
        low, high = (end(published, key=lambda one: one.value or 0.0).shown for end in (min, max))
        beside.append(f"published methods have {low}{f' to {high}' if high != low else ''}{unit} on this data set")
    sentences = [f"{name} has {cell.shown}{unit}; {', and '.join(beside)}."] if beside else []
    conditions = next(filter(None, map(describe_conditions, runs)), "")
    return " ".join(filter(None, [*sentences, conditions, largest_cause(name, budgets)]))


def describe_conditions(run: MeasuredRun) -> str:
    """Say in a word what a run's pictures could be made from, and why; empty where none of it was measured."""
    known = _conditions(run)
    if not known:
        return ""
    worst = max(one.grade for one in known)
    reasons = [one.words for one in known if one.grade == worst]
    return f"Depth and cameras are {GRADES[worst]}: {'; '.join(reasons)}."


def _conditions(run: MeasuredRun) -> list[Condition]:
    """Agreement of depth between cameras, calibration residual and coverage, as far as the run has them."""
    found = []
    if agreeing := _agreeing_shares(run):
        apart = 1.0 - float(np.mean(agreeing))
        found.append(
            Condition(apart, 0.1, 0.25, f"{100 * apart:.0f} % of the pixels have no depth that the other cameras confirm")
        )
    file = run.folder.capture_path() / "calibration.json" if "path" in run.capture else None
    calibration = read_json(file) if file and file.is_file() else {}
    if points := calibration.get("n_points"):
        off_px = calibration["mean_reprojection_error_px"]
        found.append(Condition(off_px, 0.8, 1.5, f"the calibration leaves {off_px:.2f} px"))
        found.append(Condition(-points, -1000, -300, f"the cameras were calibrated from {points} points"))
    first = run.frames[:1]
    folders = [run.folder.disoccluded(view) for view in run.protocol.views.test]
    masks = [read_image(frame_path(folder, first[0])) > 0 for folder in folders if not missing_frames(folder, first)]
    if masks:
        unseen = float(np.mean([mask.mean() for mask in masks]))
        found.append(Condition(unseen, 0.05, 0.15, f"{100 * unseen:.0f} % of the test views are seen by no source camera"))
    return found


def _agreeing_shares(run: MeasuredRun) -> list[float]:
    """Share of pixels of each stored depth map of the first instant that was checked against other cameras and has held."""
    shares, store = [], DepthStore(run.folder.depth)
    for spec in map(read_json, sorted(run.folder.depth.glob("*/spec.json"))):
        if "check" in spec and store.has(spec["key"], run.frames[0]):
            confidence = store.read(spec["key"], run.frames[0]).confidence
            filled = spec["options"].get("filled_confidence", 0.0) + 0.5 / CONFIDENCE_STEPS  # which is stored in 8 bit
            shares.append(float((confidence > filled).mean()))
    return shares


def largest_cause(name: str, budgets: Sequence[Table]) -> str:
    """The largest part of a method's squared error, in words; empty where no error was taken apart."""
    rows = [(budget, row) for budget in budgets if budget.key == BUDGET_KEY for row in budget.rows if row.name == name]
    if not rows:
        return ""
    budget, row = rows[0]
    parts = zip(budget.columns, row.cells, strict=True)
    shares = {column.name: cell.value for column, cell in parts if column.name in CAUSES and cell.value}
    if not shares:
        return ""
    largest = max(shares, key=lambda part: shares[part] or 0.0)
    return f"{shares[largest]:.0f} % of its squared error is {CAUSES[largest]}."
