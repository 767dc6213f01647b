"""FWD: point splat, fusion and blocks against their formulas, weights, whole steps."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from scipy.spatial.transform import Rotation
from torch.nn import functional

from ggvs_eval.baselines.fwd.method import Fwd, halve, halved_camera, splat_points, warp_view
from ggvs_eval.baselines.fwd.network import (
    HEADS,
    KEY_WIDTH,
    VALUE_WIDTH,
    DepthCompletion,
    FwdNetwork,
    ResidualBlock,
    ViewFusion,
    direction_change,
    load_network,
)
from ggvs_eval.errors import RenderError
from ggvs_eval.method import SourceView
from helpers.geometry_scenes import random_camera
from helpers.refusals import refused
from helpers.scenes import camera_at, instant, look


def seeded(completes_depth=False):
    torch.manual_seed(5)
    return FwdNetwork(completes_depth=completes_depth).eval()


@pytest.fixture(scope="module", params=[False, True], ids=["given", "completed"])
def weights(request, tmp_path_factory):
    """Safetensors of a seeded network, without and with completion of depth."""
    path = tmp_path_factory.mktemp("fwd") / "fwd.safetensors"
    save_file(seeded(request.param).state_dict(), path)
    return path


def plain_splat(points, features, camera, near, radius, count):
    """Features and coverage by loops over pixels and points, from the definition."""
    blended = np.zeros((features.shape[1], camera.height, camera.width))
    light = np.ones((camera.height, camera.width))
    uv = points[:, :2] / points[:, 2:] * camera.K[[0, 1], [0, 1]] + camera.K[:2, 2]
    for row, column in np.ndindex(light.shape):
        square = ((uv - [column + 0.5, row + 0.5]) ** 2).sum(axis=1)
        covering = [
            i
            for i in np.argsort(points[:, 2], kind="stable")
            if square[i] < radius**2 and points[i, 2] > near
        ]
        for index in covering[:count]:
            alpha = 1 - np.sqrt(square[index] / radius**2)
            blended[:, row, column] += light[row, column] * alpha * features[index]
            light[row, column] *= 1 - alpha
    return blended, 1 - light


@pytest.mark.parametrize(("radius", "count"), [(1.5, 24), (1.5, 2), (2.2, 16), (0.4, 1)])
def test_points_are_discs_that_fade_to_their_rim(radius, count):
    """Features and coverage are those of a loop over pixels, for points inside, outside, behind and
    at equal depths.
    """
    random = np.random.default_rng(1)
    camera = random_camera(random, 23, 17)
    points = random.uniform((-1.2, -0.9, -0.2), (1.2, 0.9, 2.0), (400, 3))
    points[::7, 2] = 1.25
    features = random.normal(size=(400, 5))
    expected, coverage = plain_splat(points, features, camera, 0.3, radius, count)
    found = splat_points(
        torch.from_numpy(points), torch.from_numpy(features).float(), camera, 0.3, radius, count
    )
    np.testing.assert_allclose(found.features, expected, atol=1e-5)
    np.testing.assert_allclose(found.alpha, coverage, atol=1e-5)
    assert 0.02 < coverage.mean() < 1


def test_splatting_passes_gradients():
    """Features and positions of points receive finite gradients, so that the network can be trained
    through the splat.
    """
    random = np.random.default_rng(2)
    camera = random_camera(random, 20, 15)
    points = torch.from_numpy(
        random.uniform((-0.5, -0.5, 1), (0.5, 0.5, 2), (100, 3))
    ).requires_grad_()
    features = torch.from_numpy(random.normal(size=(100, 3))).float().requires_grad_()
    (splat_points(points, features, camera, 0.2).features ** 2).sum().backward()
    for gradient in (points.grad, features.grad):
        assert bool(torch.isfinite(gradient).all())
        assert bool((gradient != 0).any())


def plain_attention(fusion, pixel, seen):
    """One pixel's fused feature by loops over heads, from the definition; pixel is (K, C)."""
    mixed = []
    for head in range(HEADS):
        keys = slice(head * KEY_WIDTH, (head + 1) * KEY_WIDTH)
        values = slice(head * VALUE_WIDTH, (head + 1) * VALUE_WIDTH)
        query = fusion.query.weight[keys] @ fusion.token
        logits = torch.stack(
            [query @ (fusion.key.weight[keys] @ view) / KEY_WIDTH**0.5 for view in pixel[seen]]
        )
        shares = torch.softmax(logits, dim=0)
        mixed.append(
            sum(
                share * (fusion.value.weight[values] @ view)
                for share, view in zip(shares, pixel[seen], strict=True)
            )
        )
    return functional.layer_norm(
        fusion.out.weight @ torch.cat(mixed) + fusion.token, (pixel.shape[1],)
    )


def test_fusion_is_attention_over_the_views_that_show_something():
    """Each pixel is the attention of the token over its views; views without points there do not
    count.
    """
    torch.manual_seed(3)
    fusion = ViewFusion(64)
    features, alphas = torch.randn(3, 64, 2, 3), torch.rand(3, 2, 3) + 0.1
    alphas[1, 0, 0] = alphas[0, 1, 2] = 0
    with torch.inference_mode():
        found = fusion(features, alphas)
        for row, column in np.ndindex(2, 3):
            expected = plain_attention(
                fusion, features[:, :, row, column], alphas[:, row, column] > 0
            )
            torch.testing.assert_close(found[:, row, column], expected, atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize(("resampling", "size"), [("same", 6), ("up", 12), ("down", 3)])
def test_residual_block_follows_its_definition(resampling, size):
    """Normalised and rectified before each convolution, resampled once in the residual and once in
    the shortcut.
    """
    torch.manual_seed(6)
    block = ResidualBlock(3, 5, resampling).eval()
    features = torch.randn(1, 3, 6, 6)
    grow = (
        (lambda t: t.repeat_interleave(2, 2).repeat_interleave(2, 3))
        if resampling == "up"
        else (lambda t: t)
    )
    shrink = (
        (lambda t: t.view(1, -1, 3, 2, 3, 2).mean(dim=(3, 5)))
        if resampling == "down"
        else (lambda t: t)
    )
    scale = (1 + 1e-5) ** -0.5  # fresh running statistics
    first = functional.conv2d(
        grow(torch.relu(features * scale)), block.conv1.weight, block.conv1.bias, padding=1
    )
    second = functional.conv2d(
        torch.relu(first * scale), block.conv2.weight, block.conv2.bias, padding=1
    )
    shortcut = functional.conv2d(features, block.shortcut.weight, block.shortcut.bias)
    torch.testing.assert_close(
        block(features), shrink(second) + shrink(grow(shortcut)), atol=1e-5, rtol=1e-5
    )
    assert block(features).shape == (1, 5, size, size)


def test_direction_change_is_a_unit_difference_and_a_cosine():
    """Equal directions give (0, 0, 0, 1) whatever their length; perpendicular ones their difference
    of length 1 and 0.
    """
    source = torch.tensor([[0.0, 0.0, 2.0], [1.0, 0.0, 0.0]])
    target = torch.tensor([[0.0, 0.0, 5.0], [0.0, 3.0, 0.0]])
    half = 0.5**0.5
    expected = torch.tensor([[0.0, 0.0, 0.0, 1.0], [half, -half, 0.0, 0.0]])
    torch.testing.assert_close(direction_change(source, target), expected)


def test_half_the_size_is_the_same_view():
    """Halved image and depth are those of the halved camera; unknown depth is taken from its
    neighbours, an odd row repeated.
    """
    camera = camera_at(0.1, width=71, height=51)
    image, depth = look(camera)
    depth[::2, ::2] = 0
    depth[:2, :2] = 0
    half = halve(SourceView(camera, image, depth, np.ones_like(depth)))
    expected, expected_depth = look(half.camera)
    assert half.image.shape == (26, 36, 3)
    assert half.camera.size == (36, 26)
    off = np.abs(half.image - (expected.astype(np.float32) / 127.5 - 1)).max(axis=-1)[:-1, :-1]
    assert np.quantile(off, 0.9) < 0.03
    assert half.depth[0, 0] == 0
    assert (half.depth[1:-1, 1:-1] == expected_depth[1:-1, 1:-1]).mean() > 0.95


@pytest.mark.slow
def test_completion_gives_positive_depth_everywhere():
    """Whatever the size, inverse depth is above 0 and at most 1 as a share, also where none was
    known.
    """
    torch.manual_seed(7)
    completion = DepthCompletion().eval()
    with torch.inference_mode():
        completed = completion(torch.rand(1, 3, 30, 45) * 2 - 1, torch.zeros(1, 1, 30, 45))
    assert completed.shape == (1, 1, 30, 45)
    assert 0 < float(completed.min()) <= float(completed.max()) <= 1


@pytest.mark.slow
@pytest.mark.parametrize(("suffix", "completes_depth"), [("safetensors", True), ("pth", False)])
def test_weights_come_back_bit_for_bit(tmp_path, suffix, completes_depth):
    """A file of either kind, names behind ``module.`` or not, becomes the network it was, with or
    without completion.
    """
    network = seeded(completes_depth)
    path = tmp_path / f"fwd.{suffix}"
    if suffix == "safetensors":
        save_file(network.state_dict(), path)
    else:
        torch.save(
            {f"module.{name}": tensor for name, tensor in network.state_dict().items()}, path
        )
    loaded = load_network(path)
    assert not loaded.training
    assert (loaded.completion is not None) == completes_depth
    assert all(
        torch.equal(tensor, loaded.state_dict()[name])
        for name, tensor in network.state_dict().items()
    )


@pytest.mark.slow
@pytest.mark.parametrize("completes_depth", [pytest.param(False, marks=pytest.mark.proof), True])
def test_every_parameter_can_be_trained(completes_depth):
    """The error of a view reaches each parameter through decoder, fusion and splat, the
    completion's by the points' positions.
    """
    torch.manual_seed(8)
    network = FwdNetwork(completes_depth=completes_depth)
    moment = instant(0, camera_at(0.03, width=48, height=32), rig(2), depth_noise=0.01)
    target = halved_camera(moment.target, 4)
    views = [warp_view(network, halve(source), target, 0.2, 2.0) for source in moment.sources]
    decoded = network.decode(
        torch.stack([view.features for view in views]), torch.stack([view.alpha for view in views])
    )
    (decoded**2).mean().backward()
    without = [
        name
        for name, parameter in network.named_parameters()
        if parameter.grad is None or not parameter.grad.any()
    ]
    assert without == []
    assert all(bool(torch.isfinite(parameter.grad).all()) for parameter in network.parameters())


def rig(count):
    """Source cameras around a target, nearest first."""
    places = [(0.1, 0.0), (-0.2, 0.05), (0.35, -0.1), (-0.4, 0.2), (0.0, 0.5)][:count]
    return [camera_at(x, y, width=59, height=43) for x, y in places]


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, pytest.param(5, marks=pytest.mark.proof)])
def test_a_step_gives_an_image(weights, count):
    """A finite image of the target's odd size, in [0, 1], the same bits from a fresh object and
    whatever the threads.
    """
    moment = instant(3, camera_at(0.0, width=57, height=41), rig(count), square_x=0.4)
    first = Fwd(weights).step(moment)
    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    again = Fwd(weights).step(moment)
    torch.set_num_threads(threads)
    assert first.image.shape == (41, 57, 3)
    assert first.image.dtype == np.float32
    assert np.isfinite(first.image).all()
    assert 0 <= first.image.min() < first.image.max() <= 1
    assert not any(parameter.is_inference() for parameter in load_network(weights).parameters())
    np.testing.assert_array_equal(first.image, again.image)


@pytest.mark.slow
def test_neither_unit_nor_axes_of_the_world_matter(weights):
    """The same scene in a turned world of units four times as small gives the same image."""
    moment = instant(0, camera_at(0.05, width=56, height=40), rig(2))
    turn, factor = np.eye(4), 4.0
    turn[:3, :3] = Rotation.from_rotvec([0.4, -0.7, 0.3]).as_matrix()

    def moved(camera):
        world_to_camera = camera.world_to_camera @ turn
        world_to_camera[:3, 3] *= factor
        return replace(
            camera,
            world_to_camera=world_to_camera,
            near=camera.near * factor,
            far=camera.far * factor,
        )

    sources = tuple(
        replace(source, camera=moved(source.camera), depth=source.depth * np.float32(factor))
        for source in moment.sources
    )
    other = replace(
        moment,
        target=moved(moment.target),
        sources=sources,
        units_per_metre=moment.units_per_metre * factor,
    )
    off = np.abs(Fwd(weights).step(moment).image - Fwd(weights).step(other).image)
    assert np.quantile(off, 0.99) < 1e-3


def test_no_points_at_all_are_refused(tmp_path):
    """A view that may blend no point is refused in one line."""
    with refused(RenderError, "point per pixel", "got 0"):
        Fwd(tmp_path / "fwd.safetensors", points_per_pixel=0)


def test_unknown_depth_is_no_point(tmp_path):
    """A view without any depth adds nothing: the image is that of the other views."""
    save_file(seeded().state_dict(), tmp_path / "fwd.safetensors")
    moment = instant(0, camera_at(0.05, width=56, height=40), rig(3))
    blind = replace(moment.sources[1], depth=np.zeros_like(moment.sources[1].depth))
    method = Fwd(tmp_path / "fwd.safetensors")
    with_blind = method.step(replace(moment, sources=(moment.sources[0], blind, moment.sources[2])))
    without = method.step(replace(moment, sources=(moment.sources[0], moment.sources[2])))
    np.testing.assert_allclose(with_blind.image, without.image, atol=1e-5)
