"""What the blending network does at full size: each compiled kernel against the torch code that
defines it.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from ggvs_eval import kernels
from ggvs_eval.compute_device import one_thread
from ggvs_eval.kernels import _core
from ggvs_eval.pipelines.online.blend_network import (
    BEYOND_VIEWS,
    SURE,
    BlendNetwork,
    BlendNetworkShape,
    compose_tensors,
    read_outputs,
    small_outputs,
)
from ggvs_eval.pipelines.online.network_blender import (
    Composed,
    blend_by,
    blend_on,
    blend_start,
    composed,
    refined,
    statistics_of,
    view_shares,
)
from ggvs_eval.pipelines.online.network_inputs import GUIDED, BlendMaps, input_channels
from ggvs_eval.pipelines.online.refiner import COLOUR_GAIN, Refiner, evidence, picture_statistics
from helpers.blender_inputs import random_maps
from helpers.geometry_scenes import seeds

pytestmark = pytest.mark.usefixtures("kernel_settings")


@pytest.fixture(autouse=True)
def alone():
    """Small networks are faster with one thread."""
    with one_thread():
        yield


def random_network(config: BlendNetworkShape, width: int | None = None) -> BlendNetwork:
    """A seeded network whose outputs and filters do something; its refiner as wide as wanted."""
    torch.manual_seed(0)
    network = BlendNetwork(config).eval()
    if width is not None:
        network.refiner = Refiner(config.features, width).eval()
    torch.nn.init.normal_(network.unet.last.weight, std=0.5)
    if network.refiner is not None:
        torch.nn.init.normal_(network.refiner.taps.weight, std=0.3)
        torch.nn.init.normal_(network.refiner.condition.weight, std=0.05)
        torch.nn.init.normal_(network.refiner.condition.bias, std=0.2)
    return network


def as_tensors(maps: BlendMaps) -> dict[str, torch.Tensor]:
    colours = torch.from_numpy(maps.colours).permute(0, 3, 1, 2)[None]
    return {
        "colours": colours,
        "coverage": torch.from_numpy(maps.coverage)[None],
        "fused_depth": torch.from_numpy(maps.fused_depth)[None],
    }


def twin(network: BlendNetwork, maps: BlendMaps) -> np.ndarray:
    """The image that training would see, (H, W, 3)."""
    config, views = network.config, as_tensors(maps)
    channels = input_channels(maps.reduced(config.scale), config.guidance, config.views)
    start = {name: torch.from_numpy(array)[None] for name, array in blend_start(maps).items()}
    with torch.inference_mode():
        outputs = read_outputs(network(torch.from_numpy(channels)[None]), start, config.views)
        image = network.refine(
            compose_tensors(outputs, views["colours"], views["coverage"]), outputs, views
        )
    return image[0].clamp(0, 1).permute(1, 2, 0).numpy()


# the shipped one, sizes that the scale does not divide, several tiles, and sizes below a filter's
# reach
SHAPES = (
    (BlendNetworkShape(6, "registered", 4, 4, 8), None, (301, 131), 4),
    (BlendNetworkShape(6, "registered", 4, 4, 8), None, (143, 65), 2),
    (BlendNetworkShape(3, "channels", 4, 2, 3), 5, (37, 70), 3),
    (BlendNetworkShape(2, "naive", 4, 3, 1), 21, (40, 17), 1),
    (BlendNetworkShape(2, "none", 4, 1, 17), 8, (16, 16), 2),
    (BlendNetworkShape(4, "registered", 4, 4, 0), None, (30, 22), 3),
    (BlendNetworkShape(2, "registered", 4, 8, 2), None, (1, 5), 2),
    (BlendNetworkShape(2, "registered", 4, 2, 2), None, (1, 3), 2),
)


@pytest.mark.parametrize(("config", "width", "size", "views"), SHAPES)
def test_the_blender_makes_the_twins_image(config, width, size, views):
    """Every scale, guidance, number of views, features and width of a network, at any size: the
    torch code's image.
    """
    maps, network = (
        random_maps(np.random.default_rng(1), *size, views),
        random_network(config, width),
    )
    expected = twin(network, maps)
    np.testing.assert_allclose(blend_by(network, maps).image, expected, atol=2e-5)
    if network.refiner is not None and min(size) > 2:
        silent = random_network(config, width)
        torch.nn.init.zeros_(silent.refiner.taps.weight)
        torch.nn.init.zeros_(silent.refiner.taps.bias)
        # the refiner did something that could be wrong
        assert np.abs(twin(silent, maps) - expected).max() > 0.01


DEVICES = (
    "cpu",
    pytest.param(
        "cuda",
        marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="torch finds no GPU here"),
    ),
)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize(("config", "width", "size", "views"), SHAPES)
def test_torch_blends_on_a_device_as_the_kernels_do(config, width, size, views, device):
    """The path that a GPU takes gives the kernels' image, and the same shares of the views."""
    maps, network = (
        random_maps(np.random.default_rng(1), *size, views),
        random_network(config, width),
    )
    expected = blend_by(network, maps)
    found = blend_on(network.to(device), maps, torch.device(device))
    assert found.image.flags.c_contiguous
    assert found.image.dtype == found.weights.dtype == np.float32
    np.testing.assert_allclose(found.image, expected.image, atol=2e-5 if device == "cpu" else 5e-4)
    np.testing.assert_allclose(
        found.weights, expected.weights, atol=2e-5 if device == "cpu" else 5e-4
    )


@settings(deadline=None, max_examples=20)
@given(
    seeds, st.integers(1, 60), st.integers(1, 40), st.integers(1, 5), st.sampled_from((1, 2, 4, 8))
)
def test_outputs_are_composed_as_the_twin_does(seed, width, height, views, scale):
    """Any outputs of the network, decided ones too, give the twin's picture, spread of the views
    and number of them.

    At scales whose shares are exact: at others, where one view alone counts and covers nothing,
    their rounding decides.
    """
    random = np.random.default_rng(seed)
    maps, features = random_maps(random, width, height, views), 2
    # The twin knows the scale by the sizes, which tiny ones leave open.
    assume(-(-height // -(-height // scale)) == scale)
    raw = torch.from_numpy(
        random.normal(
            0, 20, (1, views + BEYOND_VIEWS + features, -(-height // scale), -(-width // scale))
        )
    )
    start = {name: torch.from_numpy(array)[None] for name, array in blend_start(maps).items()}
    outputs, tensors = read_outputs(raw, start, views), as_tensors(maps)
    small = small_outputs(raw, start["weights"], views)[0].contiguous().numpy()
    picture = compose_tensors(outputs, tensors["colours"], tensors["coverage"])
    shares = outputs.weights * tensors["coverage"]
    sure = evidence(
        picture, tensors["colours"], shares, tensors["coverage"], tensors["fused_depth"]
    )[0].numpy()
    background = np.ascontiguousarray(start["background"][0].permute(1, 2, 0).numpy())
    found = composed(maps, maps.unseen(), background, small, scale)
    np.testing.assert_allclose(found.picture, picture[0].numpy(), atol=1e-5)
    # The root makes much of weights near 0.
    np.testing.assert_allclose(np.clip(10 * found.spread, 0, 1), sure[0], atol=1e-3)
    np.testing.assert_allclose(np.clip(found.coverage / 3, 0, 1), sure[1], atol=1e-6)


@settings(deadline=None, max_examples=20)
@given(seeds, st.integers(1, 60), st.integers(1, 40), st.integers(1, 5), st.integers(0, 3))
def test_outputs_are_read_as_the_twin_does(seed, width, height, views, features):
    """Weights, changes, features and shares of any outputs, decided ones too, with the same bits
    whatever the instruction set.
    """
    random = np.random.default_rng(seed)
    maps, most = random_maps(random, width, height, views), views + 2
    raw = random.normal(0, 20, (most + BEYOND_VIEWS + features, height, width)).astype(np.float32)
    expected = small_outputs(
        torch.from_numpy(raw)[None], torch.from_numpy(maps.weights)[None], most
    )[0].numpy()
    found = []
    for level in range(len(kernels.available_levels())):
        arrays = np.log(maps.weights), maps.coverage, maps.visibilities
        found.append(_core.read_outputs(raw, *arrays, most, SURE, 2, level))
    for small, shares in found:
        np.testing.assert_allclose(small, expected, atol=2e-6)
        np.testing.assert_allclose(shares, view_shares(expected, maps), atol=1e-5)
        np.testing.assert_array_equal(small, found[0][0])
        np.testing.assert_array_equal(shares, found[0][1])


def refined_picture(refiner: Refiner, size: tuple[int, int]) -> np.ndarray:
    random = np.random.default_rng(2)
    maps, scale = random_maps(random, *size, 1), 4
    shape = size[1], size[0]
    picture = Composed(
        *(random.random(each, dtype=np.float32) for each in ((3, *shape), shape, shape))
    )
    small = random.random(
        (1 + BEYOND_VIEWS + 8, -(-shape[0] // scale), -(-shape[1] // scale)), dtype=np.float32
    )
    return refined(refiner, picture, maps.fused_depth, small, scale, 1)


def test_threads_and_instruction_sets_change_no_bit():
    """Any number of threads and every instruction set give the same bits."""
    refiner, images = random_network(BlendNetworkShape(features=8)).refiner, {}
    for level in kernels.available_levels():
        kernels.set_simd_level(level)
        alone, many = [], []
        for threads, into in ((1, alone), (3, many)):
            kernels.set_threads(threads)
            into.append(refined_picture(refiner, (290, 135)))
        np.testing.assert_array_equal(alone[0], many[0])
        images[level] = alone[0]
    for image in images.values():
        np.testing.assert_array_equal(image, images["baseline"])


def test_statistics_steer_the_filters():
    """A network with a condition makes another picture than one whose condition is zero."""
    network, maps = (
        random_network(BlendNetworkShape(2, "registered", 4, 4, 4)),
        random_maps(np.random.default_rng(4), 60, 44, 2),
    )
    steered = blend_by(network, maps).image
    for parameter in network.refiner.condition.parameters():
        torch.nn.init.zeros_(parameter)
    assert np.abs(blend_by(network, maps).image - steered).max() > 0.01


@settings(deadline=None, max_examples=20)
@given(seeds, st.integers(1, 60), st.integers(1, 40), st.floats(1e-4, 0.3))
def test_statistics_are_the_twins_to_the_last_bit(seed, width, height, noise):
    """By numpy beside the kernels or by torch: rounded, they are equal."""
    random = np.random.default_rng(seed)
    image = np.clip(0.5 + random.normal(0, noise, (3, height, width)), 0, 1).astype(np.float32)
    spread = np.abs(random.normal(0, noise, (height, width))).astype(np.float32)
    composed_picture = Composed(image, spread, np.ones_like(spread))
    twin_spread = (COLOUR_GAIN * torch.from_numpy(spread)[None]).clamp(-1, 1)
    expected = picture_statistics(torch.from_numpy(image)[None], twin_spread)[0].numpy()
    np.testing.assert_array_equal(statistics_of(composed_picture), expected)


def test_a_network_that_must_not_see_depth_does_not():
    """Without TSDF guidance the fused depth changes nothing, with it it does."""
    random = np.random.default_rng(3)
    for guidance in ("none", "channels"):
        network, maps = (
            random_network(BlendNetworkShape(2, guidance, 4, 1, 4)),
            random_maps(random, 33, 21, 2),
        )
        moved = replace(maps, fused_depth=np.roll(maps.fused_depth, 7, axis=1))
        assert np.array_equal(blend_by(network, maps).image, blend_by(network, moved).image) == (
            guidance not in GUIDED
        )
