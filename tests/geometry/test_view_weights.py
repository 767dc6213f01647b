"""Laws of the weights between source views: no pixel, no unit of length, no camera that is left out
of the sum.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ggvs_eval.baselines.fixed_blending import DistanceBased
from ggvs_eval.camera import Camera
from ggvs_eval.geometry.per_pixel import FALL_OFF, LEAST_PARALLAX_RAD, view_weights, weighted_mean
from ggvs_eval.method import Instant
from ggvs_eval.pipelines.online.blending import GeometricBlender
from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided, OnlineOptions
from ggvs_eval.pipelines.online.network_blender import overview
from ggvs_eval.pipelines.online.network_inputs import blend_maps
from helpers.blender_inputs import inputs_of
from helpers.scenes import camera_at, instant, look

TARGET = camera_at(0.0, name="target")
# in the middle of the range, in which inverse depth is even
DEPTH = 2 / (1 / TARGET.near + 1 / TARGET.far)
places = st.lists(st.tuples(st.floats(-3, 3), st.floats(-3, 3)), min_size=1, max_size=6)


def rig(positions: list[tuple[float, float]]) -> list[Camera]:
    """Cameras at these places."""
    return [camera_at(x, y, name=f"cam{number}") for number, (x, y) in enumerate(positions)]


@settings(deadline=None)
@given(places, st.sampled_from((2, 3)), st.tuples(st.integers(0, 40), st.integers(0, 30)))
def test_neither_resolution_nor_crop_changes_a_weight(positions, factor, corner):
    """Twice the pixels, or a window of them: the same weights, bit for bit."""
    cameras, (left, top) = rig(positions), corner
    finer = [camera.resized(factor * camera.width, factor * camera.height) for camera in cameras]
    expected = view_weights(TARGET, cameras)
    np.testing.assert_array_equal(
        view_weights(TARGET.resized(factor * 96, factor * 72), finer), expected
    )
    np.testing.assert_array_equal(
        view_weights(TARGET.cropped(left, top, 40, 30), cameras), expected
    )


@settings(deadline=None)
@given(places, st.floats(0.01, 1000))
def test_the_unit_of_length_does_not_matter(positions, unit):
    """The same rig in metres or in the units of a reconstruction."""
    cameras = rig(positions)

    def rescaled(camera: Camera) -> Camera:
        pose = camera.world_to_camera.copy()
        pose[:3, 3] *= unit
        return replace(camera, world_to_camera=pose, near=camera.near * unit, far=camera.far * unit)

    found = view_weights(rescaled(TARGET), list(map(rescaled, cameras)))
    np.testing.assert_allclose(found, view_weights(TARGET, cameras), rtol=1e-5)


def test_weights_fall_with_the_angle():
    """As a power of the parallax in the middle of the depth range; 1 for the nearest; times the
    shares.
    """
    steps = np.array([1.0, 2.0, 4.0, 500.0])
    cameras = rig(
        [
            (10 * DEPTH * LEAST_PARALLAX_RAD * step - DEPTH * LEAST_PARALLAX_RAD, 0.0)
            for step in steps
        ]
    )
    np.testing.assert_allclose(view_weights(TARGET, cameras), steps**-FALL_OFF, rtol=1e-5)
    shares = (1.0, 0.5, 0.1, 1.0)
    np.testing.assert_allclose(
        view_weights(TARGET, cameras, shares),
        view_weights(TARGET, cameras) * np.float32(shares),
        rtol=1e-6,
    )


@settings(deadline=None)
@given(places, st.floats(-2, 2), st.floats(-1e-4, 1e-4))
def test_weights_are_continuous(positions, x, step):
    """A target that moves a little changes a weight a little, through the very place of a source
    too.
    """
    before, after = (
        view_weights(camera_at(at, name="target"), rig(positions)) for at in (x, x + step)
    )
    assert (
        np.abs(after - before).max()
        <= 2 * FALL_OFF * abs(step) / (DEPTH * LEAST_PARALLAX_RAD) + 1e-6
    )


def half_seen(far_x: float, share: float) -> Instant:
    """A near source that knows nothing of its right half, and one at a distance that sees all of
    the target's view.
    """
    moment = instant(0, TARGET, [camera_at(0.05, name="near"), camera_at(far_x, name="far")])
    near, far = moment.sources
    depth = near.depth.copy()
    depth[:, near.camera.width // 2 :] = 0
    return replace(moment, sources=(replace(near, depth=depth), replace(far, share=share)))


@pytest.mark.parametrize("far_x", [0.1, 0.6, 1.2])
@pytest.mark.parametrize("share", [1.0, 1e-3])
def test_what_one_view_alone_sees_has_its_colour(far_x, share):
    """However far it stands and however little it counts: as bright as the scene, not blended with
    black or a filled hole.
    """
    moment = half_seen(far_x, share)
    truth = look(TARGET)[0] / 255.0
    # right of the near view's knowledge and of the square, within the far one's image
    alone = np.s_[8:-8, 66:80]

    image = (
        GeometryGuided(OnlineOptions(temporal=False, compensated=False), GeometricBlender())
        .step(moment)
        .image
    )

    assert np.abs(image[alone] - truth[alone]).max() < 0.05
    maps = blend_maps(inputs_of(moment), "registered")
    seen = overview(maps, 1)
    assert np.abs(seen.picture[alone] - truth[alone]).max() < 0.05
    assert seen.unseen[alone].max() < 1e-3
    splatted = DistanceBased().step(moment).image
    assert np.abs(splatted[alone] - truth[alone]).max() < 0.1


def test_no_weight_is_too_small_for_a_mean():
    """A view whose weight lies thirteen orders below those of others elsewhere still gives its full
    colour.
    """
    colour, weight = np.full((1, 2, 3), 0.75, np.float32), np.array([[1e-13, 0.0]], np.float32)
    np.testing.assert_allclose(
        weighted_mean([colour], [weight])[0], [[0.75] * 3, [0.0] * 3], rtol=1e-6
    )
