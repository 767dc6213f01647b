"""Stereo pairs of the procedural room: exact disparity, honest visibility, one surface in both
views, a wide range of pairs.
"""

from collections.abc import Iterator
from functools import cache

import cv2
import numpy as np
import pytest

from ggvs_eval.camera import Camera
from ggvs_eval.contrib.training import stereo_pairs
from ggvs_eval.contrib.training.stereo_pairs import (
    StereoRig,
    StereoSample,
    expose_pair,
    find_visible,
    place_rig,
    render,
    stereo_sample,
)
from ggvs_eval.contrib.worlds.domains import FIRST_TRAINING_SEED
from ggvs_eval.contrib.worlds.room import lighting
from ggvs_eval.contrib.worlds.room.lighting import Geometry, Instant
from ggvs_eval.contrib.worlds.room.surfaces import Material, Surface, panel
from ggvs_eval.contrib.worlds.room.textures import plain
from ggvs_eval.errors import DepthError
from helpers.refusals import refused

WIDTH, HEIGHT = 224, 144
SEEDS = [stereo_pairs.SCENES_AT_A_TIME * turn + 1 for turn in range(6)]  # of one scene
WHITE, GREY, BLACK = (Material(plain((tone,) * 3)) for tone in (0.9, 0.5, 0.02))


@pytest.fixture(scope="module", autouse=True)
def _little_light() -> Iterator[None]:
    """An eighth of the rays finds the light that bounces: the same code in less time. Nobody else
    may see its scenes.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lighting, "AMBIENT_DIRECTIONS", 8)
        stereo_pairs._kept_scene.cache_clear()
        yield
        stereo_pairs._kept_scene.cache_clear()


@cache
def clean_sample(seed: int) -> StereoSample:
    return stereo_sample(seed, WIDTH, HEIGHT, sensor=False)


def warped_right(pair: StereoSample, shift: float = 0.0) -> np.ndarray:
    """The right image at the matches of the left pixels."""
    rows, columns = np.mgrid[: pair.disparity.shape[0], : pair.disparity.shape[1]].astype(
        np.float32
    )
    return cv2.remap(
        pair.right.astype(np.float32), columns - pair.disparity - shift, rows, cv2.INTER_CUBIC
    )


def facing_rig(baseline_m: float = 0.2) -> StereoRig:
    """Cameras at the origin that look along y, focal length 100 px, 120 x 80 pixels."""
    axes = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    return StereoRig(np.zeros(3), axes, 100.0, (60.0, 40.0), baseline_m, (120, 80))


def wall(y: float, half_m: float, material: Material = WHITE, shift: float = 0.0) -> Surface:
    """A square across the view at a depth, centred on it."""
    return panel((shift - half_m, y, -half_m), (2 * half_m, 0, 0), (0, 0, 2 * half_m), material)


def evenly_lit(*surfaces: Surface) -> Instant:
    """Surfaces under light of 1 from everywhere."""
    geometry = Geometry(surfaces)
    return Instant(
        geometry, None, np.ones_like(geometry.vertices), np.zeros((0, 3), np.float32), []
    )


@pytest.mark.proof
def test_equal_seeds_give_equal_bits_on_any_number_of_threads():
    """A sample is a function of its arguments alone: also where its scene is laid out and
    lit anew.
    """
    threads = cv2.getNumThreads()
    try:
        cv2.setNumThreads(1)
        first = stereo_sample(3, 160, 96)
        stereo_pairs._kept_scene.cache_clear()
        cv2.setNumThreads(4)
        second = stereo_sample(3, 160, 96)
    finally:
        cv2.setNumThreads(threads)
    for name in ("left", "right", "disparity", "visible"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def test_neighbouring_seeds_take_turns_among_scenes():
    """Seeds of a batch show several scenes, and each scene serves as many pairs as are meant before
    others are lit.
    """
    per_scene, at_a_time = stereo_pairs.PAIRS_PER_SCENE, stereo_pairs.SCENES_AT_A_TIME
    numbers = [stereo_pairs.scene_number(seed) for seed in range(2 * per_scene * at_a_time)]
    assert numbers[: at_a_time + 1] == [*range(at_a_time), 0]
    assert {number: numbers.count(number) for number in numbers} == dict.fromkeys(
        range(2 * at_a_time), per_scene
    )
    assert stereo_pairs.FIRST_SEED > 100 * FIRST_TRAINING_SEED  # nobody else's rooms


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS[:2])
def test_a_rig_sees_what_cameras_see(seed):
    """Points of the left picture lie on one row and a disparity apart by `Camera`; rays of the
    right eye meet what is visible.
    """
    scene = stereo_pairs.scene_of(seed)
    rig, depth = place_rig(scene, np.random.default_rng(seed), 96, 64)
    x, y = rig.positions()
    points = rig.eye + depth.reshape(-1, 1) * rig.rays(x, y)
    K = np.array([[rig.focal_px, 0, rig.centre[0]], [0, rig.focal_px, rig.centre[1]], [0, 0, 1]])
    projected = []
    for eye in (rig.eye, rig.right_eye):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rig.axes, -rig.axes @ eye
        projected.append(Camera("eye", K, pose, 96, 64, 0.1, 100.0).project(points)[0])
    np.testing.assert_allclose(projected[0], np.stack([x.ravel(), y.ravel()], -1), atol=1e-3)
    np.testing.assert_allclose(projected[1][:, 1], y.ravel(), atol=1e-3)
    disparity = rig.focal_px * rig.baseline_m / depth
    np.testing.assert_allclose(
        projected[0][:, 0] - projected[1][:, 0], disparity.ravel(), atol=1e-3
    )
    visible = find_visible(scene.static, rig, depth)
    match = x - disparity
    hits = scene.static.cast(rig.right_eye.astype(np.float32), rig.rays(match, y))
    met = np.full(depth.size, np.inf)
    met[hits.ray] = hits.distance
    share = met.reshape(depth.shape) / depth
    np.testing.assert_array_equal(visible & (match < 0.5), False)
    inside = match >= 0.5
    # What lies within a hundredth of the depth before a point does not hide it; leaves have two
    # sides a millimetre apart.
    assert (share[visible] > 0.985).all()
    assert (share[inside & ~visible] < 0.995).all()
    assert 0.3 < visible.mean() < 1


def test_a_plane_has_the_disparity_of_its_equation():
    """The depth of the slanted plane y = 2 + 0.3 x + 0.2 z is 2 / (1 - 0.3 u + 0.2 v) at (u, v) on
    the plane of depth 1.
    """
    rig = facing_rig()
    corner = np.array([-3.0, 2 + 0.3 * -3 + 0.2 * -3, -3])
    depth = rig.depth(Geometry([panel(corner, (6, 1.8, 0), (0, 1.2, 6), WHITE)]))
    x, y = rig.positions()
    expected = 2 / (1 - 0.3 * (x - 60) / 100 + 0.2 * (y - 40) / 100)
    np.testing.assert_allclose(depth, expected, rtol=1e-5)


def test_a_card_hides_as_many_columns_as_the_disparities_differ():
    """Left of a card the wall is hidden from the right eye over d_card - d_wall columns, and the
    left margin over d_wall.
    """
    # wall at 10 m: 1.8 px; card at 1 m: 18 px, on columns 50 to 69
    rig = facing_rig(baseline_m=0.18)
    geometry = Geometry([wall(10.0, 9.0), wall(1.0, 0.1)])
    depth = rig.depth(geometry)
    visible = find_visible(geometry, rig, depth)
    np.testing.assert_array_equal(np.flatnonzero(depth[40] < 2), np.arange(50, 70))
    np.testing.assert_array_equal(np.flatnonzero(~visible[40]), np.r_[0:2, 34:50])
    np.testing.assert_array_equal(np.flatnonzero(~visible[5]), np.arange(2))


@pytest.mark.slow
def test_the_right_image_is_the_left_image_at_the_disparity():
    """Where the right eye sees a point it shows the left eye's colour, better than a quarter of a
    pixel aside on either side.
    """
    for pair in map(clean_sample, SEEDS):
        visible = pair.visible.astype(np.uint8)
        error = np.abs(warped_right(pair) - pair.left).mean(2)
        assert np.median(error[cv2.erode(visible, np.ones((3, 3))) > 0]) < 1.5
        inner = cv2.erode(visible, np.ones((5, 5))) > 0
        textured = inner & (np.abs(cv2.Sobel(pair.left.mean(2), cv2.CV_64F, 1, 0)) > 16)
        for shift in (-0.25, 0.25):
            aside = np.abs(warped_right(pair, shift) - pair.left).mean(2)
            assert np.mean(error[textured] < aside[textured]) > 0.55


def test_edges_are_smoothed_by_their_coverage():
    """The light that a black card takes from a white wall sums up to its area, and its edge has
    tones between.
    """
    rig = facing_rig()
    scene = evenly_lit(wall(2.0, 3.0), wall(1.0, 0.1637, BLACK, shift=0.021))
    light = render(scene, rig, rig.eye, *rig.positions())[..., 1]
    covered = (light[0, 0] - light) / (light[0, 0] - light.min())
    assert covered.sum() == pytest.approx(32.74**2, rel=0.02)
    assert np.mean((covered > 0.1) & (covered < 0.9)) > 0.004


def test_rows_are_off_and_columns_are_not():
    """A row error of the right picture moves level edges by itself and leaves upright edges in
    their columns.
    """
    rig = facing_rig()
    scene = evenly_lit(
        panel((-3, 2, -3), (3, 0, 0), (0, 0, 3), BLACK),
        panel((0, 2, -3), (3, 0, 0), (0, 0, 3), WHITE),
    )
    x, y = rig.positions()
    straight, off = (render(scene, rig, rig.eye, x, y + error) for error in (0.0, 5.0))
    np.testing.assert_array_equal(np.flatnonzero(straight[60, :, 1] > 0.4), np.arange(60, 120))
    np.testing.assert_allclose(straight[50], off[50], atol=1e-6)
    assert [int(np.argmax(picture[:, 90, 1] > 0.4)) for picture in (straight, off)] == [40, 35]


def test_the_two_cameras_differ():
    """Exposure, noise and blur are each camera's own; without sensors the pictures of one view are
    equal.
    """
    flat = np.full((64, 96, 3), 0.3, np.float32)
    ratios, noises = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        left, right = expose_pair([flat, flat], rng, sensor=True)
        ratios.append(left.mean() / right.mean())
        noises.append(float(left[24:40, 40:56, 1].std()))
        if noises[-1] > 1:
            noise = [picture[24:40, 40:56, 1].ravel().astype(float) for picture in (left, right)]
            assert abs(np.corrcoef(noise)[0, 1]) < 0.3
        np.testing.assert_array_equal(*expose_pair([flat, flat], rng, sensor=False))
    assert 0.5 < min(ratios) < 0.9
    assert 1.1 < max(ratios) < 2
    assert min(noises) < 0.7
    assert max(noises) > 2.5


@pytest.mark.slow
def test_paint_is_changed_but_for_what_shines():
    """No share leaves all materials, the whole share replaces those that send out no light."""
    lamp = Material(plain((0.9, 0.9, 0.9)), emission=1.0)
    geometry = Geometry([wall(1.0, 0.5, GREY), wall(2.0, 0.5, lamp)])
    rng = np.random.default_rng(0)
    assert stereo_pairs.repainted(geometry, rng, 0.0) == [GREY, lamp]
    new, kept = stereo_pairs.repainted(geometry, rng, 1.0)
    assert new in stereo_pairs.skins()
    assert kept is lamp
    assert len({skin.texture.tobytes() for skin in stereo_pairs.skins()}) > 0.8 * stereo_pairs.SKINS


@pytest.mark.slow
def test_pairs_are_of_many_kinds():
    """Small and large disparities, shallow and deep views, much and little that is hidden; all of
    the promised types.
    """
    pairs = [clean_sample(seed) for seed in SEEDS]
    for pair in pairs:
        assert pair.left.shape == pair.right.shape == (HEIGHT, WIDTH, 3)
        assert pair.left.dtype == pair.right.dtype == np.uint8
        assert pair.visible.shape == pair.disparity.shape == (HEIGHT, WIDTH)
        assert (pair.visible.dtype, pair.disparity.dtype) == (bool, np.float32)
        assert 0 < pair.disparity.min() <= pair.disparity.max() <= 0.42 * WIDTH * (1 + 1e-6)
    assert all(np.abs(pair.left.astype(int) - pairs[0].left).mean() > 5 for pair in pairs[1:])
    nearest = np.array([pair.disparity.max() for pair in pairs])
    ratio = nearest / np.array([pair.disparity.min() for pair in pairs])
    hidden = np.array([np.mean(~pair.visible) for pair in pairs])
    assert nearest.min() < 10
    assert nearest.max() > 25
    assert ratio.min() < 4
    assert ratio.max() > 7
    assert hidden.min() < 0.05
    assert hidden.max() > 0.15


def test_a_scene_without_a_place_for_cameras_says_so():
    """Where nothing is in the picture there is no depth to learn from."""
    with refused(DepthError, "96 x 64", "200 attempts"):
        place_rig(evenly_lit(wall(-50.0, 1.0)), np.random.default_rng(0), 96, 64)


@pytest.mark.parametrize(("seed", "width", "height"), [(0, 63, 48), (0, 64, 47), (-1, 64, 48)])
def test_impossible_samples_are_refused(seed, width, height):
    """Too small a picture or a negative seed is refused with what came."""
    with pytest.raises(DepthError, match=rf"{width} x {height}, seed {seed}"):
        stereo_sample(seed, width, height)
