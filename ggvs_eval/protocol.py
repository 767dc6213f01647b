"""The protocol: everything that a number depends on besides the frames, in one hashed TOML file."""

import dataclasses
import hashlib
import json
import pathlib
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from typing import Any, Literal

from ggvs_eval.camera import SourceChoice
from ggvs_eval.errors import ProtocolError, did_you_mean, no_such_path
from ggvs_eval.files.images import ResizeFilter
from ggvs_eval.files.toml_tables import build_table, key_of, parse_toml, read_toml
from ggvs_eval.metric_choices import LATER, MetricChoices
from ggvs_eval.plugins import say_once

CalibrationChoice = Literal["given", "refined", "compare"]
WayName = Literal["as-is", "mvsnerf", "enerf"]
USUAL = ("PSNR", "SSIM", "LPIPS", "TCC", "STED")
# of renders that come with their reference
OF_OWN_TRUTH = ("PSNR", "SSIM", "LPIPS", "L1", "TCC", "STED", "Flicker", "SDT")
# change by 8 bit and another implementation, at most
AGREEING = {"PSNR": 0.05, "SSIM": 0.002, "LPIPS": 0.005}
COSTLIEST = "LPIPS"  # of the usual metrics; as much as all others
MOST_DIFFERENCES = 4  # that a message lists
OF_A_SCREEN = tuple(f"{name}_stream" for name in USUAL)  # metrics of earlier versions


@dataclass(frozen=True)
class SceneSources:
    """Cameras that any method may see in some scenes of a data set.

    Attributes:
        scenes: names of the scenes, as their folders are called.
        sources: names of the cameras.
    """

    scenes: tuple[str, ...]
    sources: tuple[str, ...]


@dataclass(frozen=True)
class Views:
    """Cameras that are synthesised, each from the others (leave-one-out).

    Attributes:
        test: names of the target cameras.
        chosen_by: who chose them and by which rule.
        keep_unsynced: keep cameras that are known to be out of step among the sources, as the code
            of some authors does.
        sources: names of the cameras that any method may see, in images or in depth; empty for
            every camera.
        of_scenes: such cameras where they differ by scene; the protocol is then one of these scenes
            alone.
        folds: groups of test cameras that are held out together from a method fitted to the
            capture, one fit per group. If it is empty and such a method runs, the run states the
            groups, see `ggvs_eval.pipelines.run.folds.choose_folds`.
    """

    test: tuple[str, ...]
    chosen_by: str = "by hand"
    keep_unsynced: bool = field(default=False, metadata=LATER)
    sources: tuple[str, ...] = field(default=(), metadata=LATER)
    of_scenes: tuple[SceneSources, ...] = field(default=(), metadata=LATER)
    folds: tuple[tuple[str, ...], ...] = field(default=(), metadata=LATER)

    def sources_of(self, scene: str) -> tuple[str, ...]:
        """Return the cameras that any method may see in a scene; empty for every camera.

        Raises:
            ProtocolError: the protocol lists scenes, and this is none of them.
        """
        if not self.of_scenes:
            return self.sources
        by_scene = {name: entry.sources for entry in self.of_scenes for name in entry.scenes}
        if scene not in by_scene:
            raise ProtocolError(
                f"the protocol names the sources of {', '.join(by_scene)}, got the scene {scene}; "
                "rename its folder, or choose another protocol"
            )
        return by_scene[scene]


@dataclass(frozen=True)
class Frames:
    """Consecutive instants that are synthesised.

    Attributes:
        start: the first frame.
        count: number of frames; 0 takes all that the capture has.
    """

    start: int = 0
    count: int = 0

    @property
    def numbers(self) -> range:
        """The frame numbers."""
        return range(self.start, self.start + self.count)


@dataclass(frozen=True)
class Synthesis:
    """Input of the methods: how many source views, which, and at which size.

    Attributes:
        k: number of source cameras.
        width: width of input and output images; 0 keeps the capture's.
        height: height of input and output images; 0 keeps the capture's.
        resize_filter: filter that resizes the capture's frames.
        sources: choice of the source cameras, the same for all methods: the ``nearest`` by centre,
            as in the paper; those whose calibration covers most of the target's view
            (``coverage``); or the three corners of the triangle around the target (``triplet``).
        calibration: cameras ``given``, ``refined`` by bundle adjustment, or ``compare``: those that
            render source cameras better, given ones up to an epipolar error of 0.5 pixels; none:
            given, not examined.
    """

    k: int = 4
    width: int = 0
    height: int = 0
    resize_filter: ResizeFilter = "lanczos"
    sources: SourceChoice = field(default="nearest", metadata=LATER)
    calibration: CalibrationChoice | None = field(default=None, metadata=LATER)


@dataclass(frozen=True)
class PathCamera:
    """One pose of a camera path, as `Camera.to_json` writes it.

    Attributes:
        K: intrinsics in pixels, (3, 3).
        world_to_camera: rigid transform, (4, 4), OpenCV axes.
        size: (width, height) in pixels; the path is rendered at the size of the first test view.
        near: smallest depth of the scene, world units.
        far: largest depth of the scene, world units.
    """

    K: tuple[tuple[float, ...], ...]
    world_to_camera: tuple[tuple[float, ...], ...]
    size: tuple[int, ...]
    near: float
    far: float


@dataclass(frozen=True)
class CameraPath:
    """A camera path that is synthesised at one instant, for epipolar plane images.

    Attributes:
        poses: number of virtual cameras; 0 for no path. A capture with a true path has its own
            number.
        cameras: the poses themselves where they were chosen, e.g. by `ggvs-eval view`; they come
            before all others.
        frame: the instant at which such poses are synthesised.
    """

    poses: int = 48
    cameras: tuple[PathCamera, ...] = field(default=(), metadata=LATER)
    frame: int = field(default=0, metadata={"left out with": "cameras"})


@dataclass(frozen=True)
class Measurement(MetricChoices):
    """Measurement of the 8-bit frames on disk.

    Attributes:
        metrics: names of the metrics, see `ggvs_eval.metrics.registry.METRICS`.
        width: width to which both images are resized before anything is measured; 0 keeps the
            rendered size.
        height: height to which both images are resized; 0 keeps the rendered size.
        resize_filter: filter that resizes both images.
        as_: way of measuring, see `ggvs_eval.measured_frames`: frames ``as-is``; ``mvsnerf``, as
            MVSNeRF's notebook measures LLFF (both resized to 960 x 640, a tenth cut off at every
            side, SSIM of range 2); ``enerf``, as ENeRF's evaluator does (the same without
            resizing).
        ceilings: also estimate the scores of perfect renderings, as grey rows of the tables.
        aggregation: order of the means.
    """

    metrics: tuple[str, ...] = USUAL
    width: int = 0
    height: int = 0
    resize_filter: ResizeFilter = "area"
    as_: WayName = field(default="as-is", metadata=LATER)
    ceilings: bool = True
    aggregation: Literal["frames, views, scenes"] = "frames, views, scenes"


@dataclass(frozen=True)
class StatedTime:
    """Time of a picture of a method where it is stated and not measured: of frames rendered
    elsewhere, or on another machine.

    Attributes:
        method: its label.
        ms: milliseconds of each of its stages, in order.
    """

    method: str
    ms: tuple[float, ...]


@dataclass(frozen=True)
class Stream:
    """Conditions under which pictures reach a screen, for rows of what a viewer sees at every
    instant.

    See `ggvs_eval.metrics.time.on_screen`. A method's clock is the median time of each of its
    stages as the run has recorded it, or what is stated here.

    Attributes:
        fps: frames per second of the cameras.
        policy: a method takes the newest frame whenever it is free and drops those in between.
            ``drop`` shows each picture as soon as it is ready; ``deadline`` never shows one that is
            late.
        deadline_ms: longest time from the capture of a frame to its picture under ``deadline``; 150
            ms is the delay up to which ITU-T G.114 finds a conversation undisturbed.
        pipelined: stages of a method work on different frames at once: more pictures per second,
            none of them sooner.
        depth_ms: time of the depth of all sources of a picture; by default that of the run,
            measured with the matcher ``live`` and 0 with others, whose depth is computed before.
        stated: times of methods that the run did not measure, as tables of `method` and `ms` (one
            per stage).
        warm_up: instants at the beginning of the clip that are not scored. Methods are ranked on
            the instants that all of them show; one whose first picture comes later is measured from
            there on.
    """

    fps: float
    policy: Literal["drop", "deadline"] = "drop"
    deadline_ms: float = 150.0
    pipelined: bool = False
    depth_ms: float | None = field(default=None, metadata=LATER)
    stated: tuple[StatedTime, ...] = ()
    warm_up: int = 0


@dataclass(frozen=True)
class Protocol:
    """One evaluation protocol; equal protocols have equal hashes, regardless of their files.

    Attributes:
        name: name of the protocol.
        dataset: name of the data set in tables; published values are shown next to runs of the same
            name only.
        stream: how pictures reach a screen, for rows of what a viewer sees; None if every picture
            is waited for.
    """

    name: str
    dataset: str
    views: Views
    frames: Frames = Frames()
    synthesis: Synthesis = Synthesis()
    measurement: Measurement = Measurement()
    path: CameraPath = CameraPath()
    stream: Stream | None = field(default=None, metadata=LATER)

    def with_folds(self, folds: tuple[tuple[str, ...], ...]) -> "Protocol":
        """Return the protocol with these folds stated, or with none."""
        return dataclasses.replace(self, views=dataclasses.replace(self.views, folds=folds))

    def agrees_with(self, protocol: "Protocol") -> bool:
        """Return whether one run folder can serve both: they are equal, or one of them leaves its
        folds open.
        """
        is_equal = self.with_folds(()) == protocol.with_folds(())
        return is_equal and (
            not self.views.folds
            or not protocol.views.folds
            or self.views.folds == protocol.views.folds
        )

    def over(self, n_frames: int) -> "Protocol":
        """Return the protocol over a clip of N instants: all from its first one, if it sets no
        number.
        """
        if self.frames.count:
            return self
        return dataclasses.replace(
            self,
            frames=dataclasses.replace(self.frames, count=max(n_frames - self.frames.start, 1)),
        )

    def shortened(self, frames: int | None, path_poses: int | None) -> "Protocol":
        """Return the protocol over its first N instants and with a camera path of N poses.

        None keeps either.

        Raises:
            ProtocolError: no instant, or a negative number of poses.
        """
        count = self.frames.count if frames is None else min(frames, self.frames.count)
        poses = self.path.poses if path_poses is None else path_poses
        if count < 1 or poses < 0:
            raise ProtocolError(
                f"protocol: wanted one frame or more and no negative number of poses, got "
                f"{frames}, {path_poses}"
            )
        frames_kept, path = (
            dataclasses.replace(self.frames, count=count),
            dataclasses.replace(self.path, poses=poses),
        )
        return dataclasses.replace(self, frames=frames_kept, path=path)

    def streamed(self, stream: Stream) -> "Protocol":
        """Return the protocol with these conditions, unless it has its own.

        The warm-up is at most half of its instants.
        """
        fitting = dataclasses.replace(stream, warm_up=min(stream.warm_up, self.frames.count // 2))
        return dataclasses.replace(self, stream=self.stream or fitting)

    @property
    def sha256(self) -> str:
        """Hash of every value (not of the file's layout or comments).

        Results carry it, tables refuse to mix it.
        """
        return hashlib.sha256(json.dumps(self.values(), sort_keys=True).encode()).hexdigest()

    def values(self) -> dict[str, Any]:
        """Return every value as TOML and JSON know it, without later choices that are not made."""
        return _values_of(self)

    def to_toml(self) -> str:
        """Return the protocol as a TOML file that `load_protocol` reads back."""
        values = self.values()
        lines = [
            f"{key} = {_toml_value(value)}"
            for key, value in values.items()
            if not isinstance(value, dict)
        ]
        for section, table in values.items():
            if isinstance(table, dict):
                lines += [
                    "",
                    f"[{section}]",
                    *(f"{key} = {_toml_value(value)}" for key, value in table.items()),
                ]
        return "\n".join(lines) + "\n"


def _values_of(table: Any) -> dict[str, Any]:
    fields = {attribute.name: attribute for attribute in dataclasses.fields(table)}
    values = {}
    for name, attribute in fields.items():
        companion = attribute.metadata.get("left out with", name)
        if not attribute.metadata or getattr(table, companion) != fields[companion].default:
            value = getattr(table, name)
            values[key_of(name)] = (
                _values_of(value) if dataclasses.is_dataclass(value) else _plain(value)
            )
    return values


def _plain(value: Any) -> Any:
    """Return a value within tuples as `dataclasses.asdict` gives it."""
    if isinstance(value, tuple):
        return tuple(map(_plain, value))
    return (
        dataclasses.asdict(value)
        if dataclasses.is_dataclass(value) and not isinstance(value, type)
        else value
    )


def load_protocol(source: str | pathlib.Path) -> Protocol:
    """Read a protocol from a TOML file, or one that ships with the package by its name (``demo``,
    ``dynerf``, ...).

    Raises:
        ProtocolError: no such file, not TOML, or an unknown, missing or mistyped key; the message
            names the nearest known one.

    Examples:
        >>> protocol = load_protocol("dynerf")
        >>> protocol.views.test[:3], protocol.synthesis.k
        (('cam00', 'cam02', 'cam04'), 4)
        >>> load_protocol("dinerf")
        Traceback (most recent call last):
        ggvs_eval.errors.ProtocolError: protocol 'dinerf' is not packaged; ...; did you mean dynerf?
    """
    path = pathlib.Path(source)
    if path.suffix == ".toml":
        if not path.is_file():
            raise ProtocolError(no_such_path(path, "a protocol file or a packaged name"))
        values = read_toml(path, ProtocolError)
    else:
        if str(source) not in packaged_protocols():
            packaged = packaged_protocols()
            choice = (
                f"a .toml file or one of {', '.join(packaged)}{did_you_mean(str(source), packaged)}"
            )
            raise ProtocolError(f"protocol {str(source)!r} is not packaged; use {choice}")
        text = (resources.files("ggvs_eval") / "protocols" / f"{source}.toml").read_text(
            encoding="utf-8"
        )
        values = parse_toml(text, str(source), ProtocolError)
    values = {"name": path.stem, **values}
    values = {"dataset": values["name"], **values}
    protocol = build_table(Protocol, values, str(source), "", ProtocolError)
    return checked_protocol(_without_screens(protocol, str(source)), str(source))


def _without_screens(protocol: Protocol, file: str) -> Protocol:
    """Return a protocol of an earlier version without metrics of displayed frames, and say so."""
    metrics = protocol.measurement.metrics
    if gone := [name for name in metrics if name in OF_A_SCREEN]:
        where = "what a viewer sees of METHOD is the row METHOD@screen, in every metric"
        say_once(f"{file}: without {', '.join(gone)}; {where}")
    remaining = tuple(name for name in metrics if name not in OF_A_SCREEN)
    return dataclasses.replace(
        protocol, measurement=dataclasses.replace(protocol.measurement, metrics=remaining)
    )


def name_differences(first: Mapping[str, Any], second: Mapping[str, Any]) -> str:
    """Return the first differences of two records in words, as ``a.b: 1 and 2``.

    Of lists what one of them has alone.
    """
    differing = _differences(first, second)
    more = (
        f" and {len(differing) - MOST_DIFFERENCES} more"
        if len(differing) > MOST_DIFFERENCES
        else ""
    )
    return "; ".join(differing[:MOST_DIFFERENCES]) + more


def _differences(first: Any, second: Any, name: str = "") -> list[str]:
    if isinstance(first, Mapping) and isinstance(second, Mapping):
        keys = dict.fromkeys([*first, *second])
        return [
            text
            for key in keys
            for text in _differences(first.get(key), second.get(key), f"{name}.{key}".lstrip("."))
        ]
    if first == second:
        return []
    if (
        isinstance(first, list | tuple)
        and isinstance(second, list | tuple)
        and {*map(str, first)} != {*map(str, second)}
    ):
        alone = [
            [str(value) for value in side if value not in opposite]
            for side, opposite in ((first, second), (second, first))
        ]
        first, second = (", ".join(values) or "none" for values in alone)
    return [f"{name}: {str(first)[:60]} and {str(second)[:60]}"]


def packaged_protocols() -> list[str]:
    """Return the names of the protocols that ship with the package.

    Examples:
        >>> "dynerf" in packaged_protocols()
        True
    """
    folder = resources.files("ggvs_eval") / "protocols"
    return sorted(
        item.name.removesuffix(".toml") for item in folder.iterdir() if item.name.endswith(".toml")
    )


def checked_protocol(protocol: Protocol, file: str) -> Protocol:
    """Refuse values of the right type that make no sense, naming the rule and the file."""
    synthesis, measurement, stream = protocol.synthesis, protocol.measurement, protocol.stream
    times_ms = (
        []
        if stream is None
        else [stream.depth_ms or 0.0, *(ms for row in stream.stated for ms in row.ms)]
    )
    labels = [] if stream is None else [row.method for row in stream.stated]
    views, folded = protocol.views.test, [view for fold in protocol.views.folds for view in fold]
    rules = {
        "views.test must name each test view once, and at least one": views
        and len(set(views)) == len(views),
        "views.sources must name each camera once": len(set(protocol.views.sources))
        == len(protocol.views.sources),
        "views.folds must hold each of views.test once, and nothing else": not folded
        or sorted(folded) == sorted(views),
        "frames.start and frames.count must be at least 0": protocol.frames.start >= 0
        and protocol.frames.count >= 0,
        "synthesis.k must be at least 1": synthesis.k >= 1,
        "path.poses must be 0 or at least 2": protocol.path.poses == 0 or protocol.path.poses >= 2,
        "path.poses must be the number of path.cameras": len(protocol.path.cameras)
        in (0, protocol.path.poses),
        "synthesis.width and height must both be positive, or both 0": _is_size(
            synthesis.width, synthesis.height
        ),
        "measurement.width and height must both be positive, or both 0": _is_size(
            measurement.width, measurement.height
        ),
        "measurement.metrics must name at least one metric": measurement.metrics,
        "measurement.ddof must be 0 or 1": measurement.ddof in (0, 1),
        "measurement.lpips_every must be at least 1": measurement.lpips_every >= 1,
        "stream.fps and stream.deadline_ms must be positive": stream is None
        or (stream.fps > 0 and stream.deadline_ms > 0),
        "stream.warm_up must leave an instant": stream is None
        or 0 <= stream.warm_up < (protocol.frames.count or sys.maxsize),
        "stream.depth_ms and stream.stated must have no negative time": min(times_ms, default=0.0)
        >= 0,
        "stream.stated must name each method once, with a time": len({*labels}) == len(labels)
        and (stream is None or all(row.ms for row in stream.stated)),
    }
    for rule, holds in rules.items():
        if not holds:
            raise ProtocolError(f"{file}: {rule}")
    return protocol


def _is_size(width: int, height: int) -> bool:
    return (width > 0 and height > 0) or (width == 0 and height == 0)


def _toml_value(value: Any) -> str:
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{key} = {_toml_value(entry)}' for key, entry in value.items())} }}"
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml_value, value))}]"
    return json.dumps(value)
