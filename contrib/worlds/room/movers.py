"""Things that move or change by themselves: a rolling ball, a swinging door, a screen, a flame."""

from collections.abc import Callable

import numpy as np

from ggvs_eval.arrays import Array
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
from ggvs_eval.contrib.worlds.room.textures import bands, picture, plain
from ggvs_eval.kernels.portable import length, product, sin

Mover = Callable[[float], list[Surface]]


def rolling_ball(rng: np.random.Generator, start: tuple[float, float, float], speed: float, radius: float = 0.065) -> Mover:
    """A striped ball that rolls along x on a level surface.

    Args:
        start: where it touches the surface at time 0, metres.
        speed: metres per second along +x.
        radius: metres.
    """
    colours = rng.permutation([(0.86, 0.2, 0.15), (0.95, 0.9, 0.82), (0.15, 0.4, 0.7), (0.95, 0.75, 0.15), (0.2, 0.55, 0.35)])[:3]
    strip = np.rint(np.tile(colours, (2, 1)) * 255).astype(np.uint8)[None].repeat(40, axis=1).reshape(1, -1, 3)
    skin = Material(strip, (2 * np.pi * radius, 1.0), 0.5, 50)
    ball = ellipsoid((radius, radius, radius), skin, 40).moved(rotation(1.2, (0.3, 1, 0)))

    def at(time_s: float) -> list[Surface]:
        x = speed * time_s
        return [ball.moved(product(translation(start[0] + x, start[1], start[2] + radius), rotation(x / radius, (0, 1, 0))))]

    return at


def swinging_door(hinge: tuple[float, float, float], width: float, height: float, skin: Material, phase_rad: float) -> Mover:
    """A cupboard door, hinged at its -x edge, that swings open and shut towards -y."""
    knob = Material(plain((0.75, 0.65, 0.4)), specular=0.8)
    leaf = box((0, -0.018, 0), (width, 0, height), skin)
    leaf += [ellipsoid((0.014, 0.014, 0.014), knob, 12).moved(translation(width - 0.04, -0.03, height / 2))]
    leaf += [rod((width - 0.04, -0.03, height / 2), (width - 0.04, -0.018, height / 2), (0.006, 0.006), knob, 8)]

    def at(time_s: float) -> list[Surface]:
        angle = -0.75 - 0.45 * sin(2 * np.pi * 0.6 * time_s + phase_rad)
        return moved(leaf, product(translation(*hinge), rotation(angle, (0, 0, 1))))

    return at


def screen_colour(time_s: float, phase_rad: float) -> Array:
    """Tint of the screen's picture at an instant, (3,)."""
    return 0.65 + 0.35 * sin(2 * np.pi * 0.8 * time_s + phase_rad + np.array([0.0, 2.1, 4.2]))


def screen(name: str, corner: tuple[float, float, float], width: float, height: float, phase_rad: float) -> Mover:
    """A flat screen facing -y that shows a panning photograph in changing colours; its lower left corner is given."""
    photo = picture(name, 512, 288)

    def at(time_s: float) -> list[Surface]:
        panned = np.roll(np.concatenate([photo, photo[:, ::-1]], axis=1), -round(160 * time_s), axis=1)[:, :512]
        shown = np.rint(panned * screen_colour(time_s, phase_rad)).astype(np.uint8)
        return [panel(corner, (width, 0, 0), (0, 0, height), Material(shown, (width, height), 0.15, 120, emission=0.8))]

    return at


def flame_strength(time_s: float) -> float:
    """Brightness of the flame at an instant, around 1."""
    return float(1 + 0.22 * sin(2 * np.pi * 3.1 * time_s) + 0.12 * sin(2 * np.pi * 7.3 * time_s + 1))


def flame(rng: np.random.Generator, wick: tuple[float, float, float]) -> Mover:
    """A candle's flame that flickers in height, colour and direction."""
    profile = np.array([(0, 0), (0.55, 0.08), (0.9, 0.22), (1, 0.34), (0.8, 0.52), (0.42, 0.75), (0.15, 0.92), (0, 1)])
    texture = bands(rng, (0.05, 0.05), [(0.45, 0.5, 0.85), (1.0, 0.9, 0.55), (1.0, 0.72, 0.25)], [0.18, 0.7])

    def at(time_s: float) -> list[Surface]:
        strength = flame_strength(time_s)
        size = (0.011, 0.042 * strength)
        glow = Material(texture, (0.05, float(length(np.diff(profile * size, axis=0)).sum())), emission=3.0 * strength)
        lean = rotation(0.25 * sin(2 * np.pi * 1.9 * time_s), (0.4, 1, 0))
        return [turned(profile * size, glow, 16).moved(product(translation(*wick), lean))]

    return at
