"""A capture to learn from, reduced to the size of its samples; captures for tests are refused."""

import hashlib
import json
from collections.abc import Collection, Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from ggvs_eval.camera import Camera, nearest_cameras
from ggvs_eval.capture import Capture
from ggvs_eval.contrib.worlds.domains import FIRST_TRAINING_SEED, VALIDATION_SEEDS
from ggvs_eval.datasets.units import DEMO_NOTES
from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.errors import TrainingError
from ggvs_eval.files.digest import digest_values
from ggvs_eval.pipelines.offline.depth.consistency import describe_check
from ggvs_eval.pipelines.offline.sensor.sensor_depth import describe_filter

GRID = 8  # rays across and down, and depths


@dataclass(frozen=True)
class CapturePlan:
    """Plan of the samples of each capture.

    More targets add samples and change none, of rigs as long as `instants` stays.

    Attributes:
        span: sequences: sources maximum distance of a source from the target, frames
        gap: exclusive minimum of that distance, frames
        overlap: ... and see this share of the target's view; where fewer than K do, those that see
            most are taken.
        wide_share: rigs: share of the samples whose sources are drawn from twice as many near
            cameras, not the nearest.
        instants: rigs: number of instants of targets, evenly spaced over the capture.
        width: least width of the samples, pixels; captures are reduced, in their own shape, as far
            as both sides allow.
        height: least height of the samples, pixels.
        matcher: whose depth the samples have where no sensor measured it, see
            `ggvs_eval.pipelines.offline.depth.depth_choice`.
    """

    targets: int = 24
    views: int = 4
    span: int = 30
    gap: int = 4
    overlap: float = 0.5
    wide_share: float = 0.5
    instants: int = 1
    width: int = 480
    height: int = 360
    matcher: str = "sgbm"

    def __post_init__(self) -> None:
        """Refuse plans without samples."""
        if (
            min(self.targets, self.views, self.instants, self.width, self.height) < 1
            or not 0 <= self.gap < self.span
        ):
            raise TrainingError(
                f"wanted at least one target, view, instant and pixel, and 0 <= gap < span, got "
                f"{self}"
            )


def draw_views(
    capture: Capture, plan: CapturePlan, name: str, number: int
) -> tuple[Camera, list[Camera]]:
    """Return the target and sources, nearest first, of a capture's sample of that number.

    No target comes twice before every camera that can be one has been one.

    Args:
        capture: a sequence (RGB-D: each frame is a camera) or a rig.

    Reading:
        ScanNet's rule counts frames as they are numbered, also where an export leaves numbers out,
        and draws evenly. It is made for 30 frames per second; in a sequence of fewer it also allows
        frames that look elsewhere, from which nothing can be learned, hence the overlap: without it
        the sources of five targets of a HoloLens sequence covered 51 % of them, with it 74 %. Rigs
        are treated as the training rooms are: the nearest cameras, or some of twice as many.
    """
    seed = int(hashlib.sha256(name.encode()).hexdigest()[:8], 16)
    targets = possible_targets(capture, plan)
    turn, place = divmod(number, len(targets))
    target = targets[np.random.default_rng([seed, 95, turn]).permutation(len(targets))[place]]
    rng = np.random.default_rng([seed, 96, number])
    if is_sequence(capture):
        candidates = within_rule(capture, target, plan)
        shares = {camera.name: overlap(target, camera) for camera in candidates}
        enough = [camera for camera in candidates if shares[camera.name] >= plan.overlap]
        pool = (
            enough
            if len(enough) >= plan.views
            else sorted(candidates, key=lambda view: -shares[view.name])[: plan.views]
        )
    else:
        wide = rng.random() < plan.wide_share
        pool = nearest_cameras(
            target,
            capture.cameras,
            min(2 * plan.views, len(capture.cameras) - 1) if wide else plan.views,
        )
    sources = [pool[index] for index in rng.choice(len(pool), plan.views, replace=False)]
    return target, nearest_cameras(target, sources, plan.views)


def is_sequence(capture: Capture) -> bool:
    """Return whether the cameras of a capture are the frames of one moving camera, called by their
    numbers.
    """
    return capture.layout == "rgbd"


def within_rule(capture: Capture, target: Camera, plan: CapturePlan) -> list[Camera]:
    """Return the frames of a sequence that may be sources of a target: within `span` of it, but not
    within `gap`.
    """
    at = int(target.name)
    return [
        camera for camera in capture.cameras if plan.gap < abs(int(camera.name) - at) <= plan.span
    ]


def overlap(target: Camera, source: Camera) -> float:
    """Return the share of the target's view, at depths from near to far, that is in the source's
    image.
    """
    across, down = np.meshgrid(*((np.arange(GRID) + 0.5) / GRID * size for size in target.size))
    depths = np.geomspace(target.near, target.far, GRID)[1:-1, None, None]
    uv = np.broadcast_to(np.stack([across, down], axis=-1), (GRID - 2, GRID, GRID, 2))
    seen_at, depth = source.project(target.unproject(uv, np.broadcast_to(depths, uv.shape[:-1])))
    return float(np.mean((depth > 0) & ((seen_at > 0) & (seen_at < source.size)).all(axis=-1)))


def possible_targets(capture: Capture, plan: CapturePlan) -> list[Camera]:
    """Return the cameras that have enough others to be synthesised from."""
    if not is_sequence(capture):
        return list(capture.cameras) if len(capture.cameras) > plan.views else []
    numbers = np.array([int(camera.name) for camera in capture.cameras])
    apart = np.abs(numbers[:, None] - numbers)
    counts = ((apart > plan.gap) & (apart <= plan.span)).sum(axis=1)
    return [
        camera for camera, count in zip(capture.cameras, counts, strict=True) if count >= plan.views
    ]


def held_back_halves(
    capture: Capture, span: int = 30, most_overlap: float = 0.5
) -> tuple[Capture, Capture]:
    """Return the frames to learn from and those held back, with `span` frames between them that
    belong to neither.

    Args:
        capture: an RGB-D sequence.
        span: how far from its target a source may be: what either part's samples show is at least
            so far from the other's.
        most_overlap: frames of whose view a learned frame sees a larger share belong to neither,
            see `overlap`.

    Raises:
        TrainingError: no sequence, or too short, or all of it comes back to what is learned.

    Reading:
        The first half in time is learned from. A camera that comes back sees again what it saw
        before: such frames of the second half are left out, so that apart are the places as well as
        noise, blur and the errors of depth and poses.
    """
    numbers = [int(camera.name) for camera in capture.cameras] if is_sequence(capture) else []
    middle = (numbers[0] + numbers[-1] + 1) // 2 if numbers else 0
    learned = [
        camera for camera, number in zip(capture.cameras, numbers, strict=False) if number < middle
    ]
    later = [
        camera
        for camera, number in zip(capture.cameras, numbers, strict=False)
        if number >= middle + span
    ]
    apart = [
        camera
        for camera in later
        if all(overlap(camera, known_view) <= most_overlap for known_view in learned)
    ]
    if not learned or not apart:
        raise TrainingError(
            f"{capture.path}: wanted a sequence of one moving camera, longer than {2 * span} "
            f"frames, whose second half sees what is new, got {len(numbers)} frames of layout "
            f"{capture.layout}, {len(later)} after the gap, {len(apart)} of them new; give another "
            "RGB-D sequence or a smaller span"
        )
    return restricted(capture, {camera.name for camera in learned}), restricted(
        capture, {camera.name for camera in apart}
    )


def restricted(capture: Capture, names: Collection[str]) -> Capture:
    """Return the capture with some of its cameras only, in its own order, without a note of it."""
    indices = [index for index, name in enumerate(capture.camera_names) if name in names]
    return replace(
        capture,
        cameras=tuple(capture.cameras[index] for index in indices),
        sources=tuple(capture.sources[index] for index in indices),
        extras=tuple(capture.extras[index] for index in indices) if capture.extras else (),
    )


class CaptureSource:
    """The views of a capture; any that `open_capture` opens: ScanNet, Spaces, DyNeRF, your own rig.

    A test capture must never be trained on: none of those that the packaged protocols name test
    views of, nor any other that results are reported for. Only the demo capture and its likes can
    be recognised here, and are refused.

    Raises:
        TrainingError: a capture that is for tests, too small, or has too few cameras.
    """

    origin: Literal["captures"] = "captures"

    def __init__(self, capture: Capture, plan: CapturePlan) -> None:
        _refuse_tests(capture)
        _check_cameras(capture, plan)
        self.name = _name(capture)
        self.plan = plan
        self.capture = _reduced(capture, plan)
        self.count, self.most_views, self.least_size = (
            plan.targets,
            plan.views,
            (plan.width, plan.height),
        )
        self.matcher = plan.matcher

    def __repr__(self) -> str:
        """Scene and plan, for the model card; the path is not recorded."""
        return f"{self.capture.scene}: {self.plan!r}"

    def contents(self, depth: bool) -> str:
        """See `SampleSource`."""
        how = f"depth as measured or by {self.plan.matcher}" if depth else "no depth"
        return f"{self.count} views of the captures {self.capture.scene}, {how}"

    def describe(self, depth: bool) -> dict[str, object]:
        """See `SampleSource`."""
        options = DepthRunOptions(self.plan.matcher).options()
        return {
            "plan": {name: value for name, value in asdict(self.plan).items() if name != "targets"},
            "depth": options.describe() if depth else None,
            "sensor": describe_filter() if depth and options.sensor else None,
            "consistency": describe_check() if depth and options.consistency else None,
        }

    def file_name(self, number: int) -> str:
        """See `SampleSource`."""
        return f"{self.name}-{number:04d}.npz"

    def groups(self) -> list[list[int]]:
        """Return the numbers of one instant of a rig together.

        Frames of a sequence share too little depth to be kept.
        """
        targets, instants = self.plan.targets, self.plan.instants
        if is_sequence(self.capture):
            return [[number] for number in range(targets)]
        return [list(range(first, targets, instants)) for first in range(min(instants, targets))]

    def opened(self, folder: Path, number: int) -> Capture:
        """Return the capture itself."""
        return self.capture

    def frame(self, number: int) -> int:
        """Turn by turn one of the evenly spaced instants."""
        return round(
            (number % self.plan.instants + 0.5) / self.plan.instants * self.capture.n_frames - 0.5
        )

    def draw(self, capture: Capture, number: int) -> tuple[Camera, list[Camera]]:
        """See `draw_views`."""
        return draw_views(capture, self.plan, self.name, number)

    def kept(self, number: int) -> None:
        """All of it."""


def capture_sources(captures: Iterable[Capture], plan: CapturePlan) -> list[CaptureSource]:
    """Captures to learn from, by one plan.

    Raises:
        TrainingError: a capture given twice, or one that cannot be learned from, see
            `CaptureSource`.
    """
    sources = [CaptureSource(capture, plan) for capture in captures]
    if len({source.name for source in sources}) < len(sources):
        listed = ", ".join(str(source.capture.path) for source in sources)
        raise TrainingError(f"--captures: wanted each once, got {listed}")
    return sources


def _reduced(capture: Capture, plan: CapturePlan) -> Capture:
    """Return the capture as small as the plan allows, in its own shape."""
    width, height = capture.cameras[0].size
    share = max(plan.width / width, plan.height / height)
    return capture.resized(round(width * share), round(height * share), "area")


def _check_cameras(capture: Capture, plan: CapturePlan) -> None:
    small = [
        camera
        for camera in capture.cameras
        if camera.width < plan.width or camera.height < plan.height
    ]
    if small:
        size = f"{small[0].width} x {small[0].height} of {small[0].name}"
        raise TrainingError(
            f"{capture.path}: wanted images of at least {plan.width} x {plan.height}, got {size}; "
            f"lower the plan's"
        )
    if len({camera.size for camera in capture.cameras}) > 1:
        raise TrainingError(
            f"{capture.path}: wanted cameras of one size to learn from, got several; resize the "
            f"images"
        )
    if plan.instants > capture.n_frames:
        raise TrainingError(
            f"{capture.path}: wanted {plan.instants} instants, the capture has {capture.n_frames} "
            f"frames"
        )
    if not possible_targets(capture, plan):
        rule = f" numbered {plan.gap + 1}..{plan.span} from it" if is_sequence(capture) else ""
        raise TrainingError(
            f"{capture.path}: wanted a target with {plan.views} other cameras{rule}, got "
            f"{len(capture.cameras)} cameras and none with as many; lower the plan's views or give "
            "more frames"
        )


def _refuse_tests(capture: Capture) -> None:
    """A procedural capture names its room.

    All except training and validation rooms are for tests.
    """
    file = capture.path / DEMO_NOTES
    if not file.is_file():
        return
    try:
        seed = int(json.loads(file.read_text(encoding="utf-8"))["options"]["seed"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise TrainingError(
            f"{file}: wanted the seed of a demo capture, got none ({error}); write it again"
        ) from error
    if seed < FIRST_TRAINING_SEED and seed not in VALIDATION_SEEDS:
        raise TrainingError(
            f"{capture.path}: the demo capture of seed {seed} is for tests, not for training; film "
            f"another by `ggvs-eval film --seed {FIRST_TRAINING_SEED}`"
        )


def _name(capture: Capture) -> str:
    """Distinguish captures by the poses of their cameras and the first one's picture."""
    cameras = [f"{camera.name} {camera.to_json()}" for camera in capture.cameras]
    digest = digest_values(capture.sources[0].digest, str(capture.n_frames), *cameras)
    return f"{capture.scene}-{digest[:12]}"
