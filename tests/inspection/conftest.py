"""A rig without fault that all tests of the check share."""

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import pytest

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.pipelines.inspection.capture import pairs
from ggvs_eval.pipelines.inspection.capture.check import CaptureCheck, ExaminedRig, examine
from ggvs_eval.pipelines.inspection.capture.records import CameraRecord
from helpers.small_rig import N_FRAMES, Frames, film, make_cameras, recorded, write_rig

match_pair = cache(pairs.match_pair)


@dataclass(frozen=True)
class FilmedRig:
    """Cameras, their frames, and what a check records of each; nobody changes them."""

    cameras: list[Camera]
    frames: dict[str, Frames]
    records: list[CameraRecord]

    def check(self, cameras: Sequence[Camera] | None = None, **changed: Frames) -> CaptureCheck:
        """The check of the rig with other poses, or with other frames of some cameras."""
        records = [
            recorded(changed[old.name], old.name) if old.name in changed else old
            for old in self.records
        ]
        cameras, sources = (
            tuple(cameras or self.cameras),
            tuple(SimpleNamespace() for _ in self.cameras),
        )
        capture = Capture(
            "rig", "test", Path("rig"), cameras, sources, N_FRAMES, 30.0, 1.0, "guess: 2 m"
        )
        return CaptureCheck(capture.path, examine(ExaminedRig(capture, records)))


@pytest.fixture(scope="session")
def frames() -> dict[str, Frames]:
    """What the cameras of the rig see."""
    return {camera.name: film(camera) for camera in make_cameras()}


@pytest.fixture(scope="session")
def records(frames) -> list[CameraRecord]:
    return [recorded(seen, name) for name, seen in frames.items()]


@pytest.fixture(scope="session")
def filmed(frames, records) -> FilmedRig:
    """The rig without fault; the pictures of its cameras are matched once for all tests."""
    rig = FilmedRig(make_cameras(), frames, records)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pairs, "match_pair", match_pair)
        rig.check()
    return rig


@pytest.fixture(scope="session")
def written_rig(filmed, tmp_path_factory) -> Path:
    """The same on disk, in the layout of DyNeRF."""
    return write_rig(tmp_path_factory.mktemp("check") / "rig", filmed.cameras, filmed.frames)


@pytest.fixture
def rig(written_rig, tmp_path) -> Path:
    """A rig on disk to damage."""
    return Path(shutil.copytree(written_rig, tmp_path / "rig"))


@pytest.fixture(autouse=True)
def _matched_once(monkeypatch) -> None:
    """What was matched before is remembered."""
    monkeypatch.setattr(pairs, "match_pair", match_pair)
