"""Metrics of images: fidelity of frames, stability over time and over views.

>>> from ggvs_eval.metrics import psnr, ssim, strred
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ggvs_eval.built_in import METRIC_FUNCTIONS
from ggvs_eval.plugins import Registry

if TYPE_CHECKING:
    from ggvs_eval.metrics.image.corrected import psnr_colour_corrected
    from ggvs_eval.metrics.image.dssim import dssim
    from ggvs_eval.metrics.image.l1 import l1, masked_l1
    from ggvs_eval.metrics.image.lpips import lpips
    from ggvs_eval.metrics.image.ms_ssim import ms_ssim
    from ggvs_eval.metrics.image.psnr import masked_psnr, psnr
    from ggvs_eval.metrics.image.sharpness import sharpness
    from ggvs_eval.metrics.image.ssim import masked_ssim, ssim, ssim_variant
    from ggvs_eval.metrics.metric import MetricOptions
    from ggvs_eval.metrics.path.rendered_path import PathPose
    from ggvs_eval.metrics.path.view_consistency import warping_error
    from ggvs_eval.metrics.path_scores import score_path
    from ggvs_eval.metrics.registry import METRICS
    from ggvs_eval.metrics.series_scores import score_depths, score_frames
    from ggvs_eval.metrics.stream import score_view
    from ggvs_eval.metrics.time.depth_variation import depth_mtv, depth_mtv2, depth_sharpness
    from ggvs_eval.metrics.time.deviations import sdt, sdv
    from ggvs_eval.metrics.time.flicker import flicker
    from ggvs_eval.metrics.time.strred import strred
    from ggvs_eval.metrics.time.tcc import tcc
    from ggvs_eval.metrics.time.temporal_variation import mtv, mtv2

__all__ = [
    "METRICS",
    "MetricOptions",
    "PathPose",
    "colmap_consistency",
    "depth_mtv",
    "depth_mtv2",
    "depth_sharpness",
    "dists",
    "dssim",
    "flicker",
    "flip",
    "iv_psnr",
    "l1",
    "lpips",
    "masked_l1",
    "masked_psnr",
    "masked_ssim",
    "ms_ssim",
    "mtv",
    "mtv2",
    "psnr",
    "psnr_colour_corrected",
    "psnr_ycbcr",
    "score_depths",
    "score_frames",
    "score_path",
    "score_view",
    "sdt",
    "sdv",
    "sharpness",
    "spatial_consistency",
    "ssim",
    "ssim_variant",
    "strred",
    "tcc",
    "warping_error",
]

# What is imported when a name is first used, so that the import of this package costs nothing.
_MODULES = {
    "image.corrected": ("psnr_colour_corrected",),
    "image.dssim": ("dssim",),
    "image.l1": ("l1", "masked_l1"),
    "image.lpips": ("lpips",),
    "image.ms_ssim": ("ms_ssim",),
    "image.psnr": ("masked_psnr", "psnr"),
    "image.sharpness": ("sharpness",),
    "image.ssim": ("masked_ssim", "ssim", "ssim_variant"),
    "metric": ("MetricOptions",),
    "path.rendered_path": ("PathPose",),
    "path.view_consistency": ("warping_error",),
    "path_scores": ("score_path",),
    "registry": ("METRICS",),
    "series_scores": ("score_depths", "score_frames"),
    "stream": ("score_view",),
    "time.depth_variation": ("depth_mtv", "depth_mtv2", "depth_sharpness"),
    "time.deviations": ("sdt", "sdv"),
    "time.flicker": ("flicker",),
    "time.strred": ("strred",),
    "time.tcc": ("tcc",),
    "time.temporal_variation": ("mtv", "mtv2"),
}
_FUNCTIONS: Registry[Any] = Registry("functions of metrics", METRIC_FUNCTIONS)
_MODULE_OF = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Import a name on first use (PEP 562)."""
    if name in METRIC_FUNCTIONS:
        return _FUNCTIONS[name]
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULE_OF[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
