"""Overlap of the views: how much of each picture its neighbours see too."""

from collections.abc import Collection, Sequence

import numpy as np

from ggvs_eval.camera import Camera, nearest_cameras
from ggvs_eval.geometry.sight import LEAST_SHOWN, advise_sight, describe_sight, shown_share
from ggvs_eval.pipelines.inspection.finding import RIG, Finding

QUESTION = "overlap"
SOURCES = 4  # views that the method blends
# Depth of a point needs two other views; below 40 % most of the picture would be guessed.
LEAST_SHARE, LEAST_VIEWS = 0.4, 2
GRID, DEPTHS = 24, 5


def check_overlap(cameras: Sequence[Camera], sensed: Collection[str] = ()) -> tuple[Finding, ...]:
    """Measure the share of each picture, over the depths from near to far, that at least two of the four nearest cameras see.

    Where these could not show enough of it for a test view, that is said instead; it is bad where none can be one.
    """
    if len(cameras) < 2:
        return (Finding(RIG, QUESTION, "unknown", "one camera alone"),)
    shares = np.array([seen_share(camera, cameras) for camera in cameras])
    evaluated = []
    blind = {camera.name: finding for camera in cameras if (finding := _blindness(camera, cameras, sensed)) is not None}
    for camera, share in zip(cameras, shares, strict=True):
        if camera.name in blind:
            evaluated.append(blind[camera.name])
            continue
        is_little = share < LEAST_SHARE
        advice = "add cameras between, or leave it out of the test views" if is_little else ""
        measured = f"{100 * share:.0f} % of the picture seen by {LEAST_VIEWS} of {SOURCES} neighbours"
        evaluated.append(
            Finding(camera.name, QUESTION, "warn" if is_little else "ok", measured, {"share": round(float(share), 4)}, advice)
        )
    measured = (
        f"median {100 * np.median(shares):.0f} %, least {100 * shares.min():.0f} % seen by {LEAST_VIEWS} of {SOURCES} neighbours"
    )
    values = {"median_share": round(float(np.median(shares)), 4)}
    if len(blind) == len(cameras):
        worst = min(blind.values(), key=lambda finding: finding.values["shown_share"])
        measured = f"no camera can be synthesised from the others; {worst.subject}: {worst.measured}"
        return (Finding(RIG, QUESTION, "bad", measured, values, worst.advice), *evaluated)
    return (Finding(RIG, QUESTION, "ok", measured, values), *evaluated)


def _blindness(camera: Camera, cameras: Sequence[Camera], sensed: Collection[str]) -> Finding | None:
    """Return the finding on a camera of which its nearest cameras can show too little for a test view; None on any other."""
    sources = nearest_cameras(camera, cameras, min(SOURCES, len(cameras) - 1))
    share = shown_share(camera, sources, cameras, sensed)
    if share >= LEAST_SHOWN:
        return None
    advice = advise_sight(camera, len(sources), cameras, sensed)
    return Finding(
        camera.name, QUESTION, "warn", describe_sight(camera, sources, share), {"shown_share": round(share, 4)}, advice
    )


def seen_share(camera: Camera, cameras: Sequence[Camera]) -> float:
    """Share of a grid of pixels and depths (even steps of disparity) that enough of the nearest cameras see; nothing occludes."""
    others = nearest_cameras(camera, cameras, min(SOURCES, len(cameras) - 1))
    columns, rows = ((np.arange(GRID) + 0.5) / GRID * side for side in camera.size)
    uv = np.stack(np.meshgrid(columns, rows), axis=-1)[None]  # (1, G, G, 2)
    depth = 1 / np.linspace(1 / camera.far, 1 / camera.near, DEPTHS)[:, None, None]
    points = camera.unproject(np.broadcast_to(uv, (DEPTHS, GRID, GRID, 2)), np.broadcast_to(depth, (DEPTHS, GRID, GRID)))
    n_views = np.zeros((DEPTHS, GRID, GRID), int)
    for other in others:
        at, z = other.project(points)
        n_views += (z > 0) & (at >= 0).all(axis=-1) & (at <= np.array(other.size)).all(axis=-1)
    return float((n_views >= min(LEAST_VIEWS, len(others))).mean())
