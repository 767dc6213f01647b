"""The procedural stereo scenes: exact disparity, honest visibility, the same surface in both views, a wide range of scenes."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ggvs_eval.errors import DepthError
from ggvs_eval.synthetic.stereo.stereo_builder import SceneBuilder, axes_across, rotation
from ggvs_eval.synthetic.stereo.stereo_masks import mask_bank
from ggvs_eval.synthetic.stereo.stereo_render import draw_view, visible_on_the_right
from ggvs_eval.synthetic.stereo.stereo_scenes import StereoOptions, StereoSample, stereo_sample
from ggvs_eval.synthetic.stereo.stereo_sensor import SensorOptions, expose_pair
from ggvs_eval.synthetic.stereo.stereo_shapes import Ball, Sheet
from ggvs_eval.synthetic.stereo.stereo_textures import LEVELS, SIDE, sample, texture_bank
from ggvs_eval.synthetic.stereo.stereo_tubes import Tubes

pytestmark = pytest.mark.slow

WIDTH, HEIGHT = 224, 144
PLAIN = StereoOptions(gloss=False, sensor=False)
PERFECT = SensorOptions(exposure=1, hard_exposure=1, blur_px=0, noise=0, row_shift_px=0, jpeg_share=0)


@cache
def plain_sample(seed: int) -> StereoSample:
    return stereo_sample(seed, WIDTH, HEIGHT, PLAIN)


def builder(seed: int = 0) -> SceneBuilder:
    return SceneBuilder(np.random.default_rng(seed), texture_bank(), 120, 80, 100.0, (57.0, 41.5), gloss=False)


def painted(colour: float, maker: SceneBuilder):
    """A look of one grey."""
    return replace(maker.look(), gain=np.zeros(3), bias=np.full(3, colour), grain_strength=0.0)


def draw(maker: SceneBuilder):
    scene = maker.scene()
    scene = replace(scene, light=replace(scene.light, ambient=1.0, direction=np.array([0.0, 1.0, 0.0]), dapple_strength=0.0))
    return tuple(draw_view(scene, texture_bank(), 120, 80, eye) for eye in (0.0, 1.0))


def warped_right(drawn: StereoSample, shift: float = 0.0) -> np.ndarray:
    """The right image at the matches of the left pixels."""
    rows, columns = np.mgrid[: drawn.disparity.shape[0], : drawn.disparity.shape[1]].astype(np.float32)
    return cv2.remap(drawn.right.astype(np.float32), columns - drawn.disparity - shift, rows, cv2.INTER_CUBIC)


def test_equal_seeds_give_equal_bits_on_any_number_of_threads():
    """A sample is a function of its arguments alone."""
    threads = cv2.getNumThreads()
    try:
        cv2.setNumThreads(1)
        first = stereo_sample(5, 160, 96)
        cv2.setNumThreads(4)
        second = stereo_sample(5, 160, 96)
    finally:
        cv2.setNumThreads(threads)
    for name in ("left", "right", "disparity", "visible", "right_disparity"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def test_seeds_give_different_scenes():
    """Another seed is another scene, also beyond 32 bits."""
    pictures = [stereo_sample(seed, 96, 64).left for seed in (5, 6, 2**40, 2**40 + 1)]
    differences = [np.abs(a.astype(int) - b).mean() for k, a in enumerate(pictures) for b in pictures[:k]]
    assert min(differences) > 5


@pytest.mark.parametrize("seed", range(24))
def test_every_pixel_has_a_possible_disparity(seed):
    """Shapes and types are as promised; disparities are finite, positive and below the limit, hidden pixels included."""
    drawn = stereo_sample(seed, 160, 96)
    assert drawn.left.shape == drawn.right.shape == (96, 160, 3)
    assert drawn.left.dtype == drawn.right.dtype == np.uint8
    assert drawn.visible.shape == (96, 160)
    assert drawn.visible.dtype == bool
    for disparity in (drawn.disparity, drawn.right_disparity):
        assert disparity.shape == (96, 160)
        assert disparity.dtype == np.float32
        assert np.isfinite(disparity).all()
        assert disparity.min() > 0.4
        assert disparity.max() <= 0.4 * 160


def test_the_warped_right_image_is_the_left_image():
    """Where the right eye sees a point it shows the left eye's colour, but for resampling; one pixel aside it does not."""
    at_match, beside = [], []
    for seed in range(12):
        drawn = plain_sample(seed)
        inner = cv2.erode(drawn.visible.astype(np.uint8), np.ones((3, 3))) > 0
        error = np.abs(warped_right(drawn) - drawn.left).mean(2)[inner]
        assert np.median(error) < 1.5
        assert np.mean(error < 12) > 0.93
        at_match.append(np.mean(error))
        beside.append(np.mean(np.abs(warped_right(drawn, 1.0) - drawn.left).mean(2)[inner]))
    assert np.mean(at_match) < 1.5
    assert np.mean(beside) > 3 * np.mean(at_match)


def test_the_disparity_is_exact_to_a_fraction_of_a_pixel():
    """The best match of the images lies at the stated disparity, not beside it, on whatever side."""
    for shift in (-0.25, 0.25):
        better = []
        for seed in range(8):
            drawn = plain_sample(seed)
            inner = cv2.erode(drawn.visible.astype(np.uint8), np.ones((5, 5))) > 0
            textured = inner & (np.abs(cv2.Sobel(drawn.left.mean(2), cv2.CV_64F, 1, 0)) > 16)
            exact, aside = (np.abs(warped_right(drawn, s) - drawn.left).mean(2)[textured] for s in (0.0, shift))
            better.append(np.mean(exact < aside))
        assert min(better) > 0.55
        assert np.mean(better) > 0.7


def test_a_plane_has_the_disparity_it_was_given():
    """The disparity of a plane is linear in the pixel, in closed form, in both views."""
    maker = builder()
    maker.add_plane(20.0, 0.05, -0.08, maker.look(), (60.0, 40.0))
    left, right = draw(maker)
    rows, columns = np.mgrid[:80, :120]
    expected = 20 + 0.05 * (columns - 60) - 0.08 * (rows - 40)
    np.testing.assert_allclose(left.disparity, expected, atol=1e-4)
    # On the right x' = x - d, so that d = (20 + 0.05 (x' - 60) - 0.08 (y - 40)) / (1 - 0.05).
    on_the_right = (20 + 0.05 * (columns - 60) - 0.08 * (rows - 40)) / 0.95
    np.testing.assert_allclose(right.disparity, on_the_right, atol=1e-4)


def test_a_card_hides_as_many_columns_as_the_disparities_differ():
    """Left of a card the wall is hidden from the right eye over d_card - d_wall columns, and the left margin over d_wall."""
    maker = builder()
    maker.add_plane(6.0, 0, 0, painted(0.8, maker), (60, 40))
    maker.rng = np.random.default_rng(1)
    centre = maker.point(70, 40, 21.0)
    maker._add(Sheet(centre, np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), 10.2 / 21, 10.2 / 21), painted(0.1, maker), 21.0)
    left, right = draw(maker)
    visible = visible_on_the_right(left, right)
    row = visible[40]
    card = np.flatnonzero(left.disparity[40] > 20)
    assert card.min() == 60
    assert card.max() == 80
    assert row[card].all()
    np.testing.assert_array_equal(np.flatnonzero(~row), np.r_[0:6, 45:60])
    np.testing.assert_array_equal(np.flatnonzero(~visible[5]), np.arange(6))


def test_visible_means_consistent_from_left_to_right():
    """Visible pixels find their own disparity beside their match on the right; hidden ones find something nearer."""
    for seed in range(8):
        drawn = plain_sample(seed)
        columns = np.arange(WIDTH) - drawn.disparity
        floor, ceiling, nearest = (
            np.take_along_axis(drawn.right_disparity, np.clip(f(columns), 0, WIDTH - 1).astype(int), 1)
            for f in (np.floor, np.ceil, np.rint)
        )
        agrees = (np.abs(floor - drawn.disparity) <= 1) | (np.abs(ceiling - drawn.disparity) <= 1)
        # The rest is thinner than a pixel, or a face that the right eye sees from its edge.
        assert np.mean(agrees[drawn.visible]) > 0.99
        assert not (columns[drawn.visible] < 0).any()
        hidden = ~drawn.visible & (columns >= 0)
        assert (nearest[hidden] > drawn.disparity[hidden] + 1).all()
        assert np.mean(nearest[drawn.visible] > drawn.disparity[drawn.visible] + 1) < 0.005
        assert 0.3 < drawn.visible.mean() < 1


def test_edges_are_smoothed_by_their_coverage():
    """The darkness of a small turned card on a white wall sums up to its area, and its edge has tones between."""
    maker = builder()
    maker.add_plane(4.0, 0, 0, painted(0.8, maker), (60, 40))
    turn = rotation(np.array([0, 0, 0.3]))
    maker._add(Sheet(maker.point(60, 40, 8.0), turn[:, 0], turn[:, 1], 12 / 8, 7 / 8), painted(0.0, maker), 8.0)
    left, _ = draw(maker)
    covered = 1 - left.image[..., 0] / left.image[0, 0, 0]
    assert covered.sum() == pytest.approx(24 * 14, rel=0.01)
    assert np.mean((covered > 0.1) & (covered < 0.9)) > 0.004
    plain = (left.disparity > 6).sum()
    assert abs(covered.sum() - 24 * 14) <= abs(plain - 24 * 14) + 2


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    radii=st.tuples(*[st.floats(0.1, 2)] * 3),
    turn=st.tuples(*[st.floats(-2, 2)] * 3),
    place=st.tuples(st.floats(-2, 2), st.floats(-1, 1), st.floats(5, 60)),
    eye=st.sampled_from([0.0, 1.0]),
)
def test_rays_meet_ellipsoids_on_their_front(radii, turn, place, eye):
    """Each meeting lies on the ellipsoid, its normal faces the eye, and the box of its bounds holds all of them."""
    ball = Ball(np.array(place), rotation(np.array(turn)), np.array(radii))
    left, right, top, bottom = ball.bounds(eye)
    x = np.linspace(left - 0.01, right + 0.01, 41).astype(np.float32)
    y = np.linspace(top - 0.01, bottom + 0.01, 41).astype(np.float32)
    inverse = ball.cast(x[None], y[:, None], eye)
    assert (inverse > 0).any()
    rows, columns = np.nonzero(inverse)
    assert x[columns].min() >= left
    assert x[columns].max() <= right
    assert y[rows].min() >= top
    assert y[rows].max() <= bottom
    z = 1 / inverse[rows, columns]
    points = np.stack([x[columns] * z + eye, y[rows] * z, z])
    level = ball.axes @ (points - np.array(place)[:, None]) / np.array(radii)[:, None]
    np.testing.assert_allclose((level**2).sum(0), 1, atol=2e-3)
    _, _, normal = ball.surface(points.astype(np.float32))
    assert ((normal * (points - [[eye], [0], [0]])).sum(0) < 2e-2 * z).all()


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    ends=st.tuples(*[st.tuples(st.floats(-2, 2), st.floats(-1, 1), st.floats(4, 40))] * 2),
    radius=st.floats(0.02, 0.8),
    eye=st.sampled_from([0.0, 1.0]),
)
def test_rays_meet_tubes_at_their_radius(ends, radius, eye):
    """Each meeting lies a radius from the tube's axis, and the box of its bounds holds all of them."""
    start, end = (np.array(point) for point in ends)
    length = float(np.linalg.norm(end - start))
    axis = (end - start) / max(length, 1e-9) if length > 1e-6 else np.array([0, 0, 1.0])
    tubes = Tubes(start[None], axis[None], np.array([length]), np.array([radius]))
    left, right, top, bottom = tubes.boxes(eye)[0]
    x, y = (
        a.ravel() for a in np.meshgrid(np.linspace(left - 0.02, right + 0.02, 61), np.linspace(top - 0.02, bottom + 0.02, 61))
    )
    inverse = tubes.cast(x.astype(np.float32), y.astype(np.float32), eye, np.zeros(len(x), int))
    hit = inverse > 0
    assert ((x[hit] >= left) & (x[hit] <= right) & (y[hit] >= top) & (y[hit] <= bottom)).all()
    z = 1 / inverse[hit]
    local = np.stack([x[hit] * z + eye, y[hit] * z, z], 1) - start
    along = np.clip(local @ axis, 0, length)
    np.testing.assert_allclose(np.linalg.norm(local - along[:, None] * axis, axis=1), radius, atol=2e-3 * radius + 2e-4)
    # A ray to the nearer end's centre meets the round end in front of it.
    nearest = min((start, end), key=lambda point: point[2])
    ray = (nearest - [eye, 0, 0])[:2] / nearest[2]
    met = tubes.cast(*(np.array([a], np.float32) for a in ray), eye, np.zeros(1, int))
    assert 1 / met[0] < nearest[2]


def test_bent_sheets_are_met_where_they_bend():
    """Newton's steps end on the bent surface, and both eyes see the same surface."""
    axis_u, axis_v = axes_across(np.array([0.2, -0.1, 0.97]) / np.linalg.norm([0.2, -0.1, 0.97]))
    waves = np.array([[0.2, 1.1, 0.4, 0.3], [0.1, -0.6, 1.7, 2.0]])
    sheet = Sheet(np.array([0.5, 0.0, 12.0]), axis_u, axis_v, waves=waves)
    x, y = (a.ravel().astype(np.float32) for a in np.meshgrid(np.linspace(-0.5, 0.5, 50), np.linspace(-0.3, 0.3, 30)))
    for eye in (0.0, 1.0):
        z = 1 / sheet.cast(x, y, eye)
        local = np.stack([x * z + eye, y * z, z], 1) - sheet.centre
        u, v, height = local @ axis_u, local @ axis_v, local @ np.cross(axis_u, axis_v)
        expected = sum(a * np.sin(b * u + c * v + d) for a, b, c, d in waves)
        np.testing.assert_allclose(height, expected, atol=1e-4)
        assert np.std(height) > 0.1


def test_coarse_levels_are_averages():
    """Where a pixel covers sixteen texels the look-up gives the mean of sixteen by sixteen."""
    chain = texture_bank().colours[3]
    centre = np.array([16.0 * 5 + 8], np.float32)
    found = sample(chain, centre, centre, np.array([16.0], np.float32))
    np.testing.assert_allclose(found[0], chain[80:96, 80:96].mean((0, 1)), atol=1.5)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(u=st.floats(-3000, 3000), v=st.floats(-3000, 3000), level=st.floats(0, LEVELS))
def test_textures_continue_mirrored(u, v, level):
    """A texture repeats after twice its side, and is its own mirror image at its border."""
    chain = texture_bank().greys[0]
    footprint = np.array([2**level], np.float32)
    values = [
        float(sample(chain, np.array([a], np.float32), np.array([v], np.float32), footprint)[0])
        for a in (u, -u, u + 2 * SIDE, 2 * SIDE - u)
    ]
    # float32 positions of some thousand texels are good to a few thousandths, cv2.remap to a thirty-second of a texel.
    assert np.ptp(values) < 8


def test_outlines_have_a_clear_border_and_thin_bars_first():
    """No outline touches its border; lattices and wheels come first and are mostly air."""
    masks = mask_bank()
    assert len(masks) == 64
    for mask in masks:
        assert mask[[0, -1]].max() == mask[:, [0, -1]].max() == 0
        assert mask.max() > 200
    thickest = [cv2.distanceTransform((mask > 127).astype(np.uint8), cv2.DIST_L2, 3).max() for mask in masks[:16]]
    assert np.median(thickest) < 20


def test_the_sensor_never_moves_columns():
    """A vertical edge stays in its column in all rows of both pictures, whatever the rectification error; level edges move."""
    options = replace(PERFECT, row_shift_px=1.0)
    upright = np.full((60, 80, 3), 60, np.float32)
    upright[:, 40:] = 180
    level = np.full((60, 80, 3), 60, np.float32)
    level[30:] = 180
    moved = []
    for seed in range(6):
        for picture in expose_pair(upright, upright, np.random.default_rng(seed), options):
            step = np.diff(picture[..., 1].astype(int), axis=1)
            assert (step.argmax(1) == 39).all()
            assert np.abs(np.delete(step, 39, 1)).max() <= 3
        left, right = expose_pair(level, level, np.random.default_rng(seed), options)
        assert (np.diff(left[..., 1].astype(int), axis=0).argmax(0) == 29).all()
        moved.append(np.diff(right[..., 1].astype(int), axis=0).max(0).min())
    assert min(moved) < 0.8 * 120  # an edge between two rows is blurred by the displacement


def test_the_two_cameras_differ():
    """Exposure, noise and blur are each camera's own; without a sensor the views are equal but for rounding."""
    grey = np.full((64, 96, 3), 120, np.float32)
    ratios, noises = [], []
    for seed in range(30):
        left, right = expose_pair(grey, grey, np.random.default_rng(seed), SensorOptions())
        ratios.append(left[24:40, 40:56].mean() / right[24:40, 40:56].mean())
        noises.append(left[24:40, 40:56, 1].std())
        if noises[-1] > 1:
            noise = [picture[24:40, 40:56, 1].ravel().astype(float) for picture in (left, right)]
            assert abs(np.corrcoef(noise)[0, 1]) < 0.3
    assert 0.5 < min(ratios) < 0.93
    assert 1.07 < max(ratios) < 2
    assert min(noises) < 0.7
    assert max(noises) > 2.5


def test_scenes_are_of_many_kinds():
    """Over 32 seeds: small and large disparities, shallow and deep scenes, thin things, bare walls, hidden parts."""
    drawn = [plain_sample(seed) for seed in range(32)]
    nearest = np.array([s.disparity.max() for s in drawn])
    ratio = nearest / np.array([s.disparity.min() for s in drawn])
    assert nearest.min() < 14
    assert nearest.max() > 0.3 * WIDTH
    assert np.min(ratio) < 2
    assert np.max(ratio) > 6
    # Thin: in front of its surroundings over less than seven columns.
    thin = [np.mean(s.disparity > 1.1 * cv2.morphologyEx(s.disparity, cv2.MORPH_OPEN, np.ones((1, 7)))) > 0.003 for s in drawn]
    assert np.mean(thin) > 0.5
    bare = []
    for s in drawn:
        grey = s.left.mean(2)
        spread = np.sqrt(np.maximum(cv2.blur(grey**2, (9, 9)) - cv2.blur(grey, (9, 9)) ** 2, 0))
        bare.append(np.mean(spread < 2))
    assert np.mean(np.array(bare) > 0.2) > 0.2
    assert np.mean(np.array(bare) < 0.05) > 0.1
    hidden = np.array([np.mean(~s.visible) for s in drawn])
    assert hidden.min() < 0.08
    assert hidden.max() > 0.25


def test_gloss_differs_between_the_eyes():
    """With gloss on, some scenes look different to the two eyes where both see a point."""
    differences = []
    for seed in range(16):
        shiny = stereo_sample(seed, WIDTH, HEIGHT, replace(PLAIN, gloss=True))
        np.testing.assert_array_equal(shiny.disparity, plain_sample(seed).disparity)
        differences.append(np.abs(warped_right(shiny) - shiny.left).mean(2)[shiny.visible].mean())
    plain = [np.abs(warped_right(s) - s.left).mean(2)[s.visible].mean() for s in map(plain_sample, range(16))]
    assert np.max(np.array(differences) - plain) > 0.5


@pytest.mark.parametrize(("seed", "width", "height"), [(0, 63, 48), (0, 64, 47), (-1, 64, 48)])
def test_impossible_samples_are_refused(seed, width, height):
    """Too small a picture or a negative seed is refused with what came."""
    with pytest.raises(DepthError, match=rf"{width} x {height}, seed {seed}"):
        stereo_sample(seed, width, height)


@pytest.mark.parametrize("change", [{"least_disparity_px": 0.0}, {"max_disparity_px": 5.0}, {"depth_ratio": 1.0}])
def test_impossible_options_are_refused(change):
    """Ranges that hold nothing are refused."""
    with pytest.raises(DepthError, match="least_disparity_px"):
        StereoOptions(**change)
