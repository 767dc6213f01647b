"""Weights of Distance-based Blending against LLFF's formula, worked out by hand."""

from dataclasses import replace

import numpy as np

from ggvs_eval.baselines.fixed_blending import distance_weights
from helpers.scenes import FOCAL, camera_at


def test_the_nearest_depth_of_any_source_sets_the_falloff():
    """exp(-f / (32 z0) (d - d0)): two sources half a unit apart in distance, near planes at 2 and
    5.
    """
    sources = [replace(camera_at(0.25), near=5.0), camera_at(0.75)]

    np.testing.assert_allclose(
        distance_weights(camera_at(0.0), sources), [1, np.exp(-FOCAL / (32 * 2.0) * 0.5)]
    )
