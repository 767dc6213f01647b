"""Depth of one camera from the images of its partners, frame by frame."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field

import numpy as np

from ggvs_eval.camera import Camera
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.errors import DepthError
from ggvs_eval.images import Image8
from ggvs_eval.pipelines.offline.fusion import drop_flying_pixels, fill_background, fuse, smooth_surfaces
from ggvs_eval.pipelines.offline.matcher import Map, StereoMatcher
from ggvs_eval.pipelines.offline.rectification import RectifiedPair, depth_from_disparity, rectify
from ggvs_eval.pipelines.offline.sgbm import SgbmMatcher

ALGORITHM = "rectify-match-fuse 1"  # counts up whenever equal options give other bits


@dataclass(frozen=True)
class DepthOptions:
    """How depth is computed.

    Attributes:
        matcher: the stereo algorithm.
        partners: how many cameras each one is matched with at most.
        error_px: estimates of two partners agree when disparity errors of this size explain their difference.
        flying: a pixel flies when fewer than three neighbours lie within this share of its depth.
        smooth: depth is averaged over neighbours that differ by about this share of it.
        smooth_radius_px: over neighbours this far away.
        filled_confidence: confidence of pixels filled from the background; 0 leaves them invalid.
    """

    matcher: StereoMatcher = field(default_factory=SgbmMatcher)
    partners: int = 4
    error_px: float = 0.5
    flying: float = 0.03
    smooth: float = 0.03
    smooth_radius_px: int = 4
    filled_confidence: float = 0.02

    def describe(self) -> dict[str, object]:
        """All of it as values that JSON knows, with the versions of the algorithms; part of a depth map's key."""
        return {"algorithm": ALGORITHM, "matcher_name": self.matcher.name, **asdict(self)}


class DepthEstimator:
    """Computes the depth of one camera; everything that does not depend on the images is prepared once.

    Args:
        camera: the camera whose depth is wanted.
        partners: the cameras it is matched with.
        options: parameters.

    Raises:
        DepthError: no partners, or a pair that cannot be rectified.
    """

    def __init__(self, camera: Camera, partners: Sequence[Camera], options: DepthOptions) -> None:
        if not partners:
            raise DepthError(f"camera {camera.name}: depth needs at least one other camera to match with, got none")
        self.camera = camera
        self.partners = tuple(partners)
        self.options = options
        self._pairs = [rectify(camera, partner) for partner in partners]

    def estimate(self, image: Image8, partner_images: Sequence[Image8]) -> DepthMap:
        """Depth at one instant.

        Args:
            image: what the camera saw, RGB, (H, W, 3).
            partner_images: what the partners saw at the same instant, in their order.

        Returns:
            Depth, (H, W), and confidence: the share of partners that agree, weighted by their left-right agreement.

        Raises:
            DepthError: an image does not have its camera's size.
        """
        self._check(image, partner_images)
        options = self.options
        estimates = [self._match(pair, image, other) for pair, other in zip(self._pairs, partner_images, strict=True)]
        depths, confidences, disparities = (np.stack(maps) for maps in zip(*estimates, strict=True))  # (N, H, W) each
        depth, confidence = fuse(depths, confidences, disparities, options.error_px)
        depth = smooth_surfaces(drop_flying_pixels(depth, options.flying), options.smooth, options.smooth_radius_px)
        confidence = np.where(depth > 0, confidence, np.float32(0))
        return DepthMap(*fill_background(depth, confidence, options.filled_confidence))

    def _match(self, pair: RectifiedPair, image: Image8, partner_image: Image8) -> tuple[Map, Map, Map]:
        """One partner's depth, confidence and disparity at the camera's pixels, (H, W) each."""
        left, right = pair.warp_left(image), pair.warp_right(partner_image)
        disparity, confidence = self.options.matcher.match(left, right, pair.d_min, pair.d_max)
        disparity = np.where(pair.sees(disparity), disparity, np.float32(0))
        return depth_from_disparity(pair, disparity, confidence)

    def _check(self, image: Image8, partner_images: Sequence[Image8]) -> None:
        if len(partner_images) != len(self.partners):
            raise DepthError(f"camera {self.camera.name}: wanted {len(self.partners)} partner images, got {len(partner_images)}")
        for camera, each in zip((self.camera, *self.partners), (image, *partner_images), strict=True):
            if each.shape != (camera.height, camera.width, 3) or each.dtype != np.uint8:
                wanted = (camera.height, camera.width, 3)
                raise DepthError(
                    f"camera {camera.name}: wanted a uint8 image of {wanted}, got {each.dtype} {each.shape}; "
                    "resize the capture, not single images"
                )
