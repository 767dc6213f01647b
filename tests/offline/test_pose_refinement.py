"""Bundle adjustment with a prior: it stays where all fits, and finds the minimum that a general
optimiser finds.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from ggvs_eval.pipelines.offline.calibration.pose_refinement import FREEDOMS, Rig, cost, most_likely
from helpers.captures import make_rig


@dataclass(frozen=True)
class Pinhole:
    """What is asked of a camera of COLMAP, which stays out of this process: it breaks the writing
    of PNG files.
    """

    focal_px: float
    principal_point_x: float
    principal_point_y: float

    def img_from_cam(self, points: np.ndarray) -> np.ndarray:
        """Project points of the camera's frame, (N, 3)."""
        middle = np.array([self.principal_point_x, self.principal_point_y])
        return self.focal_px * points[:, :2] / points[:, 2:] + middle


def seen_rig(
    rng: np.random.Generator, n_points: int, noise_px: float, knock: float
) -> tuple[Rig, np.ndarray]:
    """Four cameras that see the same points; they are known with an error of so many of the prior's
    standard deviations.
    """
    cameras = make_rig(width=640, height=480)
    points = np.column_stack(
        [rng.uniform(-1, 2, n_points), rng.uniform(-1, 1, n_points), rng.uniform(3, 6, n_points)]
    )
    deviations = np.tile([0.004] * 3 + [0.005] * 3 + [0.005] + [2.0] * 2, (len(cameras), 1))
    camera, point = (index.ravel() for index in np.indices((len(cameras), n_points)))
    uv = np.concatenate([view.project(points)[0] for view in cameras]) + noise_px * rng.normal(
        size=(len(camera), 2)
    )
    errors = knock * rng.normal(size=(len(cameras), 6)) * deviations[:, :6]
    turns = Rotation.from_rotvec(errors[:, :3]).as_matrix() @ [view.rotation for view in cameras]
    centres = np.array([view.centre for view in cameras]) + errors[:, 3:]
    lenses = tuple(Pinhole(view.K[0, 0], view.K[0, 2], view.K[1, 2]) for view in cameras)
    rough_points = points + 0.01 * knock * rng.normal(size=points.shape)
    return Rig(lenses, turns, centres, deviations, camera, point, uv), rough_points


def test_what_fits_stays():
    """Exact cameras and features leave nothing to change."""
    rig, points = seen_rig(np.random.default_rng(0), 30, noise_px=0.0, knock=0.0)
    np.testing.assert_allclose(most_likely(rig, points)[0], 0, atol=1e-6)


@pytest.mark.slow
def test_the_minimum_is_that_of_a_general_optimiser():
    """Noisy features, one grossly wrong: BFGS does not get below our minimum, neither from it nor
    from the start.
    """
    rig, points = seen_rig(np.random.default_rng(0), 10, noise_px=0.5, knock=1.0)
    rig.uv[5] += (40.0, -25.0)
    shape = len(rig.lenses), FREEDOMS

    def cost_of(values: np.ndarray) -> float:
        return cost(
            rig,
            values[: np.prod(shape)].reshape(shape),
            values[np.prod(shape) :].reshape(points.shape),
        )

    ours = np.concatenate([part.ravel() for part in most_likely(rig, points)])
    start = np.concatenate([np.zeros(np.prod(shape)), points.ravel()])
    assert cost_of(ours) < 0.5 * cost_of(start)
    assert cost_of(ours) == pytest.approx(
        min(minimize(cost_of, begin, method="BFGS").fun for begin in (ours, start)), rel=1e-3
    )


def test_knocked_cameras_come_back():
    """Many exact features bring cameras twice as wrong as the prior expects back to where they
    stand to each other.
    """
    rig, points = seen_rig(np.random.default_rng(3), 200, noise_px=0.0, knock=2.0)
    _, centres = rig.moved(most_likely(rig, points)[0])
    true = np.diff([view.centre for view in make_rig()], axis=0)
    before, after = (np.abs(np.diff(each, axis=0) - true).max() for each in (rig.centres, centres))
    assert after < 0.5 * before
