"""Values of several views at the same target pixel made one."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Map
from ggvs_eval.camera import Camera
from ggvs_eval.errors import RenderError
from ggvs_eval.kernels import get_threads

FALL_OFF = 1.5  # power of the parallax by which a weight falls
LEAST_PARALLAX_RAD = 2e-3  # cameras nearer than this are at one place


def view_weights(
    target: Camera, cameras: Sequence[Camera], shares: Sequence[float] | None = None
) -> NDArray[np.float32]:
    """Return the weight of each source view among those that show a pixel; only ratios matter.

    Args:
        cameras: of the source views, at least one.
        shares: how far the choice of sources counts on each, see `SourceView.share`; 1 unless
            given.

    Returns:
        (K,), positive; 1 for the nearest camera if its share is.

    Examples:
        >>> from ggvs_eval.camera import translated_path
        >>> K = np.array([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]])
        >>> camera = Camera("cam00", K, np.eye(4), width=8, height=6, near=1.0, far=9.0)
        >>> rig = translated_path(camera, span=1.0, count=3)
        >>> view_weights(rig[0], rig[1:]).round(2)  # the second is twice as far away
        array([1.  , 0.36], dtype=float32)

    Reading:
        LLFF's weight exp(-f d / (P z)) counts pixels: the finer the images, the more one camera
        decides alone. Errors of a view, by wrong depth, by surfaces that shine, by light that
        changes while a camera is carried, grow with the angle between the cameras, so that the best
        mean weighs by a power of it, as unstructured lumigraphs do (Buehler et al. 2001); neither
        the resolution nor a crop nor the unit of length changes a weight. Geometric weights on nine
        views of validation rooms, nine of a real hand-held sequence and three views each of three
        more domains: 30.61, 26.4, 29.57, 25.79, 24.10 dB with a power of 1.5; 30.64, 25.7, 29.57,
        25.70, 24.05 with exp(-parallax / 0.1).
    """
    parallax = np.array([mean_parallax(target, camera) for camera in cameras]) + LEAST_PARALLAX_RAD
    weights = (parallax.min() / parallax) ** FALL_OFF
    return (weights if shares is None else weights * np.asarray(shares)).astype(np.float32)


def mean_parallax(target: Camera, camera: Camera) -> float:
    """Distance of a camera from the target over the depth of what the target sees, as its inverse
    depth has it in the mean.
    """
    distance = float(np.linalg.norm(camera.centre - target.centre))
    return distance * (1 / target.near + 1 / target.far) / 2


def weighted_mean(
    colours: Sequence[Map], weights: Sequence[Map], factors: Sequence[float] | None = None
) -> Map:
    """Return the mean of the views' colours, however small their weights; black where none has any.

    Args:
        colours: each (H, W, C) with at least three channels, float32; the first three count.
        weights: each (H, W), float32, at least 0; only their ratios matter.
        factors: one more weight per view, 1 unless given.

    Returns:
        (H, W, 3), float32: sum of weighted colours over sum of weights.

    Raises:
        RenderError: no view, or not as many weights as colours.

    Examples:
        >>> red, blue = np.zeros((2, 1, 1, 3), np.float32)
        >>> red[..., 0], blue[..., 2] = 1.0, 1.0
        >>> weighted_mean(
        ...     [red, blue], [np.full((1, 1), 3.0, np.float32), np.ones((1, 1), np.float32)]
        ... ).tolist()
        [[[0.75, 0.0, 0.25]]]
    """
    from ggvs_eval.kernels import _core

    factors = [1.0] * len(colours) if factors is None else factors
    if not len(colours) == len(weights) == len(factors) > 0:
        raise RenderError(
            f"weighted mean: wanted a weight and a factor per view, got {len(colours)} views, "
            f"{len(weights)} weights"
        )
    views = [
        (evenly_spaced(colour), np.ascontiguousarray(weight, np.float32), float(factor))
        for colour, weight, factor in zip(colours, weights, factors, strict=True)
    ]
    return _core.weighted_mean(views, views[0][1].shape, get_threads())


def largest_feature(
    features: Sequence[Map],
    alphas: Sequence[Map],
    *,
    channel: int,
    least_alpha: float,
    otherwise: float,
) -> Map:
    """Return the largest value of one feature among the views that cover a pixel.

    Args:
        features: of each splatted view, (H, W, C), float32.
        alphas: coverage of each view, (H, W), float32.
        channel: which feature.
        least_alpha: coverage from which a view has a say.
        otherwise: value where no view has one.

    Returns:
        (H, W), float32.

    Raises:
        RenderError: no view, or not as many coverages as features.
    """
    from ggvs_eval.kernels import _core

    if not len(features) == len(alphas) > 0:
        raise RenderError(
            f"largest feature: wanted a coverage per view, got {len(features)} views, "
            f"{len(alphas)} coverages"
        )
    views = [
        (evenly_spaced(feature), np.ascontiguousarray(alpha, np.float32))
        for feature, alpha in zip(features, alphas, strict=True)
    ]
    return _core.largest_feature(
        views, channel, views[0][1].shape, least_alpha, otherwise, get_threads()
    )


def evenly_spaced(image: Map) -> Map:
    """Return the image itself if its pixels are evenly spaced, as the first channels of a larger
    image do; else a copy.
    """
    image = np.asarray(image, np.float32)
    if (
        image.ndim == 3
        and image.strides[2] == 4
        and image.strides[1] > 0
        and image.strides[0] == image.shape[1] * image.strides[1]
    ):
        return image
    return np.ascontiguousarray(image)
