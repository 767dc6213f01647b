"""The compiled deformation field against its torch twin, forward and backward, its bits, and what
it refuses.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch

from ggvs_eval import kernels
from ggvs_eval.baselines.fitted.hexplane import (
    HEADS,
    DeformationNetwork,
    FieldConfiguration,
    compact,
)
from ggvs_eval.kernels import _deformation
from helpers.refusals import refused

pytestmark = pytest.mark.usefixtures("kernel_settings")
BOX = torch.tensor([[2.0, 3.0, 4.0], [-2.0, -1.0, -4.0]])  # the larger corner first
Tensors = dict[str, torch.Tensor]
FIELDS = {
    "compact": compact(24, 1),
    "one instant": replace(compact(24, 0), time_nodes=1),
    "odd sizes": FieldConfiguration((5, 2, 9), 3, 11, 7, ("pos", "opacity"), is_published=True),
}


def everything(
    configuration: FieldConfiguration, dtype: torch.dtype, count: int = 301, spoilt: bool = False
) -> Tensors:
    """Outputs of a seeded field, and derivatives of a random weighting of them; every third point's
    outputs count for nothing.

    Args:
        configuration: of the field.
        dtype: float32 is the kernel's, float64 its twin's.
        count: of points in and around the box.
        spoilt: whether the first two are no points.
    """
    draw = torch.Generator().manual_seed(7)
    network = DeformationNetwork(BOX, configuration)
    for parameter in network.parameters():
        if parameter.requires_grad:
            parameter.data = torch.rand(parameter.shape, generator=draw) - 0.5
    network = network.to(dtype)
    points = (9 * torch.rand(count, 3, generator=draw) - 4.5).to(dtype)
    if spoilt:
        points[0, 1], points[1, 2] = torch.nan, torch.inf
    points.requires_grad_()
    outputs = network(points, 0.37)
    weights = (
        torch.randn(count, sum(HEADS.values()), generator=draw)
        * (torch.arange(count) % 3 > 0)[:, None]
    )
    sum(
        (weights[:, : output.shape[1]].to(dtype) * output).sum() for output in outputs.values()
    ).backward()
    gradients = {
        f"d {name}": value.grad
        for name, value in network.named_parameters()
        if value.grad is not None
    }
    return (
        {name: output.detach() for name, output in outputs.items()}
        | gradients
        | {"d points": points.grad}
    )


@pytest.mark.parametrize("name", FIELDS)
def test_kernel_and_twin_agree(name):
    """Outputs and every derivative, with the twin in double precision, also of points outside the
    box.
    """
    ours, twin = everything(FIELDS[name], torch.float32), everything(FIELDS[name], torch.float64)

    assert ours.keys() == twin.keys()
    assert (twin["d points"][1::3] != 0).any()
    for each in twin:
        np.testing.assert_allclose(
            ours[each],
            twin[each],
            atol=5e-5 * float(twin[each].abs().max()),
            rtol=1e-4,
            err_msg=each,
        )


def test_derivatives_are_finite_differences():
    """Those by points are what the outputs do when points move, in double precision by the twin."""
    torch.manual_seed(3)
    network = DeformationNetwork(
        BOX, replace(compact(4, 0), levels=(4, 7), channels=3, width=6, heads=("pos",))
    ).double()
    torch.nn.init.normal_(network.deformation_net.pos_deform[3].weight)
    points = (2 * torch.rand(5, 3, dtype=torch.float64) - 1).requires_grad_()

    assert torch.autograd.gradcheck(lambda places: network(places, 0.3)["pos"], (points,))


@pytest.mark.parametrize("level", kernels.available_levels())
def test_bits_depend_on_neither_threads_nor_vectors(level):
    """Outputs and derivatives of 1, 2 and 7 threads and of every instruction set are the same."""
    kernels.set_simd_level("baseline")
    kernels.set_threads(1)
    plain = everything(FIELDS["compact"], torch.float32, 1501)
    kernels.set_simd_level(level)
    for threads in (1, 2, 7):
        kernels.set_threads(threads)
        other = everything(FIELDS["compact"], torch.float32, 1501)

        assert all(torch.equal(plain[name], other[name]) for name in plain)


def test_arrays_that_do_not_fit_are_refused():
    """Each is named with the shape that was wanted."""
    points, box = np.zeros((4, 3), np.float32), BOX.numpy()
    planes = tuple(np.ones((1, 8, 3, 3), np.float32) for _ in range(3))
    axes = ((0, 1), (0, 2), (1, 2))
    layers = tuple(np.zeros(shape, np.float32) for shape in ((6, 8), 6, (6, 6), 6, (2, 6), 2))
    settings = 1, 0

    assert _deformation.evaluate(points, box, 0.0, planes, axes, layers, *settings)[0].shape == (
        4,
        2,
    )
    with refused(TypeError, "points", "float32 (4, 3)", "float64"):
        _deformation.evaluate(points.astype(float), box, 0.0, planes, axes, layers, *settings)
    wrong = (np.zeros((6, 9), np.float32), *layers[1:])
    with refused(TypeError, "weights", "float32 (6, 8)", "float32 (6, 9)"):
        _deformation.evaluate(points, box, 0.0, planes, axes, wrong, *settings)
    with refused(TypeError, "pairs of axes", "planes"):
        _deformation.evaluate(points, box, 0.0, planes[:2], axes, layers, *settings)
    with refused(TypeError, "axes", "0 to 3"):
        _deformation.evaluate(points, box, 0.0, planes, ((1, 0), *axes[1:]), layers, *settings)
    with refused(TypeError, "layers", "four for each head"):
        _deformation.evaluate(points, box, 0.0, planes, axes, layers[:4], *settings)
    with refused(TypeError, "by_outputs", "float32 (4, 2)", "float32 (4, 3)"):
        _deformation.gradients(points, box, 0.0, planes, axes, layers, (points,), *settings)
