"""Frames of a distorting lens, given as the pinhole frames that a `Camera` describes."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np

from ggvs_eval.arrays import Array, Image8
from ggvs_eval.capture import FrameSource
from ggvs_eval.files.digest import digest_values
from ggvs_eval.lens import Lens


@dataclass(frozen=True, eq=False)
class UndistortedFrames:
    """A `FrameSource` whose frames are those of another, undistorted to a pinhole image of the same
    size.

    Attributes:
        lens: the lens, at the size of these frames.
        K: intrinsics of the pinhole image.

    Reading:
        Bicubic resampling; pixels that the lens did not see are black, but no black is mixed into
        those at the edge.
    """

    source: FrameSource
    lens: Lens
    K: Array

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return self.source.n_frames

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels, before and after."""
        return self.lens.width, self.lens.height

    @cached_property
    def digest(self) -> str:
        """Identifies the frames and their processing."""
        values = [*self.lens.K.ravel(), *self.lens.coefficients, *self.K.ravel()]
        return digest_values(
            self.source.digest, self.lens.model, *(f"{value:.17g}" for value in values)
        )

    def frames(self, start: int, stop: int) -> Iterator[Image8]:
        """Decode and undistort frames start <= t < stop one by one, RGB uint8 (H, W, 3)."""
        for image in self.source.frames(start, stop):
            map_u, map_v, unseen = self._maps
            resampled_image = cv2.remap(
                image, map_u, map_v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
            )
            pinhole = np.asarray(resampled_image, dtype=np.uint8)
            pinhole[unseen] = 0
            yield pinhole

    def __getstate__(self) -> dict[str, Any]:
        """Without the maps, which are large and soon made again: captures travel between
        processes.
        """
        return {key: value for key, value in self.__dict__.items() if key != "_maps"}

    @cached_property
    def _maps(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Undistortion maps in OpenCV's fixed-point form, and a mask of the pinhole pixels outside
        the distorted image.
        """
        # The same as `Lens.distort` for every pixel, fifty times as fast. OpenCV counts from pixel
        # centres.
        half = np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]])
        find = (
            cv2.fisheye.initUndistortRectifyMap
            if self.lens.model == "fisheye"
            else cv2.initUndistortRectifyMap
        )
        coefficients = np.array(self.lens.coefficients)
        u, v = find(
            self.lens.K - half, coefficients, np.eye(3), self.K - half, self.size, cv2.CV_32FC1
        )
        unseen = ~(
            (u >= -0.5) & (u <= self.lens.width - 0.5) & (v >= -0.5) & (v <= self.lens.height - 0.5)
        )
        u[unseen] = v[unseen] = 0
        return *cv2.convertMaps(u, v, cv2.CV_16SC2), unseen
