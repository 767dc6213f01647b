"""A rectified pair as one picture in which a person sees whether matching points lie on the same row."""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array, Image8
from ggvs_eval.camera import Camera
from ggvs_eval.files.images import resize
from ggvs_eval.geometry.rectification import RectifiedPair
from ggvs_eval.reports.depth_page.pair_errors import on_canvas

WIDTH_PX = 640  # of a picture
HEIGHT_PX = 400  # of each half
GAP_PX = 4
GUIDES = 12
DOTS = 14
GREY = 128
GUIDE_COLOURS = ((240, 228, 66), (86, 180, 233))  # yellow and sky blue, of Okabe and Ito's colours
DOT_COLOURS = ((213, 94, 0), (0, 158, 115), (204, 121, 167), (0, 114, 178), (230, 159, 0))


class PairPicture(NamedTuple):
    """A rectified pair to look at.

    Attributes:
        image: RGB uint8, (H, W, 3).
        beside: True where the camera stands on the left and its partner on the right, False where it stands above it.
    """

    image: Image8
    beside: bool


def pair_picture(
    pair: RectifiedPair, camera: Camera, partner: Camera, image: Image8, partner_image: Image8, uv: Array
) -> PairPicture:
    """Put the two rectified images side by side, with lines along their common rows and dots on a few matched features.

    The canvas of a partner on the left is upside down, that of one above or below lies on its side: pictures are turned back.
    Rows become columns where that takes a quarter turn, and the halves stand one above the other.

    Args:
        pair: the rectification.
        camera: the reference, which plays the left image.
        partner: the partner.
        image: of the reference, RGB (H, W, 3).
        partner_image: of the partner.
        uv: matched pixels of the two, (M, 2, 2).
    """
    turns = _turns_upright(pair.rotation[0])
    rows = _span(pair.left_inside | pair.right_inside, axis=1)
    places = on_canvas(pair, camera, partner, _spread(uv))  # (N, 2, 2)
    sides = ((pair.warp_left(image), pair.left_inside), (pair.warp_right(partner_image), pair.right_inside))
    columns = [_span(inside, axis=0) for _, inside in sides]
    scale = _scale(turns, rows, columns)
    halves = []
    for side, ((warped, inside), each) in enumerate(zip(sides, columns, strict=True)):
        window = np.where(inside[..., None], warped, np.uint8(GREY))[rows, each]
        corner = np.array([each.start, rows.start])
        halves.append(_draw(window, (places[:, side] - corner), scale))
    beside = turns % 2 == 0
    joined = [np.rot90(half, turns) for half in halves]
    gap = np.full((joined[0].shape[0], GAP_PX, 3) if beside else (GAP_PX, joined[0].shape[1], 3), GREY, np.uint8)
    return PairPicture(np.concatenate([joined[0], gap, joined[1]], axis=1 if beside else 0), beside)


def _turns_upright(along: Array) -> int:
    """Quarter turns, counter-clockwise, that bring a canvas whose x axis points `along` in the camera upright."""
    if abs(along[0]) >= abs(along[1]):
        return 0 if along[0] > 0 else 2
    return 3 if along[1] > 0 else 1


def _span(inside: NDArray[np.bool_], axis: int) -> slice:
    """From the first to the last row (axis 1) or column (axis 0) with anything inside."""
    found = np.flatnonzero(inside.any(axis=axis))
    return slice(int(found[0]), int(found[-1]) + 1) if found.size else slice(0, 1)


def _scale(turns: int, rows: slice, columns: list[slice]) -> float:
    """What brings both halves to the size of the picture; nothing is magnified."""
    height, width = rows.stop - rows.start, max(each.stop - each.start for each in columns)
    if turns % 2 == 0:
        return min(1.0, (WIDTH_PX - GAP_PX) / 2 / width)
    return min(1.0, WIDTH_PX / height, HEIGHT_PX / width)


def _spread(uv: Array) -> Array:
    """A few of the matches, from all over the first image's rows."""
    order = np.lexsort((uv[:, 0, 0], uv[:, 0, 1]))
    return uv[order[np.unique(np.linspace(0, len(uv) - 1, min(DOTS, len(uv))).astype(np.intp))]]


def _draw(window: Image8, places: Array, scale: float) -> Image8:
    """A half at its final size, with guides and dots."""
    size = max(1, int(window.shape[1] * scale)), max(1, int(window.shape[0] * scale))
    picture = np.ascontiguousarray(resize(window, *size, "area"))
    for number in range(1, GUIDES):
        row = number * size[1] // GUIDES
        picture[row] = picture[row] // 2 + np.array(GUIDE_COLOURS[number % 2], np.uint8) // 2
    for number, place in enumerate(places[np.isfinite(places).all(axis=1)]):
        at = int(place[0] * scale), int(place[1] * scale)
        cv2.circle(picture, at, 4, (255, 255, 255), -1, cv2.LINE_AA)
        cv2.circle(picture, at, 3, DOT_COLOURS[number % len(DOT_COLOURS)], -1, cv2.LINE_AA)
    return picture
