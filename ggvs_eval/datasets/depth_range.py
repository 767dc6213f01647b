"""A depth range for cameras whose capture gives none: from where the rig looks, or from a cloud of points."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera
from ggvs_eval.errors import CameraError, CaptureError
from ggvs_eval.files.plain import check_plain
from ggvs_eval.files.toml_tables import build_table, read_toml

DEPTH_RANGE_FILE = "depth_range.toml"
RANGE_MEND = (
    f"{DEPTH_RANGE_FILE} with near and far in the capture's folder says it, 'ggvs-eval calibrate --known-poses' measures it"
)

# The scene is assumed to lie between these multiples of the distance to the point that the rig looks at.
NEAR_FACTOR, FAR_FACTOR = 0.25, 4.0
# A rig that looks at no common point sees the scene from these many times the spacing of its cameras on.
NEAR_SPACINGS, FAR_SPACINGS = 5.0, 500.0
LEAST_CONVERGENCE_RAD = 0.02
LARGEST_NUMBER = 1e100
LARGEST_CLOUD = 256 << 20  # bytes
# Cameras around a scene are at most twice as far apart as the middle is far, and that if they are two that face each other.
LEAST_DEPTH_SPACINGS = 0.4
LARGEST_MISS = 0.5
# A little nearer and farther than all but the outermost hundredth of what was measured.
NEAR_MARGIN, FAR_MARGIN = 0.8, 1.2


@dataclass(frozen=True)
class GivenDepthRange:
    """Content of ``depth_range.toml``: least and greatest depth of the scene, world units."""

    near: float
    far: float


class Placed(NamedTuple):
    """A camera whose depth range its capture may not give.

    Attributes:
        K: intrinsics of its pinhole image, (3, 3).
        world_to_camera: (4, 4).
        size: (width, height), pixels.
        near_far: depth range, world units; None where the capture gives none.
    """

    name: str
    K: Array
    world_to_camera: Array
    size: tuple[int, int]
    near_far: tuple[float, float] | None = None


def ranged_cameras(rig: Sequence[Placed], file: Path) -> list[Camera]:
    """The cameras of a rig; those without a depth range get that of `rig_depth_range`, and say that it is guessed."""
    guesses = rig_depth_range([each.world_to_camera for each in rig])
    cameras = []
    for (name, K, pose, size, given), guess in zip(rig, guesses, strict=True):
        try:
            cameras.append(Camera(name, K, pose, *size, *(given or guess), range_origin="given" if given else "guessed"))
        except CameraError as error:
            raise CaptureError(f"{file}: {error}") from error
    return cameras


def given_depth_range(path: Path) -> tuple[float, float] | None:
    """Return near and far of all cameras as ``depth_range.toml`` in a capture's folder gives them; None without that file."""
    file = path / DEPTH_RANGE_FILE
    if not file.exists():
        return None
    given = build_table(GivenDepthRange, read_toml(file, CaptureError), str(file), "", CaptureError)
    if not 0 < given.near < given.far:
        raise CaptureError(f"{file}: wanted 0 < near < far in world units, got {given.near:g} and {given.far:g}; correct it")
    return given.near, given.far


def write_depth_range(path: Path, near: float, far: float) -> None:
    """Write a file that `given_depth_range` reads back."""
    (path / DEPTH_RANGE_FILE).write_text(f"near = {near!r}\nfar = {far!r}\n", encoding="utf-8")


def rig_depth_range(poses: Sequence[Array]) -> list[tuple[float, float]]:
    """Near and far of each camera from the poses alone.

    Args:
        poses: world_to_camera of every camera, each (4, 4).

    Returns:
        (near, far) per camera, world units.

    Reading:
        Where the optical axes converge in front of most cameras, the depth of that point times 1/4 and 4, which holds a person in
        a room as well as a street; where they do not, or miss that point by over half its depth, 5 and 500 times the median
        distance of neighbouring cameras. One camera alone, or all in one place, gets 0.1 and 100.
    """
    if any(pose.shape != (4, 4) or not (np.abs(pose) < LARGEST_NUMBER).all() for pose in poses):
        return [(0.1, 100.0)] * len(poses)  # no poses at all; `Camera` says so better
    rotations = np.stack([pose[:3, :3] for pose in poses])
    centres = np.stack([-pose[:3, :3].T @ pose[:3, 3] for pose in poses])
    spacing = _median_spacing(centres)
    if spacing == 0:
        return [(0.1, 100.0)] * len(poses)
    axes = rotations[:, 2]
    towards = _looked_at(centres, axes) - centres
    depths = (towards * axes).sum(axis=1)
    typical = float(np.median(depths))
    missed = float(np.median(np.linalg.norm(towards - depths[:, None] * axes, axis=1)))
    is_seen = typical > LEAST_DEPTH_SPACINGS * spacing and missed < LARGEST_MISS * typical
    if _convergence_rad(axes) < LEAST_CONVERGENCE_RAD or not is_seen:
        return [(NEAR_SPACINGS * spacing, FAR_SPACINGS * spacing)] * len(poses)
    # A camera that looks elsewhere gets the range of the others.
    trusted = np.where((depths > typical / FAR_FACTOR) & (depths < typical * FAR_FACTOR), depths, typical)
    return [(float(NEAR_FACTOR * depth), float(FAR_FACTOR * depth)) for depth in trusted]


def _looked_at(centres: Array, axes: Array) -> Array:
    """The point nearest to all optical axes, (3,)."""
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    return np.linalg.lstsq(across.sum(axis=0), np.einsum("nij,nj->i", across, centres), rcond=None)[0]


def _median_spacing(centres: Array) -> float:
    if len(centres) < 2:
        return 0.0
    return float(np.median(neighbour_distances(centres)))


def neighbour_distances(centres: Array) -> Array:
    """Distance of each of at least two points to its nearest neighbour, (N,).

    Args:
        centres: (N, 3).
    """
    from scipy.spatial import KDTree

    return np.asarray(KDTree(centres).query(centres, k=2)[0][:, 1])


def _convergence_rad(axes: Array) -> float:
    """Median angle between the axes and their mean."""
    mean = axes.mean(axis=0)
    mean /= max(float(np.linalg.norm(mean)), 1e-12)  # cameras around the scene look in directions that cancel out
    return float(np.median(np.arccos(np.clip(axes @ mean, -1, 1))))


def points_depth_range(
    points_world: Array, pose: Array, K: Array, size: tuple[int, int], fewest: int = 1
) -> tuple[float, float, float] | None:
    """1st, 50th and 99.9th percentile of the depth of the points in a camera's view; None where it sees too few.

    Args:
        points_world: (N, 3).
        pose: world_to_camera, (4, 4).
        K: intrinsics, (3, 3).
        size: of the image, pixels.
    """
    points_camera = points_world @ pose[:3, :3].T + pose[:3, 3]
    points_camera = points_camera[points_camera[:, 2] > 0]
    with np.errstate(over="ignore"):
        uv = points_camera[:, :2] / points_camera[:, 2:] * K[[0, 1], [0, 1]] + K[:2, 2]
    depths = points_camera[((uv >= 0) & (uv <= size)).all(axis=1), 2]
    if len(depths) < fewest:
        return None
    nearest, median, farthest = np.percentile(depths, [1.0, 50.0, 99.9])
    return float(nearest), float(median), float(farthest)


def read_points(path: Path) -> Array:
    """The vertices of a PLY file, (N, 3)."""
    import trimesh

    try:
        check_plain(path, LARGEST_CLOUD)
        # Without materials: a texture that the file names may lie anywhere.
        cloud = trimesh.load(path, process=False, skip_materials=True)
        points = np.asarray(getattr(cloud, "vertices", ()), dtype=np.float64)
    except Exception as error:  # the reader raises whatever a damaged file makes it stumble over
        raise CaptureError(
            f"{path}: wanted a PLY point cloud, got: {' '.join(str(error).split())[:120] or type(error).__name__}; restore it"
        ) from error
    if points.ndim != 2 or points.shape[-1] != 3 or not np.isfinite(points).all() or not len(points):
        raise CaptureError(f"{path}: wanted finite points, got {points.shape} with NaN, infinity or nothing; restore it")
    return points
