"""A deformation field by the compiled kernel, forward and backward, as a function that autograd knows.

`hexplane.PlaneGrid` and torch's layers are its readable twin, and what computes on a GPU.
"""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from ggvs_eval.kernels import SIMD_LEVELS, get_simd_level, get_threads

Axes = tuple[tuple[int, int], ...]


def evaluate(
    points: Tensor,
    box: Tensor,
    time: float,
    planes: Sequence[Tensor],
    axes: Sequence[tuple[int, int]],
    layers: Sequence[Tensor],
) -> tuple[Tensor, ...]:
    """Outputs of each head of a field at points; the same bits for any number of threads.

    Args:
        points: (N, 3), float32 on the CPU.
        box: what the planes span, (2, 3).
        time: on the planes, in [-1, 1].
        planes: (1, channels, nodes of the second axis, of the first) each, level by level.
        axes: of a level's planes.
        layers: weights and biases of the layer that all heads share, then for each head those of its two layers.

    Returns:
        (N, outputs) for each head.
    """
    outputs: tuple[Tensor, ...] = _Field.apply(time, tuple(axes), len(planes), points, box, *planes, *layers)
    return outputs


class _Field(torch.autograd.Function):
    """Kernel calls; the first three arguments are no tensors."""

    @staticmethod
    def forward(ctx: Any, time: float, axes: Axes, n_planes: int, *tensors: Tensor) -> tuple[Tensor, ...]:
        """Outputs of the heads."""
        from ggvs_eval.kernels import _deformation

        ctx.save_for_backward(*tensors)
        ctx.options = time, axes, n_planes
        outputs = _deformation.evaluate(*_arguments(ctx.options, tensors), *_settings())
        return tuple(torch.from_numpy(output) for output in outputs)

    @staticmethod
    def backward(ctx: Any, *by_outputs: Tensor) -> tuple[Tensor | None, ...]:
        """Derivatives by the points, the planes and the layers."""
        from ggvs_eval.kernels import _deformation

        given = tuple(gradient.contiguous().numpy() for gradient in by_outputs)
        by_points, by_planes, by_layers = _deformation.gradients(*_arguments(ctx.options, ctx.saved_tensors), given, *_settings())
        gradients = (torch.from_numpy(by_points), None, *map(torch.from_numpy, (*by_planes, *by_layers)))
        needed = ctx.needs_input_grad[3:]
        return None, None, None, *(each if asked else None for each, asked in zip(gradients, needed, strict=True))


def _arguments(
    options: tuple[float, Axes, int], tensors: Sequence[Tensor]
) -> tuple[Any, Any, float, tuple[Any, ...], Axes, tuple[Any, ...]]:
    time, axes, n_planes = options
    points, box, *others = (tensor.detach().contiguous().numpy() for tensor in tensors)
    return points, box, time, tuple(others[:n_planes]), axes, tuple(others[n_planes:])


def _settings() -> tuple[int, int]:
    return get_threads(), SIMD_LEVELS.index(get_simd_level())
