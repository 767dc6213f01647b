"""Samples of captures on disk, whatever a sample is, with the depth that a sensor measured or with stereo."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture, DepthSource
from ggvs_eval.datasets.units import DEMO_NOTES
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.errors import TrainingError
from ggvs_eval.files.digest import digest_values
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions, check_measured_depth
from ggvs_eval.pipelines.offline.depth.depth_choice import DepthRunOptions
from ggvs_eval.pipelines.offline.sensor.sensor_depth import SensorDepthEstimator
from ggvs_eval.pipelines.training.samples.blend_samples import SampleMaker
from ggvs_eval.pipelines.training.samples.capture_views import CapturePlan, draw_views, is_sequence, possible_targets
from ggvs_eval.pipelines.training.samples.samples import Job, Sample, SampleKind, Samples
from ggvs_eval.synthetic.domains import FIRST_TRAINING_SEED, VALIDATION_SEEDS


class CapturePool(Samples[Sample]):
    """The samples of some captures on disk; a capture is whatever `open_capture` opens: ScanNet, Spaces, DyNeRF, one's own rig.

    A test capture must never be trained on: none of those that the packaged protocols name test views of, nor any other that
    results are told of. Only the demo capture and its likes can be told from others here, and are refused.

    Args:
        folder: where samples are kept; several plans, and several kinds of samples, may share it.
        captures: what to learn from, at their own size.
        plan: which samples.
        kind: what a sample is.
        name: of the kind; folders begin with it.
        version: of the samples: counts up whenever equal plans give other ones.

    Raises:
        TrainingError: a capture that is for tests, too small, given twice, or has too few cameras.
    """

    def __init__(
        self, folder: Path, captures: Sequence[Capture], plan: CapturePlan, kind: SampleKind[Sample], name: str, version: int
    ) -> None:
        self.plan = plan
        self._kind = kind
        self._folder = folder / f"{name}-{_digest(plan, version, kind)}"
        self._names = [_name(capture) for capture in captures]
        if not captures or len(set(self._names)) < len(captures):
            listed = ", ".join(str(capture.path) for capture in captures) or "none"
            raise TrainingError(f"captures to learn from: wanted at least one, and each once, got {listed}")
        for capture in captures:
            _refuse_tests(capture)
            _check_cameras(capture, plan)
        self._captures = [_reduced(capture, plan) for capture in captures]

    def __repr__(self) -> str:
        """Scenes and plan; the model card shows them, and where the folders lie is nobody's business."""
        return f"{', '.join(capture.scene for capture in self._captures)}: {self.plan!r}"

    def __len__(self) -> int:
        return len(self._captures) * self.plan.targets

    @property
    def plans(self) -> tuple[CapturePlan]:
        """Which samples there are."""
        return (self.plan,)

    @property
    def data(self) -> str:
        """Contents of the samples, for the model card."""
        scenes = ", ".join(capture.scene for capture in self._captures)
        depth = f"depth as measured or by {self.plan.matcher}" if self._kind.depth else "no depth"
        return f"{len(self)} views of the captures {scenes}, {depth}"

    def read(self, index: int) -> Sample:
        """One of the samples.

        Raises:
            TrainingError: it has not been prepared, or is damaged.
        """
        capture, number = divmod(index, self.plan.targets)
        return self._kind.read(self._path(capture, number))

    def jobs(self) -> list[Job]:
        """Make samples that are not there yet; targets that share an instant, and thereby depth, are one job."""
        jobs: list[Job] = []
        for index, capture in enumerate(self._captures):
            for numbers in _groups(capture, self.plan):
                lacking = {number: path for number in numbers if not (path := self._path(index, number)).is_file()}
                if lacking:
                    jobs.append(partial(make_samples, capture, self.plan, self._names[index], lacking, self._kind))
        return jobs

    def _path(self, capture: int, number: int) -> Path:
        return self._folder / f"{self._names[capture]}-{number:04d}.npz"


def make_samples(capture: Capture, plan: CapturePlan, name: str, paths: Mapping[int, Path], kind: SampleKind[Sample]) -> None:
    """Make samples of one instant of a capture; runs in a worker.

    Args:
        capture: at the size of the samples.
        plan: which samples.
        name: of the capture; with a sample's number it decides what is drawn.
        paths: number of each sample, and where it goes.
        kind: what a sample is.
    """
    maker = MeasuredSampleMaker(capture, DepthRunOptions(plan.matcher).options(), _instant(capture, plan, next(iter(paths))))
    for number, path in paths.items():
        kind.write(path, kind.make(maker, *draw_views(capture, plan, name, number)))


class MeasuredSampleMaker(SampleMaker):
    """Takes measured depth, filtered, where a source camera has a sensor, and stereo where it has none.

    Args:
        capture: at the size of the samples.
        options: how depth is computed or filtered. The target takes no part in it.
        frame: the instant.
    """

    def __init__(self, capture: Capture, options: DepthOptions, frame: int = 0) -> None:
        super().__init__(capture, options, frame)
        self._measured: dict[str, DepthMap] = {}

    def _depth(self, source: Camera, target: Camera) -> DepthMap:
        sensor = self._sensor(source)
        if sensor is None or self._options.sensor is None:
            return super()._depth(source, target)
        if source.name not in self._measured:
            estimator = SensorDepthEstimator(source, sensor, self._options.sensor)
            self._measured[source.name] = estimator.at(self._frame, self._image(source.name))
        return self._measured[source.name]

    def _checked(self, source: Camera, depth_map: DepthMap, others: Sequence[tuple[Camera, DepthMap]]) -> DepthMap:
        if self._sensor(source) is None:
            return super()._checked(source, depth_map, others)
        return check_measured_depth(source, self._image(source.name), depth_map, others, self._options)

    def _sensor(self, source: Camera) -> DepthSource | None:
        return None if self._options.sensor is None else self.capture.extras_of(source.name).depth


def _groups(capture: Capture, plan: CapturePlan) -> list[list[int]]:
    """Numbers of the samples, those of one instant of a rig together; frames of a sequence share too little to be kept."""
    if is_sequence(capture):
        return [[number] for number in range(plan.targets)]
    return [list(range(first, plan.targets, plan.instants)) for first in range(min(plan.instants, plan.targets))]


def _instant(capture: Capture, plan: CapturePlan, number: int) -> int:
    """Frame number of a sample: turn by turn one of the evenly spaced instants."""
    return round((number % plan.instants + 0.5) / plan.instants * capture.n_frames - 0.5)


def _reduced(capture: Capture, plan: CapturePlan) -> Capture:
    """The capture as small as the plan allows, in its own shape."""
    width, height = capture.cameras[0].size
    share = max(plan.width / width, plan.height / height)
    return capture.resized(round(width * share), round(height * share), "area")


def _check_cameras(capture: Capture, plan: CapturePlan) -> None:
    small = [camera for camera in capture.cameras if camera.width < plan.width or camera.height < plan.height]
    if small:
        size = f"{small[0].width} x {small[0].height} of {small[0].name}"
        raise TrainingError(
            f"{capture.path}: wanted images of at least {plan.width} x {plan.height}, got {size}; lower the plan's"
        )
    if len({camera.size for camera in capture.cameras}) > 1:
        raise TrainingError(f"{capture.path}: wanted cameras of one size to learn from, got several; resize the images")
    if plan.instants > capture.n_frames:
        raise TrainingError(f"{capture.path}: wanted {plan.instants} instants, the capture has {capture.n_frames} frames")
    if not possible_targets(capture, plan):
        rule = f" numbered {plan.gap + 1}..{plan.span} from it" if is_sequence(capture) else ""
        raise TrainingError(
            f"{capture.path}: wanted a target with {plan.views} other cameras{rule}, got {len(capture.cameras)} cameras and none "
            "with as many; lower the plan's views or give more frames"
        )


def _refuse_tests(capture: Capture) -> None:
    """A procedural capture says which room it shows; all but training and validation rooms are for tests."""
    file = capture.path / DEMO_NOTES
    if not file.is_file():
        return
    try:
        seed = int(json.loads(file.read_text(encoding="utf-8"))["options"]["seed"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise TrainingError(f"{file}: wanted the seed of a demo capture, got none ({error}); write it again") from error
    if seed < FIRST_TRAINING_SEED and seed not in VALIDATION_SEEDS:
        raise TrainingError(
            f"{capture.path}: the demo capture of seed {seed} is for tests and must not be learned from; make another by "
            f"`ggvs-eval demo --seed {FIRST_TRAINING_SEED}`"
        )


def _name(capture: Capture) -> str:
    """Tells captures apart by where their cameras stand and what the first one shows."""
    cameras = [f"{camera.name} {camera.to_json()}" for camera in capture.cameras]
    return f"{capture.scene}-{digest_values(capture.sources[0].digest, str(capture.n_frames), *cameras)[:12]}"


def _digest(plan: CapturePlan, version: int, kind: SampleKind[Sample]) -> str:
    """Names all that a sample depends on but its capture and its number."""
    options = DepthRunOptions(plan.matcher).options()
    described: dict[str, object] = {
        "version": version,
        "plan": {name: value for name, value in asdict(plan).items() if name != "targets"},
        "depth": options.describe() if kind.depth else None,
        "sensor": options.sensor.describe() if kind.depth and options.sensor else None,
        "consistency": options.consistency.describe() if kind.depth and options.consistency else None,
        **kind.describe(),
    }
    return hashlib.sha256(json.dumps(described, sort_keys=True).encode()).hexdigest()[:12]
