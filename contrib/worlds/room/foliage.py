"""Plants with thin parts: shrubs, reeds, bare twigs, shoots, trees and hedges; each built where it stands, room frame, metres."""

from collections.abc import Callable

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.contrib.worlds.room import textures
from ggvs_eval.contrib.worlds.room.surfaces import Material, Surface, blades, rod, sheet
from ggvs_eval.kernels.portable import cos, power, sin, unit
from ggvs_eval.kernels.portable import length as length_of

GREENS: tuple[textures.Colour, ...] = (
    (0.2, 0.36, 0.13),
    (0.31, 0.45, 0.16),
    (0.42, 0.5, 0.2),
    (0.26, 0.38, 0.24),
    (0.5, 0.34, 0.2),
)
BARK: tuple[textures.Colour, ...] = ((0.34, 0.27, 0.2), (0.45, 0.4, 0.34), (0.28, 0.2, 0.16))
# Light that passes through a leaf, as a multiple of its colour.
TRANSLUCENT = 0.12
Place = tuple[float, float]


def shrub(rng: np.random.Generator, place: Place, height: float) -> list[Surface]:
    """Stems that bend outwards, with leaves along them; the ground shows through."""
    stems = _curves(rng, place, int(rng.integers(7, 12)), height, bend=0.35, points=5)
    return [*_stalks(rng, stems, 0.006), *_leaves_along(rng, stems, int(rng.integers(18, 30)), rng.uniform(0.05, 0.09))]


def shoot(rng: np.random.Generator, place: Place, height: float) -> list[Surface]:
    """One thin stem with leaves."""
    stem = _curves(rng, place, 1, height, bend=0.2, points=5)
    return [*_stalks(rng, stem, 0.005), *_leaves_along(rng, stem, 26, 0.07)]


def hanging(rng: np.random.Generator, place: Place, length: float) -> list[Surface]:
    """Leafy shoots that hang down into the picture from 2.4 m."""
    stems = _curves(rng, place, int(rng.integers(2, 5)), length, bend=0.35, points=5)
    stems = stems * (1, 1, -1) + np.array([0, 0, 2.4])
    return [*_stalks(rng, stems, 0.005), *_leaves_along(rng, stems, int(rng.integers(18, 26)), rng.uniform(0.05, 0.08))]


def reeds(rng: np.random.Generator, place: Place, height: float) -> list[Surface]:
    """A clump of long blades, a few millimetres wide."""
    count, along = int(rng.integers(30, 50)), np.linspace(0, 1, 10)
    spines = _curves(rng, place, count, height, bend=0.4, points=len(along), spread=0.09)
    turn = rng.uniform(0, 2 * np.pi, count)
    across = np.stack([cos(turn), sin(turn), 0 * turn], -1)[:, None, None]  # (N, 1, 1, 3)
    half = 0.0045 * np.clip(1.15 - along, 0.05, 1)[None, :, None, None] * np.array([-1, 0, 1])[None, None, :, None]
    uv = np.stack(np.meshgrid([0, 0.005, 0.01], along * height), -1)
    return [blades(spines[:, :, None] + half * across, uv, _leaf_material(rng))]


def twigs(rng: np.random.Generator, place: Place, height: float) -> list[Surface]:
    """A bare little tree: every branch forks, down to 2 mm."""
    bark, parts = Material(textures.mottled(rng, BARK[int(rng.integers(len(BARK)))], 0.15), (0.5, 0.5)), []
    tips = [(np.array([*place, 0.0]), np.array([0.0, 0.0, 0.36 * height]), 0.009)]
    for _ in range(5):
        grown = []
        for start, step, radius in tips:
            end = start + step
            parts.append(rod(start, end, (radius, 0.8 * radius), bark, 6))
            for _ in range(2):
                turned = step + rng.normal(0, 0.42, 3) * length_of(step) * (1, 0.7, 0.6)
                grown.append((end, turned * rng.uniform(0.66, 0.86) * (1, 0.85, 1), max(0.72 * radius, 0.002)))
        tips = grown
    return parts


def tree(rng: np.random.Generator, place: Place) -> list[Surface]:
    """A trunk and a loose crown."""
    height = float(rng.uniform(2.6, 3.8))
    bark = Material(textures.mottled(rng, BARK[int(rng.integers(len(BARK)))], 0.2), (0.5, 0.5))
    trunk = rod((*place, 0), (place[0], place[1], 0.7 * height), (0.09, 0.05), bark)
    count = 600
    direction = rng.standard_normal((count, 3))
    direction *= (np.sqrt(rng.uniform(0.35, 1, count)) / length_of(direction))[:, None]
    centres = np.array([*place, 0.75 * height]) + direction * (0.95, 0.8, 0.8)
    return [trunk, _leaves(rng, centres, rng.uniform(-1, 1, (count, 3)), 0.18, rows=3)]


def hedge(rng: np.random.Generator, y: float, width: float) -> list[Surface]:
    """A clipped hedge with leaves that stand out of it."""
    height = float(rng.uniform(1.1, 1.6))
    x, z = np.meshgrid(np.linspace(-width / 2, width / 2, 120), np.linspace(0, height, 14))
    bumps = 0.12 * textures.fractal_noise(rng, x.shape, (5, 5), 3)
    size = (4.0, 1.6)
    tone = 1 + 0.4 * textures.fractal_noise(rng, (640, 1600), (18, 18), 4)
    texture = np.rint(np.clip(tone[..., None] * np.array((0.2, 0.3, 0.13)), 0.02, 0.9) * 255).astype(np.uint8)
    front = sheet(np.stack([x, y + bumps, z], -1), np.stack([x + width / 2, z], -1), Material(texture, size))
    count = 800
    centres = np.stack(
        [rng.uniform(-width / 2, width / 2, count), y - rng.uniform(0, 0.2, count), rng.uniform(0, height, count)], -1
    )
    return [front, _leaves(rng, centres, rng.normal(0, 1, (count, 3)) - np.array((0, 0.8, 0)), 0.15, rows=3)]


SHAPES: tuple[Callable[[np.random.Generator, Place, float], list[Surface]], ...] = (shrub, reeds, twigs)


def _curves(
    rng: np.random.Generator, place: Place, count: int, height: float, bend: float, points: int = 8, spread: float = 0.06
) -> Array:
    """Stems that grow from around a place and bend outwards, (count, points, 3)."""
    angle, tall = rng.uniform(0, 2 * np.pi, count), height * rng.uniform(0.65, 1.0, count)
    out = rng.uniform(0.15, 1.0, count) * bend * height
    along = np.linspace(0, 1, points)[None]
    foot = np.array(place) + rng.normal(0, spread, (count, 2))
    reach = out[:, None] * along**2
    x, y = foot[:, :1] + cos(angle)[:, None] * reach, foot[:, 1:] + sin(angle)[:, None] * reach
    return np.stack([x, y, tall[:, None] * along * (1 - 0.18 * along**2)], -1)


def _stalks(rng: np.random.Generator, stems: Array, radius: float) -> list[Surface]:
    bark = Material(textures.mottled(rng, BARK[int(rng.integers(len(BARK)))], 0.15), (0.5, 0.5))
    thin = np.linspace(radius, 0.25 * radius, stems.shape[1])
    return [rod(stem[k], stem[k + 1], (thin[k], thin[k + 1]), bark, 6) for stem in stems for k in range(0, stems.shape[1] - 1)]


def _leaves_along(rng: np.random.Generator, stems: Array, per_stem: int, length: float) -> list[Surface]:
    """Leaves that point away from the upper four fifths of each stem."""
    share = np.sort(rng.uniform(0.2, 1.0, (len(stems), per_stem)), axis=1) * (stems.shape[1] - 1)
    before = np.minimum(share.astype(int), stems.shape[1] - 2)
    rows = np.arange(len(stems))[:, None]
    weight = (share - before)[..., None]
    places = (1 - weight) * stems[rows, before] + weight * stems[rows, before + 1]
    angle = rng.uniform(0, 2 * np.pi, share.shape)
    pointing = np.stack([cos(angle), sin(angle), rng.uniform(-0.3, 0.7, share.shape)], -1)
    return [_leaves(rng, places.reshape(-1, 3), pointing.reshape(-1, 3), length)]


def _leaves(rng: np.random.Generator, places: Array, pointing: Array, length: float, rows: int = 4) -> Surface:
    """One leaf at each place, (N, 3), growing in its direction, (N, 3), bent downwards."""
    along = unit(pointing)
    across = unit(np.cross(along, (0, 0, 1)) + 1e-6)
    tilt = rng.uniform(-0.7, 0.7, (len(places), 1))
    across = across * cos(tilt) + np.cross(along, across) * sin(tilt)
    u, v = np.meshgrid(np.linspace(0, 1, rows), np.linspace(-1, 1, 3), indexing="ij")
    half = rng.uniform(0.16, 0.26) * power(sin(np.pi * np.clip(0.04 + 0.94 * u, 0, 1)), 0.8) * v
    size = length * rng.uniform(0.6, 1.2, (len(places), 1, 1, 1))
    spread = u[..., None] * along[:, None, None] + half[..., None] * across[:, None, None]
    sag = np.stack([0 * u, 0 * u, 0.12 * np.abs(v) * half - 0.35 * u**2], -1)
    uv = np.stack([u * length, half * length], -1)
    return blades(places[:, None, None] + size * (spread + sag), uv, _leaf_material(rng))


def _leaf_material(rng: np.random.Generator) -> Material:
    green = np.array(GREENS[int(rng.integers(len(GREENS)))]) * rng.uniform(0.8, 1.2)
    return Material(textures.mottled(rng, tuple(green), 0.22, 0.03), (0.5, 0.5), 0.12, 25, TRANSLUCENT)
