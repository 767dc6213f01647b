"""Compiled features of frames: against torch's convolutions and the definition of LPIPS'
distance.
"""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from torch.nn import functional

from ggvs_eval import kernels
from ggvs_eval.compute_device import one_thread
from ggvs_eval.kernels import SIMD_LEVELS, _features
from helpers.geometry_scenes import seeds

pytestmark = pytest.mark.usefixtures("kernel_settings")


@pytest.fixture(autouse=True)
def alone():
    with one_thread():
        yield


def drawn(seed: int, *shape: int) -> np.ndarray:
    """Normal numbers, float32."""
    return np.random.default_rng(seed).standard_normal(shape).astype(np.float32)


def drawn_layers(sizes=((3, 64, False), (64, 64, True), (64, 128, False), (128, 64, True))):
    """Filters (after, before, 3, 3) that keep the size of what they filter, biases, and which are
    tapped.
    """
    return [
        (
            drawn(2 * n, after, before, 3, 3) / np.sqrt(4.5 * before).astype(np.float32),
            0.1 * drawn(2 * n + 1, after),
            tap,
        )
        for n, (before, after, tap) in enumerate(sizes)
    ]


def packed(layers):
    return [(_features.pack_filters(weights, 2), bias, tap) for weights, bias, tap in layers]


def torch_maps(frame: np.ndarray, layers) -> list[np.ndarray]:
    """The definition: convolutions with zeros around, ReLU, and maxima of 2 x 2 behind what is
    tapped, in float64.
    """
    maps, features = [], torch.from_numpy(frame).double().permute(2, 0, 1)[None]
    for n, (weights, bias, tap) in enumerate(layers):
        features = functional.max_pool2d(features, 2) if n and layers[n - 1][2] else features
        features = functional.conv2d(
            features, torch.from_numpy(weights).double(), torch.from_numpy(bias).double(), 1, 1
        ).relu_()
        if tap:
            maps.append(features[0].permute(1, 2, 0).numpy())
    return maps


@pytest.mark.parametrize("size", [(2, 2), (3, 5), (21, 34)])
def test_features_are_those_of_torch(size):
    """Sizes that tiles of four and halvings divide or not, down to one pixel: within 1e-5 of the
    largest feature.
    """
    frame, layers = drawn(99, *size, 3), drawn_layers()

    found = _features.feature_maps(
        frame, packed(layers), 2, SIMD_LEVELS.index(kernels.get_simd_level())
    )

    for ours, theirs in zip(found, torch_maps(frame, layers), strict=True):
        assert ours.shape == theirs.shape
        assert np.abs(ours - theirs).max() <= 1e-5 * np.abs(theirs).max()


def test_layers_go_on_from_features():
    """A block by itself, fed with what the one before hands on, has the bits of both in one
    call.
    """
    frame, layers = drawn(5, 22, 30, 3), packed(drawn_layers())
    level = SIMD_LEVELS.index(kernels.get_simd_level())
    first, second = _features.feature_maps(frame, layers, 1, level)
    halved = first.reshape(11, 2, 15, 2, 64).max(axis=(1, 3))

    assert np.array_equal(_features.feature_maps(frame, layers[:2], 1, level)[0], first)
    assert np.array_equal(
        _features.feature_maps(np.ascontiguousarray(halved), layers[2:], 1, level)[0], second
    )


def test_bits_are_equal_for_all_threads_and_instruction_sets():
    """More tiles than a block holds, on one thread and three."""
    frame, layers = drawn(1, 37, 45, 3), packed(drawn_layers())
    ours, theirs, weights = drawn(2, 37, 45, 64), drawn(3, 37, 45, 64), np.abs(drawn(4, 64))
    wanted = _features.feature_maps(frame, layers, 1, 0)
    distances = _features.compare_features(ours, theirs, weights, 1, 0)

    for level in range(len(kernels.available_levels())):
        for threads in (1, 3):
            found = _features.feature_maps(frame, layers, threads, level)
            assert all(np.array_equal(one, other) for one, other in zip(found, wanted, strict=True))
            assert np.array_equal(
                _features.compare_features(ours, theirs, weights, threads, level), distances
            )


@pytest.mark.parametrize("size", [(4, 5), (33, 21), pytest.param((67, 12), marks=pytest.mark.slow)])
def test_bands_have_the_bits_of_whole_maps(size):
    """Heights that a band of 32 rows, tiles of four and halvings divide or not: what is handed on,
    distances of both taps.
    """
    layers = packed(
        drawn_layers(((3, 64, False), (64, 64, True), (64, 128, False), (128, 128, True)))
    )
    frames, weights = (
        [drawn(9 + n, *size, 3) for n in range(3)],
        [np.abs(drawn(n, 64 * n)) for n in (1, 2)],
    )
    taps = [_features.feature_maps(frame, layers, 1, 0) for frame in frames]

    for level, threads in ((0, 3), (len(kernels.available_levels()) - 1, 1)):
        halved, distances = _features.compare_banded(frames, layers, weights, threads, level)
        for found, (_, tap) in zip(halved, taps, strict=True):
            height, width = tap.shape[0] // 2, tap.shape[1] // 2
            whole = tap[: 2 * height, : 2 * width].reshape(height, 2, width, 2, -1)
            assert np.array_equal(found, whole.max(axis=(1, 3)))
        for found, ours in zip(distances, taps[1:], strict=True):
            for map_, *layer in zip(found, ours, taps[0], weights, strict=True):
                assert np.array_equal(map_, _features.compare_features(*layer, 1, 0))


@pytest.mark.parametrize(
    ("frames", "layers", "count"),
    [
        ([], drawn_layers(), 2),
        ([drawn(0, 8, 8, 64)], drawn_layers(), 2),
        ([drawn(0, 8, 8, 3), drawn(0, 8, 9, 3)], drawn_layers(), 2),
        ([drawn(0, 3, 8, 3)], drawn_layers(), 2),  # nothing left behind the second halving
        ([drawn(0, 8, 8, 3)], drawn_layers(), 1),  # no weights for the second tap
        ([drawn(0, 8, 8, 3)], drawn_layers()[:3], 2),  # the last one not tapped
        ([drawn(0, 8, 8, 3)], drawn_layers(((3, 64, True),)), 1),
        ([drawn(0, 8, 8, 3)], [], 0),
    ],
)
def test_what_does_not_fit_is_refused_in_bands(frames, layers, count):
    with pytest.raises(TypeError, match="wanted"):
        _features.compare_banded(frames, packed(layers), [drawn(0, 64)] * count, 1, 0)


@given(seed=seeds)
@settings(max_examples=5, deadline=None)
def test_distances_are_those_of_directions(seed):
    """Weighted squares of the difference of unit vectors; features without a length are no division
    by zero.
    """
    ours, theirs, weights = (
        drawn(seed, 9, 7, 32),
        drawn(seed + 1, 9, 7, 32),
        np.abs(drawn(seed + 2, 32)),
    )
    ours[4, 5] = 0
    units = [
        each.astype(float) / (np.linalg.norm(each.astype(float), axis=-1, keepdims=True) + 1e-10)
        for each in (ours, theirs)
    ]

    found = _features.compare_features(
        ours, theirs, weights, 2, SIMD_LEVELS.index(kernels.get_simd_level())
    )

    assert found == pytest.approx((units[0] - units[1]) ** 2 @ weights, rel=1e-5)
    assert not _features.compare_features(ours, ours, weights, 1, 0).any()


@pytest.mark.parametrize(
    ("frame", "layers"),
    [
        (np.zeros((8, 8, 3)), drawn_layers()),  # of the wrong kind
        (drawn(0, 8, 8, 5), drawn_layers()),  # channels that no filter has
        (drawn(0, 8, 8, 64), drawn_layers()),  # of another layer
        (drawn(0, 1, 8, 3), drawn_layers()),  # nothing left behind the first halving
        (drawn(0, 8, 8, 3), []),
        (drawn(0, 8, 8, 3), drawn_layers(((3, 64, True),))),
    ],
)
def test_what_does_not_fit_is_refused(frame, layers):
    with pytest.raises(TypeError, match="wanted"):
        _features.feature_maps(frame, packed(layers), 1, 0)


def test_filters_of_other_sizes_are_refused():
    for shape in ((64, 64, 5, 5), (60, 64, 3, 3), (64, 60, 3, 3)):
        with pytest.raises(TypeError, match="filters: wanted"):
            _features.pack_filters(np.zeros(shape, np.float32), 1)


def test_a_bias_that_fills_no_panel_is_refused():
    """Filters of 32 channels with a bias of 40: the kernel, which reads biases by panels of 32,
    would read beyond its end.
    """
    packed_filters = _features.pack_filters(drawn(0, 32, 3, 3, 3), 1)
    layers = [
        (packed_filters, drawn(1, 32), False),
        (_features.pack_filters(drawn(2, 32, 64, 3, 3), 1), drawn(3, 40), True),
    ]
    with pytest.raises(TypeError, match="bias: wanted a multiple of 32 channels, got"):
        _features.feature_maps(drawn(0, 8, 8, 3), layers, 1, 0)


def test_distances_of_no_channels_are_refused():
    """Features without channels have no direction, and pixels that an int cannot count no
    number.
    """
    for shape in ((4, 4, 0), (4, 4, 24), (70_000, 1, 16)):
        with pytest.raises(TypeError, match="theirs: wanted"):
            _features.compare_features(
                np.zeros(shape, np.float32), np.zeros(shape, np.float32), drawn(0, shape[2]), 1, 0
            )
