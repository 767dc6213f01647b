"""PSNR after one homography: what a table would say if every picture's camera were where its
calibration says.
"""

import numpy as np

from ggvs_eval.arrays import Image8, Mask
from ggvs_eval.geometry.registration import register
from ggvs_eval.metrics.image.psnr import masked_psnr
from ggvs_eval.metrics.inputs import check_pair
from ggvs_eval.metrics.metric import FURTHER, ViewMetric

LEAST_COVERED = 0.5  # of the pixels compared, which a moved picture still has to cover


def psnr_registered(rendered: Image8, truth: Image8, mask: Mask | None = None) -> float:
    """PSNR of one frame after the homography that lays it on the truth.

    Where poses are off, every rendering is shifted against the capture, and PSNR prefers the most
    blurred one. This metric takes a motion of the whole picture out. It cannot see: a wrong focal
    length, shift or turn of the picture, whoever made it; and parallax of a camera at a wrong place
    remains. Interpolation at parts of a pixel smooths, so that a noisy picture gains up to 1.4 dB:
    compare methods by it, not its height with that of PSNR.

    Args:
        rendered: (H, W, 3), uint8.
        truth: captured frame, same shape.
        mask: (H, W), which pixels count; None for all.

    Returns:
        PSNR in dB over the pixels that the moved picture covers, at least that of the picture where
        it is.

    Raises:
        MetricError: images or mask do not fit each other, or fewer than 64 pixels inside.

    Example:
        >>> import numpy as np
        >>> import cv2
        >>> noise = np.random.default_rng(0).uniform(0, 255, (96, 128, 3)).astype(np.float32)
        >>> truth = cv2.normalize(
        ...     cv2.GaussianBlur(noise, (0, 0), 3), None, 0, 255, cv2.NORM_MINMAX
        ... ).astype(np.uint8)
        >>> psnr_registered(np.roll(truth, 2, axis=1), truth) > 35  # in place: 24 dB
        True

    Reading:
        `register`; whatever it finds is used only where it explains error, so that a method never
        loses by it.
    """
    check_pair(rendered, truth)
    is_compared = np.ones(truth.shape[:2], bool) if mask is None else mask
    in_place_db = masked_psnr(rendered, truth, is_compared)
    registered = register(rendered, truth, is_compared)
    if registered is None:
        return in_place_db
    moved, is_covered = registered
    is_counted = is_covered & is_compared
    if is_counted.sum() < LEAST_COVERED * is_compared.sum():
        return in_place_db
    white = np.float32(255)
    return max(in_place_db, masked_psnr(moved / white, truth / white, is_counted))


PSNR_REGISTERED = ViewMetric(
    name="PSNR_registered",
    kind="frame",
    function=psnr_registered,
    unit="dB",
    higher_is_better=True,
    group=FURTHER,
    decimals=2,
    describe=(
        "PSNR after the homography that lays the picture on the captured one: blind to a picture "
        "that is moved as a whole, whether by poses or by the method"
    ),
    reference="Evangelidis and Psarakis 2008 for the alignment",
    inside=lambda pair, mask: psnr_registered(pair.rendered, pair.truth.image, mask),
)
