"""Registration of a picture with the true one by a homography, as where the pose of its camera is
wrong.
"""

import cv2
import numpy as np

from ggvs_eval.arrays import Array, Array32, Image8, Map, Mask
from ggvs_eval.files.images import mean_of_channels

# longer sides of the pictures compared; at 960 corners are within 0.02 px
COARSEST_PX, FINEST_PX = 160, 960
STEPS = cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 1e-5
SMOOTH_PX = 5  # of ECC's own filter
# of the longer side: a picture whose corners move further shows something else
FARTHEST_SHARE = 0.1


def register(
    image: Image8, truth: Image8, weight: Mask | None = None
) -> tuple[Array32, Mask] | None:
    """Move a picture by the homography that lays it on another.

    The homography maximises the enhanced correlation coefficient (Evangelidis and Psarakis,
    "Parametric image alignment using enhanced correlation coefficient maximization", 2008), which
    no gain or offset changes, from coarse to fine pictures.

    Args:
        image: (H, W, 3).
        truth: (H, W, 3).
        weight: pixels that are compared, (H, W); all by default.

    Returns:
        The moved picture, (H, W, 3), grey levels, interpolated by Lanczos, which blurs least, and
        where it lies on the picture, (H, W); None where no homography is found, or it moves a
        corner by more than a tenth of the longer side.
    """
    homography = _homography(mean_of_channels(image), mean_of_channels(truth), weight)
    if homography is None:
        return None
    size = truth.shape[1::-1]
    inverse = cv2.INTER_LANCZOS4 | cv2.WARP_INVERSE_MAP
    moved = cv2.warpPerspective(
        image.astype(np.float32), homography, size, flags=inverse, borderMode=cv2.BORDER_REFLECT
    )
    inside = cv2.warpPerspective(
        np.ones(truth.shape[:2], np.float32), homography, size, flags=cv2.WARP_INVERSE_MAP
    )
    return np.clip(moved, 0, 255), inside > 1 - 1e-3


def _homography(image: Map, truth: Map, weight: Mask | None) -> Array | None:
    """Return the map from pixels of the truth to those of the image, (3, 3)."""
    height, width = truth.shape
    longest = max(height, width)
    side_px = min(longest, FINEST_PX)
    sides_px = [side_px]
    while sides_px[0] > 2 * COARSEST_PX:
        sides_px.insert(0, sides_px[0] // 2)
    homography = np.eye(3)
    for side_px in sides_px:
        size = max(1, round(width * side_px / longest)), max(1, round(height * side_px / longest))
        small, target = (
            cv2.resize(picture, size, interpolation=cv2.INTER_AREA) for picture in (image, truth)
        )
        mask = (
            None
            if weight is None
            else cv2.resize(weight.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
        )
        factors = np.array(size) / (width, height)
        smaller = np.diag([*factors, 1.0])
        smaller[:2, 2] = (factors - 1) / 2  # pixel centres are at whole numbers
        larger = np.linalg.inv(smaller)
        start = np.float32(smaller @ homography @ larger)
        try:
            _, fitted = cv2.findTransformECC(
                target, small, start, cv2.MOTION_HOMOGRAPHY, STEPS, mask, SMOOTH_PX
            )
        except cv2.error:  # pictures without correlation, or without texture
            return None
        homography = larger @ fitted.astype(np.float64) @ smaller
    corners = np.array([[[0, 0], [width, 0], [0, height], [width, height]]], np.float64)
    moved_px = np.abs(cv2.perspectiveTransform(corners, homography) - corners).max()
    return homography if moved_px < FARTHEST_SHARE * longest else None
