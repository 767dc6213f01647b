"""Rectified pairs with exact disparity, of the procedural room and garden, for stereo networks to
learn from.
"""

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import cv2
import numpy as np

from ggvs_eval.arrays import Array, Array32, Image8, Map, Mask
from ggvs_eval.contrib.worlds.film.shots import Sensor
from ggvs_eval.contrib.worlds.room import furniture, garden, textures
from ggvs_eval.contrib.worlds.room.figure import random_figure
from ggvs_eval.contrib.worlds.room.garden import build_garden
from ggvs_eval.contrib.worlds.room.lighting import Geometry, Instant, LitRoom
from ggvs_eval.contrib.worlds.room.room import Room, build_room
from ggvs_eval.contrib.worlds.room.shading import expose, radiance, read_finish
from ggvs_eval.contrib.worlds.room.surfaces import (
    Material,
    Surface,
    ellipsoid,
    moved,
    panel,
    rod,
    rotation,
    translation,
)
from ggvs_eval.errors import DepthError
from ggvs_eval.files.images import quantise
from ggvs_eval.kernels.portable import cos, exp, power, product, sin, transformed, unit

# rooms of pairs have seeds from here on; those of demos, of validation and of views to train on are
# below
FIRST_SEED = 2**20
GARDENS = 0.35  # share of the scenes
# Where things are strewn: lowest and highest corner, metres.
STREWN_M = np.array([(-1.5, 0.1, 0.1), (1.5, 2.2, 2.0)])
SKIN_M = 0.6  # side of a skin's pattern before it is scaled
SKINS = 96


def build_scene(number: int) -> Instant:
    """Lay a scene out and light it, which takes seconds.

    Equal numbers give equal scenes, all of whose surfaces are static.
    """
    rng = np.random.default_rng([number, 91])
    build = build_garden if rng.random() < GARDENS else build_room
    room = build(FIRST_SEED + number)
    parts = [*room.static, *room.at(float(rng.uniform(0, 10)))]
    for _ in range(int(rng.integers(8, 40))):
        parts += _strewn(rng)
    return LitRoom(Room(parts, room.lights, [])).empty()


def repainted(geometry: Geometry, rng: np.random.Generator, share: float) -> list[Material]:
    """Return the materials of a geometry, a share of those that do not shine replaced by skins."""
    bank = skins()
    return [
        bank[int(rng.integers(len(bank)))]
        if not material.emission and rng.random() < share
        else material
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
        bank.append(
            Material(
                texture=texture, tile_m=size, specular=gloss, shininess=float(rng.uniform(15, 80))
            )
        )
    return bank


def _any_colour(rng: np.random.Generator) -> textures.Colour:
    red, green, blue = np.clip(rng.uniform(0.1, 0.85) + rng.normal(0, 0.12, 3), 0.03, 0.95)
    return float(red), float(green), float(blue)


_SIZE = (SKIN_M, SKIN_M)
_PATTERNS: tuple[Callable[[np.random.Generator], textures.Image8], ...] = (
    lambda rng: textures.picture(textures.PICTURES[int(rng.integers(len(textures.PICTURES)))]),
    lambda rng: textures.wallpaper(rng, _SIZE, _any_colour(rng), _any_colour(rng)),
    lambda rng: textures.mottled(
        rng, _any_colour(rng), float(rng.uniform(0.1, 0.5)), float(rng.uniform(0.01, 0.1))
    ),
    lambda rng: textures.bricks(rng, _SIZE, _any_colour(rng), _any_colour(rng)),
    lambda rng: textures.plain(_any_colour(rng)),
    lambda rng: textures.fabric(
        rng,
        _SIZE,
        _any_colour(rng),
        _any_colour(rng),
        str(rng.choice(("stripes", "check", "plain"))),
    ),
    lambda rng: textures.wood(rng, _SIZE, _any_colour(rng)),
    lambda rng: textures.rug(rng, _SIZE, [_any_colour(rng) for _ in range(3)]),
    lambda rng: textures.plaster(rng, _SIZE, _any_colour(rng)),
    lambda rng: textures.bands(
        rng, _SIZE, [_any_colour(rng) for _ in range(9)], np.sort(rng.uniform(0, 1, 8)).tolist()
    ),
    lambda rng: textures.mottled(
        rng, _any_colour(rng), float(rng.uniform(0.02, 0.1)), float(rng.uniform(0.02, 0.1))
    ),
    lambda rng: textures.boards(rng, _SIZE, _any_colour(rng), float(rng.uniform(0.02, 0.1))),
)


def _strewn(rng: np.random.Generator) -> list[Surface]:
    thing = _THINGS[int(rng.integers(len(_THINGS)))](rng)
    axis = rng.standard_normal(3)
    upright = rng.random() < 0.4
    turn = rotation(float(rng.uniform(0, 2 * np.pi)), (0, 0, 1) if upright else axis)
    size = 0.4 * float(power(5.0, rng.uniform()))
    return moved(
        thing,
        product(
            translation(*rng.uniform(*STREWN_M)), product(turn, np.diag([size, size, size, 1]))
        ),
    )


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
    return [
        front,
        *moved(
            [replace(front, material=_skin(rng))],
            product(rotation(np.pi, (0, 0, 1)), translation(0, -0.004, 0)),
        ),
    ]


def _ball(rng: np.random.Generator) -> list[Surface]:
    return [ellipsoid(rng.uniform(0.05, 0.25, 3), _skin(rng))]


def _chair(rng: np.random.Generator) -> list[Surface]:
    return moved(
        furniture.chair(_skin(rng), _skin(rng), int(rng.integers(4, 8))), translation(0, 0, -0.5)
    )


def _potted(rng: np.random.Generator) -> list[Surface]:
    return furniture.plant(
        rng, _skin(rng), (0.3, 0.45, 0.2), int(rng.integers(8, 20)), float(rng.uniform(0.6, 1.2))
    )


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
    lambda rng: garden.SHAPES[int(rng.integers(len(garden.SHAPES)))](
        rng, (0.0, 0.0), float(rng.uniform(0.5, 1.2))
    ),
    lambda rng: random_figure(rng, (0.0, 0.0)).surfaces(float(rng.uniform(0, 10))),
)


PAIRS_PER_SCENE, SCENES_AT_A_TIME = 64, 4
LARGEST_SHARE = 0.42  # of the width: no disparity is larger
NEAREST_M, FARTHEST_M = 0.25, 60.0
ATTEMPTS = 200
ROW_ERROR_PX = 0.3
# bend of inverse depth, as a share of it, from which a pixel is averaged over several rays
EDGE = 0.02


@dataclass(frozen=True, eq=False)
class StereoSample:
    """A rectified pair and its truth.

    The point at column x on the left is at x - disparity on the right.

    Attributes:
        left: RGB uint8 (H, W, 3).
        right: RGB uint8 (H, W, 3).
        disparity: of the left image's surfaces, also where the right eye does not see them; pixels,
            float32 (H, W), > 0.
        visible: the match is within the right image and nothing hides it, bool (H, W).
    """

    left: Image8
    right: Image8
    disparity: Map
    visible: Mask


@dataclass(frozen=True, eq=False)
class StereoRig:
    """Two pinhole cameras side by side.

    Attributes:
        eye: of the left camera, room frame, metres, (3,).
        axes: rows are right, down and forward of both cameras, room frame, (3, 3).
        centre: principal point, x and y, pixels.
        baseline_m: from the left eye to the right one, along the first axis.
        size: width and height, pixels.
    """

    eye: Array
    axes: Array
    focal_px: float
    centre: tuple[float, float]
    baseline_m: float
    size: tuple[int, int]

    @property
    def right_eye(self) -> Array:
        """Of the right camera, room frame, metres, (3,)."""
        return self.eye + self.baseline_m * self.axes[0]

    def rays(self, x: Array, y: Array) -> Array32:
        """Return the rays through image positions, pixel centres at halves, (...,) each.

        Of unit depth, room frame, (N, 3).
        """
        across, down = (x - self.centre[0]) / self.focal_px, (y - self.centre[1]) / self.focal_px
        directions = (
            across[..., None] * self.axes[0] + down[..., None] * self.axes[1] + self.axes[2]
        )
        return directions.reshape(-1, 3).astype(np.float32)

    def positions(self, step: int = 1) -> tuple[Array, Array]:
        """Return the pixel centres, every N pixels, x and y, (H, W) each."""
        y, x = np.mgrid[step // 2 : self.size[1] : step, step // 2 : self.size[0] : step] + 0.5
        return x, y

    def depth(self, geometry: Geometry, step: int = 1) -> Map:
        """Return the depth of the left picture, metres, `FARTHEST_M` where nothing is, (H, W), or
        of every N pixels.
        """
        x, y = self.positions(step)
        depth = np.full(x.size, FARTHEST_M, np.float32)
        hits = geometry.cast(self.eye.astype(np.float32), self.rays(x, y))
        depth[hits.ray] = hits.distance
        return depth.reshape(x.shape)


def stereo_sample(seed: int, width: int, height: int, sensor: bool = True) -> StereoSample:
    """Take one pair; equal arguments give equal bits.

    Neighbouring seeds share scenes, which take seconds to light; cameras, paint, light and sensors
    are each pair's own.

    Args:
        seed: chooses the scene and the cameras, >= 0.
        width: of the pictures, pixels, at least 64.
        height: of the pictures, pixels, at least 48.
        sensor: whether two different cameras take the pictures, their rows not quite agreeing;
            without, they are only rounded.
    """
    if width < 64 or height < 48 or seed < 0:
        raise DepthError(
            f"a stereo sample needs at least 64 x 48 pixels and a seed >= 0, not {width} x "
            f"{height}, seed {seed}"
        )
    rng = np.random.default_rng([seed, 93])
    scene = _painted(scene_of(seed), rng)
    rig, depth = place_rig(scene, rng, width, height)
    visible = find_visible(scene.static, rig, depth)
    x, y = rig.positions()
    row_error = _row_error(rng, rig) if sensor else 0.0
    pictures = [
        render(scene, rig, eye, x, rows)
        for eye, rows in ((rig.eye, y), (rig.right_eye, y + row_error))
    ]
    left, right = expose_pair(pictures, rng, sensor)
    return StereoSample(
        left=left,
        right=right,
        disparity=(rig.focal_px * rig.baseline_m / depth).astype(np.float32),
        visible=visible,
    )


def scene_of(seed: int) -> Instant:
    """Return the scene that the pair of a seed is taken of."""
    return _kept_scene(scene_number(seed))


def scene_number(seed: int) -> int:
    """Return the scene of a seed: neighbouring seeds alternate among a few scenes until each has
    given its pairs.
    """
    turn, lane = divmod(seed, SCENES_AT_A_TIME)
    return turn // PAIRS_PER_SCENE * SCENES_AT_A_TIME + lane


_kept_scene = lru_cache(maxsize=SCENES_AT_A_TIME)(build_scene)


def _painted(scene: Instant, rng: np.random.Generator) -> Instant:
    """Return the scene with other paint, and one more lamp whose light falls without shadows."""
    geometry = copy(scene.static)  # shares vertices and the tree of rays
    geometry.materials = repainted(geometry, rng, float(rng.choice([0.0, 0.5, 1.0])))
    towards = unit(rng.standard_normal(3)).astype(np.float32)
    cosine = transformed(towards[None], geometry.normals)[:, 0]
    tint = exp(rng.normal(0, 0.1, 3))
    strength = float(rng.uniform(0, 1)) * float(np.median(scene.static_light))
    light = (scene.static_light * tint + strength * np.maximum(cosine, 0)[:, None]).astype(
        np.float32
    )
    return replace(scene, static=geometry, static_light=light)


def place_rig(
    scene: Instant, rng: np.random.Generator, width: int, height: int
) -> tuple[StereoRig, Map]:
    """Choose the cameras' places so that near things have a disparity drawn from a wide range.

    Nothing in the left picture is closer than `NEAREST_M`, nothing is between the cameras.

    Returns:
        The cameras, and the depth of the left one, metres, (H, W).
    """
    most_px = LARGEST_SHARE * width
    near_px = 6 * float(power(0.7 * most_px / 6, rng.uniform()))
    for _ in range(ATTEMPTS):
        focal = float(rng.uniform(0.7, 1.6)) * width
        centre = (
            width / 2 + rng.normal(0, 0.03) * width,
            height / 2 + rng.normal(0, 0.05) * height,
        )
        rig = StereoRig(*_pose(rng), focal, centre, 0.0, (width, height))
        coarse = rig.depth(scene.static, step=8)
        near_m = float(np.percentile(coarse, 10))
        if coarse.min() < NEAREST_M or np.median(coarse) < 1.15 * near_m:
            continue
        depth = rig.depth(scene.static)
        baseline_m = min(near_px * near_m, most_px * float(depth.min())) / focal
        reach = (1.5 * baseline_m * rig.axes[:1]).astype(np.float32)
        if (
            depth.min() >= NEAREST_M
            and not scene.static.blocks(rig.eye.astype(np.float32), reach)[0]
        ):
            return replace(rig, baseline_m=baseline_m), depth
    raise DepthError(
        f"stereo sample: no place for two cameras of {width} x {height} pixels after {ATTEMPTS} "
        f"attempts"
    )


def _pose(rng: np.random.Generator) -> tuple[Array, Array]:
    """Eye and axes of a camera that looks at the middle of the scene or past it."""
    eye = rng.uniform((-1.6, -1.2, 0.4), (1.6, 1.0, 2.1))
    aim = rng.uniform((-1.2, 1.2, 0.4), (1.2, 3.0, 1.7))
    forward = unit(aim - eye)
    right = unit(np.cross(forward, np.array([0.0, 0.0, 1.0])))
    down = np.cross(forward, right)
    roll_rad = float(rng.normal(0, 0.1))
    cosine, sine = cos(roll_rad), sin(roll_rad)
    right, down = cosine * right + sine * down, cosine * down - sine * right
    return eye, np.stack([right, down, forward])


def find_visible(geometry: Geometry, rig: StereoRig, depth: Map) -> Mask:
    """Return the mask of the points of the left picture that are within the right one and are not
    hidden from its eye, (H, W).

    What is within the last hundredth of the way to a point does not hide it, so that no surface
    hides itself.
    """
    x, y = rig.positions()
    towards = (
        depth.reshape(-1, 1) * rig.rays(x, y).astype(np.float64) - rig.baseline_m * rig.axes[0]
    )
    hidden = geometry.blocks(rig.right_eye.astype(np.float32), towards.astype(np.float32))
    within = x - rig.focal_px * rig.baseline_m / depth >= 0.5
    return within & ~hidden.reshape(x.shape)


def _row_error(rng: np.random.Generator, rig: StereoRig) -> Array:
    """Draw the vertical misalignment of the right picture: shift, turn, stretch and bend by
    fractions of a pixel, (H, W).
    """
    height, width = rig.size[::-1]
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    shift, turn, stretch, bend = rng.normal(0, ROW_ERROR_PX, 4) * (1, 0.5, 0.4, 0.4)
    return np.asarray(shift + turn * x + stretch * y + bend * x * x)


def render(scene: Instant, rig: StereoRig, eye: Array, x: Array, y: Array) -> Array32:
    """Return the linear light at image positions, (H, W, 3): one ray each, four where
    surfaces end.
    """
    light, depth = _shaded(scene, rig, eye, x, y)
    edges = _edges(depth.reshape(x.shape))
    rows = np.flatnonzero(edges)
    if len(rows):
        offsets = np.array([(-0.375, -0.125), (0.125, -0.375), (0.375, 0.125), (-0.125, 0.375)])
        around = [
            _shaded(scene, rig, eye, x.ravel()[rows] + dx, y.ravel()[rows] + dy)[0]
            for dx, dy in offsets
        ]
        light[rows] = np.mean(around, axis=0)
    return light.reshape(*x.shape, 3)


def _edges(depth: Map) -> Mask:
    """Return the pixels at which inverse depth bends, (H, W)."""
    inverse = 1 / cv2.copyMakeBorder(depth, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    middle = inverse[1:-1, 1:-1]
    across = np.abs(inverse[1:-1, :-2] - 2 * middle + inverse[1:-1, 2:])
    down = np.abs(inverse[:-2, 1:-1] - 2 * middle + inverse[2:, 1:-1])
    return np.asarray(np.maximum(across, down) > EDGE * middle)


def _shaded(
    scene: Instant, rig: StereoRig, eye: Array, x: Array, y: Array
) -> tuple[Array32, Array32]:
    """Return the linear light, (N, 3), and depth, (N,), along the rays through image positions."""
    rays, geometry = rig.rays(x, y), scene.static
    hits = geometry.cast(eye.astype(np.float32), rays)
    finish = read_finish(geometry, hits, 1 / rig.focal_px)
    light, depth = np.zeros_like(rays), np.full(len(rays), FARTHEST_M, np.float32)
    light[hits.ray] = radiance(
        geometry, hits, finish, scene.static_light, scene.highlights, rays[hits.ray]
    )
    depth[hits.ray] = hits.distance
    return light, depth


def expose_pair(
    pictures: list[Array32], rng: np.random.Generator, sensor: bool
) -> tuple[Image8, Image8]:
    """Return two pictures as two cameras take them that share a style but not their settings."""
    exposure = 0.35 * float(exp(rng.normal(0, 0.45))) / max(float(np.median(pictures[0])), 1e-3)
    left, right = (expose(exposure * light) for light in pictures)
    if not sensor:
        return quantise(left), quantise(right)
    largest = 1.65 if rng.random() < 0.125 else 1.25
    noise, blur = (
        float(rng.uniform(0, 5) * rng.uniform(0.2, 1)),
        float(rng.choice([0.0, rng.uniform(0, 1.2)])),
    )
    processing = float(rng.choice([0.0, 0.0, rng.uniform(0.2, 1)]))
    jpeg = int(rng.choice([0, 0, int(rng.integers(70, 98))]))
    pictures_taken = []
    for image in (left, right):
        gain = (power(largest, 0.6 * rng.uniform(-1, 1)) * exp(rng.normal(0, 0.025, 3))).astype(
            np.float32
        )
        numbers = tuple(int(number) for number in rng.integers(0, 2**31, 2))
        defocus = max(0.0, blur * float(rng.uniform(0.6, 1.3)) - 0.2)
        camera = Sensor(
            gain=gain,
            noise_sigma_255=noise * float(rng.uniform(0.8, 1.2)),
            seed=numbers,
            defocus_px=defocus,
            processing=processing,
            jpeg_quality=jpeg,
        )
        pictures_taken.append(camera.expose(image, camera.noise(0)))
    return pictures_taken[0], pictures_taken[1]
