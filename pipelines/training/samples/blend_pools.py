"""What the blending network learns from: views of procedural rooms and of captures, kept on disk."""

from collections.abc import Sequence
from pathlib import Path

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.pipelines.training.samples.blend_samples import BlendSample, SampleMaker, read_sample, write_sample
from ggvs_eval.pipelines.training.samples.capture_pool import CapturePool
from ggvs_eval.pipelines.training.samples.capture_views import CapturePlan
from ggvs_eval.pipelines.training.samples.room_plan import RoomPlan
from ggvs_eval.pipelines.training.samples.room_pool import RoomPool
from ggvs_eval.pipelines.training.samples.samples import SampleKind

ROOM_VERSION, CAPTURE_VERSION = 4, 2  # each counts up whenever equal plans give other samples


class BlendSampleKind(SampleKind[BlendSample]):
    """The views of the sources in the target, and what the geometric blender makes of them."""

    def make(self, maker: SampleMaker, target: Camera, sources: Sequence[Camera]) -> BlendSample:
        """See `SampleMaker.sample`."""
        return maker.sample(target, sources)

    def cropped(self, sample: BlendSample, left: int, top: int, width: int, height: int) -> BlendSample:
        """A window of all that belongs to the target view."""
        return sample.cropped(left, top, width, height)

    def read(self, path: Path) -> BlendSample:
        """See `read_sample`."""
        return read_sample(path)

    def write(self, path: Path, sample: BlendSample) -> None:
        """See `write_sample`."""
        write_sample(path, sample)


class RoomSamples(RoomPool[BlendSample]):
    """The blending network's samples of a plan, see `RoomPool`.

    Args:
        folder: where rooms and samples are kept.
        plan: which samples.

    Raises:
        TrainingError: seeds of neither training nor validation rooms, or a plan without samples.
    """

    def __init__(self, folder: Path, plan: RoomPlan) -> None:
        super().__init__(folder, plan, BlendSampleKind(), "samples", ROOM_VERSION)


class CaptureSamples(CapturePool[BlendSample]):
    """The blending network's samples of captures, see `CapturePool`.

    Args:
        folder: where samples are kept.
        captures: what to learn from, at their own size.
        plan: which samples.

    Raises:
        TrainingError: a capture that is for tests, too small, given twice, or has too few cameras.
    """

    def __init__(self, folder: Path, captures: Sequence[Capture], plan: CapturePlan) -> None:
        super().__init__(folder, captures, plan, BlendSampleKind(), "captures", CAPTURE_VERSION)
