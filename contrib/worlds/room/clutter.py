"""Small things that stand about: bottles, cups, bowls, fruit, books, candles; each on z = 0, metres."""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from ggvs_eval.contrib.worlds.room.surfaces import Material, Surface, box, ellipsoid, moved, rod, rotation, translation, turned
from ggvs_eval.contrib.worlds.room.textures import Colour, bands, mottled, plain
from ggvs_eval.kernels.portable import cos, length, sin

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
    [(0, 0), (1, 0), (1.02, 0.02), (1, 0.3), (1, 0.6), (0.85, 0.68), (0.4, 0.76), (0.33, 0.95), (0.4, 0.97), (0.4, 1), (0, 1)]
)
BOWL = np.array([(0, 0), (0.4, 0), (0.45, 0.04), (0.8, 0.22), (1, 0.5), (0.96, 0.5), (0.75, 0.26), (0.3, 0.12), (0, 0.12)])
FRUIT: tuple[Colour, ...] = ((0.85, 0.5, 0.1), (0.75, 0.15, 0.12), (0.55, 0.68, 0.2), (0.9, 0.78, 0.2))


def some_colour(rng: np.random.Generator) -> Colour:
    """One of a palette that fits a home, shaded a little."""
    red, green, blue = np.clip(np.array(BRIGHT[rng.integers(len(BRIGHT))]) * rng.uniform(0.8, 1.15), 0.05, 0.95)
    return float(red), float(green), float(blue)


def bottle(rng: np.random.Generator) -> list[Surface]:
    """Wine or oil bottle with a label and a capsule."""
    height, radius = rng.uniform(0.22, 0.32), rng.uniform(0.03, 0.041)
    glass = ((0.1, 0.16, 0.09), (0.16, 0.1, 0.06), (0.5, 0.52, 0.4), (0.1, 0.11, 0.12))[rng.integers(4)]
    colours = [glass, (0.9, 0.87, 0.78) if rng.random() < 0.6 else some_colour(rng), glass, some_colour(rng)]
    around = 2 * np.pi * radius
    profile = BOTTLE * (radius, height)
    along = float(length(np.diff(profile, axis=0)).sum())
    skin = Material(bands(rng, (around, along), colours, [0.24, 0.55, 0.8]), (around, along), 0.6, 90)
    return [turned(profile, skin)]


def cup(rng: np.random.Generator) -> list[Surface]:
    """Mug with a handle and something dark in it."""
    radius, height = rng.uniform(0.035, 0.045), rng.uniform(0.08, 0.105)
    clay = Material(mottled(rng, some_colour(rng), 0.04), (0.5, 0.5), 0.35, 60)
    outline = np.array([(0, 0), (0.9, 0), (1, 0.5), (1, 1), (0.9, 1), (0.88, 0.8)])
    body = turned(outline * (radius, height), clay)
    drink = turned([(0.89 * radius, 0.8 * height), (1e-4, 0.8 * height)], Material(plain((0.2, 0.12, 0.07)), specular=0.4))
    knots = [(radius + 0.024 * sin(a), 0, height * 0.52 + 0.03 * cos(a)) for a in np.linspace(0, np.pi, 7)]
    handle = [rod(a, b, (0.005, 0.005), clay, 8) for a, b in pairwise(knots)]
    return moved([body, drink, *handle], rotation(rng.uniform(-1.2, 1.2), (0, 0, 1)))


def fruit_bowl(rng: np.random.Generator) -> list[Surface]:
    """Shallow bowl heaped with fruit."""
    radius = rng.uniform(0.12, 0.15)
    glaze = Material(mottled(rng, some_colour(rng), 0.06), (0.5, 0.5), 0.4, 70)
    parts = [turned(BOWL * radius, glaze, 32)]
    for index in range(7):
        angle, ring = index * 2 * np.pi / 5, 0.52 * radius if index < 5 else 0.16 * radius
        size = rng.uniform(0.032, 0.042)
        skin = Material(mottled(rng, FRUIT[rng.integers(len(FRUIT))], 0.1, 0.03), (0.5, 0.5), 0.25, 30)
        at = (ring * cos(angle), ring * sin(angle), 0.3 * radius + size + (0.04 if index > 4 else 0.0))
        parts.append(ellipsoid((size, size, size * rng.uniform(0.85, 1.15)), skin, 20).moved(translation(*at)))
    return parts


def jar(rng: np.random.Generator) -> list[Surface]:
    """Storage jar with a lid."""
    radius, height = rng.uniform(0.04, 0.06), rng.uniform(0.12, 0.2)
    around = 2 * np.pi * radius
    colours = [some_colour(rng), some_colour(rng), (0.75, 0.72, 0.66)]
    skin = Material(bands(rng, (around, height), colours, [0.2, 0.75]), (around, height), 0.3, 60)
    lid = Material(plain((0.5, 0.42, 0.3)), specular=0.2)
    side = turned([(0, 0), (radius, 0), (radius, height), (0.9 * radius, height)], skin)
    return [side, turned([(1.04 * radius, height), (1.04 * radius, height + 0.022), (0, height + 0.026)], lid)]


def candle_stick(rng: np.random.Generator) -> list[Surface]:
    """Candle on a turned foot; its flame is a moving thing."""
    brass = Material(plain((0.6, 0.45, 0.2)), specular=0.8, shininess=60)
    foot = turned([(0, 0), (0.045, 0), (0.04, 0.012), (0.01, 0.03), (0.012, 0.09), (0.025, 0.1), (0, 0.1)], brass)
    wax = Material(mottled(rng, (0.9, 0.85, 0.72), 0.03), (0.5, 0.5), 0.1)
    return [foot, turned([(0.011, 0.1), (0.011, 0.2), (0.0, 0.203)], wax, 16)]


def books(rng: np.random.Generator, width: float, tallest: float) -> list[Surface]:
    """A row of books between x = 0 and the width, backs towards -y; the last ones may lean."""
    parts: list[Surface] = []
    x = 0.0
    while True:
        thick, tall, deep = rng.uniform(0.014, 0.042), rng.uniform(0.68, 1.0) * tallest, rng.uniform(0.13, 0.18)
        if x + thick > width - 0.06:
            return parts
        ink = some_colour(rng)
        cloth = bands(rng, (tall, thick), [ink, some_colour(rng), ink], [0.12, 0.88])
        lettered = bands(rng, (thick, tall), [ink, some_colour(rng), ink, some_colour(rng), ink], [0.1, 0.16, 0.66, 0.8])
        spine = Material(np.rot90(lettered) if thick < tall else cloth, (tall, thick), 0.08)
        parts += moved(box((0, -deep, 0), (thick, 0, tall), spine), translation(x, 0, 0))
        x += thick + 0.001


Maker = Callable[[np.random.Generator], list[Surface]]


def scatter(rng: np.random.Generator, makers: Sequence[Maker], spots: Sequence[tuple[float, float]], z: float) -> list[Surface]:
    """One thing of each maker on each spot of a level surface at height z, nudged a little."""
    parts: list[Surface] = []
    for maker, (x, y) in zip(makers, spots, strict=True):
        nudge_x, nudge_y = rng.uniform(-0.02, 0.02, 2)
        parts += moved(maker(rng), translation(x + nudge_x, y + nudge_y, z))
    return parts
