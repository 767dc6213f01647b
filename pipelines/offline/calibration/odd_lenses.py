"""Cameras of a model with one lens for all that would like a lens of their own: each is freed once,
and the adjustments compared.

Runs in the process of `calibration_worker` alone.
"""

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

# Twice the gain in log-likelihood, in units of the residuals' own variance. Cameras of clean rigs
# reach 13, one that is zoomed by
# 8 % has 200 to 1,500, and draws its neighbours along to 40 until it is freed.
LEAST_GAIN = 30.0
# Lenses of one make and setting differ by 1 %.
LEAST_DIFFERENCE = 0.015
MOST_ODD_SHARE = 0.34
SIGMAS = 3.0


def find_odd_lenses(shared: Any) -> dict[str, dict[str, float]]:
    """Return the cameras that disagree with the lens that all share, the clearest first.

    Args:
        shared: reconstruction whose images share one camera; it stays as it is.

    Returns:
        Image -> ``factor`` on the common focal length, its ``half_width``, and ``common_factor``,
        by which the focal length of the others changes once this camera and those before it are
        freed.

    Reading:
        Points, poses and lenses are adjusted with each camera freed in turn, under Cauchy's loss,
        so that a few wrong matches have no say. The one that explains most is kept free, since it
        bends its neighbours, and the others are tried again.
    """
    names = sorted(image.name for image in shared.images.values() if image.has_pose)
    odd: dict[str, dict[str, float]] = {}
    if len(names) < 3:
        return odd
    model, _ = free_lenses(shared, ())
    cost, n_residuals = _adjust(model)
    (shared_focal,) = (camera.mean_focal_length() for camera in model.cameras.values())
    while len(odd) < MOST_ODD_SHARE * len(names):
        tried = {name: _freed(shared, [*odd, name]) for name in names if name not in odd}
        best = min(tried, key=lambda name: tried[name][0])
        left, factor, common = tried[best]
        gain = 2 * (cost - left) / max(2 * left / n_residuals, 1e-12)
        if gain < LEAST_GAIN or abs(factor - 1) < LEAST_DIFFERENCE:
            break
        half_width = SIGMAS * abs(factor - 1) / np.sqrt(gain)
        odd[best] = {
            "factor": factor,
            "half_width": float(half_width),
            "common_factor": common / shared_focal,
        }
        cost = left
    return odd


def free_lenses(shared: Any, names: Collection[str]) -> tuple[Any, dict[str, int]]:
    """Return a copy of a reconstruction in which some images have a camera of their own, and its
    number by image.
    """
    import pycolmap

    model = pycolmap.Reconstruction()
    numbers: dict[str, int] = {}
    for camera in shared.cameras.values():
        model.add_camera_with_trivial_rig(pycolmap.Camera(camera.todict()))
    for image in sorted(shared.images.values(), key=lambda image: image.image_id):
        if not image.has_pose:
            continue
        number = image.camera_id
        if image.name in names:
            camera = pycolmap.Camera(image.camera.todict())
            camera.camera_id = number = numbers[image.name] = max(shared.cameras) + 1 + len(numbers)
            model.add_camera_with_trivial_rig(camera)
        places = np.array([point.xy for point in image.points2D]).reshape(-1, 2)
        copied = pycolmap.Image(
            name=image.name, keypoints=places, camera_id=number, image_id=image.image_id
        )
        model.add_image_with_trivial_frame(copied, image.cam_from_world())
    for _, point in sorted(shared.points3D.items()):
        model.add_point3D(point.xyz, point.track)
    return model, numbers


def adjust_own(shared: Any, names: Collection[str]) -> Any:
    """Return the reconstruction with some images freed from the lens that the others share,
    adjusted.
    """
    model, _ = free_lenses(shared, names)
    _adjust(model)
    model.update_point_3d_errors()
    return model


def _freed(shared: Any, names: Sequence[str]) -> tuple[float, float, float]:
    """Cost with some images freed, focal length of the last of them as a factor on the common one,
    and that one, pixels.
    """
    model, numbers = free_lenses(shared, names)
    cost, _ = _adjust(model)
    (common,) = (model.cameras[number].mean_focal_length() for number in shared.cameras)
    return cost, model.cameras[numbers[names[-1]]].mean_focal_length() / common, common


def _adjust(model: Any) -> tuple[float, int]:
    """Adjust everything; gives the cost, half the sum of the losses, and the number of
    residuals.
    """
    import pycolmap

    options, config = pycolmap.BundleAdjustmentOptions(), pycolmap.BundleAdjustmentConfig()
    options.print_summary = False
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.solver_options.num_threads = 1
    for image in model.reg_image_ids():
        config.add_image(image)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    summary: Any = pycolmap.create_default_ceres_bundle_adjuster(options, config, model).solve()
    return float(summary.ceres_summary.final_cost), int(summary.num_residuals)
