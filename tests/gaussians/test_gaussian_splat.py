"""The splat of 3D Gaussians: the facts of the field's rasteriser in closed form, and gradients
against finite differences.
"""

import json
from dataclasses import replace
from math import exp, log, pi, sqrt

import numpy as np
import pytest
import torch

from ggvs_eval.camera import Camera
from ggvs_eval.errors import RenderError
from ggvs_eval.gaussians import GaussianCloud, render_gaussians
from ggvs_eval.gaussians.cloud import (
    antialiased,
    harmonic_basis,
    harmonic_colours,
    turned_harmonics,
)
from ggvs_eval.gaussians.torch_splat import project
from helpers.gaussian_clouds import random_cloud, view_of
from helpers.places import DATA_FOLDER
from helpers.refusals import refused

WIDTH, HEIGHT, FOCAL = 40, 30, 50.0
WHITE = torch.ones(1, 3, dtype=torch.float64)


def camera_of(cx: float = WIDTH / 2, cy: float = HEIGHT / 2) -> Camera:
    return view_of(WIDTH, HEIGHT, cx=cx, cy=cy)


def point(
    z: float = 2.0, *, scale: float = 0.05, opacity: float = 0.9, colour: torch.Tensor = WHITE
) -> GaussianCloud:
    """One round Gaussian on the optical axis."""
    return GaussianCloud.of_points(
        torch.tensor([[0.0, 0.0, z]], dtype=colour.dtype), colour, scale=scale, opacity=opacity
    )


def joined(*clouds: GaussianCloud) -> GaussianCloud:
    return GaussianCloud(
        *(
            torch.cat(tensors)
            for tensors in zip(*(cloud.parameters().values() for cloud in clouds), strict=True)
        )
    )


def test_footprint_in_closed_form():
    """A round Gaussian on the axis: sigma^2 = (f s / z)^2 + 0.3 px^2, pixel centres at halves of
    the camera's coordinates, alpha = o exp(-r^2 / 2 sigma^2), and nothing where that is below
    1/255.
    """
    picture = render_gaussians(point(2.0, scale=0.05, opacity=0.9), camera_of(cx=20.5, cy=14.5))
    columns, rows = np.meshgrid(np.arange(WIDTH) - 20.0, np.arange(HEIGHT) - 14.0)
    variance = (FOCAL * 0.05 / 2.0) ** 2 + 0.3
    expected = 0.9 * np.exp(-(columns**2 + rows**2) / (2 * variance))
    expected[expected < 1 / 255] = 0

    np.testing.assert_allclose(picture.alpha.numpy(), expected, atol=1e-12)
    np.testing.assert_allclose(
        picture.image.numpy(), np.repeat(expected[..., None], 3, 2), atol=1e-12
    )
    np.testing.assert_allclose(picture.depth.numpy(), np.where(expected > 0, 2.0, 0.0), atol=1e-12)
    # the reference's floor below the root
    assert picture.radii.tolist() == [int(np.ceil(3 * sqrt(variance + sqrt(0.1))))]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_antialiased_gaussians_keep_their_light(dtype):
    """The opacity is multiplied by sqrt(det S / det(S + 0.3 I)), which is sigma^2 / (sigma^2 + 0.3)
    of a round Gaussian.
    """
    thin = antialiased(point(4.0, scale=0.05, opacity=0.9, colour=WHITE.to(dtype)))
    variance = (FOCAL * 0.05 / 4.0) ** 2

    alpha = render_gaussians(thin, camera_of(cx=20.5, cy=14.5)).alpha
    assert float(alpha[14, 20]) == pytest.approx(0.9 * variance / (variance + 0.3), abs=1e-6)


def test_alpha_is_at_most_099():
    """However opaque, a Gaussian leaves a hundredth of what is behind it."""
    picture = render_gaussians(
        point(opacity=0.9999), camera_of(cx=20.5, cy=15.5), background=(0.0, 1.0, 0.0)
    )

    assert picture.alpha.max() == pytest.approx(0.99, abs=1e-12)
    assert picture.image[15, 20].tolist() == pytest.approx([0.99, 1.0, 0.99])


def test_order_and_early_stop():
    """Nearest first whatever the order of the cloud; the pixel stops BEFORE the Gaussian that would
    bring T under 1e-4.
    """
    colours = torch.eye(3, dtype=torch.float64)
    layers = [
        point(2.0 + n, scale=5.0, opacity=0.95, colour=colours[None, n % 3]) for n in range(4)
    ]
    centre = render_gaussians(joined(*layers[::-1]), camera_of(cx=20.5, cy=15.5))
    weights = [0.95, 0.05 * 0.95, 0.05**2 * 0.95]  # T is 1.25e-4 then, and 6e-6 after the fourth

    assert centre.image[15, 20].tolist() == pytest.approx(weights, abs=1e-9)
    assert 1 - centre.alpha[15, 20].item() == pytest.approx(0.05**3, abs=1e-9)
    assert centre.depth[15, 20].item() == pytest.approx(
        np.average([2, 3, 4], weights=weights), abs=1e-9
    )


def test_near_plane_culls_at_02():
    """Depth 0.2 is left out, what lies just behind it is shown; nothing behind the camera is."""
    radii = [render_gaussians(point(z), camera_of()).radii.item() for z in (-2.0, 0.2, 0.2001)]

    assert radii[:2] == [0, 0]
    assert radii[2] > 0
    assert render_gaussians(point(0.3), camera_of(), near=0.4).alpha.max() == 0


def test_principal_point_shifts_the_image():
    """A principal point 3 px to the right and 2 px down moves every pixel by as much: the
    projection is K's.
    """
    cloud = random_cloud(30)
    # slopes that the Jacobian takes as they are
    inner = (cloud.means[:, :2].abs() / cloud.means[:, 2:] < 0.2).all(1)
    cloud = GaussianCloud(*(tensor[inner] for tensor in cloud.parameters().values()))
    straight, shifted = (
        render_gaussians(cloud, camera_of()),
        render_gaussians(cloud, camera_of(WIDTH / 2 + 3, HEIGHT / 2 + 2)),
    )

    np.testing.assert_allclose(shifted.image[2:, 3:], straight.image[:-2, :-3], atol=1e-9)
    assert straight.alpha.max() > 0.3


def test_anisotropic_gaussian_in_closed_form():
    """An axis along x alone stretches by (f s / z)^2 along x; turned by 90 degrees about z it does
    along y.
    """
    cloud = point(2.0, opacity=0.8)
    axes = torch.tensor([[log(0.2), log(0.01), log(0.01)]], dtype=torch.float64)
    turn = torch.tensor([[sqrt(0.5), 0, 0, sqrt(0.5)]], dtype=torch.float64)
    along = render_gaussians(replace(cloud, log_scales=axes), camera_of(20.5, 15.5))
    across = render_gaussians(
        replace(cloud, log_scales=axes, quaternions=7 * turn), camera_of(20.5, 15.5)
    )

    assert along.alpha[15, 24].item() == pytest.approx(0.8 * exp(-16 / (2 * (25 + 0.3))))
    assert along.alpha[16, 20].item() == pytest.approx(0.8 * exp(-1 / (2 * (0.0625 + 0.3))))
    np.testing.assert_allclose(
        across.alpha[15 - 9 : 15 + 10, 20], along.alpha[15, 20 - 9 : 20 + 10], atol=1e-12
    )


def test_colour_of_harmonics():
    """Colour is the sum of harmonics along the direction camera -> Gaussian, plus 0.5, and not
    below 0.
    """
    cloud = point(2.0, opacity=0.5)
    sh = torch.zeros(1, 4, 3, dtype=torch.float64)
    sh[0, 0] = torch.tensor([0.2, -5.0, 0.0])
    sh[0, 2] = torch.tensor([0.3, 0.0, 0.1])  # of z: the Gaussian lies along +z
    picture = render_gaussians(replace(cloud, sh=sh), camera_of(20.5, 15.5))
    constant, first = 0.5 / sqrt(pi), sqrt(3 / (4 * pi))

    expected = [0.5 * (0.5 + constant * 0.2 + first * 0.3), 0.0, 0.5 * (0.5 + first * 0.1)]
    assert picture.image[15, 20].tolist() == pytest.approx(expected)


def test_harmonics_are_those_of_scipy():
    """Every term up to degree 4 is the real form of scipy's complex harmonics, which carry the
    Condon-Shortley phase.
    """
    from scipy.special import sph_harm_y

    directions = torch.nn.functional.normalize(random_cloud(50).means, dim=1)
    x, y, z = directions.numpy().T
    polar, azimuth = np.arccos(z), np.arctan2(y, x)
    for degree in range(5):
        for order in range(-degree, degree + 1):
            value = sph_harm_y(degree, abs(order), polar, azimuth)
            real = value.real if order == 0 else sqrt(2) * (value.imag if order < 0 else value.real)
            np.testing.assert_allclose(
                harmonic_basis(directions, 4)[:, degree * degree + degree + order], real, atol=1e-12
            )


def test_turned_harmonics_show_the_same():
    """Colours of degree 4 that were seen along d are seen along R d; two turns are one, and turning
    back restores them.
    """
    from scipy.spatial.transform import Rotation

    generator = torch.Generator().manual_seed(3)
    sh = torch.randn(5, 25, 3, generator=generator, dtype=torch.float64)
    directions = torch.nn.functional.normalize(
        torch.randn(5, 3, generator=generator, dtype=torch.float64), dim=-1
    )
    first, second = (
        torch.as_tensor(Rotation.random(random_state=seed).as_matrix()) for seed in (1, 2)
    )
    torch.testing.assert_close(
        harmonic_colours(turned_harmonics(sh, first), directions @ first.T),
        harmonic_colours(sh, directions),
        atol=1e-10,
        rtol=0,
    )
    torch.testing.assert_close(
        turned_harmonics(turned_harmonics(sh, first), second),
        turned_harmonics(sh, second @ first),
        atol=1e-10,
        rtol=0,
    )
    torch.testing.assert_close(
        turned_harmonics(turned_harmonics(sh, first), first.T), sh, atol=1e-10, rtol=0
    )


def test_projection_is_that_of_gsplat():
    """Centres, inverse covariances and colours as gsplat 1.5.3's torch implementation gives them
    (`gsplat.cuda._torch_impl`: `_fully_fused_projection` with eps2d 0.3, `_spherical_harmonics`;
    2026-11-23), whose pixel centres lie at halves.
    """
    golden = json.loads((DATA_FOLDER / "gsplat_projection.json").read_text())
    ellipses = project(random_cloud(12), view_of(75, 50, cx=40.2, turned=True), near=0.2)

    assert ellipses.visible.nonzero()[:, 0].tolist() == golden["gaussians"]
    for name, ours in (
        ("means2d", ellipses.centres + 0.5),
        ("conics", ellipses.conics),
        ("colours", ellipses.colours),
    ):
        np.testing.assert_allclose(
            ours[golden["gaussians"]], golden[name], rtol=1e-8, atol=1e-8, err_msg=name
        )


def test_gradients_are_those_of_finite_differences():
    """Of every parameter group and the screen offsets, through image, alpha and depth together, in
    double precision.
    """
    cloud = random_cloud(14, seed=3)
    offsets = torch.zeros(len(cloud), 2, dtype=torch.float64)
    weights = torch.randn(
        HEIGHT, WIDTH, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(2)
    )

    def weighted(*tensors: torch.Tensor) -> torch.Tensor:
        picture = render_gaussians(
            GaussianCloud(*tensors[:5]), camera_of(cx=22.3), (0.2, 0.3, 0.4), tensors[5]
        )
        return (
            torch.cat([picture.image, picture.alpha[..., None], picture.depth[..., None]], -1)
            * weights
        ).sum()

    inputs = tuple(tensor.requires_grad_() for tensor in (*cloud.parameters().values(), offsets))
    assert torch.autograd.gradcheck(
        weighted, inputs, eps=1e-7, atol=1e-4, rtol=1e-3, fast_mode=True
    )


def test_nothing_to_show():
    """An empty cloud, and one behind the camera, show the background; gradients are 0 and
    not NaN.
    """
    empty = GaussianCloud.of_points(torch.zeros(0, 3), torch.zeros(0, 3), scale=1.0)
    behind = point(-3.0)
    behind.means.requires_grad_()
    picture = render_gaussians(behind, camera_of(), background=(0.1, 0.2, 0.3))
    picture.image.sum().backward()

    assert render_gaussians(empty, camera_of(), background=(0.1, 0.2, 0.3)).image[
        0, 0
    ].tolist() == pytest.approx([0.1, 0.2, 0.3])
    assert picture.image[3, 3].tolist() == pytest.approx([0.1, 0.2, 0.3])
    assert behind.means.grad.abs().max() == 0


def test_what_is_no_cloud_is_refused():
    cloud = random_cloud(3, dtype=torch.float32)
    parameters = cloud.parameters()
    with refused(RenderError, "(N, (degree + 1)^2, 3)", "(3, 5, 3)"):
        GaussianCloud(**{**parameters, "sh": torch.zeros(3, 5, 3)})
    with refused(RenderError, "quaternions", "(3, 4)", "(2, 4)"):
        GaussianCloud(**{**parameters, "quaternions": torch.zeros(2, 4)})
    with refused(RenderError, "opacity_logits", "torch.float32 on cpu", "torch.float64"):
        GaussianCloud(**{**parameters, "opacity_logits": torch.zeros(3, dtype=torch.float64)})
    with refused(RenderError, "screen offsets", "(3, 2)", "(3, 3)"):
        render_gaussians(cloud, camera_of(), screen_offsets=torch.zeros(3, 3))
    with refused(RenderError, "near", "-1"):
        render_gaussians(cloud, camera_of(), near=-1)
    with refused(RenderError, "background", "three numbers"):
        render_gaussians(cloud, camera_of(), background=(1.0,))
