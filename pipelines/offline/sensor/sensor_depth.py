"""Depth that a sensor measured next to the images, made fit for rendering: outliers removed, small
holes closed.
"""

import cv2
import numpy as np

from ggvs_eval.arrays import Image8, Map
from ggvs_eval.camera import Camera
from ggvs_eval.capture import DepthSource
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.errors import DepthError
from ggvs_eval.geometry.pinhole import as_image8
from ggvs_eval.pipelines.offline.sensor.sensor_grid import SensorGrid, close_edges, close_holes
from ggvs_eval.pipelines.offline.stereo.fusion import drop_flying_pixels, smooth_surfaces
from ggvs_eval.tasks.identity import code_of

# of the logarithm of depth in which OpenCV looks for speckles; one is a thousandth of the depth
STEPS = 1000
# The filter; pixels are the sensor's.
# neighbours whose depths differ by more than this share of them are on two surfaces, ...
STEP = 0.03
# ... unless a surface whose normal is this far off the ray explains the difference
STEEPEST_RAD = 1.4
SPECKLE_PX = 20  # surfaces of fewer pixels than this are dropped
HOLE_PX = 3  # holes up to this wide are filled, along the row or the column
# depth is averaged over near neighbours that differ by about this share of it
SMOOTH, SMOOTH_RADIUS_PX = 0.015, 4
EDGE_PX = 3.0  # confidence falls nearer than this to edges and holes
FILLED_CONFIDENCE = 0.2  # of filled pixels, over that of measured ones
# rows down and columns right to one of two opposite neighbours
OPPOSITE = ((0, 1), (1, 0), (1, 1), (1, -1))


class SensorDepthEstimator:
    """Depth of one camera from the sensor next to it, frame by frame, as `DepthEstimator` for
    stereo.
    """

    def __init__(self, camera: Camera, source: DepthSource) -> None:
        self.camera = camera
        self.source = source

    def at(self, frame: int, image: Image8) -> DepthMap:
        """Filtered depth of one instant, see `filter_sensor_depth`.

        Args:
            image: what the camera saw then, RGB, (H, W, 3).

        Raises:
            DepthError: the sensor has no such frame, or the image is not of the camera's size.
        """
        if not 0 <= frame < self.source.n_frames:
            raise DepthError(
                f"camera {self.camera.name}: wanted sensor depth of frame {frame}, the capture has "
                f"depth of {self.source.n_frames} frames; choose other frames or compute depth by "
                "stereo"
            )
        return filter_sensor_depth(
            next(iter(self.source.depths(frame, frame + 1))), image, self.camera
        )

    def describe(self) -> dict[str, object]:
        """Describe what the depth depends on besides camera and images: the options of
        `describe_depth`.
        """
        return {**describe_filter(), "sensor": self.source.digest}


def describe_filter() -> dict[str, object]:
    """Return the filter as values that JSON knows, its code included."""
    return {"algorithm": "sensor-filter", "code": code_of(__name__)}


def filter_sensor_depth(depth: Map, image: Image8, camera: Camera) -> DepthMap:
    """Remove mixed pixels and speckles from the depth that a sensor measured, and resample it to
    the camera's size.

    Args:
        depth: z as measured, world units, 0 or not finite = unknown, (h, w): the camera's view at
            any size.
        camera: the camera; depth outside its range is unknown.

    Returns:
        Depth and confidence, (H, W).

    Raises:
        DepthError: the image is not of the camera's size, or the depth is not a map of numbers.

    Reading:
        The paper takes RGB-D input and names no filter. Sensors fail at edges, where a pixel sees
        two surfaces and reports a depth between, and where little light comes back. Confidence is
        chosen here, a product: it falls towards edges and holes, with the cosine between ray and
        surface normal, and by half from the camera to `far`. Its constants were chosen on a
        HoloLens sequence, by how far depth warped between near frames agrees, and on validation
        rooms (demo seeds 101-103) seen by a simulated sensor of a half and a third of the
        resolution with 0.5 % noise.
    """
    _check(depth, image, camera)
    with np.errstate(invalid="ignore"):
        depth_in_range = np.where((depth >= camera.near) & (depth <= camera.far), depth, 0).astype(
            np.float32
        )
    grid = SensorGrid.find(depth_in_range)
    # of the sensor's pixels, in the camera's
    pitch = grid.columns.pitch * camera.width / depth.shape[1]
    step = max(STEP, float(np.tan(STEEPEST_RAD)) * pitch / camera.focal_px)
    reduced = drop_mixed_pixels(grid.reduce(depth_in_range), step)
    closed = drop_speckles(close_holes(reduced, HOLE_PX, step), SPECKLE_PX, step)
    smooth = smooth_surfaces(closed, SMOOTH, SMOOTH_RADIUS_PX)
    result = close_edges(grid.enlarge(smooth, image, step), image, round(HOLE_PX * pitch))
    filled = grid.repeat(reduced, *camera.size) == 0
    trust = np.where(filled, np.float32(FILLED_CONFIDENCE), np.float32(1))
    return DepthMap(result, trust * surface_confidence(result, camera, EDGE_PX * pitch, step))


def drop_mixed_pixels(depth: Map, step: float) -> Map:
    """Invalidate pixels between a nearer and a farther neighbour, and isolated ones.

    Args:
        depth: (H, W), 0 = unknown.
        step: share of the depth by which neighbours on two opposite sides are nearer and farther.

    Returns:
        What remains, (H, W).
    """
    mixed = np.zeros(depth.shape, np.bool_)
    low, high = depth * np.float32(1 - step), depth * np.float32(1 + step)
    for down, right in OPPOSITE:
        before, after = (_shift(depth, sign * down, sign * right) for sign in (-1, 1))
        near, far = np.minimum(before, after), np.maximum(before, after)
        mixed |= (near > 0) & (near < low) & (far > high)
    return drop_flying_pixels(np.where(mixed, np.float32(0), depth), step)


def drop_speckles(depth: Map, speckle_px: int, step: float) -> Map:
    """Invalidate connected surfaces of fewer than `speckle_px` pixels.

    Neighbours within the share `step` are connected.
    """
    mask = depth > 0
    if speckle_px <= 1 or not mask.any():
        return depth
    logarithm = np.log(np.where(mask, depth, np.float32(1)))
    steps = np.where(mask, 1 + STEPS * (logarithm - logarithm[mask].min()), 0)
    labels = np.rint(np.minimum(steps, np.iinfo(np.int16).max)).astype(np.int16)
    cv2.filterSpeckles(labels, 0, speckle_px - 1, round(STEPS * step))
    return np.where(labels > 0, depth, np.float32(0))


def surface_confidence(depth: Map, camera: Camera, edge_px: float, step: float) -> Map:
    """Return the trust in measured depth by its place: away from edges, facing the camera, near,
    (H, W) in [0, 1], 0 = unknown.

    Args:
        depth: (H, W), 0 = unknown.
        edge_px: distance from edges and holes beyond which they have no effect, pixels.
        step: neighbours whose depths differ by more than this share of them are an edge.
    """
    mask = depth > 0
    low = cv2.erode(depth, np.ones((3, 3)), borderType=cv2.BORDER_REPLICATE)
    high = cv2.dilate(depth, np.ones((3, 3)), borderType=cv2.BORDER_REPLICATE)
    inner = (high - low <= step * low) & mask
    distance = cv2.distanceTransform(
        np.pad(inner, 1, constant_values=True).astype(np.uint8), cv2.DIST_L2, 5
    )[1:-1, 1:-1]
    range_share = np.minimum(depth / np.float32(camera.far), np.float32(1))
    confidence = (
        np.minimum((1 + distance) / (1 + edge_px), 1)
        * _facing(depth, camera)
        / (1 + range_share**2)
    )
    return np.where(mask, confidence, 0).astype(np.float32)


def _facing(depth: Map, camera: Camera) -> Map:
    """Return the cosine of the angle between each pixel's ray and the normal of the surface through
    its neighbours, (H, W).
    """
    slope_down, slope_across = np.gradient(depth.astype(np.float32))
    fx, fy, cx, cy = camera.K[[0, 1, 0, 1], [0, 1, 2, 2]]
    u, v = np.arange(camera.width) + 0.5 - cx, (np.arange(camera.height) + 0.5 - cy)[:, None]
    ray_length = np.sqrt(np.square(u / fx) + np.square(v / fy) + 1)
    # times the depth, with a sign
    normal = fx * slope_across, fy * slope_down, depth + u * slope_across + v * slope_down
    length = np.sqrt(sum(np.square(part) for part in normal)) * ray_length
    return (depth / np.maximum(length, 1e-12)).astype(np.float32)


def _shift(depth: Map, down: int, right: int) -> Map:
    """Return the map moved by some pixels, 0 if nothing comes in."""
    height, width = depth.shape
    moved = np.zeros_like(depth)
    moved[max(down, 0) : height + min(down, 0), max(right, 0) : width + min(right, 0)] = depth[
        max(-down, 0) : height + min(-down, 0), max(-right, 0) : width + min(-right, 0)
    ]
    return moved


def _check(depth: Map, image: Image8, camera: Camera) -> None:
    if depth.ndim != 2 or not np.issubdtype(depth.dtype, np.floating) or depth.size == 0:
        raise DepthError(
            f"camera {camera.name}: wanted sensor depth (h, w) of floating-point numbers, got "
            f"{depth.dtype} {depth.shape}; scale the sensor's steps to world units first"
        )
    as_image8(image, camera, DepthError)
