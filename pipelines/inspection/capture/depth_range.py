"""Depth of the views: near and far of each camera, and how much of its picture neighbours see too.

Near and far are checked against the distance of the neighbours and the depths that matches show.
"""

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera, nearest_cameras
from ggvs_eval.datasets.depth_range import neighbour_distances
from ggvs_eval.finding import RIG, Finding, Verdict
from ggvs_eval.geometry.sight import LEAST_SHOWN, advise_sight, describe_sight, shown_share

DEPTH_QUESTION = "depth range"
# Share of matched points that may be outside near .. far; percentiles of the scene leave out a few
# by definition.
WARN_OUTSIDE, BAD_OUTSIDE = 0.15, 0.5
# Neighbours between a thousandth of the depth (no parallax) and the depth itself (nothing in
# common).
LEAST_BASELINE, LARGEST_BASELINE = 1e-3, 1.5
FEWEST_POINTS = 30
OVERLAP_QUESTION = "overlap"
SOURCES = 4  # views that the method blends
# Depth of a point needs two other views; below 40 % most of the picture would be guessed.
LEAST_SHARE, LEAST_VIEWS = 0.4, 2
GRID, DEPTHS = 24, 5


def check_depth_range(
    cameras: Sequence[Camera], depths: Mapping[int, Array], doubtful: Collection[int] = ()
) -> tuple[Finding, ...]:
    """Evaluate near and far of every camera.

    Args:
        depths: depths of triangulated matches per camera, world units, if there are any.
    """
    spacing = neighbour_spacing(cameras)
    typical = float(np.median([np.sqrt(camera.near * camera.far) for camera in cameras]))
    ratio = float(np.median(spacing)) / typical
    evaluated = [
        _evaluate_range(camera, depths.get(index, np.empty(0)), index in doubtful)
        for index, camera in enumerate(cameras)
    ]
    nearest, farthest = (
        min(camera.near for camera in cameras),
        max(camera.far for camera in cameras),
    )
    values = {
        "near": round(nearest, 4),
        "far": round(farthest, 4),
        "spacing_over_depth": round(ratio, 5),
    }
    text = (
        f"{nearest:.3g} .. {farthest:.3g} units, neighbours {100 * ratio:.1f} % of the depth apart"
    )
    if not LEAST_BASELINE < ratio < LARGEST_BASELINE:
        advice = "poses and depth bounds in different units?"
        return (
            Finding(
                subject=RIG,
                question=DEPTH_QUESTION,
                verdict="warn",
                measured=text,
                values=values,
                advice=advice,
            ),
            *evaluated,
        )
    return (
        Finding(subject=RIG, question=DEPTH_QUESTION, verdict="ok", measured=text, values=values),
        *evaluated,
    )


def neighbour_spacing(cameras: Sequence[Camera]) -> Array:
    """Return the distance of each camera to its nearest neighbour, world units, (N,)."""
    return neighbour_distances(np.stack([camera.centre for camera in cameras]))


def _evaluate_range(camera: Camera, depths: Array, is_doubtful: bool) -> Finding:
    values: dict[str, object] = {"near": round(camera.near, 4), "far": round(camera.far, 4)}
    if len(depths) < FEWEST_POINTS:
        reason = (
            "its calibration is in doubt, see epipolar error"
            if is_doubtful
            else f"{len(depths)} matched points with a depth"
        )
        return Finding(
            subject=camera.name,
            question=DEPTH_QUESTION,
            verdict="unknown",
            measured=reason,
            values=values,
        )
    outside = float(((depths < camera.near) | (depths > camera.far)).mean())
    low, high = np.percentile(depths, [2, 98])
    values |= {
        "outside_share": round(outside, 4),
        "seen_near": round(float(low), 4),
        "seen_far": round(float(high), 4),
    }
    verdict: Verdict = (
        "bad" if outside > BAD_OUTSIDE else "warn" if outside > WARN_OUTSIDE else "ok"
    )
    text = (
        f"{100 * outside:.0f} % of {len(depths)} points outside {camera.near:.3g} .. "
        f"{camera.far:.3g}"
    )
    text += f", seen {low:.3g} .. {high:.3g}"
    advice = (
        "" if verdict == "ok" else f"set near and far to about {0.9 * low:.3g} and {1.1 * high:.3g}"
    )
    return Finding(
        subject=camera.name,
        question=DEPTH_QUESTION,
        verdict=verdict,
        measured=text,
        values=values,
        advice=advice,
    )


def check_overlap(cameras: Sequence[Camera], sensed: Collection[str] = ()) -> tuple[Finding, ...]:
    """Measure the share of each picture, over the depths from near to far, that at least two of the
    four nearest cameras see.

    Where these could not show enough of it for a test view, that is said instead; it is bad where
    none can be one.
    """
    if len(cameras) < 2:
        return (
            Finding(
                subject=RIG,
                question=OVERLAP_QUESTION,
                verdict="unknown",
                measured="one camera alone",
            ),
        )
    shares = np.array([seen_share(camera, cameras) for camera in cameras])
    evaluated = []
    blind = {
        camera.name: finding
        for camera in cameras
        if (finding := _blindness(camera, cameras, sensed)) is not None
    }
    for camera, share in zip(cameras, shares, strict=True):
        if camera.name in blind:
            evaluated.append(blind[camera.name])
            continue
        is_little = share < LEAST_SHARE
        advice = "add cameras between, or remove it from the test views" if is_little else ""
        text = f"{100 * share:.0f} % of the picture seen by {LEAST_VIEWS} of {SOURCES} neighbours"
        evaluated.append(
            Finding(
                subject=camera.name,
                question=OVERLAP_QUESTION,
                verdict="warn" if is_little else "ok",
                measured=text,
                values={"share": round(float(share), 4)},
                advice=advice,
            )
        )
    text = (
        f"median {100 * np.median(shares):.0f} %, least {100 * shares.min():.0f} % seen by "
        f"{LEAST_VIEWS} of {SOURCES} neighbours"
    )
    values = {"median_share": round(float(np.median(shares)), 4)}
    if len(blind) == len(cameras):
        worst = min(blind.values(), key=lambda finding: finding.values["shown_share"])
        text = f"no camera can be synthesised from the others; {worst.subject}: {worst.measured}"
        return (
            Finding(
                subject=RIG,
                question=OVERLAP_QUESTION,
                verdict="bad",
                measured=text,
                values=values,
                advice=worst.advice,
            ),
            *evaluated,
        )
    return (
        Finding(subject=RIG, question=OVERLAP_QUESTION, verdict="ok", measured=text, values=values),
        *evaluated,
    )


def _blindness(
    camera: Camera, cameras: Sequence[Camera], sensed: Collection[str]
) -> Finding | None:
    """Return the finding on a camera of which its nearest cameras can show too little for a test
    view; None on any other.
    """
    sources = nearest_cameras(camera, cameras, min(SOURCES, len(cameras) - 1))
    share = shown_share(camera, sources, cameras, sensed)
    if share >= LEAST_SHOWN:
        return None
    advice = advise_sight(camera, len(sources), cameras, sensed)
    return Finding(
        subject=camera.name,
        question=OVERLAP_QUESTION,
        verdict="warn",
        measured=describe_sight(camera, sources, share),
        values={"shown_share": round(share, 4)},
        advice=advice,
    )


def seen_share(camera: Camera, cameras: Sequence[Camera]) -> float:
    """Share of a grid of pixels and depths (even steps of disparity) that enough of the nearest
    cameras see; nothing occludes.
    """
    neighbours = nearest_cameras(camera, cameras, min(SOURCES, len(cameras) - 1))
    columns, rows = ((np.arange(GRID) + 0.5) / GRID * side for side in camera.size)
    uv = np.stack(np.meshgrid(columns, rows), axis=-1)[None]  # (1, G, G, 2)
    depth = 1 / np.linspace(1 / camera.far, 1 / camera.near, DEPTHS)[:, None, None]
    points = camera.unproject(
        np.broadcast_to(uv, (DEPTHS, GRID, GRID, 2)), np.broadcast_to(depth, (DEPTHS, GRID, GRID))
    )
    n_views = np.zeros((DEPTHS, GRID, GRID), int)
    for neighbour in neighbours:
        at, z = neighbour.project(points)
        n_views += (z > 0) & (at >= 0).all(axis=-1) & (at <= np.array(neighbour.size)).all(axis=-1)
    return float((n_views >= min(LEAST_VIEWS, len(neighbours))).mean())
