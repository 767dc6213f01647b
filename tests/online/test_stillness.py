"""What source views share is motion, what each has for itself is noise: a trail is left by none, of
whatever contrast.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from ggvs_eval import kernels
from ggvs_eval.camera import Camera, nearest_cameras
from ggvs_eval.files.images import round_levels
from ggvs_eval.geometry.splat import Splat
from ggvs_eval.method import Instant, SourceView
from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided, OnlineOptions
from ggvs_eval.pipelines.online.temporal_filters import (
    TemporalDepthFilter,
    cells,
    middle_rays,
    splatted_change,
    stillness,
)
from helpers.scenes import camera_at

WIDTH, HEIGHT, FOCAL, DEPTH, MARGIN = 160, 120, 150.0, 3.0, 60
STEPS = 7


def rig_camera(x: float, name: str) -> Camera:
    """A camera of the rig at (x, 0, 0); 0.02 of it is a pixel on the wall."""
    K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    world_to_camera = np.eye(4)
    world_to_camera[0, 3] = -x
    return Camera(name, K, world_to_camera, WIDTH, HEIGHT, 1.0, 6.0)


RIG = [rig_camera(0.1 * n, f"cam{n:02d}") for n in range(4)]
TARGET = rig_camera(0.16, "target")


def wall(contrast: float, grain: float) -> np.ndarray:
    """A grey texture of this standard deviation in levels, blurred by so many pixels."""
    noise = np.random.default_rng(5).random((HEIGHT, WIDTH + 2 * MARGIN), np.float32)
    blurred = cv2.GaussianBlur(noise, (0, 0), grain) if grain else noise
    return 128 + contrast * (blurred - blurred.mean()) / blurred.std()


def looks(texture: np.ndarray, camera: Camera, moved: float) -> np.ndarray:
    """What a camera sees of the wall, its texture moved by so many pixels, (H, W, 3), float32
    levels.
    """
    down, across = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    left = np.float32(MARGIN + FOCAL * camera.centre[0] / DEPTH - moved)
    seen = cv2.remap(texture, across + left, down, cv2.INTER_CUBIC)
    return np.repeat(seen[..., None], 3, axis=2)


def shown(
    index: int, texture: np.ndarray, pixels: float, noise: float, cameras: list[Camera]
) -> Instant:
    """An instant of the wall whose texture moves by so many pixels in each, with exact depth and
    sensors' noise.
    """
    views = []
    for camera in cameras:
        grain = np.random.default_rng([index, int(camera.name[3:])]).normal(
            0, noise, (HEIGHT, WIDTH, 3)
        )
        image = round_levels(looks(texture, camera, pixels * index) + grain)
        depth = np.full((HEIGHT, WIDTH), DEPTH, np.float32)
        views.append(SourceView(camera, image, depth, np.ones_like(depth)))
    return Instant(index, TARGET, tuple(views), units_per_metre=1.0)


def errors(
    limit: float, contrast: float, noise: float, pixels: float, grain: float = 2.0, k: int = 2
) -> np.ndarray:
    """Mean error of each instant, grey levels, away from the borders."""
    method, texture = GeometryGuided(OnlineOptions(recurrent_limit=limit)), wall(contrast, grain)
    cameras, inside = nearest_cameras(TARGET, RIG, k), np.s_[10:-10, 10:-10]
    found = []
    for index in range(STEPS):
        image = 255 * method.step(shown(index, texture, pixels, noise, cameras)).image
        found.append(np.abs(image - looks(texture, TARGET, pixels * index))[inside].mean())
    return np.array(found)


@pytest.mark.parametrize(("contrast", "noise"), [(2.0, 0.0), (2.0, 3.0), (10.0, 1.0), (50.0, 3.0)])
def test_motion_of_any_contrast_leaves_no_trail(contrast, noise):
    """The whole picture moves by a pixel: no instant is worse by a fifth than without the recurrent
    output.
    """
    with_past, without = errors(0.85, contrast, noise, 1.0), errors(0.0, contrast, noise, 1.0)
    assert (with_past <= 1.2 * without).all()


@pytest.mark.parametrize("k", [2, pytest.param(4, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("grain", "pixels"), [(0.0, 0.1), (1.0, 0.4), (8.0, 4.0)])
def test_motion_of_any_speed_and_grain_leaves_no_trail(grain, pixels, k):
    """Slow motion, which the mean lags behind by less than a pixel, and fast motion, which looks
    like noise in one view.
    """
    contrast, noise = (10.0, 0.0) if k == 2 else (4.0, 1.5)
    with_past, without = (errors(limit, contrast, noise, pixels, grain, k) for limit in (0.85, 0.0))
    assert (with_past <= 1.2 * without).all()


@pytest.mark.parametrize("noise", [0.5, 3.0])
def test_what_stands_still_is_averaged_whatever_the_noise(noise):
    """The other side of the law: the error of a still wall falls to less than half in seven
    instants.
    """
    assert errors(0.85, 10.0, noise, 0.0)[-1] < 0.5 * errors(0.0, 10.0, noise, 0.0)[-1]


def still_cells(pixels: float, cameras: list[Camera], light: float = 0.0) -> np.ndarray:
    """Stillness at the second instant, with noise of 1.5 levels and light that has risen by so
    many.
    """
    filters, views = TemporalDepthFilter(), []
    for index in range(2):
        instant = shown(index, wall(10.0, 2.0), pixels, 1.5, cameras)
        lit = [
            np.clip(view.image + index * light, 0, 255).astype(np.uint8) for view in instant.sources
        ]
        sources = [
            replace(view, image=image) for view, image in zip(instant.sources, lit, strict=True)
        ]
        views = [filters.step(index, view) for view in sources]
    sources, changes = zip(*views, strict=True)
    depth = np.full((HEIGHT, WIDTH), DEPTH, np.float32)
    return stillness(
        TARGET, depth, sources, changes, np.zeros((HEIGHT // 4, WIDTH // 4), np.float32), 0.1
    )


def test_two_views_tell_motion_from_noise_and_light():
    """A wall that stands still does, though light rises; one that moves does not; one view alone
    knows nothing.
    """
    assert still_cells(0.0, RIG[1:3]).mean() > 0.95
    assert still_cells(0.0, RIG[1:3], light=3.0).mean() > 0.95
    assert still_cells(1.0, RIG[1:3]).mean() < 0.05
    assert still_cells(0.0, RIG[1:2]).max() == 0


@pytest.mark.usefixtures("kernel_settings")
def test_threads_do_not_change_a_bit():
    """One thread and three find the same stillness."""
    found = []
    for count in (1, 3):
        kernels.set_threads(count)
        found.append(still_cells(0.3, RIG))
    np.testing.assert_array_equal(*found)


def test_cells_are_the_middles():
    """Of every four pixels the third, of what is left the middle; their camera looks through these
    pixels' middles.
    """
    assert cells(np.arange(10)[None]).tolist() == [[1, 5, 8]]
    camera = camera_at(0.2, width=32, height=16)
    np.testing.assert_allclose(middle_rays(camera).rays(), cells(camera.rays()), atol=1e-12)


def test_the_change_is_the_largest_that_a_covering_view_saw():
    """Eq. 1 undone: a mask of 0.8 is a change of (0.8 - 0.6) 0.7; a view that does not cover has no
    say; next cells count.
    """
    masks = np.full((2, 32, 64), 0.6, np.float32)
    masks[0, 18, 34], masks[1, 18, 6] = 0.8, 1.0
    alphas = np.ones((2, 32, 64), np.float32)
    alphas[1, :, :16] = 0.3
    splats = [
        Splat(np.dstack([np.zeros((32, 64, 3), np.float32), mask]), alpha, alpha)
        for mask, alpha in zip(masks, alphas, strict=True)
    ]

    change = splatted_change(splats, 0.6, 0.7)

    assert change.shape == (8, 16)
    np.testing.assert_allclose(change[4, 6:11], 0.14, atol=1e-6)
    assert change[:, :6].max() < 1e-6
