"""ENeRF: names and shapes of the published checkpoint, outputs equal to the authors', and the method as a whole."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from ggvs_eval.baselines.enerf.method import ENeRF
from ggvs_eval.baselines.enerf.network import Networks, load_enerf
from ggvs_eval.baselines.enerf.rendering import composite, disagreement, expectation, find_surface, render_pixels, target_grid
from ggvs_eval.baselines.enerf.views import SeenView, extrinsics, see
from ggvs_eval.compute_device import one_thread
from ggvs_eval.errors import RenderError, WeightsError
from helpers.hostile import Hostile
from helpers.places import DATA_FOLDER
from helpers.refusals import refused
from helpers.scenes import WALL_Z, camera_at, look
from helpers.seeded_baselines import seed_weights, turned_rig

DATA = DATA_FOLDER


@pytest.fixture(scope="module")
def networks():
    """The networks with seeded weights."""
    return seed_weights(Networks()).requires_grad_(False)


@pytest.fixture(scope="module")
def weights(networks, tmp_path_factory):
    """A checkpoint as the authors write it."""
    path = tmp_path_factory.mktemp("enerf") / "latest.pth"
    torch.save({"net": networks.state_dict(), "optim": {"state": {}}, "epoch": 299}, path)
    return path


@pytest.fixture(scope="module")
def golden():
    """Outputs of the authors' code on the same weights (tests/data/IBRNET_ENERF_ORACLES.md)."""
    return np.load(DATA / "enerf_golden.npz")


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
    """Every parameter and buffer of the authors' network exists under its name with its shape, and no other."""
    oracle = json.loads((DATA / "enerf_state_dict.json").read_text())
    networks = Networks()
    assert {name: list(tensor.shape) for name, tensor in networks.state_dict().items()} == oracle["net"]
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
        np.testing.assert_allclose(features[0, :, ::2, ::2, ::2], golden[f"features_{name}"], atol=1e-4)
    voxels = torch.from_numpy(rng.normal(size=(40, 8))).float()
    seen = torch.from_numpy(rng.normal(size=(40, 4, 39))).float()
    seen[..., 32:35] = torch.sigmoid(seen[..., 32:35])
    colours, density = networks.nerf_0(voxels, seen[..., :35], seen[..., 35:])
    np.testing.assert_allclose(colours, golden["radiance"][:, :3], atol=1e-5)
    np.testing.assert_allclose(density, golden["radiance"][:, 3], atol=1e-5)


def test_rendered_pixels_are_the_authors(networks, golden):
    """Every 7th pixel of a turned rig, by both volumes and two samples, agrees with the authors' to 1e-4 in colour and depth."""
    instant = turned_rig(3)
    views = [see(networks.feature_net, source) for source in instant.sources]
    surface = find_surface(networks, views, target_grid(instant.target), *instant.depth_range, planes=32)
    rays = torch.from_numpy(instant.target.rays().reshape(-1, 3)).float()[::7]
    pixels = torch.arange(64 * 96)[::7]
    centre = torch.from_numpy(instant.target.centre).float()
    colours, depth = render_pixels(networks, views, surface, centre, rays, (pixels // 96, pixels % 96))
    np.testing.assert_allclose(colours, golden["rgb"], atol=1e-4)
    np.testing.assert_allclose(depth, golden["depth"], atol=1e-4)
    assert golden["rgb"].std() > 0.1


def test_a_published_checkpoint_loads_strictly(networks, weights, tmp_path):
    """A file in the authors' format, with and without ``module.``, becomes the networks, bit for bit."""
    torch.save({"net": {f"module.{name}": tensor for name, tensor in networks.state_dict().items()}}, tmp_path / "parallel.pth")
    for path in (weights, tmp_path / "parallel.pth"):
        loaded = load_enerf(path).state_dict()
        assert all(torch.equal(tensor, loaded[name]) for name, tensor in networks.state_dict().items())


def test_what_is_no_checkpoint_is_refused(networks, tmp_path):
    """Absent, damaged, hostile, without its state dict, or of another shape: refused in one line, and no code is run."""
    state = networks.state_dict()
    (tmp_path / "damaged.pth").write_bytes(b"PK\x03\x04 no zip")
    torch.save({"net": state, "epoch": Hostile(tmp_path / "pwned")}, tmp_path / "hostile.pth")
    torch.save({"model": state}, tmp_path / "partial.pth")
    torch.save({"net": {**state, "nerf_1.lr0.0.bias": torch.zeros(32)}}, tmp_path / "shape.pth")
    cases = {
        "nowhere": r"nowhere\.pth: wanted weights of ENeRF",
        "damaged": "wanted a file of tensors only",
        "hostile": "wanted a file of tensors only",
        "partial": "wanted a state dict under net, got model",
        "shape": r"1 tensors differ from ENeRF, first nerf_1\.lr0\.0\.bias: wanted \(64,\), got \(32,\)",
    }
    for name, message in cases.items():
        with pytest.raises(WeightsError, match=message) as caught:
            load_enerf(tmp_path / f"{name}.pth")
        assert "\n" not in str(caught.value)
    assert not (tmp_path / "pwned").exists()


@pytest.mark.parametrize("views", [2, 5])
def test_a_step_gives_a_picture(weights, views):
    """Of any number of views from two: finite, of the target's size, not flat, in [0, 1]; depth within the range."""
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
    """Equal bits from a second object and with another number of threads, close ones with other chunks."""
    instant = small_target(2)
    first = ENeRF(weights).step(instant).image
    torch.set_num_threads(2)
    assert np.array_equal(ENeRF(weights).step(instant).image, first)
    assert torch.get_num_threads() == 2
    np.testing.assert_allclose(ENeRF(weights, pixels_per_chunk=101).step(instant).image, first, atol=1e-5)


def in_millimetres(camera):
    """The same camera in a world measured in thousandths."""
    world_to_camera = camera.world_to_camera.copy()
    world_to_camera[:3, 3] *= 1000
    return replace(camera, world_to_camera=world_to_camera, near=1000 * camera.near, far=1000 * camera.far)


def test_units_of_length_do_not_matter(weights):
    """A scene in millimetres gives the picture of the same scene in metres, and a thousandfold depth."""
    instant = small_target(2)
    sources = tuple(replace(source, camera=in_millimetres(source.camera)) for source in instant.sources)
    scaled = replace(instant, target=in_millimetres(instant.target), sources=sources)
    once, again = ENeRF(weights).step(instant), ENeRF(weights).step(scaled)
    np.testing.assert_allclose(again.image, once.image, atol=1e-4)
    np.testing.assert_allclose(again.depth / 1000, once.depth, atol=1e-3)


def test_too_little_is_refused(weights):
    """One view, or a number of planes that cannot be halved twice, is refused with what is wanted."""
    instant = small_target(2)
    with refused(RenderError, "2 source views", "got 1"):
        ENeRF(weights).step(replace(instant, sources=instant.sources[:1]))
    with refused(RenderError, "multiples of 4", "got 30"):
        ENeRF(weights, coarse_planes=30)


def test_views_agree_where_the_surface_is():
    """Planes before the target at several depths: the views' colours disagree least at the depth of the wall they show."""
    target = camera_at(0.0, 0.0, "target")
    views = []
    for x in (-0.3, 0.25, 0.4):
        camera = camera_at(x)
        image = torch.from_numpy(look(camera, square_x=9.0)[0]).permute(2, 0, 1)[None].float() / 255
        half = torch.nn.functional.interpolate(image, scale_factor=0.5, mode="bilinear", align_corners=True)[0]
        views.append(SeenView((half, half), image[0], camera.K_opencv, extrinsics(camera, 1.0)))
    depths = torch.tensor([3.0, 4.0, WALL_Z, 6.5, 8.0])
    grid = target_grid(target)
    planes = depths[:, None, None].expand(-1, grid.height // 2, grid.width // 2)
    seen = disagreement(views, grid, 1, planes)[:, :, 8:28, 15:33]  # where all views look
    mean = seen.mean(dim=(0, 2, 3))
    assert int(mean.argmin()) == 2
    assert float(mean[2]) < 0.1 * float(mean[[0, 1, 3, 4]].min())


def test_expectation_follows_its_formula():
    """Mean and deviation under the softmax; what is certain deviates by 1e-5."""
    scores = torch.tensor([0.0, 1.0, -1.0])[:, None, None]
    values = torch.tensor([1.0, 2.0, 4.0])[:, None, None]
    shares = np.exp([0.0, 1.0, -1.0]) / np.exp([0.0, 1.0, -1.0]).sum()
    mean = (shares * [1, 2, 4]).sum()
    deviation = np.sqrt((shares * (np.array([1, 2, 4]) - mean) ** 2).sum())
    found = expectation(scores, values)
    np.testing.assert_allclose([each.item() for each in found], [mean, deviation], rtol=1e-5)
    assert expectation(scores * 1000, values)[1].item() == pytest.approx(1e-5)


def test_compositing_follows_its_formula():
    """Share of a sample = its alpha times what passes those before it."""
    colours = torch.rand(1, 3, 3, generator=torch.Generator().manual_seed(1))
    density, depths = torch.tensor([[0.5, 2.0, 1.0]]), torch.tensor([[1.0, 2.0, 3.0]])
    alpha = 1 - np.exp(-density.numpy()[0].astype(float))
    shares = np.array([alpha[i] * np.prod(1 - alpha[:i]) for i in range(3)])
    mixed, depth = composite(colours, density, depths)
    np.testing.assert_allclose(mixed[0], shares @ colours[0].numpy(), atol=1e-6)
    np.testing.assert_allclose(depth, np.exp(shares) @ [1, 2, 3] / np.exp(shares).sum(), atol=1e-6)
