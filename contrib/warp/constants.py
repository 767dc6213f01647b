"""Inputs of a step besides pictures - cameras, weights, flags - as one block of memory that one
copy uploads.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import torch
import warp as wp
from numpy.typing import NDArray
from torch import Tensor

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera
from ggvs_eval.contrib.warp.tables import Sizes
from ggvs_eval.geometry.per_pixel import view_weights
from ggvs_eval.geometry.warp import forgiven
from ggvs_eval.kernels.portable import length, product
from ggvs_eval.method import Instant, SourceView
from ggvs_eval.pipelines.online import exposure_compensation as compensation
from ggvs_eval.pipelines.online.geometry_guided import SAME_SURFACE_TAU, OnlineOptions

# Places of the single numbers, and of the flags of valid memories.
NEAR, END, TAU, PER_BIT, FAR, SAME_SURFACE, NOISE = (wp.constant(place) for place in range(7))
PAST, SHOWN, GAINS = (wp.constant(place) for place in range(3))
SLABS = 512  # depth intervals of the march's grid, about equal in log depth
ALIGNMENT = 16  # bytes
NO_VIEW = -1


@dataclass(frozen=True, eq=False)
class Remembered:
    """State of the previous instant, as known to the host.

    Attributes:
        index: of that instant.
        target: its camera.
        cameras: its sources, in the order of the state's stacks.
    """

    index: int
    target: Camera
    cameras: tuple[Camera, ...]


class StepConstants:
    """The numbers of a step on the host and on the device, by name.

    The device's tensors stay where they are.

    Kernels that are recorded read them there, so that one recording serves every camera of the same
    size.

    Attributes:
        pinholes: fx, fy, cx, cy of the sources and of the target, (K + 1, 4), float64.
        small_target: the same of the target at the network's size, (4,), float64.
        gauge: weights by which gains are averaged into the target's, (K,), float64.
        signs: of each pair of sources, -1 if its names are not in order, (P,), float64.
        lens: largest squared tangent in any picture, and instants that a ratio is the mean of,
            (2,), float64.
        numbers: `NEAR` and its neighbours, (7,), float32.
        to_views, from_views: matrices by `pixel_maps` from the target to each source and back, (K +
            1, 12), float32; the last is that of the target of the instant before.
        projectors: by which Gaussians become ellipses, (K, 22), float32, see `kernels/splat.hpp`.
        transforms: between the sources of each pair, there and back, (2 P, 12), float32.
        to_pixels, to_cells: from the target's cells to the sources' pixels and to the cells of
            their masks, (K, 12), float32.
        weights, distances, axes: geometric weight of each source, its distance from the target and
            the cosine between their axes, (K,), float32.
        forgiven: of each source, see `ggvs_eval.geometry.warp.forgiven`, (K, 2), float32.
        centres: of the sources in the target's frame, (K, 3), float32.
        flags: `PAST`, `SHOWN` and `GAINS`: 1 if that memory counts, (3,), int32.
        previous: place of each source in the state's stacks, -1 if it was not there, (K,), int32.
        rows: of each pair in the table of ratios, (P,), int32.
    """

    def __init__(self, sizes: Sizes, device: torch.device) -> None:
        views, pairs = len(sizes.views), sizes.pairs
        layout: dict[str, tuple[Any, tuple[int, ...]]] = {
            "pinholes": (np.float64, (views + 1, 4)),
            "small_target": (np.float64, (4,)),
            "gauge": (np.float64, (views,)),
            "signs": (np.float64, (pairs,)),
            "lens": (np.float64, (2,)),
            "numbers": (np.float32, (7,)),
            "to_views": (np.float32, (views + 1, 12)),
            "from_views": (np.float32, (views + 1, 12)),
            "projectors": (np.float32, (views, 22)),
            "transforms": (np.float32, (2 * pairs, 12)),
            "to_pixels": (np.float32, (views, 12)),
            "to_cells": (np.float32, (views, 12)),
            "weights": (np.float32, (views,)),
            "distances": (np.float32, (views,)),
            "axes": (np.float32, (views,)),
            "forgiven": (np.float32, (views, 2)),
            "centres": (np.float32, (views, 3)),
            "flags": (np.int32, (3,)),
            "previous": (np.int32, (views,)),
            "rows": (np.int32, (pairs,)),
        }
        lengths = [int(np.prod(shape)) * np.dtype(kind).itemsize for kind, shape in layout.values()]
        ends = np.cumsum([-(-length // ALIGNMENT) * ALIGNMENT for length in lengths])
        on_gpu = device.type == "cuda"
        self._host = torch.zeros(int(ends[-1]), dtype=torch.uint8, device="cpu", pin_memory=on_gpu)
        self._device = torch.zeros_like(self._host, device=device) if on_gpu else self._host
        self._values: dict[str, NDArray[Any]] = {}
        self._tensors: dict[str, Tensor] = {}
        kinds = {np.float64: torch.float64, np.float32: torch.float32, np.int32: torch.int32}
        for (name, (kind, shape)), size, end in zip(layout.items(), lengths, ends, strict=True):
            begin = int(end) - -(-size // ALIGNMENT) * ALIGNMENT
            self._values[name] = self._host[begin : begin + size].numpy().view(kind).reshape(shape)
            self._tensors[name] = self._device[begin : begin + size].view(kinds[kind]).view(shape)
        self._sizes = sizes
        self._filled: tuple[Any, ...] = ()

    def __getattr__(self, name: str) -> Tensor:
        """Return a group of numbers on the device."""
        try:
            return self.__dict__["_tensors"][name]
        except KeyError:
            raise AttributeError(name) from None

    def upload(self) -> None:
        """Copy all numbers to the device; the host does not wait."""
        if self._device is not self._host:
            self._device.copy_(self._host, non_blocking=True)

    def fill(
        self,
        instant: Instant,
        sources: Sequence[SourceView],
        options: OnlineOptions,
        end: float,
        before: Remembered | None,
        rows: Sequence[int],
    ) -> None:
        """Set the numbers of an instant on the host.

        Args:
            sources: its views, nearest first.
            end: depth where rays end, see `march_end`.
            before: of the state that is read; None if nothing is remembered.
            rows: of each pair of sources in the table of ratios.
        """
        target, cameras = instant.target, tuple(source.camera for source in sources)
        values = self._values
        follows = before is not None and before.index == instant.index - 1
        if not (follows and options.temporal):
            before = None
        moved = before is None or not before.target.shows_the_same_rays(target)
        values["flags"][:] = before is not None, not moved, follows
        values["previous"][:] = [_place(camera, before) for camera in cameras]
        values["rows"][:] = rows
        past = target if before is None else before.target
        values_used = (
            target,
            past,
            *cameras,
            *(source.share for source in sources),
            instant.units_per_metre,
            end,
        )
        is_same = len(values_used) == len(self._filled) and all(
            new is old or new == old for new, old in zip(values_used, self._filled, strict=True)
        )
        if not is_same:
            self._fill_geometry(instant, sources, options, end, past)
            self._filled = values_used

    def _fill_geometry(
        self,
        instant: Instant,
        sources: Sequence[SourceView],
        options: OnlineOptions,
        end: float,
        past: Camera,
    ) -> None:
        target, cameras, values = (
            instant.target,
            [source.camera for source in sources],
            self._values,
        )
        tau = options.tau_m * instant.units_per_metre
        first, last = (int(np.float32(depth).view(np.int32)) for depth in (target.near, end))
        noise = 7 * options.depth_noise_m * instant.units_per_metre
        values["numbers"][:] = (
            target.near,
            end,
            tau,
            SLABS / (last - first),
            target.far,
            SAME_SURFACE_TAU * tau,
            noise,
        )
        pinhole, pinholes = (
            _pinhole(target),
            np.stack([_pinhole(camera) for camera in (*cameras, past)]),
        )
        values["pinholes"][:-1], values["pinholes"][-1] = pinholes[:-1], pinhole
        # of a size that the scale divides, by repetition
        values["small_target"][:] = pinhole / self._sizes.scale
        forward, back = (
            _rigid([target] * len(pinholes), [*cameras, past]),
            _rigid([*cameras, past], [target] * len(pinholes)),
        )
        values["to_views"][:] = pixel_maps(forward, pinhole, pinholes)
        values["from_views"][:] = pixel_maps(back, pinholes, pinhole)
        values["projectors"][:] = _projectors(
            back[:-1], pinholes[:-1], target, instant.near_plane, options.gaussian_scale_px
        )
        middles = _middle_rays(target, pinhole, self._sizes)
        values["to_pixels"][:] = pixel_maps(forward[:-1], middles, pinholes[:-1])
        cells = [
            _resized(pinhole, size, cell)
            for pinhole, size, cell in zip(
                pinholes[:-1], self._sizes.views, self._sizes.mask_cells, strict=True
            )
        ]
        values["to_cells"][:] = pixel_maps(forward[:-1], middles, np.stack(cells))
        pairs = list(combinations(range(len(cameras)), 2))
        if pairs:
            ordered = [order for j, k in pairs for order in ((j, k), (k, j))]
            between = _rigid([cameras[j] for j, _ in ordered], [cameras[k] for _, k in ordered])
            values["transforms"][:] = between[:, :3].reshape(len(ordered), 12)
            values["signs"][:] = [
                -1.0 if cameras[j].name > cameras[k].name else 1.0 for j, k in pairs
            ]
        weights = view_weights(target, cameras, [source.share for source in sources])
        gauge = weights.astype(np.float64) ** compensation.GAUGE_POWER
        values["weights"][:], values["gauge"][:] = weights, gauge / gauge.sum()
        values["lens"][:] = (
            _corner([target, *cameras]),
            compensation.MEMORY if options.temporal else 1,
        )
        values["centres"][:] = back[:-1, :3, 3]
        values["distances"][:] = [
            float(length(camera.centre - target.centre)) for camera in cameras
        ]
        values["forgiven"][:] = [
            forgiven(target, camera, options.forgiven_px) for camera in cameras
        ]
        values["axes"][:] = [float(camera.axis @ target.axis) for camera in cameras]


def _place(camera: Camera, before: Remembered | None) -> int:
    """Return the place of a camera in the stacks of the instant before, -1 if it was not there at
    this size.
    """
    named = (
        [view.name == camera.name and view.size == camera.size for view in before.cameras]
        if before
        else []
    )
    return named.index(True) if True in named else NO_VIEW


def _pinhole(camera: Camera) -> Array:
    """fx, fy, cx, cy."""
    return camera.K[[0, 1, 0, 1], [0, 1, 2, 2]]


def _resized(pinhole: Array, size: tuple[int, int], new_size: tuple[int, int]) -> Array:
    """fx, fy, cx, cy of the image of a size (width, height) resampled to another."""
    return pinhole * np.tile([new_size[0] / size[0], new_size[1] / size[1]], 2)


def _middle_rays(target: Camera, pinhole: Array, sizes: Sizes) -> Array:
    """`temporal_filters.middle_rays` of the target, as fx, fy, cx, cy."""
    width, height = sizes.cells
    return _resized(pinhole, target.size, sizes.cells) - [
        0,
        0,
        0.5 * width / target.width,
        0.5 * height / target.height,
    ]


def _rigid(firsts: Sequence[Camera], seconds: Sequence[Camera]) -> Array:
    """`rigid_between` of many pairs, (N, 4, 4)."""
    first, second = (
        np.stack([camera.world_to_camera for camera in cameras]) for cameras in (firsts, seconds)
    )
    transforms = np.tile(np.eye(4), (len(first), 1, 1))
    transforms[:, :3, :3] = product(second[:, :3, :3], first[:, :3, :3].transpose(0, 2, 1))
    transforms[:, :3, 3] = (
        second[:, :3, 3] - product(transforms[:, :3, :3], first[:, :3, 3:])[..., 0]
    )
    return transforms


def pixel_maps(rigid: Array, first: Array, second: Array | None) -> NDArray[np.float32]:
    """Matrices and offsets, (N, 12), that take (depth u, depth v, depth) of one camera to another,
    see `kernels/camera.hpp`.

    Args:
        rigid: from the first camera's frame to the second's, (N, 4, 4).
        first: fx, fy, cx, cy of those whose pixels and depths are given, (4,) or (N, 4).
        second: of those in whose images (u z, v z, z) is wanted; None for points in their frames.
    """
    turned = rigid[:, :3].copy()  # (N, 3, 4)
    if second is not None:
        fx, fy, cx, cy = np.broadcast_to(second, (len(rigid), 4)).T[..., None]
        turned[:, 0], turned[:, 1] = (
            fx * turned[:, 0] + cx * turned[:, 2],
            fy * turned[:, 1] + cy * turned[:, 2],
        )
    fx, fy, cx, cy = np.broadcast_to(first, (len(rigid), 4)).T[..., None]
    last = turned[:, :, 2] - turned[:, :, 0] * cx / fx - turned[:, :, 1] * cy / fy
    matrix = np.stack([turned[:, :, 0] / fx, turned[:, :, 1] / fy, last], axis=2)
    return np.concatenate([matrix.reshape(-1, 9), turned[:, :, 3]], axis=1).astype(np.float32)


def _projectors(back: Array, pinholes: Array, target: Camera, near: float, scale: float) -> Array:
    """Parameters by which the sources' Gaussians become ellipses in the target image, (K, 22).

    See `kernels/splat.hpp`.
    """
    fx, fy, cx, cy = _pinhole(target)
    slopes = 1.3 * target.width / (2.0 * fx), 1.3 * target.height / (2.0 * fy)
    common = np.array(
        [fx, fy, cx - 0.5, cy - 0.5, *slopes, near, target.width - 1, target.height - 1]
    )
    sigmas = scale / (0.5 * (pinholes[:, 0] + pinholes[:, 1]))
    scales = np.concatenate([sigmas[:, None], np.tile(common, (len(back), 1))], axis=1)
    return np.concatenate([pixel_maps(back, pinholes, None), scales], axis=1)


def _corner(cameras: Sequence[Camera]) -> float:
    """`exposure_compensation.corner_of`, which is in a corner."""
    ends = [
        max(((at + 0.5 - camera.K[axis, 2]) / camera.K[axis, axis]) ** 2 for at in (0, size - 1))
        for camera in cameras
        for axis, size in enumerate(camera.size)
    ]
    return max(across + down for across, down in zip(ends[::2], ends[1::2], strict=True))
