"""Puts a stereo scene together, part by part; places and sizes are given as they appear in the left picture."""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from ggvs_eval.arrays import Image8, Vector
from ggvs_eval.synthetic.stereo.stereo_paint import Light, Look
from ggvs_eval.synthetic.stereo.stereo_render import Scene
from ggvs_eval.synthetic.stereo.stereo_shapes import Ball, Shape, Sheet
from ggvs_eval.synthetic.stereo.stereo_textures import TextureBank
from ggvs_eval.synthetic.stereo.stereo_tubes import Tubes


@dataclass(eq=False)
class SceneBuilder:
    """A scene in the making.

    Attributes:
        rng: source of all choices.
        bank: textures to choose from.
        width: of the pictures, pixels.
        height: of the pictures, pixels.
        focal_px: focal length, pixels.
        centre_px: principal point.
        gloss: whether some looks shine.
    """

    rng: np.random.Generator
    bank: TextureBank
    width: int
    height: int
    focal_px: float
    centre_px: tuple[float, float]
    gloss: bool = True
    _shapes: list[Shape] = field(default_factory=list)
    _looks: list[Look] = field(default_factory=list)
    _disparities: list[float] = field(default_factory=list)
    _pieces: list[tuple[Vector, Vector, float, int]] = field(default_factory=list)
    _tube_looks: list[Look] = field(default_factory=list)

    def point(self, column: float, row: float, disparity: float) -> Vector:
        """Point of space that the left camera sees at a pixel with a disparity."""
        ray = np.array([column - self.centre_px[0], row - self.centre_px[1], self.focal_px])
        return ray / disparity

    def look(self) -> Look:
        """A random look: patterned, plain or shiny."""
        rng = self.rng
        tint = np.clip(rng.normal(1, 0.12, 3) * rng.uniform(0.65, 1.25), 0.2, 1.5)
        contrast = (0.0, 0.03, 0.1, 0.35, 1.0)[min(int(rng.integers(14)), 4)]
        colour = np.clip(rng.uniform(0.12, 0.75) + rng.normal(0, 0.09, 3), 0.05, 0.9)
        turn = (0.0, np.pi / 2, float(rng.uniform(0, 2 * np.pi)))[int(rng.integers(3))]
        return Look(
            texture=int(rng.integers(len(self.bank.colours))),
            texels=float(np.exp(rng.uniform(np.log(0.5), np.log(3.5)))),
            turn=turn,
            shift=(float(rng.uniform(0, 1024)), float(rng.uniform(0, 1024))),
            gain=contrast * tint,
            bias=(1 - contrast) * colour,
            grain=int(rng.integers(len(self.bank.greys))),
            grain_texels=float(np.exp(rng.uniform(np.log(0.4), np.log(3)))),
            grain_strength=(0.0, 0.01, 0.02, 0.03, 0.05, 0.1, 0.2, 0.4)[int(rng.integers(8))],
            gloss=float(rng.uniform(0.1, 0.7)) * self.gloss if rng.random() < 0.2 else 0.0,
            sharpness=float(np.exp(rng.uniform(np.log(8), np.log(120)))),
        )

    def add_plane(self, disparity: float, slope_x: float, slope_y: float, look: Look, pivot: tuple[float, float]) -> None:
        """A whole plane: its disparity at the pivot (column, row) and how it grows per pixel."""
        normal, _ = self.plane_normal(disparity, slope_x, slope_y, pivot)
        centre = self.point(*pivot, disparity)
        axis_u, axis_v = axes_across(normal)
        self._add(Sheet(centre, axis_u, axis_v), look, disparity)

    def add_wavy_plane(self, disparity: float, slope: tuple[float, float], look: Look, depth: float, wave_px: float) -> None:
        """A whole plane with waves of a relative depth and a length in pixels: a curtain, a rock, a heap."""
        pivot = (self.width / 2, self.height / 2)
        normal, distance = self.plane_normal(disparity, *slope, pivot)
        axis_u, axis_v = axes_across(normal)
        waves = self._waves(3, wave_px / disparity, depth * distance, steepest=0.35)
        self._add(Sheet(self.point(*pivot, disparity), axis_u, axis_v, waves=waves), look, disparity)

    def add_card(
        self,
        place: tuple[float, float, float],
        size_px: tuple[float, float],
        look: Look,
        tilt: float,
        mask: Image8 | None = None,
        bent: bool = False,
    ) -> None:
        """A flat or bent piece with an outline.

        Args:
            place: column, row and disparity of its centre.
            size_px: width and height as they would appear facing the camera.
            look: how it is painted.
            tilt: largest angle between its normal and the line of sight, radians.
            mask: its outline, None = a rectangle.
            bent: whether it is curved like paper.
        """
        centre = self.point(*place)
        axes = self.turned(centre, tilt)
        half_u, half_v = (s / 2 / place[2] for s in size_px)
        waves = self._waves(1, 2.2 * half_u, 0.5 * half_u, steepest=0.45) if bent else None
        self._add(Sheet(centre, axes[0], axes[1], half_u, half_v, mask, waves), look, place[2])

    def add_box(self, centre: Vector, half: Vector, looks: list[Look], axes: Vector) -> None:
        """A box; of its six faces those that can be seen.

        Args:
            centre: in baselines, (3,).
            half: half lengths of its edges, baselines, (3,).
            looks: taken in turn by the three directions of faces.
            axes: unit vectors of its edges, rows, right-handed, (3, 3).
        """
        for axis in range(3):
            for side in (-1, 1):
                middle = centre + side * half[axis] * axes[axis]
                if side * axes[axis] @ middle >= 0 and side * axes[axis] @ (middle - [1, 0, 0]) >= 0:
                    continue
                a, b = (axis + 1) % 3, (axis + 2) % 3
                self._add(Sheet(middle, axes[a], axes[b], half[a], half[b]), looks[axis % len(looks)], self.focal_px / centre[2])

    def add_ball(self, centre: Vector, radii: Vector, look: Look, axes: Vector) -> None:
        """An ellipsoid; the texture's poles lie on its second axis. Lengths in baselines, axes as rows."""
        self._add(Ball(centre, axes, radii), look, self.focal_px / centre[2])

    def add_tube(self, points: Vector, radius: float, look: Look, disparity: float) -> None:
        """A tube along a polygon of points in space (N, 3), its radius in baselines; long pieces are cut into short ones."""
        for start, end in pairwise(points):
            pieces = max(1, int(np.linalg.norm(end - start) * disparity / max(48, 3 * radius * disparity)))
            corners = start + np.linspace(0, 1, pieces + 1)[:, None] * (end - start)
            for first, second in pairwise(corners):
                self._pieces.append((first, second, radius, len(self._tube_looks)))
        self._tube_looks.append(look.at(disparity))

    def scene(self) -> Scene:
        """What has been added, under a random light."""
        tube_of = np.array([piece[3] for piece in self._pieces], np.int64)
        looks = self._looks + self._tube_looks
        return Scene(self.focal_px, self.centre_px, self._shapes, self._tubes(), tube_of, looks, self._light())

    def _add(self, shape: Shape, look: Look, disparity: float) -> None:
        self._shapes.append(shape)
        self._looks.append(look.at(disparity))
        self._disparities.append(disparity)

    def plane_normal(self, disparity: float, slope_x: float, slope_y: float, pivot: tuple[float, float]) -> tuple[Vector, float]:
        """Unit normal of a plane given by its disparity, and its distance from the left eye."""
        offset = disparity - slope_x * (pivot[0] - self.centre_px[0]) - slope_y * (pivot[1] - self.centre_px[1])
        # disparity / focal length = 1 / z = m (x, y, 1) with x = column offset over the focal length
        normal = np.array([slope_x, slope_y, offset / self.focal_px])
        length = float(np.linalg.norm(normal))
        return normal / length, 1 / length

    def _waves(self, count: int, length: float, height: float, steepest: float) -> Vector:
        """Rows of `Sheet.waves`; heights are cut so that the slope stays below `steepest`."""
        rows = []
        for _ in range(count):
            angle, frequency = self.rng.uniform(0, np.pi), 2 * np.pi / (length * self.rng.uniform(0.7, 1.6))
            amplitude = min(height * self.rng.uniform(0.4, 1), steepest / frequency) / count
            rows.append([amplitude, frequency * np.cos(angle), frequency * np.sin(angle), self.rng.uniform(0, 2 * np.pi)])
        return np.array(rows)

    def turned(self, centre: Vector, tilt: float) -> Vector:
        """Axes of a thing at a point: the third along the line of sight, but for a random tilt; rows, (3, 3)."""
        axis_u, axis_v = axes_across(centre / np.linalg.norm(centre))
        frame = np.stack([axis_u, axis_v, centre / np.linalg.norm(centre)])
        roll = self.rng.uniform(0, 2 * np.pi) if self.rng.random() < 0.5 else self.rng.normal(0, 0.1)
        lean, towards = tilt * np.sqrt(self.rng.uniform(0, 1)), self.rng.uniform(0, 2 * np.pi)
        return rotation(np.array([np.cos(towards), np.sin(towards), 0]) * lean) @ rotation(np.array([0, 0, roll])) @ frame

    def _tubes(self) -> Tubes:
        if not self._pieces:
            return Tubes(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0))
        start, end = (np.array([piece[k] for piece in self._pieces]) for k in (0, 1))
        length = np.maximum(np.linalg.norm(end - start, axis=1), 1e-9)
        return Tubes(start, (end - start) / length[:, None], length, np.array([piece[2] for piece in self._pieces]))

    def _light(self) -> Light:
        rng = self.rng
        direction = np.array([rng.normal(0, 0.8), -rng.uniform(0.2, 1.2), -rng.uniform(0.2, 1.2)])
        length = self.width / float(np.median(self._disparities)) * np.exp(rng.uniform(np.log(0.2), np.log(1.5)))
        frequency = rng.normal(0, 1, (3, 3)) * 2 * np.pi / length
        return Light(
            direction=direction / np.linalg.norm(direction),
            ambient=float(rng.uniform(0.3, 0.9)),
            dapples=np.concatenate([frequency, rng.uniform(0, 2 * np.pi, (3, 1))], 1),
            dapple_strength=float(rng.uniform(0.05, 0.4)) if rng.random() < 0.45 else 0.0,
            dapple_sharpness=float(np.exp(rng.uniform(np.log(0.3), np.log(8)))),
        )


def axes_across(normal: Vector) -> tuple[Vector, Vector]:
    """Two unit vectors upright on a unit normal and each other, the first as level as can be."""
    level = np.cross([0.0, 1.0, 0.0], normal)
    if np.linalg.norm(level) < 1e-3:
        level = np.array([1.0, 0.0, 0.0])
    level = level - (level @ normal) * normal
    level /= np.linalg.norm(level)
    return level, np.cross(normal, level)


def rotation(vector: Vector) -> Vector:
    """Rotation matrix of a rotation vector."""
    return np.asarray(Rotation.from_rotvec(vector).as_matrix())
