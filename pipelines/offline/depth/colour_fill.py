"""Unmeasured depth, filled along the edges of the colours: the Fast Global Smoother (Min et al.,
IEEE TIP 2014).
"""

import cv2
import numpy as np

from ggvs_eval.arrays import Image8, Map, Mask
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.tasks.identity import code_of

LEAST_WEIGHT = 1e-12  # of depth that reaches a pixel; below, none does
# lambda, weight of smoothness next to that of measured depth; its root is about the reach in pixels
STRENGTH = 900.0
LEVELS = 4.0  # difference of colours, of 255, across which smoothness counts for 1 / e
ROUNDS = 3  # passes along rows and columns
# neighbours whose depths differ by more than this share of the nearer one are an edge of depth ...
JUMP = 0.05
# ... and pixels this near to it are filled anew: sensors measure edges slightly off those of
# colours
EDGE_PX = 2
CONFIDENCE = 0.02  # of filled pixels


def describe_fill() -> dict[str, object]:
    """Return the fill as values that JSON knows, its code included; part of a depth map's key."""
    return {"algorithm": "fill-by-colour", "code": code_of(__name__)}


def fill_by_colour(depth_map: DepthMap, image: Image8) -> DepthMap:
    """Fill invalid pixels, and edges of depth, with the smooth inverse depth of what has their
    colour.

    Measured pixels count by their confidence.

    Args:
        depth_map: depth, world units, 0 = unknown, and confidence, (H, W).

    Returns:
        Depth and confidence, (H, W); depth is unknown only where no pixel was known.

    Reading:
        The paper takes depth without holes and names no fill. Chosen on validation data: nine views
        each of hand-held rooms (demo seeds 101-103) with blurred pictures and with misplaced depth,
        three of the rest of a real sequence; benchmarks/RESULTS.md has the gains. Of them 0.04 dB
        are due to `EDGE_PX`; a `STRENGTH` of 400 or 2000 loses 0.02 and 0.04 dB, 3 `LEVELS` 0.03.
    """
    depth_map = depth_map.clean()
    depth, confidence = depth_map.depth, depth_map.confidence
    unknown = (depth == 0) | beside_jumps(depth)
    if not unknown.any() or unknown.all():
        return depth_map
    inverse = np.divide(1, depth, out=np.zeros_like(depth), where=~unknown)
    weight = np.where(unknown, np.float32(0), np.maximum(confidence, np.float32(CONFIDENCE)))
    total, sure = np.moveaxis(
        smooth_by_colour(np.stack([weight * inverse, weight], axis=-1), image), -1, 0
    )
    filled = unknown & (sure > LEAST_WEIGHT) & (total > 0)
    result = np.where(filled, np.divide(sure, total, out=np.zeros_like(depth), where=filled), depth)
    return DepthMap(result, np.where(filled, np.float32(CONFIDENCE), confidence))


def beside_jumps(depth: Map) -> Mask:
    """Return the mask pixels near an edge between known depths, (H, W)."""
    neighbours, reach = np.ones((3, 3), np.uint8), 2 * EDGE_PX + 1
    farthest = cv2.dilate(depth, neighbours)
    nearest = cv2.erode(np.where(depth > 0, depth, np.float32(np.inf)), neighbours)
    jumps = farthest * np.float32(1 / (1 + JUMP)) > nearest
    return (
        cv2.dilate(
            jumps.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))
        )
        > 0
    )


def smooth_by_colour(
    maps: Map,
    image: Image8,
    strength: float = STRENGTH,
    levels: float = LEVELS,
    rounds: int = ROUNDS,
) -> Map:
    """Smooth maps within the edges of an image: weighted least squares along all rows, then along
    all columns, in some rounds.

    Each line minimises the sum of (u - f)^2 + lambda exp(-|difference of colours| / levels)
    (difference of u)^2; later rounds are weaker by four, so that streaks of the first go.

    Args:
        maps: f, (H, W, C), float32.
        image: guide, RGB, (H, W, 3).

    Returns:
        u, (H, W, C).
    """
    guide = image.astype(np.float32)
    along_rows, along_columns = _likeness(guide, levels), _likeness(guide.swapaxes(0, 1), levels)
    for _ in range(rounds):
        maps = _smooth_lines(maps, strength * along_rows)
        maps = _smooth_lines(maps.swapaxes(0, 1), strength * along_columns).swapaxes(0, 1)
        strength /= 4
    return maps


def _likeness(guide: Map, levels: float) -> Map:
    """Return the similarity of each pixel to the next one of its line, (N, M) in [0, 1].

    0 at the end of a line.
    """
    likeness = np.zeros(guide.shape[:2], np.float32)
    likeness[:, :-1] = np.exp(-np.linalg.norm(np.diff(guide, axis=1), axis=-1) / np.float32(levels))
    return likeness


def _smooth_lines(maps: Map, links: Map) -> Map:
    """Solve all lines (N, M, C) as one tridiagonal system: what links the last pixel of a line to
    the next line is 0.
    """
    from scipy.linalg import solve_banded  # late: every run imports this module, few fill depth

    above = links.ravel()
    below = np.concatenate([np.zeros(1, np.float32), above[:-1]])
    # LAPACK's form: the entry above the diagonal is in the next column
    bands = np.stack([-below, 1 + above + below, -above])
    lines = solve_banded(
        (1, 1), bands, maps.reshape(-1, maps.shape[2]), overwrite_ab=True, check_finite=False
    )
    return np.asarray(lines, np.float32).reshape(maps.shape)
