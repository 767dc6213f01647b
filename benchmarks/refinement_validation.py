"""Gain of refining a calibration: ``python -m benchmarks.refinement_validation``, a part of ``make
validate``.

Two validation rooms of 1344x1008 with ten cameras, calibrated exactly, and roughly: every camera
turned, moved and zoomed a little, its principal point shifted. Both are then refined from one
instant, and each state renders the same views. What an exact calibration loses is the price of a
refinement that was not needed.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain, pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from benchmarks.domain_views import ViewPlan, render_domain
from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.contrib.training.samples.samples import SampleMaker
from ggvs_eval.contrib.worlds.domains import VALIDATION_SEEDS
from ggvs_eval.datasets import open_capture
from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.files.colmap_text import Sightings, write_model
from ggvs_eval.files.images import quantise, write_image
from ggvs_eval.geometry.epipolar import epipolar_errors
from ggvs_eval.jobs.processes import finish_all, worker_pool
from ggvs_eval.kernels import usable_cpus
from ggvs_eval.metrics.image.psnr import psnr
from ggvs_eval.metrics.image.ssim import ssim
from ggvs_eval.pipelines.methods.registry import find_method
from ggvs_eval.pipelines.offline.calibration.calibrate import (
    Calibration,
    CalibrationOptions,
    calibrate,
)
from ggvs_eval.run_folder import write_json

DOMAIN, ROOMS, METHOD = "large", 2, "ours-geometric"
# Standard deviations of a rough calibration: about what flame_steak's own differs by from a better
# one.
TURN_DEG, CENTRE_SHARE, ZOOM, PRINCIPAL_POINT_PX = 0.05, 0.001, 0.002, 2.0
COMMAND = "python -m benchmarks.refinement_validation"


def main() -> None:
    """Print the table of states and write out/validate_refinement.json."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("out"),
        help="folder for validate_refinement.json and the rooms",
    )
    out = parser.parse_args().out
    figures = validate_refinement(out / "domains", VALIDATION_SEEDS[:ROOMS])
    print(figures.round(4).to_string())
    write_json(
        out / "validate_refinement.json",
        {"command": COMMAND, "means": figures.round(5).to_dict(orient="index")},
    )


def validate_refinement(cache: Path, seeds: Sequence[int]) -> pd.DataFrame:
    """Measure exact and rough calibrations, as given and refined.

    Args:
        cache: where rooms are kept.
        seeds: of the rooms.

    Returns:
        A row per state, means over rooms and views: mean reprojection error of the features and
        median epipolar error of exact matches, both in pixels, PSNR in dB and SSIM of the rendered
        views.
    """
    with worker_pool(min(usable_cpus(), len(seeds))) as pool:
        rooms = [pool.submit(_measure_room, cache, seed) for seed in seeds]
        finish_all(pool, rooms, "rooms calibrated")
    rows = chain.from_iterable(room.result() for room in rooms)
    return pd.DataFrame(rows).groupby("state", sort=False).mean()


def _measure_room(cache: Path, seed: int) -> list[dict[str, object]]:
    """Return one room in all states, a row per state and view."""
    rows: list[dict[str, object]] = []
    exact, choices = render_domain(cache, DOMAIN, seed, ViewPlan())
    names = [(target.name, [source.name for source in sources]) for target, sources in choices]
    with TemporaryDirectory() as folder:
        for state, cameras in (("exact", exact.cameras), ("rough", knocked(exact.cameras, seed))):
            written = write_rig(Path(folder) / state, exact, cameras)
            for refine in (False, True):
                options = CalibrationOptions(known_poses=written, refine=refine)
                found = calibrate(written / "images", Path(folder) / f"{state}-{refine}", options)
                row = {
                    "state": f"{state}, refined" if refine else state,
                    "reprojection": found.mean_reprojection_error_px,
                }
                row |= {"contradiction": contradiction_px(exact, found)}
                rows += [row | scores for scores in render_scores(open_capture(found.path), names)]
    return rows


def knocked(cameras: Sequence[Camera], seed: int) -> list[Camera]:
    """Return the cameras as a rough calibration has them."""
    rng, centres = np.random.default_rng(seed), np.array([camera.centre for camera in cameras])
    extent = float(np.linalg.norm(centres[:, None] - centres[None], axis=-1).max())
    rough = []
    for camera in cameras:
        pose, K = camera.world_to_camera.copy(), camera.K.copy()
        pose[:3, :3] = (
            Rotation.from_rotvec(np.radians(TURN_DEG) * rng.normal(size=3)).as_matrix()
            @ pose[:3, :3]
        )
        pose[:3, 3] = -pose[:3, :3] @ (camera.centre + CENTRE_SHARE * extent * rng.normal(size=3))
        K[[0, 1], [0, 1]] *= 1 + ZOOM * rng.normal()
        K[:2, 2] += PRINCIPAL_POINT_PX * rng.normal(size=2)
        rough.append(replace(camera, K=K, world_to_camera=pose))
    return rough


def write_rig(folder: Path, capture: Capture, cameras: Sequence[Camera]) -> Path:
    """Write the first instant of a capture with cameras that need not be its own.

    A point before each says how deep it looks.
    """
    grey = np.full((1, 3), 128, np.uint8)
    sightings = [
        Sightings(np.array([number]), camera.K[None, :2, 2], grey)
        for number, camera in enumerate(cameras)
    ]
    points = np.array([camera.centre + 3 * camera.near * camera.axis for camera in cameras])
    write_model(folder / "sparse" / "0", cameras, sightings, points)
    for name in capture.camera_names:
        write_image(folder / "images" / f"{name}.png", capture.frame(name, 0))
    return folder


def contradiction_px(truth: Capture, rig: Calibration) -> float:
    """Median epipolar error of exact matches between neighbours: how far off a rig looks up what
    another camera sees.
    """
    rng, errors = np.random.default_rng(0), []
    for first, second in pairwise(truth.camera_names):
        one, other = truth.camera(first), truth.camera(second)
        depth = rng.uniform(2 * one.near, 8 * one.near, 500)
        rays = one.rays().reshape(-1, 3)[rng.integers(one.width * one.height, size=len(depth))]
        uv = [camera.project(one.centre + depth[:, None] * rays)[0] for camera in (one, other)]
        errors.append(epipolar_errors(rig.cameras[first], rig.cameras[second], *uv))
    return float(np.median(np.concatenate(errors)))


def render_scores(
    capture: Capture, names: Sequence[tuple[str, Sequence[str]]]
) -> list[dict[str, float]]:
    """PSNR and SSIM of views by their sources; the target takes no part in depth."""
    maker, scores = SampleMaker(capture, DepthRunOptions().options()), []
    for target, sources in names:
        camera = capture.camera(target)
        instant = maker.instant(camera, [capture.camera(source) for source in sources])
        image, truth = quantise(find_method(METHOD).make().step(instant).image), maker.image(camera)
        scores.append({"PSNR": psnr(image, truth), "SSIM": ssim(image, truth)})
    return scores


if __name__ == "__main__":
    main()
