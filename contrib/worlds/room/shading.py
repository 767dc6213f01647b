"""Light that leaves a surface towards the eye: albedo from textures, baked light, highlights, and
the camera's tone curve.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array32
from ggvs_eval.contrib.worlds.room.lighting import Geometry, Highlight, Hits
from ggvs_eval.contrib.worlds.room.surfaces import Material
from ggvs_eval.kernels.portable import exp, power, shrink, unit

EXPOSURE = 1.0
LOBE_EDGE = 0.8
TO_LINEAR: Array32 = np.where(
    np.arange(256) <= 10,
    np.arange(256) / 255 / 12.92,
    power((np.arange(256) / 255 + 0.055) / 1.055, 2.4),
).astype(np.float32)


class Finish(NamedTuple):
    """Material at a set of hits.

    Attributes:
        albedo: linear, (N, 3).
        emission: multiple of the albedo that is sent out, (N, 1).
        specular: strength of highlights, (N,).
        shininess: their exponent, (N,).
    """

    albedo: Array32
    emission: Array32
    specular: Array32
    shininess: Array32

    def rows(self, index: NDArray[np.int64]) -> "Finish":
        """Return the finish of some of the hits."""
        return Finish(*(values[index] for values in self))


def read_finish(geometry: Geometry, hits: Hits, metres_per_pixel: float) -> Finish:
    """Look the materials up.

    Args:
        metres_per_pixel: size of a pixel at distance 1, metres; textures are prefiltered to it.
    """
    kind = geometry.material[hits.face]
    uv = geometry.at_hits(geometry.uv, hits)
    albedo = np.empty((len(kind), 3), np.float32)
    order = np.argsort(kind, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(kind[order])) + 1):
        if len(rows):
            material = geometry.materials[kind[rows[0]]]
            footprint_m = float(np.median(hits.distance[rows])) * metres_per_pixel
            albedo[rows] = sample_texture(material, uv[rows], footprint_m)
    table = np.array(
        [(m.emission, m.specular, m.shininess) for m in geometry.materials], np.float32
    )[kind]
    return Finish(albedo=albedo, emission=table[:, :1], specular=table[:, 1], shininess=table[:, 2])


def sample_texture(material: Material, uv: Array32, footprint_m: float) -> Array32:
    """Return the linear albedo at texture coordinates, bilinear, (N, 3).

    Args:
        uv: metres, (N, 2).
        footprint_m: the texture is first reduced so that its texels are about this large.
    """
    texel_m = material.tile_m[0] / material.texture.shape[1]
    texture = _linear_texture(material, max(1, int(footprint_m / texel_m)))
    height, width = texture.shape[:2]
    if height == width == 1:
        return np.broadcast_to(texture[0, 0], (len(uv), 3))
    x = uv[:, :1] / np.float32(material.tile_m[0] / width) - np.float32(0.5)
    y = -uv[:, 1:] / np.float32(material.tile_m[1] / height) - np.float32(0.5)
    left, top = np.floor(x), np.floor(y)
    columns, rows = (
        (_wrapped(a, n), _wrapped(a + 1, n)) for a, n in ((left, width), (top, height))
    )
    flat, x, y = texture.reshape(-1, 3), x - left, y - top
    upper, lower = (
        flat.take(row * width + columns[0], 0) * (1 - x)
        + flat.take(row * width + columns[1], 0) * x
        for row in rows
    )
    return upper * (1 - y) + lower * y


@lru_cache(maxsize=1024)
def _linear_texture(material: Material, factor: int) -> Array32:
    """Return the linear texture reduced by an integer factor, (h, w, 3)."""
    width, height = (max(1, size // factor) for size in material.texture.shape[1::-1])
    return shrink(TO_LINEAR[material.texture], height, width)


def _wrapped(index: Array32, size: int) -> NDArray[np.int32]:
    return index[:, 0].astype(np.int32) % np.int32(size)


def radiance(
    geometry: Geometry,
    hits: Hits,
    finish: Finish,
    light: Array32,
    highlights: list[Highlight],
    rays: Array32,
) -> Array32:
    """Return the light towards the eye, linear RGB, (N, 3).

    Args:
        light: irradiance of the geometry's vertices, (V, 3).
        rays: directions of the rays that hit, (N, 3).
    """
    irradiance = geometry.at_hits(light, hits)
    total = finish.albedo * (irradiance + finish.emission)
    glossy = np.flatnonzero(finish.specular)
    if len(glossy):
        total[glossy] += _mirrored(
            geometry,
            hits.rows(glossy),
            finish.rows(glossy),
            irradiance[glossy],
            highlights,
            rays[glossy],
        )
    return total


def _mirrored(
    geometry: Geometry,
    hits: Hits,
    finish: Finish,
    irradiance: Array32,
    highlights: list[Highlight],
    rays: Array32,
) -> Array32:
    """Highlights after Blinn and Phong, (N, 3).

    The diffuse light takes the place of their shadows.
    """
    normals = unit(geometry.at_hits(geometry.normals, hits))
    points = geometry.at_hits(geometry.vertices, hits)
    view, total = -unit(rays), np.zeros_like(points)
    for position, strength in highlights:
        towards = position - points
        squared = np.einsum("nc,nc->n", towards, towards)
        half = unit(towards / np.sqrt(squared)[:, None] + view)
        cosine = np.einsum("nc,nc->n", half, normals)
        # Beyond this angle even the broadest lobe in use is black.
        rows = np.flatnonzero(cosine > LOBE_EDGE)
        unshadowed = np.maximum(np.einsum("nc,nc->n", towards[rows], normals[rows]), 0) / (
            squared[rows] * np.sqrt(squared[rows])
        )
        visibility = np.clip(irradiance[rows, 1] / (strength[1] * unshadowed + 0.05), 0, 1)
        shininess = finish.shininess[rows]
        lobe = (
            (cosine[rows] - LOBE_EDGE)
            / (1 - LOBE_EDGE)
            * power(cosine[rows], shininess)
            * (shininess + 8)
            / 25
        )
        total[rows] += (finish.specular[rows] * lobe * visibility / np.maximum(squared[rows], 0.3))[
            :, None
        ] * strength
    return total


def expose(linear: Array32) -> Array32:
    """Return the picture of linear light as a camera gives it: a soft shoulder, then the sRGB
    curve; any shape, in [0, 1].
    """
    exposed = 1 - exp(-EXPOSURE * linear)
    return np.where(
        exposed <= 0.0031308, 12.92 * exposed, 1.055 * power(exposed, 1 / 2.4) - 0.055
    ).astype(np.float32)
