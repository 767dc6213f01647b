"""Which cameras are compared with which, and the points they share."""

from collections.abc import Iterable, Sequence

import numpy as np

from ggvs_eval.camera import Camera
from ggvs_eval.geometry.epipolar import MatchedPair, match_pair
from ggvs_eval.pipelines.inspection.capture.camera_record import CameraRecord
from ggvs_eval.progress import track

# Enough that a camera between two faulty neighbours still has honest ones.
NEIGHBOURS = 5


def neighbour_pairs(cameras: Sequence[Camera], count: int = NEIGHBOURS) -> list[tuple[int, int]]:
    """Every camera with its `count` nearest, each pair once, smaller index first.

    Near means near in place and in viewing direction: cameras back to back stand close and share nothing.
    """
    pairs = set()
    for index, camera in enumerate(cameras):
        order = sorted((_remoteness(camera, other), place) for place, other in enumerate(cameras) if place != index)
        pairs |= {(min(index, place), max(index, place)) for _, place in order[:count]}
    return sorted(pairs)


def match_pairs(
    cameras: Sequence[Camera], records: Sequence[CameraRecord], pairs: Iterable[tuple[int, int]]
) -> list[MatchedPair]:
    """Match the first frames of each pair; pairs that share too little are left out."""
    found = []
    for i, j in track(list(pairs), "matching neighbours"):
        one, other = records[i].features, records[j].features
        if one is not None and other is not None:
            found.append(match_pair(i, j, one, other, max(*cameras[i].size, *cameras[j].size)))
    return [pair for pair in found if pair is not None]


def _remoteness(camera: Camera, other: Camera) -> float:
    """Distance of the centres, doubled at 90 degrees between the axes and tripled back to back."""
    distance = float(np.linalg.norm(camera.centre - other.centre))
    return distance * (2.0 - float(camera.axis @ other.axis))
