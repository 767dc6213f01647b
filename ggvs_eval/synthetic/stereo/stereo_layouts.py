"""The kinds of stereo scenes: rooms, workshops, clutter, nearly flat scenes, thickets; each fills a `SceneBuilder`."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ggvs_eval.synthetic.stereo.stereo_builder import SceneBuilder
from ggvs_eval.synthetic.stereo.stereo_masks import mask_bank
from ggvs_eval.synthetic.stereo.stereo_paint import Look
from ggvs_eval.synthetic.stereo.stereo_things import (
    Floor,
    add_figure,
    add_floating_box,
    add_furniture,
    add_outlined_card,
    add_pole,
    add_thing,
    add_wall_picture,
    add_wire,
    inside,
    nearer,
)

Layout = Callable[[SceneBuilder, float, float], None]


def fill(builder: SceneBuilder, d_min: float, d_max: float) -> None:
    """Fill a scene of a random kind between two disparities, pixels."""
    kinds: list[tuple[float, Layout]] = [(0.38, room), (0.2, workshop), (0.24, clutter), (0.07, flat), (0.11, thicket)]
    chosen = builder.rng.choice(len(kinds), p=[weight for weight, _ in kinds])
    kinds[int(chosen)][1](builder, d_min, d_max)


def room(builder: SceneBuilder, d_min: float, d_max: float) -> None:
    """Walls, a floor, perhaps a ceiling; furniture and people on the floor, things on the walls, poles and cards in front."""
    rng = builder.rng
    floor = _walls(builder, d_min, d_max, untextured=0.6)
    for _ in range(int(rng.integers(2, 8))):
        add_wall_picture(builder, d_min, d_max)
    for _ in range(int(rng.integers(4, 12))):
        add_furniture(builder, floor, d_max) if floor else add_floating_box(builder, nearer(rng, d_min, d_max))
    for _ in range(int(rng.integers(0, 3)) if floor else 0):
        add_figure(builder, floor, d_max)  # type: ignore[arg-type]
    for _ in range(int(rng.integers(1, 7))):
        add_thing(builder, nearer(rng, d_min, d_max))
    for _ in range(int(rng.integers(1, 5))):
        add_pole(builder, nearer(rng, d_min, d_max))


def workshop(builder: SceneBuilder, d_min: float, d_max: float) -> None:
    """A wall, and before it a tangle of thin bent parts, wheels and small blocks about one middle distance."""
    rng = builder.rng
    _walls(builder, d_min, d_max, untextured=0.35)
    middle = np.sqrt(d_min * d_max)
    low, high = max(d_min, middle / 1.6), min(d_max, middle * 1.6)
    for _ in range(int(rng.integers(6, 18))):
        add_wire(builder, rng.uniform(low, high))
    for _ in range(int(rng.integers(1, 6))):
        add_outlined_card(builder, rng.uniform(low, high), thin=True)
    for _ in range(int(rng.integers(4, 12))):
        add_floating_box(builder, rng.uniform(low, high), scale=0.5)
    for _ in range(int(rng.integers(2, 9))):
        add_thing(builder, rng.uniform(low, high), scale=0.6)
    for _ in range(int(rng.integers(0, 4))):
        add_thing(builder, nearer(rng, d_min, d_max))


def clutter(builder: SceneBuilder, d_min: float, d_max: float) -> None:
    """Things of all kinds anywhere between near and far."""
    rng = builder.rng
    _backdrop(builder, d_min, d_max)
    for _ in range(int(rng.integers(12, 36))):
        add_thing(builder, nearer(rng, d_min, d_max))
    for _ in range(int(rng.integers(0, 4))):
        add_wire(builder, nearer(rng, d_min, d_max))


def flat(builder: SceneBuilder, d_min: float, d_max: float) -> None:
    """One slanted or wavy wall with little before it: a large untextured or repeated surface."""
    rng = builder.rng
    _backdrop(builder, d_min, d_max)
    d_max = min(d_max, 2 * d_min * rng.uniform(1.1, 1.5))
    for _ in range(int(rng.integers(0, 8))):
        add_thing(builder, nearer(rng, 1.3 * d_min, d_max), scale=0.7)


def thicket(builder: SceneBuilder, d_min: float, d_max: float) -> None:
    """Stalks and leaves in depth."""
    rng = builder.rng
    _backdrop(builder, d_min, d_max)
    leaf, stalk = builder.look(), builder.look()
    outline = mask_bank()[32 + int(rng.integers(8))]
    for _ in range(int(rng.integers(5, 12))):
        add_pole(builder, nearer(rng, d_min, d_max), stalk)
    for _ in range(int(rng.integers(15, 40))):
        size = builder.width * rng.uniform(0.05, 0.3)
        place = inside(builder, nearer(rng, d_min, d_max), size)
        look = leaf if rng.random() < 0.7 else builder.look()
        builder.add_card(place, (size, size), look, tilt=1.0, mask=outline, bent=bool(rng.random() < 0.4))


def _walls(builder: SceneBuilder, d_min: float, d_max: float, untextured: float) -> Floor | None:
    """Planes that enclose the scene; the nearest of them is seen. Returns the floor."""
    rng, width, height = builder.rng, builder.width, builder.height
    far = 1.2 * d_min
    # No wall comes nearer than the things before it.
    steepest = max(0.75 * d_max - far, 0.1 * d_min)
    slope_x = d_min / width * (rng.normal(0, 0.2) if rng.random() < 0.6 else rng.uniform(-0.6, 0.6))
    builder.add_plane(
        far, slope_x, rng.normal(0, 0.08) * d_min / height, _wall_look(builder, untextured), (width / 2, height / 2)
    )
    floor = None
    if rng.random() < 0.8:
        line = height * rng.uniform(0.45, 0.85)
        floor = Floor(far, slope_x, min(d_min * rng.uniform(1, 5) / height, steepest / (height - line)), (width / 2, line))
        builder.add_plane(far, slope_x, floor.slope_y, _wall_look(builder, 0.3), floor.pivot)
    if rng.random() < 0.35:
        line = height * rng.uniform(0.05, 0.3)
        slope_y = -min(d_min * rng.uniform(0.5, 3) / height, steepest / line)
        builder.add_plane(far, slope_x, slope_y, _wall_look(builder, 0.8), (width / 2, line))
    for side in (1, -1):
        if rng.random() < 0.45:
            reach = width * rng.uniform(0.02, 0.35)
            slope = side * min(d_min * rng.uniform(0.5, 5) / width, steepest / reach)
            pivot = (width / 2 + side * (width / 2 - reach), height / 2)
            builder.add_plane(far, slope, rng.normal(0, 0.05) * abs(slope), _wall_look(builder, untextured), pivot)
    return floor


def _backdrop(builder: SceneBuilder, d_min: float, d_max: float) -> None:
    """Walls, or one slanted wall, or a wavy one."""
    rng = builder.rng
    kind = rng.random()
    if kind < 0.4:
        _walls(builder, d_min, d_max, untextured=0.3)
        return
    share = min(0.45, 0.5 * (d_max / d_min - 1))
    slope = [rng.uniform(-share, share) * d_min / n for n in (builder.width, builder.height)]
    if kind < 0.7:
        builder.add_plane(d_min * (1 + share), slope[0], slope[1], builder.look(), (builder.width / 2, builder.height / 2))
    else:
        wave_px = builder.width * float(np.exp(rng.uniform(np.log(0.1), np.log(0.8))))
        builder.add_wavy_plane(d_min * (1 + share), (slope[0], slope[1]), builder.look(), rng.uniform(0.02, 0.12), wave_px)


def _wall_look(builder: SceneBuilder, untextured: float) -> Look:
    """A patterned wall, or a painted one with hardly any mark on it."""
    look, rng = builder.look(), builder.rng
    if rng.random() >= untextured:
        return look
    contrast = float(rng.choice([0.0, 0.02, 0.06]))
    colour = np.clip(rng.uniform(0.25, 0.85) + rng.normal(0, 0.05, 3), 0.1, 0.9)
    strength = float(rng.choice([0.0, 0.01, 0.03, 0.06]))
    return replace(look, gain=contrast * np.ones(3), bias=(1 - contrast) * colour, grain_strength=strength)
