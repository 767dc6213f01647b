"""Colours of the stereo scenes' surfaces: texture, grain, light, shadow and gloss, the same for a point in both views."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from ggvs_eval.arrays import Map, Vector
from ggvs_eval.synthetic.stereo.stereo_textures import TextureBank, sample


@dataclass(frozen=True, eq=False)
class Look:
    """How a thing is painted.

    Attributes:
        texture: index into the bank's colour textures.
        texels: scale of the texture, texels per pixel at the thing's own disparity; after `at`, texels per baseline.
        turn: angle of the texture, radians.
        shift: position of the texture, texels.
        gain: factor on the texture's colour, (3,).
        bias: added to it, in [0, 1], (3,).
        grain: index into the bank's grey textures.
        grain_texels: scale of the grain, as `texels`.
        grain_strength: relative change of the colour by the grain.
        gloss: strength of the highlight.
        sharpness: its exponent.
    """

    texture: int
    texels: float
    turn: float
    shift: tuple[float, float]
    gain: Vector
    bias: Vector
    grain: int
    grain_texels: float
    grain_strength: float
    gloss: float
    sharpness: float

    def at(self, disparity: float) -> "Look":
        """The look with its scales fixed for a thing at a disparity."""
        return replace(self, texels=self.texels * disparity, grain_texels=self.grain_texels * disparity)


@dataclass(frozen=True, eq=False)
class Light:
    """One lamp far away, and dapples that lie in space.

    Attributes:
        direction: unit vector towards the lamp, (3,).
        ambient: share of the light that comes from everywhere.
        dapples: rows (frequency along x, y, z in radians per baseline, phase), (K, 4); K may be 0.
        dapple_strength: relative change of the light by the dapples.
        dapple_sharpness: 1 = soft, 10 = edges of shadows.
    """

    direction: Vector
    ambient: float
    dapples: Vector
    dapple_strength: float
    dapple_sharpness: float


def paint(
    look: Look, light: Light, bank: TextureBank, points: Map, surface: tuple[Map, Map, Map], focal_px: float, eye: float
) -> Map:
    """Colours of points of one thing.

    Args:
        look: of the thing, its scales fixed.
        light: of the scene.
        bank: the textures.
        points: in the space of `stereo_shapes`, (3, N), N < 32767.
        surface: their coordinates u and v, (N,), and unit normals, (3, N) or (3, 1).
        focal_px: focal length, pixels.
        eye: position of the eye on the baseline; only gloss depends on it.

    Returns:
        Colours, neither clipped nor rounded, [0, 255] and a little more, float32 (N, 3).
    """
    u, v, normal = surface
    away = _dot(normal, points)
    facing = np.where(away > 0, np.float32(-1), np.float32(1))
    # Baselines per pixel. The slant is that towards the left eye in both views, so that a point is equally sharp in both.
    slant = np.abs(away) / np.sqrt(_dot(points, points))
    pixel = points[2] * np.float32(1 / focal_px) / np.sqrt(np.maximum(slant, np.float32(0.02)))
    colour = _pattern(look, bank, u, v, pixel)
    brightness = _brightness(light, points, facing * _dot(light.direction.astype(np.float32), normal))
    if look.grain_strength > 0:
        scale = np.float32(look.grain_texels)
        grain = sample(bank.greys[look.grain], u * scale, v * scale, pixel * scale)
        brightness *= 1 + np.float32(look.grain_strength) * (grain * np.float32(1 / 128) - 1)
    colour *= brightness[:, None]
    if look.gloss > 0:
        cosine = _highlight(light, points, normal, facing, eye)
        colour += (np.float32(255 * look.gloss) * cosine ** np.float32(look.sharpness))[:, None]
    return colour


def _pattern(look: Look, bank: TextureBank, u: Map, v: Map, pixel: Map) -> Map:
    """Colour under even light, (N, 3), of surface points where a pixel covers `pixel` baselines."""
    if not look.gain.any():
        return np.full((len(u), 3), 255 * look.bias, np.float32)
    cos, sin = (np.float32(look.texels * f(look.turn)) for f in (np.cos, np.sin))
    s, t = cos * u + sin * v + np.float32(look.shift[0]), cos * v - sin * u + np.float32(look.shift[1])
    texture = sample(bank.colours[look.texture], s, t, pixel * np.float32(look.texels))
    change = np.column_stack([np.diag(look.gain), 255 * look.bias])
    return np.asarray(cv2.transform(texture[None], change)[0], np.float32)


def _brightness(light: Light, points: Map, cosine: Map) -> Map:
    """Light that each point receives, about 1."""
    brightness = np.float32(light.ambient) + np.float32(1.2 - light.ambient) * np.maximum(cosine, 0)
    if light.dapple_strength == 0:
        return brightness
    waves = np.zeros_like(points[0])
    for row in light.dapples.astype(np.float32):
        waves += np.sin(_dot(row, points) + row[3])
    waves *= np.float32(light.dapple_sharpness)
    # x / sqrt(1 + x^2) is a cheap step
    return brightness * (1 + np.float32(light.dapple_strength) * waves / np.sqrt(1 + waves * waves))


def _highlight(light: Light, points: Map, normal: Map, facing: Map, eye: float) -> Map:
    """Cosine between the normal and the middle of lamp and eye (Blinn); it depends on the eye, as on varnish and metal."""
    x, y, z = np.float32(eye) - points[0], -points[1], -points[2]
    length = np.sqrt(x * x + y * y + z * z)
    a, b, c = light.direction.astype(np.float32)
    x, y, z = x / length + a, y / length + b, z / length + c
    cosine = facing * (normal[0] * x + normal[1] * y + normal[2] * z)
    return np.maximum(cosine, 0) / np.maximum(np.sqrt(x * x + y * y + z * z), np.float32(1e-6))


def _dot(first: Map, second: Map) -> Map:
    return first[0] * second[0] + first[1] * second[1] + first[2] * second[2]
