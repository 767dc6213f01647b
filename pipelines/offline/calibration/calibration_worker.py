"""Calibrates the images of one instant with pycolmap, in a separate process: pycolmap breaks the
writing of PNG files.

With every lens free from the start, the mapper can settle far from the truth and still register
every camera below a pixel or so (seen on flame_steak: focal lengths wrong by a factor of three).
Runs in the process of `calibration_worker` alone.

Command: ``python -m ggvs_eval.pipelines.offline.calibration.calibration_worker FOLDER``. FOLDER
holds ``job.json`` (see `run_job`) and ``images/``; written into it are ``sparse/0`` and
``result.json``, and COLMAP's log on the standard output. The process ends when its standard input
is closed, so that it does not outlive its parent.
"""

import json
import os
import sys
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ggvs_eval.pipelines.offline.calibration.odd_lenses import adjust_own, find_odd_lenses
from ggvs_eval.pipelines.offline.calibration.pose_refinement import refined_views

ROUNDS = 2
# Tried in turn until every camera is registered: COLMAP's own settings, then smaller angles between
# the first two cameras, fewer matches, and other guesses of the focal length (in units of the
# larger side of the image) for lenses far from a normal one.
ATTEMPTS: tuple[dict[str, float], ...] = (
    {
        "focal": 1.2,
        "init_angle": 16.0,
        "init_inliers": 100,
        "pose_inliers": 30,
        "pose_ratio": 0.25,
        "pose_error": 12.0,
    },
    {
        "focal": 0.6,
        "init_angle": 8.0,
        "init_inliers": 60,
        "pose_inliers": 20,
        "pose_ratio": 0.2,
        "pose_error": 12.0,
    },
    {
        "focal": 1.2,
        "init_angle": 4.0,
        "init_inliers": 40,
        "pose_inliers": 15,
        "pose_ratio": 0.15,
        "pose_error": 16.0,
    },
    {
        "focal": 2.4,
        "init_angle": 2.0,
        "init_inliers": 25,
        "pose_inliers": 12,
        "pose_ratio": 0.1,
        "pose_error": 16.0,
    },
)
LARGEST_MODELS = 5
REFINEMENTS = 2
LONGEST_ATTEMPT_S = 1800


def run_job(folder: Path) -> dict[str, Any]:
    """Calibrate and write ``sparse/0``.

    Args:
        folder: its ``job.json`` holds ``groups`` (names of images below ``images/``, those of one
            size together), ``model``, ``shared``, ``own_lens`` (images that do not share),
            ``refine``, ``seed``, ``threads``, ``max_features``, ``max_image_size_px`` and
            ``known``: null, or image -> ``model``, ``params``, ``width``, ``height`` and
            ``world_to_camera`` (3 x 4, or null).

    Returns:
        ``registered``: image -> the number of points it sees; ``features`` and ``matches`` (with
        the best partner) per image; ``attempt``, ``n_points``, ``mean_reprojection_error_px``,
        ``versions``; ``odd_lenses``, see `find_odd_lenses`.
    """
    import pycolmap

    job = json.loads((folder / "job.json").read_text(encoding="utf-8"))
    pycolmap.set_random_seed(job["seed"])
    _find_features(folder, job)
    _match(folder, job)
    views_by_image = job["known"] or {}
    if views_by_image and all(view["world_to_camera"] for view in views_by_image.values()):
        model, attempt = _from_poses(folder, job), 0
    else:
        model, attempt = _map(folder, job)
        if model is not None and not job["known"] and not job["shared"]:
            model = release_lenses(
                folder, _images(job), model, _mapping_options(job, ATTEMPTS[attempt])
            )
        elif model is not None and not job["known"] and job["own_lens"]:
            model = adjust_own(model, job["own_lens"])
    features, matches = _describe_matches(folder)
    registered = _drop_blind(model) if model is not None else {}
    is_shared = (
        model is not None
        and registered
        and job["shared"]
        and not job["known"]
        and not job["own_lens"]
    )
    odd_lenses = find_odd_lenses(model) if is_shared else {}
    if model is not None and registered:
        (folder / "sparse" / "0").mkdir(parents=True)
        model.write_binary(folder / "sparse" / "0")
    return {
        "registered": registered,
        "features": features,
        "matches": matches,
        "attempt": attempt,
        "odd_lenses": odd_lenses,
        "n_points": model.num_points3D() if registered else 0,
        "mean_reprojection_error_px": model.compute_mean_reprojection_error()
        if registered
        else 0.0,
        "versions": {"pycolmap": pycolmap.__version__, "ceres": pycolmap.__ceres_version__},
    }


def _find_features(folder: Path, job: Mapping[str, Any]) -> None:
    """Import the images first, in order: extraction by several threads numbers them as they
    finish.
    """
    import pycolmap

    database, images = folder / "database.db", folder / "images"
    pycolmap.Database.open(database).close()
    mode = pycolmap.CameraMode.PER_IMAGE if job["known"] else pycolmap.CameraMode.SINGLE
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = job["model"]
    for group in job["groups"]:
        pycolmap.import_images(database, images, mode, group, reader)
    if job["known"]:
        _set_known_intrinsics(database, job["known"])
    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    options.num_threads = job["threads"]
    options.max_image_size = job["max_image_size_px"]
    options.sift.max_num_features = job["max_features"]
    pycolmap.extract_features(
        database, images, _images(job), mode, reader, options, pycolmap.Device.cpu
    )


def _images(job: Mapping[str, Any]) -> list[str]:
    """Return all images, in the order in which the database numbers them."""
    return [image for group in job["groups"] for image in group]


def _set_known_intrinsics(database: Path, views_by_image: Mapping[str, Mapping[str, Any]]) -> None:
    import pycolmap

    opened = pycolmap.Database.open(database)
    for image in opened.read_all_images():
        view = views_by_image[image.name]
        camera = pycolmap.Camera(
            model=view["model"], width=view["width"], height=view["height"], params=view["params"]
        )
        camera.camera_id = image.camera_id
        camera.has_prior_focal_length = True
        opened.update_camera(camera)
    opened.close()


def _match(folder: Path, job: Mapping[str, Any]) -> None:
    """Every image with every other.

    One thread, which is hardly slower here and keeps the order of matches.
    """
    import pycolmap

    options = pycolmap.FeatureMatchingOptions()
    options.use_gpu = False
    options.num_threads = 1
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = job["seed"]
    device = pycolmap.Device.cpu
    pycolmap.match_exhaustive(
        folder / "database.db", options, verification_options=verification, device=device
    )


def _map(folder: Path, job: Mapping[str, Any]) -> tuple[Any, int]:
    """Return the largest model of the first attempt that registers every camera, or of all
    attempts; and the attempt's number.
    """
    import pycolmap

    best, best_attempt = None, 0
    for number, attempt in enumerate(ATTEMPTS):
        if not job["known"]:
            _guess_focal_length(folder / "database.db", attempt["focal"])
        out = folder / f"attempt{number}"
        out.mkdir()
        models = pycolmap.incremental_mapping(
            folder / "database.db", folder / "images", out, _mapping_options(job, attempt)
        )
        for _, model in sorted(models.items()):
            if best is None or _rank(model) > _rank(best):
                best, best_attempt = model, number
        if best is not None and best.num_reg_images() == len(_images(job)):
            break
    return best, best_attempt


def _rank(model: Any) -> tuple[int, int]:
    return model.num_reg_images(), model.num_points3D()


def _guess_focal_length(database: Path, factor: float) -> None:
    """Set the initial focal length of cameras whose files say nothing of it."""
    import pycolmap

    opened = pycolmap.Database.open(database)
    for camera in opened.read_all_cameras():
        if not camera.has_prior_focal_length:
            params = camera.params.copy()
            params[camera.focal_length_idxs()] = factor * max(camera.width, camera.height)
            camera.params = params.tolist()
            opened.update_camera(camera)
    opened.close()


def _mapping_options(job: Mapping[str, Any], attempt: Mapping[str, float]) -> Any:
    """Return one thread and fixed seeds: equal images give equal models."""
    import pycolmap

    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = options.mapper.num_threads = 1
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = job[
        "seed"
    ]
    options.extract_colors = False
    options.min_model_size = 2
    options.max_num_models = LARGEST_MODELS
    options.max_runtime_seconds = LONGEST_ATTEMPT_S
    is_free = not job["known"]
    options.ba_refine_focal_length = options.ba_refine_extra_params = is_free
    options.mapper.abs_pose_refine_focal_length = options.mapper.abs_pose_refine_extra_params = (
        is_free
    )
    options.mapper.init_min_tri_angle = attempt["init_angle"]
    options.mapper.init_min_num_inliers = int(attempt["init_inliers"])
    options.mapper.abs_pose_min_num_inliers = int(attempt["pose_inliers"])
    options.mapper.abs_pose_min_inlier_ratio = attempt["pose_ratio"]
    options.mapper.abs_pose_max_error = attempt["pose_error"]
    return options


def _from_poses(folder: Path, job: Mapping[str, Any]) -> Any:
    """Return the points for cameras that stay where they are, or that are then refined: more points
    come with better cameras.
    """
    model = _triangulate(folder, job, job["known"])
    for _ in range(REFINEMENTS if job["refine"] else 0):
        views_by_image = refined_views(model, job["known"])
        _set_known_intrinsics(folder / "database.db", views_by_image)
        model = _triangulate(folder, job, views_by_image)
    return model


def _triangulate(
    folder: Path, job: Mapping[str, Any], views_by_image: Mapping[str, Mapping[str, Any]]
) -> Any:
    import pycolmap

    poses = {
        name: pycolmap.Rigid3d(view["world_to_camera"]) for name, view in views_by_image.items()
    }
    posed = posed_model(folder / "database.db", poses)
    out = folder / "triangulated"
    out.mkdir(exist_ok=True)
    options = _mapping_options(job, ATTEMPTS[0])
    return pycolmap.triangulate_points(
        posed, folder / "database.db", folder / "images", out, options=options
    )


def _drop_blind(model: Any) -> dict[str, int]:
    """Take cameras that see no point off the model.

    Gives the names of the others and how many points they see.
    """
    registered = {}
    for image in sorted(model.images.values(), key=lambda image: image.name):
        if image.has_pose and image.num_points3D > 0:
            registered[image.name] = image.num_points3D
        elif image.has_pose:
            model.deregister_frame(image.frame_id)
    return registered


def _describe_matches(folder: Path) -> tuple[dict[str, int], dict[str, int]]:
    """Per image the number of its features, and of its verified matches with the partner where
    these are most.
    """
    import pycolmap

    opened = pycolmap.Database.open(folder / "database.db")
    images = opened.read_all_images()
    features = {image.name: opened.num_keypoints_for_image(image.image_id) for image in images}
    matches = dict.fromkeys(features, 0)
    for index, first in enumerate(images):
        for second in images[index + 1 :]:
            if opened.exists_two_view_geometry(first.image_id, second.image_id):
                count = len(
                    opened.read_two_view_geometry(first.image_id, second.image_id).inlier_matches
                )
                matches[first.name], matches[second.name] = (
                    max(matches[first.name], count),
                    max(matches[second.name], count),
                )
    opened.close()
    return features, matches


def _end_with_parent() -> None:
    """Wait on stdin, to which nothing is written; it ends with the parent.

    Python's own stdin would be locked.
    """
    os.read(0, 1)
    os._exit(1)


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
    _copy_matches(
        folder, database, images, {name: image.camera for name, image in posed_images.items()}
    )
    model = posed_model(
        database, {name: image.cam_from_world() for name, image in posed_images.items()}
    )
    adjusting = pycolmap.BundleAdjustmentOptions()
    adjusting.print_summary = False
    adjusting.ceres.solver_options.num_threads = 1
    # points that only the better lenses explain come in the second round
    for number in range(ROUNDS):
        out = folder / f"released{number}"
        out.mkdir()
        model = pycolmap.triangulate_points(
            model, database, folder / "images", out, options=options
        )
        pycolmap.bundle_adjustment(model, adjusting)
        model.update_point_3d_errors()
    return model


def posed_model(database: Path, poses: Mapping[str, Any]) -> Any:
    """Return a reconstruction without points.

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


def _copy_matches(
    folder: Path, database: Path, images: Sequence[str], cameras: Mapping[str, Any]
) -> None:
    """A database of the same features and matches, with a camera of its own for every image that
    has one in `cameras`.
    """
    import pycolmap

    pycolmap.Database.open(database).close()
    pycolmap.import_images(database, folder / "images", pycolmap.CameraMode.PER_IMAGE, list(images))
    source, target = (
        pycolmap.Database.open(folder / "database.db"),
        pycolmap.Database.open(database),
    )
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


if __name__ == "__main__":
    threading.Thread(target=_end_with_parent, daemon=True).start()
    result = run_job(Path(sys.argv[1]))
    (Path(sys.argv[1]) / "result.json").write_text(json.dumps(result), encoding="utf-8")
