"""Depth of one camera over consecutive instants: keyframes anew, between them only changed
pixels.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8, Mask
from ggvs_eval.camera import Camera
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.errors import DepthError
from ggvs_eval.geometry.rectification import can_rectify
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthEstimator, DepthOptions
from ggvs_eval.pipelines.offline.depth.matchers import SharedMatches

CONTEXT_PX = 48  # what a matcher sees around the window that it computes again
GRID_PX = 64  # windows start and end on multiples of it, so that their estimators can be kept
MOST_CHANGED = 0.6  # of the image; beyond, a window saves nothing
# a pixel has changed when its blurred difference exceeds this share of the value range
CHANGED = 0.02
GROW_PX = 8  # pixels this near to a changed one are recomputed too
BLUR_SIGMA_PX = 1.5  # averages sensor noise away before pictures are compared


class DepthStream:
    """Depth of one camera, instant by instant; each call is the next instant.

    What it returns depends on the instants since the last keyframe alone, and keyframes are where
    the frame number is a multiple of `keyframe_every`: a killed run continues from the keyframe
    before, with equal bits.

    Args:
        shared: see `PairwiseEstimator`.

    Reading:
        Whether something has changed is asked of the camera's own picture since its depth was
        computed, not since the frame before: slow changes add up. A partner that is newly covered
        does not change what the camera sees.
    """

    def __init__(
        self,
        camera: Camera,
        partners: Sequence[Camera],
        options: DepthOptions,
        shared: SharedMatches | None = None,
    ) -> None:
        self.camera = camera
        self.partners = tuple(partners)
        self.options = options
        self._whole = DepthEstimator(camera, partners, options, shared=shared)
        self._windows: dict[tuple[int, int, int, int], DepthEstimator] = {}
        self._reference: tuple[NDArray[np.float32], DepthMap] | None = None

    def step(self, frame: int, image: Image8, partner_images: Sequence[Image8]) -> DepthMap:
        """Return the depth at one instant.

        Args:
            frame: its number; consecutive from call to call.
        """
        if frame == self.options.first_needed(frame):
            self._whole.forget()
            self._reference = None
        if self.options.keyframe_every == 1:
            return self._whole.estimate(image, partner_images)
        blurred = cv2.GaussianBlur(image, (0, 0), BLUR_SIGMA_PX).astype(np.float32)
        if self._reference is None:
            depth_map = self._whole.estimate(image, partner_images)
        else:
            blurred, depth_map = self._renew(*self._reference, blurred, image, partner_images)
        self._reference = blurred, depth_map
        return depth_map

    def _renew(
        self,
        reference: NDArray[np.float32],
        depth_map: DepthMap,
        blurred: NDArray[np.float32],
        image: Image8,
        partner_images: Sequence[Image8],
    ) -> tuple[NDArray[np.float32], DepthMap]:
        """Compute again what has changed: the pictures that depth is now of, and the depth."""
        changed = self._changed(reference, blurred)
        if not changed.any():
            return reference, depth_map
        window = _window_around(changed, self.camera.size)
        left, top, width, height = window
        is_narrow = not all(
            can_rectify(self.camera.cropped(*window), pair, nearest=1.0)
            for pair in self._whole.pairs
        )
        if is_narrow or width * height > MOST_CHANGED * self.camera.width * self.camera.height:
            return blurred, self._whole.estimate(image, partner_images)
        rows, columns = slice(top, top + height), slice(left, left + width)
        try:
            fresh = self._window_estimator(window).estimate(
                np.ascontiguousarray(image[rows, columns]), partner_images
            )
        except DepthError:  # it cannot be rectified alone
            return blurred, self._whole.estimate(image, partner_images)
        mask = changed[rows, columns]
        renewed = [reference.copy(), depth_map.depth.copy(), depth_map.confidence.copy()]
        newest = [blurred[rows, columns], fresh.depth, fresh.confidence]
        if depth_map.guess is not None and fresh.guess is not None:
            renewed, newest = [*renewed, depth_map.guess.copy()], [*newest, fresh.guess]
        for old, new in zip(renewed, newest, strict=True):
            old[rows, columns][mask] = new[mask]
        return renewed[0], DepthMap(*renewed[1:])

    def _changed(self, reference: NDArray[np.float32], blurred: NDArray[np.float32]) -> Mask:
        different = np.abs(reference - blurred).max(axis=-1) > 255 * CHANGED
        grown = cv2.dilate(different.astype(np.uint8), np.ones((2 * GROW_PX + 1,) * 2, np.uint8))
        return np.asarray(grown, bool)

    def _window_estimator(self, window: tuple[int, int, int, int]) -> DepthEstimator:
        if window not in self._windows:
            # each holds the maps of its pairs
            self._windows = dict(list(self._windows.items())[-3:])
            # the whole map's share of gaps decides, not the window's
            options = replace(self.options, filler_share=0.0)
            self._windows[window] = DepthEstimator(
                camera=self.camera.cropped(*window),
                partners=self.partners,
                options=options,
                pairs=self._whole.pairs,
            )
        estimator = self._windows[window]
        estimator.forget()
        return estimator


def _window_around(changed: Mask, size: tuple[int, int]) -> tuple[int, int, int, int]:
    """(left, top, width, height) of the smallest window on the grid that holds all changed pixels
    and their context.
    """
    starts, stops = [], []
    for axis, side in zip((0, 1), size, strict=True):
        where = np.flatnonzero(changed.any(axis=axis))
        starts.append(max(0, int(where[0]) - CONTEXT_PX) // GRID_PX * GRID_PX)
        stops.append(min(side, -(-(int(where[-1]) + 1 + CONTEXT_PX) // GRID_PX) * GRID_PX))
    return starts[0], starts[1], stops[0] - starts[0], stops[1] - starts[1]
