"""World units per metre, where they come from, and the sizes that they imply."""

from collections.abc import Mapping

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.capture import Capture
from ggvs_eval.pipelines.inspection.capture.depth_range import neighbour_spacing
from ggvs_eval.pipelines.inspection.finding import RIG, Finding

QUESTION = "units"
GUESS = "guess"
# Rooms, stages and streets; rigs from a phone's pair of lenses to a stadium's.
SCENE_M, SPACING_M = (0.2, 100.0), (0.005, 10.0)


def check_scale(capture: Capture, depths: Mapping[int, Array]) -> tuple[Finding, ...]:
    """Evaluate the scale by the metres it gives for the scene's depth and the cameras' spacing.

    Args:
        depths: depths of triangulated matches per camera, world units, where there are any.
    """
    medians = [float(np.median(values)) for values in depths.values() if len(values)]
    depth = float(np.median(medians or [np.sqrt(camera.near * camera.far) for camera in capture.cameras]))
    depth_m = depth / capture.units_per_metre
    spacing_m = (
        float(np.median(neighbour_spacing(capture.cameras))) / capture.units_per_metre if len(capture.cameras) > 1 else np.nan
    )
    values: dict[str, object] = {
        "units_per_metre": capture.units_per_metre,
        "origin": capture.units_origin,
        "median_depth_m": round(depth_m, 4),
    }
    if capture.units_origin.startswith(GUESS):
        return (_guessed(capture, depth, spacing_m * capture.units_per_metre, values),)
    measured = f"{capture.units_per_metre:.4g} units per metre ({capture.units_origin}): scene {depth_m:.2f} m away"
    if np.isfinite(spacing_m):
        values["spacing_m"] = round(spacing_m, 4)
        measured += f", neighbours {100 * spacing_m:.0f} cm apart"
    if not SCENE_M[0] < depth_m < SCENE_M[1] or not (np.isnan(spacing_m) or SPACING_M[0] < spacing_m < SPACING_M[1]):
        return (Finding(RIG, QUESTION, "warn", measured, values, "measure a baseline and give the units (--units)"),)
    return (Finding(RIG, QUESTION, "ok", measured, values),)


def _guessed(capture: Capture, depth: float, spacing: float, values: dict[str, object]) -> Finding:
    """Return the finding in world units, for a capture of which nothing is known in metres."""
    near, far = min(camera.near for camera in capture.cameras), max(camera.far for camera in capture.cameras)
    measured = f"metres are not known; in world units the scene lies within {near:.3g} .. {far:.3g}, {depth:.3g} at the median"
    if np.isfinite(spacing):
        values["spacing_units"] = round(spacing, 4)
        measured += f", neighbours {spacing:.3g} apart"
    measured += f"; {capture.units_per_metre:.4g} units are taken for a metre ({capture.units_origin})"
    advice = "measure one baseline or two points and give it (units.toml); thresholds in metres depend on it"
    return Finding(RIG, QUESTION, "warn", measured, values, advice)
