"""The U-Net of the blending network: shapes, size, padding, what its normalisation does; its kernel
against torch.
"""

import numpy as np
import pytest
import torch
from torch.nn import functional

from ggvs_eval import kernels
from ggvs_eval.compute_device import one_thread
from ggvs_eval.pipelines.online.blend_network import UNet, unet_outputs

pytestmark = pytest.mark.usefixtures("kernel_settings")


@pytest.fixture(autouse=True)
def alone():
    """Small networks are faster with one thread, a hundred times so beside other work."""
    with one_thread():
        yield


def small_unet(inputs: int = 5, outputs: int = 3, width: int = 4) -> UNet:
    """A seeded network."""
    torch.manual_seed(0)
    return UNet(inputs, outputs, width).eval()


@pytest.mark.parametrize("size", [(1, 1), (32, 48), (33, 17), (70, 95)])
def test_any_size_comes_back(size):
    """Images whose sides are no multiples of 16, even single pixels, come out at their size and
    finite.
    """
    with torch.inference_mode():
        out = small_unet()(torch.rand(2, 5, *size))
    assert out.shape == (2, 3, *size)
    assert torch.isfinite(out).all()


def test_the_size_of_the_network_is_known():
    """The number of weights follows from the widths c, 2 c, 4 c, 8 c and 16 c; about 7.9 million
    for the paper's 37 inputs.
    """
    inputs, outputs, width = 37, 8, 32
    widths = [width * 2**level for level in range(5)]
    pairs = list(zip([inputs, *widths[:-1]], widths, strict=True)) + [
        (3 * each, each) for each in widths[:-1]
    ]
    convolutions = sum(9 * (before * after + after * after) + 2 * after for before, after in pairs)
    normalisations = sum(4 * after for _, after in pairs)
    expected = convolutions + normalisations + (width + 1) * outputs
    with torch.device("meta"):
        found = sum(parameter.numel() for parameter in UNet(inputs, outputs, width).parameters())
    assert found == expected
    assert round(expected / 1e6, 1) == 7.9


def test_padding_repeats_the_border():
    """An image of 40 x 60 gives what the same image with its border repeated to 48 x 64 gives, cut
    out again.
    """
    network, image = small_unet(), torch.rand(1, 5, 40, 60)
    with torch.inference_mode():
        around = network(functional.pad(image, (2, 2, 4, 4), mode="replicate"))
        assert torch.equal(network(image), around[..., 4:44, 2:62])


def restless_unet(inputs: int, outputs: int, width: int) -> UNet:
    """A seeded network whose normalisations change something, too."""
    network = small_unet(inputs, outputs, width)
    for module in network.modules():
        if isinstance(module, torch.nn.GroupNorm):
            torch.nn.init.normal_(module.weight, 1.0, 0.2)
            torch.nn.init.normal_(module.bias, 0.0, 0.2)
    return network


def channels_of(inputs: int, height: int, width: int) -> np.ndarray:
    return np.random.default_rng(height).normal(size=(inputs, height, width)).astype(np.float32)


@pytest.mark.parametrize("level", kernels.available_levels())
@pytest.mark.parametrize(
    ("size", "layout"),
    [
        ((1, 1), (5, 3, 4)),
        ((33, 17), (7, 9, 1)),
        ((38, 51), (61, 18, 16)),
        ((16, 352), (9, 10, 12)),
    ],
)
def test_the_kernel_is_the_network(size, layout, level):
    """Any size, number of channels and width give what torch gives, to rounding, with every
    instruction set.
    """
    network, channels = restless_unet(*layout), channels_of(layout[0], *size)
    kernels.set_simd_level(level)
    with torch.inference_mode():
        expected = network(torch.from_numpy(channels)[None])[0].numpy()
    found = unet_outputs(network, channels)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, expected, atol=2e-5, rtol=2e-5)


def test_threads_instruction_sets_and_layout_give_the_same_bits():
    """Nor do threads or vectors with fused multiply-adds change a bit, nor the order in which the
    weights lie in memory.
    """
    network, channels = restless_unet(13, 6, 8), channels_of(13, 40, 70)
    first = unet_outputs(network, channels)
    for level in kernels.available_levels()[1:]:
        kernels.set_simd_level(level)
        for threads in (1, 3, 7):
            kernels.set_threads(threads)
            np.testing.assert_array_equal(unet_outputs(network, channels), first)
    network = network.to(memory_format=torch.channels_last)
    np.testing.assert_array_equal(unet_outputs(network, channels), first)


def test_channels_that_are_not_given_are_zeros():
    """Leaving channels out is the same bits as filling them with zeros."""
    network, channels, given = (
        restless_unet(9, 6, 8),
        channels_of(9, 40, 33),
        np.array([0, 1, 4, 7]),
    )
    zeros = np.zeros_like(channels)
    zeros[given] = channels[given]
    np.testing.assert_array_equal(
        unet_outputs(network, channels[given], given), unet_outputs(network, zeros)
    )


def test_weights_that_change_count():
    """Filters are packed once, but anew when somebody has written the weights, moved them or left
    other channels out.
    """
    network, channels = restless_unet(5, 3, 4), channels_of(5, 20, 20)
    first = unet_outputs(network, channels)
    with torch.no_grad():
        network.up[3][3].weight *= 1.5
    changed = unet_outputs(network, channels)
    assert not np.array_equal(changed, first)
    assert not np.array_equal(unet_outputs(network, channels[1:], np.arange(1, 5)), changed)
    network.load_state_dict({name: 2 * values for name, values in network.state_dict().items()})
    with torch.inference_mode():
        expected = network(torch.from_numpy(channels)[None])[0].numpy()
    np.testing.assert_allclose(unet_outputs(network, channels), expected, atol=1e-3)


def test_channels_of_another_number_are_refused():
    """Channels that the first layer does not take are a TypeError, not memory read beyond
    its end.
    """
    with pytest.raises(TypeError, match="filters: wanted float32"):
        unet_outputs(small_unet(), channels_of(4, 20, 20))
