"""Which procedural rooms of which domains networks learn from: seeds, how each is rendered, and the views of each sample."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ggvs_eval.camera import Camera, nearest_cameras
from ggvs_eval.capture import Capture
from ggvs_eval.datasets import open_capture
from ggvs_eval.errors import TrainingError
from ggvs_eval.pipelines.training.samples.capture_views import CapturePlan, draw_views, is_sequence
from ggvs_eval.synthetic.demo import write_demo
from ggvs_eval.synthetic.domains import DOMAINS, FIRST_TRAINING_SEED, PLAIN, VALIDATION_SEEDS, domain_options, find_domain
from ggvs_eval.synthetic.film.options import DemoOptions

FIRST_TRAINING_ROOM = FIRST_TRAINING_SEED
WINDOW = (480, 360)  # of large images, pixels
LARGE_FACTOR = 3  # so many times the pixels, fewer rooms and more views of each


@dataclass(frozen=True)
class RoomPlan:
    """Which samples there are. More rooms or more targets add samples and change none.

    Attributes:
        first_room: seed of the first room, from 1000 on.
        rooms: how many rooms.
        targets: target views per room.
        views: K of most samples.
        other_views: K of the others, so that one network learns to serve them all.
        other_share: share of the others.
        width: of the images, pixels.
        height: of the images, pixels.
        wide_share: share of the samples whose sources are drawn from twice as many near cameras instead of being the nearest.
        matcher: whose depth the samples have, see `ggvs_eval.pipelines.offline.depth.depth_choice`,
            or that of a sensor.
        domain: kind of captures, see `ggvs_eval.synthetic.domains`.
        window: width and height of the random part of each view that is kept, pixels; None keeps whole views. Large images would
            fill disks, and a training looks at crops anyway.
    """

    first_room: int = FIRST_TRAINING_ROOM
    rooms: int = 25
    targets: int = 9
    views: int = 4
    other_views: tuple[int, ...] = (2, 3, 5, 6)
    other_share: float = 0.4
    width: int = 480
    height: int = 360
    wide_share: float = 0.5
    matcher: str = "sgbm"
    domain: str = PLAIN
    window: tuple[int, int] | None = None

    @property
    def most_views(self) -> int:
        """The largest K of a sample."""
        return max(self.views, *self.other_views) if self.other_share else self.views

    @property
    def least_size(self) -> tuple[int, int]:
        """Width and height of the samples, pixels."""
        return self.window or (self.width, self.height)

    @property
    def seeds(self) -> range:
        """Seeds of the rooms."""
        return range(self.first_room, self.first_room + self.rooms)


def refuse_tests(plan: RoomPlan) -> None:
    """Refuse rooms that are neither for training nor for validation, and plans without samples."""
    if not (plan.first_room >= FIRST_TRAINING_ROOM or set(plan.seeds) <= set(VALIDATION_SEEDS)):
        raise TrainingError(
            f"rooms {plan.seeds.start}..{plan.seeds.stop - 1}: wanted seeds from {FIRST_TRAINING_ROOM} on for training, or "
            f"of {', '.join(map(str, VALIDATION_SEEDS))} for validation; the others are for tests"
        )
    if plan.window and not (0 < plan.window[0] <= plan.width and 0 < plan.window[1] <= plan.height):
        raise TrainingError(f"wanted windows within images of {plan.width} x {plan.height}, got {plan.window}; lower the window")
    if min(plan.rooms, plan.targets, plan.views) < 1:
        raise TrainingError(f"wanted at least one room, target and view, got {plan}")


def film_room(folder: Path, seed: int, plan: RoomPlan) -> Capture:
    """The capture of a room, rendered unless it has been."""
    kind = "" if plan.domain == PLAIN else f"{plan.domain}-"
    name = f"{kind}seed{seed}-{plan.width}x{plan.height}"
    return open_capture(write_demo(folder / name, room_options(seed, plan), workers=1))


def room_options(seed: int, plan: RoomPlan) -> DemoOptions:
    """Return a room's options: one instant; training rooms differ in their strengths, validation rooms are as their domain."""
    return domain_options(plan.domain, seed, plan.width, plan.height)


def choose_views(capture: Capture, plan: RoomPlan, seed: int, number: int) -> tuple[Camera, list[Camera]]:
    """Target and sources of a room's sample of that number; no target comes twice before every camera has been one.

    Reading:
        The paper draws inputs and target at random. Half of ours are the nearest cameras, as in the evaluation; the others are
        drawn from twice as many, so that the network also sees wide gaps. Of a hand-held camera they are drawn as of any
        RGB-D sequence, see `draw_views`.
    """
    if is_sequence(capture):
        return _choose_frames(capture, plan, seed, number)
    count = len(capture.cameras)
    turn, place = divmod(number, count)
    target = capture.cameras[np.random.default_rng([seed, 85, turn]).permutation(count)[place]]
    rng = np.random.default_rng([seed, 86, number])
    views = int(rng.choice(plan.other_views)) if rng.random() < plan.other_share else plan.views
    if rng.random() >= plan.wide_share:
        return target, nearest_cameras(target, capture.cameras, views)
    near = nearest_cameras(target, capture.cameras, min(2 * views, count - 1))
    return target, [near[index] for index in sorted(rng.choice(len(near), views, replace=False))]


def draw_window(plan: RoomPlan, seed: int, number: int) -> tuple[int, int, int, int]:
    """Left, top, width and height of the part of a room's sample of that number that is kept, pixels."""
    width, height = plan.least_size
    rng = np.random.default_rng([seed, 88, number])
    return int(rng.integers(plan.width - width + 1)), int(rng.integers(plan.height - height + 1)), width, height


def _choose_frames(capture: Capture, plan: RoomPlan, seed: int, number: int) -> tuple[Camera, list[Camera]]:
    """Target and sources of a hand-held camera's sample."""
    rng, domain = np.random.default_rng([seed, 86, number]), find_domain(plan.domain)
    views = int(rng.choice(plan.other_views)) if rng.random() < plan.other_share else plan.views
    rule = CapturePlan(plan.targets, views, domain.span, domain.gap, width=plan.width, height=plan.height, matcher=plan.matcher)
    return draw_views(capture, rule, f"{plan.domain}{seed}", number)


def domain_plans(domains: Iterable[str] = tuple(DOMAINS), rooms: int = 4, targets: int = 8, **shared: object) -> list[RoomPlan]:
    """A training plan per domain, rendered at the domain's own size; of large images windows of the usual size are kept.

    Args:
        domains: their names.
        rooms: per domain; of domains whose images are large a third of that, as they take as much time.
        targets: views per room; of domains whose images are large three times as many.
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
    rooms, targets = max(plan.rooms // LARGE_FACTOR, 1), plan.targets * LARGE_FACTOR
    return replace(plan, domain=domain, rooms=rooms, targets=targets, width=width, height=height, window=WINDOW)
