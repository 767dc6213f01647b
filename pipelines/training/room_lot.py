"""Samples of procedural rooms on disk, whatever a sample is: the rooms are filmed once, each sample is made once."""

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Generic, TypeVar

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.pipelines.offline.depth_choice import DepthChoice
from ggvs_eval.pipelines.training.blend_rgbd import MeasuredSampleMaker
from ggvs_eval.pipelines.training.blend_samples import SampleMaker
from ggvs_eval.pipelines.training.room_plan import RoomPlan, choose_views, draw_window, film_room, refuse_tests
from ggvs_eval.processes import finish_all, worker_pool
from ggvs_eval.synthetic.domains import PLAIN, find_domain

Sample = TypeVar("Sample")


class RoomLot(ABC, Generic[Sample]):
    """The samples of a plan on disk; a subclass says what a sample is.

    Args:
        folder: where rooms and samples are kept; several plans, and several kinds of samples, may share it.
        plan: which samples.
        kind: of the samples; their folder begins with it.
        version: of what `make` does: counts up whenever equal plans give other samples.
        depth: whether samples depend on the depth of their sources.

    Raises:
        TrainingError: seeds of neither training nor validation rooms, or a plan without samples.
    """

    def __init__(self, folder: Path, plan: RoomPlan, kind: str, version: int, depth: bool = True) -> None:
        refuse_tests(plan)
        self.plan = plan
        self._depth = depth
        self._rooms = folder / "rooms"
        self._samples = folder / f"{kind}-{_digest(plan, version, depth)}"

    def __repr__(self) -> str:
        """The plan; the model card shows it, and where the folder lies is nobody's business."""
        return repr(self.plan)

    def __len__(self) -> int:
        return self.plan.rooms * self.plan.targets

    @property
    def data(self) -> str:
        """What they show, for the model card."""
        depth = f"depth by {self.plan.matcher}" if self._depth else "no depth"
        domain = "" if self.plan.domain == PLAIN else f" of domain {self.plan.domain}"
        return f"{len(self)} views of {self.plan.rooms} procedural rooms{domain} (ggvs_eval.synthetic), {depth}"

    @abstractmethod
    def make(self, maker: SampleMaker, target: Camera, sources: Sequence[Camera]) -> Sample:
        """The sample of a target and its source cameras."""

    @abstractmethod
    def cropped(self, sample: Sample, left: int, top: int, width: int, height: int) -> Sample:
        """The window of a sample that starts at pixel (left, top)."""

    @abstractmethod
    def read_file(self, path: Path) -> Sample:
        """Read a sample.

        Raises:
            TrainingError: absent or damaged.
        """

    @abstractmethod
    def write_file(self, path: Path, sample: Sample) -> None:
        """Write a sample, the whole file or none."""

    def read(self, index: int) -> Sample:
        """One of the samples.

        Raises:
            TrainingError: it has not been prepared, or is damaged.
        """
        room, target = divmod(index, self.plan.targets)
        return self.read_file(self._path(self.plan.seeds[room], target))

    def prepare(self, workers: int) -> None:
        """Film the rooms and make the samples that are not there yet; a killed preparation goes on where it stopped.

        Args:
            workers: processes; a room is one job.
        """
        missing = [seed for seed in self.plan.seeds if not all(self._path(seed, n).is_file() for n in range(self.plan.targets))]
        if not missing:
            return
        with worker_pool(min(workers, len(missing))) as pool:
            finish_all(pool, [pool.submit(self.prepare_room, seed) for seed in missing], "rooms to learn from")

    def prepare_room(self, seed: int) -> None:
        """Film one room and make its samples."""
        self.prepare_capture(seed, film_room(self._rooms, seed, self.plan))

    def prepare_capture(self, seed: int, capture: Capture) -> None:
        """Make the samples of a room that has been filmed."""
        maker = MeasuredSampleMaker(capture, DepthChoice(self.plan.matcher).options())
        for number in range(self.plan.targets):
            path = self._path(seed, number)
            if not path.is_file():
                sample = self.make(maker, *choose_views(capture, self.plan, seed, number))
                window = draw_window(self.plan, seed, number)
                self.write_file(path, self.cropped(sample, *window) if self.plan.window else sample)

    def _path(self, seed: int, number: int) -> Path:
        return self._samples / f"room{seed}-{number:02d}.npz"


def _digest(plan: RoomPlan, version: int, depth: bool) -> str:
    """Names all that a sample depends on but its room and its number."""
    options = DepthChoice(plan.matcher).options()
    described = {
        "version": version,
        "views": [plan.views, plan.other_views, plan.other_share],
        "size": [plan.width, plan.height],
        "wide_share": plan.wide_share,
        "depth": options.describe() if depth else None,
        "consistency": options.consistency.describe() if depth and options.consistency else None,
    }
    if plan.domain != PLAIN:
        described |= _describe_domain(plan.domain)
    if plan.window:
        described["window"] = plan.window
    return hashlib.sha256(json.dumps(described, sort_keys=True).encode()).hexdigest()[:12]


def _describe_domain(name: str) -> dict[str, Any]:
    """What samples depend on of their domain."""
    domain = find_domain(name)
    described: dict[str, Any] = {"domain": name, "options": dict(domain.options), "strengths": dict(domain.strengths)}
    if domain.hand_held:
        sensor = DepthChoice().options().sensor
        described |= {"frames": [domain.gap, domain.span], "sensor": sensor.describe() if sensor else None}
    return described
