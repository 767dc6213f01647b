"""The geometric operations of the method: forward splatting, the image-based TSDF, backward warping."""

from ggvs_eval.geometry.splat import PixelGaussians, Splat, splat
from ggvs_eval.geometry.tsdf import DepthView, PreviousDepth, RayMarch, fusion_weights, ray_march
from ggvs_eval.geometry.warp import CapturedView, Warp, look_up, warp

__all__ = [
    "CapturedView",
    "DepthView",
    "PixelGaussians",
    "PreviousDepth",
    "RayMarch",
    "Splat",
    "Warp",
    "fusion_weights",
    "look_up",
    "ray_march",
    "splat",
    "warp",
]
