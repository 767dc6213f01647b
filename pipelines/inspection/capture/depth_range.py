"""Near and far of each camera against its neighbours' distance and the depths that matches show."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera
from ggvs_eval.datasets.depth_range import neighbour_distances
from ggvs_eval.pipelines.inspection.finding import RIG, Finding, Verdict

QUESTION = "depth range"
# Share of matched points that may lie outside near .. far; percentiles of the scene leave out a few by definition.
WARN_OUTSIDE, BAD_OUTSIDE = 0.15, 0.5
# Neighbours between a thousandth of the depth (no parallax) and the depth itself (nothing in common).
LEAST_BASELINE, LARGEST_BASELINE = 1e-3, 1.5
FEWEST_POINTS = 30


def check_depth_range(
    cameras: Sequence[Camera], depths: Mapping[int, Array], doubtful: Collection[int] = ()
) -> tuple[Finding, ...]:
    """Evaluate near and far of every camera.

    Args:
        depths: depths of triangulated matches per camera, world units, where there are any.
    """
    spacing = neighbour_spacing(cameras)
    typical = float(np.median([np.sqrt(camera.near * camera.far) for camera in cameras]))
    ratio = float(np.median(spacing)) / typical
    evaluated = [_evaluate(camera, depths.get(index, np.empty(0)), index in doubtful) for index, camera in enumerate(cameras)]
    nearest, farthest = min(camera.near for camera in cameras), max(camera.far for camera in cameras)
    values = {"near": round(nearest, 4), "far": round(farthest, 4), "spacing_over_depth": round(ratio, 5)}
    measured = f"{nearest:.3g} .. {farthest:.3g} units, neighbours {100 * ratio:.1f} % of the depth apart"
    if not LEAST_BASELINE < ratio < LARGEST_BASELINE:
        advice = "poses and depth bounds in different units?"
        return (Finding(RIG, QUESTION, "warn", measured, values, advice), *evaluated)
    return (Finding(RIG, QUESTION, "ok", measured, values), *evaluated)


def neighbour_spacing(cameras: Sequence[Camera]) -> Array:
    """Distance of each camera to its nearest neighbour, world units, (N,)."""
    return neighbour_distances(np.stack([camera.centre for camera in cameras]))


def _evaluate(camera: Camera, depths: Array, is_doubtful: bool) -> Finding:
    values: dict[str, object] = {"near": round(camera.near, 4), "far": round(camera.far, 4)}
    if len(depths) < FEWEST_POINTS:
        reason = (
            "its calibration is in doubt, see epipolar error" if is_doubtful else f"{len(depths)} matched points with a depth"
        )
        return Finding(camera.name, QUESTION, "unknown", reason, values)
    outside = float(((depths < camera.near) | (depths > camera.far)).mean())
    low, high = np.percentile(depths, [2, 98])
    values |= {"outside_share": round(outside, 4), "seen_near": round(float(low), 4), "seen_far": round(float(high), 4)}
    verdict: Verdict = "bad" if outside > BAD_OUTSIDE else "warn" if outside > WARN_OUTSIDE else "ok"
    measured = f"{100 * outside:.0f} % of {len(depths)} points outside {camera.near:.3g} .. {camera.far:.3g}"
    measured += f", seen {low:.3g} .. {high:.3g}"
    advice = "" if verdict == "ok" else f"set near and far to about {0.9 * low:.3g} and {1.1 * high:.3g}"
    return Finding(camera.name, QUESTION, verdict, measured, values, advice)
