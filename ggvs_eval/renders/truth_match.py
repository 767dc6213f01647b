"""Copies of the truth that came with renders, against the captured frames: they give the order, and
test the protocol.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path

import cv2
import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.errors import RenderError
from ggvs_eval.files.images import read_image
from ggvs_eval.renders.request import FrameRequest

# On frames of Neural 3D Video another resize filter moves a picture by up to 0.9 levels of 255, one
# pixel by 0.9, another decoder by 1.2, BT.601 taken for BT.709 by 2.3; studio range taken for full
# by 6.9, gamma 1.1 by 6.7, the next camera by 17.8.
LARGEST_DIFFERENCE = 4.0
SAMPLED = 12
LISTED = 20
# A neighbouring instant must fit this much better than the claimed one to be believed.
CLEARLY_BETTER = 0.8
VISIBLE_DIFFERENCE = 0.25

Claims = Mapping[tuple[str, int], Path]


def difference(first: Image8, second: Image8) -> float:
    """Return the mean absolute difference in levels of 255; infinite where the sizes differ."""
    if first.shape != second.shape:
        return math.inf
    return float(cv2.norm(first, second, cv2.NORM_L1)) / first.size


def check_truth(claims: Claims, request: FrameRequest) -> float:
    """Refuse renders whose own copy of the truth differs from the capture.

    Args:
        claims: (view, frame) -> their picture of it; views and frames of the protocol.

    Returns:
        Their mean difference in levels of 255.

    Raises:
        RenderError: copies of another size, that are too far from the captured frame, or nearer to
            the next or previous instant; the message names them and how far they are.
    """
    checked = [_check_view(view, claims, request) for view in request.views]
    wrong = [complaint for _, complaints in checked for complaint in complaints]
    if wrong:
        more = f" and {len(wrong) - LISTED} more" if len(wrong) > LISTED else ""
        raise RenderError(
            "wanted copies of the captured frames next to these renders, got others: "
            f"{'; '.join(wrong[:LISTED])}{more}; wanted at most {LARGEST_DIFFERENCE:g} levels of "
            "255: check views, frames, size, colours, undistortion"
        )
    levels = [level for view_levels, _ in checked for level in view_levels]
    return float(np.mean(levels)) if levels else 0.0


def _check_view(view: str, claims: Claims, request: FrameRequest) -> tuple[list[float], list[str]]:
    """Measure how far the copies of one view are from what they are said to show, and list what is
    wrong with them.
    """
    frames = sorted(frame for claimed, frame in claims if claimed == view)
    distances = _ViewDistances(request, view)
    levels = [distances.add(read_image(claims[(view, frame)]), frame) for frame in frames]
    wrong = [
        _describe(claims[(view, frame)], view, frame, level)
        for frame, level in zip(frames, levels, strict=True)
        if level > LARGEST_DIFFERENCE
    ]
    moved = distances.better_neighbour()
    return levels, [*wrong, f"copies of {view} {moved}"] if moved else wrong


def _describe(path: Path, view: str, frame: int, level: float) -> str:
    name = "/".join(path.parts[-3:])
    if math.isinf(level):
        return f"{name} has another size than frame {frame} of {view}"
    return f"{name} is {level:.1f} levels from frame {frame} of {view}"


class _ViewDistances:
    """Distances of one view's copies to the captured frames of the same instant, one earlier and
    one later.
    """

    def __init__(self, request: FrameRequest, view: str) -> None:
        self._request = request
        self._truth = lru_cache(maxsize=3)(lambda frame: request.truth(view, frame))
        # offset -> distance at the instant, distance at the neighbour
        self._sums = {-1: np.zeros(2), 1: np.zeros(2)}

    def add(self, copy: Image8, frame: int) -> float:
        """Take the next copy; gives back its distance to the frame it is said to show."""
        level = difference(copy, self._truth(frame))
        for offset, sums in self._sums.items():
            if frame + offset in self._request.frames:
                sums += level, difference(copy, self._truth(frame + offset))
        return level

    def better_neighbour(self) -> str:
        """Note that the copies fit neighbouring instants clearly better; else empty."""
        for offset, (base, shifted) in self._sums.items():
            if (
                math.isfinite(base)
                and base > VISIBLE_DIFFERENCE
                and shifted < CLEARLY_BETTER * base
            ):
                return (
                    f"fit {'one frame later' if offset > 0 else 'one frame earlier'} better "
                    f"({shifted:.1f} against {base:.1f})"
                )
        return ""


@dataclass(frozen=True)
class Order:
    """An order in which a flat list of pictures may run.

    Attributes:
        places: index in the list -> (view, frame), for those of the protocol.
    """

    describe: str
    places: Mapping[int, tuple[str, int]]


def find_order(copies: Sequence[Path], request: FrameRequest) -> Order:
    """Find out by the pictures which view and frame each place of a flat list is.

    Returns:
        The order whose places fit best, which may be badly.
    """
    orders = list(_possible_orders(len(copies), request))
    if not orders:
        counts = {
            len(views) * n
            for views in (request.views, request.views[:1])
            for n in (len(request.frames), request.n_frames)
        }
        raise RenderError(
            f"wanted {', '.join(map(str, sorted(counts)))} pictures (all test views or one, the "
            f"protocol's frames or the whole capture), got {len(copies)}; name the files "
            "<view>/<frame>.png"
        )
    truth = lru_cache(maxsize=2 * SAMPLED)(request.truth)
    copy = lru_cache(maxsize=2 * SAMPLED)(lambda index: read_image(copies[index]))
    scored = []
    for order in orders:
        sample = _spread(sorted(order.places), SAMPLED)
        scored.append(
            (
                float(
                    np.mean(
                        [difference(copy(index), truth(*order.places[index])) for index in sample]
                    )
                ),
                order,
            )
        )
    scored.sort(key=lambda pair: pair[0])
    best = scored[0][0]  # where nothing fits, `check_truth` says how far it is
    if (
        len(scored) > 1
        and best <= LARGEST_DIFFERENCE
        and scored[1][0] <= 1.25 * best + VISIBLE_DIFFERENCE
    ):
        raise RenderError(
            f"two orders fit the captured frames equally: {scored[0][1].describe} ({best:.1f} "
            f"levels) and {scored[1][1].describe} ({scored[1][0]:.1f}); name the files "
            "<view>/<frame>.png"
        )
    return scored[0][1]


def _possible_orders(count: int, request: FrameRequest) -> Iterable[Order]:
    """Yield every different order with that many pictures."""
    rankings = [
        request.views,
        tuple(sorted(request.views)),
        tuple(name for name in request.cameras if name in request.views),
    ]
    earlier_orders: list[Mapping[int, tuple[str, int]]] = []
    for views in dict.fromkeys([*rankings, *((view,) for view in request.views)]):
        for frames in dict.fromkeys([request.frames, range(request.n_frames)]):
            if len(views) * len(frames) != count:
                continue
            by_view = [(view, frame) for view in views for frame in frames]
            by_frame = [(view, frame) for frame in frames for view in views]
            named = f"{', '.join(views)} in frames {frames.start}-{frames.stop - 1}"
            for places, outer in (
                (by_view, "view after view"),
                (by_frame, "instant after instant"),
            ):
                inside = {
                    index: place for index, place in enumerate(places) if place[1] in request.frames
                }
                if inside not in earlier_orders:
                    earlier_orders.append(inside)
                    yield Order(f"{named}, {outer}", inside)


def _spread(indices: list[int], count: int) -> list[int]:
    step = max(len(indices) // count, 1)
    return list(islice(indices, 0, None, step))[:count] if len(indices) > count else indices
