"""Depth from all partners at once: planes swept from a small image to the full one, then the
fraction of a plane.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval import kernels
from ggvs_eval.arrays import Image8, Map
from ggvs_eval.camera import Camera
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.pipelines.offline.depth.matchers import Estimator, Matcher
from ggvs_eval.pipelines.offline.plane_sweep.planes import plan_planes
from ggvs_eval.pipelines.offline.plane_sweep.views import (
    PartnerView,
    Projection,
    find_hidden,
    turn_partner,
)

CONFIRMING = 0.3  # a partner takes part where its correlation is at least this
FLAT = np.float32(0.1)  # confidence without texture, a third of what counts as sure
MOST_STEP = 0.7  # planes
# (grey values / pixel)^2; holds the surface where the images have no gradient along the parallax
DAMPING = 4.0


@dataclass(frozen=True)
class PlaneSweep(Matcher):
    """Planes swept through all partners at once, then semi-global matching over them along eight
    paths (Hirschmueller 2008).

    The planes are evenly in inverse depth. The cost of a pixel on a plane is one minus the
    normalised cross-correlation of its window with the partners', 0 to 1. Matching goes from a
    small image to the full one: what the small one finds says which planes are worth a look, and
    which partners see a point.

    Attributes:
        step_px: from plane to plane, points move by this much in the image of the widest partner,
            pixels.
        most_planes: maximum number, in steps of 32 and not above 256; where it does not suffice,
            they are farther apart.
        radius_px: of the correlated window, 1 to 3.
        colour_scale: a pixel of the window counts less than half where its colour differs by this
            much, grey values.
        noise: variance of grey values that is no texture.
        small_step: penalty of a step of one plane between neighbours, in units of the cost.
        large_step: penalty of a larger step, on a surface of one grey.
        edge_grey: difference of grey values of neighbours at which a larger step costs half.
        smallest_px: the image is halved until its longer side is at most this.
        search_planes: how far around what the smaller image found planes are looked at.
        median_radius_px: depth edges are moved to those of the image by a median over windows of
            this radius; 0 leaves them.
        median_colour: in that median, a pixel's weight falls by e for this difference of grey
            values.
        refinements: Gauss-Newton steps on the images, which find the fraction of a plane.
    """

    name = "plane-sweep"
    step_px: float = 0.5
    most_planes: int = 192
    radius_px: int = 2
    colour_scale: float = 20.0
    noise: float = 0.5
    small_step: float = 0.06
    large_step: float = 0.6
    edge_grey: float = 10.0
    smallest_px: int = 360
    search_planes: int = 4
    median_radius_px: int = 5
    median_colour: float = 7.0
    refinements: int = 1

    def estimator(self, camera: Camera, partners: Sequence[Camera], *_: object) -> Estimator:
        """See Matcher.estimator."""
        return PlaneSweepEstimator(camera, partners, self)


class SurfaceFit:
    """A surface checked against a reference image and the partners' images.

    Args:
        grey: the reference's grey image, (H, W).
        hidden_px: see `find_hidden`.
    """

    def __init__(
        self,
        grey: Map,
        views: Sequence[PartnerView],
        turned: Sequence[Map],
        n_partners: int,
        *,
        noise: float,
        window_px: int,
        hidden_px: float,
    ) -> None:
        self.grey, self.views, self.turned, self.n_partners = (
            grey,
            tuple(views),
            tuple(turned),
            n_partners,
        )
        self.noise, self.window_px, self.hidden_px = np.float32(noise), window_px, hidden_px
        self._mean = self._blur(grey)
        self._variance = self._blur(grey * grey) - self._mean**2

    def refine(self, inverse_depth: Map, step: float) -> Map:
        """Return one Gauss-Newton step towards the smallest difference of the windows, gains and
        offsets aside.

        Args:
            inverse_depth: the surface, (H, W), 1 / world units.
            step: from plane to plane; the surface moves by less than one.
        """
        slope, curvature = np.zeros_like(inverse_depth), np.zeros_like(inverse_depth)
        for view, image in zip(self.views, self.turned, strict=True):
            places = view.project(inverse_depth)
            samples = self._look_up(image, places)
            score, gain = self._correlate(samples)
            weight = self._weight(view, inverse_depth, places, score)
            change = (
                self._look_up(cv2.Sobel(image, cv2.CV_32F, 1, 0, scale=1 / 8), places)
                * places.column_slope
            )
            change += (
                self._look_up(cv2.Sobel(image, cv2.CV_32F, 0, 1, scale=1 / 8), places)
                * places.row_slope
            )
            moved = gain * (
                self._covariance(self.grey, change) - gain * self._covariance(samples, change)
            )
            speed = places.column_slope**2 + places.row_slope**2
            slope += weight * moved
            curvature += weight * (
                gain**2 * self._covariance(change, change) + np.float32(DAMPING) * speed
            )
        update = np.divide(slope, curvature, out=np.zeros_like(slope), where=curvature > 0)
        return inverse_depth + np.clip(update, -MOST_STEP * step, MOST_STEP * step).astype(
            np.float32
        )

    def confidence(self, inverse_depth: Map) -> Map:
        """Measure how far all partners confirm the surface, (H, W) in [0, 1].

        Those that do not see it count 0.

        A partner that sees it confirms it by the correlation of its window, and a little without
        any: if there is no texture the surface comes from its surroundings, and is better than what
        would be guessed in its place.
        """
        total = np.zeros_like(inverse_depth)
        for view, image in zip(self.views, self.turned, strict=True):
            places = view.project(inverse_depth)
            score, _ = self._correlate(self._look_up(image, places))
            visibility = self._sees(view, inverse_depth, places)
            total += np.where(visibility, FLAT + (1 - FLAT) * _confirmation(score), np.float32(0))
        return total / np.float32(self.n_partners)

    def _weight(self, view: PartnerView, inverse_depth: Map, places: Projection, score: Map) -> Map:
        """Return the partner's correlation where it confirms the surface, else 0."""
        return np.where(
            self._sees(view, inverse_depth, places), _confirmation(score), np.float32(0)
        )

    def _sees(self, view: PartnerView, inverse_depth: Map, places: Projection) -> NDArray[np.bool_]:
        return view.sees(places) & ~find_hidden(view, inverse_depth, self.hidden_px)

    def _correlate(self, samples: Map) -> tuple[Map, Map]:
        """Return the normalised cross-correlation with the reference, and the gain that takes
        `samples` to it; (H, W) each.
        """
        mean = self._blur(samples)
        variance = np.maximum(self._blur(samples * samples) - mean * mean, 0) + self.noise
        covariance = self._blur(samples * self.grey) - mean * self._mean
        score = covariance / np.sqrt(variance * (np.maximum(self._variance, 0) + self.noise))
        return score, np.clip(covariance / variance, 0.5, 2)

    def _covariance(self, first: Map, second: Map) -> Map:
        return self._blur(first * second) - self._blur(first) * self._blur(second)

    def _look_up(self, image: Map, places: Projection) -> Map:
        return cv2.remap(
            image, places.column, places.row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )

    def _blur(self, values: Map) -> Map:
        return cv2.blur(values, (self.window_px, self.window_px), borderType=cv2.BORDER_REFLECT)


def _confirmation(score: Map) -> Map:
    """Return a correlation where it is high enough to confirm anything, else 0."""
    return np.where(score > CONFIRMING, np.minimum(score, np.float32(1)), np.float32(0))


DISTANCE_SCALE_PX = 1.5  # a pixel of the window this far from its middle counts half
HIDDEN_PX = 1.5  # of parallax; a surface this much nearer occludes
# of a partner that should not see a point: little, but all there is where all are hidden
HIDDEN_WEIGHT = 0.05
MEDIAN_TOLERANCE = 5.0  # planes; what is as near to the median of its surroundings stays


@dataclass(frozen=True, eq=False)
class LevelImages:
    """The images of one instant, as one size of the sweep needs them.

    Attributes:
        guide: what the camera saw, RGB, (H, W, 3).
        grey: the same in grey around 0, (H, W).
        turned: the partners' grey images on the camera's axes.
    """

    guide: Image8
    grey: Map
    turned: tuple[Map, ...]


class SweepLevel:
    """Matches a camera with its partners at one size.

    All that does not depend on the images is prepared once.

    Args:
        partners: the cameras it is matched with, at their full size.
    """

    def __init__(self, camera: Camera, partners: Sequence[Camera], options: PlaneSweep) -> None:
        self.camera, self.options = camera, options
        shrunk = [_as_fine_as(camera, partner) for partner in partners]
        self.planes = plan_planes(camera, shrunk, options.step_px, options.most_planes)
        views = [
            turn_partner(camera, partner, self.planes, options.radius_px) for partner in shrunk
        ]
        # n: which partner
        self._views = [
            (n, shrunk[n].size, view) for n, view in enumerate(views) if view is not None
        ]
        self._n_partners = len(partners)

    @property
    def blind(self) -> bool:
        """True if no partner sees anything of what the camera sees."""
        return not self._views

    def load(self, image: Image8, partner_images: Sequence[Image8]) -> LevelImages:
        """Prepare the images of one instant, given at full size, RGB."""
        guide = np.ascontiguousarray(_shrink(image, self.camera.size))
        turned = [
            view.turn(_grey(_shrink(partner_images[n], size))) for n, size, view in self._views
        ]
        return LevelImages(guide, _grey(guide), tuple(turned))

    def match(self, images: LevelImages, prior: Map | None) -> Map:
        """Return the surface that the images agree on.

        Args:
            prior: inverse depth found at a smaller size, (H', W'); None looks at every plane.

        Returns:
            Inverse depth, (H, W), 1 / world units.
        """
        if prior is not None:
            prior = cv2.resize(prior, self.camera.size, interpolation=cv2.INTER_NEAREST)
        surface = self._aggregate(images.guide, self._costs(images, prior))
        if self.options.median_radius_px:
            surface = self._move_edges(images.guide, surface)
        return self.planes.inverse_depth_of(surface)

    def fit(self, images: LevelImages) -> SurfaceFit:
        """Return the fit that evaluates a surface by these images."""
        return SurfaceFit(
            grey=images.grey,
            views=[view for _, _, view in self._views],
            turned=images.turned,
            n_partners=self._n_partners,
            noise=self.options.noise,
            window_px=2 * self.options.radius_px + 1,
            hidden_px=HIDDEN_PX,
        )

    def _costs(self, images: LevelImages, prior: Map | None) -> NDArray[np.uint8]:
        """(H, W, planes)."""
        from ggvs_eval.kernels import _stereo

        options, planes = self.options, self.planes
        partners = []
        for (_, _, view), turned in zip(self._views, images.turned, strict=True):
            visible = (
                None if prior is None else (~find_hidden(view, prior, HIDDEN_PX)).astype(np.uint8)
            )
            partners.append((turned, view.first, view.last, visible, view.motion))
        return _stereo.sweep_planes(
            images.grey,
            images.guide,
            partners,
            (options.radius_px, options.colour_scale, DISTANCE_SCALE_PX, options.noise),
            HIDDEN_WEIGHT,
            (planes.first, planes.step, planes.count),
            self._ranges(prior),
            *_threads_and_level(),
        )

    def _ranges(self, prior: Map | None) -> NDArray[np.int32]:
        """Select the planes of each tile of the kernel: around those of the prior in it and its
        eight neighbours.
        """
        from ggvs_eval.kernels import _stereo

        columns, rows = _stereo.TILE_SIZE
        width, height = self.camera.size
        across, down = -(-width // columns), -(-height // rows)
        if prior is None:
            return np.tile(np.array([0, self.planes.count], np.int32), (down, across, 1))
        surface = (prior - np.float32(self.planes.first)) / np.float32(self.planes.step)
        padded = np.pad(
            surface, ((0, down * rows - height), (0, across * columns - width)), mode="edge"
        )
        tiles = padded.reshape(down, rows, across, columns)
        beside = np.ones((3, 3), np.uint8)
        first = cv2.erode(tiles.min(axis=(1, 3)), beside) - self.options.search_planes
        last = cv2.dilate(tiles.max(axis=(1, 3)), beside) + self.options.search_planes + 1
        ranges = np.stack([np.floor(first), np.ceil(last)], axis=-1)
        return np.ascontiguousarray(np.clip(ranges, 0, self.planes.count).astype(np.int32))

    def _aggregate(self, guide: Image8, costs: NDArray[np.uint8]) -> Map:
        """Semi-global matching: the surface in planes, (H, W)."""
        from ggvs_eval.kernels import _stereo

        options, limit = self.options, _stereo.COST_LIMIT
        small = round(options.small_step * limit)
        falling = options.large_step / (1 + np.arange(256) / options.edge_grey)
        large = np.clip(np.rint(falling * limit), 2 * small, limit - small).astype(np.uint8)
        grey = cv2.cvtColor(guide, cv2.COLOR_RGB2GRAY)
        return _stereo.aggregate(costs, grey, small, large, *_threads_and_level())[0]

    def _move_edges(self, guide: Image8, surface: Map) -> Map:
        from ggvs_eval.kernels import _stereo

        radius, colour = self.options.median_radius_px, self.options.median_colour
        threads = kernels.get_threads()
        return _stereo.weighted_median(
            surface, guide, self.planes.count, radius, colour, MEDIAN_TOLERANCE, threads
        )


def _threads_and_level() -> tuple[int, int]:
    return kernels.get_threads(), kernels.SIMD_LEVELS.index(kernels.get_simd_level())


def _as_fine_as(camera: Camera, partner: Camera) -> Camera:
    """Return the partner at a size at which its pixels are no finer than the camera's."""
    share = min(1.0, camera.focal_px / partner.focal_px)
    return partner.resized(
        max(round(partner.width * share), 1), max(round(partner.height * share), 1)
    )


def _shrink(image: Image8, size: tuple[int, int]) -> Image8:
    if image.shape[1::-1] == size:
        return image
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def _grey(image: Image8) -> Map:
    """Around 0, which keeps sums of squares small."""
    return cv2.cvtColor(image.astype(np.float32), cv2.COLOR_RGB2GRAY) - np.float32(128)


class PlaneSweepEstimator(Estimator):
    """Depth of one camera by a plane sweep.

    Everything that does not depend on the images is prepared once.
    """

    def __init__(self, camera: Camera, partners: Sequence[Camera], options: PlaneSweep) -> None:
        self.options = options
        sizes = _halved(camera.size, options.smallest_px)
        self._levels = [SweepLevel(camera.resized(*size), partners, options) for size in sizes]

    def estimate(self, image: Image8, partner_images: Sequence[Image8]) -> DepthMap:
        """Return the depth at one instant, invalid everywhere where no partner sees anything of the
        camera's view.

        Returns:
            Depth, (H, W), and confidence: the mean correlation of the partners' windows with the
            camera's, 0 for a partner that sees something else or nothing.
        """
        finest = self._levels[-1]
        if finest.blind:
            zeros = np.zeros(image.shape[:2], np.float32)
            return DepthMap(zeros, zeros.copy())
        prior: Map | None = None
        for level in self._levels[:-1]:
            if not level.blind:  # as it is where what partners see is too small when halved
                prior = level.match(level.load(image, partner_images), prior)
        images = finest.load(image, partner_images)
        inverse_depth, fit = finest.match(images, prior), finest.fit(images)
        for _ in range(self.options.refinements):
            refined = fit.refine(inverse_depth, finest.planes.step)
            # what is beyond the planes is not at infinity
            inverse_depth = np.maximum(refined, np.float32(finest.planes.first))
        return DepthMap(np.float32(1) / inverse_depth, fit.confidence(inverse_depth))


def _halved(size: tuple[int, int], smallest_px: int) -> list[tuple[int, int]]:
    """Sizes from the smallest to `size`; at least two, as only the second knows who hides what."""
    sizes = [size]
    while max(sizes[0]) > smallest_px or len(sizes) < 2:
        width, height = sizes[0]
        sizes.insert(0, (-(-width // 2), -(-height // 2)))
    return sizes
