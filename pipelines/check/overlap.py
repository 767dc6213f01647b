"""How much of each picture its neighbours see too."""

from collections.abc import Sequence

import numpy as np

from ggvs_eval.camera import Camera, nearest_cameras
from ggvs_eval.pipelines.check.finding import RIG, Finding

QUESTION = "overlap"
SOURCES = 4  # views that the method blends
# Depth of a point needs two other views; below 40 % most of the picture would be guessed.
LEAST_SHARE, LEAST_VIEWS = 0.4, 2
GRID, DEPTHS = 24, 5


def check_overlap(cameras: Sequence[Camera]) -> tuple[Finding, ...]:
    """Share of each picture, over the depths from near to far, that at least two of the four nearest cameras see."""
    if len(cameras) < 2:
        return (Finding(RIG, QUESTION, "unknown", "one camera alone"),)
    shares = np.array([seen_share(camera, cameras) for camera in cameras])
    judged = []
    for camera, share in zip(cameras, shares, strict=True):
        is_little = share < LEAST_SHARE
        advice = "add cameras between, or leave it out of the test views" if is_little else ""
        measured = f"{100 * share:.0f} % of the picture seen by {LEAST_VIEWS} of {SOURCES} neighbours"
        judged.append(
            Finding(camera.name, QUESTION, "warn" if is_little else "ok", measured, {"share": round(float(share), 4)}, advice)
        )
    measured = (
        f"median {100 * np.median(shares):.0f} %, least {100 * shares.min():.0f} % seen by {LEAST_VIEWS} of {SOURCES} neighbours"
    )
    rig = Finding(RIG, QUESTION, "ok", measured, {"median_share": round(float(np.median(shares)), 4)})
    return (rig, *judged)


def seen_share(camera: Camera, cameras: Sequence[Camera]) -> float:
    """Share of a grid of pixels and depths (even steps of disparity) that enough of the nearest cameras see; nothing occludes."""
    others = nearest_cameras(camera, cameras, min(SOURCES, len(cameras) - 1))
    columns, rows = ((np.arange(GRID) + 0.5) / GRID * side for side in camera.size)
    uv = np.stack(np.meshgrid(columns, rows), axis=-1)[None]  # (1, G, G, 2)
    depth = 1 / np.linspace(1 / camera.far, 1 / camera.near, DEPTHS)[:, None, None]
    points = camera.unproject(np.broadcast_to(uv, (DEPTHS, GRID, GRID, 2)), np.broadcast_to(depth, (DEPTHS, GRID, GRID)))
    seen = np.zeros((DEPTHS, GRID, GRID), int)
    for other in others:
        at, z = other.project(points)
        seen += (z > 0) & (at >= 0).all(axis=-1) & (at <= np.array(other.size)).all(axis=-1)
    return float((seen >= min(LEAST_VIEWS, len(others))).mean())
