"""IBRNet: names and shapes of the published checkpoint, outputs equal to the authors', and the
method as a whole.
"""

import copy
import json
from dataclasses import fields, replace

import numpy as np
import pytest
import torch

from ggvs_eval import kernels
from ggvs_eval.baselines.ibrnet.method import IBRNet
from ggvs_eval.baselines.ibrnet.network import PARTS, Networks, load_ibrnet
from ggvs_eval.baselines.ibrnet.rendering import (
    SeenView,
    _shade,
    depth_range,
    packed_layers,
    projection_of,
    render_rays,
)
from ggvs_eval.compute_device import one_thread
from ggvs_eval.errors import RenderError
from ggvs_eval.kernels import _core
from helpers.places import DATA_FOLDER
from helpers.refusals import refused
from helpers.seeded_baselines import seed_weights, turned_rig


@pytest.fixture(scope="module")
def networks():
    """The networks with seeded weights, thin enough that a ray passes many samples."""
    seeded = seed_weights(Networks()).requires_grad_(False)
    for network in (seeded.net_coarse, seeded.net_fine):
        for parameter in network.out_geometry_fc[2].parameters():
            parameter.mul_(0.05)
    return seeded


@pytest.fixture(scope="module")
def weights(networks, tmp_path_factory):
    path = tmp_path_factory.mktemp("ibrnet") / "model_255000.pth"
    torch.save(
        {
            **{part: networks.get_submodule(part).state_dict() for part in PARTS},
            "optimizer": {"state": {}},
        },
        path,
    )
    return path


@pytest.fixture(scope="module")
def golden():
    """Outputs of the authors' code on the same weights (tests/data/IBRNET_ENERF_ORACLES.md)."""
    return np.load(DATA_FOLDER / "ibrnet_golden.npz")


@pytest.fixture(autouse=True)
def single_thread():
    """Small tensors; more threads would only wait for each other."""
    with one_thread():
        yield


def as_tensor(image):
    """(H, W, 3) uint8 to (1, 3, H, W) in [0, 1]."""
    return torch.from_numpy(image).permute(2, 0, 1)[None].float() / 255


def see(networks, source):
    """A source view as the renderer takes it."""
    image = as_tensor(source.image)
    coarse, fine = networks.feature_net(image)
    return SeenView(
        image[0],
        coarse[0],
        fine[0],
        projection_of(source.camera),
        torch.from_numpy(source.camera.centre).float(),
    )


def small_target(views):
    """A rig whose target has fewer pixels than its sources."""
    instant = turned_rig(views, 44, 36)
    return replace(instant, target=instant.target.resized(18, 12))


def test_names_and_shapes_are_those_of_the_checkpoint():
    """Every parameter of the authors' three networks exists under its name with its shape, and no
    other.
    """
    oracle = json.loads((DATA_FOLDER / "ibrnet_state_dict.json").read_text())
    networks = Networks()
    for part in PARTS:
        wanted = oracle["feature_net" if part == "feature_net" else "net_coarse/net_fine"]
        network = networks.get_submodule(part)
        assert {name: list(tensor.shape) for name, tensor in network.state_dict().items()} == wanted
        count = oracle["n_params"]["feature_net" if part == "feature_net" else "net"]
        assert sum(parameter.numel() for parameter in network.parameters()) == count


def test_features_are_the_authors(networks, golden):
    """Features of even and of odd image sizes agree with the authors' to 1e-4."""
    sources = turned_rig(3).sources
    coarse, _ = networks.feature_net(as_tensor(sources[0].image))
    _, fine = networks.feature_net(as_tensor(sources[1].image))
    odd, _ = networks.feature_net(as_tensor(sources[0].image[:57, :90]))
    np.testing.assert_allclose(coarse[0, :, ::3, ::3], golden["features_coarse"], atol=1e-4)
    np.testing.assert_allclose(fine[0, :, ::3, ::3], golden["features_fine"], atol=1e-4)
    np.testing.assert_allclose(odd[0, ::4], golden["features_odd"], atol=1e-4)


def test_the_ray_network_is_the_authors(networks, golden):
    """Colours and densities of random samples agree, samples that one view or none sees
    included.
    """
    rng = np.random.default_rng(3)
    seen = torch.from_numpy(rng.uniform(0, 1, (4, 10, 5, 35))).float()
    differences = rng.normal(size=(4, 10, 5, 3))
    differences /= np.linalg.norm(differences, axis=-1, keepdims=True)
    directions = torch.from_numpy(
        np.concatenate([differences, rng.uniform(0.5, 1, (4, 10, 5, 1))], axis=-1)
    ).float()
    visible = torch.from_numpy(rng.uniform(size=(4, 10, 5, 1)) > 0.6)
    visible[1, :4] = False
    colours, density = networks.net_coarse(seen, directions, visible)
    np.testing.assert_allclose(colours, golden["network"][..., :3], atol=1e-5)
    np.testing.assert_allclose(density, golden["network"][..., 3], atol=1e-5)


def test_rendered_rays_are_the_authors(networks, golden):
    """Two passes over every 37th ray of a turned rig agree with the authors' to 1e-4 in colour, in
    depth where it is opaque.
    """
    instant = turned_rig(3)
    views = [see(networks, source) for source in instant.sources]
    rays = torch.from_numpy(instant.target.rays().reshape(-1, 3)[::37]).float()
    centre = torch.from_numpy(instant.target.centre).float()
    colours, depth = render_rays(networks, views, centre, rays, *depth_range(instant))
    np.testing.assert_allclose(colours, golden["fine_rgb"], atol=1e-4)
    opaque = golden["opacity"] >= 0.5
    assert opaque.sum() > 50
    np.testing.assert_allclose(
        depth[opaque], (golden["fine_depth"] / golden["opacity"].clip(1e-10))[opaque], atol=1e-3
    )
    assert (depth[golden["opacity"] < 0.499] == 0).all()


def test_a_published_checkpoint_loads_strictly(networks, weights, tmp_path):
    """A file in the authors' format, with and without ``module.``, becomes the networks, bit for
    bit.
    """
    parallel = {
        part: {
            f"module.{name}": tensor
            for name, tensor in networks.get_submodule(part).state_dict().items()
        }
        for part in PARTS
    }
    torch.save(parallel, tmp_path / "parallel.pth")
    for path in (weights, tmp_path / "parallel.pth"):
        loaded = load_ibrnet(path).state_dict()
        assert all(
            torch.equal(tensor, loaded[name]) for name, tensor in networks.state_dict().items()
        )


@pytest.mark.parametrize("views", [2, pytest.param(5, marks=pytest.mark.slow)])
def test_a_step_gives_a_picture(weights, views):
    """Of any number of views from two: finite, of the target's size, not flat, in [0, 1]; depth
    within the range or 0.
    """
    instant = small_target(views)
    rendering = IBRNet(weights).step(instant)
    assert rendering.image.shape == (12, 18, 3)
    assert rendering.image.dtype == np.float32
    assert rendering.image.min() >= 0
    assert rendering.image.max() <= 1
    assert rendering.image.std() > 0.02
    near, far = depth_range(instant)
    assert (
        (rendering.depth == 0) | ((rendering.depth >= near) & (rendering.depth <= far * 1.001))
    ).all()
    assert set(rendering.seconds) == {"features", "rays"}


@pytest.mark.slow
@pytest.mark.usefixtures("torch_threads")
def test_a_step_is_the_same_again(weights):
    """Equal bits from a second object and with another number of threads, close ones with other
    chunks.
    """
    instant = small_target(2)
    first = IBRNet(weights).step(instant).image
    threads = kernels.get_threads()
    torch.set_num_threads(2)
    kernels.set_threads(3 - min(threads, 2))
    try:
        assert np.array_equal(IBRNet(weights).step(instant).image, first)
    finally:
        kernels.set_threads(threads)
    assert torch.get_num_threads() == 2
    np.testing.assert_allclose(
        IBRNet(weights, rays_per_chunk=101).step(instant).image, first, atol=1e-5
    )


def test_too_little_to_see_is_refused(weights):
    """One view, or an image too small for the features, is refused with what to do."""
    method, instant = IBRNet(weights), turned_rig(2, 44, 30)
    with refused(RenderError, "camera cam0", "33 pixels", "44 x 30"):
        method.step(instant)
    with refused(RenderError, "2 source views", "got 1"):
        method.step(replace(instant, sources=instant.sources[:1]))


@pytest.fixture
def shaded(networks):
    """Two rays' worth of samples, near ones that no view sees included, through a network that
    nobody trains or somebody does.
    """
    instant = turned_rig(3)
    views = [see(networks, source) for source in instant.sources]
    rays = torch.from_numpy(instant.target.rays().reshape(-1, 3)[::29]).float()
    near, far = depth_range(instant)
    depths = torch.linspace(0.02 * near, far, 21).expand(len(rays), -1)
    centre = torch.from_numpy(instant.target.centre).float()

    def shade(
        with_gradients: bool, dtype: torch.dtype = torch.float32
    ) -> tuple[torch.Tensor, torch.Tensor]:
        network = copy.deepcopy(networks.net_fine).to(dtype).requires_grad_(with_gradients)
        seen = [
            SeenView(*(getattr(view, field.name).to(dtype) for field in fields(SeenView)))
            for view in views
        ]
        return _shade(network, seen, "fine", *(each.to(dtype) for each in (centre, rays, depths)))

    return shade


def test_the_kernel_is_the_network(shaded):
    """What nobody wants gradients of comes from a compiled pass, as near to the network in double
    precision as torch comes.
    """
    exact, of_torch, compiled = shaded(True, torch.float64), shaded(True), shaded(False)
    assert of_torch[1].requires_grad
    assert not compiled[1].requires_grad
    # samples that no view sees are among them
    assert 0 < (compiled[1] == 0).sum() < compiled[1].numel()
    for wanted, theirs, ours in zip(exact, of_torch, compiled, strict=True):
        rounding = (theirs - wanted).abs().detach()
        assert (ours - wanted).abs().mean() < 1.5 * rounding.mean() < 1e-5
        assert (ours - wanted).abs().max() < 2 * rounding.max()


def test_vectors_of_any_size_agree(shaded):
    """Every instruction set gives the same bits."""
    best, by_level = kernels.get_simd_level(), {}
    try:
        for level in kernels.available_levels():
            kernels.set_simd_level(level)
            by_level[level] = shaded(with_gradients=False)
    finally:
        kernels.set_simd_level(best)
    assert all(
        torch.equal(*pair)
        for other in by_level.values()
        for pair in zip(other, by_level["baseline"], strict=True)
    )


def test_the_kernel_takes_what_fits_alone(networks):
    """Arrays of another shape or type are refused by name, before anything is read."""
    image, features = np.zeros((8, 9, 3), np.float32), np.zeros((4, 5, 32), np.float32)
    view = (image, features, np.zeros((3, 4), np.float32), np.zeros(3, np.float32))
    good = {
        "layers": packed_layers(networks.net_fine),
        "norm": np.ones((2, 16), np.float32),
        "closeness": 0.2,
        "views": [view],
        "centre": np.zeros(3, np.float32),
        "rays": np.zeros((2, 3), np.float32),
        "depths": np.ones((2, 5), np.float32),
        "places": np.zeros((5, 16), np.float32),
        "level": 0,
    }
    cases = {
        "20 layers": {"layers": good["layers"][:3]},
        "at least one view": {"views": []},
        "features: wanted float32": {"views": [(image, features[..., :31].copy(), *view[2:])]},
        "rays: wanted float32": {"rays": np.zeros((3, 3), np.float32)},
        "depths: wanted float32": {"depths": np.ones((2, 5))},
        "places: wanted float32": {"places": np.zeros((4, 16), np.float32)},
    }
    assert _core.pool_views(**good)[0].shape == (2, 5, 3)
    for message, wrong in cases.items():
        with pytest.raises((TypeError, ValueError), match=message):
            _core.pool_views(**{**good, **wrong})
