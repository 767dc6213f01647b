"""What no source sees is filled by what was seen before, steadily, and never by what has left."""

import numpy as np
import pytest

from ggvs_eval.geometry.splat import Splat
from ggvs_eval.pipelines.online.geometry_guided import RENEWAL, RememberedBackground
from helpers.scenes import camera_at

TARGET = camera_at(0.0, name="target", width=16, height=12)
SIZE, CELLS = (12, 16), (3, 4)
HOLE = np.s_[4:8, 4:8]
WALL, BODY = np.float32(0.7), np.float32(0.2)


def splats_of(hole: bool) -> list[Splat]:
    """Two views that cover everything, or all but the hole."""
    alpha = np.ones(SIZE, np.float32)
    if hole:
        alpha[HOLE] = 0
    return [
        Splat(np.zeros((*SIZE, 4), np.float32), each, np.ones(SIZE, np.float32))
        for each in (alpha, 0.3 * alpha)
    ]


def maps(colour: np.float32, depth: float) -> tuple[np.ndarray, np.ndarray]:
    """A wall of 0.9 at depth 5 with something of a colour and a depth where the hole will be."""
    image, surface = np.full((*SIZE, 3), 0.9, np.float32), np.full(SIZE, 5, np.float32)
    image[HOLE], surface[HOLE] = colour, depth
    return image, surface


def stillness_of(moves: bool) -> np.ndarray:
    """Nothing moves, or what stands where the hole will be."""
    still = np.ones(CELLS, np.float32)
    if moves:
        still[1:2, 1:2] = 0
    return still


def run(steps: list[tuple[np.float32, float, bool, bool]]) -> list[np.ndarray]:
    """Outputs of instants given as colour, depth (0 where unknown), whether it moves, whether no
    source sees it.
    """
    memory, outputs = RememberedBackground(), []
    for index, (colour, depth, moves, hole) in enumerate(steps):
        image, surface = maps(colour, depth)
        outputs.append(
            memory.step(index, TARGET, image, surface, splats_of(hole), stillness_of(moves))
        )
    return outputs


def test_what_stood_still_is_shown_when_nobody_sees_it():
    """A wall that somebody hides from the sources, but not from the target, stays what it was; the
    filling does not show.
    """
    image = run(
        [(WALL, 5.0, False, False), (WALL, 5.0, False, False), (np.float32(0.1), 0.0, True, True)]
    )[-1]
    np.testing.assert_array_equal(image[HOLE], WALL)
    np.testing.assert_array_equal(
        np.delete(image.reshape(-1, 3), _inside(), axis=0), np.float32(0.9)
    )


def test_what_was_behind_comes_back():
    """A wall, then a body before it, then a hole: the wall."""
    image = run(
        [(WALL, 5.0, False, False), (BODY, 2.0, False, False), (np.float32(0.5), 0.0, True, True)]
    )[-1]
    np.testing.assert_array_equal(image[HOLE], WALL)


def test_what_moves_is_no_background():
    """A body that stood there from the first instant and walked away is not shown; the filling is,
    as it settles.
    """
    filling = np.float32(0.5)
    outputs = run(
        [(BODY, 2.0, False, False), (BODY, 2.0, True, False), *[(filling, 0.0, False, True)] * 40]
    )
    for shown in outputs[2:]:
        np.testing.assert_array_equal(shown[HOLE], filling)


def test_the_mean_of_fillings_begins_anew_after_a_body():
    """The first filling after it is shown as it is, neither mixed with the body nor with fillings
    from before.
    """
    fillings = [np.float32(value) for value in (0.6, 0.6, 0.8, 0.7)]
    before, after = (
        [(each, 0.0, False, True) for each in part] for part in (fillings[:2], fillings[2:])
    )
    outputs = run([*before, *[(BODY, 2.0, True, False)] * 3, *after])
    np.testing.assert_array_equal(outputs[5][HOLE], fillings[2])
    np.testing.assert_allclose(
        outputs[6][HOLE], fillings[2] + RENEWAL * (fillings[3] - fillings[2]), atol=1e-6
    )


def test_fillings_do_not_boil():
    """Where nothing was ever seen, fillings that vary from frame to frame vary less, and keep their
    mean.
    """
    random = np.random.default_rng(0)
    fillings = random.normal(0.5, 0.1, 400).astype(np.float32)
    shown = np.array(
        [image[HOLE].mean() for image in run([(each, 0.0, False, True) for each in fillings])]
    )
    expected = np.sqrt(RENEWAL / (2 - RENEWAL))  # of a recursive mean of white noise
    assert shown[50:].std() < 1.5 * expected * fillings.std()
    assert shown[50:].mean() == pytest.approx(fillings[50:].mean(), abs=0.02)


def test_a_target_that_moves_remembers_nothing():
    """From another pose, and after a gap in time, the filling is shown as it is."""
    memory = RememberedBackground()
    image, depth = maps(WALL, 5.0)
    memory.step(0, TARGET, image, depth, splats_of(False), stillness_of(False))
    other, unknown = maps(BODY, 0.0)
    moved = camera_at(0.1, name="target", width=16, height=12)
    for index in (1, 3):
        shown = memory.step(
            index, moved, other.copy(), unknown, splats_of(True), stillness_of(False)
        )
        np.testing.assert_array_equal(shown, other)


def test_holes_fade_in():
    """No hole where half is covered, all of one from a quarter on, in proportion between."""
    memory, (image, depth) = RememberedBackground(), maps(WALL, 5.0)
    memory.step(0, TARGET, image, depth, splats_of(False), stillness_of(False))
    splats = splats_of(False)
    for view in splats:
        view.alpha[HOLE] = np.array([0.5, 0.375, 0.25, 0.0], np.float32)  # column by column
    filling, unknown = maps(np.float32(0), 0.0)
    shown = memory.step(1, TARGET, filling, unknown, splats, stillness_of(False))
    np.testing.assert_allclose(
        shown[HOLE][..., 0], np.tile(WALL * np.float32([0, 0.5, 1, 1]), (4, 1)), atol=1e-6
    )


def _inside() -> np.ndarray:
    """Numbers of the hole's pixels."""
    return np.arange(SIZE[0] * SIZE[1]).reshape(SIZE)[HOLE].ravel()
