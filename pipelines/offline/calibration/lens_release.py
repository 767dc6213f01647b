"""One lens per camera, starting from a rig calibrated with one lens for all.

With every lens free from the start, the mapper can settle far from the truth and still register every camera below a pixel or so
(seen on flame_steak: focal lengths wrong by a factor of three). Runs in the process of `calibration_worker` alone.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

ROUNDS = 2


def release_lenses(folder: Path, images: Sequence[str], shared: Any, options: Any) -> Any:
    """Give every image a camera of its own and adjust poses, lenses and points together.

    Args:
        folder: of the job, with ``database.db`` and ``images/``.
        images: names, in the order in which the database was filled.
        shared: the reconstruction with shared cameras.

    Returns:
        The reconstruction with the images that `shared` registered.
    """
    import pycolmap

    database = folder / "per_camera.db"
    posed_images = {image.name: image for image in shared.images.values() if image.has_pose}
    _copy_matches(folder, database, images, {name: image.camera for name, image in posed_images.items()})
    model = posed_model(database, {name: image.cam_from_world() for name, image in posed_images.items()})
    adjusting = pycolmap.BundleAdjustmentOptions()
    adjusting.print_summary = False
    adjusting.ceres.solver_options.num_threads = 1
    for number in range(ROUNDS):  # points that only the better lenses explain come in the second round
        out = folder / f"released{number}"
        out.mkdir()
        model = pycolmap.triangulate_points(model, database, folder / "images", out, options=options)
        pycolmap.bundle_adjustment(model, adjusting)
        model.update_point_3d_errors()
    return model


def posed_model(database: Path, poses: Mapping[str, Any]) -> Any:
    """A reconstruction without points.

    Args:
        database: names the images and their cameras.
        poses: image -> `pycolmap.Rigid3d` from the world to its camera.
    """
    import pycolmap

    model = pycolmap.Reconstruction()
    opened = pycolmap.Database.open(database)
    for image in sorted(opened.read_all_images(), key=lambda image: image.image_id):
        if image.name in poses:
            model.add_camera_with_trivial_rig(opened.read_camera(image.camera_id))
            model.add_image_with_trivial_frame(image, poses[image.name])
    opened.close()
    return model


def _copy_matches(folder: Path, database: Path, images: Sequence[str], cameras: Mapping[str, Any]) -> None:
    """A database of the same features and matches, with a camera of its own for every image that has one in `cameras`."""
    import pycolmap

    pycolmap.Database.open(database).close()
    pycolmap.import_images(database, folder / "images", pycolmap.CameraMode.PER_IMAGE, list(images))
    source, target = pycolmap.Database.open(folder / "database.db"), pycolmap.Database.open(database)
    numbers = {image.name: image.image_id for image in source.read_all_images()}
    copied = target.read_all_images()
    for image in copied:
        target.write_keypoints(image.image_id, source.read_keypoints(numbers[image.name]))
        if image.name in cameras:
            camera = pycolmap.Camera(cameras[image.name].todict())
            camera.camera_id = image.camera_id
            target.update_camera(camera)
    for index, first in enumerate(copied):
        for second in copied[index + 1 :]:
            pair = numbers[first.name], numbers[second.name]
            if source.exists_two_view_geometry(*pair):
                geometry = source.read_two_view_geometry(*pair)
                target.write_two_view_geometry(first.image_id, second.image_id, geometry)
    source.close()
    target.close()
