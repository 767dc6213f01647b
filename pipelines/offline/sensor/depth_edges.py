"""Edges of surfaces in depth, and how well they lie on edges of colour."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array, Image8, Map

# The background is farther by this share, the foreground's own depth differs by less within so many pixels of its edge.
STEP, SMOOTH, INSIDE_PX = 0.06, 0.03, 3
# Sensors lose the pixels between two surfaces: holes up to this share of the image's width are looked across.
HOLE = 0.025
# Half of the largest response is a gradient of twice the image's median, and half a level of 255 where there is none.
GRADIENT_FACTOR, LEAST_GRADIENT = 2.0, 0.5


@dataclass(frozen=True, eq=False)
class DepthEdges:
    """Places where a near surface ends before a far one.

    Attributes:
        uv: on the border of the last pixel of the near surface, pixels, (N, 2).
        upright: whether the edge runs up and down, the far surface beside it; else it lies below or above, (N,).
        depth: of the near surface, (N,).
    """

    uv: Array
    upright: NDArray[np.bool_]
    depth: Array

    def thinned(self, most: int) -> "DepthEdges":
        """At most so many of them, evenly chosen."""
        if len(self.uv) <= most:
            return self
        chosen = np.linspace(0, len(self.uv) - 1, most).round().astype(np.intp)
        return DepthEdges(self.uv[chosen], self.upright[chosen], self.depth[chosen])


def find_edges(depth: Map) -> DepthEdges:
    """Edges along the rows and the columns of a depth map, (H, W), 0 = unknown."""
    hole_px = round(HOLE * depth.shape[1])
    edges = []
    for upright in (True, False):
        lines = depth if upright else depth.T
        for mirrored in (False, True):
            row, place, z = _edges_to_the_right(lines[:, ::-1] if mirrored else lines, hole_px)
            place = lines.shape[1] - place if mirrored else place
            uv = np.stack((place, row) if upright else (row, place), axis=1)
            edges.append(DepthEdges(uv, np.full(len(z), upright), z))
    return DepthEdges(*(np.concatenate([getattr(part, name) for part in edges]) for name in ("uv", "upright", "depth")))


def _edges_to_the_right(lines: Map, hole_px: int) -> tuple[Array, Array, Array]:
    """Row, column of the border and depth of surfaces that have a farther one to their right, (N,) each."""
    width = lines.shape[1]
    columns = np.broadcast_to(np.arange(width), lines.shape)
    following = np.full(lines.shape, width)  # column of the next known pixel
    following[:, :-1] = np.minimum.accumulate(np.where(lines > 0, columns, width)[:, :0:-1], axis=1)[:, ::-1]
    row, near = np.nonzero((lines > 0) & (following < width) & (following - columns <= hole_px + 1) & (columns >= INSIDE_PX))
    far = following[row, near]
    z, behind = lines[row, near], lines[row, np.minimum(far + INSIDE_PX, width - 1)]
    is_edge = (np.minimum(lines[row, far], behind) > (1 + STEP) * z) & (np.abs(lines[row, near - INSIDE_PX] - z) < SMOOTH * z)
    return row[is_edge] + 0.5, near[is_edge] + 1.0, z[is_edge].astype(np.float64)


def edge_response(image: Image8, sigma_px: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Measure how much like an edge every pixel looks, in [0, 1): vertical edges and horizontal ones, (H, W) each.

    Args:
        image: RGB, (H, W, 3).
        sigma_px: of the smoothing before the gradient of the three Lab channels is taken.
    """
    lab = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_RGB2LAB).astype(np.float32), (0, 0), sigma_px)
    across, down = (np.sqrt((cv2.Sobel(lab, cv2.CV_32F, *order, ksize=3) ** 2).sum(axis=-1)) / 8 for order in ((1, 0), (0, 1)))
    half = GRADIENT_FACTOR * float(np.median([across, down])) + LEAST_GRADIENT
    return across / (across + half), down / (down + half)


def responses_at(
    response: tuple[NDArray[np.float32], NDArray[np.float32]], upright: NDArray[np.bool_], uv: Array
) -> NDArray[np.float32]:
    """The response of colour to upright and lying edges at uv, (N,).

    Cubic interpolation: a linear one is blunt between pixels, which would draw edges to pixels' centres.
    """
    result = np.empty(len(uv), np.float32)
    for is_upright, values in zip((True, False), response, strict=True):
        chosen = upright == is_upright
        x, y = ((uv[chosen, axis] - 0.5).astype(np.float32)[:, None] for axis in (0, 1))
        if len(x):
            result[chosen] = cv2.remap(values, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT).ravel()
    return result
