"""Data for training and validation of networks: the same views for all, of rooms of many domains
and of captures.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from ggvs_eval.camera import Camera, nearest_cameras
from ggvs_eval.capture import Capture
from ggvs_eval.contrib.training.request import TrainingOptions
from ggvs_eval.contrib.training.samples.capture_source import (
    CapturePlan,
    capture_sources,
    draw_views,
    held_back_halves,
    is_sequence,
)
from ggvs_eval.contrib.training.samples.samples import Sample, SampleKind, SamplePool, SampleSource
from ggvs_eval.contrib.worlds.demo import write_demo
from ggvs_eval.contrib.worlds.domains import (
    DOMAINS,
    FIRST_TRAINING_SEED,
    PLAIN,
    VALIDATION_SEEDS,
    domain_options,
    find_domain,
)
from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.datasets import open_capture
from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.errors import TrainingError
from ggvs_eval.pipelines.offline.depth.consistency import describe_check
from ggvs_eval.pipelines.offline.sensor.sensor_depth import describe_filter

FIRST_TRAINING_ROOM = FIRST_TRAINING_SEED
WINDOW = (480, 360)  # of large images, pixels
LARGE_FACTOR = 3  # factor on the pixels, with fewer rooms and more views of each


@dataclass(frozen=True)
class RoomPlan:
    """Plan of the samples. More rooms or more targets add samples and change none.

    Attributes:
        first_room: seed of the first room, from 1000 on.
        views: K of most samples.
        other_views: K of the other samples, so that one network learns every K.
        other_share: share of the others.
        width: of the images, pixels.
        height: of the images, pixels.
        wide_share: share of the samples whose sources are drawn from twice as many near cameras
            instead of being the nearest.
        matcher: whose depth the samples have, see `ggvs_eval.pipelines.offline.depth.depth_choice`,
            or that of a sensor.
        domain: kind of captures, see `ggvs_eval.contrib.worlds.domains`.
        window: width and height of the random part of each view that is kept, pixels; None keeps
            whole views. Large images would fill disks, and a training looks at crops anyway.
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
    origin: ClassVar[Literal["rooms"]] = "rooms"

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

    def __post_init__(self) -> None:
        """Refuse rooms that are neither for training nor for validation, and plans without
        samples.
        """
        if not (self.first_room >= FIRST_TRAINING_ROOM or set(self.seeds) <= set(VALIDATION_SEEDS)):
            raise TrainingError(
                f"rooms {self.seeds.start}..{self.seeds.stop - 1}: wanted seeds from "
                f"{FIRST_TRAINING_ROOM} on for training, or of "
                f"{', '.join(map(str, VALIDATION_SEEDS))} for validation; the others are for tests"
            )
        if self.window and not (
            0 < self.window[0] <= self.width and 0 < self.window[1] <= self.height
        ):
            raise TrainingError(
                f"wanted windows within images of {self.width} x {self.height}, got {self.window}; "
                f"lower the window"
            )
        if min(self.rooms, self.targets, self.views) < 1:
            raise TrainingError(f"wanted at least one room, target and view, got {self}")

    @property
    def count(self) -> int:
        """Number of its samples."""
        return self.rooms * self.targets

    def contents(self, depth: bool) -> str:
        """See `SampleSource`."""
        how = f"depth by {self.matcher}" if depth else "no depth"
        domain = "" if self.domain == PLAIN else f" of domain {self.domain}"
        return (
            f"{self.count} views of {self.rooms} procedural rooms{domain} "
            f"(ggvs_eval.contrib.worlds), {how}"
        )

    def describe(self, depth: bool) -> dict[str, object]:
        """See `SampleSource`."""
        options = DepthRunOptions(self.matcher).options()
        return {
            "views": [self.views, self.other_views, self.other_share],
            "size": [self.width, self.height],
            "wide_share": self.wide_share,
            "depth": options.describe() if depth else None,
            "consistency": describe_check() if depth and options.consistency else None,
            **({} if self.domain == PLAIN else _describe_domain(self.domain)),
            **({"window": self.window} if self.window else {}),
        }

    def file_name(self, number: int) -> str:
        """See `SampleSource`."""
        seed, target = self._place(number)
        return f"room{seed}-{target:02d}.npz"

    def groups(self) -> list[list[int]]:
        """Return the numbers of each room."""
        return [
            list(range(first, first + self.targets)) for first in range(0, self.count, self.targets)
        ]

    def opened(self, folder: Path, number: int) -> Capture:
        """See `film_room`."""
        return film_room(folder / "rooms", self._place(number)[0], self)

    def frame(self, number: int) -> int:
        """Return the only instant of a room."""
        return 0

    def draw(self, capture: Capture, number: int) -> tuple[Camera, list[Camera]]:
        """See `choose_views`."""
        return choose_views(capture, self, *self._place(number))

    def kept(self, number: int) -> tuple[int, int, int, int] | None:
        """See `draw_window`."""
        return draw_window(self, *self._place(number)) if self.window else None

    def _place(self, number: int) -> tuple[int, int]:
        """Return a sample's room and its number there."""
        room, target = divmod(number, self.targets)
        return self.seeds[room], target


def film_room(folder: Path, seed: int, plan: RoomPlan) -> Capture:
    """Return the capture of a room, rendered unless it has been."""
    kind = "" if plan.domain == PLAIN else f"{plan.domain}-"
    name = f"{kind}seed{seed}-{plan.width}x{plan.height}"
    return open_capture(write_demo(folder / name, room_options(seed, plan), workers=1))


def room_options(seed: int, plan: RoomPlan) -> DemoOptions:
    """Return a room's options: one instant.

    Training rooms differ in their strengths, validation rooms are as their domain.
    """
    return domain_options(plan.domain, seed, plan.width, plan.height)


def choose_views(
    capture: Capture, plan: RoomPlan, seed: int, number: int
) -> tuple[Camera, list[Camera]]:
    """Return the target and sources of a room's sample of that number.

    No target comes twice before every camera has been one.

    Reading:
        The paper draws inputs and target at random. Half of those here are the nearest cameras, as
        in the evaluation; the others are drawn from twice as many, so that the network also sees
        wide gaps. Of a hand-held camera they are drawn as of any RGB-D sequence, see `draw_views`.
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
    """Left, top, width and height of the part of a room's sample of that number that is kept,
    pixels.
    """
    width, height = plan.least_size
    rng = np.random.default_rng([seed, 88, number])
    return (
        int(rng.integers(plan.width - width + 1)),
        int(rng.integers(plan.height - height + 1)),
        width,
        height,
    )


def _choose_frames(
    capture: Capture, plan: RoomPlan, seed: int, number: int
) -> tuple[Camera, list[Camera]]:
    """Return the target and sources of a hand-held camera's sample."""
    rng, domain = np.random.default_rng([seed, 86, number]), find_domain(plan.domain)
    views = int(rng.choice(plan.other_views)) if rng.random() < plan.other_share else plan.views
    rule = CapturePlan(
        targets=plan.targets,
        views=views,
        span=domain.span,
        gap=domain.gap,
        width=plan.width,
        height=plan.height,
        matcher=plan.matcher,
    )
    return draw_views(capture, rule, f"{plan.domain}{seed}", number)


def domain_plans(
    domains: Iterable[str] = tuple(DOMAINS), rooms: int = 4, targets: int = 8, **shared: object
) -> list[RoomPlan]:
    """Return a training plan per domain, rendered at the domain's own size.

    Of large images windows of the usual size are kept.

    Args:
        rooms: per domain; of domains whose images are large a third of that, as they take as much
            time.
        targets: views per room; of domains whose images are large three times as many.
        shared: further settings that plans share, see `RoomPlan`.
    """
    plan = replace(RoomPlan(rooms=rooms, targets=targets), **shared)  # type: ignore[arg-type]
    return [_sized(plan, name) for name in domains]


def domain_validation_plan(
    domain: str,
    views: int = 4,
    targets: int = 3,
    seeds: int = 1,
    matcher: str = "sgbm",
    size: tuple[int, int] | None = None,
) -> RoomPlan:
    """Return the views of a domain by which choices may be made, with the sources that an
    evaluation would take.

    Args:
        size: of the images, pixels; the domain's by default.
    """
    first, width, height = VALIDATION_SEEDS[0], *(size or find_domain(domain).size)
    return RoomPlan(
        first_room=first,
        rooms=seeds,
        targets=targets,
        views=views,
        other_views=(),
        other_share=0.0,
        width=width,
        height=height,
        wide_share=0.0,
        matcher=matcher,
        domain=domain,
    )


def _sized(plan: RoomPlan, domain: str) -> RoomPlan:
    width, height = find_domain(domain).size
    if width <= WINDOW[0] and height <= WINDOW[1]:
        return replace(plan, domain=domain, width=width, height=height)
    rooms, targets = max(plan.rooms // LARGE_FACTOR, 1), plan.targets * LARGE_FACTOR
    return replace(
        plan, domain=domain, rooms=rooms, targets=targets, width=width, height=height, window=WINDOW
    )


def _describe_domain(name: str) -> dict[str, Any]:
    """Describe what samples depend on of their domain."""
    domain = find_domain(name)
    described: dict[str, Any] = {
        "domain": name,
        "options": dict(domain.options),
        "strengths": dict(domain.strengths),
    }
    if domain.hand_held:
        described |= {"frames": [domain.gap, domain.span], "sensor": describe_filter()}
    return described


USUAL_VIEWS = 4  # K of most samples, where as many are asked for
VALIDATION_TARGETS = 2  # per domain
CAPTURE_TARGETS = 72  # per capture that is learned from
# of a sequence that is held back: sources as an evaluation would have them
HELD_BACK = CapturePlan(targets=6, gap=0, span=4)


def sample_pools(
    cache: Path, data: TrainingOptions, kind: SampleKind[Sample]
) -> tuple[SamplePool[Sample], SamplePool[Sample]]:
    """Samples to learn from, and those to be validated by; `prepare_samples` makes them."""
    views, domains, halves = (
        min(USUAL_VIEWS, data.views),
        data.domains or tuple(DOMAINS),
        list(_halves(data)),
    )
    learned = capture_sources(
        [half for half, _ in halves], CapturePlan(targets=CAPTURE_TARGETS, views=views)
    )
    held_back = capture_sources(
        [half for _, half in halves if half is not None], replace(HELD_BACK, views=views)
    )
    training: list[SampleSource] = [*_training_rooms(data, views, domains), *learned]
    validation: list[SampleSource] = [
        *(domain_validation_plan(name, views, VALIDATION_TARGETS) for name in domains),
        *held_back,
    ]
    if not training:
        raise TrainingError(
            "training: wanted rooms or captures, got neither; give --rooms or --captures"
        )
    return SamplePool(cache, kind, training), SamplePool(cache, kind, validation)


def prepare_samples(
    training: SamplePool[Sample], validation: SamplePool[Sample], workers: int
) -> None:
    """Make what is not there yet of both at once, so that no worker waits for the last room of a
    pool.
    """
    (validation + training).prepare(workers)


def _training_rooms(data: TrainingOptions, views: int, domains: tuple[str, ...]) -> list[RoomPlan]:
    """Return a plan per domain, some of its samples with another K."""
    view_counts = tuple(count for count in range(2, data.views + 1) if count != views)
    shared = {
        "views": views,
        "other_views": view_counts,
        "other_share": 0.4 if view_counts else 0.0,
    }
    return domain_plans(domains, data.rooms, data.targets, **shared) if data.rooms else []


def _halves(data: TrainingOptions) -> Iterator[tuple[Capture, Capture | None]]:
    """Yield the part of each capture that is learned from, and the part that is held back."""
    for path in data.captures:
        capture = open_capture(path)
        yield held_back_halves(capture) if data.hold_back else (capture, None)
