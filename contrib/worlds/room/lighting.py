"""Light on every vertex of a mesh that rays can hit: soft shadows and several bounces, baked once
for static surfaces.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array32
from ggvs_eval.contrib.worlds.room.room import Room
from ggvs_eval.contrib.worlds.room.surfaces import Material, Surface
from ggvs_eval.kernels._film import RayTree
from ggvs_eval.kernels.portable import cos, power, product, sin, transformed, unit


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
        return Hits(
            ray=self.ray[index],
            distance=self.distance[index],
            face=self.face[index],
            corner_weights=self.corner_weights[index],
        )


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
        self.material = np.repeat(
            [order[id(s.material)] for s in surfaces], [len(s.faces) for s in surfaces]
        )

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
        return Hits(ray=ray, distance=distance[ray], face=face[ray], corner_weights=weights[ray])

    def blocks(
        self, origins: Array32, directions: Array32, reach: float = 1.0
    ) -> NDArray[np.bool_]:
        """Return for each ray whether something is within `reach` times its direction, the first
        and last percent left out.
        """
        return self._tree.blocks(*_rows(origins, directions), 0.005 * reach, 0.99 * reach)

    def at_hits(self, per_vertex: Array32, hits: Hits) -> Array32:
        """Interpolate a value of the vertices, (V, C), to hits, (N, C)."""
        corners = self.faces.take(hits.face, axis=0)
        return np.einsum("nk,nkc->nc", hits.corner_weights, per_vertex.take(corners, axis=0))

    @cached_property
    def _tree(self) -> RayTree:
        return RayTree(self.vertices, self.faces)


def _rows(origins: Array32, directions: Array32) -> tuple[Array32, Array32]:
    """Origins, (1, 3) or (N, 3), and directions, (N, 3), as they are in memory."""
    return np.ascontiguousarray(np.atleast_2d(origins), np.float32), np.ascontiguousarray(
        directions, np.float32
    )


AMBIENT_DIRECTIONS = 64
BOUNCES = 4
OFFSET_M = 0.002
CONTACT_M = 0.7
BRIGHTEST_BOUNCE = 0.8
MIRRORED_POWER = 0.3
# A change of light below this share is left out: most of the room then keeps its pixels from frame
# to frame.
NOTICEABLE = 0.01
RAYS_AT_ONCE = 1_000_000


Highlight = tuple[Array32, Array32]


@dataclass(frozen=True, eq=False)
class Instant:
    """The room at one time, lit.

    Attributes:
        moving: what does; None if all of it is taken away.
        static_light: irradiance of the static vertices, RGB, (V, 3).
        moving_light: irradiance of the moving vertices, RGB, (V', 3).
        highlights: position and power of the strong lights, for specular reflection.
    """

    static: Geometry
    moving: Geometry | None
    static_light: Array32
    moving_light: Array32
    highlights: list[Highlight]


class _Baked(NamedTuple):
    """Light of the static surfaces.

    Attributes:
        transfer: share of each sample point's power that reaches each vertex, (V, S).
        radiosity: what each face sends out, the last one for "nothing seen", (F + 1, 3).
        ambient: what bounces onto each vertex, (V, 3).
    """

    transfer: Array32
    radiosity: Array32
    ambient: Array32


class LitRoom:
    """A room whose light is baked once; `at` gives it at any time."""

    def __init__(self, room: Room) -> None:
        self.room = room
        self.static = Geometry(room.static)
        # (S, 3)
        self._points = np.concatenate([light.points for light in room.lights]).astype(np.float32)
        self._light_of_point = np.repeat(
            np.arange(len(room.lights)), [len(light.points) for light in room.lights]
        )
        self._directions = hemisphere(AMBIENT_DIRECTIONS)
        # (F, 3)
        self._albedo = np.stack([mean_albedo(material) for material in self.static.materials])[
            self.static.material
        ]

    def at(self, time_s: float) -> Instant:
        """Return the lit room at an instant."""
        moving, power = Geometry(self.room.at(time_s)), self._power(time_s)
        transfer, ambient = self._shadowed([Geometry(mover(time_s)) for mover in self.room.movers])
        static_light = _sum_over_points(transfer, power) + ambient
        noticed = np.abs(static_light - self._resting_light) > NOTICEABLE * self._resting_light
        static_light = np.where(noticed, static_light, self._resting_light)
        direct = _sum_over_points(self._direct_transfer(moving, self.static, moving), power)
        return Instant(
            static=self.static,
            moving=moving,
            static_light=static_light,
            moving_light=direct + self._ambient_on(moving),
            highlights=self._highlights(power),
        )

    def empty(self) -> Instant:
        """Return the room at time 0 without anything that moves and without its shadows."""
        return Instant(
            static=self.static,
            moving=None,
            static_light=self._resting_light,
            moving_light=np.zeros((0, 3), np.float32),
            highlights=self._highlights(self._power(0.0)),
        )

    def recall(self, time_s: float, static_light: Array32, moving_light: Array32) -> Instant:
        """Return the instant of which `at` gave these two, without computing them again."""
        moving, highlights = Geometry(self.room.at(time_s)), self._highlights(self._power(time_s))
        return Instant(
            static=self.static,
            moving=moving,
            static_light=static_light,
            moving_light=moving_light,
            highlights=highlights,
        )

    @cached_property
    def _baked(self) -> _Baked:
        """Light baked into static content.

        Made on first use, as recalling instants needs none of it.
        """
        return _Baked(*self._bake())

    @cached_property
    def _resting_light(self) -> Array32:
        """Irradiance of the static vertices at time 0 without what moves, (V, 3)."""
        return _sum_over_points(self._baked.transfer, self._power(0.0)) + self._baked.ambient

    def _bake(self) -> tuple[Array32, Array32, Array32]:
        """Compute the light of the static surfaces."""
        transfer = self._direct_transfer(self.static, self.static)
        faces = self._seen_faces(self.static, self.static.vertices, self.static.normals)  # (V, A)
        return transfer, *self._bounce(_sum_over_points(transfer, self._power(0.0)), faces)

    def _power(self, time_s: float) -> Array32:
        """Power of each sample point, (S, 3)."""
        powers = [np.asarray(light.power(time_s)) / len(light.points) for light in self.room.lights]
        return np.stack(powers).astype(np.float32)[self._light_of_point]

    def _highlights(self, power: Array32) -> list[Highlight]:
        groups = [self._light_of_point == index for index in range(len(self.room.lights))]
        lamps = [(self._points[group].mean(axis=0), power[group].sum(axis=0)) for group in groups]
        return [lamp for lamp in lamps if lamp[1].max() > MIRRORED_POWER]

    def _direct_transfer(self, receiver: Geometry, *blockers: Geometry) -> Array32:
        """Return the share of each sample point's power that reaches each vertex, (V, S)."""
        origins = receiver.vertices + OFFSET_M * receiver.normals
        transfer = np.zeros((len(origins), len(self._points)), np.float32)
        for index, point in enumerate(self._points):
            towards = point - origins  # (V, 3)
            transfer[:, index] = self._form_factor(index, towards, receiver.normals)
            lit = np.flatnonzero(transfer[:, index])
            for blocker in blockers:
                transfer[lit[blocker.blocks(origins[lit], towards[lit])], index] = 0.0
        return transfer

    def _form_factor(self, index: int, towards: Array32, normals: Array32) -> Array32:
        squared = np.einsum("vc,vc->v", towards, towards)
        factor = np.maximum(np.einsum("vc,vc->v", towards, normals), 0.0) / (
            squared * np.sqrt(squared)
        )
        normal = self.room.lights[self._light_of_point[index]].normal
        if normal is not None:
            factor *= np.maximum(
                -transformed(normal[None].astype(np.float32), towards)[:, 0], 0.0
            ) / np.sqrt(squared)
        # A lamp is no point: nearer than its own size the inverse square would run away.
        return np.minimum(factor, 60.0)

    def _seen_faces(
        self, target: Geometry, vertices: Array32, normals: Array32
    ) -> NDArray[np.int64]:
        """Static face that each vertex sees in each ambient direction, -1 for none, (V, A)."""
        seen_faces = np.full((len(vertices), AMBIENT_DIRECTIONS), -1, np.int64)
        for rows in _chunks(len(vertices)):
            directions = around(normals[rows], self._directions)  # (R, A, 3)
            origins = np.repeat(
                vertices[rows] + OFFSET_M * normals[rows], AMBIENT_DIRECTIONS, axis=0
            )
            hits = target.cast(origins, directions.reshape(-1, 3))
            flat = np.full(directions.shape[0] * AMBIENT_DIRECTIONS, -1, np.int64)
            flat[hits.ray] = hits.face
            seen_faces[rows] = flat.reshape(-1, AMBIENT_DIRECTIONS)
        return seen_faces

    def _bounce(self, direct: Array32, seen_faces: NDArray[np.int64]) -> tuple[Array32, Array32]:
        """Let light bounce; gives what each face sends out (F + 1, 3) and what bounces onto each
        vertex (V, 3).
        """
        ambient = np.zeros_like(direct)
        for _ in range(BOUNCES):
            radiosity = self._albedo * (direct + ambient)[self.static.faces].mean(axis=1)
            # A surface right at a lamp is far brighter than the rest and would show each single
            # direction as a blot.
            radiosity = np.minimum(radiosity, BRIGHTEST_BOUNCE)
            # the last one is for "nothing seen"
            radiosity = np.concatenate([radiosity, np.zeros((1, 3), np.float32)])
            ambient = np.stack(
                [radiosity[seen_faces, channel].mean(axis=1) for channel in range(3)], axis=-1
            )
        return radiosity, ambient

    def _shadowed(self, casters: list[Geometry]) -> tuple[Array32, Array32]:
        """Transfer (V, S) and ambient light (V, 3) of the static vertices with moving things in the
        way.
        """
        origins = self.static.vertices + OFFSET_M * self.static.normals
        transfer, ambient = self._baked.transfer.copy(), self._baked.ambient.copy()
        for caster in casters:
            for index, point in enumerate(self._points):
                lit = np.flatnonzero(transfer[:, index])
                lit = lit[_crosses(caster.bounds, origins[lit], point)]
                transfer[lit[caster.blocks(origins[lit], point - origins[lit])], index] = 0.0
            near = np.flatnonzero(_within(caster.bounds, self.static.vertices, CONTACT_M))
            ambient[near] *= 1 - self._covered(caster, near)[:, None]
        return transfer, ambient

    def _covered(self, moving: Geometry, rows: NDArray[np.int64]) -> Array32:
        """Return the share of the hemisphere over static vertices that moving things cover nearby,
        (R,).
        """
        share = np.zeros(len(rows), np.float32)
        for chunk in _chunks(len(rows)):
            normals = self.static.normals[rows[chunk]]
            directions = around(normals, self._directions)
            origins = np.repeat(
                self.static.vertices[rows[chunk]] + OFFSET_M * normals, AMBIENT_DIRECTIONS, axis=0
            )
            blocked = moving.blocks(origins, directions.reshape(-1, 3), CONTACT_M)
            share[chunk] = blocked.reshape(-1, AMBIENT_DIRECTIONS).mean(axis=1)
        return share

    def _ambient_on(self, moving: Geometry) -> Array32:
        """Return the light that bounces onto moving vertices, (V', 3).

        What other moving things cover is dark.
        """
        seen_faces = self._seen_faces(self.static, moving.vertices, moving.normals)
        directions = around(moving.normals, self._directions).reshape(-1, 3)
        origins = np.repeat(moving.vertices + OFFSET_M * moving.normals, AMBIENT_DIRECTIONS, axis=0)
        seen_faces[moving.blocks(origins, directions, CONTACT_M).reshape(seen_faces.shape)] = -1
        return np.stack(
            [self._baked.radiosity[seen_faces, channel].mean(axis=1) for channel in range(3)],
            axis=-1,
        )


def hemisphere(count: int) -> Array32:
    """Return the directions around +z whose density falls with the cosine, (count, 3): a Fibonacci
    spiral.
    """
    index = np.arange(count) + 0.5
    radius, angle = np.sqrt(index / count), index * np.pi * (3 - np.sqrt(5))
    return np.stack([radius * cos(angle), radius * sin(angle), np.sqrt(1 - radius**2)], -1).astype(
        np.float32
    )


def around(normals: Array32, directions: Array32) -> Array32:
    """Return the directions (A, 3) around +z turned about each normal (V, 3), (V, A, 3)."""
    helper = np.where(
        np.abs(normals[:, 2:]) < 0.9,
        np.array([[0, 0, 1]], np.float32),
        np.array([[1, 0, 0]], np.float32),
    )
    first = unit(np.cross(helper, normals))
    # (V, 3, 3), rows are the axes
    frame = np.stack([first, np.cross(normals, first), normals], axis=1)
    turned = directions[:, 0, None] * frame[:, None, 0]  # (V, A, 3)
    for axis in (1, 2):
        turned += directions[:, axis, None] * frame[:, None, axis]
    return turned


def mean_albedo(material: Material) -> Array32:
    """Return the mean linear albedo of a material, (3,)."""
    linear = power(np.arange(256) / 255.0, 2.2)
    return linear[material.texture[::4, ::4].reshape(-1, 3)].mean(axis=0).astype(np.float32)


def _sum_over_points(transfer: Array32, power: Array32) -> Array32:
    """Irradiance (V, 3) of transfer (V, S) and power (S, 3)."""
    return product(transfer, power)


def _chunks(count: int) -> list[slice]:
    rows = max(1, RAYS_AT_ONCE // AMBIENT_DIRECTIONS)
    return [slice(start, min(start + rows, count)) for start in range(0, count, rows)]


def _crosses(
    bounds: tuple[Array32, Array32], origins: Array32, point: Array32
) -> NDArray[np.bool_]:
    """Return whether the segment from each origin to a point meets a box, (N,)."""
    enter, leave = np.zeros(len(origins), np.float32), np.ones(len(origins), np.float32)
    with np.errstate(divide="ignore", invalid="ignore"):
        for axis in range(3):
            inverse = 1 / (point[axis] - origins[:, axis])
            first, second = ((bound[axis] - origins[:, axis]) * inverse for bound in bounds)
            # fmin and fmax pass over NaN: 0 / 0 if the segment runs within a side of the box.
            np.fmax(enter, np.fmin(first, second), out=enter)
            np.fmin(leave, np.fmax(first, second), out=leave)
    return enter <= leave


def _within(bounds: tuple[Array32, Array32], points: Array32, reach: float) -> NDArray[np.bool_]:
    inside: NDArray[np.bool_] = (points > bounds[0] - reach) & (points < bounds[1] + reach)
    return np.asarray(inside.all(axis=1))
