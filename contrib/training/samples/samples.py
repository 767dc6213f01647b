"""Samples on disk: their sources, the kinds that are made of them, and the pool that keeps both
together.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import partial
from hashlib import sha256
from json import dumps
from pathlib import Path
from typing import ClassVar, Generic, Literal, Protocol, TypeVar

from ggvs_eval.arrays import Image8
from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture, DepthSource
from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.errors import TrainingError
from ggvs_eval.jobs.engine import run_all
from ggvs_eval.method import Instant, SourceView
from ggvs_eval.pipelines.offline.depth.camera_depth import (
    DepthEstimator,
    DepthOptions,
    check_depth,
    check_measured_depth,
)
from ggvs_eval.pipelines.offline.sensor.sensor_depth import SensorDepthEstimator
from ggvs_eval.tasks.task import FileTask


class SampleMaker:
    """Views of one instant of a capture, depth as `prepare` makes it.

    What several targets share is computed once.

    Args:
        options: how depth is computed by a matcher, or filtered where the camera has a sensor. The
            target takes no part in it.
    """

    def __init__(self, capture: Capture, options: DepthOptions, frame: int = 0) -> None:
        self.capture = capture
        self._options = options
        self._frame = frame
        self._images: dict[str, Image8] = {}
        self._depths: dict[tuple[str, ...], DepthMap] = {}

    def instant(self, target: Camera, sources: Sequence[Camera]) -> Instant:
        """Return what a method is shown of a target and its K source cameras, the target none of
        them.
        """
        depths = [(source, self._depth(source, target)) for source in sources]
        views = tuple(
            self._view(source, depth, depths[:k] + depths[k + 1 :])
            for k, (source, depth) in enumerate(depths)
        )
        return Instant(
            index=self._frame,
            target=target,
            sources=views,
            units_per_metre=self.capture.units_per_metre,
        )

    def image(self, camera: Camera) -> Image8:
        """Return the image that a camera took."""
        if camera.name not in self._images:
            self._images[camera.name] = self.capture.frame(camera.name, self._frame)
        return self._images[camera.name]

    def _depth(self, source: Camera, target: Camera) -> DepthMap:
        """Return the depth of a source camera, measured or found without the target."""
        sensor = self._sensor(source)
        partners = (
            []
            if sensor
            else self._options.choose_partners(source, self.capture.cameras, {target.name})
        )
        key = (source.name, *(partner.name for partner in partners))
        if key not in self._depths:
            if sensor is not None:
                self._depths[key] = SensorDepthEstimator(source, sensor).at(
                    self._frame, self.image(source)
                )
            else:
                estimator = DepthEstimator(source, partners, self._options)
                self._depths[key] = estimator.estimate(
                    self.image(source), [self.image(partner) for partner in partners]
                )
        return self._depths[key]

    def _view(
        self, source: Camera, depth_map: DepthMap, partners: Sequence[tuple[Camera, DepthMap]]
    ) -> SourceView:
        """Return a source, its depth checked against that of the others, as it is prepared for a
        view.
        """
        image = self.image(source)
        if self._sensor(source) is None:
            checked = check_depth(source, depth_map, partners, self._options)
        else:
            checked = check_measured_depth(source, image, depth_map, partners, self._options)
        return SourceView(
            camera=source, image=image, depth=checked.depth, confidence=checked.confidence
        )

    def _sensor(self, source: Camera) -> DepthSource | None:
        return self.capture.extras_of(source.name).depth if self._options.sensor else None


Sample = TypeVar("Sample")
Origin = Literal["rooms", "captures"]


class SampleSource(Protocol):
    """Numbered views to learn from, of procedural rooms or of a capture, for any kind of sample."""

    @property
    def origin(self) -> Origin:
        """Of rooms or of captures."""

    @property
    def count(self) -> int:
        """Number of its samples."""

    @property
    def most_views(self) -> int:
        """The largest K of a sample."""

    @property
    def least_size(self) -> tuple[int, int]:
        """Least width and height of a sample, pixels."""

    @property
    def matcher(self) -> str:
        """Name of the matcher whose depth the samples have where no sensor measured it."""

    def contents(self, depth: bool) -> str:
        """Contents of the samples, with or without depth, for the model card."""

    def describe(self, depth: bool) -> dict[str, object]:
        """Describe what a sample depends on besides its scene, its number and its kind.

        Folders are named by it.
        """

    def file_name(self, number: int) -> str:
        """Return the name of a sample's file, by its scene and its number."""

    def groups(self) -> list[list[int]]:
        """Return the numbers of the samples, those that share depth together: of one capture and
        one instant.
        """

    def opened(self, folder: Path, number: int) -> Capture:
        """Return the capture of a sample, at its size.

        `folder` keeps rooms once they are rendered.
        """

    def frame(self, number: int) -> int:
        """Return the instant of a sample."""

    def draw(self, capture: Capture, number: int) -> tuple[Camera, list[Camera]]:
        """Return the target and sources of a sample."""

    def kept(self, number: int) -> tuple[int, int, int, int] | None:
        """Left, top, width and height of the part of a sample that is kept, pixels.

        None keeps all of it.
        """


class SampleKind(ABC, Generic[Sample]):
    """Kind of sample: how one is made, and its file.

    Attributes:
        folders: beginnings of folders' names, and versions: each counts up whenever equal sources
            give other samples.
        depth: whether it depends on the depth of its sources.
        device: of the computation and of its depth; another one than ``cpu`` wants NVIDIA Warp.
    """

    folders: ClassVar[Mapping[Origin, tuple[str, int]]]
    depth: bool = True
    device: str = "cpu"

    @abstractmethod
    def make(self, maker: SampleMaker, target: Camera, sources: Sequence[Camera]) -> Sample:
        """Return the sample of a target and its source cameras."""

    @abstractmethod
    def cropped(self, sample: Sample, left: int, top: int, width: int, height: int) -> Sample:
        """Return the window of a sample that starts at pixel (left, top)."""

    @abstractmethod
    def read(self, path: Path) -> Sample:
        """Read a sample."""

    @abstractmethod
    def write(self, path: Path, sample: Sample) -> None:
        """Write a sample, the whole file or none."""

    def folder(self, source: SampleSource) -> str:
        """Return the name of the folder of a source's samples, by all that they depend on but their
        scene and their number.

        Reading:
            Samples of a GPU are stored separately: on the CPU equal inputs give equal bits, of a
            training too, and theirs differ in the last ones. The GPU is not recorded, since samples
            are rounded to 8 bits, where that moves next to nothing.
        """
        name, version = self.folders[source.origin]
        described = {"version": version, **source.describe(self.depth)}
        if self.device != "cpu":
            described["device"] = self.device.partition(":")[0]
        return f"{name}-{sha256(dumps(described, sort_keys=True).encode()).hexdigest()[:12]}"


class SamplePool(Generic[Sample]):
    """The samples of one kind of some sources, one source after the other, made once and kept on
    disk.

    Args:
        folder: where rooms and samples are kept; several pools, and several kinds, may share it.
    """

    def __init__(
        self, folder: Path, kind: SampleKind[Sample], sources: Sequence[SampleSource]
    ) -> None:
        self.kind = kind
        self.sources = tuple(sources)
        self._folder = folder

    def __repr__(self) -> str:
        """Return the sources, for the model card; the path is not recorded."""
        return "; ".join(map(repr, self.sources))

    def __len__(self) -> int:
        return sum(source.count for source in self.sources)

    def __add__(self, pool: "SamplePool[Sample]") -> "SamplePool[Sample]":
        """Both, one after the other: of one kind, in one folder."""
        return SamplePool(self._folder, self.kind, self.sources + pool.sources)

    @property
    def data(self) -> str:
        """Contents of the samples, for the model card."""
        return "; ".join(source.contents(self.kind.depth) for source in self.sources)

    def read(self, index: int) -> Sample:
        """Return one of the samples."""
        number = index
        for source in self.sources:
            if number < source.count:
                return self.kind.read(self.path(source, number))
            number -= source.count
        raise IndexError(index)

    def path(self, source: SampleSource, number: int) -> Path:
        """Return the file of a source's sample of that number."""
        return self._folder / self.kind.folder(source) / source.file_name(number)

    def tasks(self) -> list[FileTask]:
        """Return what makes the samples, a task for those that share depth."""
        return [
            self._task(source, numbers) for source in self.sources for numbers in source.groups()
        ]

    def _task(self, source: SampleSource, numbers: Sequence[int]) -> FileTask:
        by_name = {source.file_name(number): number for number in numbers}
        return FileTask(
            name=f"training views of {source!r}",
            folder=self._folder / self.kind.folder(source),
            inputs={},
            files=tuple(by_name),
            make=partial(_open_and_make, source, self.kind, self._folder, by_name),
            addressed=True,
        )

    def prepare(self, workers: int) -> None:
        """Make the samples that are not there yet; a killed preparation continues where it stopped.

        Args:
            workers: processes that share the tasks.
        """
        missing = filter(None, (task.left() for task in self.tasks()))
        run_all(FileTask.run, list(missing), workers, "training views")


def make_samples(
    source: SampleSource, kind: SampleKind[Sample], capture: Capture, paths: Mapping[int, Path]
) -> None:
    """Make samples of one capture and instant."""
    maker = SampleMaker(
        capture, DepthRunOptions(source.matcher).options(), source.frame(next(iter(paths)))
    )
    for number, path in paths.items():
        sample, window = kind.make(maker, *source.draw(capture, number)), source.kept(number)
        kind.write(path, kind.cropped(sample, *window) if window else sample)


def _open_and_make(
    source: SampleSource,
    kind: SampleKind[Sample],
    folder: Path,
    by_name: Mapping[str, int],
    files: tuple[str, ...],
) -> None:
    paths = {by_name[name]: folder / kind.folder(source) / name for name in files}
    make_samples(source, kind, source.opened(folder, next(iter(paths))), paths)


def require_room(samples: SamplePool[Sample], width: int, height: int) -> None:
    """Refuse samples in which crops of that size do not fit."""
    for source in samples.sources:
        least = source.least_size
        if least[0] < width or least[1] < height:
            raise TrainingError(
                f"crops of {width} x {height} do not fit samples of {least[0]} x {least[1]}; use "
                f"larger samples or smaller crops"
            )
