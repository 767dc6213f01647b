"""Lines in epipolar plane images, their coherence and their slope: closed forms, laws, and what is
refused.
"""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.path.epi_metrics import (
    HorizontalPath,
    epi_coherence,
    find_lines,
    horizontal_path,
    slope_agreement,
)
from helpers.epi_scenes import FOCAL, POSES, SPAN, WALL, exact, path, rendered
from helpers.refusals import refused

STEP = SPAN / (POSES - 1)


def stripes(slope, poses=9, width=160, period_px=11.0):
    """An EPI whose lines all have one slope, float in [0, 1]."""
    v, x = np.mgrid[:poses, :width].astype(float)
    wave = np.sin((x - slope * v) * 2 * math.pi / period_px)
    return 0.5 + 0.3 * np.stack([wave, -wave, wave**2], axis=-1)


def epis_of(poses):
    images, depths = (
        np.stack([pose.image for pose in poses]),
        np.stack([pose.depth for pose in poses]),
    )
    return [(images[:, row], depths[:, row]) for row in range(images.shape[1])]


def coherence_of(poses):
    return epi_coherence(
        (epi for epi, _ in epis_of(poses)), horizontal_path([pose.camera for pose in poses])
    )


@pytest.mark.parametrize("slope", [-9.3, -2.5, -1.0, -0.37, 0.0, 0.5, 1.49, 6.8])
def test_lines_have_the_slope_they_were_drawn_with(slope):
    """Straight lines of any slope, far steeper than a pixel per pose too, are found within 0.01 px
    and have no change along.
    """
    lines = find_lines(stripes(slope), (slope - 1.3, slope + 1.7))
    assert np.abs(lines.slope_px - slope).max() < 0.01
    assert lines.along.sum() < 1e-4 * lines.across.sum()


def test_the_slope_of_a_line_stays_in_the_range_asked_for():
    """Where no allowed slope fits, the nearest one stands, and the change along it is (difference x
    gradient)^2.
    """
    lines = find_lines(stripes(1.0), (1.3, 1.4))
    assert np.unique(lines.slope_px) == pytest.approx(1.3)
    assert lines.along.sum() == pytest.approx(0.3**2 * lines.across.sum(), rel=0.02)


def test_coherence_and_line_texture_of_lines_with_a_known_change():
    """Lines 0.3 px per pose beside the nearest allowed slope: along = 0.09 across gives (1 - 0.09)
    / (1 + 0.09).
    """
    measured = epi_coherence([stripes(1.0)], HorizontalPath(5.2, near=3.0, far=3.2))
    across = find_lines(stripes(1.0), (1.0, 1.0)).across.mean()
    assert measured.coherence == pytest.approx(0.91 / 1.09, abs=0.003)
    assert measured.line_texture_255 == pytest.approx(math.sqrt(0.91 * across), rel=0.02)


def test_energy_across_is_that_of_the_smoothed_derivative():
    """A ramp of 2 grey levels per pixel has the energy 4, whatever its kind of number."""
    ramp = np.tile((2.0 * np.arange(100))[None, :, None], (6, 1, 3))
    assert find_lines(ramp / 255, (-0.2, 0.2)).across == pytest.approx(4.0, rel=1e-4)
    assert find_lines(ramp.astype(np.uint8), (-0.2, 0.2)).across == pytest.approx(4.0, rel=1e-4)


def test_path_predicts_the_slope_of_a_projected_point():
    """The slope at a depth is how far a point at that depth moves between two poses' images;
    unknown depth has none.
    """
    cameras = path()
    point = np.array([0.2, 0.1, 3.3])
    (u0, _), (u1, _) = (camera.project(point)[0] for camera in cameras[7:9])
    slopes = horizontal_path(cameras).slope_px(np.array([3.3, 0.0], np.float32))
    assert slopes.tolist() == pytest.approx([u1 - u0, 0.0], abs=1e-6)
    assert u1 < u0
    low, high = horizontal_path(cameras).slope_range_px
    assert (low, high) == pytest.approx((-FOCAL * STEP / 2.0, -FOCAL * STEP / 8.0))


@pytest.mark.parametrize(
    ("name", "least", "agreeing"),
    [
        ("wall", 0.995, 0.99),
        pytest.param("slanted", 0.995, 0.98, marks=pytest.mark.slow),
        ("two planes", 0.96, 0.9),
    ],
)
def test_exact_renderings_are_near_ideal(name, least, agreeing):
    """Exact images have straight lines of the predicted slope; occlusion edges cost a little, the
    median nothing.
    """
    poses = exact(name)
    slopes = slope_agreement(epis_of(poses), horizontal_path([pose.camera for pose in poses]))
    assert least < coherence_of(poses).coherence <= 1.0
    assert slopes.median_error_px < 0.005
    assert slopes.agreeing_share > agreeing
    assert slopes.measured_share > 0.95


def test_wide_steps_are_as_coherent_as_narrow_ones():
    """Lines that move 5 px per pose, where derivatives alias, are as straight as those that move 1
    px.
    """
    assert coherence_of(rendered(WALL, path(7, 6 * 0.18))).coherence > 0.99


def test_a_flash_is_no_line():
    """Uniform brightness that changes from pose to pose scores -1, though its EPI is a perfect
    one-dimensional structure.
    """
    levels = np.random.default_rng(0).uniform(0, 255, POSES)
    ramp = 0.5 * np.arange(128)
    epi = np.repeat((levels[:, None] * 0.7 + ramp)[..., None], 3, axis=2).astype(np.uint8)
    assert epi_coherence([epi], horizontal_path(path())).coherence < -0.99


def test_a_path_that_makes_no_epi_is_refused():
    """Too few poses, a turn, a climb, a dolly, uneven steps and standing still are refused with
    what was found.
    """
    cameras = path()
    with refused(MetricError, "5 poses", "has 4"):
        horizontal_path(cameras[:4])
    for change, message in (
        (
            lambda pose, v: pose.__setitem__(
                (slice(0, 3), slice(0, 3)), cv2.Rodrigues(np.array([0, 0.01 * v, 0]))[0]
            ),
            "orientation",
        ),
        (lambda pose, v: pose.__setitem__((1, 3), 0.01 * v), "leave their row by up to"),
        (lambda pose, v: pose.__setitem__((2, 3), 0.01 * v), "leave their row by up to"),
        (lambda pose, v: pose.__setitem__((0, 3), -0.002 * v**2), "steps differ by"),
        (lambda pose, v: pose.__setitem__((0, 3), 0.0), "got no displacement"),
    ):
        poses = []
        for v, camera in enumerate(cameras):
            pose = camera.world_to_camera.copy()
            change(pose, v)
            poses.append(replace(camera, world_to_camera=pose))
        with pytest.raises(MetricError, match=message):
            horizontal_path(poses)


def test_measures_refuse_what_they_cannot_measure():
    """No texture, no depth, shapes that do not fit, too few poses and too wide slopes are refused
    in one line, never NaN.
    """
    geometry, grey = horizontal_path(path()), np.full((9, 128, 3), 90, np.uint8)
    depth = np.full((9, 128), 4.0, np.float32)
    for measure, message in (
        (lambda: epi_coherence([], geometry), "no epipolar plane image"),
        (lambda: epi_coherence([grey], geometry), "an image without texture has no lines"),
        (lambda: slope_agreement([(grey, 0 * depth)], geometry), "no depth along the path"),
        (lambda: slope_agreement([(grey, depth[:, 1:])], geometry), "wanted one depth per pixel"),
        (lambda: find_lines(grey[:4], (0.0, 1.0)), "poses >= 5"),
        (lambda: find_lines(grey, (0.0, 30.0)), "too many for an image 128 px wide"),
    ):
        with pytest.raises(MetricError, match=message) as caught:
            measure()
        assert "\n" not in str(caught.value)


def test_slopes_are_compared_at_their_own_pixel():
    """Depth outside the inner poses and columns has no vote, and a single known depth inside is
    compared right there.
    """
    geometry = HorizontalPath(-4.0, near=2.0, far=8.0)
    epi, depth = stripes(-1.0), np.zeros((9, 160), np.float32)
    first_column = find_lines(epi, (-3.0, 1.0)).first_column
    depth[[0, 1, -2, -1]] = depth[:, :first_column] = depth[:, -first_column:] = 4.0
    depth[2:-2, first_column:-first_column] = 0.0
    with pytest.raises(MetricError, match="no depth along the path"):
        slope_agreement([(epi, depth)], geometry)
    for pose, column in ((2, first_column), (6, 159 - first_column)):
        one = depth.copy()
        one[pose, column] = 4.0
        slopes = slope_agreement([(epi, one)], geometry)
        assert (slopes.median_error_px, slopes.predicted_px) == pytest.approx((0.0, 1.0), abs=0.01)


def test_without_texture_no_slope_agrees():
    """Where no line can be measured, flat or noise, the shares are 0 and there is no median."""
    noise = np.random.default_rng(0).integers(0, 256, (9, 128, 3)).astype(np.uint8)
    for epi in (np.full_like(noise, 90), noise):
        slopes = slope_agreement(
            [(epi, np.full((9, 128), 4.0, np.float32))], horizontal_path(path())
        )
        assert slopes.agreeing_share < 0.05
        assert slopes.measured_share < 0.1
    assert (
        slope_agreement(
            [(np.full_like(noise, 90), np.ones((9, 128), np.float32))], horizontal_path(path())
        ).median_error_px
        is None
    )


def test_tolerance_and_texture_of_the_slope_are_options():
    """A depth that is wrong by 5 % everywhere gives its slope error as the median, and agrees only
    within a wider tolerance.
    """
    poses = exact("wall")
    geometry = horizontal_path(path())
    wrong = [(epi, depth * np.float32(1.05)) for epi, depth in epis_of(poses)]
    error_px = FOCAL * STEP / 4.0 * (1 - 1 / 1.05)
    strict = slope_agreement(wrong, geometry, 0.5 * error_px)
    wide = slope_agreement(wrong, geometry, 2 * error_px)
    assert strict.median_error_px == pytest.approx(error_px, abs=0.005)
    assert strict.agreeing_share < 0.1 < 0.9 < wide.agreeing_share
    assert (
        slope_agreement(wrong, geometry, least_texture_255=15.0).measured_share
        < wide.measured_share
    )
