"""Doubts about the input of a live rig: mistakes that still give a picture, and views that no camera has."""

import warnings
from collections.abc import Sequence

import numpy as np

from ggvs_eval.arrays import Map
from ggvs_eval.camera import Camera
from ggvs_eval.errors import GgvsWarning
from ggvs_eval.geometry.source_views import ray_angles, sample_view, sees, share_of_view

LEAST_FOCAL = 0.05  # of the image's width; a lens of 169 degrees
MOST_OUTSIDE = 0.5  # of the pixels with depth, farther outside near..far than by the factor
OUTSIDE_FACTOR = 2.0
MILLIMETRES = 100.0  # times the far bound, from which on depth is taken for millimetres
SEEN_FROM_DEG = 20.0  # between the rays of a view and of a camera to a point, up to which the camera shows what the view sees
LEAST_SEEN = 0.8  # of a view


def seen_share(target: Camera, cameras: Sequence[Camera]) -> float:
    """Share of a view that some camera sees from nearly its own direction, by calibration alone.

    Below `LEAST_SEEN` the view lies outside of what the rig sees, and most of its rim is guessed.

    Args:
        target: the view.
        cameras: the rig; one of the target's own name is left out.

    Reading:
        Between the cameras of the demo rig it is 1, and 0.99 in the middle of a rig carried by hand; beside the demo rig's middle
        by a quarter of its extent 0.96, by half of it 0.6, by the whole 0.2.
    """
    points = sample_view(target)
    seen = np.zeros(len(points), bool)
    for camera in cameras:
        if camera.name != target.name:
            seen |= sees(camera, points) & (ray_angles(target, camera, points) <= np.deg2rad(SEEN_FROM_DEG))
    return share_of_view(target, seen)


class Doubts:
    """Warnings about a rig, its depth and the places of the virtual camera, at most one of each kind."""

    def __init__(self, cameras: Sequence[Camera]) -> None:
        self._centres = np.stack([camera.centre for camera in cameras])  # (N, 3)
        self._near = min(camera.near for camera in cameras)
        self._said: set[str] = set()
        for camera in cameras:
            self.look_at_intrinsics(camera)

    def look_at_intrinsics(self, camera: Camera) -> None:
        """Doubt a focal length that is no number of pixels."""
        focal = float(min(camera.K[0, 0] / camera.width, camera.K[1, 1] / camera.height))
        if focal < LEAST_FOCAL:
            self._say(
                "intrinsics",
                f"camera {camera.name}: a focal length of {camera.K[0, 0]:g} x {camera.K[1, 1]:g} pixels for an image of "
                f"{camera.width} x {camera.height}; K is in pixels: multiply the rows of a normalised one by width and height",
            )

    def look_at_target(self, target: Camera) -> None:
        """Doubt a virtual camera that stands farther off the rig than the rig is wide and its nearest surfaces are away."""
        self.look_at_intrinsics(target)
        distance = float(np.linalg.norm(self._centres - target.centre, axis=1).min())
        extent = float(np.linalg.norm(np.ptp(self._centres, axis=0)))
        if distance > extent + self._near:
            self._say(
                "target",
                f"camera {target.name}: stands {distance:g} from the nearest camera of a rig that is {extent:g} wide; "
                "is its pose world_to_camera, in the rig's units and axes?",
            )

    def look_at_depth(self, camera: Camera, depth: Map) -> None:
        """Doubt depth of which most lies far outside the camera's near and far bounds."""
        known = depth[depth > 0]
        outside = (known < camera.near / OUTSIDE_FACTOR) | (known > camera.far * OUTSIDE_FACTOR)
        if not known.size or outside.mean() <= MOST_OUTSIDE:
            return
        median = float(np.median(known))
        mend = (
            "divide millimetres by 1000 and multiply by units_per_metre" if median > MILLIMETRES * camera.far else "as these are"
        )
        self._say(
            "depth",
            f"camera {camera.name}: {outside.mean():.0%} of its depth lies far outside near..far = {camera.near:g}.."
            f"{camera.far:g}, its median is {median:g}; depth is in world units: {mend}",
        )

    def _say(self, kind: str, text: str) -> None:
        if kind not in self._said:
            self._said.add(kind)
            warnings.warn(text, GgvsWarning, stacklevel=4)
