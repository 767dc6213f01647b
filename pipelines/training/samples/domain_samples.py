"""Which rooms of which domains networks learn from or are chosen by: a plan per domain."""

from collections.abc import Iterable
from dataclasses import replace

from ggvs_eval.pipelines.training.samples.room_plan import RoomPlan
from ggvs_eval.synthetic.domains import DOMAINS, VALIDATION_SEEDS, find_domain

WINDOW = (480, 360)  # of large images, pixels


def domain_plans(domains: Iterable[str] = tuple(DOMAINS), rooms: int = 4, targets: int = 8, **shared: object) -> list[RoomPlan]:
    """A training plan per domain, rendered at the domain's own size; of large images windows of the usual size are kept.

    Args:
        domains: their names.
        rooms: per domain; of domains whose images are large a third of that, as they take as much time.
        targets: views per room.
        shared: whatever else plans have in common, see `RoomPlan`.
    """
    plan = replace(RoomPlan(rooms=rooms, targets=targets), **shared)  # type: ignore[arg-type]
    return [_sized(plan, name) for name in domains]


def domain_validation_plan(
    domain: str, views: int = 4, targets: int = 3, seeds: int = 1, matcher: str = "sgbm", size: tuple[int, int] | None = None
) -> RoomPlan:
    """The views of a domain by which choices may be made, with the sources that an evaluation would take.

    Args:
        domain: its name.
        views: K.
        targets: views per seed.
        seeds: how many of the validation seeds.
        matcher: whose depth rigs get.
        size: of the images, pixels; the domain's by default.
    """
    first, width, height = VALIDATION_SEEDS[0], *(size or find_domain(domain).size)
    return RoomPlan(first, seeds, targets, views, (), 0.0, width, height, wide_share=0.0, matcher=matcher, domain=domain)


def _sized(plan: RoomPlan, domain: str) -> RoomPlan:
    width, height = find_domain(domain).size
    if width <= WINDOW[0] and height <= WINDOW[1]:
        return replace(plan, domain=domain, width=width, height=height)
    return replace(plan, domain=domain, rooms=max(plan.rooms // 3, 1), width=width, height=height, window=WINDOW)
