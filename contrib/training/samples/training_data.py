"""Data for training and validation of networks: the same views for all, of rooms of many domains and of captures."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from ggvs_eval.capture import Capture
from ggvs_eval.contrib.training.samples.capture_source import capture_sources
from ggvs_eval.contrib.training.samples.capture_views import CapturePlan, held_back_halves
from ggvs_eval.contrib.training.samples.data_options import DataOptions
from ggvs_eval.contrib.training.samples.room_plan import RoomPlan, domain_plans, domain_validation_plan
from ggvs_eval.contrib.training.samples.samples import Sample, SampleKind, SamplePool, SampleSource
from ggvs_eval.contrib.worlds.domains import DOMAINS
from ggvs_eval.datasets import open_capture
from ggvs_eval.errors import TrainingError

USUAL_VIEWS = 4  # K of most samples, where as many are asked for
VALIDATION_TARGETS = 2  # per domain
CAPTURE_TARGETS = 72  # per capture that is learned from
HELD_BACK = CapturePlan(targets=6, gap=0, span=4)  # of a sequence that is held back: sources as an evaluation would have them


def sample_pools(cache: Path, data: DataOptions, kind: SampleKind[Sample]) -> tuple[SamplePool[Sample], SamplePool[Sample]]:
    """Samples to learn from, and those to be validated by; `prepare_samples` makes them."""
    views, domains, halves = min(USUAL_VIEWS, data.views), data.domains or tuple(DOMAINS), list(_halves(data))
    learned = capture_sources([half for half, _ in halves], CapturePlan(targets=CAPTURE_TARGETS, views=views))
    held_back = capture_sources([half for _, half in halves if half is not None], replace(HELD_BACK, views=views))
    training: list[SampleSource] = [*_training_rooms(data, views, domains), *learned]
    validation: list[SampleSource] = [*(domain_validation_plan(name, views, VALIDATION_TARGETS) for name in domains), *held_back]
    if not training:
        raise TrainingError("training: wanted rooms or captures to learn from, got neither; give --rooms or --captures")
    return SamplePool(cache, kind, training), SamplePool(cache, kind, validation)


def prepare_samples(training: SamplePool[Sample], validation: SamplePool[Sample], workers: int) -> None:
    """Make what is not there yet of both at once, so that no worker waits for the last room of a pool."""
    (validation + training).prepare(workers)


def _training_rooms(data: DataOptions, views: int, domains: tuple[str, ...]) -> list[RoomPlan]:
    """A plan per domain, some of its samples with another K."""
    others = tuple(count for count in range(2, data.views + 1) if count != views)
    shared = {"views": views, "other_views": others, "other_share": 0.4 if others else 0.0}
    return domain_plans(domains, data.rooms, data.targets, **shared) if data.rooms else []


def _halves(data: DataOptions) -> Iterator[tuple[Capture, Capture | None]]:
    """Yield the part of each capture that is learned from, and the part that is held back."""
    for path in data.captures:
        capture = open_capture(path)
        yield held_back_halves(capture) if data.hold_back else (capture, None)
