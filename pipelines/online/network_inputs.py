"""Input channels of the blending network: colours, depths and angles of every view, in the target
view.

They are made of maps: the source views in the target view, registered by the fused depth or
splatted.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Map
from ggvs_eval.camera import Camera
from ggvs_eval.errors import RenderError
from ggvs_eval.geometry.per_pixel import view_weights
from ggvs_eval.geometry.pinhole import rigid_between
from ggvs_eval.geometry.splat import COVERED_ALPHA, Splat
from ggvs_eval.geometry.warp import register_views
from ggvs_eval.kernels import get_threads
from ggvs_eval.method import SourceView
from ggvs_eval.pipelines.online.blending import BlendingInputs

Guidance = Literal["registered", "channels", "none", "naive"]
# coverage of a fully splatted pixel whose view does not see the fused surface
FAINT = np.float32(0.02)
GUIDED = ("registered", "channels")  # by the fused depth
FUSED_GROUP = 3  # index of the only group that is not of the views


@dataclass(frozen=True, eq=False)
class BlendMaps:
    """The K views in the target view as they are blended.

    Attributes:
        target: camera of the maps.
        sources: cameras of the views, nearest first.
        colours: I_k, (K, H, W, 3), float32 in [0, 1].
        coverage: how far a view shows anything to blend, the factor of its weight, (K, H, W).
        visibilities: how far it shows what the target sees; where none does the background takes
            over, (K, H, W).
        alphas: coverage of the splats, K maps (H, W), in [0, 1).
        depths: splatted depth, K maps (H, W), world units, 0 where unknown.
        fused_depth: of the ray march, (H, W), world units, 0 where unknown.
        shares: of the views, see `SourceView.share`, (K,); 1 unless given.
    """

    target: Camera
    sources: tuple[Camera, ...]
    colours: Map
    coverage: Map
    visibilities: Map
    # apart as they are splatted: side by side they would be one more copy of all views
    alphas: tuple[Map, ...]
    depths: tuple[Map, ...]
    fused_depth: Map
    shares: tuple[float, ...] | None = None

    def reduced(self, scale: int) -> "BlendMaps":
        """Return the maps of a camera with N times fewer pixels: averages, except depths: one pixel
        of each block.

        Sizes that `scale` does not divide are continued by their last row and column.
        """
        if scale == 1:
            return self
        stacks = self.colours, self.coverage, self.visibilities, np.stack(self.alphas)
        averaged = [_averaged(maps, scale) for maps in stacks]
        top, left = (min(scale // 2, size - 1) for size in self.fused_depth.shape)
        picked = np.stack(
            [depth[top::scale, left::scale] for depth in (*self.depths, self.fused_depth)]
        )
        return self.with_means(scale, averaged, _continued(picked, *averaged[-1].shape[1:]))

    def with_means(self, scale: int, averaged: Sequence[Map], picked: Map) -> "BlendMaps":
        """`reduced`, the averages of colours, coverage, seen and alphas and the picked depths,
        fused ones last, being known.
        """
        height, width = picked.shape[1:]
        target = replace(self.target, width=width * scale, height=height * scale).resized(
            width, height
        )
        colours, coverage, visibilities, alphas = averaged
        splatted = tuple(alphas), tuple(picked[:-1])
        return BlendMaps(
            target,
            self.sources,
            colours,
            coverage,
            visibilities,
            *splatted,
            picked[-1],
            self.shares,
        )

    @property
    def weights(self) -> Map:
        """Weight of each view relative to the others, (K,), see `view_weights`."""
        return view_weights(self.target, self.sources, self.shares)

    def unseen(self) -> Map:
        """Return the share of what the target sees that no view shows, (H, W), in [0, 1]."""
        return np.float32(1) - np.minimum(self.visibilities.sum(axis=0), np.float32(1))


def blend_maps(inputs: BlendingInputs, guidance: Guidance) -> BlendMaps:
    """Return the maps of one instant, views ordered by the distance of their cameras from the
    target, ties by name.

    Reading:
        The paper blends the splats. Splats are blurred by the Gaussians' footprint; with
        ``registered`` guidance each source image is sampled at the fused surface instead wherever
        its view sees that, and splats replace it elsewhere.
    """
    target, (sources, splats) = inputs.instant.target, in_order(inputs)
    if guidance == "registered":
        stacks = register_views(
            target, inputs.depth, sources, splats, inputs.tau, float(FAINT), inputs.forgiven_px
        )
    else:
        coverage = np.stack([view.alpha for view in splats])
        stacks = np.stack([view.features[..., :3] for view in splats]), coverage, coverage
    return maps_of(inputs, stacks)


def in_order(inputs: BlendingInputs) -> tuple[list[SourceView], list[Splat]]:
    """Return the source views and their splats, nearest camera first."""
    order = nearest_first(inputs)
    return [inputs.instant.sources[k] for k in order], [inputs.splats[k] for k in order]


def maps_of(inputs: BlendingInputs, stacks: tuple[Map, Map, Map]) -> BlendMaps:
    """Return the maps of one instant, colours, coverage and visibilities of the views in their
    order being known.
    """
    sources, splats = in_order(inputs)
    cameras, shares = (
        tuple(source.camera for source in sources),
        tuple(source.share for source in sources),
    )
    alphas, depths = tuple(view.alpha for view in splats), tuple(view.depth for view in splats)
    return BlendMaps(inputs.instant.target, cameras, *stacks, alphas, depths, inputs.depth, shares)


def nearest_first(inputs: BlendingInputs) -> list[int]:
    """Return the numbers of the source views, nearest camera first."""
    cameras, target = [source.camera for source in inputs.instant.sources], inputs.instant.target
    if len(cameras) != len(inputs.splats):
        raise RenderError(
            f"blending network: wanted one splat per source view, got {len(inputs.splats)} for "
            f"{len(cameras)}"
        )
    return sorted(range(len(cameras)), key=lambda k: nearness(cameras[k], target))


def nearness(camera: Camera, target: Camera) -> tuple[float, str]:
    """Order of views: the distance of their cameras from the target in world units, ties by
    name.
    """
    return float(np.linalg.norm(camera.centre - target.centre)), camera.name


def _averaged(maps: Map, scale: int) -> Map:
    """Return the mean of each block, of maps (K, H, W) or (K, H, W, 3)."""
    views, height, width, *channels = maps.shape
    means = np.empty((views, -(-height // scale), -(-width // scale), *channels), np.float32)
    for view, mean in zip(maps, means, strict=True):
        for rows in _parts(height, scale):
            for columns in _parts(width, scale):
                part = _whole_blocks(view[rows, columns], scale)
                cells = mean[rows.start // scale :, columns.start // scale :]
                size = part.shape[1] // scale, part.shape[0] // scale
                cells[: size[1], : size[0]] = cv2.resize(
                    part, size, interpolation=cv2.INTER_AREA
                ).reshape(*size[::-1], *channels)
    return means


def _parts(size: int, scale: int) -> list[slice]:
    """Return the whole blocks of a side and what is left of it: only that needs to be continued,
    which copies.
    """
    end = size // scale * scale
    return [part for part in (slice(0, end), slice(end, size)) if part.start < part.stop]


def _whole_blocks(image: Map, scale: int) -> Map:
    """Return an image continued by its last row and column to whole blocks."""
    below, right = -image.shape[0] % scale, -image.shape[1] % scale
    if not (below or right):
        return image
    return np.asarray(
        cv2.copyMakeBorder(image, 0, below, 0, right, cv2.BORDER_REPLICATE), np.float32
    )


def _continued(maps: Map, height: int, width: int) -> Map:
    """Return the maps (..., H, W) with their last row and column repeated up to a size."""
    missing = [(0, 0)] * (maps.ndim - 2) + [
        (0, height - maps.shape[-2]),
        (0, width - maps.shape[-1]),
    ]
    return np.pad(maps, missing, mode="edge")


def channel_count(views: int, guidance: Guidance) -> int:
    """Return the number of channels of `input_channels`: as printed 9 K + 1."""
    return {
        "registered": 10 * views + 1,
        "channels": 9 * views + 1,
        "none": 8 * views,
        "naive": 6 * views,
    }[guidance]


def present_channels(count: int, views: int, guidance: Guidance) -> NDArray[np.intp]:
    """Return the indices of the channels that `count` views fill, of a network made for `views`.

    The other channels are 0.
    """
    guided = guidance in GUIDED
    # colours, then one of each other group
    of_a_view = [3] + [1] * (channel_count(1, guidance) - guided - 3)
    numbers, first = [], 0
    for group, channels in enumerate(of_a_view):
        if guided and group == FUSED_GROUP:
            numbers.append(np.array([first]))
            first += 1
        numbers.append(first + np.arange(channels * count))
        first += channels * views
    return np.concatenate(numbers)


def guide_depth(maps: BlendMaps, guidance: Guidance) -> Map:
    """Return the depth of the surface that angles are measured at, (H, W), world units, 0 where
    unknown.

    Reading:
        The paper's ablation takes the fused depth away; angles are then measured at the splatted
        depth of the nearest view that covers the pixel.
    """
    if guidance in GUIDED:
        return maps.fused_depth
    covers = np.stack(maps.alphas) >= COVERED_ALPHA  # (K, H, W)
    first = np.argmax(covers, axis=0)[None]
    return np.where(
        covers.any(axis=0),
        np.take_along_axis(np.stack(maps.depths), first, axis=0)[0],
        np.float32(0),
    )


def reference_depth(depth: Map, camera: Camera) -> float:
    """Return the length that depths and distances are measured in: the median of what is known, or
    the far plane.
    """
    depths = depth[depth > 0]
    return float(np.median(depths)) if depths.size else camera.far


def input_channels(
    maps: BlendMaps, guidance: Guidance, views: int | None = None, unit: float | None = None
) -> Map:
    """Return the channels of the network's input.

    Args:
        maps: the views, K of them.
        guidance: what the network sees of the fused depth. ``channels``: groups 1-8, as printed.
            ``registered``: group 9 too. ``none``: all except groups 4 and 5 (ablation 'No TSDF
            Guidance'). ``naive``: groups 1, 3, 7 and 8, which need no depth.
        views: how many views the network is made for; channels of those that are not there are 0. K
            unless given.
        unit: what depths and distances are measured in, world units; `reference_depth` of the
            guide's depth unless given. A crop wants that of the whole view.

    Returns:
        (`channel_count`, H, W), float32, in this order: 1. colours, 3 K; 2. splatted inverse
        depths, K; 3. coverages of the splats, K; 4. inverse fused depth, 1; 5. cosine between the
        surface's normal and the direction to each camera, K; 6. cosine between the directions to
        the target camera and to each camera, K; 7. distance of each camera from the target camera,
        K; 8. cosine between their axes, K; 9. whether the view sees the fused surface, K.

    Reading:
        The paper names the first eight groups. Depth enters as unit / depth, distance as distance /
        unit, so that nothing depends on the scale of the world. Directions go from the surface to
        the cameras; where the surface is unknown, cosines to its normal are 0 and the point is on
        the far plane. Zeros for absent views let one network serve every K up to its own.
    """
    guide = guide_depth(maps, guidance)
    unit = unit or reference_depth(guide, maps.target)
    surface, size = guide > 0, guide.shape
    # a power of two, which rounds nothing: lengths are of order 1
    per = np.exp2(-np.floor(np.log2(np.float32(unit))))
    points = per * surface_points(
        maps.target, np.where(surface, guide, np.float32(maps.target.far))
    )
    to_sources = [_unit(per * _centre(source, maps.target) - points) for source in maps.sources]
    guided, count, flat = guidance in GUIDED, len(maps.sources), guidance == "naive"
    of_views = [
        np.moveaxis(maps.colours, 3, 1).reshape(-1, *size),
        None if flat else _inverse(np.stack(maps.depths), unit),
        np.stack(maps.alphas),
        _cosines(to_sources, surface_normals(points, surface)) if guided else None,
        None if flat else _cosines(to_sources, _unit(-points)),
        _constant([_distance(source, maps.target) / unit for source in maps.sources], size),
        _constant([float(source.axis @ maps.target.axis) for source in maps.sources], size),
        maps.visibilities if guidance == "registered" else None,
    ]
    groups = [_widened(group, count, views or count) for group in of_views if group is not None]
    if guided:
        groups.insert(FUSED_GROUP, _inverse(guide, unit)[None])
    return np.concatenate(groups, dtype=np.float32)


def _widened(group: Map, count: int, views: int) -> Map:
    """Return a group of `count` views with zeros for those that are not there, up to `views`."""
    absent = (views - count) * (len(group) // count)
    return (
        np.concatenate([group, np.zeros((absent, *group.shape[1:]), np.float32)])
        if absent
        else group
    )


def surface_points(camera: Camera, depth: Map) -> Map:
    """Return the points of a depth map in its camera's frame, (3, H, W), float32."""
    across, down = ray_slopes(camera)
    return np.stack([depth * across, depth * down[:, None], depth])


def ray_slopes(camera: Camera) -> tuple[Map, Map]:
    """Return the slopes x / z of the rays through each column, (W,), and y / z of those through
    each row, (H,), float32.
    """
    across = (np.arange(camera.width) + 0.5 - camera.K[0, 2]) / camera.K[0, 0]
    down = (np.arange(camera.height) + 0.5 - camera.K[1, 2]) / camera.K[1, 1]
    return across.astype(np.float32), down.astype(np.float32)


def surface_normals(points: Map, has_depth: NDArray[np.bool_]) -> Map:
    """Return the unit normals of a depth map, towards the camera, from central differences
    (one-sided at the border).

    Args:
        points: in the camera's frame, (3, H, W).
        has_depth: if there is a surface, (H, W).

    Returns:
        (3, H, W), float32, 0 if the pixel or one of its four neighbours is unknown.
    """
    padded = np.pad(points, ((0, 0), (1, 1), (1, 1)), mode="edge")
    along_row = padded[:, 1:-1, 2:] - padded[:, 1:-1, :-2]
    along_column = padded[:, 2:, 1:-1] - padded[:, :-2, 1:-1]
    normals = _unit(np.cross(along_column, along_row, axis=0))
    around = np.pad(has_depth, 1, mode="edge")
    is_smooth = (
        has_depth & around[1:-1, 2:] & around[1:-1, :-2] & around[2:, 1:-1] & around[:-2, 1:-1]
    )
    facing = -np.sign(_dot(normals, points))
    return normals * (facing * is_smooth)


def _distance(first: Camera, second: Camera) -> float:
    return float(np.linalg.norm(first.centre - second.centre))


def _centre(camera: Camera, target: Camera) -> Map:
    """Return a camera's centre in the target camera's frame, (3, 1, 1)."""
    return rigid_between(camera, target)[:3, 3, None, None].astype(np.float32)


def _constant(values: Sequence[float], size: tuple[int, ...]) -> Map:
    """Return one constant map per value, (K, H, W)."""
    return np.broadcast_to(np.array(values, np.float32)[:, None, None], (len(values), *size))


def _cosines(directions: Sequence[Map], target: Map) -> Map:
    """Between each of K fields of unit vectors and another one, (K, H, W)."""
    return np.stack([_dot(direction, target) for direction in directions])


def _inverse(depth: Map, unit: float) -> Map:
    return np.divide(np.float32(unit), depth, out=np.zeros_like(depth), where=depth > 0)


def _dot(first: Map, second: Map) -> Map:
    return np.einsum("chw,chw->hw", first, second)


def _unit(vectors: Map) -> Map:
    length = np.maximum(np.sqrt(_dot(vectors, vectors)), np.float32(1e-12))
    return np.divide(vectors, length, dtype=np.float32)


def network_channels(maps: BlendMaps, guidance: Guidance, views: int) -> Map:
    """Return the channels of the network's input, (channels, H, W).

    By the kernel where the fused depth guides.

    Args:
        maps: the views, K of them, of the network's own size.
        guidance: as in `input_channels`.
        views: how many views the network is made for.
    """
    if guidance not in GUIDED:
        return input_channels(maps, guidance, views)
    from ggvs_eval.kernels import _core

    target, unit = maps.target, reference_depth(maps.fused_depth, maps.target)
    stacks = (maps.colours, maps.depths, maps.alphas)
    colours, depths, alphas = (np.ascontiguousarray(stack, np.float32) for stack in stacks)
    visibilities = (
        np.ascontiguousarray(maps.visibilities, np.float32) if guidance == "registered" else None
    )
    fused = np.ascontiguousarray(maps.fused_depth, np.float32)
    centres = np.stack([rigid_between(source, target)[:3, 3] for source in maps.sources])
    distances = [
        float(np.linalg.norm(source.centre - target.centre)) / unit for source in maps.sources
    ]
    axes = [float(source.axis @ target.axis) for source in maps.sources]
    cameras = (
        centres.astype(np.float32),
        np.array(distances, np.float32),
        np.array(axes, np.float32),
    )
    settings = (target.far, unit, views, get_threads())
    return _core.network_inputs(
        colours, depths, alphas, visibilities, fused, ray_slopes(target), cameras, *settings
    )
