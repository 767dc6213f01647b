"""Contested depth: colours decide between what was fused and what the views show, and only where
most views contradict it.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ggvs_eval import kernels
from ggvs_eval.camera import Camera
from ggvs_eval.errors import RenderError
from ggvs_eval.geometry.contested_depth import LEAST_ALPHA, LEAST_SHARE, RATIO, settle_depth
from ggvs_eval.geometry.per_pixel import view_weights
from ggvs_eval.geometry.splat import Splat, splat
from ggvs_eval.method import SourceView
from helpers.geometry_scenes import random_camera, random_depth, seeds, sizes, view_of
from helpers.refusals import refused
from helpers.scenes import camera_at, instant, look

pytestmark = pytest.mark.usefixtures("kernel_settings")

TARGET = camera_at(0.0, name="target")
SOURCES = [camera_at(-0.15), camera_at(0.15), camera_at(-0.45), camera_at(0.45)]
TOLERANCE = 0.04


def views_and_splats(scale: float = 1.0) -> tuple[list[SourceView], list[Splat]]:
    """Four views of a square before a wall, whose depth is wrong by a factor."""
    views = [
        replace(view, depth=view.depth * np.float32(scale))
        for view in instant(0, TARGET, SOURCES).sources
    ]
    return views, [splat([view], TARGET, near=0.1) for view in views]


def surface(scale: float = 1.0) -> np.ndarray:
    """What the target sees, times a factor."""
    return look(TARGET)[1] * np.float32(scale)


def random_case(
    seed: int, size: tuple[int, int], count: int
) -> tuple[Camera, np.ndarray, list[SourceView], list[Splat]]:
    """A rough surface, views of several sizes around it, and splats that often contradict it."""
    random = np.random.default_rng(seed)
    target = random_camera(random, *size, "target")
    views, splats = [], []
    for k in range(count):
        camera = random_camera(random, 5 + 9 * k, 7 + 5 * k, f"source {k}")
        image = random.integers(0, 256, (camera.height, camera.width, 3)).astype(np.uint8)
        views.append(view_of(camera, random_depth(random, camera), image))
        alpha = random.random((target.height, target.width), dtype=np.float32)
        splats.append(
            Splat(np.zeros((*alpha.shape, 3), np.float32), alpha, random_depth(random, target))
        )
    return target, random_depth(random, target), views, splats


def twin(
    target: Camera,
    fused: np.ndarray,
    views: list[SourceView],
    splats: list[Splat],
    tolerance: float,
) -> np.ndarray:
    """`settle_depth` pixel by pixel, in float64."""
    weights, settled = (
        view_weights(target, [view.camera for view in views]).astype(float),
        fused.copy(),
    )
    for (row, column), depth in np.ndenumerate(fused):
        shown = [
            (w, s.depth[row, column])
            for w, s in zip(weights, splats, strict=True)
            if s.alpha[row, column] > LEAST_ALPHA
        ]
        shown = [(weight, other) for weight, other in shown if other > 0]
        agreeing = sum(
            weight for weight, other in shown if abs(other - depth) <= np.float32(tolerance)
        )
        if depth <= 0 or not shown or agreeing >= LEAST_SHARE * sum(weight for weight, _ in shown):
            continue
        least = RATIO * (spread(target, row, column, depth, views) or 0.0)
        for _, other in shown:
            here = spread(target, row, column, other, views)
            if abs(other - depth) > np.float32(tolerance) and here is not None and here < least:
                least, settled[row, column] = here, other
    return settled


def spread(
    target: Camera, row: int, column: int, depth: float, views: list[SourceView]
) -> float | None:
    """Variance of the colours that the views have at a point of a target pixel's ray."""
    point = target.unproject(np.array([[column + 0.5, row + 0.5]]), np.array([float(depth)]))
    colours = []
    for view in views:
        ((u, v),), (z,) = view.camera.project(point)
        x, y = u - 0.5, v - 0.5
        if z > 0 and 0 <= x <= view.camera.width - 1 and 0 <= y <= view.camera.height - 1:
            left, top = min(int(x), view.camera.width - 2), min(int(y), view.camera.height - 2)
            cell = view.image[top : top + 2, left : left + 2].astype(float)
            across = cell[:, 0] + (x - left) * (cell[:, 1] - cell[:, 0])
            colours.append(across[0] + (y - top) * (across[1] - across[0]))
    return float(np.var(colours, axis=0).sum()) if len(colours) >= 2 else None


@settings(deadline=None, max_examples=20)
@given(seeds, sizes, st.integers(1, 4))
def test_the_kernel_does_what_is_written(seed, size, count):
    """Any sizes, poses and holes give what the twin gives, but for rounding where two depths fit
    alike.
    """
    target, fused, views, splats = random_case(seed, size, count)
    found, expected = (
        settle_depth(target, fused, views, splats, TOLERANCE),
        twin(target, fused, views, splats, TOLERANCE),
    )
    assert found.dtype == np.float32
    assert (found != expected).mean() <= 0.01 + 1 / found.size


def test_a_surface_voted_away_comes_back():
    """Fused depth behind what all views show, where their colours differ: nearly all of it
    returns.
    """
    views, splats = views_and_splats()
    settled = settle_depth(TARGET, surface(1.3), views, splats, TOLERANCE)
    assert (np.abs(settled - surface()) < TOLERANCE).mean() > 0.8


def test_depth_that_is_wrong_in_every_view_does_not_win():
    """All views claim a nearer surface; at the fused one their colours agree: it stays, though
    nobody votes for it.
    """
    views, splats = views_and_splats(0.8)
    settled = settle_depth(TARGET, surface(), views, splats, TOLERANCE)
    assert (settled == surface()).mean() > 0.97


def test_uncontested_depth_stays():
    """Depth that the views agree with, within the tolerance, is not touched, whatever the colours
    say.
    """
    views, splats = views_and_splats()
    slightly_off = surface() + np.float32(TOLERANCE / 2)
    agreed = np.logical_and.reduce(
        [np.abs(each.depth - slightly_off) < TOLERANCE for each in splats]
    )
    blind = [
        replace(view, image=255 - view.image if k else view.image) for k, view in enumerate(views)
    ]
    settled = settle_depth(TARGET, slightly_off, blind, splats, TOLERANCE)
    assert agreed.mean() > 0.8
    np.testing.assert_array_equal(settled[agreed], slightly_off[agreed])


def test_what_is_unknown_stays_unknown():
    """Pixels where nothing was fused, or no view shows anything, keep what they have."""
    views, splats = views_and_splats()
    unknown, blank = (
        np.zeros_like(surface()),
        [replace(each, alpha=np.zeros_like(each.alpha)) for each in splats],
    )
    np.testing.assert_array_equal(settle_depth(TARGET, unknown, views, splats, TOLERANCE), unknown)
    np.testing.assert_array_equal(
        settle_depth(TARGET, surface(1.3), views, blank, TOLERANCE), surface(1.3)
    )


def test_a_single_view_changes_nothing():
    """One view cannot agree with itself."""
    views, splats = views_and_splats()
    np.testing.assert_array_equal(
        settle_depth(TARGET, surface(1.3), views[:1], splats[:1], TOLERANCE), surface(1.3)
    )


def test_threads_give_the_same_bits():
    """One thread or three."""
    (views, splats), settled = views_and_splats(), []
    for threads in (1, 3):
        kernels.set_threads(threads)
        settled.append(settle_depth(TARGET, surface(1.3), views, splats, TOLERANCE))
    assert (settled[0] != surface(1.3)).any()
    np.testing.assert_array_equal(*settled)


def test_what_does_not_fit_is_refused():
    """Too few splats, or a fused depth of another size."""
    views, splats = views_and_splats()
    with refused(RenderError, "4 views", "3 splats"):
        settle_depth(TARGET, surface(), views, splats[:3], TOLERANCE)
    with pytest.raises(RenderError, match="fused depth"):
        settle_depth(TARGET, surface()[:-1], views, splats, TOLERANCE)


@pytest.mark.parametrize("size", [(1, 7), (7, 1), (1, 1)])
def test_images_of_one_pixel_are_not_settled(size):
    """Their colours are not interpolated: the fused depth stays."""
    (views, splats), (width, height) = views_and_splats(), size
    narrow = []
    for view in views:
        image, depth = view.image[:height, :width], view.depth[:height, :width]
        narrow.append(
            replace(view, camera=view.camera.cropped(3, 2, *size), image=image, depth=depth)
        )
    np.testing.assert_array_equal(
        settle_depth(TARGET, surface(1.3), narrow, splats, TOLERANCE), surface(1.3)
    )
