"""Pairs of cameras before any stereo: how well matched features keep to their rows once rectified,
as numbers and picture.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array, Image8
from ggvs_eval.camera import Camera
from ggvs_eval.errors import DepthError
from ggvs_eval.files.images import resize
from ggvs_eval.geometry.epipolar import Features, match_pair
from ggvs_eval.geometry.rectification import RectifiedPair, rectify
from ggvs_eval.geometry.source_views import turn_rad

# a disparity counts as outside its range only beyond this, the error of a feature's place
SLACK_PX = 1.0
WIDTH_PX = 640  # of a picture
HEIGHT_PX = 400  # of each half
GAP_PX = 4
GUIDES = 12
DOTS = 14
GREY = 128
GUIDE_COLOURS = ((240, 228, 66), (86, 180, 233))  # yellow and sky blue, of Okabe and Ito's colours
DOT_COLOURS = ((213, 94, 0), (0, 158, 115), (204, 121, 167), (0, 114, 178), (230, 159, 0))


@dataclass(frozen=True)
class PairErrors:
    """A camera, a partner, and the errors of their matched features.

    Attributes:
        baseline: distance of their centres, world units.
        d_min: smallest disparity that is looked for, pixels.
        d_max: largest.
        matches: number of matched features; 0 where too few agree with each other to say anything.
        row_px: median distance from the row where a match belongs, pixels; 0 without matches, and
            so are the next two.
        row_high_px: distance that one match in ten exceeds.
        outside: share of matches whose disparity is not looked for.
        obstacle: why the two cannot be rectified, and nothing above was measured; empty if they
            can.
    """

    camera: str
    partner: str
    baseline: float
    angle_rad: float
    d_min: int = 0
    d_max: int = 0
    matches: int = 0
    row_px: float = 0.0
    row_high_px: float = 0.0
    outside: float = 0.0
    obstacle: str = ""


def measure_pair(
    camera: Camera, partner: Camera, features: Features, partner_features: Features
) -> tuple[PairErrors, Array]:
    """Match two images and see how far their matches miss the common row, and whether their
    disparities are looked for.

    Matches are chosen without any calibration, by the epipolar geometry that most of them share: a
    calibration that is wrong cannot choose those that fit it.

    Returns:
        The errors, and the matches as pixels of the two images, (M, 2, 2).
    """
    baseline = float(np.linalg.norm(partner.centre - camera.centre))
    errors = PairErrors(
        camera=camera.name,
        partner=partner.name,
        baseline=baseline,
        angle_rad=turn_rad(camera, partner),
    )
    uv = np.zeros((0, 2, 2))
    try:
        pair = rectify(camera, partner)
    except DepthError as error:  # a plane sweep needs no rectification
        return replace(errors, obstacle=str(error)), uv
    errors = replace(errors, d_min=pair.d_min, d_max=pair.d_max)
    longest_side_px = max(*camera.size, *partner.size)
    matched = match_pair(0, 1, features, partner_features, longest_side_px)
    if matched is not None:
        uv = np.stack([matched.uv_first, matched.uv_second], axis=1)
    places = on_canvas(pair, camera, partner, uv)
    places = places[np.isfinite(places).all(axis=(1, 2))]
    if not len(places):
        return errors, uv
    disparity_px, off_px = (
        places[:, 0, 0] - places[:, 1, 0],
        np.abs(places[:, 0, 1] - places[:, 1, 1]),
    )
    outside = (disparity_px < pair.d_min - SLACK_PX) | (disparity_px > pair.d_max + SLACK_PX)
    row_px, row_high_px = np.percentile(off_px, (50, 90))
    errors = replace(
        errors,
        matches=len(places),
        row_px=float(row_px),
        row_high_px=float(row_high_px),
        outside=float(outside.mean()),
    )
    return errors, uv


def on_canvas(pair: RectifiedPair, camera: Camera, partner: Camera, uv: Array) -> Array:
    """Map matched pixels to the rectified canvas.

    Args:
        uv: pixels of the two images, (M, 2, 2).

    Returns:
        Pixels of the canvas (pixel centres at halves), (M, 2, 2); not finite where a ray does not
        meet it.
    """
    rotations = (pair.rotation, pair.rotation @ camera.rotation @ partner.rotation.T)
    places = []
    for seen_by, rotation, pixels in zip(
        (camera, partner), rotations, np.moveaxis(uv, 1, 0), strict=True
    ):
        ray = np.concatenate(
            [(pixels - seen_by.K[:2, 2]) / seen_by.K[[0, 1], [0, 1]], np.ones((len(pixels), 1))],
            axis=1,
        )
        x, y, z = pair.projection @ rotation @ ray.T
        with np.errstate(divide="ignore", invalid="ignore"):
            places.append(np.where(z > 0, (x / z, y / z), np.nan).T)
    return np.stack(places, axis=1)


class PairPicture(NamedTuple):
    """A rectified pair to look at.

    Attributes:
        image: RGB uint8, (H, W, 3).
        beside: True if the camera is on the left and its partner on the right, False if it is above
            it.
    """

    image: Image8
    beside: bool


def pair_picture(
    pair: RectifiedPair,
    camera: Camera,
    partner: Camera,
    image: Image8,
    partner_image: Image8,
    uv: Array,
) -> PairPicture:
    """Put the two rectified images side by side, with lines along their common rows and dots on a
    few matched features.

    The canvas of a partner on the left is upside down, that of one above or below is on its side:
    pictures are turned back. Rows become columns where that takes a quarter turn, and the halves
    are one above the other.

    Args:
        image: of the reference, RGB (H, W, 3).
        uv: matched pixels of the two, (M, 2, 2).
    """
    turns = _turns_upright(pair.rotation[0])
    rows = _span(pair.left_inside | pair.right_inside, axis=1)
    places = on_canvas(pair, camera, partner, _spread(uv))  # (N, 2, 2)
    sides = (
        (pair.warp_left(image), pair.left_inside),
        (pair.warp_right(partner_image), pair.right_inside),
    )
    columns = [_span(inside, axis=0) for _, inside in sides]
    scale = _scale(turns, rows, columns)
    halves = []
    for side, ((warped, inside), span) in enumerate(zip(sides, columns, strict=True)):
        window = np.where(inside[..., None], warped, np.uint8(GREY))[rows, span]
        corner = np.array([span.start, rows.start])
        halves.append(_draw(window, (places[:, side] - corner), scale))
    beside = turns % 2 == 0
    joined = [np.rot90(half, turns) for half in halves]
    gap = np.full(
        (joined[0].shape[0], GAP_PX, 3) if beside else (GAP_PX, joined[0].shape[1], 3),
        GREY,
        np.uint8,
    )
    return PairPicture(np.concatenate([joined[0], gap, joined[1]], axis=1 if beside else 0), beside)


def _turns_upright(along: Array) -> int:
    """Return the quarter turns, counter-clockwise, that turn a canvas whose x axis points `along`
    in the camera upright.
    """
    if abs(along[0]) >= abs(along[1]):
        return 0 if along[0] > 0 else 2
    return 3 if along[1] > 0 else 1


def _span(inside: NDArray[np.bool_], axis: int) -> slice:
    """From the first to the last row (axis 1) or column (axis 0) with anything inside."""
    indices = np.flatnonzero(inside.any(axis=axis))
    return slice(int(indices[0]), int(indices[-1]) + 1) if indices.size else slice(0, 1)


def _scale(turns: int, rows: slice, columns: list[slice]) -> float:
    """Return the scale that fits both halves into the picture; nothing is magnified."""
    height, width = rows.stop - rows.start, max(span.stop - span.start for span in columns)
    if turns % 2 == 0:
        return min(1.0, (WIDTH_PX - GAP_PX) / 2 / width)
    return min(1.0, WIDTH_PX / height, HEIGHT_PX / width)


def _spread(uv: Array) -> Array:
    """Return a few of the matches, from all over the first image's rows."""
    order = np.lexsort((uv[:, 0, 0], uv[:, 0, 1]))
    return uv[order[np.unique(np.linspace(0, len(uv) - 1, min(DOTS, len(uv))).astype(np.intp))]]


def _draw(window: Image8, places: Array, scale: float) -> Image8:
    """Return a half at its final size, with guides and dots."""
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
