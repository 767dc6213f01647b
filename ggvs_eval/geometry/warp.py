"""Backward warping: what a source image shows at the surface that the target sees."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8, Map
from ggvs_eval.camera import Camera
from ggvs_eval.errors import RenderError
from ggvs_eval.geometry.per_pixel import evenly_spaced
from ggvs_eval.geometry.pinhole import Pinhole, as_image, as_image8, pinhole, rigid_between
from ggvs_eval.geometry.splat import Splat
from ggvs_eval.kernels import SIMD_LEVELS, get_simd_level, get_threads
from ggvs_eval.kernels.portable import length
from ggvs_eval.method import SourceView


@dataclass(frozen=True, eq=False)
class Warp:
    """A source image in the target view.

    Attributes:
        colour: (H, W, 3) float32, 0 if the surface projects outside the source image or the target
            has no depth.
        visibility: (H, W) float32 in [0, 1]: whether the source sees this surface or another one
            before or behind it.
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
    forgiven_px: float = 0.0,
) -> Warp:
    """Sample a source image where the target's surface points project into it.

    Args:
        target_depth: its depth, (H, W) float32, world units, 0 = unknown.
        source: the camera of the image.
        image: (Hs, Ws, 3) float32 in [0, 1].
        source_depth: the source's own depth, (Hs, Ws) float32, world units, 0 = invalid.
        tolerance: depths that differ by less are the same surface; visibility falls to 0 at twice
            this, world units.
        bicubic: interpolate with Catmull-Rom splines, sharper, clipped to [0, 1]; else bilinearly.
        forgiven_px: see `forgiven`.

    Raises:
        RenderError: images that do not fit their cameras, or a tolerance that is not positive.

    Examples:
        >>> from ggvs_eval.camera import translated_path
        >>> K = np.array([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]])
        >>> camera = Camera("cam00", K, np.eye(4), width=8, height=6, near=1.0, far=9.0)
        >>> left, right = translated_path(camera, span=0.25, count=2)
        >>> ramp = np.repeat(
        ...     np.linspace(0, 0.7, 8, dtype=np.float32)[None, :, None], 6, axis=0
        ... ).repeat(3, axis=2)
        >>> wall = np.full((6, 8), 2.0, np.float32)
        >>> seen = warp(left, wall, right, ramp, wall, tolerance=0.1)
        >>> seen.colour[0, :4, 0].round(
        ...     2
        ... )  # a baseline of 0.25 at depth 2 shifts the picture by one pixel
        array([0. , 0. , 0.1, 0.2], dtype=float32)
        >>> seen.visibility[0, :3].tolist()
        [0.0, 1.0, 1.0]
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
        forgiven(target, source, forgiven_px),
    )
    return Warp(
        *_core.warp(*views, tolerance, bicubic, get_threads(), SIMD_LEVELS.index(get_simd_level()))
    )


def warp_change(
    target: Camera, target_depth: Map, source: SourceView, before: Image8, tolerance: float
) -> Warp:
    """Sample how a source image has changed where the target's surface points project into it,
    bilinearly.

    Args:
        target_depth: its depth, (H, W) float32, world units, 0 = unknown.
        before: its image before, RGB uint8 (Hs, Ws, 3).
        tolerance: as in `warp`, world units.

    Returns:
        As `warp`; the change of colour is in [-1, 1].

    Raises:
        RenderError: images that do not fit their cameras.

    Examples:
        >>> from ggvs_eval.camera import translated_path
        >>> K = np.array([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]])
        >>> camera = Camera("cam00", K, np.eye(4), width=8, height=6, near=1.0, far=9.0)
        >>> dark, bright, wall = (
        ...     np.zeros((6, 8, 3), np.uint8),
        ...     np.full((6, 8, 3), 51, np.uint8),
        ...     np.full((6, 8), 2.0, np.float32),
        ... )
        >>> seen = warp_change(
        ...     camera, wall, SourceView(camera, bright, wall, wall), dark, tolerance=0.1
        ... )
        >>> seen.colour[3, 4].round(3).tolist()
        [0.20000000298023224, 0.20000000298023224, 0.20000000298023224]
    """
    from ggvs_eval.kernels import _core

    views = (
        pinhole(target),
        as_image(target_depth, target, "target depth", RenderError),
        pinhole(source.camera),
        rigid_between(target, source.camera),
        (_image8(source), _image8(replace(source, image=before))),
        as_image(source.depth, source.camera, "source depth", RenderError),
        forgiven(target, source.camera, 0.0),
    )
    return Warp(
        *_core.warp(*views, tolerance, False, get_threads(), SIMD_LEVELS.index(get_simd_level()))
    )


def look_up(
    target: Camera,
    target_depth: NDArray[np.float32],
    sources: Sequence[SourceView],
    weights: Sequence[float],
    background: NDArray[np.float32],
    tolerance: float,
    forgiven_px: float = 0.0,
) -> NDArray[np.float32]:
    """Look the target's surface up in all source images at once: their weighted mean, over a
    background.

    What `warp` does for each view (bicubic), the mean of their colours by visibility times weight,
    and the background as far as the sum of the visibilities falls short of 1, in one pass without
    images in between.

    Args:
        target_depth: its depth, (H, W) float32, world units, 0 = unknown.
        sources: the source views, at least one; sizes may differ.
        weights: weight of each view among the others that see the surface, positive.
        background: (H, W, 3) float32.
        tolerance: as in `warp`, world units.
        forgiven_px: see `forgiven`.

    Returns:
        (H, W, 3) float32.

    Raises:
        RenderError: images that do not fit their cameras or are not 8-bit RGB, a tolerance or a
            weight that is not positive, no view, or not as many weights as views.
    """
    from ggvs_eval.kernels import _core

    if len(sources) != len(weights):
        raise RenderError(
            f"look-up: wanted a weight per view, got {len(weights)} for {len(sources)} views"
        )
    least, largest = min(weights, default=0.0), max(weights, default=0.0)
    if not (0 < tolerance < np.inf and 0 < least <= largest < np.inf):
        raise RenderError(
            f"look-up: tolerance and weights must be positive, got {tolerance:g} and {least:g} .. "
            f"{largest:g}"
        )
    if background.shape[2:] != (3,):
        raise RenderError(f"look-up: wanted a background (H, W, 3), got {background.shape}")
    fields = [
        (*_source_fields(target, source, forgiven_px), weight)
        for source, weight in zip(sources, weights, strict=True)
    ]
    depth = as_image(target_depth, target, "target depth", RenderError)
    under = as_image(background, target, "background", RenderError)
    level = SIMD_LEVELS.index(get_simd_level())
    return _core.look_up(pinhole(target), depth, fields, under, tolerance, get_threads(), level)


def forgiven(target: Camera, source: Camera, forgiven_px: float) -> tuple[float, float]:
    """Return which errors of depth hide no surface from a source: those that move what it shows by
    at most `forgiven_px`.

    Where the target is at the source's place these are all errors: the same ray shows the surface.
    Between once and twice that visibility falls to 0. Unknown depth of the source is infinite. A
    surface of unknown depth is shown, at the far plane, by sources for which every depth from the
    near plane on is forgiven.

    Args:
        forgiven_px: displacement, pixels of the source; 0 forgives nothing.

    Returns:
        Largest difference of inverse depths that is forgiven, per world unit, and the depth of
        unknown surfaces, world units; 0 for none.
    """
    moved_px = source.focal_px * float(length(source.centre - target.centre))  # at unit depth
    slack = forgiven_px / moved_px if moved_px else (np.inf if forgiven_px else 0.0)
    return slack, target.far if slack * target.near >= 1 else 0.0


def _source_fields(target: Camera, source: SourceView, forgiven_px: float) -> tuple[Any, ...]:
    """Pack a source view for the kernels: pinhole, pose relative to the target's, checked image and
    depth, what is forgiven.
    """
    depth = as_image(source.depth, source.camera, "source depth", RenderError)
    relative = rigid_between(target, source.camera), _image8(source), depth
    return pinhole(source.camera), *relative, forgiven(target, source.camera, forgiven_px)


def _image8(source: SourceView) -> Image8:
    """Return the image of a view, C-contiguous, as the kernels that look it up want it."""
    image = as_image8(source.image, source.camera, RenderError)
    if image.size < 6:  # the kernels read bytes by fours
        raise RenderError(
            f"camera {source.camera.name}: wanted an image of at least two pixels, got "
            f"{image.shape}"
        )
    return np.ascontiguousarray(image)


def register_views(
    target: Camera,
    target_depth: NDArray[np.float32],
    sources: Sequence[SourceView],
    splats: Sequence[Splat],
    tolerance: float,
    faint: float,
    forgiven_px: float = 0.0,
) -> tuple[Map, Map, Map]:
    """Register views in one pass, without images in between: what `warp` gives for each (bicubic),
    mixed with its splat.

    Args:
        target_depth: its depth, (H, W) float32, world units, 0 = unknown.
        sources: the source views; sizes may differ.
        splats: the same views splatted into the target view, at least three features: their
            colours.
        tolerance: as in `warp`, world units.
        faint: coverage of a pixel that only the splat shows, per coverage of the splat.
        forgiven_px: see `forgiven`.

    Returns:
        Stacks of the K views, float32: colours (K, H, W, 3), the splat's, and its image's at the
        fused surface as far as the view is visible, or wholly where nothing was splatted; coverage
        (K, H, W), the visibility, or the faint coverage of the splat if that is more; visibilities
        (K, H, W) in [0, 1], as in `warp`.

    Raises:
        RenderError: no view, not as many splats as views, images that do not fit their cameras or
            are not 8-bit RGB, or a tolerance that is not positive.
    """
    from ggvs_eval.kernels import _core

    arguments = registration_arguments(
        target, target_depth, sources, splats, tolerance, forgiven_px
    )
    return _core.register_views(
        *arguments, faint, get_threads(), SIMD_LEVELS.index(get_simd_level())
    )


def registration_arguments(
    target: Camera,
    target_depth: NDArray[np.float32],
    sources: Sequence[SourceView],
    splats: Sequence[Splat],
    tolerance: float,
    forgiven_px: float = 0.0,
) -> tuple[Pinhole, Map, list[tuple[Any, ...]], float]:
    """Check and pack what `register_views` is given, except for `faint`, for the kernels."""
    if not len(sources) == len(splats) > 0:
        raise RenderError(
            f"registration: wanted a splat per view, got {len(sources)} views and {len(splats)} "
            f"splats"
        )
    if not 0 < tolerance < np.inf:
        raise RenderError(f"registration: tolerance must be positive and finite, got {tolerance:g}")
    fields = [
        (
            *_source_fields(target, source, forgiven_px),
            evenly_spaced(splat.features),
            as_image(splat.alpha, target, "coverage of the splat", RenderError),
        )
        for source, splat in zip(sources, splats, strict=True)
    ]
    return (
        pinhole(target),
        as_image(target_depth, target, "target depth", RenderError),
        fields,
        tolerance,
    )
