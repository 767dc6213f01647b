"""A living room: walls, furniture, clutter, lights and what moves in it, laid out by a seed.

Room frame: metres, x right, y into the room, z up; the rig is around x = y = 0, the table and the
person in front of it. The inside reaches from -half_width to half_width, from `FRONT_M` to back and
from 0 to `CEILING_M`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ggvs_eval.arrays import Array, Image8
from ggvs_eval.contrib.worlds.room import furniture, textures
from ggvs_eval.contrib.worlds.room.figure import random_figure
from ggvs_eval.contrib.worlds.room.surfaces import (
    Material,
    Surface,
    box,
    ellipsoid,
    moved,
    panel,
    rod,
    rotation,
    translation,
    turned,
)
from ggvs_eval.contrib.worlds.room.textures import PICTURES, Colour, bands, picture, plain
from ggvs_eval.kernels.portable import cos, length, product, sin

Mover = Callable[[float], list[Surface]]


def rolling_ball(
    rng: np.random.Generator, start: tuple[float, float, float], speed: float, radius: float = 0.065
) -> Mover:
    """Return a striped ball that rolls along x on a level surface.

    Args:
        start: where it touches the surface at time 0, metres.
        speed: metres per second along +x.
        radius: metres.
    """
    colours = rng.permutation(
        [
            (0.86, 0.2, 0.15),
            (0.95, 0.9, 0.82),
            (0.15, 0.4, 0.7),
            (0.95, 0.75, 0.15),
            (0.2, 0.55, 0.35),
        ]
    )[:3]
    strip = (
        np.rint(np.tile(colours, (2, 1)) * 255)
        .astype(np.uint8)[None]
        .repeat(40, axis=1)
        .reshape(1, -1, 3)
    )
    skin = Material(texture=strip, tile_m=(2 * np.pi * radius, 1.0), specular=0.5, shininess=50)
    ball = ellipsoid((radius, radius, radius), skin, 40).moved(rotation(1.2, (0.3, 1, 0)))

    def at(time_s: float) -> list[Surface]:
        x = speed * time_s
        return [
            ball.moved(
                product(
                    translation(start[0] + x, start[1], start[2] + radius),
                    rotation(x / radius, (0, 1, 0)),
                )
            )
        ]

    return at


def swinging_door(
    hinge: tuple[float, float, float], width: float, height: float, skin: Material, phase_rad: float
) -> Mover:
    """Return a cupboard door, hinged at its -x edge, that swings open and shut towards -y."""
    knob = Material(plain((0.75, 0.65, 0.4)), specular=0.8)
    leaf = box((0, -0.018, 0), (width, 0, height), skin)
    leaf += [
        ellipsoid((0.014, 0.014, 0.014), knob, 12).moved(
            translation(width - 0.04, -0.03, height / 2)
        )
    ]
    leaf += [
        rod(
            (width - 0.04, -0.03, height / 2),
            (width - 0.04, -0.018, height / 2),
            (0.006, 0.006),
            knob,
            8,
        )
    ]

    def at(time_s: float) -> list[Surface]:
        angle = -0.75 - 0.45 * sin(2 * np.pi * 0.6 * time_s + phase_rad)
        return moved(leaf, product(translation(*hinge), rotation(angle, (0, 0, 1))))

    return at


def screen_colour(time_s: float, phase_rad: float) -> Array:
    """Tint of the screen's picture at an instant, (3,)."""
    return 0.65 + 0.35 * sin(2 * np.pi * 0.8 * time_s + phase_rad + np.array([0.0, 2.1, 4.2]))


def screen(
    name: str, corner: tuple[float, float, float], width: float, height: float, phase_rad: float
) -> Mover:
    """Return a flat screen facing -y that shows a panning photograph in changing colours.

    Its lower left corner is given.
    """
    photo = picture(name, 512, 288)

    def at(time_s: float) -> list[Surface]:
        panned = np.roll(
            np.concatenate([photo, photo[:, ::-1]], axis=1), -round(160 * time_s), axis=1
        )[:, :512]
        image = np.rint(panned * screen_colour(time_s, phase_rad)).astype(np.uint8)
        return [
            panel(
                corner,
                (width, 0, 0),
                (0, 0, height),
                Material(
                    texture=image,
                    tile_m=(width, height),
                    specular=0.15,
                    shininess=120,
                    emission=0.8,
                ),
            )
        ]

    return at


def flame_strength(time_s: float) -> float:
    """Return the brightness of the flame at an instant, around 1."""
    return float(
        1 + 0.22 * sin(2 * np.pi * 3.1 * time_s) + 0.12 * sin(2 * np.pi * 7.3 * time_s + 1)
    )


def flame(rng: np.random.Generator, wick: tuple[float, float, float]) -> Mover:
    """Return a candle's flame that flickers in height, colour and direction."""
    profile = np.array(
        [
            (0, 0),
            (0.55, 0.08),
            (0.9, 0.22),
            (1, 0.34),
            (0.8, 0.52),
            (0.42, 0.75),
            (0.15, 0.92),
            (0, 1),
        ]
    )
    texture = bands(
        rng, (0.05, 0.05), [(0.45, 0.5, 0.85), (1.0, 0.9, 0.55), (1.0, 0.72, 0.25)], [0.18, 0.7]
    )

    def at(time_s: float) -> list[Surface]:
        strength = flame_strength(time_s)
        size = (0.011, 0.042 * strength)
        glow = Material(
            texture,
            (0.05, float(length(np.diff(profile * size, axis=0)).sum())),
            emission=3.0 * strength,
        )
        lean = rotation(0.25 * sin(2 * np.pi * 1.9 * time_s), (0.4, 1, 0))
        return [turned(profile * size, glow, 16).moved(product(translation(*wick), lean))]

    return at


CEILING_M, FRONT_M = 2.5, -1.5
WALLS: tuple[Colour, ...] = (
    (0.78, 0.7, 0.58),
    (0.6, 0.68, 0.64),
    (0.72, 0.6, 0.52),
    (0.66, 0.7, 0.76),
    (0.8, 0.76, 0.66),
)


def walls(
    rng: np.random.Generator, half_width: float, back: float, floor_wood: Colour
) -> list[Surface]:
    """Return the six inner sides of the room.

    The wall behind the rig is plain, as no camera sees it.
    """
    wide, deep, flat = (
        (2 * half_width, CEILING_M),
        (back - FRONT_M, CEILING_M),
        (2 * half_width, back - FRONT_M),
    )
    wall, second_wall = (WALLS[k] for k in rng.permutation(len(WALLS))[:2])
    back_wall = Material(_back_wall(rng, wide, wall, second_wall), wide)
    left, right = (Material(textures.plaster(rng, deep, second_wall), deep) for _ in range(2))
    floor = Material(
        texture=textures.boards(rng, flat, floor_wood), tile_m=flat, specular=0.12, shininess=30
    )
    ceiling = Material(textures.plaster(rng, flat, (0.9, 0.88, 0.84)), flat)
    up, across, along = (
        (0, 0, CEILING_M),
        np.array([2 * half_width, 0, 0]),
        np.array([0, back - FRONT_M, 0]),
    )
    return [
        panel((-half_width, back, 0), across, up, back_wall, 0.04),
        panel((-half_width, FRONT_M, 0), along, up, left, 0.04),
        panel((half_width, back, 0), -along, up, right, 0.04),
        panel((half_width, FRONT_M, 0), -across, up, Material(textures.plain(wall)), 0.1),
        panel((-half_width, FRONT_M, 0), across, along, floor, 0.04),
        panel((-half_width, back, CEILING_M), across, -along, ceiling, 0.06),
    ]


def _back_wall(
    rng: np.random.Generator, size_m: textures.Size, wall: Colour, second_wall: Colour
) -> Image8:
    kind = str(rng.choice(("wallpaper", "bricks", "plaster")))
    if kind == "wallpaper":
        return textures.wallpaper(rng, size_m, wall, second_wall)
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
    """Window on the wall at y = 0, facing -y, its lower edge at z = 0: the view, frame and bars, a
    sill and two curtains.
    """
    view = Material(textures.outdoors(rng, (width, height)), (width, height), emission=1.6)
    white = Material(textures.plain((0.88, 0.87, 0.84)), specular=0.15)
    parts = [panel((-width / 2, -0.004, 0), (width, 0, 0), (0, 0, height), view)]
    for x in (-width / 2 - 0.05, -0.02, width / 2):
        parts += box((x, -0.05, -0.05), (x + 0.05, 0, height + 0.05), white)
    for bar in (-0.05, 0.62 * height, height):
        parts += box((-width / 2, -0.045, bar), (width / 2, 0, bar + 0.045), white)
    parts += box((-width / 2 - 0.1, -0.16, -0.08), (width / 2 + 0.1, 0, -0.05), white)
    cloth = Material(
        textures.fabric(rng, (1.0, 1.0), furniture.some_colour(rng), (0.85, 0.8, 0.7), "stripes")
    )
    for x in (-width / 2 - 0.12, width / 2 + 0.12):
        parts += moved(furniture.curtain(0.34, 1.5, 5, cloth), translation(x, -0.1, -0.15))
    return parts


TABLE_M = 0.74
WOODS: tuple[Colour, ...] = (
    (0.62, 0.42, 0.26),
    (0.45, 0.28, 0.17),
    (0.75, 0.58, 0.38),
    (0.36, 0.24, 0.17),
)
SPOTS = (
    (-0.72, 1.38),
    (-0.6, 1.32),
    (0.42, 1.4),
    (-0.38, 1.02),
    (0.55, 1.0),
    (0.68, 1.36),
    (0.16, 1.4),
    (-0.16, 1.36),
)
CANDLE = (0.3, 1.0)


@dataclass(frozen=True, eq=False)
class Light:
    """A source of light, sampled by points.

    Attributes:
        points: (S, 3), room frame, metres.
        normal: direction it faces, (3,); None shines to all sides.
        power: irradiance at 1 m head on, RGB, at an instant in seconds.
    """

    points: Array
    normal: Array | None
    power: Callable[[float], Array]


@dataclass(frozen=True, eq=False)
class Room:
    """Everything there is to see.

    Attributes:
        movers: what moves; each gives its surfaces at an instant.
    """

    static: list[Surface]
    lights: list[Light]
    movers: list[Mover]

    def at(self, time_s: float) -> list[Surface]:
        """Surfaces of all moving things at an instant."""
        return [surface for mover in self.movers for surface in mover(time_s)]


def build_room(seed: int) -> Room:
    """Lay out a room; equal seeds give equal rooms."""
    return _Layout(np.random.default_rng([seed, 2])).room()


class _Layout:
    """Places things one after another.

    The window is on one side, the bookshelf on one side of the back wall.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.side, self.shelf_side = (int(sign) for sign in rng.choice((-1, 1), 2))
        self.half_width, self.back = rng.uniform(2.0, 2.2), rng.uniform(2.55, 2.75)
        size = (1.6, 0.6)
        self.woods = [
            Material(
                texture=textures.wood(rng, size, WOODS[k]), tile_m=size, specular=0.18, shininess=35
            )
            for k in rng.permutation(len(WOODS))
        ]
        self.pictures = [str(name) for name in rng.permutation(PICTURES)]
        self.static: list[Surface] = []
        self.lights: list[Light] = []
        self.movers: list[Mover] = []

    def room(self) -> Room:
        self.static += walls(
            self.rng, self.half_width, self.back, WOODS[int(self.rng.integers(len(WOODS)))]
        )
        self.static += skirting(self.half_width, self.back)
        for place in (
            self._window,
            self._table,
            self._seats,
            self._bookshelf,
            self._media,
            self._decoration,
            self._lamps,
        ):
            place()
        self.movers.append(
            random_figure(self.rng, (float(self.rng.uniform(-0.15, 0.15)), 1.85)).surfaces
        )
        return Room(self.static, self.lights, self.movers)

    def _add(
        self, parts: list[Surface], x: float, y: float, z: float = 0.0, turn_rad: float = 0.0
    ) -> None:
        self.static += moved(parts, product(translation(x, y, z), rotation(turn_rad, (0, 0, 1))))

    def _window(self) -> None:
        width, height, y, z = self.rng.uniform(1.0, 1.3), self.rng.uniform(1.1, 1.3), 1.35, 0.95
        self._add(
            window(self.rng, width, height),
            self.half_width * self.side,
            y,
            z,
            -np.pi / 2 * self.side,
        )
        across, upward = np.meshgrid(
            (np.arange(4) - 1.5) * width / 4, (np.arange(4) + 0.5) * height / 4
        )
        points = np.stack(
            [0 * across + (self.half_width - 0.06) * self.side, across + y, upward + z], -1
        ).reshape(-1, 3)
        self.lights.append(Light(points, np.array([-self.side, 0.0, 0.0]), _steady(3.3, 3.5, 3.8)))

    def _table(self) -> None:
        """The table with clutter in its places and a ball that rolls between them."""
        rng = self.rng
        self._add(
            furniture.table(rng.uniform(1.6, 1.85), 0.66, TABLE_M, self.woods[0], self.woods[0]),
            0.0,
            1.18,
        )
        things = [furniture.bottle] * 3 + [furniture.cup] * 2 + [furniture.jar] * 2
        makers = [*(things[k] for k in rng.permutation(len(things))), furniture.fruit_bowl]
        self.static += furniture.scatter(rng, makers, SPOTS, TABLE_M)
        self._candle()
        cloth = Material(
            textures.fabric(rng, (1.0, 1.0), furniture.some_colour(rng), (0.9, 0.87, 0.8), "check")
        )
        self._add(
            box((-0.22, -0.15, 0), (0.22, 0.15, 0.004), cloth, 0.03), -0.45, 1.04, TABLE_M, 0.15
        )
        direction = int(rng.choice((-1, 1)))
        start = (-direction * rng.uniform(0.2, 0.35), 1.19, TABLE_M)
        self.movers.append(rolling_ball(rng, start, direction * rng.uniform(0.45, 0.6)))

    def _candle(self) -> None:
        wick = (*CANDLE, TABLE_M + 0.204)
        self._add(furniture.candle_stick(self.rng), *CANDLE, TABLE_M)
        self.movers.append(flame(self.rng, wick))
        warm, point = np.array([0.05, 0.032, 0.012]), np.add(wick, (0, 0, 0.02))
        self.lights.append(Light(point[None], None, lambda time_s: warm * flame_strength(time_s)))

    def _seats(self) -> None:
        rng = self.rng
        seat = Material(
            textures.fabric(
                rng, (1.0, 1.0), furniture.some_colour(rng), furniture.some_colour(rng), "stripes"
            )
        )
        wood, slats = self.woods[int(rng.integers(4))], int(rng.integers(4, 8))
        self._add(
            furniture.chair(wood, seat, slats),
            -1.2 * self.side,
            1.25,
            0.0,
            rng.uniform(1.0, 1.5) * self.side,
        )
        self._add(
            furniture.chair(wood, seat, slats),
            0.72 * self.side,
            1.95,
            0.0,
            rng.uniform(-0.5, 0.2) * self.side,
        )
        self._add([furniture.cushion(0.34, seat)], 0.72 * self.side, 1.98, 0.5)

    def _bookshelf(self) -> None:
        rng, width = self.rng, self.rng.uniform(0.8, 0.95)
        heights = np.linspace(0.1, rng.uniform(1.35, 1.9), int(rng.integers(5, 7))).tolist()
        parts = furniture.shelf(width, 0.26, heights, self.woods[1], self.woods[1])
        for low, high in pairwise(heights):
            row = rng.uniform(0.45, 0.8) * width
            parts += moved(
                furniture.books(rng, row, high - low - 0.05),
                translation(0.03 - width / 2, 0.1, low),
            )
            if width - row > 0.25:
                parts += moved(furniture.jar(rng), translation(width / 2 - 0.1, -0.02, low))
        parts += furniture.scatter(
            rng, [furniture.jar, furniture.fruit_bowl], [(-0.2, 0), (0.15, 0)], heights[-1]
        )
        self._add(parts, rng.uniform(1.35, 1.48) * self.shelf_side, self.back - 0.15)

    def _media(self) -> None:
        """A cupboard full of jars with one fixed and one swinging door, and a screen on top
        of it.
        """
        rng, x, y = self.rng, -self.rng.uniform(1.2, 1.4) * self.shelf_side, self.back - 0.22
        width, height = rng.uniform(0.95, 1.1), rng.uniform(0.6, 0.7)
        paint = Material(
            texture=textures.wood(rng, (1.0, 0.6), furniture.some_colour(rng)),
            tile_m=(1.0, 0.6),
            specular=0.15,
            shininess=30,
        )
        parts = furniture.cupboard(width, 0.4, height, self.woods[2], self.woods[3])
        for z in (0.06, height / 2 + 0.018):
            parts += furniture.scatter(
                rng,
                [furniture.jar] * 3 + [furniture.cup],
                [(dx, 0) for dx in (-0.3, -0.1, 0.12, 0.32)],
                z,
            )
        leaf = (width / 2 - 0.005, height - 0.05)
        parts += moved(
            box((0, -0.018, 0), (leaf[0], 0, leaf[1]), paint), translation(0, -0.2, 0.05)
        )
        self._add(parts, x, y)
        self.movers.append(
            swinging_door((x - width / 2, y - 0.2, 0.05), *leaf, paint, rng.uniform(-1, 1))
        )
        self._screen(x, y, height + 0.02)

    def _screen(self, x: float, y: float, z: float) -> None:
        black = Material(textures.plain((0.06, 0.06, 0.07)), specular=0.5, shininess=80)
        width, height, phase_rad = 0.84, 0.47, float(self.rng.uniform(0, 6))
        self._add(furniture.screen_body(width, height, black), x, y, z)
        self.movers.append(
            screen(
                self.pictures.pop(),
                (x - width / 2, y - 0.0215, z + 0.065),
                width,
                height,
                phase_rad,
            )
        )
        across, upward = np.meshgrid(
            (np.arange(3) - 1) * width / 3, (np.arange(2) + 0.5) * height / 2
        )
        points = np.stack([x + across, 0 * across + y - 0.03, z + 0.065 + upward], -1).reshape(
            -1, 3
        )
        glow = Light(
            points,
            np.array([0.0, -1.0, 0.0]),
            lambda time_s: 0.16 * screen_colour(time_s, phase_rad),
        )
        self.lights.append(glow)

    def _decoration(self) -> None:
        rng = self.rng
        for x, z, width in ((-0.42, 1.62, 0.34), (0.14, 1.78, 0.42), (0.62, 1.58, 0.3)):
            frame = self.woods[int(rng.integers(4))]
            hung = furniture.framed_picture(picture(self.pictures.pop()), width, frame)
            self._add(hung, x * self.side, self.back, z + rng.uniform(-0.06, 0.06))
        hung = furniture.framed_picture(picture(self.pictures.pop()), 0.6, self.woods[3])
        self._add(hung, -self.half_width * self.side, 1.45, 1.55, np.pi / 2 * self.side)
        pot = Material(textures.mottled(rng, furniture.some_colour(rng)), (0.5, 0.5), 0.2)
        green = (rng.uniform(0.2, 0.34), rng.uniform(0.4, 0.5), rng.uniform(0.16, 0.26))
        leaves = furniture.plant(rng, pot, green, int(rng.integers(14, 24)), rng.uniform(0.9, 1.3))
        self._add(leaves, (0.35 - self.half_width) * self.side, 1.95)
        knots = textures.rug(rng, (2.2, 1.4), [furniture.some_colour(rng) for _ in range(3)])
        self._add(box((-1.1, -0.7, 0), (1.1, 0.7, 0.008), Material(knots, (2.2, 1.4))), 0.0, 1.75)

    def _lamps(self) -> None:
        metal = Material(textures.plain((0.25, 0.24, 0.23)), specular=0.6)
        shade = Material(textures.plain((0.95, 0.85, 0.68)), emission=0.55)
        tall, corner = self.rng.uniform(1.5, 1.65), -self.rng.uniform(0.5, 0.68) * self.shelf_side
        self._add(furniture.floor_lamp(tall, metal, shade), corner, self.back - 0.3)
        self._add(furniture.pendant_lamp(CEILING_M, 0.35, metal, shade), 0.35 * self.side, 1.7)
        bulb = 0.05 * np.stack(
            [cos(np.arange(6)), sin(np.arange(6)), 0.4 * cos(2 * np.arange(6))], -1
        )
        for place, power in (
            ((corner, self.back - 0.3, tall - 0.08), 0.55),
            ((0.35 * self.side, 1.7, CEILING_M - 0.5), 1.1),
        ):
            self.lights.append(
                Light(np.add(bulb, place), None, _steady(power, 0.84 * power, 0.64 * power))
            )


def _steady(*power: float) -> Callable[[float], Array]:
    return lambda time_s: np.array(power)
