"""The geometric operations of the method: forward splatting, the image-based TSDF, backward warping."""

from ggvs_eval.geometry.splat import PixelGaussians, Splat, splat
from ggvs_eval.geometry.tsdf import DepthView, PreviousDepth, RayMarch, fusion_weights, ray_march
from ggvs_eval.geometry.warp import Warp, warp

__all__ = [
    "DepthView",
    "PixelGaussians",
    "PreviousDepth",
    "RayMarch",
    "Splat",
    "Warp",
    "fusion_weights",
    "ray_march",
    "splat",
    "warp",
]
