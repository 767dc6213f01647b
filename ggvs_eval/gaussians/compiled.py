"""The splat by the compiled kernel, forward and backward, as a function that autograd knows."""

from typing import Any

import numpy as np
import torch

from ggvs_eval.camera import Camera
from ggvs_eval.gaussians.cloud import GaussianCloud
from ggvs_eval.gaussians.projection import SLOPE_MARGIN
from ggvs_eval.geometry.pinhole import pinhole
from ggvs_eval.kernels import SIMD_LEVELS, get_simd_level, get_threads

Pictures = tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]


def splat(cloud: GaussianCloud, camera: Camera, near: float, screen_offsets: torch.Tensor | None) -> Pictures:
    """Render without a background, as `torch_splat.splat` does, for float32 on the CPU.

    Gradients and pictures have the same bits for any number of threads and any instruction set.
    """
    offsets = None if screen_offsets is None else screen_offsets.to(torch.float32)
    return _Splat.apply(camera, near, *cloud.parameters().values(), offsets)


class _Splat(torch.autograd.Function):
    """Kernel calls; the first two arguments are no tensors."""

    @staticmethod
    def forward(ctx: Any, camera: Camera, near: float, *tensors: torch.Tensor | None) -> Pictures:
        """Sums of colour, transmittance, sums of depth, and radii."""
        from ggvs_eval.kernels import _gaussians

        colour, transmittance, depth, radii, frame = _gaussians.render(
            _arrays(tensors), pinhole(camera), camera.world_to_camera, camera.centre, near, SLOPE_MARGIN, *_settings()
        )
        ctx.save_for_backward(*tensors)
        ctx.frame = frame
        radii_px = torch.from_numpy(radii)
        ctx.mark_non_differentiable(radii_px)
        return torch.from_numpy(colour), torch.from_numpy(transmittance), torch.from_numpy(depth), radii_px

    @staticmethod
    def backward(ctx: Any, *by_pictures: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        """Derivatives by the tensors that want one."""
        from ggvs_eval.kernels import _gaussians

        tensors = ctx.saved_tensors
        by_colour, by_transmittance, by_depth = (gradient.contiguous().numpy() for gradient in by_pictures[:3])
        gradients = _gaussians.gradients(ctx.frame, _arrays(tensors), by_colour, by_transmittance, by_depth, *_settings())
        needed = ctx.needs_input_grad[2:]
        return None, None, *(torch.from_numpy(each) if asked else None for each, asked in zip(gradients, needed, strict=True))


def _arrays(tensors: tuple[torch.Tensor | None, ...]) -> tuple[np.ndarray | None, ...]:
    return tuple(None if tensor is None else tensor.detach().contiguous().numpy() for tensor in tensors)


def _settings() -> tuple[int, int]:
    return get_threads(), SIMD_LEVELS.index(get_simd_level())
