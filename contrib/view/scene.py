"""Scene around the picture in the browser: the cameras of the rig as frusta, and the points that
depth says are there.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from ggvs_eval.arrays import Array, Image8
from ggvs_eval.camera import Camera
from ggvs_eval.contrib.view.live_view import FrameStock

if TYPE_CHECKING:
    import viser

MOST_POINTS = 120_000
FRUSTUM_SHARE = 0.2  # of the distance between neighbouring cameras
POINT_SHARE = 0.0025  # of the depth that the rig looks at
FRUSTUM_COLOUR = (230, 159, 0)


def middle_camera(cameras: Sequence[Camera]) -> Camera:
    """Return the camera nearest to the middle of the rig."""
    centres = np.stack([camera.centre for camera in cameras])
    return cameras[int(np.argmin(np.linalg.norm(centres - centres.mean(axis=0), axis=1)))]


def vertical_fov(camera: Camera) -> float:
    """Return the vertical field of view, radians."""
    return float(2 * np.arctan(camera.height / (2 * camera.K[1, 1])))


def camera_orientation(camera: Camera) -> Array:
    """Camera-to-world rotation as a unit quaternion w, x, y, z, (4,)."""
    return np.asarray(Rotation.from_matrix(camera.rotation.T).as_quat(scalar_first=True))


def gazed_depth(stock: FrameStock, instant: int) -> float:
    """Return the median depth that the middle camera sees, world units.

    The middle of its range where nothing is known.
    """
    camera = middle_camera(stock.cameras)
    depth = stock.read(camera.name, instant)[1].depth
    depths = depth[depth > 0]
    return float(np.median(depths)) if depths.size else float(np.sqrt(camera.near * camera.far))


def cloud(stock: FrameStock, instant: int, most: int = MOST_POINTS) -> tuple[Array, Image8]:
    """Return the surface that all cameras see at an instant, thinned evenly.

    Returns:
        Points in the world (N, 3) and their colours (N, 3), RGB uint8.
    """
    frames = {camera.name: stock.read(camera.name, instant) for camera in stock.cameras}
    step = max(
        int(np.ceil((sum(depth_map.depth.size for _, depth_map in frames.values()) / most) ** 0.5)),
        1,
    )
    points, colours = [], []
    for camera in stock.cameras:
        image, depth_map = frames[camera.name]
        cells = np.s_[step // 2 :: step, step // 2 :: step]
        depth = depth_map.depth[cells]
        usable = depth > 0
        points.append(
            camera.unproject(
                camera.pixel_centres()[cells][usable], depth[usable].astype(np.float64)
            )
        )
        colours.append(image[cells][usable])
    return np.concatenate(points), np.concatenate(colours)


class Leash:
    """Keeps a virtual camera near the rig: where it stands farther away it is taken to the nearest
    place within reach.

    Attributes:
        reach: from the nearest camera of the rig, world units: half of the rig's width or a third
            of what it looks at.
    """

    def __init__(self, cameras: Sequence[Camera], gazed: float) -> None:
        self._centres = np.stack([camera.centre for camera in cameras])
        width = float(np.linalg.norm(self._centres[:, None] - self._centres, axis=-1).max())
        self.reach = max(width / 2, gazed / 3)

    def keep(self, place: Array) -> Array:
        """Return the place, or the one within reach that is nearest to it, (3,)."""
        away = place - self._centres
        distances = np.linalg.norm(away, axis=1)
        nearest = int(np.argmin(distances))
        if distances[nearest] <= self.reach:
            return place
        return np.asarray(
            self._centres[nearest] + away[nearest] * (self.reach / distances[nearest])
        )


class Frusta:
    """The cameras of a rig.

    The one at the viewer's position would frame the picture and is hidden.
    """

    def __init__(self, scene: "viser.SceneApi", cameras: Sequence[Camera]) -> None:
        centres = np.stack([camera.centre for camera in cameras])
        apart = np.linalg.norm(centres[:, None] - centres, axis=-1)
        spacing = float(np.median(np.sort(apart, axis=1)[:, 1])) if len(cameras) > 1 else 1.0
        self._centres, self._size = centres, FRUSTUM_SHARE * spacing
        self.handles = [self._add(scene, camera) for camera in cameras]

    def show(self, is_wanted: bool, viewer: Array) -> None:
        """Show all cameras but those near the viewer's place (3,), or none."""
        far = np.linalg.norm(self._centres - viewer, axis=1) > 2 * self._size
        for handle, is_far in zip(self.handles, far.tolist(), strict=True):
            if handle.visible != (is_wanted and is_far):
                handle.visible = is_wanted and is_far

    def _add(self, scene: "viser.SceneApi", camera: Camera) -> "viser.CameraFrustumHandle":
        return scene.add_camera_frustum(
            f"/cameras/{camera.name}",
            vertical_fov(camera),
            camera.width / camera.height,
            scale=self._size,
            color=FRUSTUM_COLOUR,
            wxyz=camera_orientation(camera),
            position=camera.centre,
        )


def add_cloud(
    scene: "viser.SceneApi", stock: FrameStock, instant: int, name: str = "/points"
) -> "viser.PointCloudHandle":
    """Draw the points of an instant."""
    points, colours = cloud(stock, instant)
    size = POINT_SHARE * gazed_depth(stock, instant)
    return scene.add_point_cloud(
        name, points.astype(np.float32), colours, point_size=size, point_shape="square"
    )
