"""Source views at half their size, on which FWD works; its decoder doubles again."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Map
from ggvs_eval.camera import Camera
from ggvs_eval.method import SourceView


@dataclass(frozen=True, eq=False)
class HalfView:
    """One source view at half its size.

    Attributes:
        camera: of that size.
        image: (H, W, 3), in [-1, 1].
        depth: (H, W), world units, 0 where unknown.
    """

    camera: Camera
    image: Map
    depth: Map


def halve(source: SourceView) -> HalfView:
    """Mean colour of each 2 x 2 pixels, and the first known depth among them in reading order, so that none is invented.

    An odd row or column at the end is repeated.
    """
    height, width = source.image.shape[:2]
    bottom, right = height % 2, width % 2
    image = cv2.copyMakeBorder(source.image, 0, bottom, 0, right, cv2.BORDER_REPLICATE)
    depth = np.pad(source.depth, ((0, bottom), (0, right)), mode="edge")
    camera = halved_camera(source.camera, 2)
    fours = image.astype(np.float32).reshape(camera.height, 2, camera.width, 2, 3)
    return HalfView(camera, fours.mean(axis=(1, 3)) / np.float32(127.5) - 1, _first_known(depth))


def halved_camera(camera: Camera, multiple: int) -> Camera:
    """The camera at half its size, after its window was grown to the right and downwards to multiples of so many pixels."""
    width, height = (-(-side // multiple) * multiple for side in camera.size)
    return camera.cropped(0, 0, width, height).resized(width // 2, height // 2)


def _first_known(depth: NDArray[np.float32]) -> Map:
    """(2 H, 2 W) to (H, W)."""
    known = np.zeros_like(depth[::2, ::2])
    for row, column in ((0, 0), (0, 1), (1, 0), (1, 1)):
        known = np.where(known > 0, known, depth[row::2, column::2])
    return np.ascontiguousarray(known, np.float32)
