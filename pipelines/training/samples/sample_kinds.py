"""The two kinds of samples, of rooms and of captures: what the blending network sees, and what the baselines are shown."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.method import Instant, SourceView
from ggvs_eval.pipelines.training.samples.blend_samples import BlendSample, SampleMaker, read_sample, write_sample
from ggvs_eval.pipelines.training.samples.capture_pool import CapturePool
from ggvs_eval.pipelines.training.samples.capture_views import CapturePlan
from ggvs_eval.pipelines.training.samples.room_plan import RoomPlan
from ggvs_eval.pipelines.training.samples.room_pool import RoomPool
from ggvs_eval.pipelines.training.samples.samples import SampleKind
from ggvs_eval.training.instant_samples import InstantSample, read_instant, write_instant

# Each counts up whenever equal plans give other samples.
BLEND_ROOM_VERSION, BLEND_CAPTURE_VERSION = 4, 2
INSTANT_ROOM_VERSION, INSTANT_CAPTURE_VERSION = 1, 1


@dataclass(frozen=True)
class BlendSampleKind(SampleKind[BlendSample]):
    """The views of the sources in the target, and what the geometric blender makes of them.

    Attributes:
        device: where they are splatted and warped.
    """

    device: str = "cpu"

    def make(self, maker: SampleMaker, target: Camera, sources: Sequence[Camera]) -> BlendSample:
        """See `SampleMaker.sample`."""
        return maker.sample(target, sources, self.device)

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
        device: where they are computed, see `SampleKind`.

    Raises:
        TrainingError: seeds of neither training nor validation rooms, or a plan without samples.
    """

    def __init__(self, folder: Path, plan: RoomPlan, device: str = "cpu") -> None:
        super().__init__(folder, plan, BlendSampleKind(device), "samples", BLEND_ROOM_VERSION)


class CaptureSamples(CapturePool[BlendSample]):
    """The blending network's samples of captures, see `CapturePool`.

    Args:
        folder: where samples are kept.
        captures: what to learn from, at their own size.
        plan: which samples.
        device: where they are computed, see `SampleKind`.

    Raises:
        TrainingError: a capture that is for tests, too small, given twice, or has too few cameras.
    """

    def __init__(self, folder: Path, captures: Sequence[Capture], plan: CapturePlan, device: str = "cpu") -> None:
        super().__init__(folder, captures, plan, BlendSampleKind(device), "captures", BLEND_CAPTURE_VERSION)


@dataclass(frozen=True)
class InstantKind(SampleKind[InstantSample]):
    """Samples for methods: what a method is shown, and the image that the target's camera took.

    Attributes:
        depth: whether sources come with depth; methods that take none need not wait for it.
    """

    depth: bool = True

    def make(self, maker: SampleMaker, target: Camera, sources: Sequence[Camera]) -> InstantSample:
        """The instant with the depth of `SampleMaker.instant`, or with none."""
        if self.depth:
            return InstantSample(maker.instant(target, sources), maker.truth(target))
        views = []
        for source in sources:
            unknown = np.zeros((source.height, source.width), np.float32)
            views.append(SourceView(source, maker.truth(source), unknown, unknown))
        return InstantSample(Instant(0, target, tuple(views), maker.capture.units_per_metre), maker.truth(target))

    def cropped(self, sample: InstantSample, left: int, top: int, width: int, height: int) -> InstantSample:
        """A window of the target, sources cut to what it can show of them."""
        return sample.cropped(left, top, width, height).focused()

    def read(self, path: Path) -> InstantSample:
        """See `read_instant`."""
        return read_instant(path)

    def write(self, path: Path, sample: InstantSample) -> None:
        """See `write_instant`."""
        write_instant(path, sample)


class RoomInstants(RoomPool[InstantSample]):
    """The baselines' samples of a plan, see `RoomPool`.

    Args:
        folder: where rooms and samples are kept; `RoomSamples` may share it.
        plan: which samples.
        depth: whether sources come with depth.

    Raises:
        TrainingError: seeds of neither training nor validation rooms, or a plan without samples.
    """

    def __init__(self, folder: Path, plan: RoomPlan, depth: bool = True) -> None:
        super().__init__(folder, plan, InstantKind(depth), "instants", INSTANT_ROOM_VERSION)


class CaptureInstants(CapturePool[InstantSample]):
    """The baselines' samples of captures, see `CapturePool`.

    Args:
        folder: where samples are kept; `CaptureSamples` may share it.
        captures: what to learn from, at their own size.
        plan: which samples.
        depth: whether sources come with depth.

    Raises:
        TrainingError: a capture that is for tests, too small, given twice, or has too few cameras.
    """

    def __init__(self, folder: Path, captures: Sequence[Capture], plan: CapturePlan, depth: bool = True) -> None:
        super().__init__(folder, captures, plan, InstantKind(depth), "capture-instants", INSTANT_CAPTURE_VERSION)
