"""Normals of the surfaces in a depth map."""

import numpy as np

from ggvs_eval.arrays import Array, Map
from ggvs_eval.camera import Camera

RADIUS_PX = 3  # of the window that a plane is fitted to
SAME_SURFACE = 0.03  # neighbours whose depth differs by a larger share belong to another surface
FEWEST = 8  # neighbours that decide on a plane


def surface_normals(camera: Camera, depth: Map) -> Map:
    """Unit normals in the camera's frame, towards the camera, by a plane fitted around each pixel.

    A plane n . p = d is linear in inverse depth, n . (x, y, 1) = d / z along the ray (x, y, 1), so that least squares over the
    neighbours of the same surface give its normal.

    Args:
        camera: the camera of the depth map.
        depth: (H, W), z in world units, 0 = invalid.

    Returns:
        (H, W, 3) float32; 0 where the depth is invalid or too few neighbours lie on the same surface.
    """
    sums = _window_sums(depth)
    determined = (depth > 0) & (sums[5] >= FEWEST)
    across, down, level, determinant = _solve(*sums.astype(np.float64))
    determined &= determinant > 1.0
    x, y = np.moveaxis((camera.pixel_centres() - camera.K[:2, 2]) / camera.K[[0, 1], [0, 1]], -1, 0)
    across, down = across * camera.K[0, 0], down * camera.K[1, 1]
    away = np.stack([across, down, 1 + level - across * x - down * y], axis=-1)  # (H, W, 3)
    normals = -away / np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-30)
    return np.where(determined[..., None], normals, 0).astype(np.float32)


def _window_sums(depth: Map) -> Map:
    """Normal equations of inverse depth over that of the middle pixel, less 1, as a linear function of column and row.

    Returns:
        Sums over the neighbours of the same surface, (9, H, W): column^2, column row, row^2, column, row, 1, and of the excess
        times column, row and 1.
    """
    height, width = depth.shape
    padded = np.pad(depth, RADIUS_PX)
    sums = np.zeros((9, height, width), np.float32)
    for row, column in np.ndindex(2 * RADIUS_PX + 1, 2 * RADIUS_PX + 1):
        neighbour = padded[row : row + height, column : column + width]
        same = (depth > 0) & (neighbour > 0) & (np.abs(neighbour - depth) <= SAME_SURFACE * depth)
        excess = np.divide(depth - neighbour, neighbour, out=np.zeros_like(depth), where=same)
        u, v = np.float32(column - RADIUS_PX), np.float32(row - RADIUS_PX)
        for total, factor in zip(sums[:6], (u * u, u * v, v * v, u, v, np.float32(1)), strict=True):
            np.add(total, factor, out=total, where=same)
        for total, factor in zip(sums[6:], (u, v, np.float32(1)), strict=True):
            total += factor * excess
    return sums


def _solve(
    uu: Array, uv: Array, vv: Array, u: Array, v: Array, one: Array, ru: Array, rv: Array, r: Array
) -> tuple[Array, Array, Array, Array]:
    """Cramer's rule for the slopes across and down, the level, and the determinant, (H, W) each."""
    a, b, c = vv * one - v * v, u * v - uv * one, uv * v - u * vv
    d, e, f = uu * one - u * u, u * uv - uu * v, uu * vv - uv * uv
    determinant: Array = uu * a + uv * b + u * c
    safe = np.where(determinant > 0, determinant, 1.0)
    return (a * ru + b * rv + c * r) / safe, (b * ru + d * rv + e * r) / safe, (c * ru + e * rv + f * r) / safe, determinant
