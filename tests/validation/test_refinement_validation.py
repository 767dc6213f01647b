"""The proof of refined calibrations: rough ones are rough, and what is written of them is read
back. Not in the wheel.
"""

from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.datasets import open_capture
from ggvs_eval.pipelines.offline.calibration.calibrate import Calibration
from helpers.captures import write_dynerf

refinement = pytest.importorskip(
    "benchmarks.refinement_validation", reason="benchmarks lie beside the package"
)


@pytest.fixture
def row_of_four(tmp_path: Path) -> Capture:
    """Four cameras in a row."""
    return open_capture(write_dynerf(tmp_path / "rig"))


def calibration(cameras: list[Camera]) -> Calibration:
    """Cameras as a calibration finds them."""
    return Calibration(Path(), {camera.name: camera for camera in cameras}, {}, 0.0, 0, {})


def test_knocked_cameras_contradict_each_other(row_of_four: Capture) -> None:
    """Exact cameras agree with exact matches; those that somebody leaned on do not, by pixels and
    not by their whole width.
    """
    rough = refinement.knocked(row_of_four.cameras, seed=1)
    assert refinement.contradiction_px(row_of_four, calibration(list(row_of_four.cameras))) < 1e-6
    assert 0.3 < refinement.contradiction_px(row_of_four, calibration(rough)) < 5
    for one, other in zip(rough, row_of_four.cameras, strict=True):
        assert np.degrees(np.abs(one.rotation - other.rotation).max()) < 5 * refinement.TURN_DEG
        assert one.K[0, 0] == pytest.approx(other.K[0, 0], rel=5 * refinement.ZOOM)


def test_a_rig_is_written_with_the_cameras_that_are_asked_for(
    row_of_four: Capture, tmp_path: Path
) -> None:
    """The written capture has the frames of one and the cameras of the other."""
    rough = refinement.knocked(row_of_four.cameras, seed=2)
    written = open_capture(refinement.write_rig(tmp_path / "rough", row_of_four, rough))
    for camera in rough:
        np.testing.assert_allclose(written.camera(camera.name).K, camera.K, atol=1e-9)
        np.testing.assert_allclose(
            written.camera(camera.name).world_to_camera, camera.world_to_camera, atol=1e-9
        )
        np.testing.assert_array_equal(
            written.frame(camera.name, 0), row_of_four.frame(camera.name, 0)
        )
