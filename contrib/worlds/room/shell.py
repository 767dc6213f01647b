"""Walls, floor, ceiling and window of a room.

Room frame: metres, x right, y into the room, z up; the inside reaches from -half_width to half_width, from `FRONT_M` to back
and from 0 to `CEILING_M`.
"""

import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.contrib.worlds.room import clutter, furniture, textures
from ggvs_eval.contrib.worlds.room.surfaces import Material, Surface, box, moved, panel, translation
from ggvs_eval.contrib.worlds.room.textures import Colour

CEILING_M, FRONT_M = 2.5, -1.5
WALLS: tuple[Colour, ...] = ((0.78, 0.7, 0.58), (0.6, 0.68, 0.64), (0.72, 0.6, 0.52), (0.66, 0.7, 0.76), (0.8, 0.76, 0.66))


def walls(rng: np.random.Generator, half_width: float, back: float, floor_wood: Colour) -> list[Surface]:
    """The six inner sides of the room; the wall behind the rig is plain, as no camera sees it."""
    wide, deep, flat = (2 * half_width, CEILING_M), (back - FRONT_M, CEILING_M), (2 * half_width, back - FRONT_M)
    wall, other = (WALLS[k] for k in rng.permutation(len(WALLS))[:2])
    back_wall = Material(_back_wall(rng, wide, wall, other), wide)
    left, right = (Material(textures.plaster(rng, deep, other), deep) for _ in range(2))
    floor = Material(textures.boards(rng, flat, floor_wood), flat, 0.12, 30)
    ceiling = Material(textures.plaster(rng, flat, (0.9, 0.88, 0.84)), flat)
    up, across, along = (0, 0, CEILING_M), np.array([2 * half_width, 0, 0]), np.array([0, back - FRONT_M, 0])
    return [
        panel((-half_width, back, 0), across, up, back_wall, 0.04),
        panel((-half_width, FRONT_M, 0), along, up, left, 0.04),
        panel((half_width, back, 0), -along, up, right, 0.04),
        panel((half_width, FRONT_M, 0), -across, up, Material(textures.plain(wall)), 0.1),
        panel((-half_width, FRONT_M, 0), across, along, floor, 0.04),
        panel((-half_width, back, CEILING_M), across, -along, ceiling, 0.06),
    ]


def _back_wall(rng: np.random.Generator, size_m: textures.Size, wall: Colour, other: Colour) -> Image8:
    kind = str(rng.choice(("wallpaper", "bricks", "plaster")))
    if kind == "wallpaper":
        return textures.wallpaper(rng, size_m, wall, other)
    if kind == "bricks":
        return textures.bricks(rng, size_m, (0.6, 0.36, 0.28), (0.68, 0.64, 0.58))
    return textures.plaster(rng, size_m, wall)


def skirting(half_width: float, back: float) -> list[Surface]:
    """Skirting boards along the walls that are seen."""
    white = Material(textures.plain((0.86, 0.84, 0.8)), specular=0.1)
    boards = box((-half_width, back - 0.018, 0), (half_width, back, 0.09), white)
    for x in (-half_width, half_width - 0.018):
        boards += box((x, FRONT_M, 0), (x + 0.018, back - 0.018, 0.09), white)
    return boards


def window(rng: np.random.Generator, width: float, height: float) -> list[Surface]:
    """Window on the wall at y = 0, facing -y, its lower edge at z = 0: the view, frame and bars, a sill and two curtains."""
    view = Material(textures.outdoors(rng, (width, height)), (width, height), emission=1.6)
    white = Material(textures.plain((0.88, 0.87, 0.84)), specular=0.15)
    parts = [panel((-width / 2, -0.004, 0), (width, 0, 0), (0, 0, height), view)]
    for x in (-width / 2 - 0.05, -0.02, width / 2):
        parts += box((x, -0.05, -0.05), (x + 0.05, 0, height + 0.05), white)
    for bar in (-0.05, 0.62 * height, height):
        parts += box((-width / 2, -0.045, bar), (width / 2, 0, bar + 0.045), white)
    parts += box((-width / 2 - 0.1, -0.16, -0.08), (width / 2 + 0.1, 0, -0.05), white)
    cloth = Material(textures.fabric(rng, (1.0, 1.0), clutter.some_colour(rng), (0.85, 0.8, 0.7), "stripes"))
    for x in (-width / 2 - 0.12, width / 2 + 0.12):
        parts += moved(furniture.curtain(0.34, 1.5, 5, cloth), translation(x, -0.1, -0.15))
    return parts
