"""Live depth, for play and view: images of a limited size, each pair of cameras matched once for
the depth of both.

Every instant is computed from itself alone, so that cuts, gaps and first instants are nothing
special. What the instant before has found would not narrow the search: scenes fill the range of
disparities that near and far allow (benchmarks/TRIED.md).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ggvs_eval.arrays import Image8, Map
from ggvs_eval.camera import Camera
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.errors import DepthError
from ggvs_eval.geometry.pinhole import as_image8
from ggvs_eval.geometry.rectification import (
    can_rectify,
    depth_from_disparity,
    exchange_roles,
    rectify,
)
from ggvs_eval.kernels import get_threads
from ggvs_eval.pipelines.offline.depth.matchers import Estimator
from ggvs_eval.pipelines.offline.stereo.fusion import fuse
from ggvs_eval.pipelines.offline.stereo.sgbm import SgbmMatcher, Side

SAME_SURFACE = 0.01  # of the depth; neighbours that differ by less are one surface
# depth, confidence and disparity at the pixels of a camera, (H, W) each
Estimate = tuple[Map, Map, Map]


@dataclass(frozen=True)
class LiveMatcher(SgbmMatcher):
    """Semi-global block matching of images of a limited size, each pair once for both of its
    cameras.

    Attributes:
        levels: sizes at which the pair is matched.
        longest_px: larger images are made smaller until their longer side is this long.
    """

    name = "sgbm-3way-shared"
    levels: int = 2
    longest_px: int = 928
    refine_iterations: int = 1

    def estimator(
        self, camera: Camera, partners: Sequence[Camera], error_px: float, *_: object
    ) -> Estimator:
        """See Matcher.estimator."""
        return LiveEstimator(camera=camera, partners=partners, matcher=self, error_px=error_px)

    def rig(
        self, cameras: Sequence[Camera], matched: Sequence[Sequence[str]], error_px: float
    ) -> "RigEstimator":
        """See Matcher.rig."""
        return RigEstimator(cameras=cameras, matched=matched, matcher=self, error_px=error_px)

    def small(self, camera: Camera) -> Camera:
        """Return the camera at the size at which it is matched."""
        share = min(self.longest_px / max(camera.size), 1.0)
        return camera.resized(round(camera.width * share), round(camera.height * share))


class SharedPair:
    """Two cameras matched with each other once, for the depth of both.

    Args:
        first: one of them, at the size at which they are matched.
    """

    def __init__(self, first: Camera, second: Camera, matcher: LiveMatcher) -> None:
        self._matcher = matcher
        self._pair = rectify(first, second)
        self._turned = exchange_roles(self._pair, first, second)
        self._d_min = min(
            self._pair.d_min, int(np.floor(self._turned.depth_scale.min() / second.far))
        )
        self._d_max = max(
            self._pair.d_max, int(np.ceil(self._turned.depth_scale.max() / second.near))
        )

    def match(self, image: Image8, partner_image: Image8, sides: Sequence[Side]) -> list[Estimate]:
        """Match the pair, for the depth of one or both cameras.

        Args:
            image: what the first camera saw, RGB, (H, W, 3).
            partner_image: what the second camera saw at the same instant.
            sides: left for the depth of the first camera, right for that of the second.
        """
        left, right = self._pair.warp_left(image), self._pair.warp_right(partner_image)
        matches = self._matcher.match_sides(left, right, self._d_min, self._d_max, sides)
        return [self._seen(side, *match) for side, match in zip(sides, matches, strict=True)]

    def _seen(self, side: Side, disparity: Map, confidence: Map) -> Estimate:
        """Resample canvas depth to the camera."""
        pair = self._pair
        if side == "right":
            pair, disparity, confidence = (
                self._turned,
                disparity[::-1, ::-1],
                confidence[::-1, ::-1],
            )
        depth, sure, sampled = depth_from_disparity(
            pair, np.where(pair.sees(disparity), disparity, np.float32(0)), confidence
        )
        # Between a match and none the interpolation passes through tiny disparities.
        matched = sampled >= max(self._d_min, 1) - 0.5
        return (
            np.where(matched, depth, np.float32(0)),
            np.where(matched, sure, np.float32(0)),
            sampled,
        )


class RigEstimator:
    """Depth of several cameras at once.

    Everything that does not depend on the images is prepared once.

    Each camera has the same depth to the last bit in any selection of cameras: a pair is always
    matched in the order of its cameras' names, or where it cannot be rectified so the other way
    round; a partner with which neither goes has no opinion.

    Args:
        matched: for each depth map that is wanted the name of its camera, and those of the cameras
            that it is matched with.
        error_px: estimates of two partners agree when disparity errors of this size, in the smaller
            images, explain their difference.
    """

    def __init__(
        self,
        cameras: Sequence[Camera],
        matched: Sequence[Sequence[str]],
        matcher: LiveMatcher,
        error_px: float,
    ) -> None:
        self.matched = [tuple(names) for names in matched]
        self._cameras = {camera.name: camera for camera in cameras}
        self._matcher, self._error_px = matcher, error_px
        self._requested = {
            (name, partner) for name, *partners in self.matched for partner in partners
        }
        ordered = sorted({(min(names), max(names)) for names in self._requested})
        small = {camera.name: matcher.small(camera) for camera in cameras}
        self._pairs: dict[tuple[str, str], SharedPair] = {}
        for names in ordered:
            for first, second in (names, names[::-1]):
                if can_rectify(small[first], small[second]):
                    self._pairs[first, second] = SharedPair(small[first], small[second], matcher)
                    break

    def estimate(self, images: Mapping[str, Image8]) -> list[DepthMap]:
        """Return the depth at one instant, invalid where no partner has an opinion.

        Args:
            images: what each camera of the rig saw that is wanted or matched, RGB, (H, W, 3).

        Returns:
            Depth, (H, W), and confidence of each map that is wanted: the share of partners that
            agree, weighted by their left-right agreement.
        """
        small = {
            name: self._shrunk(name, images)
            for name in dict.fromkeys(name for names in self.matched for name in names)
        }
        estimates: dict[tuple[str, str], Estimate] = {}
        for (first, second), pair in self._pairs.items():
            views: dict[Side, tuple[str, str]] = {"left": (first, second), "right": (second, first)}
            sides = [side for side, names in views.items() if names in self._requested]
            for side, estimate in zip(
                sides, pair.match(small[first], small[second], sides), strict=True
            ):
                estimates[views[side]] = estimate
        return [
            self._fused(
                [estimates[name, partner] for partner in partners if (name, partner) in estimates],
                images[name],
                small[name],
            )
            for name, *partners in self.matched
        ]

    def _shrunk(self, name: str, images: Mapping[str, Image8]) -> Image8:
        camera = self._cameras[name]
        image = as_image8(images.get(name), camera, DepthError)
        size = self._matcher.small(camera).size
        return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)

    def _fused(self, estimates: Sequence[Estimate], image: Image8, small_image: Image8) -> DepthMap:
        if not estimates:
            return DepthMap(*np.zeros((2, *image.shape[:2]), np.float32))
        # (N, H, W) each
        depths, confidences, disparities = (np.stack(maps) for maps in zip(*estimates, strict=True))
        return enlarge(
            DepthMap(*fuse(depths, confidences, disparities, self._error_px)), small_image, image
        )


class LiveEstimator(Estimator):
    """Depth of one camera as `RigEstimator` finds it for many.

    Args:
        error_px: see `RigEstimator`.
    """

    def __init__(
        self, camera: Camera, partners: Sequence[Camera], matcher: LiveMatcher, error_px: float
    ) -> None:
        cameras = (camera, *partners)
        self._names = [view.name for view in cameras]
        self._rig = RigEstimator(
            cameras=cameras, matched=[self._names], matcher=matcher, error_px=error_px
        )

    def estimate(self, image: Image8, partner_images: Sequence[Image8]) -> DepthMap:
        """Return the depth at one instant, see `RigEstimator.estimate`."""
        return self._rig.estimate(dict(zip(self._names, (image, *partner_images), strict=True)))[0]


def enlarge(small: DepthMap, small_image: Image8, image: Image8) -> DepthMap:
    """Upsample depth to the size of its image, aware of edges.

    A pixel takes the depth of that of the four nearest small pixels whose colour is most like its
    own, so that depth ends where the image's edges are, and is interpolated within surfaces only.

    Args:
        small: depth and confidence, (h, w).
        small_image: the image at that size, RGB, (h, w, 3).
        image: the image, (H, W, 3).
    """
    if small_image.shape == image.shape:
        return small
    from ggvs_eval.kernels import _stereo

    depth, confidence = (
        np.ascontiguousarray(array, np.float32) for array in (small.depth, small.confidence)
    )
    smooth = np.asarray(
        cv2.resize(depth, image.shape[1::-1], interpolation=cv2.INTER_LINEAR), np.float32
    )
    small_guide, guide = np.ascontiguousarray(small_image), np.ascontiguousarray(image)
    return DepthMap(
        *_stereo.enlarge_to_edges(
            depth, confidence, small_guide, guide, smooth, SAME_SURFACE, get_threads()
        )
    )
