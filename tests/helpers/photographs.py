"""Photographs with noise, and the PSNR of a picture."""

import numpy as np
from skimage import data

from ggvs_eval.files.images import round_levels


def noisy_pair(
    height: int = 90, width: int = 110, strength: float = 8.0, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """A crop of a photograph with Gaussian noise of this deviation in levels, and without, both
    uint8 (height, width, 3).
    """
    left = min(180, 512 - width)
    truth = np.ascontiguousarray(data.astronaut()[20 : 20 + height, left : left + width])
    noise = np.random.default_rng(seed).normal(0, strength, truth.shape)
    return round_levels(truth + noise), truth


def psnr_db(image: np.ndarray, truth: np.ndarray) -> float:
    """PSNR of an image in [0, 1]; the truth is of that scale too, or 8-bit."""
    scale = 255.0 if truth.dtype == np.uint8 else 1.0
    return float(-10 * np.log10(np.mean((image - truth / scale) ** 2)))
