"""A capture to learn from, reduced to the size of its samples; captures for tests are refused."""

import json
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Literal

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.contrib.training.samples.capture_views import CapturePlan, draw_views, is_sequence, possible_targets
from ggvs_eval.contrib.worlds.domains import FIRST_TRAINING_SEED, VALIDATION_SEEDS
from ggvs_eval.datasets.units import DEMO_NOTES
from ggvs_eval.errors import TrainingError
from ggvs_eval.files.digest import digest_values
from ggvs_eval.pipelines.offline.depth.depth_choice import DepthRunOptions


class CaptureSource:
    """The views of a capture; it is whatever `open_capture` opens: ScanNet, Spaces, DyNeRF, one's own rig.

    A test capture must never be trained on: none of those that the packaged protocols name test views of, nor any other that
    results are reported for. Only the demo capture and its likes can be recognised here, and are refused.

    Raises:
        TrainingError: a capture that is for tests, too small, or has too few cameras.
    """

    origin: Literal["captures"] = "captures"

    def __init__(self, capture: Capture, plan: CapturePlan) -> None:
        _refuse_tests(capture)
        _check_cameras(capture, plan)
        self.name = _name(capture)
        self.plan = plan
        self.capture = _reduced(capture, plan)
        self.count, self.most_views, self.least_size = plan.targets, plan.views, (plan.width, plan.height)
        self.matcher = plan.matcher

    def __repr__(self) -> str:
        """Scene and plan, for the model card; the path is not recorded."""
        return f"{self.capture.scene}: {self.plan!r}"

    def contents(self, depth: bool) -> str:
        """See `SampleSource`."""
        how = f"depth as measured or by {self.plan.matcher}" if depth else "no depth"
        return f"{self.count} views of the captures {self.capture.scene}, {how}"

    def describe(self, depth: bool) -> dict[str, object]:
        """See `SampleSource`."""
        options = DepthRunOptions(self.plan.matcher).options()
        return {
            "plan": {name: value for name, value in asdict(self.plan).items() if name != "targets"},
            "depth": options.describe() if depth else None,
            "sensor": options.sensor.describe() if depth and options.sensor else None,
            "consistency": options.consistency.describe() if depth and options.consistency else None,
        }

    def file_name(self, number: int) -> str:
        """See `SampleSource`."""
        return f"{self.name}-{number:04d}.npz"

    def groups(self) -> list[list[int]]:
        """Numbers of one instant of a rig together; frames of a sequence share too little depth to be kept."""
        targets, instants = self.plan.targets, self.plan.instants
        if is_sequence(self.capture):
            return [[number] for number in range(targets)]
        return [list(range(first, targets, instants)) for first in range(min(instants, targets))]

    def opened(self, folder: Path, number: int) -> Capture:
        """The capture itself."""
        return self.capture

    def frame(self, number: int) -> int:
        """Turn by turn one of the evenly spaced instants."""
        return round((number % self.plan.instants + 0.5) / self.plan.instants * self.capture.n_frames - 0.5)

    def draw(self, capture: Capture, number: int) -> tuple[Camera, list[Camera]]:
        """See `draw_views`."""
        return draw_views(capture, self.plan, self.name, number)

    def kept(self, number: int) -> None:
        """All of it."""


def capture_sources(captures: Iterable[Capture], plan: CapturePlan) -> list[CaptureSource]:
    """Captures to learn from, by one plan.

    Raises:
        TrainingError: a capture given twice, or one that cannot be learned from, see `CaptureSource`.
    """
    sources = [CaptureSource(capture, plan) for capture in captures]
    if len({source.name for source in sources}) < len(sources):
        listed = ", ".join(str(source.capture.path) for source in sources)
        raise TrainingError(f"captures to learn from: wanted each once, got {listed}")
    return sources


def _reduced(capture: Capture, plan: CapturePlan) -> Capture:
    """The capture as small as the plan allows, in its own shape."""
    width, height = capture.cameras[0].size
    share = max(plan.width / width, plan.height / height)
    return capture.resized(round(width * share), round(height * share), "area")


def _check_cameras(capture: Capture, plan: CapturePlan) -> None:
    small = [camera for camera in capture.cameras if camera.width < plan.width or camera.height < plan.height]
    if small:
        size = f"{small[0].width} x {small[0].height} of {small[0].name}"
        raise TrainingError(
            f"{capture.path}: wanted images of at least {plan.width} x {plan.height}, got {size}; lower the plan's"
        )
    if len({camera.size for camera in capture.cameras}) > 1:
        raise TrainingError(f"{capture.path}: wanted cameras of one size to learn from, got several; resize the images")
    if plan.instants > capture.n_frames:
        raise TrainingError(f"{capture.path}: wanted {plan.instants} instants, the capture has {capture.n_frames} frames")
    if not possible_targets(capture, plan):
        rule = f" numbered {plan.gap + 1}..{plan.span} from it" if is_sequence(capture) else ""
        raise TrainingError(
            f"{capture.path}: wanted a target with {plan.views} other cameras{rule}, got {len(capture.cameras)} cameras and none "
            "with as many; lower the plan's views or give more frames"
        )


def _refuse_tests(capture: Capture) -> None:
    """A procedural capture says which room it shows; all but training and validation rooms are for tests."""
    file = capture.path / DEMO_NOTES
    if not file.is_file():
        return
    try:
        seed = int(json.loads(file.read_text(encoding="utf-8"))["options"]["seed"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise TrainingError(f"{file}: wanted the seed of a demo capture, got none ({error}); write it again") from error
    if seed < FIRST_TRAINING_SEED and seed not in VALIDATION_SEEDS:
        raise TrainingError(
            f"{capture.path}: the demo capture of seed {seed} is for tests and must not be learned from; make another by "
            f"`ggvs-eval demo --seed {FIRST_TRAINING_SEED}`"
        )


def _name(capture: Capture) -> str:
    """Tells captures apart by the poses of their cameras and what the first one shows."""
    cameras = [f"{camera.name} {camera.to_json()}" for camera in capture.cameras]
    return f"{capture.scene}-{digest_values(capture.sources[0].digest, str(capture.n_frames), *cameras)[:12]}"
