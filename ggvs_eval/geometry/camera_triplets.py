"""The three cameras around a view: the triangle of a Delaunay triangulation of the rig that the view lies in."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera
from ggvs_eval.errors import CameraError

NEED = 3  # cameras of a triangle
PRIOR = 0.01  # how much the middle of what the cameras see counts against their axes, which parallel cameras have alone
OPPOSITE = np.cos(np.deg2rad(150.0))  # cameras that look at the target's back lie beyond every triangle around it
FLAT = 0.02  # height of the rig over its length, below which its cameras stand in a row


def find_triplet(target: Camera, cameras: Sequence[Camera]) -> dict[int, float]:
    """The cameras of the triangle that a view lies in, and its barycentric coordinates there.

    Directions from a point that the rig looks at are triangulated on the sphere, so that cameras on a plane, an arc or a dome
    all have neighbours. A view outside of them all belongs to the nearest edge.

    Args:
        target: the view; not among `cameras`.
        cameras: of the rig.

    Returns:
        Index in `cameras` -> coordinate in [0, 1]; three of them, sum 1.

    Raises:
        CameraError: fewer than three cameras, or cameras in a row, which have no triangles.

    Source: Buehler et al., Unstructured Lumigraph Rendering, SIGGRAPH 2001, who triangulate cameras as the target sees them.

    Reading:
        The triangulation is fixed to the rig and does not follow the target, so that coordinates are continuous along any path:
        a stereographic projection, whose centre is the target, maps circles to circles and leaves Delaunay triangles as they are.
    """
    pivot = _pivot(cameras)
    directions = np.stack([_unit(camera.centre - pivot) for camera in cameras])
    places, kept = _project(directions, _unit(target.centre - pivot))
    if len(kept) < NEED or _is_a_row(places):
        raise CameraError(
            f"camera {target.name}: wanted three cameras around it that form a triangle, the {len(cameras)} others stand in a "
            'row or are too few; set synthesis.sources = "nearest"'
        )
    from scipy.spatial import Delaunay, QhullError  # protocols name the choice, and whoever reads one does not want scipy

    try:
        triangles = Delaunay(places).simplices
    except QhullError as error:
        raise CameraError(f'camera {target.name}: its cameras have no triangles; set synthesis.sources = "nearest"') from error
    weights = np.stack([_closest(places[triangle]) for triangle in triangles])  # (T, 3)
    reached = np.einsum("tc,tcd->td", weights, places[triangles])
    best = int(np.argmin(np.square(reached).sum(axis=1).round(12)))
    return {int(kept[member]): float(weight) for member, weight in zip(triangles[best], weights[best], strict=True)}


def _pivot(cameras: Sequence[Camera]) -> Array:
    """The point that the cameras look at, (3,): nearest to all axes and, by a little, to the middle of what they see."""
    middles = np.stack([each.centre + each.axis * 2 / (1 / each.near + 1 / each.far) for each in cameras])
    across = np.stack([np.eye(3) - np.outer(each.axis, each.axis) for each in cameras])  # takes the part along the axis away
    centres = np.stack([each.centre for each in cameras])
    matrix = across.mean(axis=0) + PRIOR * np.eye(3)
    return np.linalg.solve(matrix, np.einsum("nij,nj->i", across, centres) / len(cameras) + PRIOR * middles.mean(axis=0))


def _project(directions: Array, middle: Array) -> tuple[Array, NDArray[np.int64]]:
    """Stereographic projection of unit vectors, (N, 3), with `middle` at 0: places, (M, 2), and whose they are, (M,)."""
    cosine = directions @ middle
    kept = np.flatnonzero(cosine > OPPOSITE)
    right = _unit(np.cross(middle, np.eye(3)[np.abs(middle).argmin()]))
    axes = np.stack([right, np.cross(middle, right)])
    return directions[kept] @ axes.T / (1 + cosine[kept])[:, None], kept


def _is_a_row(places: Array) -> bool:
    extents = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    return bool(extents[1] <= FLAT * extents[0])


def _closest(corners: Array) -> Array:
    """Barycentric coordinates of the point of a triangle, (3, 2), that lies nearest to 0, (3,)."""
    inside = np.linalg.solve(np.vstack([corners.T, np.ones(3)]), [0.0, 0.0, 1.0]) if _area(corners) > 0 else np.full(3, -1.0)
    if inside.min() >= 0:
        return np.asarray(inside)
    options = []
    for first, second in ((0, 1), (1, 2), (2, 0)):
        along = corners[second] - corners[first]
        share = float(np.clip(-corners[first] @ along / max(float(along @ along), 1e-300), 0.0, 1.0))
        weights = np.zeros(3)
        weights[first], weights[second] = 1 - share, share
        options.append(weights)
    return min(options, key=lambda weights: float(np.square(weights @ corners).sum()))


def _area(corners: Array) -> float:
    one, other = corners[1] - corners[0], corners[2] - corners[0]
    return abs(float(one[0] * other[1] - one[1] * other[0]))


def _unit(vector: Array) -> Array:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-300))
