"""Error of each method alone: over views or over time.

Unseen, by cameras, colour, misplacement, blur, wrong surfaces, or noise.

A method's number alone has a ceiling, published values of the same data, its training data, and the
sources of its error.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass, replace
from functools import lru_cache, partial, reduce

import cv2
import numpy as np

from ggvs_eval.arrays import Array, Array32, Image8, Map, Mask
from ggvs_eval.errors import ResultsError
from ggvs_eval.files.images import mean_of_channels, read_image, round_levels
from ggvs_eval.geometry.registration import register
from ggvs_eval.jobs.processes import in_threads
from ggvs_eval.reports.model.measured import MeasuredRun, limit_by_cameras
from ggvs_eval.reports.model.table import Cell, Column, Row, Table
from ggvs_eval.reports.section import RUNS_KEPT, Report, SectionContent, tables_of_runs
from ggvs_eval.results import split_label
from ggvs_eval.run_folder import frame_path, missing_frames, read_json
from ggvs_eval.statistics.decomposition import TwoWay, decompose_metric

METRIC = "L1"
UNIT = "grey levels of 255"
VARIANCE_CAPTION = (
    "L1 of every view and frame decomposed: mean + view effect + time effect + rest; shares of the "
    "variance about the mean. SDT contains time and rest, SDV views and rest."
)
VARIANCE_COLUMNS: tuple[tuple[Column, str, Callable[[TwoWay], float]], ...] = (
    (Column("mean L1", UNIT, False), "{:.2f}", lambda parts: parts.mean),
    (Column("views", "%"), "{:.1f}", lambda parts: 100 * parts.shares()["view"]),
    (Column("time", "%"), "{:.1f}", lambda parts: 100 * parts.shares()["time"]),
    (Column("rest", "%"), "{:.1f}", lambda parts: 100 * parts.shares()["rest"]),
)
FITTED_WIDTH = 160  # pixels of the pictures that the colour map is fitted to
ROUNDS = 12  # of the fit, each with weights by the errors of the one before
LEAST_ERROR_255 = 0.5  # in those weights
SMOOTH_PX = 3.0  # blur before the fit: a gain that takes noise or texture away is no colour
# of smooth pictures, below which no colour map is fitted: other content fits best to a grey picture
LEAST_CORRELATION = 0.7
COMPARED_WIDTH = 640  # pixels of the pictures whose windows are compared
WINDOW = 7  # pixels of them
MOST_LEFT = 0.5  # of a window's error, where a cause explains it
COARSEST_WIDTH = 40  # pixels of the smallest pictures that motion is sought in
MOTION_WINDOW = 11  # pixels that move together
# Motion of neighbouring windows differs by less, standard deviation as a share of the width; other
# content needs any motion.
EVEN_PX, EVEN_SHARE = 15, 1 / 320
BLURS_PX = (0.7, 1.2, 2.0, 3.3, 5.5)
# Other content: smooth pictures of which a window of this share of the width has less than half of
# its variation in common; what varies by less than this many levels is alike.
WIDE_SHARE, CONTENT_PX, LEAST_LIKENESS, LEAST_CONTRAST_255 = 0.03, 1.5, 0.5, 3.0
# leaves white noise its variance, and nothing smooth
GRAIN = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6
BUDGET_KEY = "error_budget"  # of the table
FRAMES_AT_MOST = 4  # of each view, evenly spaced
CAPTION = (
    "Mean squared error of single frames, decomposed by what undoes it. Unseen: pixels that no "
    "source view covers, which methods must invent. Camera: what one homography per picture "
    "removes, as wrong poses move the pictures of all methods. Colour: a tone curve per channel "
    "and a falloff to the corners, due to camera differences. Misplaced: windows whose error "
    "smooth motion halves, of all or half of the content (double images). Blur: windows whose "
    "error a blur of the reference halves. Wrong surface: other or missing content. Noise: white, "
    "even grain of both pictures. Unexplained: the rest."
)
COLUMNS = (
    Column("squared error", "grey levels² of 255", higher_is_better=False),
    *(
        Column(part, "%")
        for part in (
            "unseen",
            "camera",
            "colour",
            "misplaced",
            "blur",
            "wrong surface",
            "noise",
            "unexplained",
        )
    ),
)
NOT_TOLD = Cell("not measured", note="add PSNR_disoccluded to the protocol's metrics")
CAUSES = {
    "unseen": "areas that no source camera sees",
    "camera": "a motion of whole pictures, by poses or lenses if all methods have it",
    "colour": "colour and exposure, which a tone curve would remove",
    "misplaced": "misplaced content, by wrong depth, poses or motion",
    "blur": "blur",
    "wrong surface": "wrong surfaces: missing or replaced content",
    "noise": "noise, that of the captured frames included",
    "unexplained": "unexplained",
}


def decomposition_table(run: MeasuredRun) -> Table | None:
    """Return the table of one run; None if it has a single view or frame, or no L1."""
    if (
        run.protocol.frames.count < 2
        or len(run.protocol.views.test) < 2
        or METRIC not in set(run.results.table["metric"])
    ):
        return None
    rows = [run.row(label, _variance_cells(run, label)) for label in run.labels]
    columns = tuple(column for column, _, _ in VARIANCE_COLUMNS)
    return Table(
        key="decomposition",
        title="Variation of the error",
        caption=VARIANCE_CAPTION,
        columns=columns,
        rows=tuple(rows),
        dataset=run.scene,
    )


def _variance_cells(run: MeasuredRun, label: str) -> tuple[Cell, ...]:
    try:
        parts = decompose_metric(
            run.results, METRIC, run.scene, *split_label(label), run.protocol.dataset
        )
    except ResultsError as error:
        return tuple(Cell(f"not computed: {error}") for _ in VARIANCE_COLUMNS)
    return tuple(
        Cell(text.format(value(parts)), value(parts)) for _, text, value in VARIANCE_COLUMNS
    )


@dataclass(frozen=True)
class ErrorBudget:
    """Parts of a mean squared error, grey levels² of 255; they add up to it.

    Attributes:
        unseen: of pixels that no source view covers; None where these are not known, and counted
            with the others.
        camera: error of the other pixels that one homography removes: at least what wrong poses
            cost, unless the method itself moves whole pictures.
        colour: further error, that a colour map of the image removes.
        misplaced: further error, of windows that motion explains best.
        blur: further error, of windows that a blur of the truth explains best.
        surface: further error, of windows with other content than the truth.
        noise: of what is left, white and even noise.
        unexplained: the rest.
    """

    unseen: float | None
    camera: float
    colour: float
    misplaced: float
    blur: float
    surface: float
    noise: float
    unexplained: float

    @property
    def total(self) -> float:
        """The mean squared error."""
        return sum(part or 0.0 for part in astuple(self))


def error_budget(image: Image8, truth: Image8, unseen: Mask | None) -> ErrorBudget:
    """Decompose the squared error of an image.

    Args:
        image: synthesised, (H, W, 3).
        truth: (H, W, 3).
        unseen: true where no source view covers the pixel, (H, W); None if that is not known.

    Reading:
        Each cause is a way to make the image from the truth, and what it does not leave of the
        error is its share. One colour map serves the whole picture. Of motion and blur the one that
        leaves less of a window's error counts, if it leaves half at most: any error has a best
        move, but of noise or other content it leaves more, or its neighbours move elsewhere. Half
        the content in another place, as where two views are blended, is motion too. Noise is only
        what is everywhere in what is left.
    """
    coverage = (
        np.ones(truth.shape[:2], np.float32) if unseen is None else (~unseen).astype(np.float32)
    )
    squared = _squared(image.astype(np.float32), truth)
    hidden = None if unseen is None else _mean(squared * unseen)
    placed = image.astype(np.float32)
    before = squared * coverage
    visible_error = _mean(before)
    if registered := register(image, truth, coverage > 0):
        moved, is_covered = registered
        placed, before = _better(
            placed, before, np.where(is_covered[..., None], moved, placed), truth, coverage
        )
    placed_error = _mean(before)
    mapped, after = _better(placed, before, colour_map(placed, truth, coverage), truth, coverage)
    shares = explained_shares(mapped, truth, coverage)
    misplaced, blur, surface = (_mean(after * share) for share in shares)
    left = after * (1 - sum(shares))
    grain = cv2.filter2D(mapped - truth, -1, GRAIN)[coverage > 0]
    noise_variance = float(np.square(1.4826 * np.median(np.abs(grain)))) if len(grain) else 0.0
    recoloured_error = _mean(after)
    noise = min(_mean(np.minimum(_windows(left), noise_variance)), _mean(left))
    return ErrorBudget(
        unseen=hidden,
        camera=visible_error - placed_error,
        colour=placed_error - recoloured_error,
        misplaced=misplaced,
        blur=blur,
        surface=surface,
        noise=noise,
        unexplained=recoloured_error - misplaced - blur - surface - noise,
    )


def _better(
    image: Array32, error: Map, changed: Array32, truth: Image8, coverage: Map
) -> tuple[Array32, Map]:
    """Return a changed image and its squared error where the change lowers it, else the image and
    its own.
    """
    changed_error = _squared(changed, truth) * coverage
    return (changed, changed_error) if changed_error.mean() < error.mean() else (image, error)


def _mean(error: Map) -> float:
    return float(error.mean(dtype=np.float64))


def _squared(image: Array32, truth: Image8 | Array32) -> Map:
    # the mean, fast
    return np.asarray(cv2.transform(np.square(image - truth), np.full((1, 3), 1 / 3)), np.float32)


def _windows(values: Map, size_px: int = WINDOW) -> Map:
    return np.asarray(
        cv2.boxFilter(values, -1, (size_px, size_px), borderType=cv2.BORDER_REFLECT), np.float32
    )


def colour_map(image: Image8 | Array32, truth: Image8, coverage: Map) -> Array32:
    """Map an image to the colours of another by a quadratic tone curve and a falloff to the corners
    in each channel.

    Args:
        image: (H, W, 3).
        truth: (H, W, 3).
        coverage: weight of each pixel in the fit, (H, W).

    Returns:
        (H, W, 3), grey levels; the map of least absolute errors, which a wrong part of the picture
        does not bend; the image itself where the pictures have little in common.
    """
    small, target, weight = (
        cv2.GaussianBlur(_resized(values, FITTED_WIDTH), (0, 0), SMOOTH_PX)
        for values in (image, truth, coverage)
    )
    mapped = image.astype(np.float32)
    covariance = np.cov(small.mean(axis=2).ravel(), target.mean(axis=2).ravel())
    if covariance[0, 1] < LEAST_CORRELATION * np.sqrt(covariance[0, 0] * covariance[1, 1]):
        return mapped
    for channel in range(truth.shape[2]):
        levels, design = small[..., channel].ravel().astype(np.float64), _tones(small[..., channel])
        values, weights = target[..., channel].ravel() - levels, weight.ravel().astype(np.float64)
        change = np.zeros(design.shape[1])
        for _ in range(ROUNDS):
            weighted = design.T * (
                weights / np.maximum(np.abs(design @ change - values), LEAST_ERROR_255)
            )
            change = np.linalg.lstsq(weighted @ design, weighted @ values, rcond=1e-6)[0]
        mapped[..., channel] += (
            (_tones(image[..., channel]) @ change).reshape(truth.shape[:2]).astype(np.float32)
        )
    return mapped


def _tones(levels: Array32 | Image8) -> Array:
    """Return what the colour map of a channel is a sum of: 1, level, its square, and level by
    squared radius, (H W, 4).
    """
    y, x = np.meshgrid(*(np.linspace(-1, 1, count) for count in levels.shape), indexing="ij")
    centred = levels / 127.5 - 1.0
    return np.stack(
        [np.ones_like(x), centred, centred**2, levels / 255 * (x * x + y * y)], axis=-1
    ).reshape(-1, 4)


def _resized(values: Array32 | Image8 | Map, widest: int) -> Array32:
    """Return a picture with at most this number of columns."""
    height, width = values.shape[:2]
    columns = min(width, widest)
    size = columns, max(1, round(columns / width * height))
    return np.asarray(
        cv2.resize(values.astype(np.float32), size, interpolation=cv2.INTER_AREA), np.float32
    )


def explained_shares(image: Array32, truth: Image8, coverage: Map) -> tuple[Map, Map, Map]:
    """Return the shares of each pixel's squared error that motion, blur and other content explain,
    (H, W) each.

    Args:
        image: (H, W, 3), grey levels.
        coverage: 1 if a source sees the pixel, (H, W).
    """
    rendered, target, counted = (
        _resized(values, COMPARED_WIDTH) for values in (image, truth, coverage)
    )
    error = _windows(_squared(rendered, target) * counted)
    full, half = (
        _left_when_moved(moved, target, counted) for moved in (rendered, 2 * rendered - target)
    )
    moved = np.minimum(full, half / 4)
    blurs = (cv2.GaussianBlur(target, (0, 0), sigma_px) for sigma_px in BLURS_PX)
    best = reduce(
        np.minimum, (_windows(_squared(rendered, blur) * counted) for blur in blurs), moved
    )
    is_explained = best < MOST_LEFT * error
    share = np.where(is_explained, 1 - best / np.maximum(error, 1e-6), 0).astype(np.float32)
    is_other = _likeness(rendered, target, counted) < LEAST_LIKENESS
    misplaced, blurred, unlike = (
        cv2.resize(
            np.where(mask, values, np.float32(0)),
            image.shape[1::-1],
            interpolation=cv2.INTER_NEAREST,
        )
        for mask, values in (
            (moved == best, share),
            (moved > best, share),
            (is_other & ~is_explained, np.float32(1)),
        )
    )
    return misplaced, blurred, unlike


def _left_when_moved(image: Array32, truth: Array32, coverage: Map) -> Map:
    """Return the squared error that smooth motion leaves in windows of a picture, (H, W)."""
    target, grey = (round_levels(mean_of_channels(picture)) for picture in (truth, image))
    width = coverage.shape[1]
    levels = 1 + max(int(np.log2(width / COARSEST_WIDTH)), 0)
    # (H, W, 2), pixels
    motion = cv2.calcOpticalFlowFarneback(
        target, grey, None, 0.5, levels, MOTION_WINDOW, 3, 5, 1.1, 0
    )
    rows, columns = np.indices(coverage.shape, dtype=np.float32)
    places = columns + motion[..., 0], rows + motion[..., 1]
    moved = cv2.remap(image, *places, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    before, after = (_windows(_squared(picture, truth) * coverage) for picture in (image, moved))
    weight = before[..., None] + 1e-3
    total = _windows(weight, EVEN_PX)[..., None]
    mean, square = (_windows(weight * values, EVEN_PX) / total for values in (motion, motion**2))
    is_even = (square - mean**2).sum(axis=2) < (EVEN_SHARE * width) ** 2
    return np.where(is_even, after, before)


def _likeness(image: Array32, truth: Array32, coverage: Map) -> Map:
    """Return the share of their variation that wide windows of two pictures have in common, as SSIM
    does, (H, W).
    """
    first, second, weight = (_resized(values, FITTED_WIDTH) for values in (image, truth, coverage))
    sigma_px = WIDE_SHARE * weight.shape[1]

    def mean(values: Array32) -> Array32:
        sums = cv2.GaussianBlur(values * weight[..., None], (0, 0), sigma_px)
        return np.asarray(
            sums / np.maximum(cv2.GaussianBlur(weight, (0, 0), sigma_px), 1e-6)[..., None],
            np.float32,
        )

    first, second = (cv2.GaussianBlur(values, (0, 0), CONTENT_PX) for values in (first, second))
    apart = _squared(mean(first), mean(second))
    variances = mean((first - mean(first)) ** 2 + (second - mean(second)) ** 2).mean(axis=2)
    different = mean((first - second) ** 2).mean(axis=2)
    alike = 2 * LEAST_CONTRAST_255**2
    likeness = (variances + apart - different + alike) / (variances + apart + alike)
    return cv2.resize(likeness, coverage.shape[::-1], interpolation=cv2.INTER_LINEAR)


@lru_cache(maxsize=RUNS_KEPT)
def budget_table(run: MeasuredRun) -> Table | None:
    """Return a row per method, and one per view of the one that the page shows first.

    None if there are no pictures.
    """
    if not run.pictured:
        return None
    main = run.ours_first[0]
    frames = run.frames[:: math.ceil(len(run.frames) / FRAMES_AT_MOST)]
    instants = [(view, frame) for view in run.protocol.views.test for frame in frames]
    budgets = dict(zip(instants, in_threads(partial(_budgets, run), instants), strict=True))
    rows = [
        run.row(label, _share_cells([budget[label] for budget in budgets.values()]))
        for label in run.pictured
    ]
    for view in run.protocol.views.test:
        rows.append(
            Row(
                f"{run.name(main)} in {view}",
                _share_cells([budgets[view, frame][main] for frame in frames]),
            )
        )
    below = (f"Unseen is not measured: {NOT_TOLD.note}.",) * any(
        NOT_TOLD in row.cells for row in rows
    )
    return Table(
        key=BUDGET_KEY,
        title="Sources of the error",
        caption=CAPTION,
        columns=COLUMNS,
        rows=tuple(rows),
        dataset=run.title,
        notes=below,
    )


def _budgets(run: MeasuredRun, instant: tuple[str, int]) -> dict[str, ErrorBudget]:
    """Return label -> budget of one frame of one view."""
    view, frame = instant
    folders, masks = run.frame_folders(view), run.folder.disoccluded(view)
    truth = read_image(frame_path(folders.pop("truth"), frame))
    is_told = not missing_frames(masks, range(frame, frame + 1))
    unseen = read_image(frame_path(masks, frame))[..., 0] > 0 if is_told else None
    return {
        label: error_budget(read_image(frame_path(folder, frame)), truth, unseen)
        for label, folder in folders.items()
    }


def _share_cells(budgets: Sequence[ErrorBudget]) -> tuple[Cell, ...]:
    """Return the mean of the squared errors, and shares of it."""
    total = float(np.mean([budget.total for budget in budgets]))
    unseen_shares = [budget.unseen for budget in budgets if budget.unseen is not None]
    unseen = (
        _share(float(np.mean(unseen_shares)), total)
        if len(unseen_shares) == len(budgets)
        else NOT_TOLD
    )
    parts = np.mean([astuple(budget)[1:] for budget in budgets], axis=0)
    return Cell(f"{total:.1f}", total), unseen, *(_share(float(part), total) for part in parts)


def _share(part: float, total: float) -> Cell:
    percent = 100 * part / total if total else 0.0
    return Cell(f"{percent:.1f}", percent)


def describe_absolute(
    name: str,
    cell: Cell,
    column: Column,
    table: Table,
    budgets: Sequence[Table],
    runs: Sequence[MeasuredRun] = (),
) -> str:
    """Return a few sentences on a method's number alone; empty if there is nothing to compare with.

    Args:
        table: the main table, whose grey rows have the ceilings of the capture and values published
            of the same data set.
        budgets: error budgets of the group's runs; the cause is of the first.
        runs: of the group; what they were made from is that of the first of which it is known.

    Reading:
        Published values of other captures say nothing of this one, so only those in the table
        count. The largest of the parts of the squared error is named as the cause.
    """
    unit, at = f" {column.unit}" if column.unit else "", table.columns.index(column)
    beside = []
    ceilings = [
        row.cells[at].shown
        for row in table.rows
        if row.kind == "reference" and row.cells[at].value is not None
    ]
    if ceilings:
        beside.append(
            f"a perfect rendering without noise or codec would have {ceilings[0]}{unit} on this "
            f"capture"
        )
    published = [
        row.cells[at]
        for row in table.rows
        if row.kind == "published" and row.cells[at].value is not None
    ]
    if published:
        low, high = (
            end(published, key=lambda row_cell: row_cell.value or 0.0).shown for end in (min, max)
        )
        beside.append(
            f"published methods reach {low}{f' to {high}' if high != low else ''}{unit} on this "
            f"data set"
        )
    sentences = [f"{name} has {cell.shown}{unit}; {', and '.join(beside)}."] if beside else []
    calibration = next(filter(None, map(describe_calibration, runs)), "")
    return " ".join(
        filter(
            None, [limit_by_cameras(runs), *sentences, calibration, largest_cause(name, budgets)]
        )
    )


def describe_calibration(run: MeasuredRun) -> str:
    """State what a run's cameras were calibrated from, which limits every method.

    Empty if that is unknown.
    """
    file = run.folder.capture_path() / "calibration.json" if "path" in run.capture else None
    calibration = read_json(file) if file and file.is_file() else {}
    if points := calibration.get("n_points"):
        left_px = calibration["mean_reprojection_error_px"]
        return f"The cameras were calibrated from {points} points, which leaves {left_px:.2f} px."
    return ""


def largest_cause(name: str, budgets: Sequence[Table]) -> str:
    """Return the largest explained part of a method's squared error, and a larger rest, in words.

    Empty if there is none.
    """
    rows = [
        row
        for budget in budgets
        if budget.key == BUDGET_KEY
        for row in budget.rows
        if row.name == name
    ]
    if not rows:
        return ""
    # behind the squared error
    *explained, remainder = (cell.value or 0.0 for cell in rows[0].cells[1:])
    largest, cause = max(zip(explained, CAUSES.values(), strict=False))  # the remainder has none
    if not largest:
        return ""
    unexplained = f", and {remainder:.0f} % is unexplained" if remainder > largest else ""
    return f"{largest:.0f} % of its squared error is {cause}{unexplained}."


def error_section(report: Report) -> SectionContent:
    """Return the tables of each run, and of each group what the best method's number is next to."""
    content = tables_of_runs(lambda run: (budget_table(run), decomposition_table(run)), "views")(
        report
    )
    values = {}
    for group in report.groups:
        column = group.verdict.column
        if column:
            best = group.verdict.contenders[0]
            table = next(table for table in group.tables if column in table.columns)
            first = content.tables[next(iter(group.runs))]
            absolute = describe_absolute(
                best.name, best.cell, column, table, first, [*group.runs.values()]
            )
            values[group.id] = {"absolute": absolute}
    return replace(content, values=values)
