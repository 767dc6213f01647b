"""What the blending network works on: the source views in the target view, registered by the fused depth or as they splat."""

from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np

from ggvs_eval.baselines.distance_based import distance_weights
from ggvs_eval.baselines.method import Map
from ggvs_eval.camera import Camera
from ggvs_eval.errors import RenderError
from ggvs_eval.geometry.warp import Warp, warp
from ggvs_eval.pipelines.online.blending import BlendingInputs

Guidance = Literal["registered", "channels", "none", "naive"]
MAPS_OF_VIEWS = ("splats", "depths", "alphas", "warps", "visibilities")
FAINT = np.float32(0.02)  # coverage of a fully splatted pixel whose view does not see the fused surface


@dataclass(frozen=True, eq=False)
class RawViews:
    """The K views in the target view as splatting and warping give them, nearest camera first.

    Attributes:
        target: camera of the maps.
        sources: cameras of the views.
        splats: splatted colour, (K, H, W, 3), float32 in [0, 1].
        depths: splatted depth, (K, H, W), float32, world units, 0 where the view shows nothing.
        alphas: coverage of the splats, (K, H, W), float32 in [0, 1).
        warps: colour of the source image at the fused surface, (K, H, W, 3).
        visibilities: whether the view sees the fused surface, (K, H, W), in [0, 1].
        fused_depth: of the ray march, (H, W), float32, world units, 0 where it met nothing.
    """

    target: Camera
    sources: tuple[Camera, ...]
    splats: Map
    depths: Map
    alphas: Map
    warps: Map
    visibilities: Map
    fused_depth: Map

    def cropped(self, left: int, top: int, width: int, height: int) -> "RawViews":
        """The window that starts at pixel (left, top)."""
        rows, columns = slice(top, top + height), slice(left, left + width)
        windows = {name: getattr(self, name)[:, rows, columns] for name in MAPS_OF_VIEWS}
        target = self.target.cropped(left, top, width, height)
        return replace(self, target=target, fused_depth=self.fused_depth[rows, columns], **windows)

    def maps(self, guidance: Guidance) -> "BlendMaps":
        """What a network of that guidance works on.

        Reading:
            The paper blends the splats. Splats are blurred by the Gaussians' footprint; with ``registered`` guidance each source
            image is sampled at the fused surface instead wherever its view sees that, and splats only stand in elsewhere.
        """
        registered = guidance == "registered"
        colours = self.splats
        if registered:
            colours = self.splats + self.visibilities[..., None] * (self.warps - self.splats)
        coverage = np.maximum(self.visibilities, FAINT * self.alphas) if registered else self.alphas
        seen = self.visibilities if registered else self.alphas
        return BlendMaps(self.target, self.sources, colours, coverage, seen, self.alphas, self.depths, self.fused_depth)


@dataclass(frozen=True, eq=False)
class BlendMaps:
    """The K views in the target view as they are blended.

    Attributes:
        target: camera of the maps.
        sources: cameras of the views, nearest first.
        colours: I_k, (K, H, W, 3), float32 in [0, 1].
        coverage: how far a view shows anything to blend, the factor of its weight, (K, H, W).
        seen: how far it shows what the target sees; where none does the background takes over, (K, H, W).
        alphas: coverage of the splats, (K, H, W), in [0, 1).
        depths: splatted depth, (K, H, W), world units, 0 where unknown.
        fused_depth: of the ray march, (H, W), world units, 0 where unknown.
    """

    target: Camera
    sources: tuple[Camera, ...]
    colours: Map
    coverage: Map
    seen: Map
    alphas: Map
    depths: Map
    fused_depth: Map

    def reduced(self, scale: int) -> "BlendMaps":
        """The maps of a camera with so many times fewer pixels: averages, but of depths one pixel of each block.

        Sizes that `scale` does not divide are continued by their last row and column.
        """
        if scale == 1:
            return self
        height, width = (-(-size // scale) for size in self.fused_depth.shape)
        target = replace(self.target, width=width * scale, height=height * scale).resized(width, height)
        averaged = (
            np.stack([_averaged(view, scale) for view in maps]) for maps in (self.colours, self.coverage, self.seen, self.alphas)
        )
        picked = (maps[..., scale // 2 :: scale, scale // 2 :: scale] for maps in (self.depths, self.fused_depth))
        continued = (_continued(maps, height, width) for maps in picked)
        return BlendMaps(target, self.sources, *averaged, *continued)

    def near_weights(self) -> Map:
        """LLFF's weight of each view, (K,), 1 for the nearest."""
        return np.array(distance_weights(self.target, self.sources), np.float32)

    def unseen(self) -> Map:
        """How little of what the target sees is shown by near views, (H, W), in [0, 1]."""
        return np.float32(1) - np.minimum(np.einsum("k,khw->hw", self.near_weights(), self.seen), np.float32(1))


def blend_maps(inputs: BlendingInputs, guidance: Guidance) -> BlendMaps:
    """The maps of one instant, views ordered by the distance of their cameras from the target, ties by name."""
    return raw_views(inputs, warped=guidance == "registered").maps(guidance)


def raw_views(inputs: BlendingInputs, warped: bool = True) -> RawViews:
    """The views of one instant in the target view; without warps where they are not wanted."""
    cameras = [source.camera for source in inputs.instant.sources]
    if len(cameras) != len(inputs.splats):
        raise RenderError(f"blending network: wanted one splat per source view, got {len(inputs.splats)} for {len(cameras)}")
    target = inputs.instant.target
    order = sorted(range(len(cameras)), key=lambda k: (float(np.linalg.norm(cameras[k].centre - target.centre)), cameras[k].name))
    splats = [inputs.splats[k] for k in order]
    colours = np.stack([view.features[..., :3] for view in splats])
    alphas = np.stack([view.alpha for view in splats])
    warps, visibilities = colours, np.zeros_like(alphas)
    if warped:
        found = [_warped(inputs, k) for k in order]
        warps = np.stack([each.colour for each in found])
        visibilities = np.stack([each.visibility for each in found])
    depths = np.stack([view.depth for view in splats])
    return RawViews(target, tuple(cameras[k] for k in order), colours, depths, alphas, warps, visibilities, inputs.depth)


def _warped(inputs: BlendingInputs, k: int) -> Warp:
    """What a source image shows at the fused surface."""
    source = inputs.instant.sources[k]
    image = source.image.astype(np.float32) / np.float32(255)
    return warp(inputs.instant.target, inputs.depth, source.camera, image, inputs.filtered_depths[k], inputs.tau, bicubic=True)


def _averaged(image: Map, scale: int) -> Map:
    """Mean of each block, (H, W) or (H, W, 3)."""
    height, width = image.shape[:2]
    below, right = -height % scale, -width % scale
    if below or right:
        image = cv2.copyMakeBorder(image, 0, below, 0, right, cv2.BORDER_REPLICATE)
    size = (image.shape[1] // scale, image.shape[0] // scale)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.float32)


def _continued(maps: Map, height: int, width: int) -> Map:
    """Maps (..., H, W) with their last row and column repeated up to a size."""
    missing = [(0, 0)] * (maps.ndim - 2) + [(0, height - maps.shape[-2]), (0, width - maps.shape[-1])]
    return np.pad(maps, missing, mode="edge")
