"""3D Gaussians: clouds, a differentiable splat, and their file formats."""

from ggvs_eval.gaussians.cloud import GaussianCloud
from ggvs_eval.gaussians.ply import read_ply, write_ply
from ggvs_eval.gaussians.render import GaussianImage, render_gaussians

__all__ = ["GaussianCloud", "GaussianImage", "read_ply", "render_gaussians", "write_ply"]
