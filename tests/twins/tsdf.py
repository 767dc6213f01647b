"""The image-based TSDF in a page of numpy: all rays together, step by step, in float64."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.camera import Camera
from ggvs_eval.geometry import DepthView, PreviousDepth, RayMarch

Array = NDArray[np.float64]


def fusion_weights_twin(depth: NDArray, tau: float, depth_noise: float) -> Array:
    """Eqs. 11-12: omega = min(noise / sqrt(nu / 49), 1), nu = sum of min((D[u, v] - D[p, q])^2, tau^2) over 7 x 7 pixels."""
    invalid = 1e18  # as far from everything as invalid and outside neighbours count
    D = np.where(depth > 0, depth.astype(np.float64), invalid)
    padded = np.pad(D, 3, constant_values=invalid)
    nu = np.zeros_like(D)
    for dy in range(7):
        for dx in range(7):
            nu += np.minimum((D - padded[dy : dy + D.shape[0], dx : dx + D.shape[1]]) ** 2, tau**2)
    with np.errstate(divide="ignore"):
        return np.where(depth > 0, np.minimum(depth_noise / np.sqrt(nu / 49), 1.0), 0.0)


def ray_march_twin(
    target: Camera,
    views: Sequence[DepthView],
    *,
    tau: float,
    previous: PreviousDepth | None = None,
    step_fraction: float = 0.8,
    min_step: float = 0.1,
    bisections: int = 3,
) -> RayMarch:
    """What `ggvs_eval.geometry.ray_march` computes, without skipping anything."""
    rays = target.rays().reshape(-1, 3)

    def field(z: Array) -> tuple[Array, Array]:
        """Fused distance in tau (0 where unknown) and sum of weights at depth z of each ray (Eqs. 9, 10, 14)."""
        points = target.centre + z[:, None] * rays
        shares = [_share(view.camera, view.depth, lambda at, view=view: view.weight[at], points, tau) for view in views]
        if previous is not None:
            gain = previous.gain.reshape(-1)

            def temporal_weight(at: tuple) -> Array:
                return np.minimum(gain * previous.accumulated_weight[at], previous.limit)

            shares.append(_share(previous.camera, previous.depth, temporal_weight, points, tau))
        total = sum((omega for _, omega in shares), np.zeros(len(z)))
        weighted = sum((distance * omega for distance, omega in shares), np.zeros(len(z)))
        return np.divide(weighted, total, out=np.zeros(len(z)), where=total > 0), total

    front, behind, hit = _find_crossings(field, len(rays), target, tau, step_fraction, min_step)
    for _ in range(bisections):
        middle = (front + behind) / 2
        s, total = field(middle)
        positive = (s > 0) & (total > 0)
        front, behind = np.where(positive, middle, front), np.where(positive, behind, middle)
    depth = np.where(hit, (front + behind) / 2, 0.0)
    weight = np.where(hit, field(depth)[1], 0.0)
    size = (target.height, target.width)
    return RayMarch(depth.reshape(size).astype(np.float32), weight.reshape(size).astype(np.float32))


def _find_crossings(
    field: Callable[[Array], tuple[Array, Array]], count: int, target: Camera, tau: float, step_fraction: float, min_step: float
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Depths before and after the first change from positive to not positive between known samples, and where there is one."""
    z = np.full(count, target.near)
    previous = np.full(count, np.nan)  # depth of the last sample if it was known and positive
    front, behind, hit = np.zeros(count), np.zeros(count), np.zeros(count, dtype=bool)
    active = z <= target.far
    while active.any():
        s, total = field(z)
        crossed = active & (total > 0) & (s <= 0) & np.isfinite(previous)
        front, behind = np.where(crossed, previous, front), np.where(crossed, z, behind)
        hit |= crossed
        positive = (total > 0) & (s > 0)
        previous = np.where(positive, z, np.nan)
        z = z + np.where(positive, np.maximum(step_fraction * s, min_step), step_fraction) * tau
        active &= ~crossed & (z <= target.far)
    return front, behind, hit


def _share(camera: Camera, depth: NDArray, weight_at: Callable[[tuple], Array], points: Array, tau: float) -> tuple[Array, Array]:
    """One view's clamped distance in tau and its weight at each point."""
    uv, z = camera.project(points)
    inside = (z > 0) & (uv >= 0).all(axis=1) & (uv < [camera.width, camera.height]).all(axis=1)
    uv = np.where(inside[:, None], uv, 0.5)
    sampled, nearest = sample_depth(depth, uv, tau)
    distance = (sampled - z) / tau
    counts = inside & (depth[nearest] > 0) & (distance >= -1)
    return np.minimum(distance, 1.0), np.where(counts, weight_at(nearest), 0.0)


def sample_depth(depth: NDArray, uv: Array, tolerance: float) -> tuple[Array, tuple]:
    """Depth at image coordinates, bilinear where the four neighbours are valid and within the tolerance, else nearest."""
    height, width = depth.shape
    nearest = (uv[:, 1].astype(int), uv[:, 0].astype(int))
    x, y = np.clip(uv[:, 0] - 0.5, 0, width - 1), np.clip(uv[:, 1] - 0.5, 0, height - 1)
    x0, y0 = x.astype(int), y.astype(int)
    x1, y1 = np.minimum(x0 + 1, width - 1), np.minimum(y0 + 1, height - 1)
    corners = np.stack([depth[y0, x0], depth[y0, x1], depth[y1, x0], depth[y1, x1]]).astype(np.float64)
    fx, fy = x - x0, y - y0
    mean = (1 - fy) * ((1 - fx) * corners[0] + fx * corners[1]) + fy * ((1 - fx) * corners[2] + fx * corners[3])
    smooth = (corners.min(axis=0) > 0) & (np.ptp(corners, axis=0) < tolerance)
    return np.where(smooth, mean, depth[nearest].astype(np.float64)), nearest
