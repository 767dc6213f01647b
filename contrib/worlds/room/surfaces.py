"""Textured surfaces made of grids: panels, boxes, turned bodies and tubes, as triangles with
texture coordinates.

Room frame: metres, x right, y into the room, z up. Texture coordinates are metres on the surface,
the second one upwards.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array, Image8
from ggvs_eval.kernels.portable import cos, inverse, length, rotation_about, sin, transformed, unit

Vector = Sequence[float] | Array
Profile = Sequence[tuple[float, float]] | Array
# The first axis of a rod is across this one; no limb points along it.
ROLL_AXIS = np.array([0.0, 0.8, 0.6])


@dataclass(frozen=True, eq=False)
class Material:
    """Reflectance and emission of a surface.

    Attributes:
        texture: albedo, sRGB uint8 (h, w, 3).
        tile_m: width and height that one copy of the texture covers, metres; it repeats beyond.
        specular: strength of the highlight, 0 for none.
        emission: light sent out alone, as a multiple of the texture.
    """

    texture: Image8
    tile_m: tuple[float, float] = (1.0, 1.0)
    specular: float = 0.0
    shininess: float = 40.0
    emission: float = 0.0


@dataclass(frozen=True, eq=False)
class Surface:
    """One mesh of one material.

    Attributes:
        vertices: room frame, metres, (V, 3).
        normals: smooth, (V, 3).
        faces: indices of the vertices of each triangle, (F, 3).
        uv: texture coordinates of the vertices, metres, (V, 2).
    """

    vertices: Array
    normals: Array
    faces: NDArray[np.int64]
    uv: Array
    material: Material

    def moved(self, transform: Array) -> "Surface":
        """Return the same surface after a rigid or scaling transform, (4, 4)."""
        vertices = transformed(transform[:3, :3], self.vertices) + transform[:3, 3]
        normals = transformed(inverse(transform[:3, :3]).T, self.normals)
        return replace(self, vertices=vertices, normals=unit(normals))


def moved(surfaces: Sequence[Surface], transform: Array) -> list[Surface]:
    """Return all surfaces after one transform, (4, 4)."""
    return [surface.moved(transform) for surface in surfaces]


def translation(x: float, y: float, z: float) -> Array:
    """Return the transform that shifts, metres."""
    transform = np.eye(4)
    transform[:3, 3] = x, y, z
    return transform


def rotation(angle_rad: float, axis: Vector, pivot: Vector = (0.0, 0.0, 0.0)) -> Array:
    """Return the transform that turns about an axis through a pivot."""
    transform, centre = np.eye(4), np.asarray(pivot, np.float64)
    transform[:3, :3] = rotation_about(angle_rad, axis)
    transform[:3, 3] = centre - transformed(transform[:3, :3], centre)
    return transform


def sheet(points: Array, uv: Array, material: Material, closed: bool = False) -> Surface:
    """Surface through a grid of points.

    Args:
        points: (n, m, 3); the outside is on the side of (along columns) x (along rows).
        uv: (n, m, 2), metres.
        closed: the last column repeats the first one, with another texture coordinate.
    """
    along = np.gradient(points, axis=1)
    if closed:
        along[:, 0] = along[:, -1] = (points[:, 1] - points[:, -2]) / 2
    normals = unit(np.cross(along, np.gradient(points, axis=0)))
    index = np.arange(points.shape[0] * points.shape[1]).reshape(points.shape[:2])
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate(
        [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    )
    return Surface(
        vertices=points.reshape(-1, 3),
        normals=normals.reshape(-1, 3),
        faces=faces,
        uv=uv.reshape(-1, 2),
        material=material,
    )


def blades(points: Array, uv: Array, material: Material, thickness_m: float = 0.001) -> Surface:
    """Many thin sheets of one material as one surface, each seen from both sides.

    Args:
        points: (N, n, m, 3).
        uv: of all sheets, (n, m, 2), metres.
    """
    normals = unit(np.cross(np.gradient(points, axis=2), np.gradient(points, axis=1)))
    vertices = np.stack([points, points - thickness_m * normals]).reshape(-1, 3)
    count, size = 2 * len(points), points.shape[1] * points.shape[2]
    index = np.arange(size).reshape(points.shape[1:3])
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate(
        [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    )
    faces = (size * np.arange(count)[:, None, None] + faces).reshape(-1, 3)
    normals = np.stack([normals, -normals]).reshape(-1, 3)
    return Surface(
        vertices=vertices,
        normals=normals,
        faces=faces,
        uv=np.tile(uv.reshape(-1, 2), (count, 1)),
        material=material,
    )


def panel(
    corner: Vector, edge_u: Vector, edge_v: Vector, material: Material, cell_m: float = 0.05
) -> Surface:
    """Flat rectangle from a corner along two edges.

    Its outside is edge_u x edge_v, its texture starts at the corner.
    """
    corner, edge_u, edge_v = (np.asarray(vector, np.float64) for vector in (corner, edge_u, edge_v))
    lengths = length(edge_u), length(edge_v)
    u, v = (np.linspace(0, 1, int(np.ceil(side / cell_m)) + 1) for side in lengths)
    grid_u, grid_v = np.meshgrid(u, v)
    points = corner + grid_u[..., None] * edge_u + grid_v[..., None] * edge_v
    return sheet(points, np.stack([grid_u * lengths[0], grid_v * lengths[1]], -1), material)


def box(low: Vector, high: Vector, material: Material, cell_m: float = 0.05) -> list[Surface]:
    """Return the six sides of an axis-parallel box.

    The texture's rows run along the longer edge of each side, as grain does.
    """
    low, high = np.asarray(low, np.float64), np.asarray(high, np.float64)
    sides = []
    for axis in range(3):
        edges = [np.eye(3)[k] * (high - low)[k] for k in ((axis + 1) % 3, (axis + 2) % 3)]
        for corner, pair in ((high - edges[0] - edges[1], edges), (low, edges[::-1])):
            u, v = pair
            if length(v) > length(u):
                corner, u, v = corner + u, v, -u
            sides.append(panel(corner, u, v, material, cell_m))
    return sides


def turned(profile: Profile, material: Material, sides: int = 24) -> Surface:
    """Body of revolution about z.

    Args:
        profile: (n, 2) radius and height in metres, from the bottom upwards; radii of 0 close the
            body.
    """
    profile = np.asarray(profile, np.float64)
    radius, height = np.maximum(profile[:, 0], 1e-5)[:, None], profile[:, 1][:, None]
    angle = np.linspace(0, 2 * np.pi, sides + 1)[None]
    points = np.stack([radius * cos(angle), radius * sin(angle), height + 0 * angle], axis=-1)
    points[:, -1] = points[:, 0]
    along = np.concatenate([[0.0], np.cumsum(length(np.diff(profile, axis=0)))])[:, None]
    return sheet(
        points,
        np.stack([angle * radius.max() + 0 * along, along + 0 * angle], -1),
        material,
        closed=True,
    )


def ellipsoid(radii: Vector, material: Material, sides: int = 24) -> Surface:
    """Ellipsoid about the origin with the given half axes, metres."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, sides // 2 + 1)
    ball = turned(np.stack([cos(angle), sin(angle)], -1), material, sides)
    scaled = ball.moved(np.diag([*radii, 1.0]))
    return replace(scaled, uv=ball.uv * float(np.mean(np.asarray(radii))))


def rod(
    start: Vector, end: Vector, radii: tuple[float, float], material: Material, sides: int = 12
) -> Surface:
    """Straight tapered rod with round ends between two points.

    Radii at the start and at the end, metres.
    """
    start, end = np.asarray(start, np.float64), np.asarray(end, np.float64)
    height = float(length(end - start))
    cap = np.linspace(0, np.pi / 2, 4)
    bottom = np.stack([radii[0] * sin(cap), -radii[0] * cos(cap)], -1)
    top = np.stack([radii[1] * cos(cap), height + radii[1] * sin(cap)], -1)
    middle = np.linspace(0, 1, max(2, int(height / 0.05) + 1))[1:-1, None]
    profile = np.concatenate([bottom, bottom[-1] * (1 - middle) + top[0] * middle, top])
    return turned(profile, material, sides).moved(_z_towards(start, end - start))


def _z_towards(origin: Array, direction: Array) -> Array:
    """Return the rigid transform that takes the z axis to a direction and the origin to a point."""
    transform, upwards = np.eye(4), unit(direction)
    across = np.cross(ROLL_AXIS, upwards)
    across = unit(across if length(across) > 1e-3 else np.cross((1.0, 0.0, 0.0), upwards))
    transform[:3] = np.stack([across, np.cross(upwards, across), upwards, origin], axis=1)
    return transform
