"""Black borders of renders: rows and columns without a picture where the truth has one."""

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.finding import Finding, verdict_of
from ggvs_eval.pipelines.inspection.renders.identity import ViewFrames, spread

INSTANTS = 3  # of a view that are looked at
BLACK_255 = 2  # the largest level of a line without a picture; codecs leave a level or two
LIT_255 = 16.0  # the least mean level of the truth there
LEAST_SHARE = 0.005  # of the width or height
# of the next line that may be black too: where a method has no source, its holes end unevenly
MOST_RAGGED = 0.2
SIDES = ("left", "right", "top", "bottom")


def find_border(name: str, view: ViewFrames) -> list[Finding]:
    """Look for lines along the sides that are black at every instant, and not in the truth."""
    widths = np.min(
        [black_lines(*pair) for pair in view.pairs(spread(view.frames, INSTANTS))], axis=0
    )
    height, width = view.truth(view.frames[0]).shape[:2]
    if not (widths > LEAST_SHARE * np.array([width, width, height, height])).any():
        return []
    border = ", ".join(
        f"{lines} px {side}" for side, lines in zip(SIDES, widths, strict=True) if lines
    )
    values = {side: int(lines) for side, lines in zip(SIDES, widths, strict=True)}
    text = f"black where the truth has a picture: {border}"
    advice = "render the whole picture; undistortion or a crop left a border"
    return [
        Finding(
            subject=name,
            question="black border",
            verdict=verdict_of(is_certain=False),
            measured=text,
            values=values,
            advice=advice,
        )
    ]


def black_lines(rendered: Image8, truth: Image8) -> tuple[int, int, int, int]:
    """Return how many lines are black from the left, right, top and bottom, where the truth
    is lit.
    """
    is_black = rendered.max(axis=2) <= BLACK_255
    counts = []
    for axis in (0, 1):  # columns, then rows
        shares = is_black.mean(axis=axis)
        is_empty = (shares == 1.0) & (truth.mean(axis=(axis, 2)) >= LIT_255)
        counts += [_leading(is_empty, shares), _leading(is_empty[::-1], shares[::-1])]
    left, right, top, bottom = counts
    return left, right, top, bottom


def _leading(is_empty: NDArray[np.bool_], shares: NDArray[np.float64]) -> int:
    """Return how many lines are empty before one that is not.

    0 for a blank picture, and where the edge is ragged.
    """
    count = 0 if is_empty.all() else int(np.argmin(is_empty))
    return count if shares[count] < MOST_RAGGED else 0
