"""A person made of joints: torso, head, two-segment arms and legs, who gestures with one arm and
works with the other.
"""

from dataclasses import dataclass

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.contrib.worlds.room.surfaces import (
    Material,
    Surface,
    ellipsoid,
    moved,
    rod,
    rotation,
    sheet,
    translation,
)
from ggvs_eval.contrib.worlds.room.textures import Colour, fabric, mottled, plain
from ggvs_eval.kernels.portable import cos, power, product, sin, unit

UPPER_ARM_M, FOREARM_M = 0.28, 0.25
# Height, half width and half depth of rings around the trunk, metres.
TRUNK = (
    (0.9, 0.163, 0.118),
    (0.94, 0.165, 0.12),
    (1.08, 0.155, 0.11),
    (1.28, 0.18, 0.125),
    (1.37, 0.178, 0.115),
    (1.42, 0.155, 0.1),
    (1.455, 0.1, 0.08),
    (1.49, 0.06, 0.06),
)
SKIN: tuple[Colour, ...] = (
    (0.85, 0.64, 0.53),
    (0.67, 0.46, 0.34),
    (0.45, 0.3, 0.22),
    (0.9, 0.72, 0.62),
)
HAIR: tuple[Colour, ...] = (
    (0.13, 0.1, 0.08),
    (0.36, 0.22, 0.12),
    (0.6, 0.45, 0.25),
    (0.45, 0.43, 0.42),
)


@dataclass(frozen=True, eq=False)
class Figure:
    """A person standing at a place of the room, facing -y.

    Attributes:
        place: x and y of the feet, metres.
        side: +1 waves with the arm towards +x, -1 with the other.
        phase_rad: where in the gesture the clip begins.
    """

    skin: Material
    hair: Material
    shirt: Material
    trousers: Material
    place: tuple[float, float]
    side: int
    phase_rad: float

    def surfaces(self, time_s: float) -> list[Surface]:
        """Return the body at an instant, room frame."""
        sway = sin(2 * np.pi * 0.55 * time_s + self.phase_rad)
        lean = rotation(0.05 * sway, (0, 1, 0), (0, 0, 0.9))
        upper = [
            *self._trunk(),
            *self._head(time_s),
            *self._gesturing_arm(time_s),
            *self._working_arm(time_s),
        ]
        turn = rotation(0.12 * sway, (0, 0, 1))
        place = translation(self.place[0] + 0.07 * sway, self.place[1], 0)
        return moved([*moved(upper, product(turn, lean)), *self._legs(0.07 * sway)], place)

    def _trunk(self) -> list[Surface]:
        rings = np.array(TRUNK)
        height = np.linspace(rings[0, 0], rings[-1, 0], 26)
        wide, deep = (np.interp(height, rings[:, 0], rings[:, k])[:, None] for k in (1, 2))
        angle = np.linspace(0, 2 * np.pi, 37)[None]
        # A superellipse is squarer than an ellipse, as a chest is.
        x, y = (np.sign(f(angle)) * power(np.abs(f(angle)), 0.88) for f in (cos, sin))
        points = np.stack([wide * x, deep * y, height[:, None] + 0 * x], -1)
        uv = np.stack([angle * 0.16 + 0 * wide, height[:, None] + 0 * angle], -1)
        return [
            sheet(points, uv, self.shirt, closed=True),
            rod((0, 0.01, 1.47), (0, 0, 1.56), (0.052, 0.05), self.skin),
        ]

    def _head(self, time_s: float) -> list[Surface]:
        dark = Material(plain((0.12, 0.08, 0.07)), specular=0.5)
        lips = Material(plain((0.55, 0.25, 0.22)))
        parts = [
            ellipsoid((0.076, 0.094, 0.118), self.skin),
            ellipsoid((0.083, 0.094, 0.1), self.hair).moved(translation(0, 0.022, 0.038)),
            ellipsoid((0.014, 0.022, 0.024), self.skin, 12).moved(translation(0, -0.094, -0.012)),
            ellipsoid((0.026, 0.008, 0.007), lips, 12).moved(translation(0, -0.083, -0.054)),
        ]
        for side in (-1, 1):
            parts.append(
                ellipsoid((0.014, 0.007, 0.009), dark, 12).moved(
                    translation(0.032 * side, -0.083, 0.018)
                )
            )
            parts.append(
                ellipsoid((0.02, 0.006, 0.005), self.hair, 12).moved(
                    translation(0.032 * side, -0.083, 0.041)
                )
            )
            parts.append(
                ellipsoid((0.012, 0.022, 0.032), self.skin, 12).moved(
                    translation(0.077 * side, 0.005, 0.0)
                )
            )
        nod = rotation(0.1 + 0.06 * sin(2 * np.pi * 0.9 * time_s), (1, 0, 0))
        turn = rotation(0.35 * sin(2 * np.pi * 0.45 * time_s + self.phase_rad), (0, 0, 1))
        return moved(parts, product(translation(0, -0.012, 1.65), product(turn, nod)))

    def _gesturing_arm(self, time_s: float) -> list[Surface]:
        swing = sin(2 * np.pi * 1.1 * time_s + self.phase_rad)
        outward = self._direction(lift_rad=-0.15 + 0.25 * swing, forward_rad=0.5)
        upward = self._direction(lift_rad=1.25 - 0.6 * swing, forward_rad=0.45)
        return self._arm(self.side, outward, upward)

    def _working_arm(self, time_s: float) -> list[Surface]:
        circle = 2 * np.pi * 0.9 * time_s + 2 * self.phase_rad
        down = np.array([0.25, -0.35 - 0.08 * cos(circle), -0.9])
        ahead = np.array([-0.35 + 0.25 * sin(circle), -0.85, -0.1 + 0.15 * cos(circle)])
        mirror = np.array([-self.side, 1, 1])
        return self._arm(-self.side, down * mirror, ahead * mirror)

    def _direction(self, lift_rad: float, forward_rad: float) -> Array:
        level = np.array([self.side * cos(forward_rad), -sin(forward_rad), 0.0])
        return cos(lift_rad) * level + sin(lift_rad) * np.array([0.0, 0.0, 1.0])

    def _arm(self, side: int, upper: Array, fore: Array) -> list[Surface]:
        upper, fore = unit(upper), unit(fore)
        shoulder = np.array([0.175 * side, 0.0, 1.375])
        elbow = shoulder + UPPER_ARM_M * upper
        wrist = elbow + FOREARM_M * fore
        across = unit(np.cross(fore, (0.0, 1.0, 0.3)))
        parts = [
            rod(shoulder, elbow, (0.06, 0.046), self.shirt),
            rod(elbow, elbow + 0.12 * fore, (0.047, 0.044), self.shirt),
        ]
        parts.append(rod(elbow + 0.1 * fore, wrist, (0.038, 0.027), self.skin))
        parts.append(rod(wrist, wrist + 0.085 * fore, (0.028, 0.034), self.skin))
        for spread in (-0.026, -0.009, 0.009, 0.026):
            knuckle = wrist + 0.1 * fore + spread * across
            parts.append(
                rod(
                    knuckle,
                    knuckle + 0.065 * fore + 0.5 * spread * across,
                    (0.0095, 0.0075),
                    self.skin,
                    8,
                )
            )
        thumb = wrist + 0.04 * fore - 0.03 * across
        return [
            *parts,
            rod(thumb, thumb + 0.035 * fore - 0.035 * across, (0.012, 0.009), self.skin, 8),
        ]

    def _legs(self, shift: float) -> list[Surface]:
        parts = [ellipsoid((0.158, 0.112, 0.11), self.trousers).moved(translation(0, 0, 0.9))]
        for side in (-1, 1):
            hip, foot = (
                np.array([0.09 * side, 0.0, 0.88]),
                np.array([0.12 * side - shift, 0.02, 0.07]),
            )
            knee = (hip + foot) / 2 + (0.0, -0.03, 0.02)
            parts += [
                rod(hip, knee, (0.085, 0.06), self.trousers),
                rod(knee, foot, (0.06, 0.05), self.trousers),
            ]
            parts.append(
                ellipsoid((0.05, 0.13, 0.05), self.hair).moved(
                    translation(*np.add(foot, (0, -0.06, -0.02)))
                )
            )
        return parts


def random_figure(rng: np.random.Generator, place: tuple[float, float]) -> Figure:
    """Return a person in clothes of the generator's choice."""
    cloth = [
        (0.16, 0.27, 0.48),
        (0.62, 0.2, 0.18),
        (0.25, 0.42, 0.33),
        (0.82, 0.78, 0.7),
        (0.75, 0.55, 0.2),
    ]
    first, second = rng.permutation(len(cloth))[:2]
    kind = ("stripes", "check")[rng.integers(2)]
    return Figure(
        skin=Material(
            texture=mottled(rng, SKIN[rng.integers(len(SKIN))], 0.03),
            tile_m=(0.5, 0.5),
            specular=0.08,
            shininess=15,
        ),
        hair=Material(
            texture=mottled(rng, HAIR[rng.integers(len(HAIR))], 0.25, 0.008),
            tile_m=(0.5, 0.5),
            specular=0.15,
            shininess=20,
        ),
        shirt=Material(fabric(rng, (1.0, 1.0), cloth[first], cloth[second], kind)),
        trousers=Material(fabric(rng, (1.0, 1.0), (0.17, 0.19, 0.26), (0.2, 0.22, 0.3), "plain")),
        place=place,
        side=int(rng.choice((-1, 1))),
        phase_rad=float(rng.uniform(-0.6, 0.6)),
    )
