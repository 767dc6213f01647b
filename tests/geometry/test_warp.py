import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ggvs_eval.errors import RenderError
from ggvs_eval.geometry.warp import warp, warp_change
from ggvs_eval.method import SourceView
from helpers.geometry_scenes import TAU, moved, random_camera, random_depth, seeds, sizes
from helpers.refusals import refused
from helpers.twins.warp import warp_twin


@settings(deadline=None, max_examples=40)
@given(seeds, sizes, sizes, st.booleans(), st.sampled_from([0.0, 0.5, 3.0]))
def test_agrees_with_its_twin(seed, target_size, source_size, bicubic, forgiven_px):
    """Any sizes and poses give the twin's colour and visibility, single pixels at borders apart."""
    random = np.random.default_rng(seed)
    target, source = random_camera(random, *target_size), random_camera(random, *source_size)
    image = random.random((source.height, source.width, 3), dtype=np.float32)
    inputs = (
        target,
        random_depth(random, target),
        source,
        image,
        random_depth(random, source),
        TAU,
    )
    ours, theirs = (
        each(*inputs, bicubic=bicubic, forgiven_px=forgiven_px) for each in (warp, warp_twin)
    )
    flips = 2 * max(0.005, 1 / ours.visibility.size)
    assert (np.abs(ours.colour - theirs.colour).max(axis=-1) > 1e-4).mean() <= flips
    assert (np.abs(ours.visibility - theirs.visibility) > 2e-3).mean() <= flips


@settings(deadline=None, max_examples=20)
@given(seeds, sizes, sizes)
def test_a_change_is_warped_as_the_image_of_its_differences(seed, target_size, source_size):
    """Two 8-bit images give the bits that their difference over 255 gives, up to the last pixel,
    which no byte follows.
    """
    random = np.random.default_rng(seed)
    target, source = (
        random_camera(random, *target_size),
        random_camera(random, source_size[0] + 1, source_size[1]),
    )
    now, before = random.integers(0, 256, (2, source.height, source.width, 3)).astype(np.uint8)
    depth, own = random_depth(random, target), random_depth(random, source)
    difference = (now.astype(np.float32) - before) / np.float32(255)
    found = warp_change(target, depth, SourceView(source, now, own, own), before, TAU)
    expected = warp(target, depth, source, difference, own, TAU)
    np.testing.assert_array_equal(found.colour, expected.colour)
    np.testing.assert_array_equal(found.visibility, expected.visibility)


def test_every_error_of_depth_is_forgiven_at_one_place():
    """A view warped into its own place is itself whatever both depths are, unknown ones too."""
    random = np.random.default_rng(3)
    camera = random_camera(random, 41, 27)
    image, depths = (
        random.random((27, 41, 3), dtype=np.float32),
        [random_depth(random, camera, 0.3) for _ in range(2)],
    )
    assert all((depth == 0).any() for depth in depths)
    result = warp(camera, depths[0], camera, image, depths[1], TAU, forgiven_px=0.5)
    np.testing.assert_allclose(result.colour, image, atol=1e-4)
    np.testing.assert_array_equal(result.visibility, 1)


def test_a_plane_shifts_by_its_disparity():
    """A camera 10 pixels of disparity to the right sees the plane shifted by 10 pixels and nothing
    beyond the border.
    """
    camera = random_camera(np.random.default_rng(1), 60, 20)
    depth = np.full((20, 60), 2.0, dtype=np.float32)
    image = np.random.default_rng(2).random((20, 60, 3), dtype=np.float32)
    right = moved(camera, 0.0)
    shift_world = camera.rotation[0] * 10 * 2.0 / camera.K[0, 0]
    pose = camera.world_to_camera.copy()
    pose[:3, 3] -= camera.rotation @ shift_world
    right = type(camera)("right", camera.K, pose, 60, 20, camera.near, camera.far)
    result = warp(camera, depth, right, image, depth, TAU)
    np.testing.assert_allclose(result.colour[:, 11:59], image[:, 1:49], atol=1e-3)
    assert not result.visibility[:, :9].any()
    np.testing.assert_allclose(result.visibility[:, 11:], 1.0)


@pytest.mark.parametrize(
    ("offset", "visibility"),
    [(0.0, 1.0), (0.9, 1.0), (1.5, 0.5), (-1.5, 0.5), (2.1, 0.0), (-30.0, 0.0)],
)
def test_visibility_falls_between_one_and_two_tolerances(offset, visibility):
    """The source's surface may lie one tolerance off; at two it is another surface, before or
    behind.
    """
    camera = random_camera(np.random.default_rng(3), 20, 20)
    depth = np.full((20, 20), 3.0, dtype=np.float32)
    image = np.ones((20, 20, 3), dtype=np.float32)
    result = warp(camera, depth, camera, image, depth + np.float32(offset * TAU), TAU)
    np.testing.assert_allclose(result.visibility, visibility, atol=1e-4)
    np.testing.assert_allclose(result.colour, 1.0, atol=1e-6)


def test_nothing_known_is_nothing_seen():
    """Without target depth there is neither colour nor visibility; without source depth no
    visibility.
    """
    camera = random_camera(np.random.default_rng(4), 12, 9)
    ones, zeros = np.ones((9, 12), dtype=np.float32), np.zeros((9, 12), dtype=np.float32)
    image = np.ones((9, 12, 3), dtype=np.float32)
    for depth in (zeros, zeros - 1, zeros + np.nan):
        result = warp(camera, depth, camera, image, ones, TAU)
        assert not result.colour.any()
        assert not result.visibility.any()
    assert not warp(camera, ones, camera, image, zeros, TAU).visibility.any()


def test_inputs_that_do_not_fit_are_refused():
    """Sizes, channels and tolerance are checked, and named."""
    camera = random_camera(np.random.default_rng(7), 8, 6)
    depth, image = np.ones((6, 8), dtype=np.float32), np.ones((6, 8, 3), dtype=np.float32)
    with refused(RenderError, "6 x 8"):
        warp(camera, depth.T, camera, image, depth, TAU)
    with refused(RenderError, "(H, W, 3)", "(6, 8)"):
        warp(camera, depth, camera, depth, depth, TAU)
    with pytest.raises(RenderError, match="tolerance must be positive"):
        warp(camera, depth, camera, image, depth, 0.0)
