"""MVSplat: names and shapes of the published checkpoint, outputs equal to the authors', and the
method as a whole.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from ggvs_eval.compute_device import one_thread
from ggvs_eval.contrib.more_baselines.mvsplat.backbone import window_blocks
from ggvs_eval.contrib.more_baselines.mvsplat.gaussians import pixel_cloud
from ggvs_eval.contrib.more_baselines.mvsplat.method import Mvsplat, instant_cloud
from ggvs_eval.contrib.more_baselines.mvsplat.network import MvsplatNetwork, load_network
from ggvs_eval.contrib.more_baselines.mvsplat.views import see_views
from ggvs_eval.contrib.training.instant_samples import InstantSample
from ggvs_eval.contrib.training.recipes.mvsplat import DEPTH_STEPS, MvsplatRecipe
from ggvs_eval.errors import RenderError
from ggvs_eval.files.weights_file import CONFIGURATION_NOTE
from ggvs_eval.gaussians.torch_splat import rotations
from helpers.places import DATA_FOLDER
from helpers.refusals import refused
from helpers.scenes import look
from helpers.seeded_baselines import seed_weights, turned_rig

NEAR, FAR = 2.0, 8.0  # of the golden outputs


def gentle(network):
    """Seeded weights with softmaxes that are not all or nothing, and depth that stays within its
    range.
    """
    with torch.no_grad():
        for name, parameter in network.named_parameters():
            if name.endswith("q_proj.weight"):
                parameter *= 0.03
        network.depth_predictor.depth_head_lowres[2].weight *= 0.1
        for parameter in network.depth_predictor.to_disparity[2].parameters():
            parameter[0] *= 0.02
    return network


@pytest.fixture(scope="module")
def full():
    return gentle(seed_weights(MvsplatNetwork())).requires_grad_(False)


@pytest.fixture(scope="module")
def compact():
    """Ours with random weights, all parts of it awake."""
    return gentle(seed_weights(MvsplatNetwork("compact"))).requires_grad_(False)


@pytest.fixture(scope="module")
def weights(compact, tmp_path_factory):
    from safetensors.torch import save_file

    path = tmp_path_factory.mktemp("mvsplat") / "mvsplat.safetensors"
    save_file(compact.state_dict(), path, {CONFIGURATION_NOTE: "compact"})
    return path


@pytest.fixture(scope="module")
def golden():
    """Outputs of the authors' code on the same weights (tests/data/MVSPLAT_ORACLES.md)."""
    return np.load(DATA_FOLDER / "mvsplat_golden.npz")


@pytest.fixture(autouse=True)
def single_thread():
    """Small tensors; more threads would only wait for each other."""
    with one_thread():
        yield


def golden_views(count):
    """The rig of the golden outputs as the authors' code was given it: depth range 2 to 8, lengths
    as they are.
    """
    instant = turned_rig(count)
    cameras = [source.camera for source in instant.sources]
    return replace(
        see_views(instant, 16),
        camera_to_world=np.stack([np.linalg.inv(camera.world_to_camera) for camera in cameras]),
        near=NEAR,
        far=FAR,
        unit=1.0,
    )


def close(ours, theirs):
    """To 1e-4, relative where values are above one."""
    np.testing.assert_allclose(ours, theirs, atol=1e-4, rtol=1e-4)


def test_names_and_shapes_are_those_of_the_checkpoint():
    """Every parameter of the authors' network exists under its name with its shape, and no other:
    11,955,734 numbers.
    """
    oracle = json.loads((DATA_FOLDER / "mvsplat_state_dict.json").read_text())
    with torch.device("meta"):
        network = MvsplatNetwork()
    assert {
        f"encoder.{name}": list(tensor.shape) for name, tensor in network.state_dict().items()
    } == oracle["net"]
    assert (
        sum(parameter.numel() for parameter in network.parameters())
        == oracle["n_params"]
        == 11_955_734
    )


@pytest.mark.slow
def test_gaussians_are_the_authors(full, golden):
    """Features, depth, and the Gaussians of two views, in their own conventions, agree with the
    authors' to 1e-4.
    """
    views = golden_views(2)
    together, alone = full.backbone(views.images, None)
    close(alone[:, ::8, ::2, ::2], golden["alone"])
    close(together[:, ::8, ::2, ::2], golden["together"])
    pixels = full.depth_predictor(together, alone, views)
    close(1 / pixels.disparity.flatten()[::7], golden["depth"])
    cloud = pixel_cloud(pixels, views, published=True)
    close(cloud.means[::7], golden["means"])
    close(cloud.log_scales.exp()[::7], golden["scales"])
    close(cloud.opacity_logits.sigmoid()[::7], golden["opacities"])
    axes = rotations(cloud.quaternions[::37]) * cloud.log_scales[::37].exp()[:, None]
    # they are small
    np.testing.assert_allclose(axes @ axes.transpose(1, 2), golden["covariances"], atol=2e-6)
    close(cloud.sh.transpose(1, 2)[::61], golden["harmonics"])
    assert golden["depth"].std() > 1
    assert golden["opacities"].std() > 0.05
    assert golden["harmonics"][..., 9:].std() > 1e-4


@pytest.mark.slow
def test_depth_of_three_views_is_the_authors(full, golden):
    """With more than two views attention and cost volumes see all others; their mask put into the
    order of its keys.
    """
    close(1 / full(golden_views(3)).disparity.flatten()[::11], golden["depth_of_three"])


@pytest.mark.slow
def test_a_published_checkpoint_loads_strictly(full, tmp_path):
    """A file in the authors' format becomes the network, bit for bit."""
    names = {f"encoder.{name}": tensor for name, tensor in full.state_dict().items()}
    torch.save(
        {
            "state_dict": names,
            "epoch": 3,
            "global_step": 300000,
            "optimizer_states": [{"lr": 2e-4}],
        },
        tmp_path / "re10k.ckpt",
    )
    network = load_network(tmp_path / "re10k.ckpt")
    assert network.configuration == "full"
    assert all(
        torch.equal(tensor, network.state_dict()[name])
        for name, tensor in full.state_dict().items()
    )


@pytest.mark.parametrize("count", [2, 3])
def test_a_step_gives_a_picture(weights, count):
    """Of any number of views from two, of odd and different sizes: finite, of the target's size,
    not flat, in [0, 1].
    """
    instant = turned_rig(count, 44, 36)
    first, *others = instant.sources
    cut = {
        name: np.ascontiguousarray(getattr(first, name)[:30])
        for name in ("image", "depth", "confidence")
    }
    first = replace(first, camera=first.camera.cropped(0, 0, first.camera.width, 30), **cut)
    instant = replace(instant, target=instant.target.resized(38, 50), sources=(first, *others))
    rendering = Mvsplat(weights).step(instant)
    assert rendering.image.shape == (50, 38, 3)
    assert rendering.image.dtype == np.float32
    assert rendering.image.min() >= 0
    assert rendering.image.max() <= 1
    assert rendering.image.std() > 0.02
    assert rendering.depth.max() > instant.near_plane
    assert set(rendering.seconds) == {"network", "splat"}


@pytest.mark.usefixtures("torch_threads")
def test_a_step_is_the_same_again(weights):
    """Equal bits from a second object, with another number of threads, and whatever the depth maps
    say.
    """
    instant = turned_rig(3, 44, 36)
    first = Mvsplat(weights).step(instant).image
    torch.set_num_threads(2)
    sources = tuple(
        replace(source, depth=np.zeros_like(source.depth)) for source in instant.sources
    )
    assert np.array_equal(Mvsplat(weights).step(replace(instant, sources=sources)).image, first)
    assert torch.get_num_threads() == 2


def moved(instant, motion, scale=1.0):
    """The same rig and scene after a rigid motion of the world (4, 4), in other units of length."""

    def carried(camera):
        world_to_camera = camera.world_to_camera @ np.linalg.inv(motion)
        world_to_camera[:3, 3] *= scale
        return replace(
            camera,
            world_to_camera=world_to_camera,
            near=scale * camera.near,
            far=scale * camera.far,
        )

    sources = tuple(replace(source, camera=carried(source.camera)) for source in instant.sources)
    return replace(
        instant,
        target=carried(instant.target),
        sources=sources,
        units_per_metre=scale * instant.units_per_metre,
    )


@pytest.mark.slow
def test_a_rotated_rig_sees_the_same(compact, weights):
    """Turned, moved, and measured in other units, the world gives the same picture: harmonics turn
    with the cameras.
    """
    instant = turned_rig(2, 44, 36)
    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_euler("xyz", [1.0, -0.7, 2.0]).as_matrix()
    motion[:3, 3] = (0.5, -1.0, 2.0)
    once, again = (
        Mvsplat(weights).step(instant),
        Mvsplat(weights).step(moved(instant, motion, scale=10.0)),
    )
    assert once.image.std() > 0.02
    np.testing.assert_allclose(again.image, once.image, atol=2e-3)
    np.testing.assert_allclose(again.depth / 10, once.depth, rtol=1e-3, atol=1e-3)
    turned_sh = instant_cloud(compact, moved(instant, motion)).sh[:, 1:]
    # or the test would say nothing
    assert float((turned_sh - instant_cloud(compact, instant).sh[:, 1:]).abs().max()) > 0.01


def test_a_principal_point_off_the_middle_is_kept(weights):
    """A target whose window is cut out of a larger image shows that part of it."""
    instant = turned_rig(2, 44, 36)
    whole = Mvsplat(weights).step(instant).image
    part = (
        Mvsplat(weights).step(replace(instant, target=instant.target.cropped(10, 6, 24, 20))).image
    )
    # Gaussians beyond a border are projected as if at it
    np.testing.assert_allclose(part, whole[6:26, 10:34], atol=5e-3)
    assert np.abs(whole[6:26, 10:34] - whole[8:28, 10:34]).max() > 0.1


def test_one_view_is_refused(weights):
    """Nothing to compare it with: said with what is wanted."""
    instant = turned_rig(2, 44, 36)
    with refused(RenderError, "MVSplat", "2 source views", "got 1", "raise k"):
        Mvsplat(weights).step(replace(instant, sources=instant.sources[:1]))


@pytest.mark.slow
def test_depth_is_taught_first_then_pictures():
    """At first the loss is that of coarse depth, and the heads stay as they were; later a step on
    the whole loss lowers it.
    """
    instant = turned_rig(2, 48, 40)
    sample = InstantSample(instant, look(instant.target)[0])
    recipe = MvsplatRecipe()
    torch.manual_seed(1)
    network = recipe.network().train()
    early, terms = recipe.sample_loss(network, sample, 0)
    early.backward()
    assert early.item() == terms["disparity_loss"].item() > 0
    assert network.backbone.backbone.conv1.weight.grad.abs().max() > 0
    assert network.depth_predictor.to_gaussians[0].weight.grad is None
    optimiser = torch.optim.Adam(network.parameters(), 1e-3)
    losses = []
    for _ in range(3):
        loss, terms = recipe.sample_loss(network, sample, DEPTH_STEPS)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
    assert losses[-1] < losses[0]
    weights = {"squared_loss": 1, "ssim_loss": 0.05, "disparity_loss": 0.3}
    assert loss.item() == pytest.approx(
        sum(weight * terms[name].item() for name, weight in weights.items())
    )
    assert network.depth_predictor.to_gaussians[0].weight.grad.abs().max() > 0


@pytest.mark.parametrize(
    ("height", "width", "window"), [(16, 24, (8, 12)), (24, 16, (8, 8)), (9, 6, (3, 6))]
)
@pytest.mark.parametrize("shifted", [False, True])
def test_windows_cover_every_cell_once(height, width, window, shifted):
    """No window is larger than it may be; those that are moved by half a window meet the others'
    middles.
    """
    covered = np.zeros((height, width), int)
    for rows, columns, down, right in window_blocks(height, width, window, shifted):
        stretch = covered[rows, columns]
        stretch += 1
        assert stretch.shape[0] % down == stretch.shape[1] % right == 0
        assert stretch.shape[0] // down <= window[0]
        assert stretch.shape[1] // right <= window[1]
        if shifted:
            assert rows.start in (0, window[0] // 2) or rows.start > window[0]
    assert (covered == 1).all()
