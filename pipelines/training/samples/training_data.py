"""Data for training and validation of networks: the same views for all, of rooms of many domains and of captures."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from ggvs_eval.capture import Capture
from ggvs_eval.datasets import open_capture
from ggvs_eval.errors import TrainingError
from ggvs_eval.pipelines.training.samples.blend_samples import BlendSample
from ggvs_eval.pipelines.training.samples.capture_views import CapturePlan, held_back_halves
from ggvs_eval.pipelines.training.samples.room_plan import RoomPlan, domain_plans, domain_validation_plan
from ggvs_eval.pipelines.training.samples.sample_kinds import CaptureInstants, CaptureSamples, RoomInstants, RoomSamples
from ggvs_eval.pipelines.training.samples.samples import JoinedSamples, Sample, Samples
from ggvs_eval.synthetic.domains import DOMAINS
from ggvs_eval.training.instant_samples import InstantSample

VALIDATION_TARGETS = 2  # per domain
CAPTURE_TARGETS = 72  # per capture that is learned from
HELD_BACK = CapturePlan(targets=6, gap=0, span=4)  # of a sequence that is held back: sources as an evaluation would have them


@dataclass(frozen=True)
class TrainingData:
    """Choice of training data.

    Attributes:
        rooms: of each domain.
        targets: views per room.
        domains: names, see `ggvs_eval.synthetic.domains`; all of them where none is named.
        captures: folders of captures beside the rooms.
        hold_back: learn from the first half of RGB-D sequences, and validate by what is new in the rest.
        most_views: largest K of a sample.
    """

    rooms: int = 3
    targets: int = 9
    domains: tuple[str, ...] = ()
    captures: tuple[Path, ...] = ()
    hold_back: bool = False
    most_views: int = 6

    @property
    def views(self) -> int:
        """K of most samples."""
        return min(4, self.most_views)

    def training_rooms(self) -> list[RoomPlan]:
        """A plan per domain."""
        others = tuple(count for count in range(2, self.most_views + 1) if count != self.views)
        share = 0.4 if others else 0.0
        shared = {"views": self.views, "other_views": others, "other_share": share}
        return domain_plans(self._domains, self.rooms, self.targets, **shared) if self.rooms else []

    def validation_rooms(self) -> list[RoomPlan]:
        """A plan per domain."""
        return [domain_validation_plan(name, self.views, VALIDATION_TARGETS) for name in self._domains]

    def halves(self) -> Iterator[tuple[Capture, Capture | None]]:
        """Yield the part of each capture that is learned from, and the part that is held back."""
        for path in self.captures:
            capture = open_capture(path)
            yield held_back_halves(capture) if self.hold_back else (capture, None)

    @property
    def _domains(self) -> tuple[str, ...]:
        return self.domains or tuple(DOMAINS)


def blend_samples(
    cache: Path, data: TrainingData, device: str = "cpu"
) -> tuple[JoinedSamples[BlendSample], JoinedSamples[BlendSample]]:
    """The blending network's samples to learn from, and those to be validated by; `prepare` makes them.

    Args:
        cache: where rooms and samples are kept.
        data: what is learned from.
        device: where they are computed, see `SampleKind`.

    Raises:
        TrainingError: nothing to learn from, or captures that cannot be learned from.
    """
    rooms = partial(RoomSamples, cache, device=device)
    return _samples(data, rooms, lambda capture, plan: CaptureSamples(cache, [capture], plan, device))


def baseline_samples(
    cache: Path, data: TrainingData, depth: bool
) -> tuple[JoinedSamples[InstantSample], JoinedSamples[InstantSample]]:
    """The baselines' samples of the same views, see `blend_samples`.

    Args:
        cache: where rooms and samples are kept.
        data: what is learned from.
        depth: whether sources come with depth.

    Raises:
        TrainingError: nothing to learn from, or captures that cannot be learned from.
    """
    rooms = partial(RoomInstants, cache, depth=depth)
    return _samples(data, rooms, lambda capture, plan: CaptureInstants(cache, [capture], plan, depth))


def prepare_samples(training: Samples[Sample], validation: Samples[Sample], workers: int) -> None:
    """Make what is not there yet of both at once, so that no worker waits for the last room of a pool."""
    JoinedSamples(validation, training).prepare(workers)


def _samples(
    data: TrainingData,
    of_rooms: Callable[[RoomPlan], Samples[Sample]],
    of_capture: Callable[[Capture, CapturePlan], Samples[Sample]],
) -> tuple[JoinedSamples[Sample], JoinedSamples[Sample]]:
    """Samples of one kind to learn from and to be validated by."""
    training, validation = ([of_rooms(plan) for plan in plans] for plans in (data.training_rooms(), data.validation_rooms()))
    for learned, held_back in data.halves():
        training.append(of_capture(learned, CapturePlan(targets=CAPTURE_TARGETS, views=data.views)))
        if held_back is not None:
            validation.append(of_capture(held_back, replace(HELD_BACK, views=data.views)))
    if not training:
        raise TrainingError("training: wanted rooms or captures to learn from, got neither; give --rooms or --captures")
    return JoinedSamples(*training), JoinedSamples(*validation)
