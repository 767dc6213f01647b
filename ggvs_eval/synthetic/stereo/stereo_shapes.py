"""Shapes of the stereo scenes: each meets a ray exactly, in closed form or by Newton's steps.

Space is that of the left camera, OpenCV axes, with the baseline as unit of length: the right eye stands at (1, 0, 0) and the
inverse distance `inverse_z` along the optical axis times the focal length is the disparity. Rays are (x, y, 1).
"""

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8, Map, Vector

Box = tuple[float, float, float, float]  # smallest and largest x, smallest and largest y of the rays that can meet a shape

EVERYWHERE: Box = (-np.inf, np.inf, -np.inf, np.inf)
MASK_SIDE = 256


class Shape(Protocol):
    """A surface that rays can meet."""

    def bounds(self, eye: float) -> Box:
        """Rays of the eye at (eye, 0, 0) that can meet the shape."""

    def cast(self, x: Map, y: Map, eye: float) -> Map:
        """Inverse distance at which rays first meet the shape, 0 where they do not; x and y broadcast."""

    def surface(self, points: Map) -> tuple[Map, Map, Map]:
        """Surface coordinates u and v in baselines, (N,) each, and unit normals, (3, N) or (3, 1), of points (3, N)."""


@dataclass(frozen=True, eq=False)
class Sheet:
    """A plane, a piece of it, or a bent piece.

    Attributes:
        centre: a point of the plane, (3,).
        axis_u: unit vector in the plane, (3,).
        axis_v: unit vector in the plane, upright on `axis_u`, (3,).
        half_u: half of the extent along `axis_u`; infinite for a whole plane.
        half_v: half of the extent along `axis_v`.
        mask: where the rectangle is solid (above 127), uint8 (MASK_SIDE, MASK_SIDE), or None = everywhere.
        waves: bending, one row (height, frequency along u, frequency along v, phase) per wave, (K, 4); K may be 0.
    """

    centre: Vector
    axis_u: Vector
    axis_v: Vector
    half_u: float = np.inf
    half_v: float = np.inf
    mask: Image8 | None = None
    waves: Vector | None = None

    def bounds(self, eye: float) -> Box:
        """Rays towards the corners, widened for the bending."""
        if not np.isfinite(self.half_u):
            return EVERYWHERE
        signs = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
        corners = self.centre + signs[:, :1] * self.half_u * self.axis_u + signs[:, 1:] * self.half_v * self.axis_v
        if self.waves is not None:
            bulge = np.abs(self.waves[:, 0]).sum() * np.cross(self.axis_u, self.axis_v)
            corners = np.concatenate([corners - bulge, corners + bulge])
        return _box(corners, eye)

    def cast(self, x: Map, y: Map, eye: float) -> Map:
        """Meet the plane, bend, and cut."""
        normal = np.cross(self.axis_u, self.axis_v)
        start = np.array([eye, 0, 0]) - self.centre
        distance = -float(normal @ start)
        inverse = _affine(x, y, normal / distance)
        if not np.isfinite(self.half_u) and self.waves is None:
            return np.maximum(inverse, 0)
        z = np.reciprocal(np.maximum(inverse, np.float32(1e-6)))
        ray_u, ray_v = _affine(x, y, self.axis_u), _affine(x, y, self.axis_v)
        u0, v0 = np.float32(start @ self.axis_u), np.float32(start @ self.axis_v)
        if self.waves is not None:
            z = self._bend(z, ray_u, ray_v, _affine(x, y, normal), (u0, v0, np.float32(-distance)))
        u, v = u0 + ray_u * z, v0 + ray_v * z
        solid = (inverse > 1e-6) & (z > 0)
        if np.isfinite(self.half_u):
            solid &= (np.abs(u) <= self.half_u) & (np.abs(v) <= self.half_v)
        if self.mask is not None:
            solid &= self._solid(u, v)
        return np.where(solid, 1 / z, np.float32(0))

    def surface(self, points: Map) -> tuple[Map, Map, Map]:
        """Coordinates along the two axes; the normal of the bent sheet."""
        u = dot(self.axis_u, points) - np.float32(self.axis_u @ self.centre)
        v = dot(self.axis_v, points) - np.float32(self.axis_v @ self.centre)
        normal = np.cross(self.axis_u, self.axis_v).astype(np.float32)[:, None]
        if self.waves is None:
            return u, v, normal
        _, slope_u, slope_v = self._height(u, v)
        bent = normal - slope_u * self.axis_u.astype(np.float32)[:, None] - slope_v * self.axis_v.astype(np.float32)[:, None]
        return u, v, unit(bent)

    def _bend(self, z: Map, ray_u: Map, ray_v: Map, ray_n: Map, start: tuple[np.float32, np.float32, np.float32]) -> Map:
        """Newton's steps from the flat sheet to the bent one; the slopes are small, so that each ray meets it once."""
        for _ in range(5):
            height, slope_u, slope_v = self._height(start[0] + ray_u * z, start[1] + ray_v * z)
            z = z - (start[2] + ray_n * z - height) / (ray_n - slope_u * ray_u - slope_v * ray_v)
        return z

    def _height(self, u: Map, v: Map) -> tuple[Map, Map, Map]:
        """Height of the bent sheet above the plane and its slopes."""
        height, slope_u, slope_v = np.zeros_like(u), np.zeros_like(u), np.zeros_like(u)
        for amplitude, along_u, along_v, phase in np.asarray(self.waves, np.float32):
            angle = along_u * u + along_v * v + phase
            height += amplitude * np.sin(angle)
            swing = amplitude * np.cos(angle)
            slope_u += along_u * swing
            slope_v += along_v * swing
        return height, slope_u, slope_v

    def _solid(self, u: Map, v: Map) -> NDArray[np.bool_]:
        column = (u / np.float32(self.half_u) + 1) * (MASK_SIDE / 2) - np.float32(0.5)
        row = (v / np.float32(self.half_v) + 1) * (MASK_SIDE / 2) - np.float32(0.5)
        return _look_up(np.asarray(self.mask), column, row) > 127


@dataclass(frozen=True, eq=False)
class Ball:
    """An ellipsoid.

    Attributes:
        centre: its centre, (3,).
        axes: unit vectors of its axes, rows, (3, 3).
        radii: half lengths along them, (3,).
    """

    centre: Vector
    axes: Vector
    radii: Vector

    def bounds(self, eye: float) -> Box:
        """Rays towards the corners of its bounding box."""
        reach = np.sqrt(((self.axes * self.radii[:, None]) ** 2).sum(0))
        signs = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)])
        return _box(self.centre + signs * reach, eye)

    def cast(self, x: Map, y: Map, eye: float) -> Map:
        """First meeting, as of a unit sphere in squeezed space."""
        squeeze = self.axes / self.radii[:, None]
        start = squeeze @ (np.array([eye, 0, 0]) - self.centre)
        ray = [_affine(x, y, row) for row in squeeze]
        length2 = ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2
        nearest = -sum(np.float32(s) * r for s, r in zip(start, ray, strict=True)) / length2
        miss2 = sum((np.float32(s) + nearest * r) ** 2 for s, r in zip(start, ray, strict=True))
        z = nearest - np.sqrt(np.maximum(1 - miss2, 0) / length2)
        return np.asarray(np.where((miss2 < 1) & (z > 1e-3), 1 / np.maximum(z, np.float32(1e-3)), np.float32(0)), np.float32)

    def surface(self, points: Map) -> tuple[Map, Map, Map]:
        """Length along the equator and along the meridian."""
        squeeze = self.axes / self.radii[:, None]
        local = points - self.centre.astype(np.float32)[:, None]
        squeezed = [dot(row, local) for row in squeeze]
        normal = np.stack([dot(column, squeezed) for column in squeeze.T])
        mean = np.float32(self.radii.mean())
        longitude, latitude = np.arctan2(squeezed[0], -squeezed[2]), np.arcsin(np.clip(squeezed[1], -1, 1))
        return longitude * mean, latitude * mean, unit(normal)


def _affine(x: Map, y: Map, row: Vector) -> Map:
    """Product of a vector with the rays (x, y, 1)."""
    return np.float32(row[0]) * x + (np.float32(row[1]) * y + np.float32(row[2]))


def dot(row: Vector | Map, points: Map | list[Map]) -> Map:
    """Inner product along the first axis, without BLAS, whose last bits may depend on the number of threads."""
    a, b, c = (np.asarray(value, np.float32) for value in row)
    return a * points[0] + b * points[1] + c * points[2]


def unit(vectors: Map) -> Map:
    """Vectors along the first axis, made one long."""
    length = np.sqrt(vectors[0] ** 2 + vectors[1] ** 2 + vectors[2] ** 2)
    return vectors / np.maximum(length, np.float32(1e-12))


def _box(corners: Vector, eye: float) -> Box:
    if corners[:, 2].min() < 1e-2:
        return EVERYWHERE
    x, y = (corners[:, 0] - eye) / corners[:, 2], corners[:, 1] / corners[:, 2]
    return float(x.min()), float(x.max()), float(y.min()), float(y.max())


def _look_up(image: Image8, column: Map, row: Map) -> Image8:
    """Bilinear values of a grey image at a map or list of positions, 0 outside."""
    shape = column.shape
    columns = 1024 if column.ndim == 1 else shape[1]
    count = -(-column.size // columns) * columns
    maps = [np.resize(a, count).reshape(-1, columns) if column.ndim == 1 else a for a in (column, row)]
    maps = [np.clip(a, -9, 9999).astype(np.float32) for a in maps]
    return np.asarray(cv2.remap(image, maps[0], maps[1], cv2.INTER_LINEAR), np.uint8).reshape(-1)[: column.size].reshape(shape)
