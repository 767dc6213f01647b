"""Explanation of a quoted number: recomputed under the conventions in use, of which those that give
it are named.
"""

import re
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.built_in import CONVENTIONS, PATH_METRICS
from ggvs_eval.contrib.explain.conventions import (
    ALL_VIEWS,
    MaskReader,
    Masks,
    Recomputed,
    Views,
    conventions,
)
from ggvs_eval.contrib.explain.frame_conventions import OUR_LPIPS
from ggvs_eval.contrib.explain.ssim_conventions import OUR_SSIM, TORCH_MULTI_SCALE
from ggvs_eval.errors import AbsentPartError, MetricError, did_you_mean
from ggvs_eval.files.images import read_image
from ggvs_eval.files.listing import list_images
from ggvs_eval.files.names import numbers_in
from ggvs_eval.measured_frames import measured_mask
from ggvs_eval.metrics.registry import DEPTH_METRICS, METRICS
from ggvs_eval.metrics.stream import score_views
from ggvs_eval.pipelines.inspection.table import WIDTH, text_table
from ggvs_eval.plugins import Registry
from ggvs_eval.progress import track
from ggvs_eval.protocol import Measurement
from ggvs_eval.run_folder import as_ranges
from ggvs_eval.scoring import FrameReader

# Single and double precision disagree by this share of a value; a quoted one may come from either.
ROUNDING = 5e-6
# A few dozen conventions are within a decibel or two of each other: two matching digits can be
# chance. A match is evidence where few of the numbers near the quoted one would match something as
# well.
NEIGHBOURHOOD, WEAK_CHANCE = 0.05, 0.25
# share of a value by which 8 bit, rounded or cut, differs from the floats; parts of a clip are as
# near
ROUNDED = 5e-4
NEAREST = 5  # conventions that do not match and are shown
MOST_DIGITS = 100  # before or behind the point of a printed number
PRINTED = re.compile(r"(?P<number>[+-]?\d+(?:[.,]\d+)?)\s*(?P<unit>dB|%)?")
FAST_TRUTH = "as this tool, truth decoded by OpenCV, imageio or plain ffmpeg"
BOX = re.compile(r"\d+(,\d+){3}")
# of conventions in the tables that ship, by the code at the commits of published_terms.csv
USERS = {
    OUR_SSIM: "K-Planes, RF-DeRF, ViP-NeRF and SimpleNeRF",
    OUR_LPIPS: "K-Planes and RF-DeRF",
    "AlexNet, inputs in [-1, 1]": "ViP-NeRF and SimpleNeRF",
    TORCH_MULTI_SCALE: "K-Planes and RF-DeRF",
}
OF_NO_VIEW = {"path": "a camera path", "depth": "depth videos"}
FAMILIES: Registry[Callable[[Views, Masks], list[Recomputed]]] = Registry(
    "conventions", CONVENTIONS
)


@dataclass(frozen=True)
class Convention:
    """One way to compute a metric, with its result.

    Attributes:
        name: what is done, in words.
        views: ``all views``, or the one view that alone gives the value.
        matches: whether it is the quoted one to its printed digits.
        is_ours: whether this tool's own tables print it.
    """

    name: str
    views: str
    value: float
    matches: bool
    is_ours: bool


def explain(
    metric: str,
    quoted: str,
    views: Views,
    masks: Masks | None = None,
    fast: Mapping[str, FrameReader] | None = None,
) -> list[Convention]:
    """Recompute a number under every known convention of its metric.

    Args:
        metric: a key of `FAMILIES`, in any case.
        quoted: the number as it was printed, e.g. ``31.170``; its digits say how well it has to be
            met.
        views: name -> rendered and captured frames.
        masks: name -> frame number -> (H, W) bool, for conventions that leave pixels out.
        fast: name -> frame number -> captured frame as FFmpeg's fast conversion has it, for views
            that were captured as video.

    Returns:
        Every convention over all views, and over each view alone where there are several; those of
        this tool first.

    Raises:
        MetricError: an unknown metric, a quoted value that is no number, no views, or frames that
            the metric cannot have.
        WeightsError: LPIPS or DISTS without weights.
    """
    family = metric_family(metric)
    if not views:
        raise MetricError("wanted at least one view, got none; name one")
    number, _ = printed(quoted)
    rows = [*FAMILIES[family](views, masks or {}), *_of_fast_truth(family, views, fast or {})]
    usual: list[Convention] = []
    rare: list[Convention] = []
    for row in rows:
        for over, value in row.values.items():
            if len(views) > 1 or over == ALL_VIEWS:
                matches = abs(value - number) <= tolerance(quoted, value)
                (rare if row.is_rare else usual).append(
                    Convention(
                        name=row.name, views=over, value=value, matches=matches, is_ours=row.is_ours
                    )
                )
    if not any(convention.matches for convention in usual):
        usual += [convention for convention in rare if convention.views == ALL_VIEWS]
    return sorted(usual, key=lambda convention: not convention.is_ours)


def _of_fast_truth(family: str, views: Views, fast: Mapping[str, FrameReader]) -> list[Recomputed]:
    """Measure this tool's own metric of that name against the truth as OpenCV and imageio decode
    it.
    """
    if not views.keys() <= fast.keys():
        return []
    metric_name = next(
        (
            name
            for name, metric in METRICS.items()
            if name.lower() == family and metric.kind != "rig"
        ),
        None,
    )
    if metric_name is None:
        return []
    by_view = {}
    for name, view in views.items():
        pairs = (([view.rendered(index)], fast[name](index)) for index in view.frames)
        (scores,) = score_views(pairs, [metric_name])
        by_view[name] = np.array(
            [value for metric, _, value in scores.values if metric == metric_name]
        )
    # which the views are too few or too small for
    if any(len(values) == 0 for values in by_view.values()):
        return []
    return conventions({FAST_TRUTH: by_view})


@contextmanager
def followed(views: Views) -> Iterator[Views]:
    """Yield the views with a bar that moves as their rendered frames are read, one for each time
    that all of them are.
    """
    frames = range(sum(len(view.frames) for view in views.values()))
    steps: Iterator[int] = iter(())

    def passed(image: Image8) -> Image8:
        nonlocal steps
        if next(steps, None) is None:
            steps = track(frames, "comparing frames")
            next(steps)
        return image

    yield {name: view.with_rendered(passed) for name, view in views.items()}
    for _ in steps:  # ends the bar
        pass


def metric_family(metric: str) -> str:
    """Return the key of a metric in `FAMILIES`, in whichever case it is written.

    Raises:
        MetricError: a metric of which no conventions are known; the message suggests the nearest
            one.
    """
    family = metric.lower()
    of_other = {name.lower(): name for name in (*PATH_METRICS, *DEPTH_METRICS)}
    if family not in FAMILIES and family in of_other:
        name = of_other[family]
        absent = METRICS[name] if name in METRICS else DEPTH_METRICS[name]
        raise MetricError(
            f"{absent.name} is of {OF_NO_VIEW[absent.kind]}, wanted a metric of test views; see "
            f"{absent.reference}"
        )
    if reason := FAMILIES.why_absent(family):
        raise AbsentPartError(reason)
    if family not in FAMILIES:
        families = ", ".join(FAMILIES)
        raise MetricError(
            f"wanted a metric with known conventions, got {metric!r}; known are "
            f"{families}{did_you_mean(family, FAMILIES)}"
        )
    return family


def printed(quoted: str) -> tuple[float, float]:
    """Return a printed number, and half of its last digit.

    Decibels, per cent and a decimal comma are read as they are meant.

    Examples:
        >>> printed("31.52"), printed("31,52 dB"), printed("93.6 %")
        ((31.52, 0.005), (31.52, 0.005), (0.936, 0.0005))
    """
    match = PRINTED.fullmatch(quoted.strip())
    try:
        number = Decimal(match["number"].replace(",", ".")) if match else Decimal(quoted.strip())
    except InvalidOperation:
        raise MetricError(f"wanted a number as printed, e.g. 0.936, got {quoted!r}") from None
    if match and match["unit"] == "%":
        number = number.scaleb(-2)
    exponent = number.as_tuple().exponent
    if not isinstance(exponent, int) or max(abs(exponent), abs(number.adjusted())) > MOST_DIGITS:
        raise MetricError(f"wanted a finite number as printed, e.g. 0.936, got {quoted!r}")
    return float(number), 0.5 * 10.0**exponent


def tolerance(quoted: str, value: float) -> float:
    """Return the tolerance of a printed number: half of the last digit, and what single precision
    loses.
    """
    return printed(quoted)[1] + ROUNDING * abs(value)


def chance(quoted: str, values: Sequence[float]) -> float:
    """Return the share of the numbers near a quoted one, with as many digits, that would meet one
    of some values by chance.

    Returns:
        Part of the numbers within `NEIGHBOURHOOD` of the quoted one that are within the tolerance
        of any value, 0 to 1.

    Reading:
        The distribution of printed numbers is unknown; all near the quoted one are assumed equally
        likely.

    Example:
        >>> chance("30.0", [29.9, 30.4, 45.0]), chance("30.000", [29.9, 30.4, 45.0]) < 0.001
        (0.06..., True)
    """
    number, half_digit = printed(quoted)
    reach = max(NEIGHBOURHOOD * abs(number), half_digit)
    first, last = number - reach, number + reach
    covered, end = 0.0, first
    for value in sorted(values):
        low, high = (
            min(max(value + sign * tolerance(quoted, value), end), last) for sign in (-1, 1)
        )
        covered, end = covered + high - low, max(end, high)
    return covered / (2 * reach)


def explanation_table(
    metric: str,
    quoted: str,
    conventions: Sequence[Convention],
    width: int = WIDTH,
    shows_all: bool = False,
) -> str:
    """Write the result as text: a sentence, the matches, and of the others over all views the
    nearest and ours, or all.
    """
    everywhere = [row for row in conventions if row.views == ALL_VIEWS]
    matching = [row for row in conventions if row.matches]
    misses = [row for row in everywhere if not row.matches]
    misses.sort(key=lambda row: abs(row.value - printed(quoted)[0]))
    nearest = [row for at, row in enumerate(misses) if at < NEAREST or row.is_ours or shows_all]
    # Those over all views before those over one, and of these ours.
    matching.sort(key=lambda row: (row.views != ALL_VIEWS, not row.is_ours))
    rows = []
    for row in (*matching, *nearest):
        sign, whose = "=" if row.matches else "", "this tool" if row.is_ours else ""
        rows.append((sign, whose, f"{row.value:.6g}", row.views, _with_users(row)))
    table = text_table({"": 0, " ": 0, metric.upper(): 0, "over": 0, "convention": 1}, rows, width)
    left = (
        f"\n\n{len(everywhere)} conventions tried; --all shows them"
        if len(nearest) < len(misses)
        else ""
    )
    return (
        f"{textwrap.fill(_sentence(metric.upper(), quoted, conventions), width)}\n\n{table}{left}"
    )


def _sentence(metric: str, quoted: str, conventions: Sequence[Convention]) -> str:
    """Name the conventions that give the number, without those that match by chance.

    Conventions over all views come before those over one.
    """
    everywhere = [convention for convention in conventions if convention.views == ALL_VIEWS]
    number = printed(quoted)[0]
    for convention in everywhere:
        if (
            convention.is_ours
            and not convention.matches
            and abs(convention.value - number) <= ROUNDED * abs(number)
        ):
            near = (
                f"{metric} {quoted} is this tool's {convention.value:.6g} up to "
                f"{abs(convention.value - number):.2g}"
            )
            return (
                f"{near}, which rounding to 8 bit explains (round or floor, floats before they "
                "were written); what else matches so near to it does so by chance"
            )
    for tried in (everywhere, conventions):
        matching = [convention for convention in tried if convention.matches]
        if matching:
            share = chance(quoted, [convention.value for convention in tried])
            return (
                f"{_matching(metric, quoted, matching, share)}; {len(tried)} were tried, and "
                f"{_share_text(share)}"
            )
    half_digit = tolerance(quoted, printed(quoted)[0])
    count = f"{len(everywhere)} conventions over all views" + (
        f", and {len(conventions)} with those over single views,"
        if len(conventions) > len(everywhere)
        else ""
    )
    return (
        f"no known convention gives {metric} {quoted}: {count} were tried, and each is off by "
        f"more than {half_digit:.2g}"
    )


def _matching(metric: str, quoted: str, matching: Sequence[Convention], share: float) -> str:
    is_ours = any(convention.is_ours and convention.views == ALL_VIEWS for convention in matching)
    if share > WEAK_CHANCE and not is_ours:
        names = _full_name(matching[0]) if len(matching) == 1 else f"{len(matching)} conventions"
        return f"only chance matches for {metric} {quoted}: {names}; quote more digits"
    if len(matching) == 1:
        return (
            f"{metric} {quoted} is "
            f"{_full_name(matching[0])}{', the convention of this tool' if is_ours else ''}"
        )
    return (
        f"{metric} {quoted} fits {len(matching)} conventions; quote more digits or other frames to "
        "distinguish them"
    )


def _share_text(share: float) -> str:
    percent = f"{100 * share:.0f} %" if share >= 0.01 else "less than 1 %"
    return (
        f"{percent} of the numbers within {100 * NEIGHBOURHOOD:.0f} % of it would match one by "
        f"chance"
    )


def _full_name(convention: Convention) -> str:
    return _with_users(convention) + (
        "" if convention.views == ALL_VIEWS else f", {convention.views} alone"
    )


def _with_users(convention: Convention) -> str:
    users = USERS.get(convention.name)
    return f"{convention.name} ({users} measure so)" if users else convention.name


def read_masks(where: str, views: Views, measurement: Measurement) -> Masks:
    """Read masks for conventions that leave pixels out, at the size at which a protocol measures.

    Args:
        where: a picture for all views, white where pixels count; a folder with ``<view>.png`` or
            ``<view>/<frame>.png``; or a box as ``LEFT,TOP,RIGHT,BOTTOM`` in pixels, the last two
            excluded.

    Raises:
        MetricError: none of these, or a mask of another size than the frames.
    """
    path = Path(where)
    box = [int(number) for number in where.split(",")] if BOX.fullmatch(where) else None

    def read(file: Path, view: str) -> NDArray[np.bool_]:
        shape = views[view].truth(views[view].frames[0]).shape[:2]
        if box is None:
            mask = measured_mask(read_image(file)[..., 0], measurement)
        else:
            mask = np.zeros(shape, np.bool_)
            mask[box[1] : box[3], box[0] : box[2]] = True
        if mask.shape != shape or not mask.any():
            got = (
                f"{mask.shape[1]} x {mask.shape[0]}, "
                f"{'white somewhere' if mask.any() else 'black everywhere'}"
            )
            raise MetricError(
                f"{file}: wanted a mask of {shape[1]} x {shape[0]} with white where pixels count, "
                f"got {got}"
            )
        return mask

    def reader(view: str) -> MaskReader:
        files = [path] if box is not None or path.is_file() else list_images(path / view)
        files = files or [file for file in list_images(path) if file.stem == view]
        if not files:
            raise MetricError(
                f"{where}: wanted a mask of {view}, {view}.png or {view}/<frame>.png, a picture or "
                f"a box; got none"
            )
        if len(files) == 1:
            mask = read(files[0], view)
            return lambda index: mask
        by_number = dict(zip(numbers_in([file.stem for file in files]), files, strict=True))
        if absent := [index for index in views[view].frames if index not in by_number]:
            raise MetricError(
                f"{path / view}: wanted a mask of each frame, lacks {as_ranges(absent)}; number "
                f"them as the frames"
            )
        return lambda index: read(by_number[index], view)

    return {view: reader(view) for view in views}
