"""Refinement of given poses: a carried camera and a fixed rig come back to where they were, in the
given world.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.arrays import Image8
from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.errors import CaptureError
from ggvs_eval.geometry.epipolar import MatchedPair, epipolar_errors
from ggvs_eval.pipelines.offline.calibration.refine_capture import (
    epipolar_residual,
    match_capture,
    refine_cameras,
)
from helpers.textured_rigs import dome_rig, knocked, see_dome, see_straight, straight_rig

pytestmark = pytest.mark.slow  # to load pycolmap takes longer than the work


@dataclass(frozen=True)
class Shots:
    """Pictures of one camera in memory."""

    pictures: Sequence[Image8]
    digest: str = "shots"

    @property
    def n_frames(self) -> int:
        """Number of pictures."""
        return len(self.pictures)

    def frames(self, start: int, stop: int) -> Iterator[Image8]:
        """Give them in order."""
        yield from self.pictures[start:stop]


def carried_camera(rng: np.random.Generator) -> list[Camera]:
    """One camera that is carried along a third of the dome's ring, up and down on the way."""
    return [
        replace(camera, world_to_camera=knocked(camera, rng, 0.03, 0.1).world_to_camera)
        for camera in dome_rig(40)[:14]
    ]


def film(cameras: Sequence[Camera], look: Callable[[Camera], Image8], n_frames: int = 1) -> Capture:
    """A capture of a surface that brightens from frame to frame."""
    pictures = [look(camera) for camera in cameras]
    sources = tuple(
        Shots([(picture * (1 - 0.2 * frame)).astype(np.uint8) for frame in range(n_frames)])
        for picture in pictures
    )
    return Capture(
        "room", "test", Path("room"), tuple(cameras), sources, n_frames, 0.0, 1.0, "test"
    )


def contradiction_px(
    cameras: Sequence[Camera], truth: Sequence[Camera], pairs: Sequence[MatchedPair]
) -> float:
    """Median epipolar error of exact matches, at depths between 1 and 30, under other cameras than
    those that saw them.
    """
    medians = []
    for first, second in {(pair.first, pair.second) for pair in pairs}:
        one, other = truth[first], truth[second]
        depth = np.geomspace(1, 30, one.width * one.height).reshape(one.height, one.width)
        uv = [
            camera.project(one.unproject(one.pixel_centres(), depth))[0][::9, ::7].reshape(-1, 2)
            for camera in (one, other)
        ]
        medians.append(np.median(epipolar_errors(cameras[first], cameras[second], *uv)))
    return float(np.median(medians))


@pytest.mark.parametrize(
    ("rig", "look", "n_frames", "shift"),
    [(carried_camera, see_dome, 1, 0.03), (lambda _: straight_rig(9), see_straight, 3, 0.05)],
    ids=["carried", "fixed rig"],
)
def test_knocked_poses_come_back(rig, look, n_frames, shift):
    """Poses, relative to each other, are five times better; the world with its scale is that of the
    given cameras.
    """
    rng = np.random.default_rng(3)
    truth = rig(rng)
    rough = [knocked(camera, rng, 0.005, shift) for camera in truth]
    capture = replace(film(truth, look, n_frames), cameras=tuple(rough))

    pairs = match_capture(capture)
    refined, _ = refine_cameras(capture.path, capture.cameras, pairs)

    assert len({pair.first for pair in pairs}) > 5
    assert epipolar_residual(rough, pairs) > 1.0
    assert epipolar_residual(refined, pairs) < 0.25
    assert contradiction_px(refined, truth, pairs) < 0.2 * contradiction_px(rough, truth, pairs)
    shifts = [
        np.linalg.norm(camera.centre - true.centre)
        for camera, true in zip(refined, truth, strict=True)
    ]
    assert np.mean(shifts) < 1.5 * shift
    assert [camera.name for camera in refined] == [camera.name for camera in truth]
    assert {(camera.near, camera.far) for camera in refined} == {(truth[0].near, truth[0].far)}


def test_pictures_without_texture_refine_nothing():
    """Cameras that share no points are refused in one line."""
    capture = film(
        straight_rig(3), lambda camera: np.full((camera.height, camera.width, 3), 99, np.uint8)
    )

    assert epipolar_residual(capture.cameras, match_capture(capture)) is None
    with pytest.raises(
        CaptureError, match="room: wanted refined poses, got 0 shared points; use the given ones"
    ):
        refine_cameras(capture.path, capture.cameras, [])
