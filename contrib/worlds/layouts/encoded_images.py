"""Image files of the layouts that want other than colour PNG."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8

# Full chroma resolution: what is lost is little and the same in every hue.
JPEG = [cv2.IMWRITE_JPEG_QUALITY, 97, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]


def write_jpeg(path: Path, image: Image8) -> None:
    """Write an RGB image, (H, W, 3), as JPEG of quality 97 without chroma subsampling."""
    _write(path, cv2.cvtColor(image, cv2.COLOR_RGB2BGR), JPEG)


def write_grey_png(path: Path, image: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    """Write one channel of 8 or 16 bit, (H, W), as PNG."""
    _write(path, image, [])


def _write(path: Path, image: NDArray[np.uint8] | NDArray[np.uint16], flags: list[int]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    _, encoded = cv2.imencode(path.suffix, image, flags)
    path.write_bytes(encoded.tobytes())
