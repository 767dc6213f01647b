"""Source views registered in the target view: captured at the fused surface, splatted where a view does not see that."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.camera import Camera
from ggvs_eval.errors import RenderError
from ggvs_eval.geometry.per_pixel import evenly_spaced
from ggvs_eval.geometry.pinhole import as_image, pinhole
from ggvs_eval.geometry.splat import Splat
from ggvs_eval.geometry.warp import CapturedView, captured_fields
from ggvs_eval.kernels import SIMD_LEVELS, get_simd_level, get_threads


@dataclass(frozen=True, eq=False)
class Registered:
    """K views in the target view.

    Attributes:
        colours: (K, H, W, 3), float32: the splat's, and as far as the view is visible its image's at the fused surface.
        coverage: (K, H, W), float32: the visibility, or the faint coverage of the splat if that is more.
        visibilities: (K, H, W), float32 in [0, 1], as in `warp`.
        alphas: (K, H, W), float32: the splats' coverages side by side.
        depths: (K, H, W), float32: the splats' depths.
    """

    colours: NDArray[np.float32]
    coverage: NDArray[np.float32]
    visibilities: NDArray[np.float32]
    alphas: NDArray[np.float32]
    depths: NDArray[np.float32]


def register_views(
    target: Camera,
    target_depth: NDArray[np.float32],
    views: Sequence[CapturedView],
    splats: Sequence[Splat],
    tolerance: float,
    faint: float,
) -> Registered:
    """Register views in one pass, without images in between: what `warp` gives for each (bicubic), mixed with its splat.

    Args:
        target: the camera to render.
        target_depth: its depth, (H, W) float32, world units, 0 = unknown.
        views: the source views; sizes may differ, their weights do not count.
        splats: the same views splatted into the target view, at least three features: their colours.
        tolerance: as in `warp`, world units.
        faint: coverage of a pixel that only the splat shows, per coverage of the splat.

    Raises:
        RenderError: no view, not as many splats as views, images that do not fit their cameras or are not 8-bit RGB, or a
            tolerance that is not positive.
    """
    from ggvs_eval.kernels import _core

    if not len(views) == len(splats) > 0:
        raise RenderError(f"registration: wanted a splat per view, got {len(views)} views and {len(splats)} splats")
    if not 0 < tolerance < np.inf:
        raise RenderError(f"registration: tolerance must be positive and finite, got {tolerance:g}")
    fields = [
        (
            *captured_fields(target, view),
            evenly_spaced(splat.features),
            as_image(splat.alpha, target, "coverage of the splat", RenderError),
            as_image(splat.depth, target, "depth of the splat", RenderError),
        )
        for view, splat in zip(views, splats, strict=True)
    ]
    depth = as_image(target_depth, target, "target depth", RenderError)
    level = SIMD_LEVELS.index(get_simd_level())
    return Registered(*_core.register_views(pinhole(target), depth, fields, tolerance, faint, get_threads(), level))
