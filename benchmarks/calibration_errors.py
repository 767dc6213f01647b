"""How far a calibration is from the cameras that come with a capture."""

import numpy as np

from ggvs_eval.capture import Capture
from ggvs_eval.geometry.alignment import pose_differences
from ggvs_eval.pipelines.inspection.capture.poses import rig_extent
from ggvs_eval.pipelines.offline.calibration.calibrate import Calibration


def measure_against(given: Capture, calibration: Calibration) -> dict[str, float]:
    """Compare a calibration with the cameras of a capture, after aligning the centres by a
    similarity.

    Args:
        given: cameras to compare with, matched by name, at any size of the same frames.

    Returns:
        ``n_given``, ``n_registered`` (of these), ``mean_reprojection_error_px``, ``n_points``,
        ``centre_error_percent_max`` and ``_mean`` (of the rig's extent, the largest distance of two
        given cameras), ``rotation_error_deg_max`` and ``_mean``, ``focal_error_percent_max``.
    """
    truth = {camera.name: camera for camera in given.cameras}
    distances, angles_rad = pose_differences(calibration.cameras, truth)
    common = [
        (camera, truth[name].resized(*camera.size))
        for name, camera in calibration.cameras.items()
        if name in truth
    ]
    centre_percent = 100 * distances / rig_extent(truth.values())
    focal_percent = [100 * abs(camera.focal_px / true.focal_px - 1) for camera, true in common]
    return {
        "n_given": len(truth),
        "n_registered": len(common),
        "mean_reprojection_error_px": calibration.mean_reprojection_error_px,
        "n_points": calibration.n_points,
        "centre_error_percent_max": float(centre_percent.max()),
        "centre_error_percent_mean": float(centre_percent.mean()),
        "rotation_error_deg_max": float(np.degrees(angles_rad.max())),
        "rotation_error_deg_mean": float(np.degrees(angles_rad.mean())),
        "focal_error_percent_max": max(focal_percent),
    }
