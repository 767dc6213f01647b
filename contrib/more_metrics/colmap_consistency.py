"""COLMAP consistency of a rendered path: whether structure from motion believes that the images
show one scene from it.
"""

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.camera import Camera
from ggvs_eval.contrib.more_metrics import colmap_worker
from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.inputs import Image
from ggvs_eval.metrics.metric import Value
from ggvs_eval.metrics.path.rendered_path import (
    PathMetric,
    PathScorer,
    RenderedPath,
    whole_path,
    write_view,
)
from ggvs_eval.metrics.path.view_consistency import PATH_SHARPNESS

NAMES = ("COLMAP_registered", "COLMAP_track_length", "COLMAP_matches")
OVERLAP = 5  # each view is matched with N that follow
LEAST_VIEWS, MOST_VIEWS = 5, 60
TRIMMED_FITS, KEPT_SHARE = 8, 0.75
TINY = float(np.finfo(float).tiny)
Points = NDArray[np.float64]  # (V, 3), or rotations (V, 3, 3)


@dataclass(frozen=True)
class ColmapConsistency:
    """Result of structure from motion on a path.

    Attributes:
        registered: share of the views whose camera COLMAP finds, and finds where it belongs, 0 to
            1; higher is better.
        track_length: of these views per point of the model, mean, 0 without one. Blur, which leaves
            the strong points, raises it.
        matches: geometrically verified matches of a view with the next, mean; blur lowers it, one
            frozen image raises it.
        n_views: views that were looked at.
    """

    registered: float
    track_length: float
    matches: float
    n_points: int
    n_views: int


def colmap_consistency(
    images: Iterable[Image], cameras: Sequence[Camera] | None = None
) -> ColmapConsistency:
    """Solve the path from its images alone by COLMAP (SIFT, sequential matching, incremental
    mapping).

    Args:
        images: views in the order of the path, (H, W, 3), uint8 in 0..255 or float in [0, 1].
        cameras: of each view; None if they are unknown.

    Raises:
        MetricError: fewer than 5 views, another number of cameras, or COLMAP fails.

    Example:
        >>> colmap_consistency([])
        Traceback (most recent call last):
        ...
        ggvs_eval.errors.MetricError: COLMAP consistency: 0 views; needs 5

    Reading:
        After the registration rate, tracks and matches of SysCON3D (2605.18754); what counts is
        chosen here. COLMAP registers shuffled views of one scene as gladly as ordered ones, so
        being registered is not enough. With known cameras a view counts where its solved centre is
        within half a step of its true place after the best similarity, nearer than its neighbours';
        without cameras where the solved path continues from the view before to the view after and
        does not turn back, as two of three views of a shuffled line do. Known lenses are used;
        unknown ones are guessed and held. Of longer paths 60 evenly spaced views are taken.
    """
    with tempfile.TemporaryDirectory(prefix="ggvs-colmap-") as folder:
        count = 0
        for count, image in enumerate(images, start=1):
            write_view(Path(folder), count - 1, image)
        return solve_views(Path(folder), count, cameras)


def solve_views(folder: Path, n_views: int, cameras: Sequence[Camera] | None) -> ColmapConsistency:
    """Run COLMAP on the views that `rendered_path.write_view` has written into a folder.

    Args:
        folder: work continues in it, and what it leaves is left.
        cameras: see `colmap_consistency`.
    """
    if n_views < LEAST_VIEWS:
        raise MetricError(f"COLMAP consistency: {n_views} views; needs {LEAST_VIEWS}")
    if cameras is not None and len(cameras) != n_views:
        raise MetricError(
            f"COLMAP consistency: {n_views} views but {len(cameras)} cameras; give one for each"
        )
    indices = np.unique(
        np.linspace(0, n_views - 1, min(n_views, MOST_VIEWS)).round().astype(int)
    ).tolist()
    path_cameras = None if cameras is None else [cameras[index] for index in indices]
    work = Path(tempfile.mkdtemp(prefix="work", dir=folder))
    (work / "images").mkdir()
    names = [f"{index:06d}.png" for index in indices]
    for name in names:
        (work / "images" / name).hardlink_to(folder / "views" / name)
    lenses = path_cameras and [
        (camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]) for camera in path_cameras
    ]
    (work / "job.json").write_text(
        json.dumps({"images": names, "cameras": lenses, "overlap": OVERLAP}), encoding="utf-8"
    )
    result = _run(work)
    poses = {int(index): pose for index, pose in result["poses"].items()}
    in_place = (
        _at_their_cameras(poses, path_cameras) if path_cameras else _in_order(poses, len(indices))
    )
    return ColmapConsistency(
        registered=int(np.count_nonzero(in_place)) / len(indices),
        track_length=_mean_length(result["tracks"], in_place),
        matches=float(np.mean(result["matches"])),
        n_points=len(result["tracks"]),
        n_views=len(indices),
    )


def _run(work: Path) -> dict[str, Any]:
    """Run COLMAP in a child process, whose output becomes a log."""
    with (work / "colmap.log").open("w", encoding="utf-8") as log:
        code = subprocess.run(
            [sys.executable, "-m", colmap_worker.__name__, str(work)],
            stdout=log,
            stderr=subprocess.STDOUT,
            check=False,
        ).returncode
    if code or not (work / "result.json").is_file():
        lines = [
            line
            for line in (work / "colmap.log")
            .read_text(encoding="utf-8", errors="replace")
            .splitlines()
            if line.strip()
        ]
        raise MetricError(
            f"COLMAP consistency: COLMAP ended with {code}: "
            f"{lines[-1].strip()[-200:] if lines else 'nothing said'}"
        )
    return dict(json.loads((work / "result.json").read_text(encoding="utf-8")))


def _mean_length(tracks: Sequence[Sequence[int]], in_place: NDArray[np.bool_]) -> float:
    """Return the mean number of views in their places that see a point."""
    return (
        float(np.mean([np.count_nonzero(in_place[track]) for track in tracks])) if tracks else 0.0
    )


def _at_their_cameras(poses: dict[int, Any], cameras: Sequence[Camera]) -> NDArray[np.bool_]:
    """Return for each view whether it was solved, and at its camera's place."""
    in_place = np.zeros(len(cameras), dtype=bool)
    if len(poses) < 3:
        return in_place
    indices = sorted(poses)
    centres = np.array([camera.centre for camera in cameras], dtype=np.float64)
    rotations = np.array(
        [cameras[index].world_to_camera[:3, :3] for index in indices], dtype=np.float64
    )
    solved_rotations, solved_centres = (
        np.array([poses[index][part] for index in indices]) for part in (0, 1)
    )
    errors = _aligned_errors(solved_rotations, solved_centres, rotations, centres[indices])
    in_place[indices] = errors <= _half_steps(centres)[indices]
    return in_place


def _aligned_errors(
    solved_rotations: Points, solved_centres: Points, rotations: Points, centres: Points
) -> NDArray[np.float64]:
    """Return the distances of solved centres from the given ones after the similarity that fits
    three quarters of them best.

    The rotation is that of the cameras' axes, since the centres of a straight path leave one around
    it open.
    """
    errors = np.zeros(len(centres))
    for _ in range(TRIMMED_FITS):
        inliers = errors <= np.quantile(errors, KEPT_SHARE)
        left, _, right = np.linalg.svd(
            np.einsum("nij,nik->jk", rotations[inliers], solved_rotations[inliers])
        )
        turned = (
            solved_centres @ (left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right).T
        )
        source, target = (
            turned - turned[inliers].mean(axis=0),
            centres - centres[inliers].mean(axis=0),
        )
        scale = max(float((source * target)[inliers].sum()), 0.0) / max(
            float(np.square(source[inliers]).sum()), TINY
        )
        errors = np.linalg.norm(scale * source - target, axis=1)
    return errors


def _half_steps(centres: Points) -> NDArray[np.float64]:
    """Return half the mean distance of each camera of a path from its neighbours."""
    steps = np.linalg.norm(np.diff(centres, axis=0), axis=1)
    return (np.append(steps[:1], steps) + np.append(steps, steps[-1:])) / 4


def _in_order(poses: dict[int, Any], n_views: int) -> NDArray[np.bool_]:
    """Return for each view whether it was solved, and between its neighbours.

    At the ends the next view decides.
    """
    centres = np.full((n_views, 3), np.nan)
    for index, (_, centre) in poses.items():
        centres[index] = centre
    steps = np.diff(centres, axis=0)
    goes_on = (steps[:-1] * steps[1:]).sum(axis=1) > 0  # comparisons with NaN are false
    return np.concatenate([goes_on[:1], goes_on, goes_on[-1:]])


def _measure(path: RenderedPath) -> list[Value]:
    if path.folder is None:
        raise MetricError(
            "COLMAP consistency: wanted the images of the path, got none; add its metrics to the "
            "protocol"
        )
    consistency = solve_views(path.folder, len(path.cameras), path.cameras)
    return whole_path(NAMES, consistency.registered, consistency.track_length, consistency.matches)


_SCORER = PathScorer(NAMES, _measure, wants_images=True)
_REFERENCE = "after SysCON3D, arXiv 2605.18754; docs/metrics.md"
COLMAP_REGISTERED = PathMetric(
    name="COLMAP_registered",
    function=colmap_consistency,
    higher_is_better=True,
    decimals=3,
    describe="share of the poses at which COLMAP recovers the camera from the images alone",
    reference=_REFERENCE,
    scorer=_SCORER,
    beside=PATH_SHARPNESS.name,
)
COLMAP_TRACK_LENGTH = PathMetric(
    name="COLMAP_track_length",
    function=colmap_consistency,
    unit="views",
    higher_is_better=True,
    decimals=2,
    describe="correctly placed views per point of COLMAP's model of the path; blur raises it",
    reference=_REFERENCE,
    scorer=_SCORER,
    beside=PATH_SHARPNESS.name,
)
COLMAP_MATCHES = PathMetric(
    name="COLMAP_matches",
    function=colmap_consistency,
    higher_is_better=True,
    decimals=0,
    describe="verified matches of each image of the path with the next; one frozen image has most",
    reference=_REFERENCE,
    scorer=_SCORER,
    beside=PATH_SHARPNESS.name,
)
