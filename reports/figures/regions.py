"""Crop regions, chosen by rule: the squares in which a method fails most, or in which methods
differ most.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.errors import ResultsError
from ggvs_eval.files.images import mean_of_channels, read_image
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.run_folder import frame_path

Rule = Literal["worst", "different"]
# label -> (H, W), mean absolute difference of the channels, grey levels of 255
ErrorMaps = dict[str, NDArray[np.float32]]

SIDE_SHARE = 0.16  # of the width
ERROR_FULL_SCALE = 64.0  # grey levels: the brightest colour of an error map
FRAMES_AT_MOST = 10  # looked at in each view
RIM_SHARE = 0.02  # of the width: nearer to the border nothing is chosen
DARK_255 = 16  # level above which a pixel of the truth is not black
TEXTURE_255 = 8.0  # deviation of levels within a few pixels that counts in full
PLAIN_SHARE = 0.2  # of that, what a pixel without texture counts
COVERED_SHARE = 0.98  # of a square that all methods must show
RULES = {
    "worst": "where the mean absolute error of {name} is largest",
    "different": "where the mean absolute errors of the methods differ most",
}


class Square(NamedTuple):
    """A square of a picture that was chosen by eye, pixels."""

    left: int
    top: int
    side: int


def parse_square(text: str) -> Square:
    """Read ``LEFT,TOP,SIDE``, as the page's crop button writes it.

    Raises:
        ResultsError: another text.

    Examples:
        >>> parse_square("120,80,64")
        Square(left=120, top=80, side=64)
    """
    numbers = text.split(",")
    if len(numbers) != 3 or not all(number.strip().isdecimal() for number in numbers):
        raise ResultsError(f"square {text!r}: wanted LEFT,TOP,SIDE in pixels, such as 120,80,64")
    return Square(*map(int, numbers))


@dataclass(frozen=True)
class Region:
    """A square of one frame.

    Attributes:
        top: first row, pixels.
        left: first column, pixels.
        side: pixels.
        score: what the rule makes largest, grey levels of 255.
    """

    view: str
    frame: int
    top: int
    left: int
    side: int
    score: float


def find_regions(
    run: MeasuredRun,
    rule: Rule,
    label: str,
    count: int,
    *,
    view: str | None = None,
    frame: int | None = None,
    one_per_view: bool = False,
) -> tuple[Region, ...]:
    """Return the squares with the largest score, largest first.

    Args:
        rule: see `RULES`.
        label: method that ``worst`` is about.
        view: look in this view only.
        frame: look at this frame only; at most `FRAMES_AT_MOST` of each view, evenly spaced, where
            None.
        one_per_view: the worst square of each view; otherwise squares of one and the same frame,
            which do not overlap.

    Raises:
        ResultsError: no such view, frame or method, or fewer than two methods to differ.
    """
    views = run.protocol.views.test if view is None else (view,)
    frames: Sequence[int] = (
        run.frames[:: math.ceil(len(run.frames) / FRAMES_AT_MOST)] if frame is None else (frame,)
    )
    _check(run, rule, label, views, frames)
    by_view = [
        max((_search(run, rule, label, name, at, 1)[0] for at in frames), key=lambda box: box.score)
        for name in views
    ]
    by_view.sort(key=lambda box: -box.score)
    if one_per_view:
        return tuple(by_view[:count])
    return _search(run, rule, label, by_view[0].view, by_view[0].frame, count)


def given_regions(
    run: MeasuredRun, squares: Sequence[Square], view: str | None = None, frame: int | None = None
) -> tuple[Region, ...]:
    """Return the squares that somebody has chosen by eye.

    Args:
        squares: at least one.
        view: test view; None takes the first.
        frame: None takes the first.

    Raises:
        ResultsError: no such view or frame, or a square that leaves the picture.
    """
    view, frame = view or run.protocol.views.test[0], run.frames[0] if frame is None else frame
    _check_place(run, view, frame)
    height, width, _ = read_image(frame_path(run.folder.truth(view), frame)).shape
    for left, top, side in squares:
        if side < 1 or left + side > width or top + side > height:
            raise ResultsError(
                f"square {left},{top},{side}: leaves the picture of {width} x {height} pixels; "
                f"choose it within"
            )
    return tuple(
        Region(
            view=view,
            frame=frame,
            top=square.top,
            left=square.left,
            side=square.side,
            score=math.nan,
        )
        for square in squares
    )


def read_errors(run: MeasuredRun, view: str, frame: int) -> ErrorMaps:
    """Return the error of each method in each pixel of a frame."""
    return _errors(_read_frames(run, view, frame))


def _read_frames(run: MeasuredRun, view: str, frame: int) -> dict[str, Image8]:
    return {
        label: read_image(frame_path(folder, frame))
        for label, folder in run.frame_folders(view).items()
    }


def _errors(images: Mapping[str, Image8]) -> ErrorMaps:
    differences = {
        label: cv2.absdiff(image, images["truth"])
        for label, image in images.items()
        if label != "truth"
    }
    return {label: mean_of_channels(difference) for label, difference in differences.items()}


def comparison_weight(truth: Image8, images: Iterable[Image8]) -> NDArray[np.float32]:
    """Return the weight of each pixel in a comparison of pictures, (H, W), 0 to 1.

    Args:
        truth: or, on a virtual path, the mean of the methods.
        images: of the methods that are shown, (H, W, 3).

    Reading:
        0 at the border, and where a method is black and the truth is not: there it shows nothing.
        Elsewhere more where the truth has texture, since a difference on a plain wall says little.
        Where nothing is left every pixel counts the same.
    """
    levels = mean_of_channels(truth)
    variance = cv2.blur(levels * levels, (7, 7)) - np.square(cv2.blur(levels, (7, 7)))
    texture = np.minimum(np.sqrt(np.maximum(variance, 0.0)) / TEXTURE_255, 1.0)
    weight = np.asarray(PLAIN_SHARE + (1.0 - PLAIN_SHARE) * texture, np.float32)
    rim = max(1, round(RIM_SHARE * truth.shape[1]))
    inner = np.zeros_like(weight)
    inner[rim:-rim, rim:-rim] = weight[rim:-rim, rim:-rim]
    # numpy's maximum over channels takes twenty times as long
    is_lit = cv2.inRange(truth, (0,) * 3, (DARK_255,) * 3) == 0
    for image in images:
        inner[is_lit & (cv2.inRange(image, (0,) * 3, (0,) * 3) > 0)] = 0.0
    return inner if inner.any() else np.ones_like(weight)


def score_map(errors: ErrorMaps, rule: Rule, label: str) -> NDArray[np.float32]:
    """Score of the square at each place, (H - side + 1, W - side + 1), its first row and column at
    [0, 0].

    Reading:
        ``different`` takes the mean errors in a square, not the errors of single pixels, so that
        noise in which methods differ from pixel to pixel counts for nothing.
    """
    side = square_side(next(iter(errors.values())).shape)
    if rule == "worst":
        return _mean_of_squares(errors[label], side)
    means = np.stack([_mean_of_squares(error, side) for error in errors.values()])
    return np.asarray(means.max(axis=0) - means.min(axis=0))


def square_side(shape: tuple[int, ...]) -> int:
    """Side of the squares in an image of this shape (H, W), pixels."""
    return max(4, min(shape[0], round(SIDE_SHARE * shape[1])))


def _mean_of_squares(values: NDArray[np.float32], side: int) -> NDArray[np.float32]:
    sums = cv2.integral(values)  # (H + 1, W + 1)
    total = sums[side:, side:] - sums[:-side, side:] - sums[side:, :-side] + sums[:-side, :-side]
    return np.asarray(total / side**2, dtype=np.float32)


def _search(
    run: MeasuredRun, rule: Rule, label: str, view: str, frame: int, count: int
) -> tuple[Region, ...]:
    """Return the square of the largest weighted score in a frame, and the next ones that overlap
    none of those before.
    """
    images = _read_frames(run, view, frame)
    pictures = [
        image
        for key, image in images.items()
        if key != "truth" and (rule == "different" or key == label)
    ]
    errors, weight = _errors(images), comparison_weight(images["truth"], pictures)
    scores, side = score_map(errors, rule, label), square_side(errors[label].shape)
    is_shown = _mean_of_squares((weight > 0).astype(np.float32), side) >= COVERED_SHARE
    scores_left = np.where(
        is_shown if is_shown.any() else True, scores * _mean_of_squares(weight, side), -np.inf
    )
    regions: list[Region] = []
    while len(regions) < count and np.isfinite(scores_left).any():
        top, left = (
            int(at) for at in np.unravel_index(int(np.argmax(scores_left)), scores_left.shape)
        )
        regions.append(
            Region(
                view=view,
                frame=frame,
                top=top,
                left=left,
                side=side,
                score=float(scores[top, left]),
            )
        )
        scores_left[
            max(0, top - side + 1) : top + side, max(0, left - side + 1) : left + side
        ] = -np.inf
    return tuple(regions)


def _check_place(run: MeasuredRun, view: str, frame: int) -> None:
    views = run.protocol.views.test
    if view not in views:
        raise ResultsError(
            f"{run.folder.root}: no test view {view!r}; use one of {', '.join(views)}"
        )
    if frame not in run.frames:
        raise ResultsError(
            f"{run.folder.root}: no frame {frame}; use {run.frames[0]} to {run.frames[-1]}"
        )


def _check(
    run: MeasuredRun, rule: Rule, label: str, views: Sequence[str], frames: Sequence[int]
) -> None:
    _check_place(run, views[0], frames[0])
    if label not in run.pictured:
        raise ResultsError(
            f"{run.folder.root}: no complete renders of {label!r}; use one of "
            f"{', '.join(run.pictured)}"
        )
    if rule == "different" and len(run.pictured) < 2:
        raise ResultsError(
            f"{run.folder.root}: wanted at least two methods, got one; use --rule worst"
        )
