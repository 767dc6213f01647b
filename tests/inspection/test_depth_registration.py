"""Edges of sensor depth against those of its colour."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture, Extras
from ggvs_eval.pipelines.inspection.capture.depth_registration import check_depth_registration
from helpers.fitted_footage import StoredFrames

WIDTH, HEIGHT, N_FRAMES = 160, 120, 5


@dataclass(frozen=True)
class StoredDepth:
    """One depth map."""

    depth: np.ndarray
    n_frames: int = 1
    digest: str = "stored"

    def depths(self, start, stop):
        """The map."""
        yield self.depth


def boards(frame: int, right_px: int, down_px: int) -> np.ndarray:
    """Where three boards are before a wall, (H, W)."""
    mask = np.zeros((HEIGHT, WIDTH), bool)
    for column, row in ((20, 15), (70, 50), (110, 20)):
        top, left = row + 3 * frame + down_px, column + 2 * frame + right_px
        mask[top : top + 40, left : left + 30] = True
    return mask


def sequence(shifts: list[tuple[int, int]]) -> Capture:
    """Frames of the boards, each with its depth moved right and down by some pixels."""
    K = np.array([[150.0, 0, WIDTH / 2], [0, 150.0, HEIGHT / 2], [0, 0, 1]])
    cameras, sources, extras = [], [], []
    for frame, shift in enumerate(shifts):
        cameras.append(Camera(f"{frame}", K, np.eye(4), WIDTH, HEIGHT, 0.5, 8.0))
        image = np.where(boards(frame, 0, 0), 200, 60)[None, ..., None].repeat(3, axis=3)
        sources.append(StoredFrames(image.astype(np.uint8)))
        depth = np.where(boards(frame, *shift), 1.0, 3.0).astype(np.float32)
        extras.append(Extras(depth=StoredDepth(depth)))
    parts = tuple(cameras), tuple(sources), 1, 0.0, 1.0, "metres"
    return Capture("boards", "rgbd", Path(), *parts, extras=tuple(extras))


@pytest.mark.parametrize(
    ("shifts", "verdict", "off_px"),
    [
        ([(0, 0)] * N_FRAMES, "ok", 0.0),
        ([(4, -3)] * N_FRAMES, "bad", 5.0),
        ([(4, 0), (-4, 0), (0, 4), (0, -4), (4, 0)], "warn", None),
    ],
)
def test_depth_that_is_off_its_colour_is_found(shifts, verdict, off_px):
    """A common offset is measured, with the way back; frames that are off in different ways are
    said.
    """
    (finding,) = check_depth_registration(sequence(shifts))
    assert finding.verdict == verdict, finding
    if off_px is None:
        assert "differ from frame to frame" in finding.advice
    else:
        assert finding.values["displacement_px"] == pytest.approx(off_px, abs=0.2)
        assert [finding.values["right_px"], finding.values["down_px"]] == pytest.approx(
            [-shifts[0][0], -shifts[0][1]], abs=0.2
        )


def test_boards_without_edges_of_depth_are_unknown():
    """A wall alone, or a rig of sensors, is not measured; a capture without sensors is not
    asked.
    """
    assert check_depth_registration(sequence([(500, 500)] * N_FRAMES))[0].verdict == "unknown"
