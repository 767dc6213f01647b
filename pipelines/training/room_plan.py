"""Which procedural rooms networks learn from: their seeds, how each is filmed, and the views of each sample."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ggvs_eval.camera import Camera, nearest_cameras
from ggvs_eval.capture import Capture
from ggvs_eval.datasets import open_capture
from ggvs_eval.errors import TrainingError
from ggvs_eval.pipelines.depth_validation.rooms import VALIDATION_SEEDS
from ggvs_eval.synthetic.demo import write_demo
from ggvs_eval.synthetic.options import DemoOptions

FIRST_TRAINING_ROOM = 1000  # the demo capture and the validation rooms lie below


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
        matcher: whose depth the samples have, see `ggvs_eval.pipelines.offline.matchers`.
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

    @property
    def most_views(self) -> int:
        """The largest K of a sample."""
        return max(self.views, *self.other_views) if self.other_share else self.views

    @property
    def seeds(self) -> range:
        """Seeds of the rooms."""
        return range(self.first_room, self.first_room + self.rooms)


def validation_plan(views: int, matcher: str, targets: int = 3) -> RoomPlan:
    """The rooms by which choices may be made, with the sources that an evaluation would take."""
    return RoomPlan(VALIDATION_SEEDS[0], len(VALIDATION_SEEDS), targets, views, (), 0.0, wide_share=0.0, matcher=matcher)


def refuse_tests(plan: RoomPlan) -> None:
    """Refuse rooms that are neither for training nor for validation, and plans without samples."""
    if not (plan.first_room >= FIRST_TRAINING_ROOM or set(plan.seeds) <= set(VALIDATION_SEEDS)):
        raise TrainingError(
            f"rooms {plan.seeds.start}..{plan.seeds.stop - 1}: wanted seeds from {FIRST_TRAINING_ROOM} on for training, or "
            f"of {', '.join(map(str, VALIDATION_SEEDS))} for validation; the others are for tests"
        )
    if min(plan.rooms, plan.targets, plan.views) < 1:
        raise TrainingError(f"wanted at least one room, target and view, got {plan}")


def film_room(folder: Path, seed: int, plan: RoomPlan) -> Capture:
    """The capture of a room, filmed unless it has been."""
    size = f"{plan.width}x{plan.height}"
    return open_capture(write_demo(folder / f"seed{seed}-{size}", room_options(seed, plan), workers=1))


def room_options(seed: int, plan: RoomPlan) -> DemoOptions:
    """How a room is filmed: one instant; training rooms differ in noise and exposure, validation rooms are as the demo."""
    room = DemoOptions(seed=seed, width=plan.width, height=plan.height, n_frames=1, path_poses=0, depth_stride=0)
    if seed < FIRST_TRAINING_ROOM:
        return room
    rng = np.random.default_rng([seed, 84])
    return replace(room, noise_sigma_255=float(rng.uniform(0, 2.5)), exposure_spread=float(rng.uniform(0, 0.03)))


def choose_views(capture: Capture, plan: RoomPlan, seed: int, number: int) -> tuple[Camera, list[Camera]]:
    """Target and sources of a room's sample of that number; no target comes twice before every camera has been one.

    Reading:
        The paper draws inputs and target at random. Half of ours are the nearest cameras, as in the evaluation; the others are
        drawn from twice as many, so that the network also sees wide gaps.
    """
    count = len(capture.cameras)
    turn, place = divmod(number, count)
    target = capture.cameras[np.random.default_rng([seed, 85, turn]).permutation(count)[place]]
    rng = np.random.default_rng([seed, 86, number])
    views = int(rng.choice(plan.other_views)) if rng.random() < plan.other_share else plan.views
    if rng.random() >= plan.wide_share:
        return target, nearest_cameras(target, capture.cameras, views)
    near = nearest_cameras(target, capture.cameras, min(2 * views, count - 1))
    return target, [near[index] for index in sorted(rng.choice(len(near), views, replace=False))]
