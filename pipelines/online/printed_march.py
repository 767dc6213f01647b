"""The ray march with the fused field as the paper prints it, or read otherwise: slow, to measure
what a reading is worth.

`ggvs_eval.geometry.tsdf.ray_march` is the method's own; this one is numpy, all rays together, and
differs by `FieldReading` alone. In this interpretation it is the definition that tests compare the
fast one with.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.camera import Camera
from ggvs_eval.geometry.pinhole import rigid_between
from ggvs_eval.geometry.tsdf import STEP_FRACTION, PreviousDepth, RayMarch, march_end

Values = NDArray[np.float64]
Rays = NDArray[np.int64]


@dataclass(frozen=True)
class FieldReading:
    """Reading of Eqs. 9-10.

    Attributes:
        sign: the signed distance is D - z, positive in ``front`` of the surface; or z - D, as
            ``printed``.
        normalised: whether the sum over the views is divided by the sum of their weights; as
            printed it is not.
    """

    sign: Literal["front", "printed"] = "front"
    normalised: bool = True


@dataclass(frozen=True, eq=False)
class _View:
    """One depth camera, ready to be asked at points along rays.

    Attributes:
        camera: of the depth.
        depth: (H, W).
        weight: (H, W).
        gain: factor of the weight per ray, (N,); None for 1.
        limit: of the weight.
        directions: rays of the target in this camera's frame, (N, 3).
        start: where they start, (3,).
    """

    camera: Camera
    depth: NDArray[np.float32]
    weight: NDArray[np.float32]
    gain: Values | None
    limit: float
    directions: Values
    start: Values


def printed_march(
    target: Camera,
    cameras: Sequence[Camera],
    depths: Sequence[NDArray[np.float32]],
    weights: Sequence[NDArray[np.float32]],
    *,
    tau: float,
    previous: PreviousDepth | None = None,
    min_step: float = 0.1,
    reading: FieldReading,
) -> RayMarch:
    """Find the first surface along each ray, see `ggvs_eval.geometry.tsdf.ray_march` for the
    arguments.

    Args:
        cameras: the K source cameras.
        depths: of each.
        weights: of each pixel of them.
        tau: truncation distance, world units.
        previous: the previous frame's result.
        min_step: smallest step, in tau.
        reading: of the fused field.
    """
    views = [_view(target, *view) for view in zip(cameras, depths, weights, strict=True)]
    if previous is not None:
        gain = previous.gain.reshape(-1).astype(np.float64)
        views.append(
            _view(
                target,
                previous.camera,
                previous.depth,
                previous.accumulated_weight,
                gain,
                previous.limit,
            )
        )
    front, behind, hit = _crossings(views, target, tau, min_step, reading)
    share = front[1] / (front[1] - behind[1])
    depth, weight = (np.zeros(target.height * target.width, np.float32) for _ in range(2))
    depth[hit], _, weight[hit] = front + share * (behind - front)
    return RayMarch(
        depth.reshape(target.height, target.width), weight.reshape(target.height, target.width)
    )


def _crossings(
    cameras: Sequence[_View], target: Camera, tau: float, min_step: float, reading: FieldReading
) -> tuple[Values, Values, Rays]:
    """Depth, distance and weight before and after the first change from positive to not positive,
    and the rays that have one.
    """
    active = np.arange(target.height * target.width)
    # the last sample where known and positive
    z, before = np.full(active.size, target.near), np.full((3, active.size), np.nan)
    crossings: list[tuple[Values, Values, Rays]] = []
    end = march_end(target, tau, min_step, [camera.depth for camera in cameras])
    while active.size:
        s, total = _field(cameras, active, z, tau, reading)
        sample = np.stack([z, s, total])
        crossed = (total > 0) & (s <= 0) & np.isfinite(before[0])
        crossings.append((before[:, crossed], sample[:, crossed], active[crossed]))
        positive = (total > 0) & (s > 0)
        before = np.where(positive, sample, np.nan)
        z = z + tau * np.where(positive, np.maximum(STEP_FRACTION * s, min_step), STEP_FRACTION)
        going = ~crossed & (z <= end)
        active, z, before = active[going], z[going], before[:, going]
    front, behind, hit = (np.concatenate(parts, axis=-1) for parts in zip(*crossings, strict=True))
    return front, behind, hit


def _field(
    cameras: Sequence[_View], rays: Rays, z: Values, tau: float, reading: FieldReading
) -> tuple[Values, Values]:
    """Return the fused distance, in tau, and sum of the weights at one depth of each ray (Eqs.
    9-10).
    """
    total, weighted = np.zeros(rays.size), np.zeros(rays.size)
    for view in cameras:
        distance, weight = _share(view, rays, z, tau, reading)
        total += weight
        weighted += weight * distance
    return (
        np.divide(weighted, total, out=np.zeros(rays.size), where=total > 0)
        if reading.normalised
        else weighted
    ), total


def _share(
    view: _View, rays: Rays, z: Values, tau: float, reading: FieldReading
) -> tuple[Values, Values]:
    """Return one camera's clamped distance, in tau, and its weight."""
    camera, points = view.camera, view.directions[rays] * z[:, None] + view.start
    ahead = points[:, 2] > 0
    depth_of = np.where(ahead, points[:, 2], 1.0)
    u = camera.K[0, 0] * points[:, 0] / depth_of + camera.K[0, 2]
    v = camera.K[1, 1] * points[:, 1] / depth_of + camera.K[1, 2]
    inside = ahead & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    u, v = np.where(inside, u, 0.5), np.where(inside, v, 0.5)
    at = v.astype(np.int64), u.astype(np.int64)
    distance = (sample_depth(view.depth, u, v, tau) - points[:, 2]) / tau
    if reading.sign == "printed":
        distance = -distance
    weight = view.weight[at].astype(np.float64)
    if view.gain is not None:
        weight = np.minimum(view.gain[rays] * weight, view.limit)
    counts = inside & (view.depth[at] > 0) & (distance >= -1)
    return np.minimum(distance, 1.0), np.where(counts, weight, 0.0)


def sample_depth(depth: NDArray[np.float32], u: Values, v: Values, tolerance: float) -> Values:
    """Return the depth at image coordinates: bilinear where the four neighbours are known and
    close, else the nearest.

    At the border the neighbours are the last four pixels.

    Args:
        depth: (H, W), 0 = unknown.
        u: columns, (N,), 0 <= u < W; pixel centres are at halves.
        v: rows, (N,), 0 <= v < H.
        tolerance: neighbours are close when they differ by less than this, units of the depth.

    Returns:
        Depth, (N,).
    """
    height, width = depth.shape
    x, y = np.clip(u - 0.5, 0, width - 1), np.clip(v - 0.5, 0, height - 1)
    left, top = (
        np.minimum(x.astype(np.int64), max(width - 2, 0)),
        np.minimum(y.astype(np.int64), max(height - 2, 0)),
    )
    right, below = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    corners = np.stack(
        [depth[top, left], depth[top, right], depth[below, left], depth[below, right]]
    ).astype(np.float64)
    across, down = x - left, y - top
    mean = (1 - down) * ((1 - across) * corners[0] + across * corners[1]) + down * (
        (1 - across) * corners[2] + across * corners[3]
    )
    smooth = (corners.min(axis=0) > 0) & (np.ptp(corners, axis=0) < tolerance)
    return np.where(smooth, mean, depth[v.astype(np.int64), u.astype(np.int64)])


def _view(
    target: Camera,
    camera: Camera,
    depth: NDArray[np.float32],
    weight: NDArray[np.float32],
    gain: Values | None = None,
    limit: float = np.inf,
) -> _View:
    transform, K = rigid_between(target, camera), target.K
    row, column = np.indices((target.height, target.width)).reshape(2, -1) + 0.5
    rays = np.stack(
        [(column - K[0, 2]) / K[0, 0], (row - K[1, 2]) / K[1, 1], np.ones(row.size)], axis=1
    )
    return _View(
        camera=camera,
        depth=depth,
        weight=weight,
        gain=gain,
        limit=limit,
        directions=rays @ transform[:3, :3].T,
        start=transform[:3, 3],
    )
