"""The deformation field of 4DGS (Wu et al., CVPR 2024): features from planes in space and time,
heads that move Gaussians.

By the compiled kernel, forward and backward, as a function that autograd knows; `PlaneGrid` and
torch's layers are its readable twin, and what computes on a GPU.

Names and shapes are those of the authors' ``deformation.pth``, so that their files load strictly.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ggvs_eval.files.weights_file import load_strict, read_tensors
from ggvs_eval.kernels import SIMD_LEVELS, get_simd_level, get_threads

Axes = tuple[tuple[int, int], ...]
AXES = tuple(combinations(range(4), 2))  # xy, xz, xt, yz, yt, zt: the order of the planes
TIME = 3
# name in front of `_deform` -> outputs
HEADS = {"pos": 3, "scales": 3, "rotations": 4, "opacity": 1, "shs": 48}
FIRST_SHARE = 0.1  # of the authors' first weights of the last layers, in a field fitted here
OWNER = "4DGS (deformation.pth)"  # in messages


@dataclass(frozen=True)
class FieldConfiguration:
    """Sizes of a deformation field.

    Attributes:
        levels: nodes of the spatial axes, one number per level; their features are concatenated.
        time_nodes: nodes of the time axis.
        channels: features of a level.
        heads: which properties move, of `HEADS`.
        harmonics: outputs of the head of colours: three per term of the spherical harmonics.
        is_published: as the authors' files: with the parts of the network that they keep and never
            use, heads that begin with random weights, and times in [0, 1) read as they are.
    """

    levels: tuple[int, ...]
    time_nodes: int
    channels: int
    width: int
    heads: tuple[str, ...]
    harmonics: int = HEADS["shs"]
    is_published: bool = False


PUBLISHED = FieldConfiguration(
    levels=(64, 128), time_nodes=150, channels=16, width=128, heads=tuple(HEADS), is_published=True
)


def compact(instants: int, degree: int) -> FieldConfiguration:
    """Return the small field for a clip of N instants, with half as many nodes in time, as the
    authors advise.

    Only sizes do not change over time. Colours must: a screen that shows a film is most of the
    error without them.
    """
    heads = ("pos", "rotations", "opacity", "shs")
    return FieldConfiguration(
        levels=(32, 64),
        time_nodes=max(2, -(-instants // 2)),
        channels=8,
        width=32,
        heads=heads,
        harmonics=3 * (degree + 1) ** 2,
    )


class PlaneGrid(nn.Module):
    """Features of points from planes: bilinear in each, multiplied over planes, concatenated over
    levels.

    Args:
        box: corners of what the planes span, (2, 3), the larger one first: so do the authors, which
            mirrors the axes.

    Reading:
        Points outside the box take the border's features.
    """

    def __init__(
        self,
        box: Tensor,
        configuration: FieldConfiguration,
        axes: tuple[tuple[int, int], ...] = AXES,
    ) -> None:
        super().__init__()
        self.axes = axes
        self.aabb = nn.Parameter(box.clone(), requires_grad=False)
        self.grids = nn.ModuleList()
        for nodes in configuration.levels:
            sizes = (nodes, nodes, nodes, configuration.time_nodes)
            self.grids.append(
                nn.ParameterList([_plane(configuration.channels, sizes, pair) for pair in axes])
            )

    def forward(self, points: Tensor, time: float = 0.0) -> Tensor:
        """Return the features of points (N, 3) at a time in the planes' own scale [-1, 1], (N,
        levels x channels).
        """
        where = (points - self.aabb[0]) * (2 / (self.aabb[1] - self.aabb[0])) - 1
        where = torch.cat([where, torch.full_like(where[:, :1], time)], dim=1)  # (N, 4)
        return torch.cat([self._level(planes, where) for planes in self.grids], dim=1)

    def _level(self, planes: nn.Module, where: Tensor) -> Tensor:
        product = torch.ones(())
        for plane, pair in zip(planes, self.axes, strict=True):  # type: ignore[call-overload]  # a ParameterList
            spots = where[None, :, None, list(pair)]  # (1, N, 1, 2)
            features = F.grid_sample(
                plane, spots, mode="bilinear", padding_mode="border", align_corners=True
            )
            product = product * features[0, :, :, 0]
        return product.T

    def all_planes(self) -> list[Tensor]:
        """Return every plane, level by level."""
        return [plane for level in self.grids for plane in level]  # type: ignore[attr-defined]  # a ParameterList

    def planes(self, spatial: bool) -> list[Tensor]:
        """Return the planes of space alone, or those of space and time."""
        return [
            plane
            for level in self.grids
            for plane, pair in zip(level, self.axes, strict=True)  # type: ignore[call-overload]
            if (TIME not in pair) == spatial
        ]


def _plane(channels: int, sizes: tuple[int, ...], pair: tuple[int, int]) -> nn.Parameter:
    """Return a plane's nodes, (1, C, second axis, first axis): time begins with 1, which changes
    nothing of a product.
    """
    plane = nn.Parameter(torch.ones(1, channels, sizes[pair[1]], sizes[pair[0]]))
    return plane if TIME in pair else nn.Parameter(nn.init.uniform_(plane, 0.1, 0.5))


def field_outputs(
    grid: PlaneGrid, trunk: nn.Module, heads: Sequence[nn.Module], points: Tensor, time: float = 0.0
) -> tuple[Tensor, ...]:
    """Return the outputs of heads at points, by a kernel if there is one.

    Args:
        trunk: the layer that all heads share.
        heads: each a rectifier, a layer, a rectifier and a layer.
        points: (N, 3).
        time: in the planes' own scale [-1, 1].

    Returns:
        (N, outputs) for each head.
    """
    if points.device.type == "cpu" and points.dtype == torch.float32:
        layers = [tensor for part in (trunk, *heads) for tensor in part.parameters()]
        return evaluate_compiled(points, grid.aabb, time, grid.all_planes(), grid.axes, layers)
    features = trunk(grid(points, time))
    return tuple(head(features) for head in heads)


class _Field(nn.Module):
    """Planes, one layer that all share, and a head per property."""

    def __init__(self, box: Tensor, configuration: FieldConfiguration) -> None:
        super().__init__()
        width = configuration.width
        self.grid = PlaneGrid(box, configuration)
        self.feature_out = nn.Sequential(
            linear(len(configuration.levels) * configuration.channels, width)
        )
        for head in configuration.heads:
            last = linear(width, configuration.harmonics if head == "shs" else HEADS[head])
            if not configuration.is_published:
                last.weight.data.mul_(FIRST_SHARE)
            layers = nn.Sequential(nn.ReLU(), linear(width, width), nn.ReLU(), last)
            self.add_module(f"{head}_deform", layers)


def linear(inputs: int, outputs: int) -> nn.Linear:
    """Return a layer with the authors' first weights."""
    layer = nn.Linear(inputs, outputs)
    nn.init.xavier_uniform_(layer.weight)
    nn.init.zeros_(layer.bias)
    return layer


class DeformationNetwork(nn.Module):
    """Position and time -> how each property of a Gaussian differs from the canonical one, before
    its activation.

    Args:
        box: bounding box of the initial points, (2, 3), the larger corner first.

    Reading:
        Heads begin with a tenth of the authors' first weights, which shifts next to nothing; not at
        zero: planes of time would then learn less from the image than the penalty that holds them
        at 1 takes back, and nothing would ever move. The authors give times in [0, 1) to planes
        that span [-1, 1], so that half of the nodes are never met. Their files are read so; a field
        fitted here maps the clip to the whole span.
    """

    def __init__(self, box: Tensor, configuration: FieldConfiguration) -> None:
        super().__init__()
        self.configuration = configuration
        if configuration.is_published:  # in their files, and used by nothing
            for name, count in (
                ("time_poc", 4),
                ("pos_poc", 10),
                ("rotation_scaling_poc", 2),
                ("opacity_poc", 2),
            ):
                self.register_buffer(name, 2.0 ** torch.arange(count))
            self.timenet = nn.Sequential(nn.Linear(9, 64), nn.ReLU(), nn.Linear(64, 32))
        self.deformation_net = _Field(box, configuration)

    def forward(self, points: Tensor, time: float) -> dict[str, Tensor]:
        """Return head -> differences, (N, outputs), of points (N, 3) at a time in [0, 1]."""
        field, names = self.deformation_net, self.configuration.heads
        heads = [getattr(field, f"{head}_deform") for head in names]
        when = time if self.configuration.is_published else 2 * time - 1
        return dict(
            zip(
                names,
                field_outputs(field.grid, field.feature_out, heads, points, when),
                strict=True,
            )
        )

    def smoothness(self) -> Tensor:
        """Penalty on planes that bend: 2e-4 in space, 1e-3 in time, and 1e-4 on planes of time that
        are not 1 (the authors').

        Reading:
            The authors take second differences along a plane's height alone, which for planes of
            time is time; so does this package.
        """
        grid = self.deformation_net.grid
        spatial, temporal = grid.planes(spatial=True), grid.planes(spatial=False)
        bent = 2e-4 * torch.stack([_bend(plane) for plane in spatial]).sum()
        moving = torch.stack(
            [1e-3 * _bend(plane) + 1e-4 * (1 - plane).abs().mean() for plane in temporal]
        ).sum()
        return bent + moving


def _bend(plane: Tensor) -> Tensor:
    """Return the mean squared second difference along the height of a plane.

    0 if it has no three nodes.
    """
    return plane.diff(n=2, dim=2).square().mean() if plane.shape[2] > 2 else plane.new_zeros(())


def read_deformation(path: Path) -> DeformationNetwork:
    """Return the field of a ``deformation.pth`` of the authors."""
    network = DeformationNetwork(torch.zeros(2, 3), PUBLISHED)
    load_strict(read_tensors(path, model=OWNER), network, path, OWNER)
    return network


def evaluate_compiled(
    points: Tensor,
    box: Tensor,
    time: float,
    planes: Sequence[Tensor],
    axes: Sequence[tuple[int, int]],
    layers: Sequence[Tensor],
) -> tuple[Tensor, ...]:
    """Return the outputs of each head of a field at points.

    The same bits for any number of threads.

    Args:
        points: (N, 3), float32 on the CPU.
        box: what the planes span, (2, 3).
        time: on the planes, in [-1, 1].
        planes: (1, channels, nodes of the second axis, of the first) each, level by level.
        axes: of a level's planes.
        layers: weights and biases of the layer that all heads share, then for each head those of
            its two layers.

    Returns:
        (N, outputs) for each head.
    """
    outputs: tuple[Tensor, ...] = _CompiledField.apply(
        time, tuple(axes), len(planes), points, box, *planes, *layers
    )
    return outputs


class _CompiledField(torch.autograd.Function):
    """Kernel calls; the first three arguments are no tensors."""

    @staticmethod
    def forward(
        ctx: Any, time: float, axes: Axes, n_planes: int, *tensors: Tensor
    ) -> tuple[Tensor, ...]:
        """Return the outputs of the heads."""
        from ggvs_eval.kernels import _deformation

        ctx.save_for_backward(*tensors)
        ctx.options = time, axes, n_planes
        outputs = _deformation.evaluate(
            *_compiled_arguments(ctx.options, tensors), *_compiled_settings()
        )
        return tuple(torch.from_numpy(output) for output in outputs)

    @staticmethod
    def backward(ctx: Any, *by_outputs: Tensor) -> tuple[Tensor | None, ...]:
        """Return the derivatives by the points, the planes and the layers."""
        from ggvs_eval.kernels import _deformation

        by_arrays = tuple(gradient.contiguous().numpy() for gradient in by_outputs)
        by_points, by_planes, by_layers = _deformation.gradients(
            *_compiled_arguments(ctx.options, ctx.saved_tensors), by_arrays, *_compiled_settings()
        )
        gradients = (
            torch.from_numpy(by_points),
            None,
            *map(torch.from_numpy, (*by_planes, *by_layers)),
        )
        needed = ctx.needs_input_grad[3:]
        return (
            None,
            None,
            None,
            *(
                gradient if is_needed else None
                for gradient, is_needed in zip(gradients, needed, strict=True)
            ),
        )


def _compiled_arguments(
    options: tuple[float, Axes, int], tensors: Sequence[Tensor]
) -> tuple[Any, Any, float, tuple[Any, ...], Axes, tuple[Any, ...]]:
    time, axes, n_planes = options
    points, box, *parameters = (tensor.detach().contiguous().numpy() for tensor in tensors)
    return points, box, time, tuple(parameters[:n_planes]), axes, tuple(parameters[n_planes:])


def _compiled_settings() -> tuple[int, int]:
    return get_threads(), SIMD_LEVELS.index(get_simd_level())
