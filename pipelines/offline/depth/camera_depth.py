"""Depth of one camera from the images of its partners, by any matcher, frame by frame, and checked
against other cameras.
"""

from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.camera import Camera
from ggvs_eval.depth_options import FREE_MATCHER
from ggvs_eval.depth_store import DepthMap, is_known
from ggvs_eval.errors import DepthError
from ggvs_eval.geometry.pinhole import as_image8
from ggvs_eval.pipelines.offline.depth.colour_fill import fill_by_colour
from ggvs_eval.pipelines.offline.depth.consistency import check_consistency
from ggvs_eval.pipelines.offline.depth.matchers import MATCHERS, Matcher, SharedMatches
from ggvs_eval.pipelines.offline.depth.pairing import choose_partners, pairs_of
from ggvs_eval.pipelines.offline.stereo.fusion import (
    drop_flying_pixels,
    fill_background,
    smooth_surfaces,
)
from ggvs_eval.tasks.identity import code_of

# renews changed parts by the functions of this module
STREAM = "ggvs_eval.pipelines.offline.depth.depth_stream"
# of pairs: estimates of two partners agree when disparity errors of this size explain their
# difference
ERROR_PX = 0.5
FLYING = 0.03  # a pixel flies when fewer than three neighbours are within this share of its depth
# depth is averaged over near neighbours that differ by about this share
SMOOTH, SMOOTH_RADIUS_PX = 0.03, 4
FILLED_CONFIDENCE = 0.02  # of pixels that are filled


@dataclass(frozen=True)
class DepthOptions:
    """Options of depth estimation; `DepthRunOptions` makes them of what users choose.

    Attributes:
        matcher: the stereo algorithm: of pairs, or of all partners at once.
        filler: the network whose depth takes the place of what is not found, or not confirmed, of
            all partners at once or of the pairs; None for the background's.
        filler_share: ... in maps of which at least this share is unknown: the few gaps of narrow
            rigs are shadows of nearer surfaces, where the background is right. It is not asked
            where less than half of it is unknown before the check.
        partners: how many cameras each one is matched with at most.
        keyframe_every: instants from one that is computed from nothing to the next. 1 computes each
            from nothing, so that any can be computed alone; otherwise those between start from the
            disparity of the one before and are computed again only where the picture changed.
        consistency: depth is checked against that of the other sources of a view.
        sensor: measured depth takes the place of stereo where the capture has it.
        sensor_fills: ... or fills what stereo does not find.
    """

    matcher: Matcher = field(default_factory=lambda: MATCHERS[FREE_MATCHER]())
    filler: Matcher | None = None
    filler_share: float = 0.2
    partners: int = 4
    keyframe_every: int = 1
    consistency: bool = True
    sensor: bool = True
    sensor_fills: bool = False

    def first_needed(self, frame: int) -> int:
        """Return the keyframe that `frame` goes back to: depth of an instant depends on the
        instants from there on.
        """
        return frame - frame % self.keyframe_every

    def describe(self) -> dict[str, object]:
        """Return all that stereo depends on, as values that JSON knows, its code included.

        Part of the key.
        """
        matcher, filler = (
            {name: value for name, value in vars(method).items() if not isinstance(value, Path)}
            if method
            else None
            for method in (self.matcher, self.filler)
        )
        described = {
            "algorithm": "match-fuse-finish",
            "code": self._code(),
            "matcher_name": self.matcher.name,
            "filled_confidence": FILLED_CONFIDENCE,
            **asdict(self),
            "matcher": matcher,
            "filler": filler,
        }
        # they have their own specs
        del described["sensor"], described["sensor_fills"], described["consistency"]
        return described

    def _code(self) -> str:
        """Return the hash of the code that finds depth by this matcher, and by no other."""
        return code_of(__name__, *modules_of(self.matcher, self.filler))

    def choose_partners(
        self, camera: Camera, candidates: Sequence[Camera], excluded: Collection[str] = ()
    ) -> list[Camera]:
        """Return the cameras that a camera is matched with, see `pairing.choose_partners`."""
        pairs, views = self.partners, self.filler.views if self.filler else 0
        if self.matcher.views:
            pairs, views = 0, self.matcher.views
        return choose_partners(camera, candidates, pairs, excluded, views)


def modules_of(*matchers: Matcher | None) -> set[str]:
    """Return the modules that find depth by some matchers, and by no others."""
    return {
        fill_background.__module__,
        *(type(matcher).__module__ for matcher in matchers if matcher),
    }


class DepthEstimator:
    """Computes the depth of one camera.

    Everything that does not depend on the images is prepared once.

    Args:
        pairs: those of them that are matched pair by pair, where a network sees more; found here by
            default.
        shared: see `PairwiseEstimator`.
    """

    def __init__(
        self,
        camera: Camera,
        partners: Sequence[Camera],
        options: DepthOptions,
        pairs: Sequence[Camera] | None = None,
        shared: SharedMatches | None = None,
    ) -> None:
        if not partners:
            raise DepthError(
                f"camera {camera.name}: depth needs at least one other camera to match with, got "
                f"none"
            )
        self.camera = camera
        self.partners = tuple(partners)
        self.options = options
        matcher, filler = options.matcher, options.filler
        sees_more = filler is not None and filler.views > 0
        if pairs is None:
            pairs = pairs_of(camera, partners, options.partners) if sees_more else partners
        self.pairs = tuple(pairs)
        how = ERROR_PX, options.keyframe_every > 1, shared
        self._raw = matcher.estimator(camera, self.pairs, *how) if pairs else None
        views = self.partners if sees_more else self.pairs
        self._guess = (views, filler.estimator(camera, views, *how)) if filler else None

    def estimate(self, image: Image8, partner_images: Sequence[Image8]) -> DepthMap:
        """Return the depth at one instant.

        Args:
            image: what the camera saw, RGB, (H, W, 3).
            partner_images: what the partners saw at the same instant, in their order.

        Returns:
            Depth, (H, W), without flying pixels, smoothed within surfaces and filled from the
            background, and its confidence.
        """
        self._check(image, partner_images)
        raw = DepthMap(*np.zeros((2, *image.shape[:2]), np.float32))
        images = dict(zip((partner.name for partner in self.partners), partner_images, strict=True))
        if self._raw is not None:
            raw = self._raw.estimate(image, [images[pair.name] for pair in self.pairs])
        if (
            self._guess is not None
            and (~is_known(raw.depth)).mean() >= self.options.filler_share / 2
        ):
            views, estimator = self._guess
            guess = estimator.estimate(image, [images[view.name] for view in views]).clean()
            raw = replace(
                raw, guess=fill_background(guess.depth, guess.confidence, FILLED_CONFIDENCE)[0]
            )
        return finish(raw, self.options)

    def forget(self) -> None:
        """Begin a new sequence."""
        for estimator in (self._raw, self._guess and self._guess[1]):
            if estimator is not None:
                estimator.forget()

    def _check(self, image: Image8, partner_images: Sequence[Image8]) -> None:
        if len(partner_images) != len(self.partners):
            raise DepthError(
                f"camera {self.camera.name}: wanted {len(self.partners)} partner images, got "
                f"{len(partner_images)}"
            )
        for camera, picture in zip(
            (self.camera, *self.partners), (image, *partner_images), strict=True
        ):
            as_image8(picture, camera, DepthError)


def finish(raw: DepthMap, options: DepthOptions) -> DepthMap:
    """Post-process any matcher's depth: drop flying pixels, smooth surfaces, fill gaps by its guess
    or from the background.
    """
    raw = raw.clean()
    depth = smooth_surfaces(drop_flying_pixels(raw.depth, FLYING), SMOOTH, SMOOTH_RADIUS_PX)
    confidence = np.where(depth > 0, raw.confidence, np.float32(0))
    return _filled(DepthMap(depth, confidence, raw.guess), options)


def _filled(depth_map: DepthMap, options: DepthOptions) -> DepthMap:
    """Fill what is unknown by the guess, if there is one, else from the background."""
    unknown = ~is_known(depth_map.depth)
    if depth_map.guess is None or unknown.mean() < options.filler_share:
        return DepthMap(
            *fill_background(depth_map.depth, depth_map.confidence, FILLED_CONFIDENCE),
            depth_map.guess,
        )
    confidence = np.where(unknown, np.float32(FILLED_CONFIDENCE), depth_map.confidence)
    return DepthMap(
        np.where(unknown, depth_map.guess, depth_map.depth), confidence, depth_map.guess
    )


def check_depth(
    camera: Camera,
    depth_map: DepthMap,
    views: Sequence[tuple[Camera, DepthMap]],
    options: DepthOptions,
) -> DepthMap:
    """Check a camera's depth against the other sources of a view, and fill the rest by its guess or
    from the background.

    Args:
        depth_map: depth and confidence as they were found, (H, W).

    Returns:
        Depth and confidence, (H, W); those that were given where `options` want no consistency.
    """
    if not options.consistency:
        return depth_map
    checked = check_consistency(camera, depth_map, views)
    return replace(_filled(replace(checked, guess=depth_map.guess), options), guess=None)


def check_measured_depth(
    camera: Camera,
    image: Image8,
    depth_map: DepthMap,
    views: Sequence[tuple[Camera, DepthMap]],
    options: DepthOptions,
) -> DepthMap:
    """`check_depth` of what a sensor measured: the rest is filled along the edges of the colours.

    Holes of sensors are no shadows of nearer surfaces, as those of stereo are: the farther side is
    not likelier than the nearer.

    Args:
        image: what it saw, RGB, (H, W, 3).
        depth_map: filtered depth and confidence, (H, W).
    """
    if not options.consistency or not options.sensor:
        return depth_map
    checked = check_consistency(camera, depth_map, views)
    return fill_by_colour(checked, image)
