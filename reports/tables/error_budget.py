"""Error of each method alone: over views or over time; unseen, in colour, of wrong surfaces, misplaced, or in detail.

A method's number alone has a ceiling, published values of the same data, its training data, and the sources of its error.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial, reduce
from typing import NamedTuple

import cv2
import numpy as np

from ggvs_eval.arrays import Array, Array32, Image8, Map, Mask
from ggvs_eval.depth_store import CONFIDENCE_STEPS, DepthStore
from ggvs_eval.errors import ResultsError
from ggvs_eval.files.images import read_image
from ggvs_eval.jobs.processes import in_threads
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.model.table import Cell, Column, Row, Table
from ggvs_eval.reports.section import RUNS_KEPT, Report, SectionContent, tables_of_runs
from ggvs_eval.results import split_label
from ggvs_eval.run_folder import JOB_FILE, frame_path, missing_frames, read_json
from ggvs_eval.statistics.decomposition import TwoWay, decompose_metric

METRIC = "L1"
UNIT = "grey levels of 255"
VARIANCE_CAPTION = (
    "L1 of every view and frame decomposed: mean + view effect + time effect + rest; shares of the variance about the mean. "
    "SDT contains time and rest, SDV views and rest."
)
VARIANCE_COLUMNS: tuple[tuple[Column, str, Callable[[TwoWay], float]], ...] = (
    (Column("mean L1", UNIT, False), "{:.2f}", lambda parts: parts.mean),
    (Column("views", "%"), "{:.1f}", lambda parts: 100 * parts.shares()["view"]),
    (Column("time", "%"), "{:.1f}", lambda parts: 100 * parts.shares()["time"]),
    (Column("rest", "%"), "{:.1f}", lambda parts: 100 * parts.shares()["rest"]),
)
WIDE_SHARE = 0.03  # of the width: standard deviation of the Gaussian that separates wrong surfaces from detail
FITTED_WIDTH = 160  # pixels of the pictures that the colour map is fitted to
ROUNDS = 12  # of the fit, each with weights by the errors of the one before
LEAST_ERROR_255 = 0.5  # in those weights
SMOOTH_PX = 3.0  # blur before the fit: a gain that takes noise or texture away is no colour
MOVED_WIDTHS = (320, 640)  # pixels of the pictures whose windows are moved: large moves, and those of a pixel or two
MOVES = (-3, -2, -1, 0, 1, 2, 3)  # pixels of them, across and down
WINDOW = 7  # pixels of them
MOST_LEFT = 0.5  # of a window's error, where moving it explains it
BUDGET_KEY = "error_budget"  # of the table
FRAMES_AT_MOST = 4  # of each view, evenly spaced
CAPTION = (
    "Mean squared error of single frames, decomposed. Unseen: pixels that no source view covers, which methods must invent. "
    "Colour: error that a smooth colour map of the image removes (gain, offset, linear and quadratic terms, per "
    "channel), due to camera differences. Wrong surface: further error removed by subtracting the mean over "
    f"{100 * WIDE_SHARE:.0f} % of the width: missing or replaced content. "
    "Misplaced: error removed if windows of 2 % of the width move by up to 1 %, or of 1 % by .5 %, where that halves "
    "their error: edges in the wrong place, by wrong depth, poses or motion. Detail: the rest: blur, noise, small "
    "misplaced objects."
)
COLUMNS = (
    Column("squared error", "grey levels² of 255", higher_is_better=False),
    Column("unseen", "%"),
    Column("colour", "%"),
    Column("wrong surface", "%"),
    Column("misplaced", "%"),
    Column("detail", "%"),
)
NOT_TOLD = Cell("not measured", note="add PSNR_disoccluded to the protocol's metrics")
CAUSES = {
    "unseen": "areas that no source camera sees",
    "colour": "colour and exposure, which a smooth colour map would remove",
    "wrong surface": "wrong surfaces: missing or replaced content",
    "misplaced": "misplaced content, by wrong depth, poses or motion",
    "detail": "detail: blur, noise, and small misplaced objects",
}
GRADES = ("good", "fair", "poor")


def decomposition_table(run: MeasuredRun) -> Table | None:
    """Return the table of one run; None if it has a single view or frame, or no L1."""
    if run.protocol.frames.count < 2 or len(run.protocol.views.test) < 2 or METRIC not in set(run.results.table["metric"]):
        return None
    rows = [run.row(label, _variance_cells(run, label)) for label in run.labels]
    columns = tuple(column for column, _, _ in VARIANCE_COLUMNS)
    return Table("decomposition", "Variation of the error", VARIANCE_CAPTION, columns, tuple(rows), run.scene)


def _variance_cells(run: MeasuredRun, label: str) -> tuple[Cell, ...]:
    try:
        parts = decompose_metric(run.results, METRIC, run.scene, *split_label(label), run.protocol.dataset)
    except ResultsError as error:
        return tuple(Cell(f"not computed: {error}") for _ in VARIANCE_COLUMNS)
    return tuple(Cell(text.format(value(parts)), value(parts)) for _, text, value in VARIANCE_COLUMNS)


@dataclass(frozen=True)
class ErrorBudget:
    """Parts of a mean squared error, grey levels² of 255; they add up to it.

    Attributes:
        unseen: of pixels that no source view covers; None where these are not known, and counted with the others.
        colour: error of the other pixels that a smooth colour map of the image removes.
        surface: further error that removing the wide error removes.
        misplaced: further error that moving small windows removes.
        detail: of the other pixels, what all three would leave.
    """

    unseen: float | None
    colour: float
    surface: float
    misplaced: float
    detail: float

    @property
    def total(self) -> float:
        """The mean squared error."""
        return (self.unseen or 0.0) + self.colour + self.surface + self.misplaced + self.detail


def error_budget(image: Image8, truth: Image8, unseen: Mask | None) -> ErrorBudget:
    """Decompose the squared error of an image.

    Args:
        image: synthesised, (H, W, 3).
        truth: (H, W, 3).
        unseen: true where no source view covers the pixel, (H, W); None if that is not known.

    Reading:
        Only what one smooth map explains is called colour: a body that is missing is as wide as a camera's other white balance.
        The map is fitted by least absolute errors, so that such a body does not bend it. The wide error of a wrong surface is the
        Gaussian mean of the difference over the seen pixels alone. Taking it off leaves less of the squared error, unless there
        is next to nothing to take. A best move is found for any error, so that moves count only where they halve it: a texture in
        the wrong place is explained to 90 %, blur to 3 %, noise not at all. Moves are sought in pictures of 320 and of 640
        columns, and the size that explains more counts. It is a lower bound: of the error that depth 2 to 10 % wrong adds to
        rooms rendered at 640x480 they explain 44 to 73 % (320 columns alone 20 to 53 %), of the error that blur adds nothing.
    """
    coverage = np.ones(truth.shape[:2], np.float32) if unseen is None else (~unseen).astype(np.float32)
    squared = np.square(image.astype(np.float32) - truth).mean(axis=2, dtype=np.float64)
    hidden = None if unseen is None else float((squared * unseen).mean())
    shown = float((squared * coverage).mean())
    mapped = smooth_colour_map(image, truth, coverage)
    recoloured = float((np.square(mapped - truth).mean(axis=2, dtype=np.float64) * coverage).mean())
    if recoloured >= shown:
        mapped, recoloured = image.astype(np.float32), shown
    difference = mapped - truth
    sigma = WIDE_SHARE * truth.shape[1]
    blurred = (
        cv2.GaussianBlur(values, (0, 0), sigma, borderType=cv2.BORDER_REFLECT)
        for values in (difference * coverage[..., None], coverage)
    )
    mean = next(blurred) / np.maximum(next(blurred), np.float32(1e-6))[..., None]
    fine = float((np.square(difference - mean).mean(axis=2, dtype=np.float64) * coverage).mean())
    widths = {min(width, truth.shape[1]) for width in MOVED_WIDTHS}
    misplaced = min(max(_misplaced(mapped - mean, truth, coverage, width) for width in widths), fine)
    return ErrorBudget(hidden, shown - recoloured, recoloured - fine, misplaced, fine - misplaced)


def smooth_colour_map(image: Image8, truth: Image8, coverage: Map) -> Array32:
    """Map an image to the colours of another by a gain, an offset and a quadratic over the picture in each channel.

    Args:
        image: (H, W, 3).
        truth: (H, W, 3).
        coverage: weight of each pixel in the fit, (H, W).

    Returns:
        (H, W, 3), grey levels; the map of least absolute errors, which a wrong part of the picture does not bend.
    """
    scale = min(1.0, FITTED_WIDTH / truth.shape[1])
    size = (max(1, round(scale * truth.shape[1])), max(1, round(scale * truth.shape[0])))
    small, target, weight = (
        cv2.GaussianBlur(cv2.resize(values.astype(np.float32), size, interpolation=cv2.INTER_AREA), (0, 0), SMOOTH_PX)
        for values in (image, truth, coverage)
    )
    places, whole = _quadratics(size), _quadratics(truth.shape[1::-1])
    mapped = image.astype(np.float32)
    for channel in range(truth.shape[2]):
        levels = small[..., channel].ravel().astype(np.float64)
        design = np.concatenate([levels[:, None] - levels.mean(), places], axis=1)
        values, weights = target[..., channel].ravel() - levels, weight.ravel().astype(np.float64)
        change = np.zeros(design.shape[1])
        for _ in range(ROUNDS):
            weighted = design.T * (weights / np.maximum(np.abs(design @ change - values), LEAST_ERROR_255))
            change = np.linalg.lstsq(weighted @ design, weighted @ values, rcond=1e-6)[0]
        field = (whole @ change[1:]).reshape(truth.shape[:2])
        mapped[..., channel] += (change[0] * (mapped[..., channel] - levels.mean()) + field).astype(np.float32)
    return mapped


@lru_cache(maxsize=4)
def _quadratics(size: tuple[int, int]) -> Array:
    """Monomials up to the second degree at each pixel of a picture of (W, H), (W H, 6), places from -1 to 1."""
    x, y = np.meshgrid(*(np.linspace(-1, 1, count) for count in size))
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1).reshape(-1, 6)


def _misplaced(image: Array32, truth: Image8, coverage: Map, width: int) -> float:
    """Return the mean squared error that goes where windows of an image move, and the move halves the window's error.

    Args:
        image: without its wide error, (H, W, 3).
        coverage: 1 if a source sees the pixel, (H, W).
        width: columns of the pictures that it is sought in.
    """
    size = width, max(1, round(width / truth.shape[1] * truth.shape[0]))
    image, reference, counted = (
        cv2.resize(values.astype(np.float32), size, interpolation=cv2.INTER_AREA) for values in (image, truth, coverage)
    )
    counted /= 3  # channels
    reach = max(MOVES)
    wider = cv2.copyMakeBorder(image, reach, reach, reach, reach, cv2.BORDER_REFLECT)
    planes, wanted = (np.ascontiguousarray(np.moveaxis(values, 2, 0)) for values in (wider, reference))  # (3, H, W), summed fast
    apart = np.empty_like(wanted)  # kept, as to clear new memory takes longer than the sums

    def left_after(across: int, down: int) -> Map:
        moved = planes[:, reach + down : reach + down + size[1], reach + across : reach + across + size[0]]
        np.square(np.subtract(moved, wanted, out=apart), out=apart)
        error = apart.sum(axis=0) * counted
        return np.asarray(cv2.boxFilter(error, -1, (WINDOW, WINDOW), borderType=cv2.BORDER_REFLECT), np.float32)

    here = left_after(0, 0)
    best = reduce(np.minimum, (left_after(across, down) for across in MOVES for down in MOVES))
    return float(np.where(best < MOST_LEFT * here, here - best, 0.0).mean())


@lru_cache(maxsize=RUNS_KEPT)
def budget_table(run: MeasuredRun) -> Table | None:
    """Return a row per method, and one per view of the one that the page shows first; None if there are no pictures."""
    if not run.pictured:
        return None
    shown = run.ours_first[0]
    frames = run.frames[:: math.ceil(len(run.frames) / FRAMES_AT_MOST)]
    instants = [(view, frame) for view in run.protocol.views.test for frame in frames]
    budgets = dict(zip(instants, in_threads(partial(_budgets, run), instants), strict=True))
    rows = [run.row(label, _share_cells([one[label] for one in budgets.values()])) for label in run.pictured]
    for view in run.protocol.views.test:
        rows.append(Row(f"{run.name(shown)} in {view}", _share_cells([budgets[view, frame][shown] for frame in frames])))
    below = (f"Unseen is not measured: {NOT_TOLD.note}.",) * any(NOT_TOLD in row.cells for row in rows)
    return Table(BUDGET_KEY, "Sources of the error", CAPTION, COLUMNS, tuple(rows), run.title, below)


def _budgets(run: MeasuredRun, instant: tuple[str, int]) -> dict[str, ErrorBudget]:
    """Return label -> budget of one frame of one view."""
    view, frame = instant
    folders, masks = run.frame_folders(view), run.folder.disoccluded(view)
    truth = read_image(frame_path(folders.pop("truth"), frame))
    is_told = not missing_frames(masks, range(frame, frame + 1))
    unseen = read_image(frame_path(masks, frame))[..., 0] > 0 if is_told else None
    return {label: error_budget(read_image(frame_path(folder, frame)), truth, unseen) for label, folder in folders.items()}


def _share_cells(budgets: Sequence[ErrorBudget]) -> tuple[Cell, ...]:
    """Return the mean of the squared errors, and shares of it."""
    total = float(np.mean([each.total for each in budgets]))
    told = [each.unseen for each in budgets if each.unseen is not None]
    unseen = _share(float(np.mean(told)), total) if len(told) == len(budgets) else NOT_TOLD
    parts = (float(np.mean([getattr(each, part) for each in budgets])) for part in ("colour", "surface", "misplaced", "detail"))
    return Cell(f"{total:.1f}", total), unseen, *(_share(part, total) for part in parts)


def _share(part: float, total: float) -> Cell:
    percent = 100 * part / total if total else 0.0
    return Cell(f"{percent:.1f}", percent)


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
    """Return a few sentences on a method's number alone; empty if there is nothing to compare with.

    Args:
        table: the main table, whose grey rows have the ceilings of the capture and values published of the same data set.
        budgets: error budgets of the group's runs; the cause is of the first.
        runs: of the group; what they were made from is that of the first of which it is known.

    Reading:
        Published values of other captures say nothing of this one, so only those in the table count. The largest of
        the parts of the squared error is named as the cause.
    """
    unit, at = f" {column.unit}" if column.unit else "", table.columns.index(column)
    beside = []
    ceilings = [row.cells[at].shown for row in table.rows if row.kind == "reference" and row.cells[at].value is not None]
    if ceilings:
        beside.append(f"a perfect rendering without noise or codec would have {ceilings[0]}{unit} on this capture")
    published = [row.cells[at] for row in table.rows if row.kind == "published" and row.cells[at].value is not None]
    if published:
        low, high = (end(published, key=lambda one: one.value or 0.0).shown for end in (min, max))
        beside.append(f"published methods reach {low}{f' to {high}' if high != low else ''}{unit} on this data set")
    sentences = [f"{name} has {cell.shown}{unit}; {', and '.join(beside)}."] if beside else []
    conditions = next(filter(None, map(describe_conditions, runs)), "")
    return " ".join(filter(None, [*sentences, conditions, largest_cause(name, budgets)]))


def describe_conditions(run: MeasuredRun) -> str:
    """Grade the depth and cameras of a run, with reasons; empty if unmeasured."""
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
    for record in map(read_json, sorted(run.folder.depth.glob(f"*/{JOB_FILE}"))):
        spec, key = record["identity"], record["sha256"]
        if "check" in spec and store.has(key, run.frames[0]):
            confidence = store.read(key, run.frames[0]).confidence
            filled = spec["options"].get("filled_confidence", 0.0) + 0.5 / CONFIDENCE_STEPS  # which is stored in 8 bit
            shares.append(float((confidence > filled).mean()))
    return shares


def largest_cause(name: str, budgets: Sequence[Table]) -> str:
    """Return the largest part of a method's squared error, in words; empty if no error was taken apart."""
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


def error_section(report: Report) -> SectionContent:
    """Return the tables of each run, and of each group what the best method's number is next to."""
    content = tables_of_runs(lambda run: (budget_table(run), decomposition_table(run)), "views")(report)
    values = {}
    for group in report.groups:
        column = group.verdict.column
        if column:
            best = group.verdict.contenders[0]
            table = next(table for table in group.tables if column in table.columns)
            first = content.tables[next(iter(group.runs))]
            absolute = describe_absolute(best.name, best.cell, column, table, first, [*group.runs.values()])
            values[group.id] = {"absolute": absolute}
    return replace(content, values=values)
