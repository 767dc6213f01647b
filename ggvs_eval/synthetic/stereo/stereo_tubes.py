"""The tubes of the stereo scenes, all in one: poles, wires, limbs and spokes meet their rays together."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Map, Vector
from ggvs_eval.synthetic.stereo.stereo_shapes import dot, unit

Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Tubes:
    """Many straight pieces of tube with round ends: poles, wires, spokes, stalks. Many rays meet many tubes in one go.

    Attributes:
        start: one end of each piece's axis, (N, 3).
        axis: unit vectors along the axes, (N, 3).
        length: lengths of the axes, (N,).
        radius: radii, (N,).
    """

    start: Vector
    axis: Vector
    length: Vector
    radius: Vector

    def boxes(self, eye: float) -> NDArray[np.float64]:
        """Smallest and largest x and y of the rays that can meet each piece, (N, 4)."""
        ends = np.stack([self.start, self.start + self.axis * self.length[:, None]])
        z = np.maximum(ends[..., 2] - self.radius, 1e-3)
        # A sphere's outline lies a little further out than its radius over its depth.
        reach = 1.05 * self.radius / z * np.sqrt(1 + ((ends[..., :2] - [eye, 0]) ** 2).max(-1) / z**2)
        centre = (ends[..., :2] - [eye, 0]) / np.maximum(ends[..., 2:], 1e-3)
        low, high = (centre - reach[..., None]).min(0), (centre + reach[..., None]).max(0)
        return np.stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]], 1)

    def cast(self, x: Map, y: Map, eye: float, piece: Index) -> Map:
        """Inverse distance at which each ray first meets its piece, 0 where it does not; all (M,)."""
        axis = self.axis.astype(np.float32)[piece].T
        start = (np.array([eye, 0, 0]) - self.start).astype(np.float32)
        along_start = (start * self.axis.astype(np.float32)).sum(1)
        across = (start - along_start[:, None] * self.axis.astype(np.float32))[piece].T
        radius2 = (self.radius.astype(np.float32) ** 2)[piece]
        ray_along = x * axis[0] + y * axis[1] + axis[2]
        ray = (x - ray_along * axis[0], y - ray_along * axis[1], 1 - ray_along * axis[2])
        length2 = np.maximum(ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2, np.float32(1e-9))
        nearest = -(across[0] * ray[0] + across[1] * ray[1] + across[2] * ray[2]) / length2
        miss2 = sum((a + nearest * r) ** 2 for a, r in zip(across, ray, strict=True))
        z = nearest - np.sqrt(np.maximum(radius2 - miss2, 0) / length2)
        along = along_start[piece] + ray_along * z
        length = self.length.astype(np.float32)[piece]
        hit = (miss2 < radius2) & (along >= 0) & (along <= length) & (z > 1e-3)
        inverse = np.where(hit, 1 / np.maximum(z, np.float32(1e-3)), np.float32(0))
        for end in (np.float32(0), self.length.astype(np.float32)):
            offset = start - (np.asarray(end)[..., None] * self.axis.astype(np.float32) if np.ndim(end) else 0)
            inverse = np.maximum(inverse, _sphere(x, y, offset.astype(np.float32)[piece].T, radius2))
        return inverse

    def surface(self, points: Map, piece: Index) -> tuple[Map, Map, Map]:
        """Length around the tube and along it, and the normal."""
        axis, start = self.axis.astype(np.float32)[piece].T, self.start.astype(np.float32)[piece].T
        local = points - start
        along = dot(axis, local)
        outward = local - np.clip(along, 0, self.length.astype(np.float32)[piece]) * axis
        normal = unit(outward)
        # The angle around the tube is counted from the side that faces the eyes.
        level = np.stack([axis[1], -axis[0]])
        level /= np.maximum(np.sqrt(level[0] ** 2 + level[1] ** 2), np.float32(1e-6))
        angle = np.arcsin(np.clip(normal[0] * level[0] + normal[1] * level[1], -1, 1))
        return angle * self.radius.astype(np.float32)[piece], along, normal


def _sphere(x: Map, y: Map, start: Map, radius2: Map) -> Map:
    length2 = x * x + y * y + 1
    nearest = -(start[0] * x + start[1] * y + start[2]) / length2
    miss2 = (start[0] + nearest * x) ** 2 + (start[1] + nearest * y) ** 2 + (start[2] + nearest) ** 2
    z = nearest - np.sqrt(np.maximum(radius2 - miss2, 0) / length2)
    return np.where((miss2 < radius2) & (z > 1e-3), 1 / np.maximum(z, np.float32(1e-3)), np.float32(0))
