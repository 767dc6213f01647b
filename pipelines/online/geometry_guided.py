"""The paper's online method: one `step` per instant, from K source views with depth to the target
view.

A background memory shows what no source sees as it was seen before, where moving things uncovered
it; fillings do not boil.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from time import perf_counter
from typing import Literal

import numpy as np

from ggvs_eval.arrays import Map
from ggvs_eval.camera import Camera
from ggvs_eval.geometry.contested_depth import settle_depth
from ggvs_eval.geometry.per_pixel import largest_feature
from ggvs_eval.geometry.splat import COVERED_ALPHA, Splat, splat, splat_points
from ggvs_eval.geometry.tsdf import PreviousDepth, RayMarch, fusion_weights, ray_march
from ggvs_eval.kernels import get_threads, side_by_side
from ggvs_eval.method import Instant, Rendering, SourceView
from ggvs_eval.pipelines.online.blending import (
    FORGIVEN_PX,
    Blender,
    BlendingInputs,
    GeometricBlender,
)
from ggvs_eval.pipelines.online.exposure_compensation import ExposureCompensation
from ggvs_eval.pipelines.online.printed_march import FieldReading, printed_march
from ggvs_eval.pipelines.online.temporal_filters import (
    Change,
    RecurrentOutput,
    TemporalDepthFilter,
    cells,
    splatted_change,
    stillness,
)

# of the remembered depth: what is so far back at least is the same surface, or one behind it
BEHIND = 0.98
# of the remembered depth from one instant to the next, so that a wrong one does not last
FORGETTING = 0.99
RENEWAL = 0.15  # share of a new filling in the recursive mean of fillings
SURE_STILL = 0.5  # stillness from which on a pixel is background
FEATHER = 0.5  # share of COVERED_ALPHA below which a pixel is a hole altogether
# of the kernel
RULES = (BEHIND, FORGETTING, RENEWAL, SURE_STILL, COVERED_ALPHA, COVERED_ALPHA * FEATHER)
# of each source view; None if it was not there at the instant before
Changes = Sequence[Change | None]
# truncation distances within which a view's depth and the fused one are the same surface
SAME_SURFACE_TAU = 2.0


def diagnostics_maps(depth: Map | None, splats: Sequence[Splat], still: Map) -> dict[str, Map]:
    """Return the maps of `Rendering.diagnostics` except for the shares of the views, at a quarter
    of the size, see `cells`.

    Args:
        depth: fused depth, (H, W), world units, 0 where unknown; None without fusion.
        splats: forward renderings of the views.
        still: how sure it is that nothing moves, see `stillness`, (h, w).
    """
    coverage = np.maximum.reduce([cells(view.alpha) for view in splats])
    maps = {"coverage": coverage, "motion": 1 - still}
    if depth is not None:
        maps["depth"] = cells(depth)
    return maps


@dataclass(frozen=True)
class OnlineOptions:
    """Constants of the method; the paper's values, in metres where they are lengths.

    Attributes:
        temporal: the temporal depth filter, the temporal term of the ray march, the recurrent
            output, the remembered background and the memory of gains (off: 'No Temporal
            Filtering').
        fused: the ray march itself; without it the fused depth is unknown everywhere, for blenders
            that do not look at it ('No TSDF Guidance').
        lambda_t: colour difference that counts as motion (Eq. 1).
        beta_mask: smallest weight of a new depth (Eq. 1).
        history_tolerance: share of depth by which a new depth may differ from its history and still
            be mixed with it (Eq. 2).
        beta_temporal: strength of the temporal term (Eqs. 13-14).
        eta: limit of the temporal weight (Eq. 13).
        tau_m: truncation distance of the signed distance (Eqs. 9-10).
        depth_noise_m: depth noise in the fusion weight (Eqs. 11-12).
        mask_channels: how the difference of three colour channels becomes one number (Eq. 1), see
            `difference_mask`.
        mask_views: how the splatted masks of K views become one, see `target_mask`.
        splatted_depth: what is rendered forward: the ``new`` depth D^t, as printed, or the
            ``filtered`` one.
        splatted_as: pixel-sized ``gaussians``, or ``points`` that end at the border of a pixel.
        gaussian_scale_px: standard deviation of a Gaussian in source pixels.
        min_step: smallest step of the ray march, in tau; the march as printed has none, and does
            not end.
        signed_distance: see `FieldReading`; the march is slow with the one as printed.
        normalised_field: see `FieldReading`; the march is slow without.
        recurrent_limit: largest weight of the previous output where nothing moves, below 1, see
            `RecurrentOutput`; 0 for none, as in the paper.
        compensated: sources are brought to one colour before they are blended, gains and the
            fall-off of lenses alike, see `ExposureCompensation`; not in the paper.
        settled: fused depth that most views contradict gives way where their colours do, see
            `settle_depth`; not in the paper.
        forgiven_px: errors of depth by which a view still sees the fused surface, since they move
            what it shows there by no more source pixels, see `ggvs_eval.geometry.warp.forgiven`; 0,
            as in the paper, for none.
        remembered: what no source sees is shown as it was seen before, see `RememberedBackground`;
            not in the paper, and off, since it pays too rarely.

    Reading:
        What each reading is worth is measured in docs/readings.md.

        The paper calls two constants beta and gives one value, 0.6, taken for the masks.
        ``beta_temporal`` is chosen here: of 0.6, 1 and 2, the smallest for which the limit eta
        matters, 1 scored best on a validation room (demo seed 101, two views: STED 12.93, 12.65,
        13.51; PSNR 30.80, 30.78, 30.61 dB with Eq. 2 as printed; without temporal terms 14.09 and
        30.91).
    """

    temporal: bool = True
    fused: bool = True
    lambda_t: float = 0.7
    beta_mask: float = 0.6
    history_tolerance: float = 0.05
    beta_temporal: float = 1.0
    eta: float = 15.0
    tau_m: float = 0.02
    depth_noise_m: float = 0.001
    mask_channels: Literal["largest", "mean"] = "largest"
    mask_views: Literal["largest", "mean"] = "largest"
    splatted_depth: Literal["new", "filtered"] = "new"
    splatted_as: Literal["gaussians", "points"] = "gaussians"
    gaussian_scale_px: float = 0.5
    min_step: float = 0.1
    signed_distance: Literal["front", "printed"] = "front"
    normalised_field: bool = True
    recurrent_limit: float = 0.85
    compensated: bool = True
    settled: bool = True
    forgiven_px: float = FORGIVEN_PX
    remembered: bool = False

    def depth_filter(self) -> TemporalDepthFilter:
        """Make the filter of the source views' depth."""
        return TemporalDepthFilter(
            lambda_t=self.lambda_t,
            beta=self.beta_mask,
            tolerance=self.history_tolerance,
            enabled=self.temporal,
            channels=self.mask_channels,
        )


@dataclass(frozen=True)
class _Fused:
    """Fused depth of the instant before: where it was seen from, and how much evidence
    supports it.
    """

    index: int
    target: Camera
    march: RayMarch


class GeometryGuided:
    """Geometry-guided online synthesis (Secs. 3.1-3.3).

    Per instant: difference masks and temporally filtered depth of each source view, forward
    splatting of each view as pixel-sized Gaussians, fusion of the filtered depths by an image-based
    TSDF ray march in which the previous fused depth takes part, and blending. Beyond the paper,
    sources are brought to one colour and outputs averaged where nothing moves. State: one frame and
    one depth map per source camera; fused depth, output and background of the target.
    """

    def __init__(
        self, options: OnlineOptions | None = None, blender: Blender | None = None
    ) -> None:
        """Start a sequence with the given constants and blender (geometric weights unless given a
        network).
        """
        self.options = options = options or OnlineOptions()
        self.blender: Blender = blender or GeometricBlender()
        self._filter = options.depth_filter()
        self._previous: _Fused | None = None
        self._output = RecurrentOutput(options.recurrent_limit if options.temporal else 0.0)
        self._background = (
            RememberedBackground() if options.temporal and options.remembered else None
        )
        self._compensation = (
            ExposureCompensation() if options.temporal else ExposureCompensation(memory=1)
        )

    def step(self, instant: Instant) -> Rendering:
        """Synthesise one instant and remember its fused depth for the next."""
        marks = [perf_counter()]
        half = (len(instant.sources) + 1) // 2
        first, second = side_by_side(
            partial(self._filtered, instant, slice(0, half)),
            partial(self._filtered, instant, slice(half, None)),
        )
        views, changes = zip(*first, *second, strict=True)
        filtered = replace(instant, sources=views)
        # Gains are looked up by a single thread; the weights need no colours.
        filtered, weights = side_by_side(
            partial(self._compensated, filtered), partial(self._weights, filtered)
        )
        # without any whose colours are like no other's
        names = [source.camera.name for source in filtered.sources]
        places = [k for k, source in enumerate(instant.sources) if source.camera.name in names]
        instant = replace(instant, sources=tuple(instant.sources[k] for k in places))
        changes, weights = (
            tuple(changes[k] for k in places),
            [weights[k] for k in places if weights],
        )
        marks.append(perf_counter())
        splats = self._splat(instant, filtered, changes)
        marks.append(perf_counter())
        depth = (
            self._fused_depth(filtered, weights, splats, changes) if self.options.fused else None
        )
        marks.append(perf_counter())
        image, diagnostics = self._blend(filtered, splats, depth, changes)
        marks.append(perf_counter())
        seconds = dict(
            zip(("filter", "splat", "tsdf", "blend"), np.diff(marks).tolist(), strict=True)
        )
        if depth is None:
            del seconds["tsdf"]
        return Rendering(image=image, depth=depth, seconds=seconds, diagnostics=diagnostics)

    def _filtered(self, instant: Instant, part: slice) -> list[tuple[SourceView, Change | None]]:
        """Filter the depth of some of the sources: large maps made of small ones are made by a
        single thread.
        """
        return [self._filter.step(instant.index, source) for source in instant.sources[part]]

    def _compensated(self, filtered: Instant) -> Instant:
        """Return the instant with its sources brought to one colour, if that is wanted."""
        return (
            self._compensation.step(filtered, self._tau(filtered))
            if self.options.compensated
            else filtered
        )

    def _weights(self, filtered: Instant) -> list[Map]:
        """Weigh the filtered depths (Eqs. 11-12); none if they are not fused."""
        if not self.options.fused:
            return []
        noise = self.options.depth_noise_m * filtered.units_per_metre
        return [fusion_weights(view.depth, self._tau(filtered), noise) for view in filtered.sources]

    def _blend(
        self, filtered: Instant, splats: list[Splat], depth: Map | None, changes: Changes
    ) -> tuple[Map, dict[str, Map]]:
        """Blend the views, apply temporal blending in static regions.

        Return image and diagnostics.
        """
        options = self.options
        index, target = filtered.index, filtered.target
        surface = np.zeros((target.height, target.width), np.float32) if depth is None else depth
        inputs = BlendingInputs(
            instant=filtered,
            splats=splats,
            depth=surface,
            tau=self._tau(filtered),
            forgiven_px=options.forgiven_px,
        )

        def judged() -> tuple[Map, dict[str, Map]]:
            still = self._stillness(filtered, splats, depth, changes)
            return still, diagnostics_maps(depth, splats, still)

        (still, diagnostics), blended = side_by_side(judged, partial(self.blender.blend, inputs))
        if blended.weights is not None:
            diagnostics["weights"] = blended.weights
        image = np.asarray(blended.image, np.float32)
        if options.compensated:
            image = self._compensation.finish(image, target)
        if self._background is not None:
            image = self._background.step(index, target, image, surface, splats, still)
        image = self._output.step(index, target, image, still)
        return np.clip(image, 0, 1, out=image), diagnostics

    def _stillness(
        self, filtered: Instant, splats: list[Splat], depth: Map | None, changes: Changes
    ) -> Map:
        """Certainty that nothing moves, by the views that were there at the instant before."""
        places = [k for k, change in enumerate(changes) if change is not None]
        if not places:
            return np.zeros_like(cells(splats[0].alpha))
        if depth is None:
            most = np.argmax([view.alpha for view in splats], axis=0)
            depth = np.choose(most, [view.depth for view in splats])
        views, informed = (
            [filtered.sources[k] for k in places],
            [change for change in changes if change is not None],
        )
        largest = splatted_change(
            [splats[k] for k in places], self.options.beta_mask, self.options.lambda_t
        )
        return stillness(
            filtered.target, depth, views, informed, largest, SAME_SURFACE_TAU * self._tau(filtered)
        )

    def _splat(self, instant: Instant, filtered: Instant, changes: Changes) -> list[Splat]:
        """Render each view forward: colour, difference mask, coverage and depth (Sec. 3.1)."""
        target, near, options, splats = instant.target, instant.near_plane, self.options, []
        for source, view, change in zip(instant.sources, filtered.sources, changes, strict=True):
            mask = np.ones_like(source.depth) if change is None else change.mask
            splatted_view = (
                view if options.splatted_depth == "filtered" else replace(view, depth=source.depth)
            )
            if options.splatted_as == "points":
                splats.append(splat_points(splatted_view, target, near=near, extra=mask))
            else:
                splats.append(
                    splat(
                        [splatted_view],
                        target,
                        near=near,
                        extras=[mask],
                        scale=options.gaussian_scale_px,
                    )
                )
        return splats

    def _fused_depth(
        self, filtered: Instant, weights: list[Map], splats: list[Splat], changes: Changes
    ) -> Map:
        """Return the depth of the ray march, settled by colours where most views contradict it."""
        depth = self._march(
            filtered, weights, self._previous_depth(filtered, splats, changes)
        ).depth
        if not self.options.settled:
            return depth
        return settle_depth(
            filtered.target, depth, filtered.sources, splats, SAME_SURFACE_TAU * self._tau(filtered)
        )

    def _march(
        self, filtered: Instant, weights: list[Map], previous: PreviousDepth | None
    ) -> RayMarch:
        """Fuse the filtered depths, and the previous fused depth, in the target view (Eqs. 3,
        9-14).
        """
        cameras, depths = (
            [view.camera for view in filtered.sources],
            [view.depth for view in filtered.sources],
        )
        reading = FieldReading(self.options.signed_distance, self.options.normalised_field)
        march_by = (
            ray_march if reading == FieldReading() else partial(printed_march, reading=reading)
        )
        march = march_by(
            filtered.target,
            cameras,
            depths,
            weights,
            tau=self._tau(filtered),
            previous=previous,
            min_step=self.options.min_step,
        )
        self._previous = _Fused(filtered.index, filtered.target, march)
        return march

    def _tau(self, instant: Instant) -> float:
        """Return the truncation distance, world units."""
        return self.options.tau_m * instant.units_per_metre

    def _previous_depth(
        self, instant: Instant, splats: list[Splat], changes: Changes
    ) -> PreviousDepth | None:
        """Return the fused depth of the instant before as one more depth camera, trusted where
        nothing moves (Eqs. 13-14).
        """
        if (
            not self.options.temporal
            or self._previous is None
            or self._previous.index != instant.index - 1
        ):
            return None
        informed = [
            view for view, change in zip(splats, changes, strict=True) if change is not None
        ]
        if not informed:
            return None
        mask = target_mask(informed, self.options.mask_views)
        gain = np.subtract(np.float32(1), mask, out=mask)
        np.maximum(gain, np.float32(0), out=gain)
        gain *= np.float32(self.options.beta_temporal)
        return PreviousDepth(
            camera=self._previous.target,
            depth=self._previous.march.depth,
            accumulated_weight=self._previous.march.weight,
            gain=gain,
            limit=self.options.eta,
        )


def target_mask(splats: list[Splat], views: Literal["largest", "mean"] = "largest") -> Map:
    """Return the motion in the target view: the largest splatted difference mask, 1 (all is new)
    where no view covers the pixel.

    Args:
        splats: forward renderings of the views that were there at the instant before; the fourth
            feature is the difference mask.
        views: ``largest``, or the ``mean`` over the views that cover the pixel.

    Returns:
        M^t in the target view, (H, W).

    Reading:
        The paper's channel-wise maximum is taken over the K splatted masks. The paper filters all
        views of the rig, here the K chosen ones keep a state: a newly chosen one cannot detect
        motion, and has no vote.
    """
    features, alphas = [view.features for view in splats], [view.alpha for view in splats]
    if views == "largest":
        return largest_feature(
            features, alphas, channel=3, least_alpha=COVERED_ALPHA, otherwise=1.0
        )
    covering = np.zeros_like(alphas[0])
    mask = np.zeros_like(covering)
    for view in splats:
        covers = view.alpha >= COVERED_ALPHA
        covering += covers
        mask += np.where(covers, view.features[..., 3], np.float32(0))
    return np.where(covering > 0, mask / np.maximum(covering, np.float32(1)), np.float32(1))


@dataclass(eq=False)
class _Memory:
    """The farthest that the target saw, (H, W, 3), and its depth, (H, W): 0 of a filling, negative
    of what moved.
    """

    index: int
    target: Camera
    image: Map
    depth: Map


class RememberedBackground:
    """Replaces the filling of holes by what the target showed there before, as long as it is
    static.

    A pixel that does not move is remembered with its depth unless something behind it is, and
    forgotten when it begins to move: a hole shows the wall that somebody hides from the sources, or
    has uncovered, and not the body that has left. Where nothing is remembered the recursive mean of
    the fillings is shown, which begins with the first one. State: one image and one depth map of
    the target.

    Reading:
        Not in the paper, whose network invents the background anew in every frame. Off by default:
        in holes of a validation room it gained 0.08 dB with two rows of cameras, and nothing on an
        arc nor with other exposures (docs/readings.md).
    """

    def __init__(self) -> None:
        self._memory: _Memory | None = None

    def step(
        self,
        index: int,
        target: Camera,
        image: Map,
        depth: Map,
        splats: Sequence[Splat],
        still: Map,
    ) -> Map:
        """Return the output of an instant with its holes filled from memory.

        Args:
            index: of the instant; after a gap, or from another pose, nothing is remembered.
            target: camera of the output.
            image: blended, holes filled from their surroundings, (H, W, 3), float32; written into.
            depth: fused, (H, W), world units, 0 where unknown.
            splats: forward renderings of the sources; their coverage gives the holes.
            still: how sure it is that nothing moves at each cell, see `stillness`.

        Returns:
            The image.
        """
        memory = self._memory
        if (
            memory is None
            or memory.index != index - 1
            or not memory.target.shows_the_same_rays(target)
        ):
            in_hole = reduce(np.maximum, (view.alpha for view in splats)) < COVERED_ALPHA
            self._memory = _Memory(
                index=index,
                target=target,
                image=image.copy(),
                depth=np.where(in_hole, np.float32(0), depth),
            )
            return image
        from ggvs_eval.kernels import _core

        memory.index = index
        alphas = [np.ascontiguousarray(view.alpha, np.float32) for view in splats]
        depth_map, image = (
            np.ascontiguousarray(depth, np.float32),
            np.ascontiguousarray(image, np.float32),
        )
        _core.remember(
            depth_map, still, alphas, RULES, image, memory.image, memory.depth, get_threads()
        )
        return image
