"""Surfaces joined into one mesh that rays can hit."""

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array32
from ggvs_eval.contrib.worlds.room.surfaces import Material, Surface
from ggvs_eval.kernels._film import RayTree


class Hits(NamedTuple):
    """Intersections of rays with a mesh; rays that hit nothing are left out.

    Attributes:
        ray: index of the ray, (N,).
        distance: multiple of the ray's direction, (N,).
        face: index of the triangle, (N,).
        corner_weights: barycentric weights of the triangle's corners, (N, 3).
    """

    ray: NDArray[np.int64]
    distance: Array32
    face: NDArray[np.int32]
    corner_weights: Array32

    def rows(self, index: NDArray[np.int64]) -> "Hits":
        """Some of the hits."""
        return Hits(self.ray[index], self.distance[index], self.face[index], self.corner_weights[index])


class Geometry:
    """Many surfaces as one mesh, room frame, metres.

    Attributes:
        vertices: (V, 3).
        normals: smooth normals, (V, 3).
        uv: texture coordinates, metres, (V, 2).
        faces: (F, 3).
        material: index of the material of each face, (F,).
        materials: what the index points to.
    """

    def __init__(self, surfaces: Sequence[Surface]) -> None:
        sizes = [len(surface.uv) for surface in surfaces]
        self.first_vertex = np.cumsum([0, *sizes[:-1]])
        self.vertices: Array32 = np.concatenate([s.vertices for s in surfaces]).astype(np.float32)
        self.normals: Array32 = np.concatenate([s.normals for s in surfaces]).astype(np.float32)
        self.uv: Array32 = np.concatenate([s.uv for s in surfaces]).astype(np.float32)
        faces = [s.faces + first for s, first in zip(surfaces, self.first_vertex, strict=True)]
        self.faces = np.concatenate(faces).astype(np.int32)
        kinds = {id(surface.material): surface.material for surface in surfaces}
        order = {key: index for index, key in enumerate(kinds)}
        self.materials: list[Material] = list(kinds.values())
        self.material = np.repeat([order[id(s.material)] for s in surfaces], [len(s.faces) for s in surfaces])

    @cached_property
    def bounds(self) -> tuple[Array32, Array32]:
        """Lowest and highest corner, (3,) each."""
        return self.vertices.min(axis=0), self.vertices.max(axis=0)

    def cast(self, origins: Array32, directions: Array32) -> Hits:
        """Nearest hits of rays.

        Args:
            origins: (N, 3) or (3,), metres.
            directions: (N, 3), any length.
        """
        distance, face, weights = self._tree.cast(*_rows(origins, directions))
        ray = np.flatnonzero(face >= 0)
        return Hits(ray, distance[ray], face[ray], weights[ray])

    def blocks(self, origins: Array32, directions: Array32, reach: float = 1.0) -> NDArray[np.bool_]:
        """Tell for each ray whether something lies within `reach` times its direction, the first and last percent left out."""
        return self._tree.blocks(*_rows(origins, directions), 0.005 * reach, 0.99 * reach)

    def at_hits(self, per_vertex: Array32, hits: Hits) -> Array32:
        """Interpolate a value of the vertices, (V, C), to hits, (N, C)."""
        corners = self.faces.take(hits.face, axis=0)
        return np.einsum("nk,nkc->nc", hits.corner_weights, per_vertex.take(corners, axis=0))

    @cached_property
    def _tree(self) -> RayTree:
        return RayTree(self.vertices, self.faces)


def _rows(origins: Array32, directions: Array32) -> tuple[Array32, Array32]:
    """Origins, (1, 3) or (N, 3), and directions, (N, 3), as they lie in memory."""
    return np.ascontiguousarray(np.atleast_2d(origins), np.float32), np.ascontiguousarray(directions, np.float32)
