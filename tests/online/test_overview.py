"""What blending knows before the network looks: one pass over the views against the maps' methods,
and the network's input.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ggvs_eval import kernels
from ggvs_eval.geometry.per_pixel import weighted_mean
from ggvs_eval.geometry.splat import COVERED_ALPHA
from ggvs_eval.kernels import _core
from ggvs_eval.pipelines.online.network_blender import overview
from ggvs_eval.pipelines.online.network_inputs import (
    channel_count,
    input_channels,
    network_channels,
    present_channels,
)
from helpers.blender_inputs import random_maps
from helpers.geometry_scenes import seeds
from helpers.refusals import refused

pytestmark = pytest.mark.usefixtures("kernel_settings")
MAPS = ("colours", "coverage", "visibilities", "alphas", "depths", "fused_depth")


@settings(deadline=None, max_examples=30)
@given(
    seeds,
    st.integers(1, 50),
    st.integers(1, 40),
    st.integers(1, 5),
    st.sampled_from((1, 2, 3, 4, 8)),
    st.integers(1, 3),
)
def test_one_pass_finds_what_the_maps_say(seed, width, height, views, scale, threads):
    """Any size, number of views and scale: the reduced maps, what is unseen, the mean picture and
    what is covered.
    """
    maps = random_maps(np.random.default_rng(seed), width, height, views)
    kernels.set_threads(threads)

    found = overview(maps, scale)

    expected = maps.reduced(scale)
    for name in MAPS:
        ours, theirs = np.asarray(getattr(found.small, name)), getattr(expected, name)
        np.testing.assert_allclose(ours, theirs, atol=1e-6, err_msg=name)
        assert ours.dtype == np.float32
    np.testing.assert_array_equal(found.small.target.K, expected.target.K)
    assert found.small.target.size == expected.target.size
    assert found.small.sources == maps.sources
    np.testing.assert_allclose(found.unseen, maps.unseen(), atol=1e-6)
    mean = weighted_mean(list(maps.colours), list(maps.coverage), maps.weights.tolist())
    np.testing.assert_allclose(found.picture, mean, atol=1e-6)
    np.testing.assert_array_equal(found.covered, np.max(maps.alphas, axis=0) > COVERED_ALPHA)


@settings(deadline=None, max_examples=30)
@given(
    seeds,
    st.integers(1, 50),
    st.integers(1, 40),
    st.integers(1, 4),
    st.sampled_from(("registered", "channels")),
)
def test_the_kernel_makes_the_channels(seed, width, height, views, guidance):
    """Every channel of the definition, zeros of absent views included, with holes in the surface
    and at any size.
    """
    maps = random_maps(np.random.default_rng(seed), width, height, views)
    maps.fused_depth[height // 2, width // 2] = 0
    found, expected = network_channels(maps, guidance, 5), input_channels(maps, guidance, 5)
    assert found.shape == expected.shape == (channel_count(5, guidance), height, width)
    np.testing.assert_allclose(found, expected, atol=2e-6, rtol=2e-6)


@pytest.mark.parametrize("guidance", ["registered", "channels", "none", "naive"])
def test_channels_of_views_that_are_there(guidance):
    """Of the channels of a network for five views, those of three are the ones that hold anything,
    in their order.
    """
    maps = random_maps(np.random.default_rng(3), 20, 10, 3)
    present, whole = present_channels(3, 5, guidance), input_channels(maps, guidance, 5)
    np.testing.assert_array_equal(whole[present], input_channels(maps, guidance))
    assert not np.delete(whole, present, axis=0).any()


def test_a_network_without_the_surface_gets_its_channels_too():
    """Where no fused depth guides there is no kernel: the definition itself."""
    maps = random_maps(np.random.default_rng(0), 30, 20, 3)
    np.testing.assert_array_equal(
        network_channels(maps, "none", 4), input_channels(maps, "none", 4)
    )


def test_nothing_known_of_the_surface():
    """A surface that is unknown everywhere is measured by the far plane, as in the definition."""
    maps = random_maps(np.random.default_rng(0), 30, 20, 3)
    maps = replace(maps, fused_depth=np.zeros_like(maps.fused_depth))
    np.testing.assert_allclose(
        network_channels(maps, "registered", 3), input_channels(maps, "registered", 3), atol=2e-6
    )


def test_what_does_not_fit_is_refused():
    """More views than the network takes, a scale of 0, maps of another size."""
    maps = random_maps(np.random.default_rng(2), 20, 10, 3)
    with refused(ValueError, "network takes"):
        network_channels(maps, "registered", 2)
    with pytest.raises(ValueError, match="scale of at least 1"):
        _core.overview(
            maps.colours,
            maps.coverage,
            maps.visibilities,
            maps.alphas,
            maps.depths,
            maps.weights,
            0,
            0.5,
            1,
            0,
        )
    with pytest.raises(TypeError, match="seen: wanted float32"):
        overview(replace(maps, visibilities=maps.visibilities[:, :5]), 2)
