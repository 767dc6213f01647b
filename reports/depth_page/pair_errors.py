"""How well two calibrated cameras agree before any stereo: matched features on the rows they must share once rectified."""

from dataclasses import dataclass, replace

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera
from ggvs_eval.errors import DepthError
from ggvs_eval.geometry.epipolar import match_pair
from ggvs_eval.geometry.features import Features
from ggvs_eval.geometry.rectification import RectifiedPair, rectify

SLACK_PX = 1.0  # a disparity counts as outside its range only beyond this, the error of a feature's place


@dataclass(frozen=True)
class PairErrors:
    """A camera, one it is matched with, and what matched features say of the two.

    Attributes:
        camera: whose depth is wanted.
        partner: the other.
        baseline: distance of their centres, world units.
        angle_rad: between their viewing directions.
        d_min: smallest disparity that is looked for, pixels.
        d_max: largest.
        matches: number of matched features; 0 where too few agree with each other to say anything.
        row_px: median distance from the row where a match belongs, pixels; 0 without matches, and so are the next two.
        row_high_px: distance that one match in ten exceeds.
        outside: share of matches whose disparity is not looked for.
        obstacle: why the two cannot be rectified, and nothing above was measured; empty where they can.
    """

    camera: str
    partner: str
    baseline: float
    angle_rad: float
    d_min: int
    d_max: int
    matches: int
    row_px: float
    row_high_px: float
    outside: float
    obstacle: str = ""


def measure_pair(camera: Camera, partner: Camera, features: Features, partner_features: Features) -> tuple[PairErrors, Array]:
    """Match two images and see how far their matches miss the common row, and whether their disparities are looked for.

    Matches are chosen without any calibration, by the epipolar geometry that most of them share: a calibration that is wrong
    cannot choose those that fit it.

    Args:
        camera: whose depth is wanted.
        partner: a camera it is matched with.
        features: of an image of the camera.
        partner_features: of the partner's image of the same instant.

    Returns:
        The errors, and the matches as pixels of the two images, (M, 2, 2).
    """
    try:
        pair = rectify(camera, partner)
    except DepthError as error:  # a plane sweep needs no rectification
        return _unmeasured(camera, partner, str(error)), np.zeros((0, 2, 2))
    longest_side_px = max(*camera.size, *partner.size)
    matched = match_pair(0, 1, features, partner_features, longest_side_px)
    uv = np.zeros((0, 2, 2)) if matched is None else np.stack([matched.uv_first, matched.uv_second], axis=1)
    return _evaluate(camera, partner, pair, uv), uv


def on_canvas(pair: RectifiedPair, camera: Camera, partner: Camera, uv: Array) -> Array:
    """Bring matched pixels to the rectified canvas.

    Args:
        pair: the rectification of the two cameras.
        camera: the one that plays the left image.
        partner: the one that plays the right.
        uv: pixels of the two images, (M, 2, 2).

    Returns:
        Pixels of the canvas (pixel centres at halves), (M, 2, 2); not finite where a ray does not meet it.
    """
    rotations = (pair.rotation, pair.rotation @ camera.rotation @ partner.rotation.T)
    places = []
    for each, rotation, pixels in zip((camera, partner), rotations, np.moveaxis(uv, 1, 0), strict=True):
        ray = np.concatenate([(pixels - each.K[:2, 2]) / each.K[[0, 1], [0, 1]], np.ones((len(pixels), 1))], axis=1)
        x, y, z = pair.projection @ rotation @ ray.T
        with np.errstate(divide="ignore", invalid="ignore"):
            places.append(np.where(z > 0, (x / z, y / z), np.nan).T)
    return np.stack(places, axis=1)


def _evaluate(camera: Camera, partner: Camera, pair: RectifiedPair, uv: Array) -> PairErrors:
    places = on_canvas(pair, camera, partner, uv)
    places = places[np.isfinite(places).all(axis=(1, 2))]
    if not len(places):
        unknown = _unmeasured(camera, partner, "")
        return replace(unknown, d_min=pair.d_min, d_max=pair.d_max)
    disparity_px, off_px = places[:, 0, 0] - places[:, 1, 0], np.abs(places[:, 0, 1] - places[:, 1, 1])
    outside = (disparity_px < pair.d_min - SLACK_PX) | (disparity_px > pair.d_max + SLACK_PX)
    row_px, row_high_px = np.percentile(off_px, (50, 90))
    return replace(
        _unmeasured(camera, partner, ""),
        d_min=pair.d_min,
        d_max=pair.d_max,
        matches=len(places),
        row_px=float(row_px),
        row_high_px=float(row_high_px),
        outside=float(outside.mean()),
    )


def _unmeasured(camera: Camera, partner: Camera, obstacle: str) -> PairErrors:
    baseline = float(np.linalg.norm(partner.centre - camera.centre))
    angle_rad = float(np.arccos(np.clip(camera.axis @ partner.axis, -1, 1)))
    return PairErrors(camera.name, partner.name, baseline, angle_rad, 0, 0, 0, 0.0, 0.0, 0.0, obstacle)
