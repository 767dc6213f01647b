"""COLMAP consistency of a path, by COLMAP itself: a true path scores high; shuffled, invented and
frozen images do not.
"""

import numpy as np
import pytest

from ggvs_eval.camera import Camera, translated_path
from ggvs_eval.contrib.more_metrics.colmap_consistency import NAMES, colmap_consistency
from ggvs_eval.errors import MetricError
from ggvs_eval.files.images import quantise
from ggvs_eval.metrics.path.rendered_path import PathPose
from ggvs_eval.metrics.path_scores import score_path
from helpers.epi_scenes import Plane, look
from helpers.refusals import refused

SIZE, FOCAL, VIEWS, SPAN = (160, 120), 80.0, 9, 2.5
SHUFFLED = np.random.default_rng(1).permutation(VIEWS)


@pytest.fixture(scope="module")
def path() -> list[PathPose]:
    """Two slanted textured planes from a camera that moves sideways."""
    K = np.array([[FOCAL, 0, SIZE[0] / 2], [0, FOCAL, SIZE[1] / 2], [0, 0, 1]])
    cameras = translated_path(Camera("middle", K, np.eye(4), *SIZE, 2.0, 8.0), SPAN, VIEWS)
    planes = (Plane(4.0), Plane(2.6, slant=0.3, half_width=0.7, seed=1))
    return [PathPose(camera, quantise(look(planes, camera)[0])) for camera in cameras]


@pytest.mark.slow
def test_a_true_path_is_found_again_and_shuffled_frames_are_not(path):
    """Of the true views all stand where their cameras do; of the same views in another order, a
    third at most.
    """
    true = {
        name: value
        for name, pose, value in score_path(path, metrics=NAMES[:1]).values
        if pose is None
    }
    shuffled = colmap_consistency(
        [path[index].image for index in SHUFFLED], [pose.camera for pose in path]
    )

    assert true["COLMAP_registered"] == 1
    assert true["COLMAP_track_length"] > 5
    assert shuffled.registered <= 1 / 3
    assert shuffled.track_length < true["COLMAP_track_length"] / 2
    assert shuffled.matches < 0.85 * true["COLMAP_matches"]


@pytest.mark.slow
def test_noise_and_a_frozen_image_do_not_score_high(path):
    """Noise has features and no match; a frozen image matches itself and shows nothing from two
    places.
    """
    noise = [
        np.random.default_rng(index).integers(0, 256, (*SIZE[::-1], 3), dtype=np.uint8)
        for index in range(VIEWS)
    ]
    invented, frozen = colmap_consistency(noise), colmap_consistency([path[0].image] * VIEWS)

    assert (invented.registered, invented.track_length, invented.matches, invented.n_points) == (
        0,
        0,
        0,
        0,
    )
    assert (frozen.registered, frozen.track_length, frozen.n_points) == (0, 0, 0)
    assert frozen.matches > 100


@pytest.mark.slow
def test_colmap_runs_only_where_one_of_its_metrics_is_named(path):
    """Seconds are spent on a path only where a protocol asks for what they buy; too short a path
    says so.
    """
    unasked, short = score_path(path), score_path(path[:3], metrics=NAMES)

    assert not set(NAMES) & {*unasked.not_computed, *(name for name, _, _ in unasked.values)}
    assert short.not_computed["COLMAP_registered"] == "COLMAP consistency: 3 views; needs 5"


@pytest.mark.slow
def test_cameras_that_do_not_fit_are_refused(path):
    """Each view has a camera, or none has."""
    with refused(MetricError, "9 views", "2 cameras"):
        colmap_consistency([pose.image for pose in path], [pose.camera for pose in path[:2]])
