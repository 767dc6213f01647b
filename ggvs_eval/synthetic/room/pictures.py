"""Photographs for walls, book covers and screens, from the images that scikit-image carries inside its wheel."""

import cv2
import numpy as np

from ggvs_eval.arrays import Image8

PICTURES = ("astronaut", "chelsea", "coffee", "rocket", "hubble_deep_field", "moon", "camera", "retina")


def picture(name: str, width: int = 320) -> Image8:
    """One of `PICTURES`, reduced to a width in pixels, RGB uint8 (H, W, 3)."""
    from skimage import data

    image = np.asarray(getattr(data, name)())
    if image.ndim == 2:
        image = np.repeat(image[..., None], 3, axis=2)
    height = round(image.shape[0] * width / image.shape[1])
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
