"""Depth of one camera brought to the grid of another: every pixel a small plane, the nearest of
them is seen.
"""

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array, Map
from ggvs_eval.camera import Camera
from ggvs_eval.errors import RenderError
from ggvs_eval.geometry.pinhole import as_image, rigid_between
from ggvs_eval.kernels.portable import transformed

# Neighbours whose depths differ by more than this share are on two surfaces, unless the surface is
# as steep as this.
STEP, STEEPEST_SLOPE = 0.02, 6.0
# A pixel is drawn over this many pixels of the other camera along a side at most: a denser sensor
# is sold everywhere.
LARGEST_FOOTPRINT_PX = 24
CORNERS = ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))


def reproject_depth(source: Camera, depth: NDArray[np.floating], target: Camera) -> Map:
    """Reproject the depth map of a depth camera into the target's view.

    Args:
        source: the depth camera.
        depth: its z, (H, W), world units, 0 = unknown.
        target: the camera on whose grid depth is wanted; of any size and field of view, near the
            source.

    Returns:
        z in the target camera, (H', W') float32, 0 if the source measured nothing that the target
        sees.

    Raises:
        RenderError: depth of another size than the source.

    Examples:
        >>> K = np.array([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]])
        >>> camera = Camera("cam00", K, np.eye(4), width=8, height=6, near=1.0, far=9.0)
        >>> depth = reproject_depth(camera, np.full((6, 8), 2.0), camera.resized(4, 3))
        >>> depth.shape, float(depth[1, 1])
        ((3, 4), 2.0)

    Reading:
        A pixel of the sensor represents the piece of plane that it covers: its inverse depth
        continues as that of its neighbours on the same surface does, so that planes stay planes and
        no gaps open where the target has more pixels. The target's pixel takes a piece when its
        centre is in the rectangle around the four projected corners; of several the nearest.
    """
    inverse, rows, columns, slopes = _pieces(source, depth)
    # (2, N)
    rays = np.stack(
        [
            (columns + 0.5 - source.K[0, 2]) / source.K[0, 0],
            (rows + 0.5 - source.K[1, 2]) / source.K[1, 1],
        ]
    )
    transform = rigid_between(source, target)
    low, high = _footprints(source, target, transform, rays, inverse, slopes)
    # The piece's plane: a x + b y + c z = 1 in the source's frame, n . X = 1 + n . t in the
    # target's. (N, 3)
    normals = np.stack([*slopes, inverse - (rays * slopes).sum(axis=0)]).T @ transform[:3, :3].T
    offsets = 1 + normals @ transform[:3, 3]  # (N,)
    return _draw(target, low, high, normals, offsets)


def _pieces(source: Camera, depth: NDArray[np.floating]) -> tuple[Array, Array, Array, Array]:
    """Inverse depth, row and column of each known pixel, (N,) each, and how inverse depth grows
    along the rays' axes, (2, N).
    """
    z = as_image(np.nan_to_num(depth, posinf=0, neginf=0), source, "depth", RenderError).astype(
        np.float64
    )
    rows, columns = np.nonzero(z > 0)
    # (2, N)
    slopes = np.stack([_slope(z, source.K[0, 0]), _slope(z.T, source.K[1, 1]).T])[:, rows, columns]
    return 1 / z[rows, columns], rows.astype(np.float64), columns.astype(np.float64), slopes


def _slope(z: Array, focal_px: float) -> Array:
    """Mean growth of inverse depth per unit of ray towards the two neighbours on the same surface
    along each row, (H, W).
    """
    step = max(STEP, STEEPEST_SLOPE / focal_px)
    before, after = z[:, :-1], z[:, 1:]
    joined = (
        (before > 0) & (after > 0) & (np.abs(after - before) <= step * np.minimum(before, after))
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        growth = np.where(joined, (1 / after - 1 / before) * focal_px, 0.0)
    total, count = np.zeros(z.shape), np.zeros(z.shape)
    total[:, :-1], count[:, :-1] = growth, joined
    total[:, 1:] += growth
    count[:, 1:] += joined
    return total / np.maximum(count, 1)


def _footprints(
    source: Camera, target: Camera, transform: Array, rays: Array, inverse: Array, slopes: Array
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first column and row of the target whose centre each piece covers, and one past
    the last, (2, N) each.
    """
    corners = []
    for across, down in CORNERS:
        shift = np.array([[across / source.K[0, 0]], [down / source.K[1, 1]]])
        z = 1 / np.maximum(inverse + (shift * slopes).sum(axis=0), 0.5 * inverse)
        points = (
            transformed(transform[:3, :3], np.concatenate([(rays + shift) * z, z[None]]).T)
            + transform[:3, 3]
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            uv = points[:, :2] / points[:, 2:] * target.K[[0, 1], [0, 1]] + target.K[:2, 2]
        corners.append(np.where(points[:, 2:] > 0, uv, np.nan).T)
    size = np.array([[target.width], [target.height]], np.float64)
    quads = np.stack(corners)  # (4, 2, N)
    is_finite = np.isfinite(quads).all(axis=(0, 1))
    quads = np.where(is_finite, quads, -1.0)
    low, high = (
        np.ceil(np.clip(corner, 0, size) - 0.5).astype(np.int64)
        for corner in (quads.min(axis=0), quads.max(axis=0))
    )
    return low, np.minimum(high, low + LARGEST_FOOTPRINT_PX)


def _draw(
    target: Camera, low: NDArray[np.int64], high: NDArray[np.int64], normals: Array, offsets: Array
) -> Map:
    """Return the nearest piece in each pixel, (H, W).

    One pass for each place within the largest footprint.
    """
    nearest = np.full(target.height * target.width, np.inf)
    widths, heights = high - low
    for down in range(int(heights.max(initial=0))):
        tall = np.flatnonzero((heights > down) & (widths > 0))
        for across in range(int(widths[tall].max(initial=0))):
            pieces = tall[widths[tall] > across]
            column, row = low[0, pieces] + across, low[1, pieces] + down
            x, y = (
                (at + 0.5 - target.K[axis, 2]) / target.K[axis, axis]
                for axis, at in ((0, column), (1, row))
            )
            normal = normals[pieces]
            inverse = (normal[:, 0] * x + normal[:, 1] * y + normal[:, 2]) / offsets[pieces]
            with np.errstate(divide="ignore", invalid="ignore"):
                z = np.where(inverse > 0, 1 / inverse, np.inf)
            np.minimum.at(nearest, row * target.width + column, z)
    return (
        np.where(np.isfinite(nearest), nearest, 0)
        .astype(np.float32)
        .reshape(target.height, target.width)
    )
