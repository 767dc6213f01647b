"""Depth of a real rig against the sparse points it was calibrated by: of every camera, at the
pixels where it saw them.

Sparse points are where there is texture. Depth that is good there can be garbage on walls and
blinds, so this check must not are not enough: the room's regions and the rendering of left-out
views supplement it.
"""

import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from time import process_time

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks.depth_validation.depth_errors import WITHIN, relative_errors
from benchmarks.depth_validation.figures import Figures, Measure, figures_of
from benchmarks.depth_validation.tables import Column, mean_of_rows, wide_table
from ggvs_eval.arrays import Map
from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.datasets.colmap import find_model
from ggvs_eval.errors import CaptureError, DepthError
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthEstimator, DepthOptions
from ggvs_eval.progress import track

READER = "benchmarks.depth_validation.sparse_reader"
MIN_OBSERVATIONS = 3  # of a point; two views that agree may both be wrong along their rays
MAX_REPROJECTION_PX = 1.0  # of a point, in the images that were calibrated
MEASURES = (
    Measure("within_2_percent", "% of points", higher_is_better=True, target=93.0),
    Measure("median_error_percent", "%", higher_is_better=False, target=0.35),
    Measure("cpu_seconds", "CPU s per camera", higher_is_better=False),
)


@dataclass(frozen=True, eq=False)
class SparsePoints:
    """Sparse points observed by one camera.

    Attributes:
        uv: where, pixels of that camera, (N, 2).
        depth: z in that camera, world units, (N,).
    """

    uv: NDArray[np.float64]
    depth: NDArray[np.float64]


def read_sparse_points(capture: Capture) -> dict[str, SparsePoints]:
    """Return the points that each camera of a COLMAP capture saw, at the capture's size, by the
    cameras' names.

    Reading:
        A point counts with three or more observations and a mean reprojection error below one pixel
        of the calibrated images.

    Raises:
        CaptureError: no model, a damaged one, or one whose cameras distort.
    """
    model = find_model(capture.path)
    if model is None:
        raise CaptureError(
            f"{capture.path}: wanted a COLMAP model with points, found none; calibrate the capture "
            f"first"
        )
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "points.npz"
        done = subprocess.run(
            [sys.executable, "-m", READER, str(model), str(file)],
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            reason = (
                done.stderr.strip().splitlines() or [f"the reader ended with {done.returncode}"]
            )[-1]
            raise CaptureError(
                f"{model}: its points cannot be read, pycolmap says '{reason:.200}'; export the "
                f"model again"
            )
        with np.load(file) as arrays:
            parts = np.split(arrays["rows"], np.cumsum(arrays["counts"])[:-1])
            rows = {
                _camera_name(str(name)): part
                for name, part in zip(arrays["names"], parts, strict=True)
            }
    return {name: choose_points(rows[name], capture.camera(name)) for name in capture.camera_names}


def choose_points(rows: NDArray[np.float64], camera: Camera) -> SparsePoints:
    """Return the points worth comparing with, of one camera's rows as
    `sparse_reader.read_observations` gives them.
    """
    uv, depth = rows[:, :2] * camera.size, rows[:, 2]
    inside = ((uv >= 0) & (uv < camera.size)).all(axis=1)
    sure = (rows[:, 3] >= MIN_OBSERVATIONS) & (rows[:, 4] >= 0) & (rows[:, 4] < MAX_REPROJECTION_PX)
    chosen = inside & sure & (depth > 0)
    return SparsePoints(uv[chosen], depth[chosen])


def score_points(depth: Map, points: SparsePoints) -> dict[str, float]:
    """Return the depth at the pixels that hold the observations, against those of the points.

    Args:
        depth: (H, W), world units, 0 = no depth, which counts as an error of 100 %.
        points: what the camera saw.

    Returns:
        Share of the points within 2 % and median relative error, both in percent.

    Raises:
        DepthError: no points.
    """
    if not len(points.depth):
        raise DepthError(
            "sparse points: wanted at least one point to compare with, got none; leave this camera "
            "out"
        )
    columns, rows = np.floor(points.uv).astype(np.intp).T
    errors = relative_errors(depth[rows, columns], points.depth.astype(np.float32))
    return {
        "within_2_percent": float(100 * (errors <= WITHIN).mean()),
        "median_error_percent": float(100 * np.median(errors)),
    }


def evaluate_sparse(
    capture: Capture, options: Mapping[str, DepthOptions]
) -> tuple[pd.DataFrame, Figures]:
    """Return the first instant of every camera, each matched with partners chosen among all others.

    Args:
        capture: a COLMAP capture at the size that is evaluated.
        options: of each matcher, by name.

    Returns:
        A table, one row per camera, columns (matcher, measure), and figures of the means over the
        cameras. Seconds are those of all threads for one depth map once the estimator is ready.
    """
    points = read_sparse_points(capture)
    images = {
        name: capture.frame(name, 0)
        for name in track(capture.camera_names, "reading the sparse capture")
    }
    rows: dict[str, dict[Column, float]] = {name: {} for name in capture.camera_names}
    for matcher, each in options.items():
        for camera in track(capture.cameras, f"sparse points, {matcher}"):
            partners = each.choose_partners(camera, capture.cameras)
            estimator = DepthEstimator(camera, partners, each)
            start = process_time()
            depth = estimator.estimate(
                images[camera.name], [images[partner.name] for partner in partners]
            ).depth
            seconds = process_time() - start
            scores = score_points(depth, points[camera.name]) | {"cpu_seconds": seconds}
            rows[camera.name] |= {(matcher, measure): value for measure, value in scores.items()}
    table = wide_table(rows)
    return table, figures_of("sparse", MEASURES, mean_of_rows(table))


def _camera_name(image_name: str) -> str:
    """As ggvs_eval.datasets.colmap calls the camera of an image."""
    name = PurePosixPath(image_name)
    return name.parent.name or name.stem
