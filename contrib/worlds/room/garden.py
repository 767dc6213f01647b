"""A garden: thin foliage close to the cameras, a house, a hedge and the sky far behind it, laid out
by a seed.

Room frame: metres, x right, y away from the cameras, z up; the rig is around x = y = 0 as in the
living room.
"""

from collections.abc import Callable

import numpy as np

from ggvs_eval.arrays import Array, Image8
from ggvs_eval.contrib.worlds.room import textures
from ggvs_eval.contrib.worlds.room.figure import random_figure
from ggvs_eval.contrib.worlds.room.room import Light, Mover, Room
from ggvs_eval.contrib.worlds.room.surfaces import (
    Material,
    Surface,
    blades,
    box,
    moved,
    panel,
    rod,
    rotation,
    sheet,
    translation,
)
from ggvs_eval.kernels.portable import cos, power, product, sin, unit
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
    """Return the stems that bend outwards, with leaves along them; the ground shows through."""
    stems = _curves(rng, place, int(rng.integers(7, 12)), height, bend=0.35, points=5)
    return [
        *_stalks(rng, stems, 0.006),
        *_leaves_along(rng, stems, int(rng.integers(18, 30)), rng.uniform(0.05, 0.09)),
    ]


def shoot(rng: np.random.Generator, place: Place, height: float) -> list[Surface]:
    """Return one thin stem with leaves."""
    stem = _curves(rng, place, 1, height, bend=0.2, points=5)
    return [*_stalks(rng, stem, 0.005), *_leaves_along(rng, stem, 26, 0.07)]


def hanging(rng: np.random.Generator, place: Place, length: float) -> list[Surface]:
    """Leafy shoots that hang down into the picture from 2.4 m."""
    stems = _curves(rng, place, int(rng.integers(2, 5)), length, bend=0.35, points=5)
    stems = stems * (1, 1, -1) + np.array([0, 0, 2.4])
    return [
        *_stalks(rng, stems, 0.005),
        *_leaves_along(rng, stems, int(rng.integers(18, 26)), rng.uniform(0.05, 0.08)),
    ]


def reeds(rng: np.random.Generator, place: Place, height: float) -> list[Surface]:
    """Return a clump of long blades, a few millimetres wide."""
    count, along = int(rng.integers(30, 50)), np.linspace(0, 1, 10)
    spines = _curves(rng, place, count, height, bend=0.4, points=len(along), spread=0.09)
    turn = rng.uniform(0, 2 * np.pi, count)
    across = np.stack([cos(turn), sin(turn), 0 * turn], -1)[:, None, None]  # (N, 1, 1, 3)
    half = (
        0.0045
        * np.clip(1.15 - along, 0.05, 1)[None, :, None, None]
        * np.array([-1, 0, 1])[None, None, :, None]
    )
    uv = np.stack(np.meshgrid([0, 0.005, 0.01], along * height), -1)
    return [blades(spines[:, :, None] + half * across, uv, _leaf_material(rng))]


def twigs(rng: np.random.Generator, place: Place, height: float) -> list[Surface]:
    """Return a bare little tree: every branch forks, down to 2 mm."""
    bark, parts = (
        Material(textures.mottled(rng, BARK[int(rng.integers(len(BARK)))], 0.15), (0.5, 0.5)),
        [],
    )
    tips = [(np.array([*place, 0.0]), np.array([0.0, 0.0, 0.36 * height]), 0.009)]
    for _ in range(5):
        grown = []
        for start, step, radius in tips:
            end = start + step
            parts.append(rod(start, end, (radius, 0.8 * radius), bark, 6))
            for _ in range(2):
                turned = step + rng.normal(0, 0.42, 3) * length_of(step) * (1, 0.7, 0.6)
                grown.append(
                    (
                        end,
                        turned * rng.uniform(0.66, 0.86) * (1, 0.85, 1),
                        max(0.72 * radius, 0.002),
                    )
                )
        tips = grown
    return parts


def tree(rng: np.random.Generator, place: Place) -> list[Surface]:
    """Return a trunk and a loose crown."""
    height = float(rng.uniform(2.6, 3.8))
    bark = Material(textures.mottled(rng, BARK[int(rng.integers(len(BARK)))], 0.2), (0.5, 0.5))
    trunk = rod((*place, 0), (place[0], place[1], 0.7 * height), (0.09, 0.05), bark)
    count = 600
    direction = rng.standard_normal((count, 3))
    direction *= (np.sqrt(rng.uniform(0.35, 1, count)) / length_of(direction))[:, None]
    centres = np.array([*place, 0.75 * height]) + direction * (0.95, 0.8, 0.8)
    return [trunk, _leaves(rng, centres, rng.uniform(-1, 1, (count, 3)), 0.18, rows=3)]


def hedge(rng: np.random.Generator, y: float, width: float) -> list[Surface]:
    """Return a clipped hedge with protruding leaves."""
    height = float(rng.uniform(1.1, 1.6))
    x, z = np.meshgrid(np.linspace(-width / 2, width / 2, 120), np.linspace(0, height, 14))
    bumps = 0.12 * textures.fractal_noise(rng, x.shape, (5, 5), 3)
    size = (4.0, 1.6)
    tone = 1 + 0.4 * textures.fractal_noise(rng, (640, 1600), (18, 18), 4)
    texture = np.rint(
        np.clip(tone[..., None] * np.array((0.2, 0.3, 0.13)), 0.02, 0.9) * 255
    ).astype(np.uint8)
    front = sheet(
        np.stack([x, y + bumps, z], -1), np.stack([x + width / 2, z], -1), Material(texture, size)
    )
    count = 800
    centres = np.stack(
        [
            rng.uniform(-width / 2, width / 2, count),
            y - rng.uniform(0, 0.2, count),
            rng.uniform(0, height, count),
        ],
        -1,
    )
    return [
        front,
        _leaves(rng, centres, rng.normal(0, 1, (count, 3)) - np.array((0, 0.8, 0)), 0.15, rows=3),
    ]


SHAPES: tuple[Callable[[np.random.Generator, Place, float], list[Surface]], ...] = (
    shrub,
    reeds,
    twigs,
)


def _curves(
    rng: np.random.Generator,
    place: Place,
    count: int,
    height: float,
    bend: float,
    points: int = 8,
    spread: float = 0.06,
) -> Array:
    """Return the stems that grow from around a place and bend outwards, (count, points, 3)."""
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
    return [
        rod(stem[k], stem[k + 1], (thin[k], thin[k + 1]), bark, 6)
        for stem in stems
        for k in range(0, stems.shape[1] - 1)
    ]


def _leaves_along(
    rng: np.random.Generator, stems: Array, per_stem: int, length: float
) -> list[Surface]:
    """Leaves that point away from the upper four fifths of each stem."""
    share = np.sort(rng.uniform(0.2, 1.0, (len(stems), per_stem)), axis=1) * (stems.shape[1] - 1)
    before = np.minimum(share.astype(int), stems.shape[1] - 2)
    rows = np.arange(len(stems))[:, None]
    weight = (share - before)[..., None]
    places = (1 - weight) * stems[rows, before] + weight * stems[rows, before + 1]
    angle = rng.uniform(0, 2 * np.pi, share.shape)
    pointing = np.stack([cos(angle), sin(angle), rng.uniform(-0.3, 0.7, share.shape)], -1)
    return [_leaves(rng, places.reshape(-1, 3), pointing.reshape(-1, 3), length)]


def _leaves(
    rng: np.random.Generator, places: Array, pointing: Array, length: float, rows: int = 4
) -> Surface:
    """Return one leaf at each place, (N, 3), growing in its direction, (N, 3), bent downwards."""
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
    return Material(
        texture=textures.mottled(rng, tuple(green), 0.22, 0.03),
        tile_m=(0.5, 0.5),
        specular=0.12,
        shininess=25,
        emission=TRANSLUCENT,
    )


SKY_RADIUS_M, SKY_TOP_M, SKY_BOTTOM_M, SKY_HALF_RAD = 17.0, 17.0, -1.0, np.radians(125)
SKY_CENTRE_Y_M = 1.5
BACKDROP_TEXELS_PER_METRE = 60
SUN_M, SUN_RADIUS_M, SUN_POINTS = 16.0, 0.25, 8
SKY_POINTS = 20
SUNSHINE, SKYLIGHT = np.array([2.3, 2.1, 1.8]), np.array([0.75, 0.85, 1.0])


def build_garden(seed: int) -> Room:
    """Lay out a garden; equal seeds give equal gardens."""
    rng = np.random.default_rng([seed, 14])
    static = [*_ground(rng), *_backdrop(rng), *_house(rng), *hedge(rng, 6.2, 17.0), *_fence(rng)]
    for x, y in ((-3.2, 4.6), (2.9, 5.2), (-0.6, 7.4)):
        static += tree(rng, (x + rng.uniform(-0.5, 0.5), y + rng.uniform(-0.4, 0.4)))
    static += _foreground(rng)
    return Room(static, [_sun(rng), _sky()], [_person(rng), _swaying_branch(rng)])


def _foreground(rng: np.random.Generator) -> list[Surface]:
    """Shrubs, reeds and bare twigs between 0.9 and 2.6 m, with gaps between them."""
    parts: list[Surface] = []
    for x in np.linspace(-1.5, 1.5, 8) + rng.uniform(-0.15, 0.15, 8):
        maker = SHAPES[int(rng.integers(len(SHAPES)))]
        parts += maker(rng, (float(x), float(rng.uniform(1.0, 1.9))), float(rng.uniform(0.8, 1.75)))
    for _ in range(4):
        x, y = float(rng.uniform(-1.6, 1.6)), float(rng.uniform(1.9, 3.0))
        parts += shrub(rng, (x, y), float(rng.uniform(0.6, 1.3)))
    for x in rng.uniform(-1.3, 1.3, 3):
        parts += hanging(
            rng, (float(x), float(rng.uniform(1.0, 1.8))), float(rng.uniform(0.6, 1.2))
        )
    return parts


def _ground(rng: np.random.Generator) -> list[Surface]:
    """Return a lawn, finer near the cameras, where shadows fall sharply, and a path of slabs."""
    grass = Material(_grass(rng), (3.0, 3.0))
    far = panel((-20, -4, -0.01), (40, 0, 0), (0, 24, 0), grass, 0.5)
    near = panel((-2.6, 0.2, 0), (5.2, 0, 0), (0, 4.2, 0), grass, 0.08)
    slab = Material(textures.mottled(rng, (0.55, 0.53, 0.5), 0.12), (0.5, 0.5))
    turn = float(rng.uniform(-0.4, 0.4))
    slabs = [
        side
        for k in range(9)
        for side in box((-0.24, 0.7 * k, 0), (0.24, 0.7 * k + 0.6, 0.02), slab, 0.12)
    ]
    return [
        far,
        near,
        *moved(
            slabs,
            product(translation(float(rng.uniform(-0.6, 0.6)), 1.2, 0), rotation(turn, (0, 0, 1))),
        ),
    ]


def _grass(rng: np.random.Generator) -> Image8:
    shape = (900, 900)
    tone = (
        1
        + 0.2 * textures.fractal_noise(rng, shape, (300, 300), 4)
        + 0.28 * textures.fractal_noise(rng, shape, (9, 3), 2)
    )
    dry = 0.5 + 0.3 * textures.fractal_noise(rng, shape, (120, 120), 5)
    colours = (1 - dry[..., None]) * np.array((0.26, 0.34, 0.17)) + dry[..., None] * np.array(
        (0.42, 0.41, 0.25)
    )
    return np.rint(np.clip(colours * tone[..., None], 0.03, 0.9) * 255).astype(np.uint8)


def _backdrop(rng: np.random.Generator) -> list[Surface]:
    """Sky, clouds and a line of trees on a cylinder around the garden."""
    size = (2 * SKY_HALF_RAD * SKY_RADIUS_M, SKY_TOP_M - SKY_BOTTOM_M)
    angle, height = np.meshgrid(
        np.linspace(-SKY_HALF_RAD, SKY_HALF_RAD, 73), np.linspace(SKY_BOTTOM_M, SKY_TOP_M, 13)
    )
    points = np.stack(
        [SKY_RADIUS_M * sin(angle), SKY_CENTRE_Y_M + SKY_RADIUS_M * cos(angle), height], -1
    )
    uv = np.stack([(angle + SKY_HALF_RAD) * SKY_RADIUS_M, height - SKY_BOTTOM_M], -1)
    return [sheet(points, uv, Material(_horizon(rng, size), size, emission=0.9))]


def _horizon(rng: np.random.Generator, size_m: textures.Size) -> Image8:
    """Return the picture of the backdrop, its trees sharp."""
    width, height = (round(side * BACKDROP_TEXELS_PER_METRE) for side in size_m)
    up_m = (SKY_TOP_M - (np.arange(height, dtype=np.float32) + 0.5) / BACKDROP_TEXELS_PER_METRE)[
        :, None
    ]
    clouds = np.clip(
        0.25 + 0.4 * textures.fractal_noise(rng, (height, width), (260, 700), 6), 0, 1
    )[..., None]
    blue = np.array((0.5, 0.66, 0.86)) - 0.012 * np.clip(up_m, 0, None)[..., None] * np.array(
        (1.2, 0.8, 0.2)
    )
    sky = blue * (1 - clouds) + clouds * np.array((0.93, 0.94, 0.95))
    outline = 3.0 + 1.3 * textures.fractal_noise(rng, (2, width), (2, 420), 6)[:1]
    leaves = 1 + 0.34 * textures.fractal_noise(rng, (height, width), (60, 60), 6)
    green = (
        leaves[..., None]
        * np.array((0.2, 0.3, 0.14))
        * (0.75 + 0.05 * np.clip(up_m, 0, 8))[..., None]
    )
    ragged = up_m - outline + 0.35 * textures.fractal_noise(rng, (height, width), (24, 24), 3)
    share = np.clip(0.5 - ragged / 0.12, 0, 1)[..., None]
    return np.rint(np.clip(sky * (1 - share) + green * share, 0.02, 0.97) * 255).astype(np.uint8)


def _house(rng: np.random.Generator) -> list[Surface]:
    """Return a house of brick or plaster with windows and a roof, 8 to 11 m away."""
    width, height, depth = float(rng.uniform(5, 7.5)), float(rng.uniform(2.8, 3.6)), 4.0
    brick, white = bool(rng.integers(2)), Material(textures.plain((0.88, 0.87, 0.84)))
    size = (2.7, 2.4)
    ochre = textures.plaster(rng, size, (0.82, 0.74, 0.6))
    wall = Material(
        textures.bricks(rng, size, (0.56, 0.31, 0.24), (0.7, 0.66, 0.6)) if brick else ochre, size
    )
    tiles = Material(
        textures.bricks(rng, (1.8, 1.5), (0.5, 0.26, 0.2), (0.24, 0.16, 0.14)), (1.8, 1.5)
    )
    glass = Material(textures.mottled(rng, (0.16, 0.2, 0.26), 0.5, 0.3), (0.9, 1.2), 0.3)
    parts = box((-width / 2, 0, 0), (width / 2, depth, height), wall, 0.4)
    for x in np.linspace(-width / 2 + 1, width / 2 - 1, int(width // 1.6)):
        parts += _house_window(float(x), white, glass)
    ridge = np.array([0, depth / 2 + 0.3, 1.9])
    parts.append(
        panel((-width / 2 - 0.3, -0.35, height - 0.05), (width + 0.6, 0, 0), ridge, tiles, 0.4)
    )
    place = translation(float(rng.uniform(-3.5, 3.5)), float(rng.uniform(8, 11)), 0)
    return moved(parts, product(place, rotation(float(rng.uniform(-0.35, 0.35)), (0, 0, 1))))


def _house_window(x: float, white: Material, glass: Material) -> list[Surface]:
    parts = [panel((x - 0.45, -0.01, 0.9), (0.9, 0, 0), (0, 0, 1.2), glass, 0.3)]
    for low, high in (
        ((-0.5, 0.85), (-0.43, 2.15)),
        ((0.43, 0.85), (0.5, 2.15)),
        ((-0.03, 0.9), (0.03, 2.1)),
    ):
        parts += box((x + low[0], -0.05, low[1]), (x + high[0], 0, high[1]), white, 0.4)
    for low_z in (0.82, 1.62, 2.09):
        parts += box((x - 0.5, -0.06, low_z), (x + 0.5, 0, low_z + 0.06), white, 0.4)
    return parts


def _fence(rng: np.random.Generator) -> list[Surface]:
    """Thin slats before the hedge, some a little askew."""
    grain = Material(textures.wood(rng, (1.2, 0.3), (0.5, 0.42, 0.33)), (1.2, 0.3))
    parts: list[Surface] = []
    for x in np.arange(-5.0, 5.0, 0.16):
        slat = box((-0.02, 0, 0), (0.02, 0.012, float(rng.uniform(0.85, 0.95))), grain, 0.2)
        parts += moved(
            slat,
            product(
                translation(float(x), 4.1, 0), rotation(float(rng.normal(0, 0.015)), (0, 1, 0))
            ),
        )
    for z in (0.25, 0.75):
        parts += box((-5.0, 4.112, z), (5.0, 4.13, z + 0.05), grain, 0.2)
    return parts


def _person(rng: np.random.Generator) -> Mover:
    return random_figure(
        rng, (float(rng.uniform(-0.3, 0.3)), float(rng.uniform(2.4, 3.2)))
    ).surfaces


def _swaying_branch(rng: np.random.Generator) -> Mover:
    """Return a leafy shoot in front of everything that sways in the wind."""
    x, phase_rad = float(rng.uniform(-0.5, 0.5)), float(rng.uniform(0, 2 * np.pi))
    parts = shoot(rng, (x, 1.25), float(rng.uniform(1.15, 1.5)))
    axis = (0.4, 1.0, 0.0)

    def at(time_s: float) -> list[Surface]:
        angle_rad = 0.06 * float(sin(2 * np.pi * 0.6 * time_s + phase_rad))
        return moved(parts, rotation(angle_rad, axis, (x, 1.25, 0.0)))

    return at


def _sun(rng: np.random.Generator) -> Light:
    """Return the sun behind and to the side of the cameras, a small disc."""
    direction = unit(rng.uniform((-0.8, -0.8, 0.8), (0.8, -0.2, 1.2)))
    angle = 2.4 * np.arange(SUN_POINTS)
    radius = SUN_RADIUS_M * np.sqrt((np.arange(SUN_POINTS) + 0.5) / SUN_POINTS)
    across = unit(np.cross(direction, (0, 0, 1)))
    offsets = radius[:, None] * (
        cos(angle)[:, None] * across + sin(angle)[:, None] * np.cross(direction, across)
    )
    return Light(SUN_M * direction + offsets + (0, 2, 0), None, lambda time_s: SUNSHINE * SUN_M**2)


def _sky() -> Light:
    """Return the sky as points on a dome within the backdrop."""
    index, radius_m = np.arange(SKY_POINTS) + 0.5, 0.9 * SKY_RADIUS_M
    height, angle = 0.15 + 0.85 * index / SKY_POINTS, index * np.pi * (3 - np.sqrt(5))
    flat = np.sqrt(1 - height**2)
    points: Array = radius_m * np.stack([flat * cos(angle), flat * sin(angle), height], -1) + (
        0,
        SKY_CENTRE_Y_M,
        0,
    )
    return Light(points, None, lambda time_s: 2 * SKYLIGHT * radius_m**2)
