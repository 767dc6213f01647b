"""Pictures and exact depth of the lit room, seen by any camera.

Several rays per pixel are averaged in linear light; depth is that of the ray through the pixel's centre.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array, Array32
from ggvs_eval.camera import Camera
from ggvs_eval.contrib.worlds.film.rig import UNITS_PER_METRE, directions_in_room, eye_in_room, rays_in_room, room_to_world
from ggvs_eval.contrib.worlds.room.geometry import Geometry
from ggvs_eval.contrib.worlds.room.lighting import Instant
from ggvs_eval.contrib.worlds.room.shading import expose, radiance, read_finish
from ggvs_eval.kernels.portable import cos, length, shrink, sin

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
        rays: of all pixels in the room frame, of a length that has one world unit of depth, (H * W, 3).
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
        """Indices of all pixels that may show the geometry: those inside the frame around each of its surfaces."""
        uv, depth = self.camera.project(room_to_world(geometry.vertices))
        if depth.min() <= 0:
            return np.arange(len(self.rays))
        # Frames are drawn on the picture of a pinhole that holds every pixel's ray, and looked up there.
        mask = np.zeros(self._size[::-1], bool)
        low, high = (function.reduceat(uv, geometry.first_vertex) for function in (np.minimum, np.maximum))
        first, last = np.floor(low).astype(int) - self._corner, np.ceil(high).astype(int) - self._corner
        for (left, top), (right, bottom) in zip(first, last, strict=True):
            mask[max(top, 0) : max(bottom, 0), max(left, 0) : max(right, 0)] = True
        return np.flatnonzero(mask if self._cell is None else mask.ravel()[self._cell])


def undistorted_positions(camera: Camera, lens: Coefficients) -> Array:
    """Return the points where the rays of all distorted pixels meet the plane of depth 1, camera frame, (H * W, 2)."""
    if len(lens) == FISHEYE_COEFFICIENTS:
        return _fisheye_positions(camera, lens)
    uv = camera.pixel_centres().reshape(-1, 1, 2)
    positions = cv2.undistortPoints(uv, camera.K, np.array(lens), criteria=EXACT)
    return np.asarray(positions, np.float64).reshape(-1, 2)


def _fisheye_positions(camera: Camera, lens: Coefficients) -> Array:
    """The same for a fisheye: by Newton, the angle theta whose theta (1 + k1 theta^2 + ...) is the pixel's radius."""
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
    """The polynomial with these factors, the constant first (Horner)."""
    total = np.zeros_like(values)
    for factor in reversed(factors):
        total = total * values + factor
    return total


class Picture(NamedTuple):
    """Image, foreground and depth of one instant, as a camera sees it.

    Attributes:
        image: as the lens shows it, sRGB in [0, 1], (H, W, 3).
        foreground: share of each pixel of the image that moving things cover, [0, 1], (H, W).
        depth: world units, 0 where nothing is, (H, W); of the camera without its lens, so that it fits the undistorted image.
    """

    image: Array32
    foreground: Array32
    depth: Array32


def render_depth(instant: Instant, camera: Camera) -> Array32:
    """Depth at the pixel centres of any camera, world units, 0 where nothing is, (H, W)."""
    grid, eye = PixelGrid(camera), eye_in_room(camera)
    return _with_moving(instant.moving, grid, eye, depth_along(instant.static, eye, grid.rays))


class View:
    """A camera before the static part of a room, at which it looks only once.

    Args:
        supersampling: rays per pixel along each side.
    """

    def __init__(self, static: Geometry, camera: Camera, supersampling: int = 2, lens: Coefficients = ()) -> None:
        self.camera = camera
        self._eye = eye_in_room(camera)
        self._fine = PixelGrid(camera.resized(camera.width * supersampling, camera.height * supersampling), lens)
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
        """Linear light in every pixel, (H, W, 3), and the share of it that moving things cover, (H, W)."""
        self._update_static(instant)
        linear = self._radiance.copy()
        covered = np.zeros(len(linear), np.float32)
        if instant.moving is not None:
            covered[self._draw_moving(instant, instant.moving, linear)] = 1.0
        return self._averaged(linear), self._averaged(covered)

    def depth(self, instant: Instant) -> Array32:
        """Depth of the same room at an instant, world units, 0 where nothing is, (H, W)."""
        return _with_moving(instant.moving, self._grid, self._eye, self._depth)

    def _averaged(self, fine: Array32) -> Array32:
        """Mean over the rays of each pixel, (H, W, ...)."""
        image = fine.reshape(self._fine.camera.height, self._fine.camera.width, *fine.shape[1:])
        return shrink(image, self.camera.height, self.camera.width)

    def _update_static(self, instant: Instant) -> None:
        """Shade those static samples again whose light is another than at the last call."""
        changed = (instant.static_light != self._light).any(axis=1)
        rows = np.flatnonzero(changed[instant.static.faces].any(axis=1)[self._hits.face])
        hits = self._hits.rows(rows)
        light = radiance(
            instant.static, hits, self._finish.rows(rows), instant.static_light, instant.highlights, self._fine.rays[hits.ray]
        )
        self._radiance[hits.ray] = light
        self._light = instant.static_light

    def _draw_moving(self, instant: Instant, moving: Geometry, linear: Array32) -> NDArray[np.int64]:
        """Paint moving things over the light of the static ones wherever they are nearer; gives the rays that show them."""
        inside = self._fine.showing(moving)
        hits = moving.cast(self._eye, self._fine.rays[inside])
        hits = hits.rows(np.flatnonzero(hits.distance < self._fine_depth[inside[hits.ray]]))
        rays = inside[hits.ray]
        if len(rays):
            finish = read_finish(moving, hits, self._pixel_m)
            linear[rays] = radiance(moving, hits, finish, instant.moving_light, instant.highlights, self._fine.rays[rays])
        return rays


def depth_along(geometry: Geometry, eye: Array32, rays: Array32) -> Array32:
    """Depth along rays of unit depth, infinite where they hit nothing, (N,)."""
    depth = np.full(len(rays), np.inf, np.float32)
    hits = geometry.cast(eye, rays)
    depth[hits.ray] = hits.distance
    return depth


def _with_moving(moving: Geometry | None, grid: PixelGrid, eye: Array32, static_depth: Array32) -> Array32:
    """Depth (H, W) of static things along all pixels, (N,), and of what moves before them."""
    depth = static_depth.copy()
    if moving is not None:
        inside = grid.showing(moving)
        depth[inside] = np.minimum(depth[inside], depth_along(moving, eye, grid.rays[inside]))
    depth[np.isinf(depth)] = 0.0
    return depth.reshape(grid.camera.height, grid.camera.width)
