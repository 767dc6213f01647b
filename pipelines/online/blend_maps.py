"""Maps that the blending network works on: the source views in the target view, registered by the fused depth or splatted."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np

from ggvs_eval.arrays import Map
from ggvs_eval.camera import Camera
from ggvs_eval.errors import RenderError
from ggvs_eval.geometry.per_pixel import view_weights
from ggvs_eval.geometry.splat import Splat
from ggvs_eval.geometry.warp import register_views
from ggvs_eval.method import SourceView
from ggvs_eval.pipelines.online.blending import BlendingInputs

Guidance = Literal["registered", "channels", "none", "naive"]
FAINT = np.float32(0.02)  # coverage of a fully splatted pixel whose view does not see the fused surface


@dataclass(frozen=True, eq=False)
class BlendMaps:
    """The K views in the target view as they are blended.

    Attributes:
        target: camera of the maps.
        sources: cameras of the views, nearest first.
        colours: I_k, (K, H, W, 3), float32 in [0, 1].
        coverage: how far a view shows anything to blend, the factor of its weight, (K, H, W).
        visibilities: how far it shows what the target sees; where none does the background takes over, (K, H, W).
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
    alphas: tuple[Map, ...]  # apart as they are splatted: side by side they would be one more copy of all views
    depths: tuple[Map, ...]
    fused_depth: Map
    shares: tuple[float, ...] | None = None

    def reduced(self, scale: int) -> "BlendMaps":
        """The maps of a camera with so many times fewer pixels: averages, but of depths one pixel of each block.

        Sizes that `scale` does not divide are continued by their last row and column.
        """
        if scale == 1:
            return self
        stacks = self.colours, self.coverage, self.visibilities, np.stack(self.alphas)
        averaged = [_averaged(maps, scale) for maps in stacks]
        top, left = (min(scale // 2, size - 1) for size in self.fused_depth.shape)
        picked = np.stack([depth[top::scale, left::scale] for depth in (*self.depths, self.fused_depth)])
        return self.with_means(scale, averaged, _continued(picked, *averaged[-1].shape[1:]))

    def with_means(self, scale: int, averaged: Sequence[Map], picked: Map) -> "BlendMaps":
        """`reduced`, the averages of colours, coverage, seen and alphas and the picked depths, fused ones last, being known."""
        height, width = picked.shape[1:]
        target = replace(self.target, width=width * scale, height=height * scale).resized(width, height)
        colours, coverage, visibilities, alphas = averaged
        splatted = tuple(alphas), tuple(picked[:-1])
        return BlendMaps(target, self.sources, colours, coverage, visibilities, *splatted, picked[-1], self.shares)

    @property
    def weights(self) -> Map:
        """Weight of each view beside the others, (K,), see `view_weights`."""
        return view_weights(self.target, self.sources, self.shares)

    def unseen(self) -> Map:
        """Return the share of what the target sees that no view shows, (H, W), in [0, 1]."""
        return np.float32(1) - np.minimum(self.visibilities.sum(axis=0), np.float32(1))


def blend_maps(inputs: BlendingInputs, guidance: Guidance) -> BlendMaps:
    """The maps of one instant, views ordered by the distance of their cameras from the target, ties by name.

    Reading:
        The paper blends the splats. Splats are blurred by the Gaussians' footprint; with ``registered`` guidance each source
        image is sampled at the fused surface instead wherever its view sees that, and splats only stand in elsewhere.
    """
    target, (sources, splats) = inputs.instant.target, in_order(inputs)
    if guidance == "registered":
        stacks = register_views(target, inputs.depth, sources, splats, inputs.tau, float(FAINT))
    else:
        coverage = np.stack([view.alpha for view in splats])
        stacks = np.stack([view.features[..., :3] for view in splats]), coverage, coverage
    return maps_of(inputs, stacks)


def in_order(inputs: BlendingInputs) -> tuple[list[SourceView], list[Splat]]:
    """Source views and their splats, nearest camera first."""
    order = nearest_first(inputs)
    return [inputs.instant.sources[k] for k in order], [inputs.splats[k] for k in order]


def maps_of(inputs: BlendingInputs, stacks: tuple[Map, Map, Map]) -> BlendMaps:
    """The maps of one instant, colours, coverage and visibilities of the views in their order being known."""
    sources, splats = in_order(inputs)
    cameras, shares = tuple(source.camera for source in sources), tuple(source.share for source in sources)
    alphas, depths = tuple(view.alpha for view in splats), tuple(view.depth for view in splats)
    return BlendMaps(inputs.instant.target, cameras, *stacks, alphas, depths, inputs.depth, shares)


def nearest_first(inputs: BlendingInputs) -> list[int]:
    """Numbers of the source views, nearest camera first."""
    cameras, target = [source.camera for source in inputs.instant.sources], inputs.instant.target
    if len(cameras) != len(inputs.splats):
        raise RenderError(f"blending network: wanted one splat per source view, got {len(inputs.splats)} for {len(cameras)}")
    return sorted(range(len(cameras)), key=lambda k: nearness(cameras[k], target))


def nearness(camera: Camera, target: Camera) -> tuple[float, str]:
    """Order of views: the distance of their cameras from the target in world units, ties by name."""
    return float(np.linalg.norm(camera.centre - target.centre)), camera.name


def _averaged(maps: Map, scale: int) -> Map:
    """Mean of each block, of maps (K, H, W) or (K, H, W, 3)."""
    views, height, width, *channels = maps.shape
    means = np.empty((views, -(-height // scale), -(-width // scale), *channels), np.float32)
    for view, mean in zip(maps, means, strict=True):
        for rows in _parts(height, scale):
            for columns in _parts(width, scale):
                part = _whole_blocks(view[rows, columns], scale)
                cells = mean[rows.start // scale :, columns.start // scale :]
                size = part.shape[1] // scale, part.shape[0] // scale
                cells[: size[1], : size[0]] = cv2.resize(part, size, interpolation=cv2.INTER_AREA).reshape(*size[::-1], *channels)
    return means


def _parts(size: int, scale: int) -> list[slice]:
    """The whole blocks of a side and what is left of it: only that needs to be continued, which copies."""
    whole = size // scale * scale
    return [part for part in (slice(0, whole), slice(whole, size)) if part.start < part.stop]


def _whole_blocks(image: Map, scale: int) -> Map:
    """An image continued by its last row and column to whole blocks."""
    below, right = -image.shape[0] % scale, -image.shape[1] % scale
    if not (below or right):
        return image
    return np.asarray(cv2.copyMakeBorder(image, 0, below, 0, right, cv2.BORDER_REPLICATE), np.float32)


def _continued(maps: Map, height: int, width: int) -> Map:
    """Maps (..., H, W) with their last row and column repeated up to a size."""
    missing = [(0, 0)] * (maps.ndim - 2) + [(0, height - maps.shape[-2]), (0, width - maps.shape[-1])]
    return np.pad(maps, missing, mode="edge")
