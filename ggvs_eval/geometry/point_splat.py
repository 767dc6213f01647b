"""Forward rendering of bare points: a Gaussian that ends at the border of the pixel it falls into."""

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.camera import Camera
from ggvs_eval.errors import RenderError
from ggvs_eval.geometry.pinhole import as_image, rigid_between
from ggvs_eval.geometry.splat import PixelGaussians, Splat

OPAQUE = 0.99  # the most that one opaque Gaussian covers, see `splat`


def splat_points(source: PixelGaussians, target: Camera, *, near: float) -> Splat:
    """Render the pixels of one source as points: each falls into one pixel of the target, where the nearest is seen.

    The limit of `splat` for Gaussians that shrink to nothing and are still opaque in the middle; magnification opens holes.

    Args:
        source: the view.
        target: the camera to render.
        near: points at or before this depth in the target camera are left out, world units.

    Raises:
        RenderError: features that do not fit the camera, or a near that is not positive.

    Reading:
        Of points at the same depth the first in reading order of the source is seen.
    """
    if not near > 0:
        raise RenderError(f"point splat: near must be positive, got {near:g}")
    depth = as_image(source.depth, source.camera, "depth", RenderError)
    features = as_image(source.float_features(), source.camera, "features", RenderError)
    place, z, chosen = _project(source.camera, depth, target, near)
    order = np.lexsort((z, place))  # by pixel, within it by depth, within that as they were
    first = order[np.r_[True, np.diff(place[order]) > 0]] if order.size else order
    size = (target.height, target.width)
    colour, alpha, seen = np.zeros((*size, features.shape[2]), np.float32), np.zeros(size, np.float32), np.zeros(size, np.float32)
    colour.reshape(-1, features.shape[2])[place[first]] = features.reshape(-1, features.shape[2])[chosen[first]]
    alpha.reshape(-1)[place[first]] = OPAQUE
    seen.reshape(-1)[place[first]] = z[first]
    return Splat(colour, alpha, seen)


Projected = tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]


def _project(camera: Camera, depth: NDArray[np.float32], target: Camera, near: float) -> Projected:
    """The pixel of the target that each visible point falls into, its depth there, and the pixel it comes from; flat, (N,)."""
    known = np.flatnonzero(depth)
    z = depth.reshape(-1)[known].astype(np.float64)
    across = (known % camera.width + 0.5 - camera.K[0, 2]) / camera.K[0, 0]
    down = (known // camera.width + 0.5 - camera.K[1, 2]) / camera.K[1, 1]
    transform = rigid_between(camera, target)
    points = np.stack([across * z, down * z, z], axis=1) @ transform[:3, :3].T + transform[:3, 3]  # (N, 3)
    before = points[:, 2] > near
    points, known = points[before], known[before]
    column = np.floor(target.K[0, 0] * points[:, 0] / points[:, 2] + target.K[0, 2])
    row = np.floor(target.K[1, 1] * points[:, 1] / points[:, 2] + target.K[1, 2])
    inside = (column >= 0) & (column < target.width) & (row >= 0) & (row < target.height)
    place = row[inside].astype(np.int64) * target.width + column[inside].astype(np.int64)
    return place, points[inside, 2], known[inside]
