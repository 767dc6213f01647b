"""The rays of a camera's pixels, through a pinhole or through a lens that distorts."""

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array, Array32
from ggvs_eval.camera import Camera
from ggvs_eval.synthetic.film.rig import directions_in_room, rays_in_room, room_to_world
from ggvs_eval.synthetic.room.geometry import Geometry

# k1 k2 p1 p2 k3 of OpenCV's model; () is a pinhole.
Coefficients = tuple[float, ...]
EXACT = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-12)


class PixelGrid:
    """The pixels of one camera.

    Args:
        camera: its K holds for the distorted picture and for the undistorted one alike.
        lens: OpenCV's distortion coefficients.

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
    """Where the rays of all distorted pixels meet the plane of depth 1, camera frame, (H * W, 2)."""
    uv = camera.pixel_centres().reshape(-1, 1, 2)
    found = cv2.undistortPoints(uv, camera.K, np.array(lens), criteria=EXACT)
    return np.asarray(found, np.float64).reshape(-1, 2)
