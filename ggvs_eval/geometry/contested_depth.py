"""Fused depth where the views' own depths contradict it: the colours decide."""

from collections.abc import Sequence

import numpy as np

from ggvs_eval.arrays import Map
from ggvs_eval.camera import Camera
from ggvs_eval.errors import RenderError
from ggvs_eval.geometry.per_pixel import view_weights
from ggvs_eval.geometry.pinhole import as_image, pinhole, rigid_between
from ggvs_eval.geometry.splat import Splat
from ggvs_eval.kernels import get_threads
from ggvs_eval.method import SourceView

LEAST_ALPHA = 0.3  # coverage from which a splat has a say
# of the weights of the views that have one: with this share a fused depth is not contested
LEAST_SHARE = 0.5
RATIO = 0.05  # of the variance of the colours: by so much better must a depth be than the fused one


def settle_depth(
    target: Camera,
    fused: Map,
    sources: Sequence[SourceView],
    splats: Sequence[Splat],
    tolerance: float,
    *,
    ratio: float = RATIO,
    least_share: float = LEAST_SHARE,
) -> Map:
    """Fused depth, replaced where most views show another surface and the colours of all agree far
    better about one of those.

    Args:
        fused: fused depth in the target view, (H, W), world units, 0 = unknown.
        sources: the source views, brought to one colour.
        splats: the same views splatted into the target view.
        tolerance: depths that differ by less are the same surface, world units.
        ratio: of the variance of the views' colours at the fused depth, below which the one at
            another depth must be.
        least_share: of the views' weights, with which the fused depth is not contested.

    Returns:
        (H, W), float32: the fused depth or, where another one wins, the depth of one of the splats.
        What is unknown stays so, and of images one pixel wide or high, whose colours are not
        interpolated, all of it.

    Raises:
        RenderError: no view, not as many splats as views, images that do not fit their cameras.

    Reading:
        Not in the paper, whose fusion votes by depth alone. A surface whose depth each view has in
        another place is voted away, and what is behind it is looked up instead. The opposite case,
        depth that has grown over an edge in every view, is rightly voted away; colours
        distinguishes them: of the depths that splats propose, the one is taken at which all views
        agree best (a plane sweep over at most K planes), and the fused one stays unless that is far
        better.
    """
    from ggvs_eval.kernels import _core

    if not len(sources) == len(splats) > 0:
        raise RenderError(
            f"contested depth: wanted a splat per view, got {len(sources)} views and {len(splats)} "
            f"splats"
        )
    weights = view_weights(
        target, [view.camera for view in sources], [view.share for view in sources]
    )
    views = [
        (
            pinhole(view.camera),
            rigid_between(target, view.camera),
            np.ascontiguousarray(view.image),
            as_image(splat.alpha, target, "coverage of the splat", RenderError),
            as_image(splat.depth, target, "depth of the splat", RenderError),
            float(weight),
        )
        for view, splat, weight in zip(sources, splats, weights, strict=True)
    ]
    depth = as_image(fused, target, "fused depth", RenderError)
    if not comparable([view.camera for view in sources]):
        return depth
    return _core.settle_depth(
        pinhole(target), depth, views, tolerance, LEAST_ALPHA, least_share, ratio, get_threads()
    )


def comparable(cameras: Sequence[Camera]) -> bool:
    """Return whether colours can be interpolated in the images of all cameras: they have two pixels
    along each side.
    """
    return all(min(camera.size) > 1 for camera in cameras)
