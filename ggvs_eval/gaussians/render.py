"""The differentiable splat: an image, its coverage and its depth from a cloud of Gaussians.

On a CPU by the compiled kernel, forward and backward, as a function that autograd knows.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from ggvs_eval.camera import Camera
from ggvs_eval.errors import RenderError
from ggvs_eval.gaussians.cloud import AntialiasedCloud, GaussianCloud
from ggvs_eval.gaussians.torch_splat import SLOPE_MARGIN
from ggvs_eval.geometry.pinhole import pinhole
from ggvs_eval.kernels import SIMD_LEVELS, get_simd_level, get_threads
from ggvs_eval.method import NEAR_M

Pictures = tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]


@dataclass(frozen=True, eq=False)
class GaussianImage:
    """A rendered cloud.

    Attributes:
        image: colour over the background, (H, W, 3), not below 0; above 1 where Gaussians are
            brighter than white.
        alpha: coverage, (H, W), in [0, 1).
        depth: mean z of what covers the pixel, weighted by how much it covers, (H, W), world units;
            0 if nothing does.
        radii: 3 standard deviations in the image along the longer axis, rounded up, (N,) int32
            pixels; 0 if a Gaussian is not visible.
    """

    image: torch.Tensor
    alpha: torch.Tensor
    depth: torch.Tensor
    radii: torch.Tensor


def render_gaussians(
    cloud: GaussianCloud,
    camera: Camera,
    background: Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
    screen_offsets: torch.Tensor | None = None,
    *,
    near: float = NEAR_M,
) -> GaussianImage:
    """Render a cloud of Gaussians, differentiable in all its tensors (Kerbl et al. 2023, with a
    projection by K).

    Args:
        cloud: N Gaussians, world units; antialiased ones are drawn so.
        background: colour behind everything, three numbers in [0, 1].
        screen_offsets: (N, 2), pixels, added to the centres in the image: zeros that want a
            gradient get that of the centres, which density control looks at.
        near: Gaussians at or before this depth in the camera are left out, world units.

    Raises:
        RenderError: offsets that do not fit the cloud, a background that is no colour, or a near
            that is not positive.

    Examples:
        >>> import numpy as np
        >>> K = np.array([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]])
        >>> camera = Camera("cam00", K, np.eye(4), width=8, height=6, near=1.0, far=9.0)
        >>> red = torch.tensor([[1.0, 0.0, 0.0]])
        >>> cloud = GaussianCloud.of_points(
        ...     torch.tensor([[0.0, 0.0, 2.0]]), red, scale=1.0, opacity=0.8
        ... )
        >>> picture = render_gaussians(cloud, camera)
        >>> (
        ...     picture.image.shape,
        ...     round(float(picture.image[3, 4, 0]), 3),
        ...     round(float(picture.depth[3, 4]), 3),
        ... )
        (torch.Size([6, 8, 3]), 0.788, 2.0)

    Reading:
        Forward pass of 3D Gaussian splatting: 0.3 px^2 are added to both variances, alpha is at
        most 0.99 and at least 1/255, a pixel stops before its transmittance falls below 1e-4, z up
        to 0.2 is left out. Different from it are the principal point, which fields of view lose,
        and the end of a Gaussian, which is not cut at the borders of tiles (`torch_splat.splat`).
    """
    from ggvs_eval.gaussians import torch_splat

    if screen_offsets is not None and screen_offsets.shape != (len(cloud), 2):
        raise RenderError(
            f"Gaussian splat: wanted screen offsets {(len(cloud), 2)}, got "
            f"{tuple(screen_offsets.shape)}"
        )
    behind = torch.as_tensor(background, dtype=cloud.means.dtype, device=cloud.means.device)
    if behind.shape != (3,):
        raise RenderError(
            f"Gaussian splat: wanted a background of three numbers, got {tuple(behind.shape)}"
        )
    if not near > 0:
        raise RenderError(f"Gaussian splat: near must be positive, got {near:g}")
    if isinstance(cloud, AntialiasedCloud):
        cloud = torch_splat.compensated(cloud, camera, near)
    in_kernel = cloud.means.device.type == "cpu" and cloud.means.dtype == torch.float32
    splat = splat_compiled if in_kernel else torch_splat.splat
    colour, transmittance, depth_sum, radii = splat(cloud, camera, near, screen_offsets)
    alpha = 1 - transmittance
    covered = alpha > 0
    depth = torch.where(covered, depth_sum / torch.where(covered, alpha, 1), 0)
    return GaussianImage(
        image=colour + transmittance[..., None] * behind, alpha=alpha, depth=depth, radii=radii
    )


def splat_compiled(
    cloud: GaussianCloud, camera: Camera, near: float, screen_offsets: torch.Tensor | None
) -> Pictures:
    """Render without a background, as `torch_splat.splat` does, for float32 on the CPU.

    Gradients and pictures have the same bits for any number of threads and any instruction set.
    """
    offsets = None if screen_offsets is None else screen_offsets.to(torch.float32)
    return _Splat.apply(camera, near, *cloud.parameters().values(), offsets)


class _Splat(torch.autograd.Function):
    """Kernel calls; the first two arguments are no tensors."""

    @staticmethod
    def forward(ctx: Any, camera: Camera, near: float, *tensors: torch.Tensor | None) -> Pictures:
        """Return the sums of colour, transmittance, sums of depth, and radii."""
        from ggvs_eval.kernels import _gaussians

        colour, transmittance, depth, radii, frame = _gaussians.render(
            _arrays(tensors),
            pinhole(camera),
            camera.world_to_camera,
            camera.centre,
            near,
            SLOPE_MARGIN,
            *_settings(),
        )
        ctx.save_for_backward(*tensors)
        ctx.frame = frame
        radii_px = torch.from_numpy(radii)
        ctx.mark_non_differentiable(radii_px)
        return (
            torch.from_numpy(colour),
            torch.from_numpy(transmittance),
            torch.from_numpy(depth),
            radii_px,
        )

    @staticmethod
    def backward(ctx: Any, *by_pictures: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        """Return the derivatives by the tensors that want one."""
        from ggvs_eval.kernels import _gaussians

        tensors = ctx.saved_tensors
        by_colour, by_transmittance, by_depth = (
            gradient.contiguous().numpy() for gradient in by_pictures[:3]
        )
        gradients = _gaussians.gradients(
            ctx.frame, _arrays(tensors), by_colour, by_transmittance, by_depth, *_settings()
        )
        pairs = zip(gradients, ctx.needs_input_grad[2:], strict=True)
        return (
            None,
            None,
            *(torch.from_numpy(gradient) if is_needed else None for gradient, is_needed in pairs),
        )


def _arrays(tensors: tuple[torch.Tensor | None, ...]) -> tuple[np.ndarray | None, ...]:
    return tuple(
        None if tensor is None else tensor.detach().contiguous().numpy() for tensor in tensors
    )


def _settings() -> tuple[int, int]:
    return get_threads(), SIMD_LEVELS.index(get_simd_level())
