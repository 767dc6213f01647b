"""The geometric operations of the method: forward splatting, the image-based TSDF, backward warping."""

from ggvs_eval.geometry.splat import Splat, splat
from ggvs_eval.geometry.tsdf import PreviousDepth, RayMarch, fusion_weights, ray_march
from ggvs_eval.geometry.warp import Warp, look_up, warp

__all__ = [
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
