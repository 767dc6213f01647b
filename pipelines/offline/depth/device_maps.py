"""Finish and cross-check of the depth of several cameras on a device, as `finish` and `check_depth`
do on the CPU.

Maps are stacks (K, H, W), 0 where depth is unknown. The same operations are launched for any
values, nothing is uploaded and the host reads nothing, so that a GPU records them behind the
network that found the depth. Sums differ from the CPU's in the last bits; of pixels that a
comparison decides a few are decided otherwise.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor
from torch.nn import functional

from ggvs_eval.pipelines.offline.depth import consistency
from ggvs_eval.pipelines.offline.depth.camera_depth import (
    FILLED_CONFIDENCE,
    FLYING,
    SMOOTH,
    SMOOTH_RADIUS_PX,
    DepthOptions,
)
from ggvs_eval.pipelines.offline.depth.consistency import LEAST_SLOPE, UNCHECKED
from ggvs_eval.plugins import DEVICE_PARTS

Maps = tuple[Tensor, Tensor]  # depth and confidence


def finisher(options: DepthOptions) -> Callable[..., Maps]:
    """Post-processing of a stack by these options.

    Maps are checked against each other if they include consistency and K > 1.

    On a GPU by kernels where Warp and contrib's part are there: 24 ms of four maps of 1024x768
    become a few.
    """
    by_kernels = options.matcher.device != "cpu" and "depth finish" in DEVICE_PARTS
    return partial(DEVICE_PARTS["depth finish"] if by_kernels else finish_maps, options=options)


def finish_maps(
    depth: Tensor, confidence: Tensor, between: Tensor, *, options: DepthOptions
) -> Maps:
    """Drop flying pixels, smooth surfaces, remove what the other maps contradict, and fill the rest
    from the background.

    Args:
        depth: as found, (K, H, W).
        between: see `projections_between`.
    """
    depth = smooth_surfaces(drop_flying_pixels(depth, FLYING), SMOOTH, SMOOTH_RADIUS_PX)
    confidence = torch.where(depth > 0, confidence, 0.0)
    depth, confidence = fill_background(depth, confidence, FILLED_CONFIDENCE)
    if not options.consistency or len(depth) == 1:
        return depth, confidence
    return fill_background(*check_consistency(depth, confidence, between), FILLED_CONFIDENCE)


def drop_flying_pixels(depth: Tensor, share: float) -> Tensor:
    """See `fusion.drop_flying_pixels`."""
    height, width = depth.shape[1:]
    padded, allowed = functional.pad(depth, (1, 1, 1, 1)), share * depth
    near = [
        ((padded[:, row : row + height, column : column + width] - depth).abs() < allowed).to(
            torch.uint8
        )
        for row in range(3)
        for column in range(3)
    ]
    # itself and three others
    return torch.where(sum(near, torch.zeros_like(near[0])) >= 4, depth, 0.0)


def smooth_surfaces(depth: Tensor, share: float, radius_px: int) -> Tensor:
    """See `fusion.smooth_surfaces`.

    OpenCV reads the weights of a difference from a table, here they are computed.
    """
    height, width = depth.shape[1:]
    logarithm = depth.clamp(min=1e-6).log()
    padded = functional.pad(logarithm, (radius_px,) * 4, mode="reflect")
    total, weights = torch.zeros_like(depth), torch.zeros_like(depth)
    for row in range(-radius_px, radius_px + 1):
        for column in range(-radius_px, radius_px + 1):
            square = row**2 + column**2
            if square <= radius_px**2:
                top, left = radius_px + row, radius_px + column
                off = padded[:, top : top + height, left : left + width] - logarithm
                weight = (
                    off.square() * (-0.5 / share**2) - square / (2 * (0.75 * radius_px) ** 2)
                ).exp()
                total.addcmul_(weight, off)
                weights += weight
    return torch.where(depth > 0, (logarithm + total / weights).exp(), 0.0)


def fill_background(depth: Tensor, confidence: Tensor, filled_confidence: float) -> Maps:
    """See `fusion.fill_background`."""
    if filled_confidence <= 0:
        return depth, confidence
    filled = torch.where(depth > 0, depth, _farther_neighbour(depth))
    columns = _farther_neighbour(filled.transpose(1, 2).contiguous()).transpose(1, 2)
    filled = torch.where(filled > 0, filled, columns)
    return filled, torch.where(depth > 0, confidence, filled_confidence * (filled > 0))


def _farther_neighbour(depth: Tensor) -> Tensor:
    """Return the larger of the nearest known depths on the same row to the left and to the right.

    0 on empty rows.
    """
    width = depth.shape[2]
    columns = torch.arange(width, device=depth.device).expand(depth.shape)
    left = torch.where(depth > 0, columns, 0).cummax(dim=2).values
    right = (width - 1) - torch.where(depth > 0, (width - 1) - columns, 0).flip(2).cummax(
        dim=2
    ).values.flip(2)
    return torch.maximum(depth.gather(2, left), depth.gather(2, right))


def check_consistency(depth: Tensor, confidence: Tensor, between: Tensor) -> Maps:
    """Check each map of a stack against all others, see `consistency.check_consistency`."""
    depth = torch.where(confidence >= consistency.LEAST_CONFIDENCE, depth, 0.0)
    views = [
        _Others(depth=depth, confidence=confidence, between=between, shift=shift)
        for shift in range(1, len(depth))
    ]
    verdict = _evaluate(views, depth, confidence)
    agreed = (verdict.support + verdict.conflict).clamp(max=consistency.MIN_SUPPORT)
    mask = (depth > 0) & (verdict.support >= agreed) & (verdict.conflict <= verdict.support)
    result, sure = torch.where(mask, verdict.depth, 0.0), torch.where(mask, verdict.confidence, 0.0)
    if consistency.FILL_SUPPORT <= 0:
        return result, sure
    nearest, unknown = torch.full_like(depth, torch.inf), result == 0
    for view in views:
        layer = torch.where(unknown, view.project(), torch.inf)
        mask_of_layer = layer.isfinite()
        verdict = _evaluate(views, torch.where(mask_of_layer, layer, 0.0), torch.zeros_like(depth))
        better = (
            mask_of_layer
            & (verdict.support >= min(consistency.FILL_SUPPORT, len(views)))
            & (verdict.conflict == 0)
        )
        better &= verdict.depth < nearest
        nearest, sure = (
            torch.where(better, verdict.depth, nearest),
            torch.where(better, verdict.confidence, sure),
        )
    return torch.where(nearest.isfinite(), nearest, result), sure


@dataclass(frozen=True, eq=False)
class _Verdict:
    """Verdict of the others on a point of each pixel, (K, H, W) each, see
    `consistency._Verdict`.
    """

    support: Tensor
    conflict: Tensor
    depth: Tensor
    confidence: Tensor


def _evaluate(views: Sequence["_Others"], depth: Tensor, confidence: Tensor) -> _Verdict:
    """Ask the others about points at this depth, where it is known."""
    support, conflict = (torch.zeros_like(depth) for _ in range(2))
    total, mass, weighted = confidence, confidence, confidence * depth
    for view in views:
        supports, conflicts, view_depth, trust = view.ask(depth)
        support, conflict = support + supports, conflict + conflicts
        trust = torch.where(supports, trust, 0.0)
        total, counted = total + trust, torch.where(view_depth > 0, trust, 0.0)
        mass, weighted = mass + counted, weighted + counted * view_depth
    averaged = (support > 0) & (mass > 0)
    mean = torch.where(averaged, weighted / torch.where(averaged, mass, 1.0), depth)
    evaluated = support + conflict
    sure = torch.where(evaluated > 0, total / (1 + evaluated), float(UNCHECKED) * confidence)
    return _Verdict(support=support, conflict=conflict, depth=mean, confidence=sure)


class _Others:
    """Of each camera another one's map: that which comes `shift` later in the stack."""

    def __init__(self, depth: Tensor, confidence: Tensor, between: Tensor, shift: int) -> None:
        self._height, self._width = depth.shape[1:]
        self._depth, self._confidence = depth.roll(-shift, 0), confidence.roll(-shift, 0)
        # Of camera k: from its pixels to those of the other, and back; views of the same numbers.
        self._there = between.roll(-shift, 1).diagonal().T
        self._back = between.transpose(0, 1).roll(-shift, 1).diagonal().T
        self._v, self._u = (
            torch.arange(side, device=depth.device, dtype=torch.float32) + 0.5
            for side in depth.shape[1:]
        )
        self._v = self._v[:, None]
        self._rays = _rays(self._there, self._u, self._v)

    def ask(self, depth: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """See `consistency._OtherView.ask`.

        Nothing is supported or contradicted where depth is unknown.
        """
        u, v, expected = _move(self._there, self._rays, depth)
        inside = (depth > 0) & self._inside(u, v, expected)
        u, v = torch.where(inside, u, 0.0), torch.where(inside, v, 0.0)
        map_depth = self._look_up(u, v, expected)
        evaluated = inside & (map_depth > 0)
        back_u, back_v, _ = _move(self._back, _rays(self._back, u, v), map_depth)
        gap = (map_depth - expected).abs()
        near = (back_u - self._u).square() + (back_v - self._v).square() <= consistency.ERROR_PX**2
        near |= gap <= consistency.WIDE_SHARE * expected
        supports = evaluated & near & (gap <= consistency.ERROR_SHARE * expected)
        conflicts = evaluated & ~supports & (map_depth > expected)
        slope = self._rays[2]
        step = (map_depth - expected) / slope.clamp(min=float(LEAST_SLOPE))
        counts = (
            supports
            & (slope > float(LEAST_SLOPE))
            & (step.abs() <= consistency.ERROR_SHARE * depth)
        )
        return (
            supports,
            conflicts,
            torch.where(counts, depth + step, 0.0),
            self._at(self._confidence, u.long(), v.long()),
        )

    def project(self) -> Tensor:
        """Return the others' depth in the cameras' pixels, the nearest where points meet.

        Inf elsewhere.
        """
        u, v, depth = _move(self._back, _rays(self._back, self._u, self._v), self._depth)
        inside = (self._depth > 0) & self._inside(u, v, depth)
        outside = self._height * self._width  # a cell that is not looked at
        pixel = torch.where(
            inside,
            torch.where(inside, v, 0.0).long() * self._width + torch.where(inside, u, 0.0).long(),
            outside,
        )
        layer = torch.full((len(depth), outside + 1), torch.inf, device=depth.device)
        layer.scatter_reduce_(1, pixel.flatten(1), depth.flatten(1), "amin")
        return layer[:, :-1].view(depth.shape)

    def _inside(self, u: Tensor, v: Tensor, depth: Tensor) -> Tensor:
        return (depth > 0) & (u >= 0) & (u < self._width) & (v >= 0) & (v < self._height)

    def _at(self, maps: Tensor, column: Tensor, row: Tensor) -> Tensor:
        return maps.flatten(1).gather(1, (row * self._width + column).flatten(1)).view(maps.shape)

    def _look_up(self, u: Tensor, v: Tensor, expected: Tensor) -> Tensor:
        """See `consistency._OtherView._look_up`."""
        x, y = (u - 0.5).clamp(0, self._width - 1), (v - 0.5).clamp(0, self._height - 1)
        left, top = x.long(), y.long()
        x, y = x - left, y - top  # now shares
        right, bottom = (left + 1).clamp(max=self._width - 1), (top + 1).clamp(max=self._height - 1)
        taps = [
            self._at(self._depth, column, row) for row in (top, bottom) for column in (left, right)
        ]
        upper, lower = taps[0] + x * (taps[1] - taps[0]), taps[2] + x * (taps[3] - taps[2])
        closest = taps[0]
        for tap in taps[1:]:
            closest = torch.where((tap - expected).abs() < (closest - expected).abs(), tap, closest)
        low, high = torch.minimum(taps[0], taps[1]), torch.maximum(taps[0], taps[1])
        for tap in taps[2:]:
            low, high = torch.minimum(low, tap), torch.maximum(high, tap)
        return torch.where(
            high - low > consistency.ERROR_SHARE * expected, closest, upper + y * (lower - upper)
        )


def _rays(numbers: Tensor, u: Tensor, v: Tensor) -> list[Tensor]:
    """Return the homogeneous pixels in other cameras at depth 1, without the offset, of pixels
    here; numbers are (K, 12).
    """
    return [
        row[:, 0] * u + row[:, 1] * v + row[:, 2]
        for row in numbers[:, :9].view(-1, 3, 3, 1, 1).unbind(1)
    ]


def _move(numbers: Tensor, rays: Sequence[Tensor], depth: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the image coordinates and depth in other cameras of points at a depth along
    `_rays`.
    """
    offsets = numbers[:, 9:].view(-1, 3, 1, 1).unbind(1)
    x, y, z = (depth * ray + offset for ray, offset in zip(rays, offsets, strict=True))
    return x / z, y / z, z
