"""What the blending network learns from: procedural rooms, filmed once, with depth from stereo, kept on disk."""

from collections.abc import Sequence
from pathlib import Path

from ggvs_eval.camera import Camera
from ggvs_eval.pipelines.training.blend_samples import BlendSample, SampleMaker, read_sample, write_sample
from ggvs_eval.pipelines.training.room_lot import RoomLot
from ggvs_eval.pipelines.training.room_plan import RoomPlan

VERSION = 4  # counts up whenever equal plans give other samples


class RoomSamples(RoomLot[BlendSample]):
    """The blending network's samples of a plan on disk, see `RoomLot`.

    Args:
        folder: where rooms and samples are kept.
        plan: which samples.

    Raises:
        TrainingError: seeds of neither training nor validation rooms, or a plan without samples.
    """

    def __init__(self, folder: Path, plan: RoomPlan) -> None:
        super().__init__(folder, plan, "samples", VERSION)

    @property
    def plans(self) -> tuple[RoomPlan]:
        """Which samples there are."""
        return (self.plan,)

    def make(self, maker: SampleMaker, target: Camera, sources: Sequence[Camera]) -> BlendSample:
        """The views of the sources in the target, and what the geometric blender makes of them."""
        return maker.sample(target, sources)

    def cropped(self, sample: BlendSample, left: int, top: int, width: int, height: int) -> BlendSample:
        """A window of all that belongs to the target view."""
        return sample.cropped(left, top, width, height)

    def read_file(self, path: Path) -> BlendSample:
        """See `read_sample`."""
        return read_sample(path)

    def write_file(self, path: Path, sample: BlendSample) -> None:
        """See `write_sample`."""
        write_sample(path, sample)
