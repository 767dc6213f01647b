"""Single things of the stereo scenes: cards, boxes, balls, poles and wires in the air; furniture and people on a floor."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline

from ggvs_eval.arrays import Vector
from ggvs_eval.synthetic.stereo.stereo_builder import SceneBuilder, axes_across, rotation
from ggvs_eval.synthetic.stereo.stereo_masks import mask_bank
from ggvs_eval.synthetic.stereo.stereo_paint import Look

THIN_MASKS = 16  # the first outlines of the mask bank have thin bars


@dataclass(frozen=True)
class Floor:
    """A plane to stand on: its disparity at a pivot (column, row), and how it grows per pixel."""

    disparity: float
    slope_x: float
    slope_y: float
    pivot: tuple[float, float]

    def at(self, column: float, row: float) -> float:
        """Its disparity at a pixel."""
        return self.disparity + self.slope_x * (column - self.pivot[0]) + self.slope_y * (row - self.pivot[1])


def nearer(rng: np.random.Generator, d_min: float, d_max: float) -> float:
    """A disparity in front of the walls; even in its logarithm."""
    return float(np.exp(rng.uniform(np.log(min(1.3 * d_min, d_max)), np.log(d_max))))


def inside(builder: SceneBuilder, disparity: float, size_px: float) -> tuple[float, float, float]:
    """Column, row and disparity of a thing's centre anywhere in the picture, its nearest point no nearer than `disparity`."""
    column, row = (float(builder.rng.uniform(-0.1, 1.1) * n) for n in (builder.width, builder.height))
    return column, row, disparity * (1 - min(size_px / 2, 0.6 * builder.focal_px) / builder.focal_px)


def _size(builder: SceneBuilder, scale: float) -> float:
    """A size in pixels, even in its logarithm."""
    return float(scale * builder.height * np.exp(builder.rng.uniform(np.log(0.08), np.log(0.7))))


def add_thing(builder: SceneBuilder, disparity: float, scale: float = 1.0) -> None:
    """A card, box, ball, pole or bent wire."""
    kind = builder.rng.random()
    if kind < 0.35:
        add_outlined_card(builder, disparity, thin=bool(builder.rng.random() < 0.3), scale=scale)
    elif kind < 0.57:
        add_floating_box(builder, disparity, scale)
    elif kind < 0.75:
        add_floating_ball(builder, disparity, scale)
    elif kind < 0.9:
        add_pole(builder, disparity)
    else:
        add_wire(builder, disparity)


def add_outlined_card(builder: SceneBuilder, disparity: float, thin: bool, scale: float = 1.0) -> None:
    """A card with an outline, or now and then a plain rectangle; thin ones are lattices and wheels."""
    rng, masks = builder.rng, mask_bank()
    index = int(rng.integers(THIN_MASKS)) if thin else int(rng.integers(THIN_MASKS, len(masks)))
    mask = masks[index] if thin or rng.random() < 0.75 else None
    size = _size(builder, scale * (1.3 if thin else 1.0))
    shape = (size, size * float(np.exp(rng.uniform(-0.6, 0.3))))
    place = inside(builder, disparity, float(np.hypot(*shape)))
    builder.add_card(place, shape, builder.look(), tilt=1.15, mask=mask, bent=bool(rng.random() < 0.3))


def add_wall_picture(builder: SceneBuilder, d_min: float, d_max: float) -> None:
    """A poster, board or window close to the wall."""
    rng = builder.rng
    disparity = min(d_min * rng.uniform(1.22, 1.5), d_max)
    column, row = rng.uniform(0, 1) * builder.width, rng.uniform(0, 0.6) * builder.height
    size = _size(builder, 0.9)
    builder.add_card((column, row, disparity), (size, size * rng.uniform(0.5, 1.5)), builder.look(), tilt=0.12)


def add_floating_box(builder: SceneBuilder, disparity: float, scale: float = 1.0) -> None:
    """A box that floats, turned at random."""
    rng = builder.rng
    edges = np.minimum(_size(builder, scale), 0.5 * builder.focal_px) * np.exp(rng.uniform(-0.9, 0.3, 3))
    place = inside(builder, disparity, float(np.linalg.norm(edges)))
    axes = rotation(rng.normal(0, 1.2, 3)).T
    builder.add_box(builder.point(*place), edges / 2 / place[2], _box_looks(builder), axes)


def _box_looks(builder: SceneBuilder) -> list[Look]:
    return [builder.look() for _ in range(1 if builder.rng.random() < 0.6 else 3)]


def _stand(builder: SceneBuilder, floor: Floor, d_max: float) -> tuple[Vector, Vector, float, float]:
    """A place on the floor: its point, the axes there (across, down, along), its disparity, how far a thing there may reach."""
    rng = builder.rng
    column, row = rng.uniform(-0.05, 1.05) * builder.width, rng.uniform(floor.pivot[1], 1.15 * builder.height)
    disparity = min(floor.at(column, row), 0.9 * d_max)
    # Where the floor is too near already, the place moves back along it.
    row = floor.pivot[1] + (disparity - floor.at(column, floor.pivot[1])) / floor.slope_y
    down, _ = builder.plane_normal(floor.disparity, floor.slope_x, floor.slope_y, floor.pivot)
    across, along = axes_across(down)
    turn = rotation(down * rng.uniform(-np.pi, np.pi)).T
    axes = np.stack([across @ turn, down, along @ turn])
    reach = (1 / disparity - 1 / d_max) * builder.focal_px
    return builder.point(column, row, disparity), axes, disparity, reach


def add_furniture(builder: SceneBuilder, floor: Floor, d_max: float) -> None:
    """A box, a table or a post that stands on the floor."""
    rng = builder.rng
    foot, axes, disparity, reach = _stand(builder, floor, d_max)
    size = min(_size(builder, 1.0) / disparity, 0.9 * reach)
    edges = size * np.exp(rng.uniform(-1, 0, 3))
    looks = _box_looks(builder)
    if rng.random() < 0.7:
        builder.add_box(foot - edges[1] / 2 * axes[1], edges / 2, looks, axes)
        return
    # A table or stool: a board on four legs.
    board = np.array([edges[0], 0.06 * size, edges[2]])
    builder.add_box(foot - edges[1] * axes[1], board / 2, looks, axes)
    thickness = size * rng.uniform(0.015, 0.05)
    for a, b in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        leg = foot + 0.45 * (a * edges[0] * axes[0] + b * edges[2] * axes[2])
        builder.add_tube(np.array([leg, leg - edges[1] * axes[1]]), thickness, looks[0], disparity)


def add_figure(builder: SceneBuilder, floor: Floor, d_max: float) -> None:
    """A person of tubes and balls; shares of the height after common proportions."""
    rng = builder.rng
    foot, axes, disparity, reach = _stand(builder, floor, d_max)
    height = min(builder.height * rng.uniform(0.35, 1.1) / disparity, 2 * reach)
    across, up = axes[0], -axes[1]
    skin, shirt, trousers = (builder.look() for _ in range(3))

    def joint(aside: float, above: float, ahead: float = 0.0) -> Vector:
        return foot + height * (aside * across + above * up + ahead * axes[2])

    for side in (-1, 1):
        step, swing = rng.normal(0, 0.05, 2)
        leg = np.array([joint(side * 0.06, 0.02, step), joint(side * 0.07, 0.27, step / 2), joint(side * 0.05, 0.5)])
        elbow = joint(side * (0.15 + abs(rng.normal(0, 0.05))), 0.62 + rng.normal(0, 0.04), swing)
        hand = joint(side * rng.uniform(0.02, 0.3), rng.uniform(0.42, 0.85), swing + rng.uniform(-0.15, 0.15))
        builder.add_tube(leg, 0.045 * height, trousers, disparity)
        builder.add_tube(np.array([joint(side * 0.12, 0.79), elbow]), 0.033 * height, shirt, disparity)
        builder.add_tube(np.array([elbow, hand]), 0.024 * height, skin, disparity)
    builder.add_ball(joint(0, 0.66), height * np.array([0.115, 0.18, 0.075]), shirt, axes)
    builder.add_tube(np.array([joint(0, 0.8), joint(0, 0.88)]), 0.03 * height, skin, disparity)
    builder.add_ball(joint(0, 0.92), height * np.array([0.05, 0.072, 0.058]), skin, axes)


def add_floating_ball(builder: SceneBuilder, disparity: float, scale: float) -> None:
    """A ball or an ellipsoid in the air."""
    radius = min(_size(builder, scale) / 2, 0.3 * builder.focal_px)
    radii = radius * (np.exp(builder.rng.uniform(-0.8, 0.3, 3)) if builder.rng.random() < 0.6 else np.ones(3))
    place = inside(builder, disparity, 2 * float(radii.max()))
    centre = builder.point(*place)
    builder.add_ball(centre, radii / place[2], builder.look(), builder.turned(centre, tilt=0.5))


def add_pole(builder: SceneBuilder, disparity: float, look: Look | None = None) -> None:
    """A straight pole or wire of 0.6 to 12 pixels' radius, upright or not, slanted in depth."""
    rng = builder.rng
    column, row, _ = inside(builder, disparity, 0)
    radius_px = float(np.exp(rng.uniform(np.log(0.6), np.log(12))))
    angle = np.pi / 2 + rng.normal(0, 0.08) if rng.random() < 0.5 else rng.uniform(0, np.pi)
    half = builder.height * rng.uniform(0.2, 0.9) * np.array([np.cos(angle), np.sin(angle)])
    near, far = disparity, disparity * float(np.exp(-abs(rng.normal(0, 0.2))))
    if rng.random() < 0.5:
        near, far = far, near
    ends = np.array([builder.point(column - half[0], row - half[1], far), builder.point(column + half[0], row + half[1], near)])
    builder.add_tube(ends, radius_px / disparity, look or builder.look(), disparity)


def add_wire(builder: SceneBuilder, disparity: float) -> None:
    """A bent tube through a few random points: cables, handles, pipes, frames."""
    rng = builder.rng
    column, row, _ = inside(builder, disparity, 0)
    size = builder.height * rng.uniform(0.1, 0.5)
    count = int(rng.integers(3, 6))
    offsets = np.cumsum(rng.normal(0, size / 2, (count, 2)), 0)
    depths = disparity * np.exp(-np.abs(rng.normal(0, 0.08, count)))
    points = np.array([builder.point(column + a, row + b, d) for (a, b), d in zip(offsets, depths, strict=True)])
    smooth = make_interp_spline(np.linspace(0, 1, count), points, k=min(3, count - 1))(np.linspace(0, 1, 7 * count))
    radius_px = float(np.exp(rng.uniform(np.log(0.6), np.log(7))))
    builder.add_tube(smooth, radius_px / disparity, builder.look(), disparity)
