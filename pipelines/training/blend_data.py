"""What a training of the blending network learns from and is judged by: rooms of many domains, and captures."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from ggvs_eval.capture import Capture
from ggvs_eval.datasets import open_capture
from ggvs_eval.errors import TrainingError
from ggvs_eval.pipelines.training.blend_rgbd import CaptureSamples
from ggvs_eval.pipelines.training.blend_rooms import RoomSamples
from ggvs_eval.pipelines.training.capture_views import CapturePlan
from ggvs_eval.pipelines.training.domain_samples import domain_plans, domain_validation_plan
from ggvs_eval.pipelines.training.held_back import held_back_halves
from ggvs_eval.pipelines.training.joined_samples import JoinedSamples, Samples
from ggvs_eval.synthetic.domains import DOMAINS

VALIDATION_TARGETS = 2  # per domain
CAPTURE_TARGETS = 72  # per capture that is learned from
HELD_BACK = CapturePlan(targets=6, gap=0, span=4)  # of a sequence that is held back: sources as an evaluation would have them


@dataclass(frozen=True)
class BlendData:
    """What is learned from.

    Attributes:
        rooms: of each domain.
        targets: views per room.
        domains: names, see `ggvs_eval.synthetic.domains`; all of them where none is named.
        captures: folders of captures beside the rooms.
        hold_back: learn from the first half of RGB-D sequences, and let what is new in the rest judge.
    """

    rooms: int = 3
    targets: int = 9
    domains: tuple[str, ...] = ()
    captures: tuple[Path, ...] = ()
    hold_back: bool = False


def blend_samples(cache: Path, data: BlendData, most_views: int) -> tuple[JoinedSamples, JoinedSamples]:
    """Samples to learn from, and samples to be judged by; `prepare` makes them.

    Args:
        cache: where rooms and samples are kept.
        data: what is learned from.
        most_views: that the network takes.

    Raises:
        TrainingError: nothing to learn from, or captures that cannot be learned from.
    """
    views = min(4, most_views)
    others = tuple(count for count in range(2, most_views + 1) if count != views)
    domains = data.domains or tuple(DOMAINS)
    training: list[Samples] = []
    if data.rooms:
        share = 0.4 if others else 0.0
        plans = domain_plans(domains, data.rooms, data.targets, views=views, other_views=others, other_share=share)
        training += [RoomSamples(cache, plan) for plan in plans]
    validation: list[Samples] = [RoomSamples(cache, domain_validation_plan(name, views, VALIDATION_TARGETS)) for name in domains]
    for learned, held_back in _parts(data):
        training.append(CaptureSamples(cache, [learned], CapturePlan(targets=CAPTURE_TARGETS, views=views)))
        if held_back is not None:
            validation.append(CaptureSamples(cache, [held_back], replace(HELD_BACK, views=views)))
    if not training:
        raise TrainingError("train blend: wanted rooms or captures to learn from, got neither; give --rooms or --captures")
    return JoinedSamples(*training), JoinedSamples(*validation)


def _parts(data: BlendData) -> Iterator[tuple[Capture, Capture | None]]:
    """What is learned from of each capture, and what is held back."""
    for path in data.captures:
        capture = open_capture(path)
        yield held_back_halves(capture) if data.hold_back else (capture, None)
