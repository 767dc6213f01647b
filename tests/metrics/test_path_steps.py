"""Reprojection error between neighbouring poses and the switch score: closed forms, and what is
refused.
"""

import cv2
import numpy as np
import pytest

from ggvs_eval.errors import MetricError
from ggvs_eval.files.images import quantise
from ggvs_eval.metrics.path.rendered_path import StepError, reprojection_steps
from ggvs_eval.metrics.path.view_consistency import (
    mean_reprojection,
    switch_score,
    switch_steps,
    warping_error,
)
from helpers.epi_scenes import FOCAL, SCENES, WALL, WIDTH, changed, exact, look, path, rendered
from helpers.refusals import refused


def triples(poses):
    return [(pose.camera, pose.image, pose.depth) for pose in poses]


@pytest.mark.parametrize("name", SCENES)
def test_reprojection_of_exact_renderings_is_rounding_and_interpolation(name):
    """Exact images carried to the next pose differ by little more than rounding (1/3 grey level),
    over all but the rim.
    """
    mean = mean_reprojection(reprojection_steps(triples(exact(name))))
    assert 0.2 < mean.error_255 < 0.7
    assert mean.shift_px < 0.05
    assert 0.97 < mean.visible_share < 1.0


def test_reprojection_error_of_a_gain_is_that_gain():
    """Poses that alternate between two brightnesses 10 levels apart differ by 10 at every step."""
    poses = changed(
        rendered(WALL, path(6, 0.2)),
        lambda index, image: 0.1 + 0.8 * image + (index % 2) * 10 / 255,
    )
    steps = reprojection_steps(triples(poses))
    assert [step.error_255 for step in steps] == pytest.approx([10.0] * 5, abs=0.1)


def test_warping_error_is_the_mean_squared_colour_difference():
    """10 levels of 255 at every step; and between two images of one pose what numpy's mean of
    squares says, blurred ones less.
    """
    poses = changed(
        rendered(WALL, path(4, 0.2)),
        lambda index, image: 0.1 + 0.8 * image + (index % 2) * 10 / 255,
    )
    assert warping_error(triples(poses)) == pytest.approx(1000 * (10 / 255) ** 2, rel=0.03)

    camera, _, depth = triples(poses)[0]
    noise = np.random.default_rng(0).integers(0, 256, (2, *depth.shape, 3), dtype=np.uint8)
    expected = 1000 * np.square((noise[0] / 255.0 - noise[1] / 255.0)[1:-1, 1:-1]).mean()
    assert warping_error([(camera, image, depth) for image in noise]) == pytest.approx(
        expected, rel=0.01
    )
    soft = [(camera, cv2.GaussianBlur(image, (0, 0), 2), depth) for image in noise]
    assert warping_error(soft) < expected / 10


def test_reprojection_does_not_compare_what_one_pose_cannot_see():
    """Background that the square covers in the other pose takes no part: painting the square black
    leaves the error small.
    """
    planes = SCENES["two planes"]
    cameras = path(3, 0.6)
    poses = []
    for camera in cameras:
        image, depth = look(planes, camera)
        poses.append((camera, quantise(np.where(depth[..., None] < 3, 0.0, image)), depth))
    with_test = mean_reprojection(reprojection_steps(poses))
    without = mean_reprojection(reprojection_steps(poses, depth_tolerance=9.0))
    assert with_test.error_255 < 1.5 < 4 * with_test.error_255 < without.error_255
    covered_px = FOCAL * 0.3 * (1 / 2.6 - 1 / 4.0)
    assert without.visible_share - with_test.visible_share == pytest.approx(
        covered_px / WIDTH, rel=0.15
    )


def test_switch_score_is_the_ratio_of_means():
    """Twice the change at switches is a ratio of 2 and an excess of the difference; steps without a
    value do not count.
    """
    sources = ["ab", "ba", "bc", "bc", "cb", "cd"]
    assert switch_steps(sources) == [False, True, False, False, True]
    score = switch_score([2.0, 4.0, None, 2.0, 4.0], sources)
    assert (score.ratio, score.excess_255, score.n_switches, score.n_steps) == (2.0, 2.0, 2, 4)
    assert switch_score([0.0, 0.1, 0.0, 0.0, 0.0], sources).ratio == 1.0


def test_switch_score_says_why_there_is_none():
    """A path without a switch, one that switches at every step and a wrong number of steps are
    refused in words.
    """
    with refused(MetricError, "no switch", "3 poses"):
        switch_score([1.0, 1.0], ["ab", "ba", "ab"])
    with refused(MetricError, "every step"):
        switch_score([1.0, 1.0], ["ab", "bc", "cd"])
    with refused(MetricError, "no step"):
        switch_score([1.0, None], ["ab", "ab", "cd"])
    with refused(MetricError, "2 steps", "3 errors"):
        switch_score([1.0, 1.0, 1.0], ["ab", "bc", "cd"])


def test_reprojection_refuses_what_it_cannot_compare():
    """One pose, no depth, shapes that do not fit, poses that see nothing in common and no texture
    are refused in one line.
    """
    for measure, message in (
        (lambda: reprojection_steps(triples(exact("wall"))[:1]), "at least 2 poses"),
        (
            lambda: reprojection_steps(
                [(camera, image, None) for camera, image, _ in triples(exact("wall"))]
            ),
            "no depth",
        ),
        (
            lambda: reprojection_steps([(c, i, d[1:]) for c, i, d in triples(exact("wall"))]),
            "wanted depths >= 0",
        ),
        (lambda: mean_reprojection([StepError(None, 0.0, None, None)] * 3), "at none of 3 steps"),
        (lambda: mean_reprojection([StepError(0.0, 1.0, 0.0, 0.0)]), "wanted images with texture"),
        (
            lambda: warping_error(
                [(*pose[:2], 0 * pose[2]) for pose in triples(exact("wall"))[:2]]
            ),
            "E_warp: at no step do the",
        ),
    ):
        with pytest.raises(MetricError, match=message) as caught:
            measure()
        assert "\n" not in str(caught.value)


def test_a_step_without_a_common_surface_has_no_error():
    """Depths that contradict each other everywhere leave nothing to compare: no error, and a
    visible share of 0.
    """
    poses = triples(exact("wall")[:3])
    poses[1] = (*poses[1][:2], poses[1][2] * np.float32(1.2))
    steps = reprojection_steps(poses)
    assert steps == [StepError(None, 0.0, None, None)] * 2
    assert reprojection_steps(triples(exact("wall")[:2]))[0].error_255 is not None
