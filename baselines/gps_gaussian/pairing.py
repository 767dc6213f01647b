"""Which two source cameras are taken as a stereo pair."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from ggvs_eval.baselines.gps_gaussian.rectification import rectify
from ggvs_eval.camera import Camera
from ggvs_eval.errors import RenderError


def choose_pairs(target: Camera, cameras: Sequence[Camera], count: int) -> list[tuple[int, int]]:
    """The nearest pairs that can be rectified; no camera stands in two of them.

    Args:
        target: the camera to synthesise.
        cameras: the source cameras.
        count: pairs wanted; fewer come back where there are no more.

    Returns:
        Indices of the cameras of each pair, nearest pair first; in each, left camera first.

    Raises:
        RenderError: no two of the cameras can be rectified.

    Reading:
        The authors name their pair by hand: the neighbours between which the target stands on a ring. Here it is the rectifiable
        pair with the smallest sum of distances to the target, ties in the order of the sources.
    """
    distances = [float(np.linalg.norm(camera.centre - target.centre)) for camera in cameras]
    chosen: list[tuple[int, int]] = []
    refusals: list[str] = []
    for first, second in sorted(combinations(range(len(cameras)), 2), key=lambda pair: distances[pair[0]] + distances[pair[1]]):
        if len(chosen) == count:
            break
        if any(camera in pair for pair in chosen for camera in (first, second)):
            continue
        ordered = _in_order(cameras, first, second)
        try:
            rectify(cameras[ordered[0]], cameras[ordered[1]])
        except RenderError as error:
            refusals.append(str(error))
            continue
        chosen.append(ordered)
    if not chosen:
        raise RenderError(f"GPS-Gaussian needs a stereo pair among the sources; {refusals[0] if refusals else 'got one camera'}")
    return chosen


def _in_order(cameras: Sequence[Camera], first: int, second: int) -> tuple[int, int]:
    """Left camera first; of two that stand on top of each other the upper one."""
    one, other = cameras[first], cameras[second]
    towards = other.centre - one.centre
    across, down = ((one.rotation + other.rotation) @ towards)[:2]
    leading = across if abs(across) >= abs(down) else down
    return (first, second) if leading >= 0 else (second, first)
