"""Depth of a camera by any stereo matcher: each partner's opinion alone, then their consensus."""

from abc import abstractmethod
from collections.abc import Sequence

import numpy as np

from ggvs_eval.arrays import Image8, Map
from ggvs_eval.camera import Camera
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.errors import DepthError
from ggvs_eval.geometry.rectification import RectifiedPair, depth_from_disparity, rectify_each
from ggvs_eval.pipelines.offline.depth.matchers import Estimator, Matcher, SharedMatches
from ggvs_eval.pipelines.offline.stereo.fusion import fuse


class StereoMatcher(Matcher):
    """Finds for each pixel of the left image the one of the right image on the same row."""

    @abstractmethod
    def match(
        self, left: Image8, right: Image8, d_min: int, d_max: int, previous: Map | None = None
    ) -> tuple[Map, Map]:
        """Match a rectified pair.

        Args:
            left: RGB, (H, W, 3).
            right: RGB, (H, W, 3); the point at column x on the left is at x - disparity.
            d_min: smallest disparity, pixels.
            d_max: largest disparity, pixels.
            previous: disparity of the left image of the frame before, (H, W), 0 = unknown; a
                matcher may start from it.

        Returns:
            Disparity of the left image in pixels, (H, W), 0 = rejected, and its confidence in [0,
            1], (H, W).
        """

    def estimator(
        self,
        camera: Camera,
        partners: Sequence[Camera],
        error_px: float,
        warm: bool,
        shared: SharedMatches | None,
        /,
    ) -> Estimator:
        """See Matcher.estimator."""
        return PairwiseEstimator(
            camera=camera,
            partners=partners,
            matcher=self,
            error_px=error_px,
            warm=warm,
            shared=shared,
        )


class PairwiseEstimator:
    """Depth of one camera by a stereo matcher.

    Everything that does not depend on the images is prepared once.

    Args:
        partners: those that cannot be rectified with the camera have no opinion.
        error_px: estimates of two partners agree when disparity errors of this size explain their
            difference.
        warm: give the matcher of each pair its previous result; the calls must then be consecutive
            instants.
        shared: what was found of this instant and camera, by other estimators too; anyone who fills
            it empties it for the next one.
    """

    def __init__(
        self,
        camera: Camera,
        partners: Sequence[Camera],
        matcher: StereoMatcher,
        error_px: float,
        warm: bool = False,
        shared: SharedMatches | None = None,
    ) -> None:
        if warm and shared is not None:
            raise DepthError(
                f"camera {camera.name}: wanted warm=False for shared matches, got True; unset it"
            )
        self.matcher = matcher
        self.error_px = error_px
        self.warm = warm
        self._pairs = rectify_each(camera, partners)
        self._names, self._shared = [partner.name for partner in partners], shared
        self.forget()

    def estimate(self, image: Image8, partner_images: Sequence[Image8]) -> DepthMap:
        """Return the depth at one instant, invalid where no partner has an opinion.

        Returns:
            Depth, (H, W), and confidence: the share of partners that agree, weighted by their
            left-right agreement.
        """
        estimates = [
            self._match(index, pair, image, partner_images[index])
            for index, pair in self._pairs.items()
        ]
        # (N, H, W) each
        depths, confidences, disparities = (np.stack(maps) for maps in zip(*estimates, strict=True))
        return DepthMap(*fuse(depths, confidences, disparities, self.error_px))

    def forget(self) -> None:
        """Begin a new sequence: the next call starts cold."""
        self._previous: dict[int, Map] = {}

    def _match(
        self, index: int, pair: RectifiedPair, image: Image8, partner_image: Image8
    ) -> tuple[Map, Map, Map]:
        """Return one partner's depth, confidence and disparity at the camera's pixels, (H,
        W) each.
        """
        if self._shared is None:
            return self._found(index, pair, image, partner_image)
        key = self.matcher.name, self._names[index]
        if key not in self._shared:
            self._shared[key] = self._found(index, pair, image, partner_image)
        return self._shared[key]

    def _found(
        self, index: int, pair: RectifiedPair, image: Image8, partner_image: Image8
    ) -> tuple[Map, Map, Map]:
        left, right = pair.warp_left(image), pair.warp_right(partner_image)
        disparity, confidence = self.matcher.match(
            left, right, pair.d_min, pair.d_max, self._previous.get(index)
        )
        if self.warm:
            self._previous[index] = disparity
        disparity = np.where(pair.sees(disparity), disparity, np.float32(0))
        return depth_from_disparity(pair, disparity, confidence)
