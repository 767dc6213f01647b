"""Planted defects along a rendered camera path: each moves its own measures, and the others stay
about where they were.
"""

import weakref
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.path import rendered_path
from ggvs_eval.metrics.path.epi_metrics import COHERENCE_NAMES as COHERENCE
from ggvs_eval.metrics.path.epi_metrics import SLOPE_NAMES as SLOPE
from ggvs_eval.metrics.path.rendered_path import PathPose, spread_rows
from ggvs_eval.metrics.path.view_consistency import REPROJECTION_NAMES as REPROJECTION
from ggvs_eval.metrics.path.view_consistency import SWITCH_NAMES as SWITCH
from ggvs_eval.metrics.path.view_consistency import switch_steps
from ggvs_eval.metrics.path_scores import score_path
from helpers.epi_scenes import POSES, SCENES, changed, exact, path, rendered, sources_of
from helpers.refusals import refused

SWITCHES = np.array(switch_steps([sources_of(camera) for camera in path()]))
EVERY_SCENE = pytest.mark.parametrize(
    "name", ["wall", pytest.param("slanted", marks=pytest.mark.slow), "two planes"]
)


def measured(poses):
    return {name: value for name, pose, value in score_path(poses).values if pose is None}


@cache
def truth_of(name):
    return measured(exact(name))


def jumping(steps, apply):
    """A defect that is on from each of these steps to the next of them."""
    on = np.concatenate([[0], np.cumsum(steps)]) % 2
    return lambda index, image: apply(image) if on[index] else image


def brighter(image):
    return image + 6 / 255


def moved(image):
    """Half a pixel to the right: texture that jumps, colour on average the same."""
    return cv2.warpAffine(
        image, np.array([[1, 0, 0.5], [0, 1, 0]]), image.shape[1::-1], borderMode=cv2.BORDER_REFLECT
    )


def wobble(share=0.03):
    return 1 + share * np.random.default_rng(4).uniform(-1, 1, POSES)


@EVERY_SCENE
def test_exact_path_is_near_ideal_in_every_measure(name):
    """An exact rendering: straight lines of the right slope, errors of rounding, and switches like
    all other steps.
    """
    scores = score_path(exact(name))
    values = truth_of(name)
    assert scores.not_computed == {}
    assert set(values) == {*COHERENCE, *SLOPE, *REPROJECTION, *SWITCH, "E_warp", "path_sharpness"}
    assert scores.n_switches == SWITCHES.sum() == 3
    assert values["EPI_coherence"] > 0.96
    assert values["EPI_slope_error"] < 0.005
    assert values["reprojection"] < 0.7
    assert values["switch_ratio"] == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(
    ("name", "apply"),
    [
        ("wall", moved),
        pytest.param("slanted", brighter, marks=pytest.mark.slow),
        ("two planes", moved),
    ],
)
def test_a_jump_at_the_switches_raises_the_switch_score(name, apply):
    """A jump of colour or texture where the cameras switch multiplies the score; the same jump
    elsewhere does not raise it.
    """
    truth = truth_of(name)
    at_switches = measured(changed(exact(name), jumping(SWITCHES, apply)))
    elsewhere = measured(changed(exact(name), jumping(np.roll(SWITCHES, 2), apply)))
    assert at_switches["switch_ratio"] > 5 * truth["switch_ratio"]
    assert at_switches["switch_excess"] > 3 > 0.1 > truth["switch_excess"]
    assert elsewhere["switch_ratio"] < truth["switch_ratio"]
    assert elsewhere["switch_excess"] < truth["switch_excess"]


@EVERY_SCENE
def test_a_jump_at_the_switches_leaves_the_other_measures(name):
    """Three jumps along 24 steps hardly touch the measures that look at all steps, and these ignore
    where the jumps are.
    """
    truth = truth_of(name)
    at_switches, elsewhere = (
        measured(changed(exact(name), jumping(steps, brighter)))
        for steps in (SWITCHES, np.roll(SWITCHES, 2))
    )
    assert at_switches["EPI_coherence"] > truth["EPI_coherence"] - 0.05
    assert at_switches["EPI_slope_error"] < truth["EPI_slope_error"] + 0.015
    assert at_switches["reprojection"] == pytest.approx(
        truth["reprojection"] + 6 * 3 / 24, abs=0.15
    )
    for measure, tolerance in (
        ("EPI_coherence", 0.01),
        ("EPI_slope_error", 0.01),
        ("reprojection", 0.05),
    ):
        assert at_switches[measure] == pytest.approx(elsewhere[measure], abs=tolerance)


@pytest.mark.slow
@EVERY_SCENE
def test_wobbling_depth_bends_the_lines(name):
    """Poses rendered with depths that wobble by up to 3 % lose coherence and slope agreement and
    gain reprojection error.
    """
    truth, wobbling = truth_of(name), measured(rendered(SCENES[name], depth_factors=wobble()))
    assert wobbling["EPI_coherence"] < truth["EPI_coherence"] - 0.2
    assert wobbling["EPI_slope_error"] > 5 * truth["EPI_slope_error"]
    assert wobbling["EPI_slope_agreeing"] < 0.7 * truth["EPI_slope_agreeing"]
    assert wobbling["reprojection"] > 5 * truth["reprojection"]
    assert wobbling["reprojection_shift"] > 5 * truth["reprojection_shift"]
    assert wobbling["switch_ratio"] < 3
    assert wobbling["EPI_line_texture"] < truth["EPI_line_texture"]


@EVERY_SCENE
def test_blur_does_not_win(name):
    """Blurring every image alike is view-consistent, and yet no rank is won by it: less of each
    image lies on lines.
    """
    truth = truth_of(name)
    for sigma in (0.7, 3.0):
        blurred = measured(
            changed(
                exact(name), lambda _, image, sigma=sigma: cv2.GaussianBlur(image, (0, 0), sigma)
            )
        )
        assert blurred["EPI_line_texture"] < 0.95 * truth["EPI_line_texture"]
        assert blurred["EPI_coherence"] < truth["EPI_coherence"] + 0.005
        assert blurred["EPI_slope_agreeing"] < truth["EPI_slope_agreeing"] + 0.001
        assert blurred["reprojection_shift"] > truth["reprojection_shift"]
        assert blurred["switch_ratio"] == pytest.approx(truth["switch_ratio"], abs=0.15)


@EVERY_SCENE
def test_a_frozen_image_does_not_score_well(name):
    """One image along the whole path: its slopes are wrong by the whole parallax, none agrees, and
    it does not fit depth.
    """
    truth = truth_of(name)
    frozen = measured([replace(pose, image=exact(name)[12].image) for pose in exact(name)])
    assert frozen["EPI_slope_error"] == pytest.approx(1.1, abs=0.2)
    assert frozen["EPI_slope_agreeing"] < 0.01
    assert frozen["EPI_coherence"] < truth["EPI_coherence"] - 0.2
    assert frozen["reprojection"] > 10 * truth["reprojection"]


def test_what_cannot_be_measured_says_why():
    """Without depth, sources, texture or a straight path the rest is measured, and each missing
    number has its reason.
    """
    poses = exact("wall")
    bare = score_path([PathPose(pose.camera, pose.image) for pose in poses])
    assert {name for name, _, _ in bare.values} == {*COHERENCE, "path_sharpness"}
    assert set(bare.not_computed) == {*SLOPE, *REPROJECTION, *SWITCH, "E_warp"}
    assert "0 of 25 poses have a depth" in bare.not_computed["EPI_slope_error"]
    assert "no depth" in bare.not_computed["reprojection"]
    assert "wanted the source cameras of each pose" in bare.not_computed["switch_ratio"]
    one_set = score_path([replace(pose, sources=("a", "b")) for pose in poses])
    assert "no switch on this path" in one_set.not_computed["switch_ratio"]
    assert set(one_set.not_computed) == set(SWITCH)
    uneven = score_path(poses[:12] + poses[14:])
    assert set(uneven.not_computed) == {*COHERENCE, *SLOPE}
    assert "use equal steps" in uneven.not_computed["EPI_coherence"]
    grey = score_path([replace(pose, image=np.full_like(pose.image, 128)) for pose in poses])
    assert set(grey.not_computed) == {*COHERENCE, "EPI_slope_error", *REPROJECTION}
    assert ("EPI_slope_agreeing", None, 0.0) in grey.values
    assert all(
        np.isfinite(value)
        for scores in (bare, one_set, uneven, grey)
        for _, _, value in scores.values
    )


def test_images_that_do_not_fit_their_cameras_are_refused():
    """No pose, a wrong size and a change of size are errors, as they are for every metric."""
    poses = list(exact("wall"))
    with pytest.raises(MetricError, match="no poses to score"):
        score_path([])
    with refused(MetricError, "path0000", "32 x 128 x 3"):
        score_path([replace(poses[0], image=poses[0].image[1:])])
    half = poses[1].camera.resized(64, 16)
    with refused(MetricError, "one size"):
        score_path([poses[0], PathPose(half, np.zeros((16, 64, 3), np.uint8))])


def test_a_path_streams(monkeypatch):
    """Two images at most are alive at a time, and only the rows asked for are kept of the
    others.
    """
    images: list[weakref.ref] = []
    most_alive = 0

    def stream():
        nonlocal most_alive
        for pose in exact("wall"):
            image = pose.image.copy()
            images.append(weakref.ref(image))
            most_alive = max(most_alive, sum(reference() is not None for reference in images))
            yield replace(pose, image=image)
            del image

    monkeypatch.setattr(rendered_path, "N_ROWS", 8)
    scores = score_path(stream())
    assert scores.rows == (2, 6, 10, 14, 18, 22, 26, 30) == tuple(spread_rows(32, 8))
    assert spread_rows(3, 128) == [0, 1, 2]
    assert most_alive <= 3  # the one that is made, and two poses
