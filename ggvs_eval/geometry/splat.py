"""Forward rendering of pixel-sized Gaussians (paper 3.1): every source pixel becomes one opaque
Gaussian as large as itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array32, Image8, Map
from ggvs_eval.camera import Camera
from ggvs_eval.errors import RenderError
from ggvs_eval.geometry.pinhole import as_image, pinhole, rigid_between
from ggvs_eval.kernels import SIMD_LEVELS, get_simd_level, get_threads
from ggvs_eval.method import SourceView

MAX_FEATURES = 4
COVERED_ALPHA = 0.5  # from this coverage on a splatted view shows something
OPAQUE = 0.99  # the most that one opaque Gaussian covers, see `splat`
Projected = tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]


@dataclass(frozen=True, eq=False)
class Splat:
    """A source view in the target view, or several together: what its Gaussians look like from the
    target camera.

    Attributes:
        features: (H', W', C) float32.
        alpha: coverage, (H', W') float32, 0 to just below 1.
        depth: z in the target camera, (H', W') float32, world units.
    """

    features: NDArray[np.float32]
    alpha: NDArray[np.float32]
    depth: NDArray[np.float32]


def splat(
    sources: Sequence[SourceView],
    target: Camera,
    *,
    near: float,
    extras: Sequence[Map] = (),
    scale: float = 0.5,
    normalised: bool = True,
) -> Splat:
    """Render every pixel of known depth as a Gaussian, those of all sources together, blended front
    to back.

    One source gives that view's forward rendering; several give the paper's No Blending baseline.

    Args:
        sources: views whose images have the same number of channels; sizes may differ. Levels of an
            8-bit image count as shares of 255; other features, (H, W, C) float32 with C from 1 to
            4, are blended as they are.
        near: Gaussians at or before this depth in the target camera are left out, world units.
        extras: of each source one more feature besides its 8-bit image, (H, W) float32, e.g. a
            difference mask; or none.
        scale: standard deviation of a Gaussian in source pixels.
        normalised: divide features and depth by alpha where alpha > 1/255, set them to 0 elsewhere;
            False keeps the plain sums.

    Raises:
        RenderError: no source, or features that fit neither the camera nor each other, or a near or
            scale that is not positive.

    Examples:
        >>> K = np.array([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]])
        >>> camera = Camera("cam00", K, np.eye(4), width=8, height=6, near=1.0, far=9.0)
        >>> depth, grey = np.full((6, 8), 2.0, np.float32), np.full((6, 8, 3), 128, np.uint8)
        >>> view = SourceView(camera, grey, depth, confidence=np.ones_like(depth))
        >>> picture = splat([view], camera, near=0.2)
        >>> picture.features[3, 4].round(3)
        array([0.502, 0.502, 0.502], dtype=float32)
        >>> round(float(picture.depth[3, 4]), 3)
        2.0
        >>> bool(picture.alpha.min() > 0.9)
        True

    Reading:
        The paper says that a Gaussian covers a pixel, not how large it is: 0.5 pixels standard
        deviation is sharp and still closes the gaps of a 1.6-fold magnification. The forward pass
        is 3D Gaussian splatting's (0.3 px^2 added to the variance, alpha at most 0.99 and at least
        1/255, stop before transmittance falls below 1e-4), with two differences: a Gaussian ends
        where its alpha reaches 1/255 and not also at the border of a 16-pixel tile, and the
        principal point can be anywhere. Results are normalised, since Eqs. 4 and 6 multiply by
        alpha again. Equal depths keep the order of sources and pixels.
    """
    from ggvs_eval.kernels import _core

    beside: list[Map | None] = [*extras] or [None] * len(sources)
    channels = _common_channels(sources, beside)
    if not (near > 0 and scale > 0):
        raise RenderError(
            f"splat: near and scale must be positive, got near {near:g}, scale {scale:g}"
        )
    views = [
        (
            pinhole(source.camera),
            rigid_between(source.camera, target),
            as_image(source.depth, source.camera, "depth", RenderError),
            *_features(source, extra),
        )
        for source, extra in zip(sources, beside, strict=True)
    ]
    level = SIMD_LEVELS.index(get_simd_level())
    return Splat(
        *_core.splat(
            views, pinhole(target), near, scale, channels, normalised, get_threads(), level
        )
    )


def splat_depth(camera: Camera, depth: Map, target: Camera, *, near: float) -> Splat:
    """Render the Gaussians of a depth map alone: coverage and depth in the target camera, no
    colours.

    Args:
        camera: of the depth map.
        depth: (H, W), world units, 0 = no Gaussian here.
        near: as in `splat`, world units.

    Raises:
        RenderError: a depth map that does not fit its camera, or a near that is not positive.
    """
    black = np.zeros((*depth.shape, 3), np.uint8)
    return splat([SourceView(camera, black, depth, confidence=depth)], target, near=near)


def _features(source: SourceView, extra: Map | None) -> tuple[Array32 | Image8, Map | None]:
    """Return the features and the extra one in the kernel's layout, without a copy if they have it
    already.
    """
    if source.image.dtype != np.uint8:
        return as_image(source.image, source.camera, "features", RenderError), None
    if source.image.shape[:2] != (source.camera.height, source.camera.width):
        as_image(source.image, source.camera, "features", RenderError)  # raises
    extra = None if extra is None else as_image(extra, source.camera, "extra feature", RenderError)
    if source.image.size < 6:  # the kernel reads bytes by fours
        return float_features(source.image, extra), None
    return np.ascontiguousarray(source.image), extra


def _common_channels(sources: Sequence[SourceView], extras: Sequence[Map | None]) -> int:
    """Return the number of features of every source, the extra one included."""
    if len(sources) != len(extras):
        raise RenderError(
            f"splat: wanted an extra feature of every source or of none, got {len(extras)} of "
            f"{len(sources)}"
        )
    channels = set()
    for source, extra in zip(sources, extras, strict=True):
        image = source.image
        if extra is not None and image.dtype != np.uint8:
            raise RenderError(
                f"splat: wanted an 8-bit image with an extra feature, got {image.dtype}"
            )
        if image.dtype == np.uint8 and image.shape[2:] != (3,):
            raise RenderError(f"splat: wanted an 8-bit image (H, W, 3), got {image.shape}")
        channels.add((image.shape[2] if image.ndim == 3 else 0) + (extra is not None))
    if len(channels) != 1 or not 1 <= min(channels) <= MAX_FEATURES:
        shapes = ", ".join(str(source.image.shape) for source in sources) or "no source"
        raise RenderError(
            f"splat: wanted features (H, W, C) with one C from 1 to {MAX_FEATURES} in all sources, "
            f"got {shapes}"
        )
    return min(channels)


def splat_points(
    source: SourceView, target: Camera, *, near: float, extra: Map | None = None
) -> Splat:
    """Render the pixels of one source as points: each falls into one pixel of the target, where the
    nearest is seen.

    The limit of `splat` for Gaussians that shrink to nothing and are still opaque in the middle;
    magnification opens holes.

    Args:
        source: the view, its image as in `splat`.
        near: points at or before this depth in the target camera are left out, world units.
        extra: one more feature besides the image, (H, W) float32.

    Raises:
        RenderError: features that do not fit the camera, or a near that is not positive.

    Reading:
        Of points at the same depth the first in reading order of the source is seen.
    """
    if not near > 0:
        raise RenderError(f"point splat: near must be positive, got {near:g}")
    depth = as_image(source.depth, source.camera, "depth", RenderError)
    features = as_image(float_features(source.image, extra), source.camera, "features", RenderError)
    place, z, pixel = _project(source.camera, depth, target, near)
    order = np.lexsort((z, place))  # by pixel, within it by depth, within that as they were
    first = order[np.r_[True, np.diff(place[order]) > 0]] if order.size else order
    size = (target.height, target.width)
    colour, alpha = np.zeros((*size, features.shape[2]), np.float32), np.zeros(size, np.float32)
    splat_depth = np.zeros(size, np.float32)
    colour.reshape(-1, features.shape[2])[place[first]] = features.reshape(-1, features.shape[2])[
        pixel[first]
    ]
    alpha.reshape(-1)[place[first]] = OPAQUE
    splat_depth.reshape(-1)[place[first]] = z[first]
    return Splat(colour, alpha, splat_depth)


def float_features(image: Array32 | Image8, extra: Map | None = None) -> Array32:
    """Return an image, levels of 8 bit as shares of 255, and one more feature, (H, W, C).

    A copy unless it is that already.
    """
    shares = (
        image.astype(np.float32) / np.float32(255)
        if image.dtype == np.uint8
        else image.astype(np.float32, copy=False)
    )
    return (
        shares
        if extra is None
        else np.concatenate([shares, extra[..., None]], axis=-1, dtype=np.float32)
    )


def _project(camera: Camera, depth: NDArray[np.float32], target: Camera, near: float) -> Projected:
    """The pixel of the target that each visible point falls into, its depth there, and the pixel it
    comes from; flat, (N,).
    """
    pixels = np.flatnonzero(depth > 0)
    z = depth.reshape(-1)[pixels].astype(np.float64)
    across = (pixels % camera.width + 0.5 - camera.K[0, 2]) / camera.K[0, 0]
    down = (pixels // camera.width + 0.5 - camera.K[1, 2]) / camera.K[1, 1]
    transform = rigid_between(camera, target)
    # (N, 3)
    points = np.stack([across * z, down * z, z], axis=1) @ transform[:3, :3].T + transform[:3, 3]
    before = points[:, 2] > near
    points, pixels = points[before], pixels[before]
    column = np.floor(target.K[0, 0] * points[:, 0] / points[:, 2] + target.K[0, 2])
    row = np.floor(target.K[1, 1] * points[:, 1] / points[:, 2] + target.K[1, 2])
    inside = (column >= 0) & (column < target.width) & (row >= 0) & (row < target.height)
    place = row[inside].astype(np.int64) * target.width + column[inside].astype(np.int64)
    return place, points[inside, 2], pixels[inside]
