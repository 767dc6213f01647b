"""Depth from all partners at once: planes swept from a small image to the full one, then the fraction of a plane."""

from collections.abc import Sequence

import numpy as np

from ggvs_eval.arrays import Image8, Map
from ggvs_eval.camera import Camera
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.pipelines.offline.plane_sweep.sweep_level import SweepLevel
from ggvs_eval.pipelines.offline.plane_sweep.sweep_options import PlaneSweep


class PlaneSweepEstimator:
    """Depth of one camera by a plane sweep; everything that does not depend on the images is prepared once.

    Args:
        camera: the camera whose depth is wanted.
        partners: the cameras it is matched with.
        options: parameters.
    """

    def __init__(self, camera: Camera, partners: Sequence[Camera], options: PlaneSweep) -> None:
        self.options = options
        sizes = _halved(camera.size, options.smallest_px)
        self._levels = [SweepLevel(camera.resized(*size), partners, options) for size in sizes]

    def estimate(self, image: Image8, partner_images: Sequence[Image8]) -> DepthMap:
        """Depth at one instant, invalid everywhere where no partner sees anything of the camera's view.

        Args:
            image: what the camera saw, RGB, (H, W, 3).
            partner_images: what the partners saw at the same instant, in their order.

        Returns:
            Depth, (H, W), and confidence: the mean correlation of the partners' windows with the camera's, 0 for a partner that
            sees something else or nothing.
        """
        finest = self._levels[-1]
        if finest.blind:
            nothing = np.zeros(image.shape[:2], np.float32)
            return DepthMap(nothing, nothing.copy())
        prior: Map | None = None
        for level in self._levels[:-1]:
            if not level.blind:  # as it is where what partners see is too small when halved
                prior = level.match(level.load(image, partner_images), prior)
        images = finest.load(image, partner_images)
        inverse_depth, fit = finest.match(images, prior), finest.fit(images)
        for _ in range(self.options.refinements):
            refined = fit.refine(inverse_depth, finest.planes.step)
            inverse_depth = np.maximum(refined, np.float32(finest.planes.first))  # what lies beyond the planes is not at infinity
        return DepthMap(np.float32(1) / inverse_depth, fit.confidence(inverse_depth))

    def forget(self) -> None:
        """Begin a new sequence; every instant is computed from nothing anyway."""


def _halved(size: tuple[int, int], smallest_px: int) -> list[tuple[int, int]]:
    """Sizes from the smallest to `size`; at least two, as only the second knows who hides what."""
    sizes = [size]
    while max(sizes[0]) > smallest_px or len(sizes) < 2:
        width, height = sizes[0]
        sizes.insert(0, (-(-width // 2), -(-height // 2)))
    return sizes
