"""ENeRF: names and shapes of the published checkpoint, outputs equal to the authors', and the
method as a whole.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from ggvs_eval.baselines.enerf.method import ENeRF
from ggvs_eval.baselines.enerf.network import Networks, load_enerf
from ggvs_eval.baselines.enerf.rendering import find_surface, render_pixels, target_grid
from ggvs_eval.baselines.enerf.views import see
from ggvs_eval.compute_device import one_thread
from ggvs_eval.errors import RenderError
from helpers.places import DATA_FOLDER
from helpers.refusals import refused
from helpers.seeded_baselines import seed_weights, turned_rig


@pytest.fixture(scope="module")
def networks():
    return seed_weights(Networks()).requires_grad_(False)


@pytest.fixture(scope="module")
def weights(networks, tmp_path_factory):
    path = tmp_path_factory.mktemp("enerf") / "latest.pth"
    torch.save({"net": networks.state_dict(), "optim": {"state": {}}, "epoch": 299}, path)
    return path


@pytest.fixture(scope="module")
def golden():
    """Outputs of the authors' code on the same weights (tests/data/IBRNET_ENERF_ORACLES.md)."""
    return np.load(DATA_FOLDER / "enerf_golden.npz")


@pytest.fixture(autouse=True)
def single_thread():
    """Small tensors; more threads would only wait for each other."""
    with one_thread():
        yield


def small_target(views):
    """A rig whose target has another size than its sources, none of them a multiple of 32."""
    instant = turned_rig(views, 44, 36)
    return replace(instant, target=instant.target.resized(38, 50))


def test_names_and_shapes_are_those_of_the_checkpoint():
    """Every parameter and buffer of the authors' network exists under its name with its shape, and
    no other.
    """
    oracle = json.loads((DATA_FOLDER / "enerf_state_dict.json").read_text())
    networks = Networks()
    assert {name: list(tensor.shape) for name, tensor in networks.state_dict().items()} == oracle[
        "net"
    ]
    assert sum(parameter.numel() for parameter in networks.parameters()) == oracle["n_params"]


def test_features_are_the_authors(networks, golden):
    """The pyramid of one image agrees with the authors' to 1e-4 at its three sizes."""
    image = torch.from_numpy(turned_rig(3).sources[0].image).permute(2, 0, 1)[None].float() / 255
    quarter, half, full = networks.feature_net(2 * image - 1)
    np.testing.assert_allclose(quarter[0], golden["quarter"], atol=1e-4)
    np.testing.assert_allclose(half[0, :, ::2, ::2], golden["half"], atol=1e-4)
    np.testing.assert_allclose(full[0, :, ::4, ::4], golden["full"], atol=1e-4)


def test_the_other_networks_are_the_authors(networks, golden):
    """Both cost networks and the wide radiance network agree on random inputs."""
    rng = np.random.default_rng(5)
    for level, (width, columns, name) in enumerate([(32, 12, "coarse"), (16, 16, "fine")]):
        volume = torch.from_numpy(rng.uniform(0, 1, (1, width, 8, 8, columns))).float()
        features, scores = networks.get_submodule(f"cost_reg_{level}")(volume)
        np.testing.assert_allclose(scores[0], golden[f"scores_{name}"], atol=1e-4)
        np.testing.assert_allclose(
            features[0, :, ::2, ::2, ::2], golden[f"features_{name}"], atol=1e-4
        )
    voxels = torch.from_numpy(rng.normal(size=(40, 8))).float()
    seen = torch.from_numpy(rng.normal(size=(40, 4, 39))).float()
    seen[..., 32:35] = torch.sigmoid(seen[..., 32:35])
    colours, density = networks.nerf_0(voxels, seen[..., :35], seen[..., 35:])
    np.testing.assert_allclose(colours, golden["radiance"][:, :3], atol=1e-5)
    np.testing.assert_allclose(density, golden["radiance"][:, 3], atol=1e-5)


def test_rendered_pixels_are_the_authors(networks, golden):
    """Every 7th pixel of a turned rig, by both volumes and two samples, agrees with the authors' to
    1e-4 in colour and depth.
    """
    instant = turned_rig(3)
    views = [see(networks.feature_net, source) for source in instant.sources]
    surface = find_surface(
        networks, views, target_grid(instant.target), *instant.depth_range, planes=32
    )
    rays = torch.from_numpy(instant.target.rays().reshape(-1, 3)).float()[::7]
    pixels = torch.arange(64 * 96)[::7]
    centre = torch.from_numpy(instant.target.centre).float()
    colours, depth = render_pixels(
        networks, views, surface, centre, rays, (pixels // 96, pixels % 96)
    )
    np.testing.assert_allclose(colours, golden["rgb"], atol=1e-4)
    np.testing.assert_allclose(depth, golden["depth"], atol=1e-4)
    assert golden["rgb"].std() > 0.1


def test_a_published_checkpoint_loads_strictly(networks, weights, tmp_path):
    """A file in the authors' format, with and without ``module.``, becomes the networks, bit for
    bit.
    """
    torch.save(
        {"net": {f"module.{name}": tensor for name, tensor in networks.state_dict().items()}},
        tmp_path / "parallel.pth",
    )
    for path in (weights, tmp_path / "parallel.pth"):
        loaded = load_enerf(path).state_dict()
        assert all(
            torch.equal(tensor, loaded[name]) for name, tensor in networks.state_dict().items()
        )


@pytest.mark.parametrize("views", [2, 5])
def test_a_step_gives_a_picture(weights, views):
    """Of any number of views from two: finite, of the target's size, not flat, in [0, 1]; depth
    within the range.
    """
    instant = small_target(views)
    rendering = ENeRF(weights).step(instant)
    assert rendering.image.shape == (50, 38, 3)
    assert rendering.image.dtype == np.float32
    assert rendering.image.min() >= 0
    assert rendering.image.max() <= 1
    assert rendering.image.std() > 0.02
    near, far = instant.depth_range
    assert rendering.depth.min() >= near * 0.999
    assert rendering.depth.max() <= far * 1.001
    assert set(rendering.seconds) == {"features", "volumes", "rays"}


@pytest.mark.usefixtures("torch_threads")
def test_a_step_is_the_same_again(weights):
    """Equal bits from a second object and with another number of threads, close ones with other
    chunks.
    """
    instant = small_target(2)
    first = ENeRF(weights).step(instant).image
    torch.set_num_threads(2)
    assert np.array_equal(ENeRF(weights).step(instant).image, first)
    assert torch.get_num_threads() == 2
    np.testing.assert_allclose(
        ENeRF(weights, pixels_per_chunk=101).step(instant).image, first, atol=1e-5
    )


def in_millimetres(camera):
    """The same camera in a world measured in thousandths."""
    world_to_camera = camera.world_to_camera.copy()
    world_to_camera[:3, 3] *= 1000
    return replace(
        camera, world_to_camera=world_to_camera, near=1000 * camera.near, far=1000 * camera.far
    )


def test_units_of_length_do_not_matter(weights):
    """A scene in millimetres gives the picture of the same scene in metres, and a thousandfold
    depth.
    """
    instant = small_target(2)
    sources = tuple(
        replace(source, camera=in_millimetres(source.camera)) for source in instant.sources
    )
    scaled = replace(instant, target=in_millimetres(instant.target), sources=sources)
    once, again = ENeRF(weights).step(instant), ENeRF(weights).step(scaled)
    np.testing.assert_allclose(again.image, once.image, atol=1e-4)
    np.testing.assert_allclose(again.depth / 1000, once.depth, atol=1e-3)


def test_too_little_is_refused(weights):
    """One view, or a number of planes that cannot be halved twice, is refused with what is
    wanted.
    """
    instant = small_target(2)
    with refused(RenderError, "2 source views", "got 1"):
        ENeRF(weights).step(replace(instant, sources=instant.sources[:1]))
    with refused(RenderError, "multiples of 4", "got 30"):
        ENeRF(weights, coarse_planes=30)
