"""The backward warp in a page of numpy."""

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera
from ggvs_eval.geometry.warp import Warp
from ggvs_eval.pipelines.online.printed_march import sample_depth


def warp_twin(
    target: Camera,
    target_depth: NDArray,
    source: Camera,
    image: NDArray,
    source_depth: NDArray,
    tolerance: float,
    *,
    bicubic: bool = False,
    forgiven_px: float = 0.0,
) -> Warp:
    """What `ggvs_eval.geometry.warp` computes."""
    size = (target.height, target.width)
    largest_px = source.focal_px * np.linalg.norm(source.centre - target.centre) / target.near
    surface = np.where(
        target_depth > 0, target_depth, target.far * (0 < forgiven_px >= largest_px)
    ).astype(np.float64)
    points = target.unproject(target.pixel_centres(), surface).reshape(-1, 3)
    uv, z = source.project(points)
    seen = (
        (surface.reshape(-1) > 0)
        & (z > 0)
        & (uv >= 0).all(axis=1)
        & (uv < [source.width, source.height]).all(axis=1)
    )
    uv = np.where(seen[:, None], uv, 0.5)
    # the kernel repeats the border
    there = sample_depth(np.pad(source_depth, (0, 1), "edge"), *uv.T, tolerance)
    agreement = np.clip(2 - np.abs(there - z) / tolerance, 0, 1) * (there > 0)
    # the error of depth that moves the point by `forgiven_px`; unknown depth is infinite
    if forgiven_px:
        inverse = np.divide(1, there, out=np.zeros(len(z)), where=there > 0)
        moved_px = (
            source.focal_px
            * np.linalg.norm(source.centre - target.centre)
            * np.abs(inverse - 1 / np.where(seen, z, 1))
        )
        agreement = np.maximum(agreement, np.clip(2 - moved_px / forgiven_px, 0, 1))
    visibility = np.where(seen, agreement, 0.0)
    colour = np.where(seen[:, None], _sample_colour(image.astype(np.float64), uv, bicubic), 0.0)
    return Warp(
        colour.reshape(*size, 3).astype(np.float32), visibility.reshape(size).astype(np.float32)
    )


def _sample_colour(image: Array, uv: Array, bicubic: bool) -> Array:
    """Separable interpolation between pixel centres with the border repeated."""
    height, width = image.shape[:2]
    x, y = (uv - 0.5).T
    result = np.zeros((len(uv), 3))
    for j in range(-1, 3):
        for i in range(-1, 3):
            row, column = np.floor(y).astype(int) + j, np.floor(x).astype(int) + i
            weight = _kernel(y - row, bicubic) * _kernel(x - column, bicubic)
            result += weight[:, None] * image[row.clip(0, height - 1), column.clip(0, width - 1)]
    return result.clip(0, 1) if bicubic else result


def _kernel(distance: Array, bicubic: bool) -> Array:
    """Tent, or Keys' cubic with a = -1/2 (Catmull-Rom)."""
    d = np.abs(distance)
    if not bicubic:
        return np.maximum(1 - d, 0)
    near = 1 - 2.5 * d**2 + 1.5 * d**3
    return np.where(d <= 1, near, np.where(d < 2, 2 - 4 * d + 2.5 * d**2 - 0.5 * d**3, 0))
