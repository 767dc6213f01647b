"""Pictures and exact depth of the lit room, seen by any camera.

Two rows of cameras, an arc, and one carried by hand.

Several rays per pixel are averaged in linear light; depth is that of the ray through the pixel's
centre. World frame: units of 1 / `UNITS_PER_METRE` metres as a structure-from-motion tool would
give, x right, y down, z into the room.
"""

from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array, Array32
from ggvs_eval.camera import Camera
from ggvs_eval.contrib.worlds.room.lighting import Geometry, Instant
from ggvs_eval.contrib.worlds.room.shading import expose, radiance, read_finish
from ggvs_eval.kernels.portable import (
    arctan,
    cos,
    inverse,
    length,
    product,
    rotation_about,
    shrink,
    sin,
    transformed,
    unit,
)

UNITS_PER_METRE = 10.5
FOCAL_PER_WIDTH = 0.543
TOP_ROW_M, ROW_GAP = 1.5, 2.75
SPACING, OUTERMOST_YAW_RAD = 1.1, np.radians(34)
AIM_M = (0.0, 1.8, 1.12)
ARC_YAW_RAD, GRID_YAW_RAD = np.radians(38), np.radians(8)

# Room metres (x right, y into the room, z up) from world units, (4, 4).
WORLD_TO_ROOM: Array = np.array(
    [
        [1, 0, 0, 0],
        [0, 0, 1, 0],
        [0, -1, 0, TOP_ROW_M * UNITS_PER_METRE],
        [0, 0, 0, UNITS_PER_METRE],
    ]
)
WORLD_TO_ROOM = WORLD_TO_ROOM / UNITS_PER_METRE
# Half the extent of the motion along x, y and z, world units, and how often it swings per second.
REACH = np.array([4.0, 1.0, 0.7])
SWINGS_HZ = np.array([0.25, 0.37, 0.31])
AIM_SWAY, ROLL_RAD = 0.8, 0.03


def rig(
    seed: int,
    width: int,
    height: int,
    cameras_per_row: int,
    near: float = 1.0,
    far: float = 100.0,
    outermost_yaw_rad: float = OUTERMOST_YAW_RAD,
    spacing: float = 1.0,
) -> list[Camera]:
    """Return the cameras of both rows in the order of their names, ``cam00`` in the middle of the
    top row.

    Seen from behind, the top row reads n-1 .. n//2+1, 0, n//2 .. 1 and the bottom row 2n-1 .. n, as
    on the real rig.

    Args:
        seed: moves and turns every camera a little, as mounting by hand does.
        width: pixels.
        cameras_per_row: n, at least 2.
        near: depth range to note, world units.
        outermost_yaw_rad: how far the outermost camera is turned towards the middle.
        spacing: factor on the distances between cameras, in rows and between them; their circle
            stays.
    """
    rng, n = np.random.default_rng([seed, 1]), cameras_per_row
    top = [*range(n - 1, n // 2, -1), 0, *range(n // 2, 0, -1)]
    rows = [(0.0, top), (ROW_GAP, list(range(2 * n - 1, n - 1, -1)))]
    cameras = []
    for below, numbers in rows:
        along = np.cumsum(rng.uniform(0.92, 1.12, n)) * SPACING
        along -= along[top.index(0)]
        for number, distance in zip(numbers, along, strict=True):
            pose = _pose(
                distance * spacing,
                below * spacing,
                np.abs(along).max() / outermost_yaw_rad,
                rng,
                min(spacing, 1.0),
            )
            cameras.append(
                Camera(
                    name=f"cam{number:02d}",
                    K=intrinsics(width, height),
                    world_to_camera=pose,
                    width=width,
                    height=height,
                    near=near,
                    far=far,
                )
            )
    return sorted(cameras, key=lambda camera: camera.name)


def arc_rig(
    seed: int, width: int, height: int, count: int, near: float = 1.0, far: float = 100.0
) -> list[Camera]:
    """Return one row on a wide arc around what the cameras look at, ``cam00`` at its left end.

    Args:
        seed: as of `rig`.
        width: pixels.
        near: depth range to note, world units.
    """
    rng, radius = np.random.default_rng([seed, 8]), AIM_M[1] * UNITS_PER_METRE
    along = np.cumsum(rng.uniform(0.92, 1.12, count))
    along = (2 * (along - along[0]) / (along[-1] - along[0]) - 1) * ARC_YAW_RAD * radius
    poses = [_pose(distance, 0.0, radius, rng) for distance in along]
    K = intrinsics(width, height)
    return [
        Camera(
            name=f"cam{number:02d}",
            K=K,
            world_to_camera=pose,
            width=width,
            height=height,
            near=near,
            far=far,
        )
        for number, pose in enumerate(poses)
    ]


def intrinsics(width: int, height: int) -> Array:
    """K of every camera of the demo, pixels, (3, 3)."""
    return np.array(
        [
            [FOCAL_PER_WIDTH * width, 0, width / 2],
            [0, FOCAL_PER_WIDTH * width, height / 2],
            [0, 0, 1],
        ]
    )


def _pose(
    along: float, below: float, radius: float, rng: np.random.Generator, care: float = 1.0
) -> Array:
    """World to camera at an arc length from the middle of a row: on a circle, looking across its
    centre, slightly down.

    `care` scales how far the mounting is off, so that cameras close to one another stay in their
    row.
    """
    yaw = along / radius
    centre = (
        np.array([radius * sin(yaw), below, radius * (1 - cos(yaw))])
        + rng.normal(0, 0.05, 3) * care
    )
    drop_m = TOP_ROW_M - centre[1] / UNITS_PER_METRE - AIM_M[2]
    angles = np.array([-yaw, -arctan(drop_m / AIM_M[1]), 0.0]) + rng.normal(0, 0.012, 3)
    about_y, about_x, about_z = (
        rotation_about(angles[n], np.eye(3)[axis]) for n, axis in enumerate((1, 0, 2))
    )
    camera_to_world = product(about_y, product(about_x, about_z))
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3], world_to_camera[:3, 3] = (
        camera_to_world.T,
        transformed(-camera_to_world.T, centre),
    )
    return world_to_camera


def sideways_path(camera: Camera, length: float, count: int) -> list[Camera]:
    """Return the cameras of one orientation on a straight line through `camera` along its image
    rows, from left to right.

    Args:
        length: of the whole path, world units.
    """
    path = []
    for index, shift in enumerate(np.linspace(-length / 2, length / 2, count)):
        world_to_camera = camera.world_to_camera.copy()
        world_to_camera[0, 3] -= shift
        path.append(replace(camera, name=f"{index:04d}", world_to_camera=world_to_camera))
    return path


def in_metres(camera: Camera) -> Camera:
    """Return the same camera in a world whose unit is the metre; its axes and its origin stay."""
    world_to_camera = camera.world_to_camera.copy()
    world_to_camera[:3, 3] /= UNITS_PER_METRE
    return replace(
        camera,
        world_to_camera=world_to_camera,
        near=camera.near / UNITS_PER_METRE,
        far=camera.far / UNITS_PER_METRE,
    )


def eye_in_room(camera: Camera) -> Array32:
    """Centre of a camera in the room frame, metres, (3,)."""
    return room_from_world(camera.centre).astype(np.float32)


def rays_in_room(camera: Camera) -> Array32:
    """Return the rays of all pixels in the room frame whose length is one world unit of depth, (H *
    W, 3).
    """
    right, down, forward = product(camera.rotation, WORLD_TO_ROOM[:3, :3].T).astype(np.float32)
    x = ((np.arange(camera.width) + 0.5 - camera.K[0, 2]) / camera.K[0, 0]).astype(np.float32)
    y = ((np.arange(camera.height) + 0.5 - camera.K[1, 2]) / camera.K[1, 1]).astype(np.float32)
    rays = x[None, :, None] * right + (y[:, None, None] * down + forward)
    return rays.reshape(-1, 3)


def directions_in_room(camera: Camera, positions: Array) -> Array32:
    """Rays through positions on the plane of depth 1, camera frame, (N, 2), as `rays_in_room` gives
    those of pixels, (N, 3).
    """
    directions = transformed(
        camera.rotation.T, np.concatenate([positions, np.ones_like(positions[:, :1])], axis=1)
    )
    return np.asarray(transformed(WORLD_TO_ROOM[:3, :3], directions), np.float32)


def room_to_world(points_m: Array32) -> Array:
    """Return the points of the room, metres, in the world's units, (N, 3)."""
    return transformed(inverse(WORLD_TO_ROOM[:3, :3]), points_m - WORLD_TO_ROOM[:3, 3])


def room_from_world(points: Array) -> Array:
    """Return the points of the world in the room, metres, (N, 3)."""
    return transformed(WORLD_TO_ROOM[:3, :3], points) + WORLD_TO_ROOM[:3, 3]


def hand_held_poses(
    seed: int,
    width: int,
    height: int,
    count: int,
    fps: float,
    near: float = 1.0,
    far: float = 100.0,
    later_s: float = 0.0,
    sway: float = 1.0,
    spacing: float = 1.0,
) -> list[Camera]:
    """Return the poses along a smooth walk at up to 0.7 m/s between the two rows of the rig, called
    ``0``, ``1``, ...

    Args:
        width: pixels.
        fps: poses per second.
        near: depth range to note, world units.
        later_s: delay of every pose, seconds.
        sway: factor on how far the camera looks about.
        spacing: factor on how far it is carried.
    """
    phase = np.random.default_rng([seed, 8]).uniform(0, 2 * np.pi, (2, 3))
    aim = room_to_world(np.array(AIM_M, np.float32))
    poses = []
    for index in range(count):
        turn = 2 * np.pi * SWINGS_HZ * (index + later_s * fps) / fps
        centre = np.array([0.0, ROW_GAP / 2, 0.0]) + spacing * REACH * sin(turn + phase[0])
        target = aim + sway * AIM_SWAY * sin(0.7 * turn + phase[1])
        pose = _look_at(centre, target, ROLL_RAD * float(sin(turn[0] + phase[1, 0])))
        poses.append(
            Camera(
                name=str(index),
                K=intrinsics(width, height),
                world_to_camera=pose,
                width=width,
                height=height,
                near=near,
                far=far,
            )
        )
    return poses


def _look_at(centre: Array, target: Array, roll_rad: float) -> Array:
    """Return the transform of world to camera, (4, 4), from a centre towards a target.

    The world's y points down.
    """
    forward = unit(target - centre)
    right = unit(np.cross((0.0, 1.0, 0.0), forward))
    down = np.cross(forward, right)
    cosine, sine = cos(roll_rad), sin(roll_rad)
    pose = np.eye(4)
    pose[:3, :3] = [cosine * right + sine * down, cosine * down - sine * right, forward]
    pose[:3, 3] = transformed(-pose[:3, :3], centre)
    return pose


# Five are k1 k2 p1 p2 k3 of OpenCV's model, four k1 .. k4 of its fisheye; () is a pinhole.
Coefficients = tuple[float, ...]
FISHEYE_COEFFICIENTS = 4
NEWTON_STEPS = 20
EXACT = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-12)


class PixelGrid:
    """The pixels of one camera.

    Args:
        camera: its K holds for the distorted picture and for the undistorted one alike.

    Attributes:
        camera: as given.
        rays: of all pixels in the room frame, of a length that has one world unit of depth, (H * W,
            3).
    """

    def __init__(self, camera: Camera, lens: Coefficients = ()) -> None:
        self.camera = camera
        self._corner, self._size = np.zeros(2, int), np.array(camera.size)
        self._cell: NDArray[np.int64] | None = None
        if not lens:
            self.rays: Array32 = rays_in_room(camera)
            return
        normalised = undistorted_positions(camera, lens)
        self.rays = directions_in_room(camera, normalised)
        position = np.floor(normalised * camera.K[[0, 1], [0, 1]] + camera.K[:2, 2]).astype(int)
        self._corner = position.min(axis=0)
        self._size = position.max(axis=0) + 1 - self._corner
        column, row = (position - self._corner).T
        self._cell = row * self._size[0] + column

    def showing(self, geometry: Geometry) -> NDArray[np.int64]:
        """Return the indices of all pixels that may show the geometry: those inside the frame
        around each of its surfaces.
        """
        uv, depth = self.camera.project(room_to_world(geometry.vertices))
        if depth.min() <= 0:
            return np.arange(len(self.rays))
        # Frames are drawn on the picture of a pinhole that holds every pixel's ray, and looked up
        # there.
        mask = np.zeros(self._size[::-1], bool)
        low, high = (
            function.reduceat(uv, geometry.first_vertex) for function in (np.minimum, np.maximum)
        )
        first, last = (
            np.floor(low).astype(int) - self._corner,
            np.ceil(high).astype(int) - self._corner,
        )
        for (left, top), (right, bottom) in zip(first, last, strict=True):
            mask[max(top, 0) : max(bottom, 0), max(left, 0) : max(right, 0)] = True
        return np.flatnonzero(mask if self._cell is None else mask.ravel()[self._cell])


def undistorted_positions(camera: Camera, lens: Coefficients) -> Array:
    """Return the points where the rays of all distorted pixels meet the plane of depth 1, camera
    frame, (H * W, 2).
    """
    if len(lens) == FISHEYE_COEFFICIENTS:
        return _fisheye_positions(camera, lens)
    uv = camera.pixel_centres().reshape(-1, 1, 2)
    positions = cv2.undistortPoints(uv, camera.K, np.array(lens), criteria=EXACT)
    return np.asarray(positions, np.float64).reshape(-1, 2)


def _fisheye_positions(camera: Camera, lens: Coefficients) -> Array:
    """Return the same for a fisheye: by Newton, the angle theta whose theta (1 + k1 theta^2 + ...)
    is the pixel's radius.
    """
    distorted = (camera.pixel_centres().reshape(-1, 2) - camera.K[:2, 2]) / camera.K[[0, 1], [0, 1]]
    radius = length(distorted)
    factors = (1.0, *lens)
    slopes = tuple((2 * order + 1) * factor for order, factor in enumerate(factors))
    theta = radius.copy()
    for _ in range(NEWTON_STEPS):
        square = theta * theta
        theta -= (theta * _polynomial(factors, square) - radius) / _polynomial(slopes, square)
    return distorted * (sin(theta) / (cos(theta) * np.where(radius == 0, 1.0, radius)))[:, None]


def _polynomial(factors: tuple[float, ...], values: Array) -> Array:
    """Return the polynomial with these factors, the constant first (Horner)."""
    total = np.zeros_like(values)
    for factor in reversed(factors):
        total = total * values + factor
    return total


class Picture(NamedTuple):
    """Image, foreground and depth of one instant, as a camera sees it.

    Attributes:
        image: as the lens shows it, sRGB in [0, 1], (H, W, 3).
        foreground: share of each pixel of the image that moving things cover, [0, 1], (H, W).
        depth: world units, 0 if nothing is, (H, W); of the camera without its lens, so that it fits
            the undistorted image.
    """

    image: Array32
    foreground: Array32
    depth: Array32


def render_depth(instant: Instant, camera: Camera) -> Array32:
    """Return the depth at the pixel centres of any camera, world units, 0 if nothing is, (H, W)."""
    grid, eye = PixelGrid(camera), eye_in_room(camera)
    return _with_moving(instant.moving, grid, eye, depth_along(instant.static, eye, grid.rays))


class View:
    """A camera before the static part of a room, at which it looks only once.

    Args:
        supersampling: rays per pixel along each side.
    """

    def __init__(
        self, static: Geometry, camera: Camera, supersampling: int = 2, lens: Coefficients = ()
    ) -> None:
        self.camera = camera
        self._eye = eye_in_room(camera)
        self._fine = PixelGrid(
            camera.resized(camera.width * supersampling, camera.height * supersampling), lens
        )
        self._grid = PixelGrid(camera)
        self._pixel_m = 1 / (self._fine.camera.focal_px * UNITS_PER_METRE)
        self._depth = depth_along(static, self._eye, self._grid.rays)
        self._hits = static.cast(self._eye, self._fine.rays)
        self._finish = read_finish(static, self._hits, self._pixel_m)
        self._fine_depth = np.full(len(self._fine.rays), np.inf, np.float32)
        self._fine_depth[self._hits.ray] = self._hits.distance
        self._light = np.full_like(static.vertices, np.nan)
        self._radiance = np.zeros_like(self._fine.rays)

    def render(self, instant: Instant) -> Picture:
        """Render the camera's view of the same room at an instant."""
        linear, covered = self.light(instant)
        return Picture(expose(linear), covered, self.depth(instant))

    def light(self, instant: Instant) -> tuple[Array32, Array32]:
        """Return the linear light in every pixel, (H, W, 3), and the share of it that moving things
        cover, (H, W).
        """
        self._update_static(instant)
        linear = self._radiance.copy()
        covered = np.zeros(len(linear), np.float32)
        if instant.moving is not None:
            covered[self._draw_moving(instant, instant.moving, linear)] = 1.0
        return self._averaged(linear), self._averaged(covered)

    def depth(self, instant: Instant) -> Array32:
        """Return the depth of the same room at an instant, world units, 0 if nothing is, (H, W)."""
        return _with_moving(instant.moving, self._grid, self._eye, self._depth)

    def _averaged(self, fine: Array32) -> Array32:
        """Return the mean over the rays of each pixel, (H, W, ...)."""
        image = fine.reshape(self._fine.camera.height, self._fine.camera.width, *fine.shape[1:])
        return shrink(image, self.camera.height, self.camera.width)

    def _update_static(self, instant: Instant) -> None:
        """Shade those static samples again whose light is another than at the last call."""
        changed = (instant.static_light != self._light).any(axis=1)
        rows = np.flatnonzero(changed[instant.static.faces].any(axis=1)[self._hits.face])
        hits = self._hits.rows(rows)
        light = radiance(
            instant.static,
            hits,
            self._finish.rows(rows),
            instant.static_light,
            instant.highlights,
            self._fine.rays[hits.ray],
        )
        self._radiance[hits.ray] = light
        self._light = instant.static_light

    def _draw_moving(
        self, instant: Instant, moving: Geometry, linear: Array32
    ) -> NDArray[np.int64]:
        """Paint moving things over the light of the static ones wherever they are nearer.

        Gives the rays that show them.
        """
        inside = self._fine.showing(moving)
        hits = moving.cast(self._eye, self._fine.rays[inside])
        hits = hits.rows(np.flatnonzero(hits.distance < self._fine_depth[inside[hits.ray]]))
        rays = inside[hits.ray]
        if len(rays):
            finish = read_finish(moving, hits, self._pixel_m)
            linear[rays] = radiance(
                moving,
                hits,
                finish,
                instant.moving_light,
                instant.highlights,
                self._fine.rays[rays],
            )
        return rays


def depth_along(geometry: Geometry, eye: Array32, rays: Array32) -> Array32:
    """Return the depth along rays of unit depth, infinite where they hit nothing, (N,)."""
    depth = np.full(len(rays), np.inf, np.float32)
    hits = geometry.cast(eye, rays)
    depth[hits.ray] = hits.distance
    return depth


def _with_moving(
    moving: Geometry | None, grid: PixelGrid, eye: Array32, static_depth: Array32
) -> Array32:
    """Return the depth (H, W) of static things along all pixels, (N,), and of what moves before
    them.
    """
    depth = static_depth.copy()
    if moving is not None:
        inside = grid.showing(moving)
        depth[inside] = np.minimum(depth[inside], depth_along(moving, eye, grid.rays[inside]))
    depth[np.isinf(depth)] = 0.0
    return depth.reshape(grid.camera.height, grid.camera.width)
