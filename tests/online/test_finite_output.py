"""No picture is lost to one that was: stillness is a number for every content, and what is not
finite has no past.
"""

import numpy as np
import pytest

from ggvs_eval.camera import Camera
from ggvs_eval.kernels import _core
from ggvs_eval.method import Instant, SourceView
from ggvs_eval.pipelines.online.geometry_guided import RULES, GeometryGuided
from ggvs_eval.pipelines.online.temporal_filters import RecurrentOutput

WIDTH, HEIGHT, FOCAL, DEPTH = 160, 120, 130.0, 3.0
LEVELS = (100, 117, 134)  # of the wall, one an instant


def turned(x: float, degrees: float, name: str) -> Camera:
    """A camera at (x, 0, 0), turned about its vertical axis."""
    angle = np.deg2rad(degrees)
    pose = np.eye(4)
    pose[:3, :3] = [
        [np.cos(angle), 0, -np.sin(angle)],
        [0, 1, 0],
        [np.sin(angle), 0, np.cos(angle)],
    ]
    pose[:3, 3] = -pose[:3, :3] @ [x, 0, 0]
    return Camera(
        name,
        np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]]),
        pose,
        WIDTH,
        HEIGHT,
        1.0,
        30.0,
    )


def lamp(index: int, apart: float) -> Instant:
    """Two cameras turned away from each other before a wall without texture or noise, whose light
    changes.
    """
    views = []
    for camera in (turned(-0.1, -apart / 2, "cam00"), turned(0.1, apart / 2, "cam01")):
        rays = (
            np.concatenate([camera.pixel_centres(), np.ones((HEIGHT, WIDTH, 1))], axis=-1)
            @ np.linalg.inv(camera.K).T
        )
        depth = (DEPTH / (rays @ camera.rotation)[..., 2]).astype(np.float32)
        image = np.full((HEIGHT, WIDTH, 3), LEVELS[index % len(LEVELS)], np.uint8)
        views.append(SourceView(camera, image, depth, np.ones_like(depth)))
    return Instant(index, turned(0.0, 0.0, "target"), tuple(views), units_per_metre=1.0)


@pytest.mark.parametrize("apart", range(46, 56, 3))
def test_a_lamp_without_noise_leaves_numbers(apart):
    """What two views share rounds to more than each has: the noise is none, not the root of a
    negative number.
    """
    method = GeometryGuided()
    for index in range(3):
        assert np.isfinite(method.step(lamp(index, apart)).image).all()


def test_what_is_not_finite_is_forgotten_at_once():
    """Twelve values that are no numbers are twelve in that output, none in the next, and leave no
    other pixel without a past.
    """
    still, random = np.ones((HEIGHT // 4, WIDTH // 4), np.float32), np.random.default_rng(0)
    target, damaged, whole = (
        turned(0.0, 0.0, "target"),
        RecurrentOutput(0.85),
        RecurrentOutput(0.85),
    )
    for index in range(4):
        image = random.normal(0.5, 0.01, (HEIGHT, WIDTH, 3)).astype(np.float32)
        broken = image.copy()
        if index == 1:
            broken[8:12, 8:9] = np.nan  # the middle of a cell among them
        found, wanted = (
            damaged.step(index, target, broken, still),
            whole.step(index, target, image, still),
        )
        assert np.isnan(found).sum() == (12 if index == 1 else 0)
    np.testing.assert_allclose(found[40:], wanted[40:], atol=1e-3)


def test_a_background_that_is_not_finite_is_not_shown():
    """The memory of a hole that holds no number begins anew with what is there."""
    image, past = np.full((8, 8, 3), 0.5, np.float32), np.full((8, 8, 3), np.nan, np.float32)
    hidden = np.zeros((8, 8), np.float32)

    _core.remember(
        hidden,
        np.ones((2, 2), np.float32),
        [hidden],
        RULES,
        image,
        past,
        np.full((8, 8), 2.0, np.float32),
        1,
    )

    np.testing.assert_array_equal(image, 0.5)
