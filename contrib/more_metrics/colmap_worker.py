"""Runs COLMAP on the images of a path, in a separate process: in the one that loads pycolmap,
writing PNG files breaks.

Command: ``python -m ggvs_eval.contrib.more_metrics.colmap_worker FOLDER``. FOLDER holds
``images/``, ``job.json`` (``images``: their names in order; ``cameras``: fx, fy, cx, cy of each, or
null; ``overlap``: how many views on each is matched with); written into it is ``result.json``, and
COLMAP's log on the standard output.
"""

import json
import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

MAX_FEATURES = 2048  # per image; more cost time and change little
# least angle at which the first two views see their points; the second for short paths
INIT_ANGLES_DEG = (4.0, 1.0)
LEAST_ANGLE_DEG = 0.5  # of a point's rays: what is seen from one place alone is no point
# times the larger side, held fixed: a wrong guess bends the model, it does not keep views out
FOCAL_GUESS = 1.2
LONGEST_MAPPING_S = 600
SEED = 0


def run_job(folder: Path) -> dict[str, Any]:
    """Match neighbours and solve for cameras and points.

    Returns:
        ``matches``: verified ones of each pair of neighbours; of the largest model ``poses``: place
        in the list -> ``[rotation, centre]`` of a view, and ``tracks``: for each point the places
        of the views that see it. Empty if there is no model.
    """
    import pycolmap

    job = json.loads((folder / "job.json").read_text(encoding="utf-8"))
    names, database = job["images"], folder / "database.db"
    pycolmap.set_random_seed(SEED)
    pycolmap.Database.open(database).close()
    _extract(database, folder / "images", names, job["cameras"])
    _match(database, job["overlap"])
    model = max(
        _models(folder, database),
        key=lambda candidate: (candidate.num_reg_images(), candidate.num_points3D()),
        default=None,
    )
    result = {"matches": _neighbour_matches(database, names), "poses": {}, "tracks": []}
    if model is None or not model.num_points3D():
        return result
    places = {image_id: names.index(image.name) for image_id, image in model.images.items()}
    poses = {
        image_id: image.cam_from_world()
        for image_id, image in model.images.items()
        if image.has_pose
    }
    centres = {image_id: model.images[image_id].projection_center().tolist() for image_id in poses}
    tracks = [
        sorted({places[element.image_id] for element in point.track.elements})
        for point in model.points3D.values()
    ]
    return result | {
        "poses": {
            places[image_id]: [pose.rotation.matrix().tolist(), centres[image_id]]
            for image_id, pose in poses.items()
        },
        "tracks": tracks,
    }


def _extract(
    database: Path, images: Path, names: Sequence[str], cameras: Sequence[Sequence[float]] | None
) -> None:
    """Import the images first, in order, with their focal lengths: extraction by several threads
    numbers them as they finish.
    """
    import pycolmap

    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "PINHOLE"
    mode = pycolmap.CameraMode.PER_IMAGE if cameras else pycolmap.CameraMode.SINGLE
    pycolmap.import_images(database, images, mode, names, reader)
    opened = pycolmap.Database.open(database)
    lenses = dict(zip(names, cameras, strict=True)) if cameras else {}
    for image in opened.read_all_images():
        camera = opened.read_camera(image.camera_id)
        focal = FOCAL_GUESS * max(camera.width, camera.height)
        camera.params = list(
            lenses.get(image.name, (focal, focal, camera.width / 2, camera.height / 2))
        )
        camera.has_prior_focal_length = True
        opened.update_camera(camera)
    opened.close()
    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    options.sift.max_num_features = MAX_FEATURES
    pycolmap.extract_features(database, images, names, mode, reader, options, pycolmap.Device.cpu)


def _match(database: Path, overlap: int) -> None:
    """Match each view with those that follow; one thread, which keeps the order of matches."""
    import pycolmap

    options = pycolmap.FeatureMatchingOptions()
    options.use_gpu = False
    options.num_threads = 1
    pairing = pycolmap.SequentialPairingOptions()
    pairing.overlap = overlap
    pairing.quadratic_overlap = False
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = SEED
    pycolmap.match_sequential(database, options, pairing, verification, pycolmap.Device.cpu)


def _models(folder: Path, database: Path) -> list[Any]:
    """Models by each angle in turn, until one has every view."""
    import pycolmap

    models: list[Any] = []
    n_images = len(list((folder / "images").iterdir()))
    for angle in INIT_ANGLES_DEG:
        out = folder / f"model{angle:g}"
        out.mkdir()
        models += pycolmap.incremental_mapping(
            database, folder / "images", out, _mapping_options(angle)
        ).values()
        if any(model.num_reg_images() == n_images for model in models):
            break
    return models


def _mapping_options(init_angle_deg: float) -> Any:
    """Return one thread and fixed seeds: equal images give equal models.

    Lenses are known or guessed, never solved for.
    """
    import pycolmap

    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = options.mapper.num_threads = 1
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = SEED
    options.extract_colors = False
    options.min_model_size = 3
    options.max_num_models = 3
    options.max_runtime_seconds = LONGEST_MAPPING_S
    options.ba_refine_focal_length = options.ba_refine_extra_params = False
    options.mapper.init_min_tri_angle = init_angle_deg
    options.mapper.init_min_num_inliers = 50
    options.mapper.filter_min_tri_angle = options.triangulation.min_angle = LEAST_ANGLE_DEG
    return options


def _neighbour_matches(database: Path, names: Sequence[str]) -> list[int]:
    """Verified matches of each view with the next one."""
    import pycolmap

    opened = pycolmap.Database.open(database)
    numbers = {image.name: image.image_id for image in opened.read_all_images()}
    pairs = [(numbers[first], numbers[second]) for first, second in pairwise(names)]
    counts = [
        len(opened.read_two_view_geometry(*pair).inlier_matches)
        if opened.exists_two_view_geometry(*pair)
        else 0
        for pair in pairs
    ]
    opened.close()
    return counts


if __name__ == "__main__":
    work = Path(sys.argv[1])
    (work / "result.json").write_text(json.dumps(run_job(work)), encoding="utf-8")
