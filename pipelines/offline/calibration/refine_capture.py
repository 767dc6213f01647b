"""Poses and focal lengths of a capture, refined from the given ones by features that neighbours
share.

A fixed rig is refined by several instants, a carried camera by its single one: each of its pictures
is a camera. Pairs are chosen by the given poses, so that matching grows with the number of pictures
and not with its square.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera, nearest_rotation
from ggvs_eval.capture import Capture
from ggvs_eval.errors import CaptureError
from ggvs_eval.geometry.epipolar import (
    LONGEST_SIDE_PX,
    MatchedPair,
    epipolar_errors,
    find_features,
    match_pair,
    neighbour_pairs,
)
from ggvs_eval.pipelines.offline.calibration import bundle_adjustment
from ggvs_eval.progress import track
from ggvs_eval.side_process import SideProcess, SideProcessError

NEIGHBOURS = 8  # that each camera is matched with
# of a fixed rig, evenly spaced up to the last, since videos are decoded from their beginning
INSTANTS, LAST_INSTANT = 3, 30
# from which on focal lengths are free; of fewer, a lens trades them for a turn of the camera
FEWEST_CAMERAS = 8
FEWEST_POINTS = 20  # that a camera sees, below which it keeps its given pose
_ADJUSTER = SideProcess(Path(bundle_adjustment.__file__))


def match_capture(capture: Capture) -> list[MatchedPair]:
    """Match features of near cameras, each pair once per instant."""
    cameras = capture.cameras
    instants = np.unique(
        np.linspace(0, min(capture.n_frames - 1, LAST_INSTANT), INSTANTS).round().astype(int)
    )
    pairs = neighbour_pairs(cameras, NEIGHBOURS)
    matched = []
    for frame in instants.tolist():
        features = [
            find_features(capture.frame(name, frame))
            for name in track(capture.camera_names, "features for poses")
        ]
        for first, second in track(pairs, "matching for poses"):
            longest_px = max(*cameras[first].size, *cameras[second].size)
            matched.append(match_pair(first, second, features[first], features[second], longest_px))
    return [pair for pair in matched if pair]


def epipolar_residual(cameras: Sequence[Camera], pairs: Sequence[MatchedPair]) -> float | None:
    """Return the median over pairs of their median epipolar errors; None without pairs.

    Returns:
        Pixels of the pictures that features are found in, which have at most `LONGEST_SIDE_PX`.
    """
    medians = []
    for pair in pairs:
        first, second = cameras[pair.first], cameras[pair.second]
        if not np.allclose(first.centre, second.centre):
            errors = epipolar_errors(first, second, pair.uv_first, pair.uv_second)
            medians.append(np.median(errors) / _pixel([first, second]))
    return float(np.median(medians)) if medians else None


def refine_cameras(
    path: Path, cameras: Sequence[Camera], pairs: Sequence[MatchedPair]
) -> tuple[tuple[Camera, ...], int]:
    """Adjust poses, and focal lengths where there are enough cameras, to matched features.

    Equal lenses stay equal.

    Args:
        path: of the capture, for errors.
        pairs: of `match_capture`.

    Returns:
        The cameras in the world of the given ones, in their order; one that sees too little keeps
        its pose. And the number of points.

    Raises:
        CaptureError: no two cameras share enough, or pycolmap fails.

    Reading:
        The world stays: rotations of all cameras agree with the given ones best, then centres by
        scale and shift. A similarity of the centres alone leaves a rotation open where they are on
        a line. One factor moves both focal lengths of a lens; principal points stay, as in COLMAP,
        and distortion, which frames have been freed of.
    """
    keys = [(camera.size, camera.K.tobytes()) for camera in cameras]
    lenses = {
        key: float(camera.K[0, 0]) / _pixel(cameras)
        for key, camera in zip(keys, cameras, strict=True)
    }
    # of a camera's features, by their places
    numbers: list[dict[tuple[float, float], int]] = [{} for _ in cameras]
    matches: dict[tuple[int, int], list[Array]] = {}
    for pair in pairs:
        rows = []
        for camera, uv in ((pair.first, pair.uv_first), (pair.second, pair.uv_second)):
            rays = np.column_stack([uv, np.ones(len(uv))]) @ np.linalg.inv(cameras[camera].K).T
            features = numbers[camera]
            rows.append(
                [
                    features.setdefault((x, y), len(features))
                    for x, y, _ in (lenses[keys[camera]] * rays).tolist()
                ]
            )
        matches.setdefault((pair.first, pair.second), []).append(np.transpose(rows))
    request = {
        "focal": list(lenses.values()),
        "cameras": [
            ([*lenses].index(key), camera.world_to_camera[:3], list(features))
            for key, camera, features in zip(keys, cameras, numbers, strict=True)
        ],
        "matches": [
            (*pair, np.unique(np.concatenate(parts), axis=0)) for pair, parts in matches.items()
        ],
        "free_focal": len(cameras) >= FEWEST_CAMERAS,
    }
    try:
        answer = _ADJUSTER.ask(request)
    except SideProcessError as error:
        raise CaptureError(
            f"{path}: wanted refined poses, pycolmap said: {error}; use the given ones"
        ) from error
    places = np.flatnonzero(np.array(answer["points_seen"]) >= FEWEST_POINTS).tolist()
    if len(places) < 2:
        raise CaptureError(
            f"{path}: wanted refined poses, got {answer['n_points']} shared points; use the given "
            f"ones"
        )
    refined, focal = list(cameras), dict(zip(lenses, answer["focal"], strict=True))
    poses = _in_world([cameras[place] for place in places], np.array(answer["poses"])[places])
    for place, pose in zip(places, poses, strict=True):
        K = cameras[place].K.copy()
        K[[0, 1], [0, 1]] *= focal[keys[place]] / lenses[keys[place]]
        refined[place] = replace(cameras[place], K=K, world_to_camera=pose)
    return tuple(refined), answer["n_points"]


def _in_world(cameras: Sequence[Camera], poses: Array) -> Array:
    """Return poses (N, 3, 4) of a world of their own as (N, 4, 4) in that of given cameras."""
    turns, centres = poses[:, :, :3], np.array([camera.centre for camera in cameras])
    turn, _ = nearest_rotation(
        np.mean(
            [camera.rotation.T @ pose for camera, pose in zip(cameras, turns, strict=True)], axis=0
        )
    )
    turned = -np.einsum("nji,nj->ni", turns, poses[:, :, 3]) @ turn.T
    turned -= turned.mean(axis=0)
    scale = (turned * (centres - centres.mean(axis=0))).sum() / np.square(turned).sum()
    placed = np.tile(np.eye(4), (len(poses), 1, 1))
    placed[:, :3, :3] = turns @ turn.T
    placed[:, :3, 3] = -np.einsum(
        "nij,nj->ni", placed[:, :3, :3], centres.mean(axis=0) + scale * turned
    )
    return placed


def _pixel(cameras: Sequence[Camera]) -> float:
    """Return the pixel of the pictures that features are found in, pixels of the cameras."""
    return max(1.0, max(max(camera.size) for camera in cameras) / LONGEST_SIDE_PX)
