"""Filter, blending and hole filling: each compiled kernel against its twin, its laws, and the same
bits from any threads.
"""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ggvs_eval.errors import RenderError
from ggvs_eval.geometry.difference_mask import difference_mask
from ggvs_eval.geometry.per_pixel import largest_feature, weighted_mean
from ggvs_eval.geometry.warp import look_up, warp
from ggvs_eval.kernels import _core
from ggvs_eval.pipelines.online.blending import push_pull
from ggvs_eval.pipelines.online.temporal_filters import filter_depth
from helpers.geometry_scenes import (
    TAU,
    image8,
    random_camera,
    random_depth,
    seeds,
    sizes,
    view_of,
    weighted_views,
)
from helpers.refusals import refused
from helpers.twins.blending import look_up_twin, push_pull_twin, weighted_mean_twin
from helpers.twins.depth_filter import difference_mask_twin, filter_depth_twin

pytestmark = pytest.mark.usefixtures("kernel_settings")


def holes(random: np.random.Generator, height: int, width: int) -> np.ndarray:
    """Which pixels are known: patches of a few pixels."""
    return cv2.GaussianBlur(random.random((height, width)), (0, 0), 2).reshape(
        height, width
    ) > random.uniform(0.4, 0.6)


@settings(deadline=None, max_examples=40)
@given(seeds, st.integers(1, 70), st.integers(1, 70), st.sampled_from(["largest", "mean"]))
def test_the_mask_agrees_with_its_twin(seed, width, height, channels):
    """Any size gives the mask of the images averaged down first: the order does not matter
    (Eq. 1).
    """
    random = np.random.default_rng(seed)
    now, before = image8(random, height, width), image8(random, height, width)
    now[: height // 2] = before[: height // 2]

    mask = difference_mask(now, before, channels=channels)

    np.testing.assert_allclose(
        mask, difference_mask_twin(now, before, channels=channels), atol=2e-6
    )
    assert mask.shape == (height, width)


@settings(deadline=None, max_examples=40)
@given(seeds, sizes, st.sampled_from([0.0, 0.05, np.inf]))
def test_the_filter_agrees_with_its_twin(seed, size, tolerance):
    """Eq. 2 with unknown depth, unknown history and two surfaces: the twin's bits."""
    random = np.random.default_rng(seed)
    depth, near = (random.uniform(1, 2, size).astype(np.float32) for _ in range(2))
    history = np.where(random.random(size) < 0.5, depth * np.float32(1.02), near)
    for unknown in (depth, history):
        unknown[random.random(size) < 0.2] = 0
    mask = random.choice(np.array([0.6, 0.8, 1.0], np.float32), size)

    np.testing.assert_array_equal(
        filter_depth(depth, history, mask, tolerance),
        filter_depth_twin(depth, history, mask, tolerance),
    )


@settings(deadline=None, max_examples=40)
@given(seeds, st.integers(1, 90), st.integers(1, 90))
def test_push_pull_agrees_with_its_twin(seed, width, height):
    """Any size, odd ones among them, and any holes are filled as the twin fills them."""
    random = np.random.default_rng(seed)
    colour, known = (
        random.random((height, width, 3), dtype=np.float32),
        holes(random, height, width),
    )

    np.testing.assert_allclose(push_pull(colour, known), push_pull_twin(colour, known), atol=1e-5)


def test_push_pull_keeps_what_is_known_and_looks_at_nothing_else():
    """Known pixels keep their bits, unknown ones may hold anything, and holes in one colour get
    that colour.
    """
    random = np.random.default_rng(0)
    colour, known = random.random((61, 83, 3), dtype=np.float32), holes(random, 61, 83)
    filled = push_pull(colour, known)
    in_place = colour.copy()
    assert push_pull(in_place, known, out=in_place) is in_place
    np.testing.assert_array_equal(in_place, filled)

    np.testing.assert_array_equal(filled[known], colour[known])
    np.testing.assert_array_equal(
        push_pull(np.where(known[..., None], colour, np.float32(np.nan)), known), filled
    )
    np.testing.assert_allclose(push_pull(np.full_like(colour, 0.3), known), 0.3, atol=1e-6)


@settings(deadline=None, max_examples=40)
@given(seeds, sizes, st.integers(1, 5), st.integers(3, 6))
def test_the_mean_agrees_with_its_twin(seed, size, views, channels):
    """Any number of views and channels: the twin's bits, in the same order of addition; pixels
    without weight are black.
    """
    random = np.random.default_rng(seed)
    colours = [random.random((*size, channels), dtype=np.float32) for _ in range(views)]
    weights = [
        random.random(size, dtype=np.float32) * (random.random(size) < 0.7) for _ in range(views)
    ]
    weights = [weight.astype(np.float32) for weight in weights]
    factors = [float(np.float32(factor)) for factor in random.random(views)]

    ours = weighted_mean(colours, weights, factors)

    scaled = [np.float32(factor) * weight for factor, weight in zip(factors, weights, strict=True)]
    np.testing.assert_array_equal(ours, weighted_mean_twin(colours, scaled))
    # a view, not a copy
    np.testing.assert_array_equal(weighted_mean([each[..., :3] for each in colours], scaled), ours)
    assert not ours[np.sum(weights, axis=0) == 0].any()


def test_the_largest_feature_of_covering_views():
    """Views that hardly cover a pixel have no say; where none has, the value is the given one."""
    features = [np.full((1, 3, 4), value, np.float32) for value in (0.7, 0.9)]
    alphas = [np.array([[0.6, 0.6, 0.4]], np.float32), np.array([[0.6, 0.4, 0.4]], np.float32)]

    found = largest_feature(features, alphas, channel=3, least_alpha=0.5, otherwise=1.0)

    np.testing.assert_array_equal(found, np.array([[0.9, 0.7, 1.0]], np.float32))


@settings(deadline=None, max_examples=40)
@given(seeds, sizes, st.tuples(st.integers(2, 40), st.integers(1, 30)), st.integers(1, 4))
def test_the_look_up_agrees_with_its_twin(seed, target_size, source_size, count):
    """Any sizes and poses give what warping every view and blending afterwards gives, single pixels
    at borders apart.
    """
    random = np.random.default_rng(seed)
    target, views = random_camera(random, *target_size), weighted_views(random, count, source_size)
    background = random.random((target.height, target.width, 3), dtype=np.float32)
    depth = random_depth(random, target)

    ours = look_up(target, depth, *views, background, TAU)

    theirs = look_up_twin(target, depth, *views, background, TAU)
    assert (np.abs(ours - theirs).max(axis=-1) > 5e-3).mean() <= 2 * max(
        0.005 * count, 1 / depth.size
    )


def test_the_look_up_of_one_view_is_its_warp():
    """One fully visible view: the warped image, to rounding; where the target's depth is unknown,
    the background.
    """
    random = np.random.default_rng(1)
    camera = random_camera(random, 45, 31)
    depth, image = random_depth(random, camera), image8(random, 31, 45)
    background = random.random((31, 45, 3), dtype=np.float32)

    found = look_up(camera, depth, [view_of(camera, depth, image)], [0.7], background, TAU)

    warped = warp(
        camera, depth, camera, (image / 255).astype(np.float32), depth, TAU, bicubic=True
    ).colour
    np.testing.assert_allclose(found, np.where(depth[..., None] > 0, warped, background), atol=2e-5)
    np.testing.assert_array_equal(found[depth == 0], background[depth == 0])


def test_what_does_not_fit_is_refused():
    """Shapes, kinds and weights are checked, and named."""
    random = np.random.default_rng(3)
    camera = random_camera(random, 8, 6)
    depth, image, black = (
        np.ones((6, 8), np.float32),
        image8(random, 6, 8),
        np.zeros((6, 8, 3), np.float32),
    )
    view = view_of(camera, depth, image)
    with refused(RenderError, "camera camera", "uint8", "(6, 8, 3)"):
        look_up(
            camera, depth, [view_of(camera, depth, image.astype(np.float32))], [1.0], black, TAU
        )
    with refused(RenderError, "positive"):
        look_up(camera, depth, [view], [0.0], black, TAU)
    with refused(RenderError, "(H, W, 3)", "(6, 8)"):
        look_up(camera, depth, [view], [1.0], depth, TAU)
    with refused(RenderError, "2 for 1"):
        look_up(camera, depth, [view], [1.0, 1.0], black, TAU)
    with refused(RenderError, "1 views", "2 weights"):
        weighted_mean([black], [depth, depth])
    with refused(TypeError, "weight", "float32 (6, 8)", "float32 (5, 8)"):
        _core.weighted_mean([(black, depth, 1.0), (black, depth[:5], 1.0)], (6, 8), 1)
    with refused(TypeError, "before", "uint8 (6, 8, 3)"):
        difference_mask(image, image[:5])
    with refused(ValueError, "cells", "1 to 128"):
        _core.colour_change(
            np.zeros((300, 4, 3), np.uint8), np.zeros((300, 4, 3), np.uint8), (2, 1), 1
        )
