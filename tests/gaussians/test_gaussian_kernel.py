"""The compiled splat of 3D Gaussians against its torch twin, forward and backward, and its bits."""

from collections.abc import Callable

import numpy as np
import pytest
import torch

from ggvs_eval import kernels
from ggvs_eval.camera import Camera
from ggvs_eval.compute_device import one_thread
from ggvs_eval.gaussians import GaussianCloud, render, render_gaussians, torch_splat
from helpers.gaussian_clouds import random_cloud, view_of

pytestmark = pytest.mark.usefixtures("kernel_settings", "alone")
WIDTH, HEIGHT = 75, 50  # 3 x 2 tiles, the last ones in part outside of the image
Tensors = dict[str, torch.Tensor]


@pytest.fixture
def alone():
    """Small pictures are faster with one thread of torch."""
    with one_thread():
        yield


def everything(
    splat: Callable[..., tuple[torch.Tensor, ...]], cloud: GaussianCloud, camera: Camera
) -> Tensors:
    """Pictures, and derivatives of a random weighting of them by every parameter and by the screen
    offsets.
    """
    leaves = {
        name: tensor.detach().clone().requires_grad_()
        for name, tensor in cloud.parameters().items()
    }
    offsets = torch.zeros_like(cloud.means[:, :2], requires_grad=True)
    weights = torch.randn(HEIGHT, WIDTH, 5, generator=torch.Generator().manual_seed(1)).to(
        cloud.means
    )
    colour, transmittance, depth, radii = splat(GaussianCloud(**leaves), camera, 0.2, offsets)
    pictures = torch.cat([colour, transmittance[..., None], depth[..., None]], -1)
    (pictures * weights).sum().backward()
    gradients = {
        f"d {name}": leaf.grad
        for name, leaf in {**leaves, "offsets": offsets}.items()
        if leaf.grad is not None
    }
    return {"pictures": pictures.detach(), "radii": radii, **gradients}


@pytest.mark.parametrize("degree", [1, 4])
def test_kernel_and_twin_agree(degree):
    """Of long, thin, turned, hidden and half visible Gaussians, with the twin in double
    precision.
    """
    cloud, camera = (
        random_cloud(250, degree, seed=degree, dtype=torch.float32),
        view_of(WIDTH, HEIGHT, cx=40.2, turned=True),
    )
    ours, twin = (
        everything(render.splat_compiled, cloud, camera),
        everything(torch_splat.splat, cloud.to(dtype=torch.float64), camera),
    )

    assert ours.keys() == twin.keys()
    assert (ours["radii"] != twin["radii"]).sum() <= 1  # rounded up from 2.9999999 or 3.0000001
    for name in ours.keys() - {"radii"}:
        largest = float(twin[name].abs().max())
        np.testing.assert_allclose(
            ours[name], twin[name], atol=2e-4 * largest, rtol=1e-3, err_msg=name
        )
        assert float((ours[name] - twin[name]).square().mean().sqrt()) < 2e-5 * largest, name


@pytest.mark.parametrize("level", kernels.available_levels())
def test_bits_depend_on_neither_threads_nor_instruction_set(level):
    """Pictures and gradients of 1, 2 and 7 threads at any level are those of one thread at the
    lowest.
    """
    cloud, camera = random_cloud(251, dtype=torch.float32), view_of(WIDTH, HEIGHT)
    kernels.set_simd_level("baseline")
    kernels.set_threads(1)
    plain = everything(render.splat_compiled, cloud, camera)
    kernels.set_simd_level(level)
    for threads in (1, 2, 7):
        kernels.set_threads(threads)
        other = everything(render.splat_compiled, cloud, camera)

        assert all(torch.equal(plain[name], other[name]) for name in plain)


def test_equal_depths_keep_the_order_of_the_cloud():
    """The first of two Gaussians at one place is in front, in both paths."""
    colours = torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    cloud = GaussianCloud.of_points(
        torch.tensor([[0.0, 0.0, 2.0]] * 2), colours, scale=1.0, opacity=0.8
    )
    for exact in (torch.float32, torch.float64):
        image = render_gaussians(cloud.to(dtype=exact), view_of(WIDTH, HEIGHT)).image[25, 37]

        assert image[0] > 4 * image[2] > 0


def test_what_is_broken_shows_nothing():
    """NaN, infinities and sizes beyond all floats leave their Gaussian out, and the others as they
    are.
    """
    cloud, camera = random_cloud(40, dtype=torch.float32), view_of(WIDTH, HEIGHT)
    whole = render_gaussians(
        GaussianCloud(*(tensor[8:] for tensor in cloud.parameters().values())), camera
    )
    broken = [tensor.clone() for tensor in cloud.parameters().values()]
    broken[0][0], broken[0][1], broken[0][2, 2], broken[1][3] = (
        torch.nan,
        torch.inf,
        -torch.inf,
        200.0,
    )
    broken[2][4], broken[2][5], broken[3][6], broken[3][7] = (
        torch.nan,
        torch.inf,
        -torch.inf,
        -200.0,
    )
    picture = render_gaussians(GaussianCloud(*broken), camera)

    assert picture.radii[:8].tolist() == [0] * 8
    assert torch.equal(picture.image, whole.image)


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="torch finds no GPU here")
def test_a_gpu_gives_the_same():
    """Pictures to 1e-3, gradients to 1e-3 of the largest."""
    cloud, camera = (
        random_cloud(600, dtype=torch.float32),
        view_of(WIDTH, HEIGHT, cx=40.2, turned=True),
    )
    here, there = (
        everything(render.splat_compiled, cloud, camera),
        everything(torch_splat.splat, cloud.to("cuda"), camera),
    )
    for name in here.keys() - {"radii"}:
        np.testing.assert_allclose(
            there[name].cpu(), here[name], atol=1e-3 * float(here[name].abs().max()), err_msg=name
        )
