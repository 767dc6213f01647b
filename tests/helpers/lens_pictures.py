"""A picture by formula, and what a lens makes of it."""

import cv2
import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.files.images import round_levels
from ggvs_eval.lens import Lens


def pixel_grid(width: int, height: int) -> np.ndarray:
    """Pixel centres, (H, W, 2)."""
    return np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1)


def pattern(uv: np.ndarray) -> np.ndarray:
    """A smooth coloured picture, (..., 3) in 0..255."""
    u, v = uv[..., 0], uv[..., 1]
    waves = (np.sin(u / 5.0) * np.cos(v / 7.0), np.sin((u + v) / 8.0), np.cos(u / 9.0 - v / 4.0))
    return np.stack([127.5 + 100 * wave for wave in waves], axis=-1)


def undistorted_points(lens: Lens, uv: np.ndarray) -> np.ndarray:
    """OpenCV's own way back, to the pinhole image with the lens's K."""
    points = uv.reshape(-1, 1, 2)
    coefficients = np.array(lens.coefficients)
    if lens.model == "fisheye":
        return cv2.fisheye.undistortPoints(points, lens.K, coefficients, P=lens.K).reshape(uv.shape)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)
    undistort = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)  # OpenCV 4 and 5
    return undistort(
        points, lens.K, coefficients, R=np.eye(3), P=lens.K, criteria=criteria
    ).reshape(uv.shape)


def through_lens(lens: Lens, gain: float = 1.0) -> Image8:
    """The picture, in the pinhole image with the lens's K, as the lens shows it."""
    picture = gain * pattern(undistorted_points(lens, pixel_grid(lens.width, lens.height)))
    return round_levels(picture)


def straight(lens: Lens, K: np.ndarray) -> np.ndarray:
    """The same picture in a pinhole image with K, by formula, (H, W, 3) in 0..255."""
    uv = pixel_grid(lens.width, lens.height)
    return pattern((uv - K[:2, 2]) / K[[0, 1], [0, 1]] * lens.K[[0, 1], [0, 1]] + lens.K[:2, 2])


def psnr(image: np.ndarray, truth: np.ndarray) -> float:
    return float(10 * np.log10(255**2 / ((image - truth) ** 2).mean()))
