"""A sensor of depth beside the hand-held camera: how far off the colour image it sits, and what it cannot measure."""

from dataclasses import replace

import cv2
import numpy as np

from ggvs_eval.arrays import Array, Array32
from ggvs_eval.camera import Camera
from ggvs_eval.synthetic.film.options import DemoOptions
from ggvs_eval.synthetic.film.rig import UNITS_PER_METRE

# A pixel is lost where depth within its 3 x 3 neighbours differs by more than this share.
EDGE = 0.05
# Noise of triangulating sensors is correlated over so many pixels.
CORRELATED_PX = 1.0


def misplaced(options: DemoOptions, camera: Camera, image_width: int) -> Camera:
    """Where the sensor really is, of the camera it is written down as.

    Args:
        options: of the demo.
        camera: of the sensor, as it should be, at the moment it measures.
        image_width: of the colour images, pixels, in which the offset is given.

    Reading:
        Offset and rotation are one direction and one axis for the whole sequence, as of a sensor that is mounted wrongly. A
        positive offset along x shifts the depth map to the right of the image.
    """
    from scipy.spatial.transform import Rotation

    angle, axis = _mounting(options)
    K, pose = camera.K.copy(), camera.world_to_camera.copy()
    shift_px = options.depth_offset_px * camera.width / image_width
    K[:2, 2] += shift_px * np.array([np.cos(angle), np.sin(angle)])
    if options.depth_rotation_rad:
        pose[:3] = Rotation.from_rotvec(options.depth_rotation_rad * axis).as_matrix() @ pose[:3]
    return replace(camera, K=K, world_to_camera=pose)


def measured(options: DemoOptions, depth: Array32, number: int) -> Array32:
    """Depth as the sensor gives it, world units of the rig, 0 where it knows none; exact where the options want no noise.

    Args:
        options: of the demo.
        depth: exact, (H, W).
        number: of the frame; chooses the noise.
    """
    if not options.depth_noise:
        return depth
    rng = np.random.default_rng([options.seed, 12, number])
    grain = cv2.GaussianBlur(rng.standard_normal(depth.shape, np.float32), (0, 0), CORRELATED_PX)
    grain /= max(float(grain.std()), 1e-6)
    depth_m = depth / np.float32(UNITS_PER_METRE)
    noisy = depth + grain * depth_m**2 * np.float32(options.depth_noise * UNITS_PER_METRE)
    window = np.ones((3, 3), np.uint8)
    spread = cv2.dilate(depth, window) - cv2.erode(depth, window)
    return np.where((spread <= EDGE * depth) & (noisy > 0), noisy, 0).astype(np.float32)


def _mounting(options: DemoOptions) -> tuple[float, Array]:
    """Direction of the offset in the image, radians, and axis of the rotation, unit length, (3,)."""
    rng = np.random.default_rng([options.seed, 13])
    axis = rng.standard_normal(3)
    return float(rng.uniform(0, 2 * np.pi)), axis / np.linalg.norm(axis)
