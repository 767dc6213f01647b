"""Pictures and exact depth of the lit room, seen by any camera.

Several rays per pixel are averaged in linear light; depth is that of the ray through the pixel's centre.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.camera import Camera
from ggvs_eval.synthetic.geometry import Array32, Geometry
from ggvs_eval.synthetic.lighting import Instant
from ggvs_eval.synthetic.rig import UNITS_PER_METRE, eye_in_room, rays_in_room, room_to_world
from ggvs_eval.synthetic.shading import expose, radiance, read_finish


def render_view(instant: Instant, camera: Camera, supersampling: int = 2) -> tuple[Array32, Array32]:
    """Render one picture.

    Args:
        instant: the lit room.
        camera: any camera in the world of the demo.
        supersampling: rays per pixel along each side.

    Returns:
        Image, sRGB in [0, 1], (H, W, 3), and depth, world units, 0 where nothing is, (H, W).
    """
    return View(instant.static, camera, supersampling).render(instant)


class View:
    """A camera before the static part of a room, at which it looks only once.

    Args:
        static: what never moves.
        camera: where to look from.
        supersampling: rays per pixel along each side.
    """

    def __init__(self, static: Geometry, camera: Camera, supersampling: int = 2) -> None:
        self.camera = camera
        self._eye = eye_in_room(camera)
        self._fine = camera.resized(camera.width * supersampling, camera.height * supersampling)
        self._fine_rays, self._rays = rays_in_room(self._fine), rays_in_room(camera)
        self._pixel_m = 1 / (self._fine.focal_px * UNITS_PER_METRE)
        self._depth = depth_along(static, self._eye, self._rays)
        self._hits = static.cast(self._eye, self._fine_rays)
        self._finish = read_finish(static, self._hits, self._pixel_m)
        self._fine_depth = np.full(len(self._fine_rays), np.inf, np.float32)
        self._fine_depth[self._hits.ray] = self._hits.distance
        self._light = np.full_like(static.vertices, np.nan)
        self._radiance = np.zeros_like(self._fine_rays)

    def render(self, instant: Instant) -> tuple[Array32, Array32]:
        """Image (H, W, 3), sRGB in [0, 1], and depth (H, W), world units, of the same room at an instant."""
        self._update_static(instant)
        linear = self._radiance.copy()
        self._draw_moving(instant, linear)
        fine = linear.reshape(self._fine.height, self._fine.width, 3)
        averaged = np.asarray(cv2.resize(fine, self.camera.size, interpolation=cv2.INTER_AREA), np.float32)
        depth, inside = self._depth.copy(), covered_pixels(instant.moving, self.camera)
        depth[inside] = np.minimum(depth[inside], depth_along(instant.moving, self._eye, self._rays[inside]))
        depth[np.isinf(depth)] = 0.0
        return expose(averaged), depth.reshape(self.camera.height, self.camera.width)

    def _update_static(self, instant: Instant) -> None:
        """Shade those static samples again whose light is another than at the last call."""
        changed = (instant.static_light != self._light).any(axis=1)
        rows = np.flatnonzero(changed[instant.static.faces].any(axis=1)[self._hits.face])
        hits = self._hits.rows(rows)
        light = radiance(
            instant.static, hits, self._finish.rows(rows), instant.static_light, instant.highlights, self._fine_rays[hits.ray]
        )
        self._radiance[hits.ray] = light
        self._light = instant.static_light

    def _draw_moving(self, instant: Instant, linear: Array32) -> None:
        """Paint moving things over the light of the static ones wherever they are nearer."""
        inside = covered_pixels(instant.moving, self._fine)
        hits = instant.moving.cast(self._eye, self._fine_rays[inside])
        hits = hits.rows(np.flatnonzero(hits.distance < self._fine_depth[inside[hits.ray]]))
        if len(hits.ray):
            finish = read_finish(instant.moving, hits, self._pixel_m)
            rays = inside[hits.ray]
            linear[rays] = radiance(instant.moving, hits, finish, instant.moving_light, instant.highlights, self._fine_rays[rays])


def depth_along(geometry: Geometry, eye: Array32, rays: Array32) -> Array32:
    """Depth along rays of unit depth, infinite where they hit nothing, (N,)."""
    depth = np.full(len(rays), np.inf, np.float32)
    hits = geometry.cast(eye, rays)
    depth[hits.ray] = hits.distance
    return depth


def covered_pixels(geometry: Geometry, camera: Camera) -> NDArray[np.int64]:
    """Indices of all pixels that may show the geometry: those inside the frame around each of its surfaces."""
    uv, depth = camera.project(room_to_world(geometry.vertices))
    if depth.min() <= 0:
        return np.arange(camera.width * camera.height)
    mask = np.zeros((camera.height, camera.width), bool)
    low, high = (function.reduceat(uv, geometry.first_vertex) for function in (np.minimum, np.maximum))
    for (left, top), (right, bottom) in zip(np.floor(low).astype(int), np.ceil(high).astype(int), strict=True):
        mask[max(top, 0) : max(bottom, 0), max(left, 0) : max(right, 0)] = True
    return np.flatnonzero(mask)
