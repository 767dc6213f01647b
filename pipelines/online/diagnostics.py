"""What the online method decided on the way to its image, for people who ask why a pixel flickers."""

from collections.abc import Sequence

import numpy as np

from ggvs_eval.arrays import Map
from ggvs_eval.geometry.splat import Splat
from ggvs_eval.pipelines.online.recurrent_output import REDUCTION


def diagnostics_maps(depth: Map | None, splats: Sequence[Splat], still: Map, weights: Map | None) -> dict[str, Map]:
    """The maps of `Rendering.inside`, at a quarter of the size: every fourth pixel, which costs next to nothing.

    Args:
        depth: fused depth, (H, W), world units, 0 where unknown; None without fusion.
        splats: forward renderings of the views.
        still: how sure it is that nothing moves, see `stillness`, (h, w).
        weights: share of each view, (K, h, w), if the blender tells.
    """
    cells = np.s_[::REDUCTION, ::REDUCTION]
    coverage = np.maximum.reduce([view.alpha[cells] for view in splats])
    found = {"coverage": coverage, "motion": 1 - still}
    if depth is not None:
        found["depth"] = depth[cells].copy()
    return found if weights is None else found | {"weights": weights}
