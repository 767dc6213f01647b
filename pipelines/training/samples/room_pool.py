"""Samples of procedural rooms on disk, whatever a sample is: the rooms are rendered once, each sample is made once."""

import hashlib
import json
from functools import partial
from pathlib import Path
from typing import Any

from ggvs_eval.capture import Capture
from ggvs_eval.pipelines.offline.depth.depth_choice import DepthRunOptions
from ggvs_eval.pipelines.training.samples.capture_pool import MeasuredSampleMaker
from ggvs_eval.pipelines.training.samples.room_plan import RoomPlan, choose_views, draw_window, film_room, refuse_tests
from ggvs_eval.pipelines.training.samples.samples import Job, Sample, SampleKind, Samples
from ggvs_eval.synthetic.domains import PLAIN, find_domain


class RoomPool(Samples[Sample]):
    """The samples of a plan on disk.

    Args:
        folder: where rooms and samples are kept; several plans, and several kinds of samples, may share it.
        plan: which samples.
        kind: what a sample is.
        name: of the kind; folders begin with it.
        version: of the samples: counts up whenever equal plans give other ones.

    Raises:
        TrainingError: seeds of neither training nor validation rooms, or a plan without samples.
    """

    def __init__(self, folder: Path, plan: RoomPlan, kind: SampleKind[Sample], name: str, version: int) -> None:
        refuse_tests(plan)
        self.plan = plan
        self._kind = kind
        self._rooms = folder / "rooms"
        self._samples = folder / f"{name}-{_digest(plan, version, kind)}"

    def __repr__(self) -> str:
        """The plan; the model card shows it, and where the folder lies is nobody's business."""
        return repr(self.plan)

    def __len__(self) -> int:
        return self.plan.rooms * self.plan.targets

    @property
    def plans(self) -> tuple[RoomPlan]:
        """Which samples there are."""
        return (self.plan,)

    @property
    def data(self) -> str:
        """Contents of the samples, for the model card."""
        depth = f"depth by {self.plan.matcher}" if self._kind.depth else "no depth"
        domain = "" if self.plan.domain == PLAIN else f" of domain {self.plan.domain}"
        return f"{len(self)} views of {self.plan.rooms} procedural rooms{domain} (ggvs_eval.synthetic), {depth}"

    def read(self, index: int) -> Sample:
        """One of the samples.

        Raises:
            TrainingError: it has not been prepared, or is damaged.
        """
        room, target = divmod(index, self.plan.targets)
        return self._kind.read(self._path(self.plan.seeds[room], target))

    def jobs(self) -> list[Job]:
        """Film a room and make its samples, of every room that lacks some."""
        lacking = [seed for seed in self.plan.seeds if not all(self._path(seed, n).is_file() for n in range(self.plan.targets))]
        return [partial(self.prepare_room, seed) for seed in lacking]

    def prepare_room(self, seed: int) -> None:
        """Film one room and make its samples."""
        self.prepare_capture(seed, film_room(self._rooms, seed, self.plan))

    def prepare_capture(self, seed: int, capture: Capture) -> None:
        """Make the samples of a room that has been rendered."""
        maker = MeasuredSampleMaker(capture, DepthRunOptions(self.plan.matcher).options())
        for number in range(self.plan.targets):
            path = self._path(seed, number)
            if not path.is_file():
                sample = self._kind.make(maker, *choose_views(capture, self.plan, seed, number))
                window = draw_window(self.plan, seed, number)
                self._kind.write(path, self._kind.cropped(sample, *window) if self.plan.window else sample)

    def _path(self, seed: int, number: int) -> Path:
        return self._samples / f"room{seed}-{number:02d}.npz"


def _digest(plan: RoomPlan, version: int, kind: SampleKind[Sample]) -> str:
    """Names all that a sample depends on but its room and its number."""
    options = DepthRunOptions(plan.matcher).options()
    described = {
        "version": version,
        "views": [plan.views, plan.other_views, plan.other_share],
        "size": [plan.width, plan.height],
        "wide_share": plan.wide_share,
        "depth": options.describe() if kind.depth else None,
        "consistency": options.consistency.describe() if kind.depth and options.consistency else None,
    }
    if plan.domain != PLAIN:
        described |= _describe_domain(plan.domain)
    if plan.window:
        described["window"] = plan.window
    described |= kind.describe()
    return hashlib.sha256(json.dumps(described, sort_keys=True).encode()).hexdigest()[:12]


def _describe_domain(name: str) -> dict[str, Any]:
    """Describe what samples depend on of their domain."""
    domain = find_domain(name)
    described: dict[str, Any] = {"domain": name, "options": dict(domain.options), "strengths": dict(domain.strengths)}
    if domain.hand_held:
        sensor = DepthRunOptions().options().sensor
        described |= {"frames": [domain.gap, domain.span], "sensor": sensor.describe() if sensor else None}
    return described
