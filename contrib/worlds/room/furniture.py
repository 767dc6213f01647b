"""Furniture with thin parts (tables, chairs, shelves, lamps, plants, picture frames), and small
objects.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.contrib.worlds.room.surfaces import (
    Material,
    Surface,
    box,
    ellipsoid,
    moved,
    panel,
    rod,
    rotation,
    sheet,
    translation,
    turned,
)
from ggvs_eval.contrib.worlds.room.textures import Colour, bands, mottled, plain
from ggvs_eval.kernels.portable import cos, length, power, product, sin

BRIGHT: tuple[Colour, ...] = (
    (0.72, 0.16, 0.13),
    (0.85, 0.6, 0.15),
    (0.16, 0.34, 0.55),
    (0.2, 0.42, 0.27),
    (0.84, 0.8, 0.7),
    (0.42, 0.2, 0.36),
    (0.12, 0.14, 0.18),
    (0.78, 0.4, 0.2),
    (0.35, 0.55, 0.6),
)
# Outlines: radius and height, as shares of the largest.
BOTTLE = np.array(
    [
        (0, 0),
        (1, 0),
        (1.02, 0.02),
        (1, 0.3),
        (1, 0.6),
        (0.85, 0.68),
        (0.4, 0.76),
        (0.33, 0.95),
        (0.4, 0.97),
        (0.4, 1),
        (0, 1),
    ]
)
BOWL = np.array(
    [
        (0, 0),
        (0.4, 0),
        (0.45, 0.04),
        (0.8, 0.22),
        (1, 0.5),
        (0.96, 0.5),
        (0.75, 0.26),
        (0.3, 0.12),
        (0, 0.12),
    ]
)
FRUIT: tuple[Colour, ...] = (
    (0.85, 0.5, 0.1),
    (0.75, 0.15, 0.12),
    (0.55, 0.68, 0.2),
    (0.9, 0.78, 0.2),
)


def some_colour(rng: np.random.Generator) -> Colour:
    """Return one of a palette that fits a home, shaded a little."""
    red, green, blue = np.clip(
        np.array(BRIGHT[rng.integers(len(BRIGHT))]) * rng.uniform(0.8, 1.15), 0.05, 0.95
    )
    return float(red), float(green), float(blue)


def bottle(rng: np.random.Generator) -> list[Surface]:
    """Wine or oil bottle with a label and a capsule."""
    height, radius = rng.uniform(0.22, 0.32), rng.uniform(0.03, 0.041)
    glass = ((0.1, 0.16, 0.09), (0.16, 0.1, 0.06), (0.5, 0.52, 0.4), (0.1, 0.11, 0.12))[
        rng.integers(4)
    ]
    colours = [
        glass,
        (0.9, 0.87, 0.78) if rng.random() < 0.6 else some_colour(rng),
        glass,
        some_colour(rng),
    ]
    around = 2 * np.pi * radius
    profile = BOTTLE * (radius, height)
    along = float(length(np.diff(profile, axis=0)).sum())
    skin = Material(
        texture=bands(rng, (around, along), colours, [0.24, 0.55, 0.8]),
        tile_m=(around, along),
        specular=0.6,
        shininess=90,
    )
    return [turned(profile, skin)]


def cup(rng: np.random.Generator) -> list[Surface]:
    """Mug with a handle and something dark in it."""
    radius, height = rng.uniform(0.035, 0.045), rng.uniform(0.08, 0.105)
    clay = Material(
        texture=mottled(rng, some_colour(rng), 0.04), tile_m=(0.5, 0.5), specular=0.35, shininess=60
    )
    outline = np.array([(0, 0), (0.9, 0), (1, 0.5), (1, 1), (0.9, 1), (0.88, 0.8)])
    body = turned(outline * (radius, height), clay)
    drink = turned(
        [(0.89 * radius, 0.8 * height), (1e-4, 0.8 * height)],
        Material(plain((0.2, 0.12, 0.07)), specular=0.4),
    )
    knots = [
        (radius + 0.024 * sin(a), 0, height * 0.52 + 0.03 * cos(a))
        for a in np.linspace(0, np.pi, 7)
    ]
    handle = [rod(a, b, (0.005, 0.005), clay, 8) for a, b in pairwise(knots)]
    return moved([body, drink, *handle], rotation(rng.uniform(-1.2, 1.2), (0, 0, 1)))


def fruit_bowl(rng: np.random.Generator) -> list[Surface]:
    """Shallow bowl heaped with fruit."""
    radius = rng.uniform(0.12, 0.15)
    glaze = Material(
        texture=mottled(rng, some_colour(rng), 0.06), tile_m=(0.5, 0.5), specular=0.4, shininess=70
    )
    parts = [turned(BOWL * radius, glaze, 32)]
    for index in range(7):
        angle, ring = index * 2 * np.pi / 5, 0.52 * radius if index < 5 else 0.16 * radius
        size = rng.uniform(0.032, 0.042)
        skin = Material(
            texture=mottled(rng, FRUIT[rng.integers(len(FRUIT))], 0.1, 0.03),
            tile_m=(0.5, 0.5),
            specular=0.25,
            shininess=30,
        )
        at = (
            ring * cos(angle),
            ring * sin(angle),
            0.3 * radius + size + (0.04 if index > 4 else 0.0),
        )
        parts.append(
            ellipsoid((size, size, size * rng.uniform(0.85, 1.15)), skin, 20).moved(
                translation(*at)
            )
        )
    return parts


def jar(rng: np.random.Generator) -> list[Surface]:
    """Storage jar with a lid."""
    radius, height = rng.uniform(0.04, 0.06), rng.uniform(0.12, 0.2)
    around = 2 * np.pi * radius
    colours = [some_colour(rng), some_colour(rng), (0.75, 0.72, 0.66)]
    skin = Material(
        texture=bands(rng, (around, height), colours, [0.2, 0.75]),
        tile_m=(around, height),
        specular=0.3,
        shininess=60,
    )
    lid = Material(plain((0.5, 0.42, 0.3)), specular=0.2)
    side = turned([(0, 0), (radius, 0), (radius, height), (0.9 * radius, height)], skin)
    return [
        side,
        turned(
            [(1.04 * radius, height), (1.04 * radius, height + 0.022), (0, height + 0.026)], lid
        ),
    ]


def candle_stick(rng: np.random.Generator) -> list[Surface]:
    """Candle on a turned foot; its flame is a moving thing."""
    brass = Material(plain((0.6, 0.45, 0.2)), specular=0.8, shininess=60)
    foot = turned(
        [(0, 0), (0.045, 0), (0.04, 0.012), (0.01, 0.03), (0.012, 0.09), (0.025, 0.1), (0, 0.1)],
        brass,
    )
    wax = Material(mottled(rng, (0.9, 0.85, 0.72), 0.03), (0.5, 0.5), 0.1)
    return [foot, turned([(0.011, 0.1), (0.011, 0.2), (0.0, 0.203)], wax, 16)]


def books(rng: np.random.Generator, width: float, tallest: float) -> list[Surface]:
    """Return a row of books between x = 0 and the width, backs towards -y.

    The last ones may lean.
    """
    parts: list[Surface] = []
    x = 0.0
    while True:
        thick, tall, deep = (
            rng.uniform(0.014, 0.042),
            rng.uniform(0.68, 1.0) * tallest,
            rng.uniform(0.13, 0.18),
        )
        if x + thick > width - 0.06:
            return parts
        ink = some_colour(rng)
        cloth = bands(rng, (tall, thick), [ink, some_colour(rng), ink], [0.12, 0.88])
        lettered = bands(
            rng,
            (thick, tall),
            [ink, some_colour(rng), ink, some_colour(rng), ink],
            [0.1, 0.16, 0.66, 0.8],
        )
        spine = Material(np.rot90(lettered) if thick < tall else cloth, (tall, thick), 0.08)
        parts += moved(box((0, -deep, 0), (thick, 0, tall), spine), translation(x, 0, 0))
        x += thick + 0.001


Maker = Callable[[np.random.Generator], list[Surface]]


def scatter(
    rng: np.random.Generator,
    makers: Sequence[Maker],
    spots: Sequence[tuple[float, float]],
    z: float,
) -> list[Surface]:
    """Return one thing of each maker on each spot of a level surface at height z, nudged a
    little.
    """
    parts: list[Surface] = []
    for maker, (x, y) in zip(makers, spots, strict=True):
        nudge_x, nudge_y = rng.uniform(-0.02, 0.02, 2)
        parts += moved(maker(rng), translation(x + nudge_x, y + nudge_y, z))
    return parts


def table(
    width: float, depth: float, height: float, top: Material, legs: Material
) -> list[Surface]:
    """Return the table with four slim legs and an apron."""
    x, y = width / 2, depth / 2
    parts = box((-x, -y, height - 0.035), (x, y, height), top, 0.03)
    for side_x in (-x + 0.06, x - 0.06):
        for side_y in (-y + 0.06, y - 0.06):
            parts += box(
                (side_x - 0.022, side_y - 0.022, 0),
                (side_x + 0.022, side_y + 0.022, height - 0.035),
                legs,
            )
    for side_y in (-y + 0.06, y - 0.06):
        parts += box(
            (-x + 0.082, side_y - 0.01, height - 0.115),
            (x - 0.082, side_y + 0.01, height - 0.035),
            legs,
        )
    return parts


def chair(wood: Material, seat: Material, slats: int) -> list[Surface]:
    """Wooden chair with round legs, a cushion and a slatted back."""
    parts = [
        rod((x, y, 0), (0.9 * x, 0.9 * y, 0.44), (0.013, 0.018), wood)
        for x in (-0.2, 0.2)
        for y in (-0.2, 0.2)
    ]
    parts += [rod((x, -0.19, 0.18), (x, 0.19, 0.18), (0.009, 0.009), wood) for x in (-0.195, 0.195)]
    parts += box((-0.22, -0.22, 0.44), (0.22, 0.22, 0.465), wood)
    parts += box((-0.2, -0.2, 0.465), (0.2, 0.19, 0.495), seat, 0.04)
    parts += [
        rod((x, 0.2, 0.45), (x * 1.03, 0.27, 0.98), (0.016, 0.013), wood) for x in (-0.2, 0.2)
    ]
    parts += [rod((-0.205, 0.27, z), (0.205, 0.27, z), (0.016, 0.016), wood) for z in (0.62, 0.96)]
    return parts + [
        rod((x, 0.268, 0.63), (x, 0.268, 0.95), (0.007, 0.007), wood)
        for x in np.linspace(-0.15, 0.15, slats)
    ]


def shelf(
    width: float, depth: float, heights: list[float], frame: Material, back: Material
) -> list[Surface]:
    """Open shelf: two sides, a back and a board at each height."""
    x, y, top = width / 2, depth / 2, heights[-1]
    parts = box((-x, -y, 0), (-x + 0.022, y, top), frame) + box(
        (x - 0.022, -y, 0), (x, y, top), frame
    )
    parts += box((-x + 0.022, y - 0.012, 0.02), (x - 0.022, y, top), back)
    for height in heights:
        parts += box(
            (-x + 0.022, -y + 0.002, height - 0.022), (x - 0.022, y - 0.012, height), frame, 0.04
        )
    return parts


def cupboard(
    width: float, depth: float, height: float, frame: Material, inside: Material
) -> list[Surface]:
    """Cupboard without a door in front; the door is a moving thing."""
    x, y = width / 2, depth / 2
    parts = box((-x, -y, 0), (-x + 0.02, y, height), frame) + box(
        (x - 0.02, -y, 0), (x, y, height), frame
    )
    parts += box((-x, -y, height), (x, y, height + 0.02), frame, 0.04) + box(
        (-x + 0.02, -y, 0.04), (x - 0.02, y, 0.06), frame
    )
    parts += box((-x + 0.02, y - 0.015, 0.06), (x - 0.02, y, height), inside)
    return parts + box(
        (-x + 0.02, -y + 0.03, height / 2), (x - 0.02, y - 0.015, height / 2 + 0.018), frame, 0.04
    )


def screen_body(width: float, height: float, black: Material) -> list[Surface]:
    """Flat screen on a stand, without the picture: a panel of this size belongs at z = 0.065, just
    before y = -0.02.
    """
    x = width / 2 + 0.015
    parts = box((-x, -0.02, 0.05), (x, 0.02, height + 0.08), black)
    return (
        parts
        + box((-0.2, -0.09, 0), (0.2, 0.07, 0.012), black)
        + box((-0.03, -0.005, 0), (0.03, 0.015, 0.06), black)
    )


def floor_lamp(height: float, metal: Material, shade: Material) -> list[Surface]:
    """Lamp on a thin stand under an open conical shade, which glows."""
    foot = turned([(0, 0), (0.14, 0), (0.14, 0.012), (0.02, 0.03), (0.0, 0.03)], metal)
    stand = rod((0, 0, 0.02), (0, 0, height - 0.1), (0.009, 0.007), metal)
    return [foot, stand, *lamp_shade(0.19, 0.11, 0.24, shade, height - 0.14)]


def pendant_lamp(ceiling: float, drop: float, metal: Material, shade: Material) -> list[Surface]:
    """Lamp that hangs from the ceiling on a thin cord."""
    cord = rod((0, 0, ceiling - drop), (0, 0, ceiling), (0.004, 0.004), metal)
    return [cord, *lamp_shade(0.17, 0.05, 0.15, shade, ceiling - drop - 0.14)]


def lamp_shade(
    radius_low: float, radius_high: float, height: float, shade: Material, z: float
) -> list[Surface]:
    """Conical shade with an outside and an inside, open at both ends, its lower rim at z."""
    outside = np.array(
        [(radius_low, 0), ((radius_low + radius_high) / 2, height / 2), (radius_high, height)]
    )
    inside = outside[::-1] - (0.004, 0.0)
    return moved([turned(outside, shade, 32), turned(inside, shade, 32)], translation(0, 0, z))


def plant(
    rng: np.random.Generator, pot: Material, green: Colour, leaves: int, height: float
) -> list[Surface]:
    """Pot plant with bent leaves on thin stalks."""
    profile = [
        (0, 0),
        (0.1, 0),
        (0.135, 0.22),
        (0.15, 0.24),
        (0.14, 0.26),
        (0.12, 0.22),
        (0, 0.215),
    ]
    parts = [turned(profile, pot)]
    leaf_kinds = [
        Material(
            texture=mottled(rng, tuple(np.array(green) * tone)),
            tile_m=(0.5, 0.5),
            specular=0.12,
            shininess=25,
        )
        for tone in (0.8, 1.0, 1.25)
    ]
    for index in range(leaves):
        angle, share = index * 2.4 + rng.uniform(-0.3, 0.3), (index + 0.5) / leaves
        reach, rise = (
            rng.uniform(0.1, 0.28) * (1.2 - share),
            0.25 + (height - 0.3) * (0.2 + 0.8 * share),
        )
        base = np.array([reach * cos(angle), reach * sin(angle), rise])
        parts.append(
            rod((0.02 * cos(angle), 0.02 * sin(angle), 0.2), base, (0.005, 0.003), leaf_kinds[0], 6)
        )
        blade = _leaf(
            rng.uniform(0.2, 0.34),
            rng.uniform(0.05, 0.09),
            rng.uniform(0.5, 1.3),
            leaf_kinds[index % 3],
        )
        parts += moved(blade, product(translation(*base), rotation(angle, (0, 0, 1))))
    return parts


def _leaf(length: float, width: float, bend: float, material: Material) -> list[Surface]:
    along, across = np.meshgrid(np.linspace(0, 1, 9), np.linspace(-1, 1, 5), indexing="ij")
    half = width * power(sin(np.pi * np.clip(along * 0.94 + 0.04, 0, 1)), 0.8)
    angle = 0.7 - bend * along
    x, z = np.cumsum(cos(angle), 0) * length / 9, np.cumsum(sin(angle), 0) * length / 9
    points = np.stack([x, across * half, z + 0.25 * np.abs(across) * half], -1)
    uv = np.stack([along * length, across * half], -1)
    return [
        sheet(points - (0, 0, 0.001), uv, material),
        sheet(points[:, ::-1], uv[:, ::-1], material),
    ]


def framed_picture(image: Image8, width: float, frame: Material) -> list[Surface]:
    """Return the picture with a frame and a mount, hanging on the wall at y = 0, centred on
    z = 0.
    """
    height = width * image.shape[0] / image.shape[1]
    x, z, rim = width / 2 + 0.04, height / 2 + 0.04, 0.022
    across = [((-x, -z), (x, -z + rim)), ((-x, z - rim), (x, z))]
    upright = [((-x, -z + rim), (-x + rim, z - rim)), ((x - rim, -z + rim), (x, z - rim))]
    parts = [
        part
        for (x0, z0), (x1, z1) in across + upright
        for part in box((x0, -0.03, z0), (x1, 0, z1), frame)
    ]
    mount = panel(
        (-x, -0.012, -z), (2 * x, 0, 0), (0, 0, 2 * z), Material(plain((0.9, 0.88, 0.84)))
    )
    photo = panel(
        (-width / 2, -0.014, -height / 2),
        (width, 0, 0),
        (0, 0, height),
        Material(texture=image, tile_m=(width, height), specular=0.05, shininess=60),
    )
    return [*parts, mount, photo]


def curtain(width: float, height: float, folds: int, material: Material) -> list[Surface]:
    """Curtain in folds, its rail at the given height, seen from both sides."""
    u, v = np.meshgrid(np.linspace(0, 1, folds * 8 + 1), np.linspace(0, 1, 24))
    depth = 0.035 * sin(2 * np.pi * folds * u) * (0.5 + 0.5 * (1 - v))
    points = np.stack([(u - 0.5) * width, depth, v * height], -1)
    uv = np.stack([u * width * 1.6, v * height], -1)
    back = sheet(points[:, ::-1] + (0, 0.002, 0), uv[:, ::-1], material)
    return [
        sheet(points, uv, material),
        back,
        rod((-width / 2, 0, height), (width / 2, 0, height), (0.012, 0.012), material),
    ]


def cushion(width: float, material: Material) -> Surface:
    """Soft cushion standing on its edge."""
    return ellipsoid((width / 2, 0.09, width / 2), material).moved(translation(0, 0, width / 2))
