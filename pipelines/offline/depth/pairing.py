"""Choice of the cameras to match a camera with, by what they see together.

Replaces the paper's manual selection of stereo pairs.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera
from ggvs_eval.datasets.depth_range import RANGE_MEND
from ggvs_eval.errors import DepthError
from ggvs_eval.geometry.rectification import can_rectify
from ggvs_eval.geometry.source_views import sample_view, share_of_view, turn_rad

GRID = (16, 12)  # rays across and down
DEPTHS = 6  # depths per ray, evenly spaced in inverse depth
MAX_ANGLE_RAD = np.deg2rad(45.0)  # beyond, surfaces look too different for a pair, ...
# up to here the nearest surfaces may move by more than the images overlap
CLOSE_ANGLE_RAD = np.deg2rad(36.0)
MAX_VIEW_ANGLE_RAD = np.deg2rad(75.0)  # ... and for a network that weighs what several partners see
MAX_NEAR_DISPARITY = 0.25  # of the image's width
MIN_MEDIAN_DISPARITY = 0.006  # of the image's width; 8 px of 1352
MIN_OVERLAP = 0.2
# how much of a point's worth a partner on the same side of the camera takes away from the next one
SAME_SIDE = 0.6
OTHER_SIDE = 0.3


@dataclass(frozen=True, eq=False)
class Partner:
    """Worth of a candidate to a camera.

    Attributes:
        worth: 0 outside its image, else the quality of the match there, for each sample point,
            (S,).
        direction: from the camera to the candidate in the camera's image plane, unit vector, (2,).
    """

    camera: Camera
    worth: Array
    direction: Array


def choose_partners(
    camera: Camera,
    candidates: Sequence[Camera],
    count: int,
    excluded: Collection[str] = (),
    views: int = 0,
) -> list[Camera]:
    """Choose the cameras whose stereo with `camera` sees most of its view, from different sides,
    best first.

    Partners are taken one by one. A candidate is worth the sum over points of the camera's view, at
    depths from near to far, of the quality of its match where it sees the point; each partner
    already taken lowers what a point is still worth, more so from the same side: what is hidden
    from a partner on the right, one on the left sees.

    Args:
        candidates: cameras to choose from; `camera` itself is passed over.
        count: how many to choose at most; fewer come back where fewer can be matched.
        excluded: names that must not be chosen (the target of a leave-one-out run).
        views: total for a network that uses them at once: those after `count` can be farther apart,
            and need no common rectification, which wide pairs of near surfaces do not have.
    """
    passed_over = {camera.name, *excluded}
    rivals = sorted(
        (candidate for candidate in candidates if candidate.name not in passed_over),
        key=lambda candidate: candidate.name,
    )
    points = sample_view(camera, GRID, DEPTHS)
    pairs = _extend([], camera, rivals, points, count, MAX_ANGLE_RAD, rectified=True)
    partners = _extend(pairs, camera, rivals, points, views, MAX_VIEW_ANGLE_RAD, rectified=False)
    if not partners:
        degrees = np.rad2deg(MAX_VIEW_ANGLE_RAD if views else MAX_ANGLE_RAD)
        raise DepthError(
            f"camera {camera.name}: wanted a partner that sees {MIN_OVERLAP:.0%} of its view, got "
            f"none of {len(rivals)} cameras, {camera.near:.3g} .. {camera.far:.3g} deep "
            f"({camera.range_origin}), from less than {degrees:.0f} degrees away; add cameras, or "
            f"correct the depth range: {RANGE_MEND}"
        )
    return [partner.camera for partner in partners]


def pairs_of(camera: Camera, partners: Sequence[Camera], count: int) -> list[Camera]:
    """Return the first of `choose_partners`' views, which can be matched pair by pair."""
    points = sample_view(camera, GRID, DEPTHS)
    return [
        partner
        for partner in partners[:count]
        if _evaluate(camera, partner, points, MAX_ANGLE_RAD) and _can_be_matched(camera, partner)
    ]


def _extend(
    partners: Sequence[Partner],
    camera: Camera,
    candidates: Sequence[Camera],
    points: Array,
    count: int,
    max_angle_rad: float,
    *,
    rectified: bool,
) -> list[Partner]:
    """Up to `count` partners, those of `partners` first, each with the largest gain after those
    before.
    """
    partners, names = list(partners), {partner.camera.name for partner in partners}
    left = [
        partner
        for candidate in candidates
        if candidate.name not in names
        and (partner := _evaluate(camera, candidate, points, max_angle_rad)) is not None
    ]
    while left and len(partners) < count:
        best = max(left, key=lambda partner: _gain(partner, partners))
        left.remove(best)
        if not rectified or _can_be_matched(camera, best.camera):
            partners.append(best)
    return partners


def _can_be_matched(camera: Camera, partner: Camera) -> bool:
    """Return whether a pair can be rectified and is worth its search, which is as wide as its
    nearest surfaces move.
    """
    return can_rectify(
        camera, partner, nearest=np.inf if turn_rad(camera, partner) <= CLOSE_ANGLE_RAD else 1.0
    )


def _evaluate(
    camera: Camera, partner: Camera, points: Array, max_angle_rad: float
) -> Partner | None:
    """Evaluate what `partner` is worth to `camera`; None if a match makes no sense."""
    uv, depth = partner.project(points)
    inside = (depth > 0) & ((uv > 0) & (uv < partner.size)).all(axis=-1)  # (S,)
    angle = turn_rad(camera, partner)
    offset = camera.rotation @ (partner.centre - camera.centre)
    distance = float(np.linalg.norm(offset[:2]))
    if (
        share_of_view(camera, inside, DEPTHS) < MIN_OVERLAP
        or angle > max_angle_rad
        or distance <= abs(offset[2])
    ):
        return None
    median_depth = 2 / (1 / camera.near + 1 / camera.far)
    disparity = camera.focal_px * distance / np.array([camera.near, median_depth]) / camera.width
    fitness = min(1.0, MAX_NEAR_DISPARITY / disparity[0]) * min(
        1.0, disparity[1] / MIN_MEDIAN_DISPARITY
    )
    return Partner(partner, inside * fitness * np.cos(angle), offset[:2] / distance)


def _gain(partner: Partner, partners: Sequence[Partner]) -> float:
    left = np.ones_like(partner.worth)
    for rival in partners:
        likeness = max(0.0, float(partner.direction @ rival.direction))
        left *= 1 - (OTHER_SIDE + (SAME_SIDE - OTHER_SIDE) * likeness) * (rival.worth > 0)
    return float((partner.worth * left).sum())
