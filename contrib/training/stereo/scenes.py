"""Scenes to take stereo pairs of: the living room or the garden of a seed with its light baked, and things strewn before it.

Room frame, metres. What stands still and what moves are one mesh here: a pair shows one instant.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise

import numpy as np

from ggvs_eval.contrib.worlds.room import furniture, garden, textures
from ggvs_eval.contrib.worlds.room.figure import random_figure
from ggvs_eval.contrib.worlds.room.garden import build_garden
from ggvs_eval.contrib.worlds.room.lighting import Geometry, Instant, LitRoom
from ggvs_eval.contrib.worlds.room.room import Room, build_room
from ggvs_eval.contrib.worlds.room.surfaces import Material, Surface, ellipsoid, moved, panel, rod, rotation, translation
from ggvs_eval.kernels.portable import power, product

FIRST_SEED = 2**20  # rooms of pairs have seeds from here on; those of demos, of validation and of views to train on lie below
GARDENS = 0.35  # share of the scenes
# Where things are strewn: lowest and highest corner, metres.
STREWN_M = np.array([(-1.5, 0.1, 0.1), (1.5, 2.2, 2.0)])
SKIN_M = 0.6  # side of a skin's pattern before it is scaled
SKINS = 96


def build_scene(number: int) -> Instant:
    """Lay a scene out and light it, which takes seconds; equal numbers give equal scenes, all of whose surfaces are static."""
    rng = np.random.default_rng([number, 91])
    build = build_garden if rng.random() < GARDENS else build_room
    room = build(FIRST_SEED + number)
    parts = [*room.static, *room.at(float(rng.uniform(0, 10)))]
    for _ in range(int(rng.integers(8, 40))):
        parts += _strewn(rng)
    return LitRoom(Room(parts, room.lights, [])).empty()


def repainted(geometry: Geometry, rng: np.random.Generator, share: float) -> list[Material]:
    """The materials of a geometry, a share of those that do not shine replaced by skins."""
    bank = skins()
    return [
        bank[int(rng.integers(len(bank)))] if not material.emission and rng.random() < share else material
        for material in geometry.materials
    ]


@lru_cache(maxsize=1)
def skins() -> Sequence[Material]:
    """Materials of every kind of texture, colour, scale and gloss, some of them next to bare."""
    rng = np.random.default_rng(92)
    bank = []
    for index in range(SKINS):
        texture = _PATTERNS[index % len(_PATTERNS)](rng)
        tile_m = 0.4 * SKIN_M * float(power(7.5, rng.uniform()))
        size = (tile_m, tile_m * texture.shape[0] / texture.shape[1])
        gloss = float(rng.choice([0, 0, 0.15, 0.5]))
        bank.append(Material(texture, size, gloss, float(rng.uniform(15, 80))))
    return bank


def _any_colour(rng: np.random.Generator) -> textures.Colour:
    red, green, blue = np.clip(rng.uniform(0.1, 0.85) + rng.normal(0, 0.12, 3), 0.03, 0.95)
    return float(red), float(green), float(blue)


_SIZE = (SKIN_M, SKIN_M)
_PATTERNS: tuple[Callable[[np.random.Generator], textures.Image8], ...] = (
    lambda rng: textures.picture(textures.PICTURES[int(rng.integers(len(textures.PICTURES)))]),
    lambda rng: textures.wallpaper(rng, _SIZE, _any_colour(rng), _any_colour(rng)),
    lambda rng: textures.mottled(rng, _any_colour(rng), float(rng.uniform(0.1, 0.5)), float(rng.uniform(0.01, 0.1))),
    lambda rng: textures.bricks(rng, _SIZE, _any_colour(rng), _any_colour(rng)),
    lambda rng: textures.plain(_any_colour(rng)),
    lambda rng: textures.fabric(rng, _SIZE, _any_colour(rng), _any_colour(rng), str(rng.choice(("stripes", "check", "plain")))),
    lambda rng: textures.wood(rng, _SIZE, _any_colour(rng)),
    lambda rng: textures.rug(rng, _SIZE, [_any_colour(rng) for _ in range(3)]),
    lambda rng: textures.plaster(rng, _SIZE, _any_colour(rng)),
    lambda rng: textures.bands(rng, _SIZE, [_any_colour(rng) for _ in range(9)], np.sort(rng.uniform(0, 1, 8)).tolist()),
    lambda rng: textures.mottled(rng, _any_colour(rng), float(rng.uniform(0.02, 0.1)), float(rng.uniform(0.02, 0.1))),
    lambda rng: textures.boards(rng, _SIZE, _any_colour(rng), float(rng.uniform(0.02, 0.1))),
)


def _strewn(rng: np.random.Generator) -> list[Surface]:
    thing = _THINGS[int(rng.integers(len(_THINGS)))](rng)
    axis = rng.standard_normal(3)
    upright = rng.random() < 0.4
    turn = rotation(float(rng.uniform(0, 2 * np.pi)), (0, 0, 1) if upright else axis)
    size = 0.4 * float(power(5.0, rng.uniform()))
    return moved(thing, product(translation(*rng.uniform(*STREWN_M)), product(turn, np.diag([size, size, size, 1]))))


def _skin(rng: np.random.Generator) -> Material:
    return skins()[int(rng.integers(SKINS))]


def _wires(rng: np.random.Generator) -> list[Surface]:
    parts, skin = [], _skin(rng)
    for _ in range(int(rng.integers(1, 6))):
        radius = float(rng.uniform(0.002, 0.012))
        knots = np.cumsum(rng.normal(0, 0.12, (int(rng.integers(3, 8)), 3)), axis=0)
        parts += [rod(start, end, (radius, radius), skin, 8) for start, end in pairwise(knots)]
    return parts


def _card(rng: np.random.Generator) -> list[Surface]:
    wide, high = (float(side) for side in rng.uniform(0.1, 0.5, 2))
    front = panel((-wide / 2, 0, -high / 2), (wide, 0, 0), (0, 0, high), _skin(rng))
    return [front, *moved([replace(front, material=_skin(rng))], product(rotation(np.pi, (0, 0, 1)), translation(0, -0.004, 0)))]


def _ball(rng: np.random.Generator) -> list[Surface]:
    return [ellipsoid(rng.uniform(0.05, 0.25, 3), _skin(rng))]


def _chair(rng: np.random.Generator) -> list[Surface]:
    return moved(furniture.chair(_skin(rng), _skin(rng), int(rng.integers(4, 8))), translation(0, 0, -0.5))


def _potted(rng: np.random.Generator) -> list[Surface]:
    return furniture.plant(rng, _skin(rng), (0.3, 0.45, 0.2), int(rng.integers(8, 20)), float(rng.uniform(0.6, 1.2)))


_THINGS: tuple[Callable[[np.random.Generator], list[Surface]], ...] = (
    furniture.bottle,
    furniture.cup,
    furniture.fruit_bowl,
    furniture.jar,
    lambda rng: furniture.books(rng, 0.5, 0.3),
    _wires,
    _wires,
    _card,
    _card,
    _ball,
    _chair,
    _potted,
    lambda rng: garden.SHAPES[int(rng.integers(len(garden.SHAPES)))](rng, (0.0, 0.0), float(rng.uniform(0.5, 1.2))),
    lambda rng: random_figure(rng, (0.0, 0.0)).surfaces(float(rng.uniform(0, 10))),
)
