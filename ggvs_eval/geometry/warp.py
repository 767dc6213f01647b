"""Backward warping: what a source image shows at the surface that the target sees."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.camera import Camera
from ggvs_eval.errors import RenderError
from ggvs_eval.geometry.pinhole import as_image, pinhole, rigid_between
from ggvs_eval.kernels import get_threads


@dataclass(frozen=True, eq=False)
class Warp:
    """A source image in the target view.

    Attributes:
        colour: (H, W, 3) float32, 0 where the surface projects outside the source image or the target has no depth.
        visibility: (H, W) float32 in [0, 1]: whether the source sees this surface or another one before or behind it.
    """

    colour: NDArray[np.float32]
    visibility: NDArray[np.float32]


def warp(
    target: Camera,
    target_depth: NDArray[np.float32],
    source: Camera,
    image: NDArray[np.float32],
    source_depth: NDArray[np.float32],
    tolerance: float,
    *,
    bicubic: bool = False,
) -> Warp:
    """Sample a source image where the target's surface points project into it.

    Args:
        target: the camera to render.
        target_depth: its depth, (H, W) float32, world units, 0 = unknown.
        source: the camera of the image.
        image: (Hs, Ws, 3) float32 in [0, 1].
        source_depth: the source's own depth, (Hs, Ws) float32, world units, 0 = invalid.
        tolerance: depths that differ by less are the same surface; visibility falls to 0 at twice this, world units.
        bicubic: interpolate with Catmull-Rom splines, sharper, clipped to [0, 1]; else bilinearly.

    Raises:
        RenderError: images that do not fit their cameras, or a tolerance that is not positive.
    """
    from ggvs_eval.kernels import _core

    if not 0 < tolerance < np.inf:
        raise RenderError(f"warp: tolerance must be positive and finite, got {tolerance:g}")
    if image.ndim != 3 or image.shape[2] != 3:
        raise RenderError(f"warp: wanted an image (H, W, 3), got {image.shape}")
    views = (
        pinhole(target),
        as_image(target_depth, target, "target depth", RenderError),
        pinhole(source),
        rigid_between(target, source),
        as_image(image, source, "image", RenderError),
        as_image(source_depth, source, "source depth", RenderError),
    )
    return Warp(*_core.warp(*views, tolerance, bicubic, get_threads()))
