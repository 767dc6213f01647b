"""How far each source view counts beside the others: by the angle between its camera and the target's."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.camera import Camera

PARALLAX_RAD = 0.1  # by which a weight falls to 1 / e
LEAST_WEIGHT = 1e-4  # of a view whatever its angle, beside 1 of the nearest: where it alone sees something, it is taken


def view_weights(target: Camera, cameras: Sequence[Camera], shares: Sequence[float] | None = None) -> NDArray[np.float32]:
    """Weight of each source view among those that show a pixel; only ratios matter.

    Args:
        target: the camera to render.
        cameras: of the source views, at least one.
        shares: how far the choice of sources counts on each, see `SourceView.share`; 1 unless given.

    Returns:
        (K,), positive; 1 for the nearest camera if its share is.

    Reading:
        LLFF's weight exp(-f d / (P z)) counts pixels: the finer the images, the more one camera decides alone. Here f / P is an
        angle, so that neither the resolution nor a crop nor the unit of length changes a weight, and d / z the parallax of a
        point in the middle of the target's depth range, in which inverse depth is even.
    """
    parallax = np.array([mean_parallax(target, camera) for camera in cameras])
    weights = np.maximum(np.exp((parallax.min() - parallax) / PARALLAX_RAD), LEAST_WEIGHT)
    return (weights if shares is None else weights * np.asarray(shares)).astype(np.float32)


def mean_parallax(target: Camera, camera: Camera) -> float:
    """Distance of a camera from the target over the depth of what the target sees, as its inverse depth has it in the mean."""
    distance = float(np.linalg.norm(camera.centre - target.centre))
    return distance * (1 / target.near + 1 / target.far) / 2
