"""Depth of one camera from the images of its partners, by whatever matcher, frame by frame, and held against that of others."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.camera import Camera
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.errors import DepthError
from ggvs_eval.geometry.pinhole import as_image8
from ggvs_eval.jobs.code_identity import code_identity
from ggvs_eval.pipelines.offline.depth.consistency import ConsistencyOptions, check_consistency
from ggvs_eval.pipelines.offline.plane_sweep.plane_sweep import PlaneSweepEstimator
from ggvs_eval.pipelines.offline.plane_sweep.planes import PlaneSweep
from ggvs_eval.pipelines.offline.sensor.colour_fill import fill_by_colour
from ggvs_eval.pipelines.offline.sensor.sensor_depth import SensorDepthOptions
from ggvs_eval.pipelines.offline.stereo.fusion import PairwiseEstimator, drop_flying_pixels, fill_background, smooth_surfaces
from ggvs_eval.pipelines.offline.stereo.live import LiveEstimator, LiveMatcher
from ggvs_eval.pipelines.offline.stereo.matcher import StereoMatcher
from ggvs_eval.pipelines.offline.stereo.sgbm import SgbmMatcher

STREAM = "ggvs_eval.pipelines.offline.depth.depth_stream"  # renews what has changed by what stands here


@dataclass(frozen=True)
class TimeOptions:
    """Temporal options of depth: how that of an instant depends on the instants before. By default it does not.

    Attributes:
        keyframe_every: instants from one that is computed from nothing to the next; what lies between may use the frame before.
            1 computes every instant from nothing, so that any can be computed alone.
        warm: matchers start from the disparity of the frame before.
        reuse: depth is computed again only where the picture has changed since it was.
        changed: a pixel has changed when its blurred difference exceeds this share of the value range.
        grow_px: what lies this near to a changed pixel is computed again too.
    """

    keyframe_every: int = 1
    warm: bool = False
    reuse: bool = False
    changed: float = 0.02
    grow_px: int = 8

    def first_needed(self, frame: int) -> int:
        """The keyframe that `frame` goes back to: depth of an instant depends on the instants from there on."""
        return frame - frame % self.keyframe_every


@dataclass(frozen=True)
class DepthOptions:
    """Options of depth estimation.

    Attributes:
        matcher: the stereo algorithm: of pairs, or the plane sweep over all partners at once.
        partners: how many cameras each one is matched with at most.
        error_px: of pairs: estimates of two partners agree when disparity errors of this size explain their difference.
        flying: a pixel flies when fewer than three neighbours lie within this share of its depth.
        smooth: depth is averaged over neighbours that differ by about this share of it.
        smooth_radius_px: over neighbours this far away.
        filled_confidence: confidence of pixels filled from the background; 0 leaves them invalid.
        time: how instants depend on each other.
        consistency: how depth is held against that of the other sources of a view; None leaves it as it is.
        sensor: how measured depth is filtered, which takes the place of stereo where the capture has it; None ignores it.
    """

    matcher: StereoMatcher | PlaneSweep = field(default_factory=SgbmMatcher)
    partners: int = 4
    error_px: float = 0.5
    flying: float = 0.03
    smooth: float = 0.03
    smooth_radius_px: int = 4
    filled_confidence: float = 0.02
    time: TimeOptions = field(default_factory=TimeOptions)
    consistency: ConsistencyOptions | None = field(default_factory=ConsistencyOptions)
    sensor: SensorDepthOptions | None = field(default_factory=SensorDepthOptions)

    def describe(self) -> dict[str, object]:
        """All that stereo depends on, as values that JSON knows, its code included; part of the key."""
        matcher = {name: value for name, value in vars(self.matcher).items() if not isinstance(value, Path)}
        described = {
            "algorithm": "match-fuse-finish",
            "code": self._code(),
            "matcher_name": self.matcher.name,
            **asdict(self),
            "matcher": matcher,
        }
        del described["sensor"], described["consistency"]  # they have specs of their own
        return described

    def _code(self) -> str:
        """Hash of the code that finds depth by this matcher, and by no other."""
        estimators = {PlaneSweep: PlaneSweepEstimator, LiveMatcher: LiveEstimator}
        estimator = estimators.get(type(self.matcher), PairwiseEstimator)
        modules = (part.__module__ for part in (fill_background, estimator, type(self.matcher)))
        return code_identity(__name__, STREAM, *modules, unfollowed=(__name__,))


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
        self._raw: PairwiseEstimator | PlaneSweepEstimator | LiveEstimator
        if isinstance(options.matcher, PlaneSweep):
            self._raw = PlaneSweepEstimator(camera, partners, options.matcher)
        elif isinstance(options.matcher, LiveMatcher):
            self._raw = LiveEstimator(camera, partners, options.matcher, options.error_px)
        else:
            self._raw = PairwiseEstimator(camera, partners, options.matcher, options.error_px, options.time.warm)

    def estimate(self, image: Image8, partner_images: Sequence[Image8]) -> DepthMap:
        """Depth at one instant.

        Args:
            image: what the camera saw, RGB, (H, W, 3).
            partner_images: what the partners saw at the same instant, in their order.

        Returns:
            Depth, (H, W), without flying pixels, smoothed within surfaces and filled from the background, and its confidence.

        Raises:
            DepthError: an image does not have its camera's size.
        """
        self._check(image, partner_images)
        return finish(self._raw.estimate(image, partner_images), self.options)

    def forget(self) -> None:
        """Begin a new sequence."""
        self._raw.forget()

    def _check(self, image: Image8, partner_images: Sequence[Image8]) -> None:
        if len(partner_images) != len(self.partners):
            raise DepthError(f"camera {self.camera.name}: wanted {len(self.partners)} partner images, got {len(partner_images)}")
        for camera, each in zip((self.camera, *self.partners), (image, *partner_images), strict=True):
            as_image8(each, camera, DepthError)


def finish(raw: DepthMap, options: DepthOptions) -> DepthMap:
    """Post-process any matcher's depth: drop flying pixels, smooth surfaces, fill gaps from the background."""
    depth = smooth_surfaces(drop_flying_pixels(raw.depth, options.flying), options.smooth, options.smooth_radius_px)
    confidence = np.where(depth > 0, raw.confidence, np.float32(0))
    return DepthMap(*fill_background(depth, confidence, options.filled_confidence))


def check_depth(
    camera: Camera, depth_map: DepthMap, others: Sequence[tuple[Camera, DepthMap]], options: DepthOptions
) -> DepthMap:
    """Hold a camera's depth against that of the other sources of a view, and fill the rest from the background.

    Args:
        camera: the camera of the depth map.
        depth_map: depth and confidence as they were found, (H, W).
        others: other cameras with theirs, as they were found too.

    Returns:
        Depth and confidence, (H, W); those that were given where `options` want no consistency.

    Raises:
        DepthError: a depth map that does not fit its camera.
    """
    if options.consistency is None:
        return depth_map
    checked = check_consistency(camera, depth_map, others, options.consistency)
    return DepthMap(*fill_background(checked.depth, checked.confidence, options.filled_confidence))


def check_measured_depth(
    camera: Camera, image: Image8, depth_map: DepthMap, others: Sequence[tuple[Camera, DepthMap]], options: DepthOptions
) -> DepthMap:
    """`check_depth` of what a sensor measured: the rest is filled along the edges of the colours.

    Holes of sensors are no shadows of nearer surfaces, as those of stereo are: the farther side is not likelier than the nearer.

    Args:
        camera: the camera of the depth map.
        image: what it saw, RGB, (H, W, 3).
        depth_map: filtered depth and confidence, (H, W).
        others: other cameras with theirs, filtered too.

    Raises:
        DepthError: a depth map that does not fit its camera.
    """
    if options.consistency is None or options.sensor is None:
        return depth_map
    checked = check_consistency(camera, depth_map, others, options.consistency)
    return fill_by_colour(checked, image, options.sensor.fill)
