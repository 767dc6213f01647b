"""The recurrent output: noise averages out where nothing moves; motion, light and a moved camera
leave no trace of the past.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ggvs_eval.errors import RenderError
from ggvs_eval.kernels import _core
from ggvs_eval.pipelines.online.temporal_filters import RecurrentOutput, agreement
from helpers.geometry_scenes import seeds
from helpers.refusals import refused
from helpers.scenes import camera_at
from helpers.twins.enlarging import recur_twin

TARGET = camera_at(0.0, name="target")
SIZE = (TARGET.height, TARGET.width)
CELLS = (-(-SIZE[0] // 4), -(-SIZE[1] // 4))
NOTHING_MOVES = np.ones(CELLS, np.float32)
NOISE = 2 / 255


@pytest.mark.parametrize(
    ("limit", "instants", "left"), [(0.85, 4, 0.5), (0.5, 12, np.sqrt(0.5 / 1.5))]
)
def test_noise_averages_out_up_to_the_limit(limit, instants, left):
    """Below its limit the weight of the past makes a plain mean; in the long run it is a
    first-order filter of that weight.
    """
    random, recurrent = np.random.default_rng(0), RecurrentOutput(limit)
    for index in range(instants):
        noise = random.normal(0.5, NOISE, (*SIZE, 3)).astype(np.float32)
        output = recurrent.step(index, TARGET, noise, NOTHING_MOVES)
    assert output.std() == pytest.approx(NOISE * left, rel=0.06)


@settings(deadline=None, max_examples=40)
@given(seeds, st.integers(1, 70), st.integers(1, 70), st.integers(1, 3))
def test_the_kernel_mixes_as_cells_say(seed, width, height, threads):
    """Of any size the bilinear mix of two pictures, the same bits for any number of threads."""
    random = np.random.default_rng(seed)
    now, past = random.random((2, height, width, 3), dtype=np.float32)
    cells = random.random((4, -(-height // 4), -(-width // 4)), dtype=np.float32)
    mixed = _core.recur(now, past, cells, threads)
    np.testing.assert_allclose(mixed, recur_twin(now, past, cells), atol=2e-6)
    np.testing.assert_array_equal(mixed, _core.recur(now, past, cells, 1))


def test_cells_that_do_not_fit_are_refused():
    """Fewer maps than four, none at all, or more cells than pixels."""
    image = np.zeros((8, 8, 3), np.float32)
    for shape in ((3, 2, 2), (4, 0, 2), (4, 9, 2)):
        with refused(TypeError, "cells", "four maps"):
            _core.recur(image, image, np.zeros(shape, np.float32), 1)


def test_what_moves_is_shown_as_it_is():
    """Where the sources see motion the output is the new image to the last bit, and the past begins
    anew.
    """
    recurrent, still = RecurrentOutput(0.85), NOTHING_MOVES.copy()
    still[:9] = 0
    grey = np.full((*SIZE, 3), 0.5, np.float32)
    new = grey + np.random.default_rng(0).normal(0, NOISE, (*SIZE, 3)).astype(np.float32)
    recurrent.step(0, TARGET, grey, NOTHING_MOVES)

    output = recurrent.step(1, TARGET, new, still)

    np.testing.assert_allclose(output[:32], new[:32], atol=1e-6)
    assert np.abs(output[40:] - 0.5).mean() < 0.6 * np.abs(new[40:] - 0.5).mean()
    again = recurrent.step(2, TARGET, grey, NOTHING_MOVES)
    np.testing.assert_allclose(again[:28], (new[:28] + grey[:28]) / 2, atol=1e-3)


def test_slow_light_does_not_lag():
    """Light that rises by a level per instant is no motion; it is followed to half a level while
    noise is averaged.
    """
    recurrent, random = RecurrentOutput(0.85), np.random.default_rng(0)
    for index in range(20):
        light = np.float32(0.3 + index / 255)
        output = recurrent.step(
            index,
            TARGET,
            light + random.normal(0, NOISE, (*SIZE, 3)).astype(np.float32),
            NOTHING_MOVES,
        )

    assert abs(float(output.mean() - light)) < 0.5 / 255
    assert output.std() < 0.5 * NOISE


@pytest.mark.parametrize(
    ("index", "target"),
    [
        (2, TARGET),
        (1, camera_at(0.05)),
        (1, replace(TARGET, K=TARGET.K * np.array([[1.1], [1.1], [1.0]]))),
    ],
    ids=["gap", "moved", "zoomed"],
)
def test_the_past_counts_from_the_same_view_alone(index, target):
    """After a gap in time, a move or a zoom the output is the new image itself."""
    recurrent = RecurrentOutput(0.85)
    recurrent.step(0, TARGET, np.zeros((*SIZE, 3), np.float32), NOTHING_MOVES)
    new = np.full((*SIZE, 3), 0.5, np.float32)

    np.testing.assert_array_equal(recurrent.step(index, target, new, NOTHING_MOVES), new)


def test_the_mean_of_noise_agrees_with_what_is_new_and_one_that_drags_does_not():
    """Noise of any strength in means of one to twelve images is sure, a texture that the mean lags
    behind by a pixel is not.
    """
    random = np.random.default_rng(3)
    texture = cv2.GaussianBlur(random.normal(0, 0.3, (72, 97, 3)).astype(np.float32), (0, 0), 2)
    for sigma in (1e-3, 1e-2, 1e-1):
        for count in (1, 4, 12):
            images = sigma * random.normal(size=(count + 1, 72, 96, 3)).astype(np.float32)
            new, mean, last = images[0], images[1:].mean(axis=0), images[1]
            assert agreement(new, mean, last, np.full((72, 96), count, np.float32)).mean() > 0.9
    few = np.full((72, 96), 6, np.float32)
    new, last, mean = texture[:, 1:], (texture[:, 1:] + texture[:, :-1]) / 2, texture[:, :-1]
    assert agreement(new, mean, last, few).max() == 0


@pytest.mark.parametrize("limit", [-0.1, 1.0])
def test_a_weight_that_is_none_is_refused(limit):
    """A past of weight 1 would never let anything new in."""
    with refused(RenderError, "at least 0", "below 1"):
        RecurrentOutput(limit)
