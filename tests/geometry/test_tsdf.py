import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ggvs_eval.camera import Camera
from ggvs_eval.errors import DepthError, GgvsWarning
from ggvs_eval.geometry.tsdf import PreviousDepth, RayMarch, fusion_weights, ray_march
from ggvs_eval.kernels import _core
from helpers.geometry_scenes import (
    TAU,
    WeightedDepth,
    columns,
    moved,
    random_camera,
    random_depth,
    random_previous,
    random_views,
    seeds,
    sizes,
)
from helpers.places import DATA_FOLDER
from helpers.refusals import refused
from helpers.twins.tsdf import fusion_weights_twin, ray_march_twin

ORACLE = DATA_FOLDER / "tsdf_case.npz"


pytestmark = pytest.mark.usefixtures("kernel_settings")


def assert_same_bits(first: RayMarch, second: RayMarch) -> None:
    np.testing.assert_array_equal(first.depth, second.depth)
    np.testing.assert_array_equal(first.weight, second.weight)


def plane_view(camera: Camera, z: float, weight: float = 1.0) -> WeightedDepth:
    shape = (camera.height, camera.width)
    return (camera, np.full(shape, z, dtype=np.float32), np.full(shape, weight, dtype=np.float32))


@settings(deadline=None)
@given(seeds, sizes)
def test_weights_agree_with_their_twin(seed, size):
    """Any image size gives the twin's weights, invalid and outside neighbours included."""
    random = np.random.default_rng(seed)
    depth = random_depth(random, random_camera(random, *size))
    np.testing.assert_allclose(
        fusion_weights(depth, 0.02, 0.001), fusion_weights_twin(depth, 0.02, 0.001), rtol=1e-3
    )


def test_weights_of_a_plane_and_of_a_spike():
    """A flat neighbourhood is trusted fully, a lone spike as little as the formula allows: noise /
    tau.
    """
    depth = np.full((15, 15), 2.0, dtype=np.float32)
    assert fusion_weights(depth, 0.02, 0.001)[7, 7] == 1.0
    depth[7, 7] = 3.0
    assert fusion_weights(depth, 0.02, 0.001)[7, 7] == pytest.approx(
        0.001 / (0.02 * np.sqrt(48 / 49)), rel=1e-5
    )
    depth[7, 7] = 0.0
    assert fusion_weights(depth, 0.02, 0.001)[7, 7] == 0.0


@settings(deadline=None, max_examples=12)
@given(seeds, sizes, sizes, st.integers(1, 3), st.booleans())
def test_march_agrees_with_its_twin(seed, source_size, target_size, count, temporal):
    """Views of any size, with and without a previous frame from another pose, give the twin's
    surface and weight.
    """
    random = np.random.default_rng(seed)
    views, target = random_views(random, source_size, count), random_camera(random, *target_size)
    previous = random_previous(random, target) if temporal else None
    ours, theirs = (
        march(target, *columns(views), tau=TAU, previous=previous)
        for march in (ray_march, ray_march_twin)
    )
    # at pixel borders float32 may sample the neighbouring pixel
    flips = max(0.01, 2 / ours.depth.size)
    assert (np.abs(ours.depth - theirs.depth) > 0.02 * TAU).mean() <= 2 * flips
    assert (np.abs(ours.weight - theirs.weight) > 1e-3 * (1 + theirs.weight)).mean() <= 2 * flips


@settings(deadline=None, max_examples=12)
@given(seeds, sizes, sizes, st.integers(1, 3), st.booleans(), st.floats(0.005, 0.2))
def test_skipping_empty_space_changes_no_bit(seed, source_size, target_size, count, temporal, tau):
    """The march that skips empty slabs gives exactly the full march's result."""
    random = np.random.default_rng(seed)
    views, target = random_views(random, source_size, count), random_camera(random, *target_size)
    previous = random_previous(random, target) if temporal else None
    skipping, full = (
        ray_march(target, *columns(views), tau=tau, previous=previous, skip_empty=skip)
        for skip in (True, False)
    )
    assert_same_bits(skipping, full)


@pytest.mark.parametrize("yaw", [0.0, 1.2, 3.0])
def test_skipping_is_safe_for_sources_beside_and_behind_the_target(yaw):
    """Depth that lies partly behind the target camera is marked too."""
    random = np.random.default_rng(8)
    views = random_views(random, (60, 45), 2)
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]]
    pose[:3, 3] = pose[:3, :3] @ [0.3, 0.0, -1.7]
    target = replace(random_camera(random, 50, 40), world_to_camera=pose, near=0.05)
    assert_same_bits(
        *(ray_march(target, *columns(views), tau=TAU, skip_empty=skip) for skip in (True, False))
    )


@pytest.mark.parametrize("skip_empty", [True, False])
def test_oracle(skip_empty):
    """Plane and sphere seen by three views: hit rate and accuracy of the probe that fixed the
    readings.
    """
    case = np.load(ORACLE)
    cameras = [
        Camera(str(k), case["K"], pose, 128, 96, 0.5, 6.0) for k, pose in enumerate(case["src_w2c"])
    ]
    depths = case["src_depth"].astype(np.float32)
    views = cameras, depths, [fusion_weights(depth, 0.02, 0.001) for depth in depths]
    target = Camera("target", case["K"], case["tgt_w2c"], 128, 96, 1.0, 6.0)
    depth = ray_march(target, *views, tau=0.02, skip_empty=skip_empty).depth
    error = np.abs(depth - case["tgt_depth_gt"])[depth > 0]
    assert (depth > 0).mean() == pytest.approx(0.99772, abs=2e-4)
    assert np.median(error) < 0.135e-3
    assert np.quantile(error, 0.9) < 1.7e-3


def test_plane_is_found_where_it_stands():
    """A plane seen by its own camera is found exactly, with the sum of the weights."""
    camera = random_camera(np.random.default_rng(0), 40, 30)
    march = ray_march(
        camera, *columns([plane_view(camera, 2.0, 0.75), plane_view(camera, 2.0, 0.5)]), tau=TAU
    )
    np.testing.assert_allclose(march.depth, 2.0, atol=1e-4 * TAU)
    np.testing.assert_array_equal(march.weight, np.float32(1.25))


def test_two_views_meet_at_their_weighted_mean():
    """Planes 0.4 tau apart are fused where the weighted clamped distances cancel (Eq. 10)."""
    camera = random_camera(np.random.default_rng(1), 20, 20)
    views = [plane_view(camera, 2.0, 1.0), plane_view(camera, 2.0 + 0.4 * TAU, 3.0)]
    depth = ray_march(camera, *columns(views), tau=TAU).depth
    np.testing.assert_allclose(depth, 2.0 + 0.3 * TAU, atol=1e-3 * TAU)


def test_previous_depth_is_weighted_by_gain_up_to_its_limit():
    """The temporal weight is min(gain * accumulated, eta) of the current ray (Eqs. 13-14); 0 leaves
    the previous depth out.
    """
    camera = random_camera(np.random.default_rng(2), 24, 16)
    shape = (16, 24)
    gain = np.zeros(shape, dtype=np.float32)
    gain[:, 8:16], gain[:, 16:] = 0.5, 100.0
    earlier = np.full(shape, 2.0 + 0.4 * TAU, dtype=np.float32)
    previous = PreviousDepth(camera, earlier, np.full(shape, 2.0, dtype=np.float32), gain, 15.0)
    march = ray_march(camera, *columns([plane_view(camera, 2.0)]), tau=TAU, previous=previous)
    for part, weight in ((slice(0, 8), 0.0), (slice(8, 16), 1.0), (slice(16, 24), 15.0)):
        np.testing.assert_allclose(march.weight[:, part], 1.0 + weight, rtol=1e-6)
        np.testing.assert_allclose(
            march.depth[:, part], 2.0 + 0.4 * TAU * weight / (1 + weight), atol=1e-3 * TAU
        )


def test_previous_depth_follows_a_moving_target():
    """Seen from another pose, the previous depth supports the same surface in the world."""
    before = replace(random_camera(np.random.default_rng(3), 48, 36), world_to_camera=np.eye(4))
    now = moved(before, 0.3)
    shape = (36, 48)
    ones = np.ones(shape, dtype=np.float32)
    march = ray_march(
        now, [], [], [], tau=TAU, previous=PreviousDepth(before, 2 * ones, ones, ones, 15.0)
    )
    seen = march.depth > 0
    shift = round(0.3 * now.K[0, 0] / 2.0)
    assert seen[:, : 48 - shift - 2].all()
    assert not seen[:, 48 - shift + 2 :].any()
    np.testing.assert_allclose(march.depth[seen], 2.0, atol=0.1 * TAU)


def test_nothing_known_is_nothing_found():
    """Invalid depth, zero weight, no view, or a surface outside the depth range give no hit and
    weight 0.
    """
    camera = random_camera(np.random.default_rng(4), 17, 13)
    for views in (
        [],
        [plane_view(camera, 0.0)],
        [plane_view(camera, 2.0, 0.0)],
        [plane_view(camera, 7.0)],
    ):
        march = ray_march(camera, *columns(views), tau=TAU)
        assert not march.depth.any()
        assert not march.weight.any()


def test_a_surface_entered_from_behind_is_no_hit():
    """A view from the other side does not stop a ray at the back of its surface."""
    camera = random_camera(np.random.default_rng(5), 21, 21)
    turned = np.diag([-1.0, 1.0, -1.0, 1.0])
    turned[2, 3] = 4.0
    opposite = replace(camera, world_to_camera=turned)
    assert not ray_march(
        replace(camera, world_to_camera=np.eye(4)), *columns([plane_view(opposite, 2.0)]), tau=TAU
    ).depth.any()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"tau": 0.0}, "tau must be positive"),
        ({"tau": float("nan")}, "tau must be positive"),
        ({"tau": 1e-6}, "wanted steps above rounding at the near depth"),
        ({"min_step": 0.0}, "min_step must be positive"),
        ({"min_step": 0.9}, "min_step must not exceed step_fraction"),
    ],
)
def test_a_march_that_would_not_end_is_refused(change, message):
    """Steps of no length are an error, not an endless loop."""
    camera = random_camera(np.random.default_rng(7), 8, 8)
    with pytest.raises(DepthError, match=message):
        ray_march(camera, *columns([plane_view(camera, 2.0)]), **({"tau": TAU} | change))


@pytest.mark.parametrize("far", [2500.0, 1e6])
def test_a_loose_far_bound_changes_nothing(far):
    """By the paper's constants a march ends after 2 km: a surface at 2 m is found all the same, as
    printed too.
    """
    near = replace(random_camera(np.random.default_rng(7), 8, 8), near=1.9)
    view, loose = plane_view(near, 2.0), replace(near, far=far)
    constants = {"tau": 0.02, "min_step": 0.1}
    expected = ray_march(near, *columns([view]), **constants).depth
    assert (expected > 0).all()
    np.testing.assert_array_equal(ray_march(loose, *columns([view]), **constants).depth, expected)


def test_known_depth_beyond_the_end_of_a_march_is_told():
    """A surface 3 km away is unreachable by steps of 2 mm, and a warning names both; nearer ones
    are no matter.
    """
    loose = replace(random_camera(np.random.default_rng(7), 8, 8), near=1.9, far=1e6)
    with pytest.warns(GgvsWarning, match=r"beyond 2000 world units .* steps of 0\.002"):
        assert not ray_march(loose, *columns([plane_view(loose, 3000.0)]), tau=0.02).depth.any()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ray_march(loose, *columns([plane_view(loose, 2.0)]), tau=0.02)


def test_a_surface_at_the_far_depth_is_not_found():
    """One that lies before it by more than the smallest step is."""
    camera = replace(random_camera(np.random.default_rng(7), 8, 8), far=2.0)
    camera = replace(camera, world_to_camera=np.eye(4))
    found = [
        (ray_march(camera, *columns([plane_view(camera, z)]), tau=0.1).depth > 0).any()
        for z in (1.98, 2.0)
    ]
    assert found == [True, False]


def test_shapes_that_do_not_fit_are_refused():
    """Depth, weight and gain must have the size of their cameras; the error names both."""
    camera = random_camera(np.random.default_rng(8), 8, 6)
    good, bad = np.ones((6, 8), dtype=np.float32), np.ones((8, 6), dtype=np.float32)
    for view in ((camera, bad, good), (camera, good, bad)):
        with refused(DepthError, "6 x 8", "(8, 6)"):
            ray_march(camera, *columns([view]), tau=TAU)
    with refused(DepthError, "gain", "6 x 8"):
        ray_march(
            camera, [], [], [], tau=TAU, previous=PreviousDepth(camera, good, good, bad, 15.0)
        )
    with pytest.raises(DepthError, match="wanted a depth image"):
        fusion_weights(np.ones(5, dtype=np.float32), TAU, 0.001)
    with refused(DepthError, "at most 32", "got 33"):
        ray_march(camera, [camera] * 33, [good] * 33, [good] * 33, tau=TAU)
    with refused(DepthError, "depth and weights", "2, 2, 1"):
        ray_march(camera, [camera] * 2, [good] * 2, [good], tau=TAU)


def test_the_kernel_converts_nothing():
    """Below the Python face a wrong dtype or layout is a TypeError that names both sides."""
    with refused(TypeError, "depth", "float32 (5, 4)", "float64 (5, 4)"):
        _core.fusion_weights(np.ones((5, 4)), 0.02, 0.001, 1, 0)
    with pytest.raises(TypeError, match="not C-contiguous"):
        _core.fusion_weights(np.ones((4, 5), dtype=np.float32).T, 0.02, 0.001, 1, 0)
