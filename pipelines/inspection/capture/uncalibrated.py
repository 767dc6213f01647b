"""Frames without a calibration yet: findings on them, and the next step."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.datasets import calibration_mark, detect_layout
from ggvs_eval.datasets.assemble import assemble_capture
from ggvs_eval.datasets.camera_frames import CameraFrames, find_rig_frames
from ggvs_eval.datasets.units import Units
from ggvs_eval.errors import CaptureError
from ggvs_eval.pipelines.inspection.finding import RIG, Finding

LAYOUT = "no calibration"


def open_uncalibrated(path: Path) -> Capture | None:
    """Open the frames of a folder that is no capture yet; None where it is one, or holds no frames of two cameras.

    A folder that shows a calibration is none of these, though nothing can read it whole.

    The cameras are placeholders at one place, which nothing may be computed from.

    Raises:
        CaptureError: a calibration that cannot be read, or frames that do not fit each other, as those of one capture must.
    """
    try:
        detect_layout(path)
    except CaptureError:
        if calibration_mark(path):
            raise
    else:
        return None
    try:
        files = find_rig_frames(path)
    except CaptureError:
        return None
    return uncalibrated_capture(path, files)


def uncalibrated_capture(path: Path, files: Mapping[str, CameraFrames]) -> Capture:
    """Frames by the names of their cameras as a capture; the cameras are placeholders, see `open_uncalibrated`."""
    cameras = []
    for name, file in files.items():
        width, height = file.size
        K = np.array([[float(width), 0.0, width / 2], [0.0, float(width), height / 2], [0.0, 0.0, 1.0]])
        cameras.append(Camera(name, K, np.eye(4), width, height, 1.0, 2.0))
    return assemble_capture(path, LAYOUT, cameras, list(files.values()), Units(1.0, LAYOUT))


def ask_for_calibration(path: Path, questions: tuple[str, ...]) -> tuple[Finding, ...]:
    """Answer the questions that want poses: how to get them."""
    advice = f"ggvs-eval calibrate {path} RIG, then check RIG"
    return tuple(Finding(RIG, question, "unknown", "no calibration yet", {}, advice) for question in questions)
