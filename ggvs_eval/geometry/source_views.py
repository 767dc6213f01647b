"""Choice of the cameras that a view is synthesised from, and the weight of each: geometry of the
calibration alone.

A choice is a function of the target's pose and nothing else, and its shares are continuous in it: a
camera that is about to give way to another one has hardly any share left at the instant of the
exchange, and the other one begins with as little.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from math import comb
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera, SourceChoice, nearest_cameras
from ggvs_eval.errors import CameraError

NEED = 3  # cameras of a triangle
# how much the middle of what the cameras see counts against their axes, which parallel cameras have
# alone
PRIOR = 0.01
# cameras that look at the target's back are beyond every triangle around it
OPPOSITE = np.cos(np.deg2rad(150.0))
FLAT = 0.02  # height of the rig over its length, below which its cameras form a row


def find_triplet(target: Camera, cameras: Sequence[Camera]) -> dict[int, float]:
    """Return the cameras of the triangle that contains a view, and its barycentric coordinates
    there.

    Directions from a point that the rig looks at are triangulated on the sphere, so that cameras on
    a plane, an arc or a dome all have neighbours. A view outside of them all belongs to the nearest
    edge.

    Args:
        target: the view; not among `cameras`.
        cameras: of the rig.

    Returns:
        Index in `cameras` -> coordinate in [0, 1]; three of them, sum 1.

    Raises:
        CameraError: fewer than three cameras, or cameras in a row, which have no triangles.

    Source: Buehler et al., Unstructured Lumigraph Rendering, SIGGRAPH 2001, who triangulate cameras
    as the target sees them.

    Reading:
        The triangulation is fixed to the rig and does not follow the target, so that coordinates
        are continuous along any path: a stereographic projection, whose centre is the target, maps
        circles to circles and leaves Delaunay triangles as they are.
    """
    pivot = _pivot(cameras)
    directions = np.stack([_unit(camera.centre - pivot) for camera in cameras])
    places, indices = _project(directions, _unit(target.centre - pivot))
    if len(indices) < NEED or _is_a_row(places):
        raise CameraError(
            f"camera {target.name}: wanted three cameras around it that form a triangle, the "
            f"{len(cameras)} others form a "
            'row or are too few; set synthesis.sources = "nearest"'
        )
    # protocols name the choice, and anyone who reads one does not want scipy
    from scipy.spatial import Delaunay, QhullError

    try:
        triangles = Delaunay(places).simplices
    except QhullError as error:
        raise CameraError(
            f"camera {target.name}: its cameras have no triangles; set synthesis.sources = "
            f'"nearest"'
        ) from error
    weights = np.stack([_closest(places[triangle]) for triangle in triangles])  # (T, 3)
    reached = np.einsum("tc,tcd->td", weights, places[triangles])
    best = int(np.argmin(np.square(reached).sum(axis=1).round(12)))
    return {
        int(indices[member]): float(weight)
        for member, weight in zip(triangles[best], weights[best], strict=True)
    }


def _pivot(cameras: Sequence[Camera]) -> Array:
    """Return the point that the cameras look at, (3,): nearest to all axes and, by a little, to the
    middle of what they see.
    """
    middles = np.stack(
        [camera.centre + camera.axis * 2 / (1 / camera.near + 1 / camera.far) for camera in cameras]
    )
    # Each matrix takes the part along the camera's axis away.
    across = np.stack([np.eye(3) - np.outer(camera.axis, camera.axis) for camera in cameras])
    centres = np.stack([camera.centre for camera in cameras])
    matrix = across.mean(axis=0) + PRIOR * np.eye(3)
    return np.linalg.solve(
        matrix,
        np.einsum("nij,nj->i", across, centres) / len(cameras) + PRIOR * middles.mean(axis=0),
    )


def _project(directions: Array, middle: Array) -> tuple[Array, NDArray[np.int64]]:
    """Stereographic projection of unit vectors, (N, 3), with `middle` at 0: places, (M, 2), and
    whose they are, (M,).
    """
    cosine = directions @ middle
    indices = np.flatnonzero(cosine > OPPOSITE)
    right = _unit(np.cross(middle, np.eye(3)[np.abs(middle).argmin()]))
    axes = np.stack([right, np.cross(middle, right)])
    return directions[indices] @ axes.T / (1 + cosine[indices])[:, None], indices


def _is_a_row(places: Array) -> bool:
    extents = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    return bool(extents[1] <= FLAT * extents[0])


def _closest(corners: Array) -> Array:
    """Barycentric coordinates of the point of a triangle, (3, 2), nearest to 0, (3,)."""
    inside = (
        np.linalg.solve(np.vstack([corners.T, np.ones(3)]), [0.0, 0.0, 1.0])
        if _area(corners) > 0
        else np.full(3, -1.0)
    )
    if inside.min() >= 0:
        return np.asarray(inside)
    options = []
    for first, second in ((0, 1), (1, 2), (2, 0)):
        along = corners[second] - corners[first]
        share = float(
            np.clip(-corners[first] @ along / max(float(along @ along), 1e-300), 0.0, 1.0)
        )
        weights = np.zeros(3)
        weights[first], weights[second] = 1 - share, share
        options.append(weights)
    return min(options, key=lambda weights: float(np.square(weights @ corners).sum()))


def _area(corners: Array) -> float:
    first_side, second_side = corners[1] - corners[0], corners[2] - corners[0]
    return abs(float(first_side[0] * second_side[1] - first_side[1] * second_side[0]))


def _unit(vector: Array) -> Array:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-300))


CHOSEN_AS: dict[SourceChoice, str] = {
    "nearest": "the nearest",
    "coverage": "chosen by their coverage of the target",
    "triplet": "the corners of the triangle of cameras around the target",
}  # in words

GRID = (12, 9)  # rays across and down
DEPTHS = 5  # per ray, evenly spaced in inverse depth
LEAST_SHARE = 1e-3  # of a view at the instant of its exchange
NEAREST_FADE = 0.3  # of the distance to the first camera that is not chosen, over which shares fall
COVERAGE_FADE = 0.6  # of what the last camera adds, over which shares fall
TRIPLET_FADE = 0.25  # coordinate in its triangle from which a camera counts whole
POOL_FADE = 0.1  # of what a camera sees
# between two axes: a camera counts whole up to the first,
FULL_TURN_RAD, MOST_TURN_RAD = np.deg2rad(60.0), np.deg2rad(75.0)
# and is turned away from the second on
HALF_ANGLE_RAD = np.deg2rad(7.0)  # between two rays to a point, at which seeing it is worth half
BORDER = 0.03  # of the image's width, over which content at its edge comes into view
TRUST = 0.95  # how likely the best view of a point shows it; the rest may be hidden from it
LEAST_GAIN = 1e-3  # of the view, that one more camera is taken to add at least
MOST_SETS = 1000  # sets of cameras that are compared


@dataclass(frozen=True, eq=False)
class ChosenSource:
    """One source of a target.

    Attributes:
        camera: the source.
        share: how far the choice counts on it, in (0, 1]; falls towards 0 as it is about to give
            way to another camera.
    """

    camera: Camera
    share: float


def choose_sources(
    target: Camera, cameras: Sequence[Camera], k: int, how: SourceChoice = "nearest"
) -> tuple[ChosenSource, ...]:
    """Choose the K source cameras of a target, nearest first; the target itself is left out.

    Args:
        target: camera to synthesise, of the rig or a virtual one.
        k: number of sources; ``coverage`` gives fewer where fewer cameras look the target's way,
            ``triplet`` wants three.
        how: ``nearest``, the cameras whose centres are nearest, regardless of what they see;
            ``coverage``, those that together see most of the target's view between its near and its
            far depth, from directions like its own; or ``triplet``, the corners of the triangle of
            cameras around the target, see `find_triplet`.

    Raises:
        CameraError: no such choice, or fewer than `k` other cameras; for ``coverage``, none that
            looks the target's way and sees any of it; for ``triplet``, another `k` than three, or
            cameras in a row.

    Examples:
        >>> from ggvs_eval.camera import translated_path
        >>> K = np.array([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]])
        >>> camera = Camera("cam00", K, np.eye(4), width=8, height=6, near=1.0, far=9.0)
        >>> rig = translated_path(camera, span=1.0, count=5)
        >>> [source.camera.name for source in choose_sources(rig[0], rig, k=2)]
        ['path0001', 'path0002']

    Reading:
        The paper takes the K nearest. Constants are chosen on the validation rigs (seeds 101-103:
        rows, arc, grid, a walk, a walk with pans; 320x240, K = 4, geometric weights, PSNR):
        `HALF_ANGLE_RAD` of 3 to 20 degrees, `TRUST` of 0.6 to 0.95, the fades of 0.1 to 0.6 by the
        switch score too. The set of ``coverage`` is the best of all sets, not one that grows camera
        by camera, since only then the shares are continuous where two cameras change places at
        once.
    """
    if how not in get_args(SourceChoice):
        raise CameraError(
            f"sources: wanted one of {', '.join(get_args(SourceChoice))}, got {how!r}"
        )
    candidates = nearest_cameras(
        target, cameras, len([camera for camera in cameras if camera.name != target.name])
    )
    nearest_cameras(target, candidates, k)  # refuses too few
    shares = SHARES[how](target, candidates, k)
    return tuple(ChosenSource(candidates[index], share) for index, share in sorted(shares.items()))


def turn_rad(first: Camera, second: Camera) -> float:
    """Return the angle between the viewing directions of two cameras.

    Examples:
        >>> K = np.array([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]])
        >>> camera = Camera("cam00", K, np.eye(4), width=8, height=6, near=1.0, far=9.0)
        >>> turn_rad(camera, camera)
        0.0
    """
    return float(np.arccos(np.clip(first.axis @ second.axis, -1.0, 1.0)))


def _nearest_shares(target: Camera, candidates: Sequence[Camera], k: int) -> dict[int, float]:
    """Index in `candidates` -> share.

    Falls over the last part of the distance to the nearest camera that is not chosen.
    """
    distances = [
        float(np.linalg.norm(camera.centre - target.centre)) for camera in candidates[: k + 1]
    ]
    if len(distances) == k or distances[k] == 0:
        return dict.fromkeys(range(k), 1.0)
    return {
        index: _share((distances[k] - distances[index]) / (NEAREST_FADE * distances[k]))
        for index in range(k)
    }


def _triplet_shares(target: Camera, candidates: Sequence[Camera], k: int) -> dict[int, float]:
    """Index in `candidates` -> share.

    Falls as the target comes near the side of its triangle that the camera does not touch.
    """
    if k != NEED:
        raise CameraError(
            f"camera {target.name}: wanted K = {NEED} for the triangle around it, got {k}; set "
            f"synthesis.k"
        )
    return {
        index: _share(coordinate / TRIPLET_FADE)
        for index, coordinate in find_triplet(target, candidates).items()
    }


def _share(margin: float) -> float:
    """Return a share that does not depend on the last bits of a sum."""
    return round(min(max(margin, LEAST_SHARE), 1.0), 6)


def _coverage_shares(target: Camera, candidates: Sequence[Camera], k: int) -> dict[int, float]:
    """Return the index in `candidates` -> share.

    Falls as the best set without a camera becomes as good as the best of all.
    """
    points = sample_view(target)
    worth = np.stack([_worth(target, camera, points) for camera in candidates])  # (N, P)
    pool, worth = _pool(worth, k)
    if not len(pool):
        raise CameraError(
            f"camera {target.name}: wanted sources that face its view, none of {len(candidates)} "
            f"cameras is turned by less than {np.rad2deg(MOST_TURN_RAD):.0f} degrees and sees any "
            "of its view; leave it out or add cameras"
        )
    k = min(k, len(pool))
    sets, fewer = _sets(len(pool), k), _sets(len(pool), k - 1)  # (S, n)
    values, values_fewer = _values(sets, worth), _values(fewer, worth)
    best = int(values.argmax())
    gain = max(values[best] - values_fewer.max(), LEAST_GAIN)
    shares = {}
    for member in np.flatnonzero(sets[best]):
        without = np.append(values[~sets[:, member]], values_fewer[~fewer[:, member]]).max()
        shares[int(pool[member])] = _share(float((values[best] - without) / (COVERAGE_FADE * gain)))
    return shares


SHARES = {"nearest": _nearest_shares, "coverage": _coverage_shares, "triplet": _triplet_shares}


def _pool(worth: Array, k: int) -> tuple[NDArray[np.int64], Array]:
    """Return the cameras that see most, few enough to compare all sets of them, and what they are
    worth.

    What a camera is worth fades as it comes near the edge of the pool, so that it enters and leaves
    it unnoticed.

    Args:
        worth: of each point to each camera, (N, P).
        k: size of the sets.

    Returns:
        Indices of the pool's cameras, ascending, (n,), and their worth, (n, P).
    """
    total = worth.sum(axis=1).round(9)
    most = k
    while comb(most + 1, k) <= MOST_SETS and most < len(worth):
        most += 1
    order = np.argsort(-total, kind="stable")
    pool = np.sort(order[:most][total[order[:most]] > 0])
    edge = total[order[most]] if most < len(worth) else 0.0
    fade = np.clip((total[pool] - edge) / (POOL_FADE * total[pool]), LEAST_SHARE, 1.0)
    return pool, worth[pool] * fade[:, None]


@lru_cache(maxsize=16)
def _sets(count: int, k: int) -> NDArray[np.bool_]:
    """Return all sets of `k` of `count` cameras, first cameras first, (S, count)."""
    sets = np.zeros((comb(count, k), count), bool)
    for row, members in enumerate(combinations(range(count), k)):
        sets[row, list(members)] = True
    sets.setflags(write=False)
    return sets


def _values(sets: NDArray[np.bool_], worth: Array) -> Array:
    """Score each set by what it sees: the mean over points of the chance that some camera shows it,
    (S,).

    A second view of a point counts too, since it may be hidden from the first.
    """
    missed = np.exp(sets.astype(np.float64) @ np.log1p(-TRUST * worth))  # (S, P)
    return np.asarray((1 - missed).mean(axis=1).round(9))


def _worth(target: Camera, source: Camera, points: Array) -> Array:
    """Worth of seeing each point from a source, in [0, 1], (P,): 1 in the middle of its image and
    from the target's direction.
    """
    turned = float(
        np.clip(
            (MOST_TURN_RAD - turn_rad(target, source)) / (MOST_TURN_RAD - FULL_TURN_RAD), 0.0, 1.0
        )
    )
    if turned == 0:
        return np.zeros(len(points))
    angles = ray_angles(target, source, points)
    return np.asarray(
        turned * _inside(source, points, BORDER) / (1 + np.square(angles / HALF_ANGLE_RAD))
    )


def sample_view(target: Camera, grid: tuple[int, int] = GRID, depths: int = DEPTHS) -> Array:
    """Return the points all over the target's view at depths from near to far, (P, 3) in the world.

    Args:
        grid: rays across and down.
        depths: of each ray, evenly spaced in inverse depth.
    """
    across, down = (
        (np.arange(n) + 0.5) / n * size for n, size in zip(grid, target.size, strict=True)
    )
    u, v, inverse = np.meshgrid(across, down, np.linspace(1 / target.near, 1 / target.far, depths))
    return target.unproject(np.stack([u, v], axis=-1), 1 / inverse).reshape(-1, 3)


def share_of_view(camera: Camera, visibility: NDArray[np.bool_], depths: int = DEPTHS) -> float:
    """Share of the points of a camera's view that are seen.

    Over a guessed depth range, at the depth where it is largest.

    A guess may be far too wide, and what is seen at the depths that it makes up says nothing of
    those that the scene has.

    Args:
        camera: whose view.
        visibility: of points at `depths` on the same ray, (P,).
        depths: number of points on a ray.
    """
    if camera.range_origin != "guessed":
        return float(visibility.mean())
    return float(visibility.reshape(-1, depths).mean(axis=0).max())


def sees(camera: Camera, points: Array) -> NDArray[np.bool_]:
    """Return the mask of the points in a camera's image, (P,); nothing occludes."""
    return _inside(camera, points, 0.0) > 0


def _inside(camera: Camera, points: Array, border: float) -> Array:
    """Measure how far each point is inside the image, in [0, 1], (P,): 0 outside, 1 from `border`
    of its width inwards.
    """
    uv, depth = camera.project(points)
    margin = np.minimum(uv, np.array(camera.size) - uv).min(axis=-1)  # (P,) pixels
    ramp = np.clip(margin / max(border * camera.width, 1e-9), 0.0, 1.0)
    return np.where(depth > 0, np.nan_to_num(ramp), 0.0)


def ray_angles(target: Camera, source: Camera, points: Array) -> Array:
    """Return the angle at each point between the rays to two cameras, radians, (P,)."""
    rays = [points - camera.centre for camera in (target, source)]
    cosine = (rays[0] * rays[1]).sum(axis=-1) / np.maximum(
        np.prod([np.linalg.norm(ray, axis=-1) for ray in rays], axis=0), 1e-12
    )
    return np.arccos(np.clip(cosine, -1.0, 1.0))
