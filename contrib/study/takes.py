"""Takes of a capture: time windows of pairs of views, and stretches of a camera path of which the
true images are known.
"""

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.contrib.study.clips import Clip, SourceClip, Take, write_take
from ggvs_eval.contrib.study.rendered_ladders import render, require_sources
from ggvs_eval.datasets import open_capture
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.datasets.llff import open_path
from ggvs_eval.depth_store import DepthStore
from ggvs_eval.errors import CameraError, CaptureError, DepthError, MetricError
from ggvs_eval.files.images import resize
from ggvs_eval.files.listing import VIDEO_SUFFIXES, list_images
from ggvs_eval.files.video import VideoFrames
from ggvs_eval.jobs.engine import Workers
from ggvs_eval.pipelines.inspection.capture.check import (
    LAYOUT,
    open_uncalibrated,
    uncalibrated_capture,
)
from ggvs_eval.pipelines.methods.render_unit import SourcePlan
from ggvs_eval.pipelines.run.path_depth import read_path_depth, write_path_depth
from ggvs_eval.pipelines.run.prepare import prepare_run
from ggvs_eval.pipelines.run.run_plan import RunPlan, RunRequest, plan_run
from ggvs_eval.pipelines.run.suggest_protocol import suggest_protocol
from ggvs_eval.protocol import CameraPath, Frames, Protocol, Synthesis, Views
from ggvs_eval.synthetic.shipped import write_room
from ggvs_eval.tasks.identity import code_of
from ggvs_eval.tasks.run_tasks import run_tasks
from ggvs_eval.tasks.task import Task

K = 4
CHOSEN_BY = "by rule: cameras evenly spread over the capture, for a metric study"


def open_footage(path: Path) -> Capture:
    """Open a capture, uncalibrated videos, one video, or one camera's folder of images."""
    if path.is_file() and path.suffix.lower() in VIDEO_SUFFIXES:
        return uncalibrated_capture(path, {path.stem: VideoFrames(path)})
    if path.is_dir() and list_images(path):
        return uncalibrated_capture(path, {path.resolve().name: ImageFrames(path)})
    return (open_uncalibrated(path) if path.is_dir() else None) or open_capture(path)


def prepare_views(
    root: Path, capture: Capture, names: Sequence[str], frames: range, workers: Workers
) -> RunPlan | None:
    """Return the capture prepared as for a run, with depth.

    None if its cameras are unknown or see too little in common.
    """
    if capture.layout == LAYOUT or len(capture.cameras) < 2:
        return None
    path = CameraPath() if open_path(capture.path) is not None else CameraPath(0)
    protocol = study_protocol(capture, names, frames, path)
    try:
        return prepare_run(plan_run(RunRequest(root, capture, protocol)), workers)
    except (CameraError, DepthError) as error:
        print(
            f"{capture.path}: cannot be rendered; boiling and switch are omitted: {error}",
            file=sys.stderr,
        )
        return None


def study_protocol(
    capture: Capture,
    names: Sequence[str],
    frames: range,
    path: CameraPath,
    sources: Sequence[str] = (),
) -> Protocol:
    """Return the protocol under which a capture is prepared, at the capture's own size.

    Args:
        sources: cameras that they are rendered from; all others if there are none.
    """
    base = suggest_protocol(capture)
    width, height = capture.cameras[0].size
    synthesis = Synthesis(
        k=min(K, len(sources or capture.cameras) - 1),
        width=width,
        height=height,
        resize_filter="area",
        sources=base.synthesis.sources,
    )
    return replace(
        base,
        name=f"metric study of {capture.scene}",
        views=Views(tuple(names), CHOSEN_BY, sources=tuple(sources)),
        frames=Frames(frames.start, len(frames)),
        synthesis=synthesis,
        measurement=replace(base.measurement, metrics=("PSNR",), width=0, height=0, ceilings=False),
        path=path,
    )


VIEWS, VIEWS_OF_TAKE, WINDOWS, STRETCHES = 4, 2, 2, 4
RENDERER = render.__module__


@dataclass(frozen=True)
class StudyOptions:
    """Options of a metric study.

    Attributes:
        metrics: names; those that do not cost much if there are none, ``all`` for every one.
        ladders: names; all if there are none.
        seeds: how often each ladder is planted in each take, with other random numbers.
        frames: of a clip, and poses of a stretch of a camera path.
        size: of the images' shorter side, pixels.
        on: what degradations are planted in: the ``truth``, where nothing else is wrong; or the
            online method's ``rendering`` of it, so that they compete with its own errors.
    """

    metrics: tuple[str, ...] = ()
    ladders: tuple[str, ...] = ()
    seeds: int = 1
    frames: int = 12
    size: int = 168
    on: Literal["truth", "rendering"] = "truth"

    def __post_init__(self) -> None:
        """Refuse clips that nothing can be measured on, and degradations that cannot be planted."""
        if self.seeds < 1:
            raise MetricError(f"metric study: wanted at least 1 seed, got {self.seeds}")
        if self.on not in ("truth", "rendering"):
            raise CaptureError(
                f"metric study: wanted degradations on truth or rendering, got {self.on!r}"
            )
        if self.frames < 5 or self.size < 32:
            raise CaptureError(
                f"metric study: wanted clips of at least 5 frames of 32 pixels, got --frames "
                f"{self.frames} --size {self.size}"
            )


@dataclass(frozen=True)
class Draft:
    """A take before its clips are made.

    Attributes:
        name: what is taken of the capture.
        depth: keys of the depth that they come with.
    """

    name: str
    make: Callable[[], list[Clip]]
    depth: list[str]


def make_takes(
    out: Path, captures: Sequence[Path], options: StudyOptions, workers: Workers
) -> list[Take]:
    """Take clips of captures, or of the shipped demo where none is given; what is there is kept.

    Raises:
        CaptureError: a capture that cannot be read, or with fewer frames than a clip has.
    """
    if not captures:
        captures = [write_room(out / "demo-capture")]
    names = [path.absolute().stem for path in captures]
    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise CaptureError(
            f"metric study: wanted captures of different names, got {', '.join(sorted(twice))} "
            f"twice; rename one"
        )
    takes = []
    for name, path in zip(names, captures, strict=True):
        takes += _takes_of(out, name, open_footage(path), options, workers)
    return takes


def _takes_of(
    out: Path, name: str, capture: Capture, options: StudyOptions, workers: Workers
) -> list[Take]:
    scale = options.size / min(capture.cameras[0].size)
    width, height = (2 * round(scale * side / 2) for side in capture.cameras[0].size)
    capture = capture.resized(width, height, "area")
    folder, common = out / "takes" / name, _inputs(capture, options)
    tasks = [
        Task(
            name=f"{name}, {draft.name}",
            folder=folder / draft.name,
            inputs=common | {"depth": draft.depth},
            make=partial(fill_take, draft.make, options.on),
        )
        for draft in _drafts(out / "captures" / name, capture, options, workers)
    ]
    run_tasks(tasks, 1, f"clips of {name}")
    return [Take.open(task.folder, task.name) for task in tasks]


def _inputs(capture: Capture, options: StudyOptions) -> dict[str, Any]:
    """Dependencies of the clips of a capture; with degraded renderings, also the rendering code."""
    choices = {"frames": options.frames, "size": options.size, "on": options.on}
    code = code_of(RENDERER, "ggvs_eval.pipelines.online") if options.on == "rendering" else ""
    return {
        "frames": [capture.digest(name) for name in capture.camera_names],
        "options": choices,
        "code": code,
    }


def fill_take(make: Callable[[], list[Clip]], on: str, folder: Path) -> dict[str, Any]:
    """Make the clips of a take and write them, with the rendering that degradations are planted in
    where they are.

    Args:
        on: ``truth`` or ``rendering``.
    """
    clips = make()
    if on == "rendering":
        clips = [replace(clip, rendering=render(require_sources(clip, 1))) for clip in clips]
    write_take(folder, clips)
    return {"views": [clip.name for clip in clips]}


def _drafts(
    root: Path, capture: Capture, options: StudyOptions, workers: Workers
) -> Iterator[Draft]:
    if capture.n_frames == 1:
        yield from _hand_held(root, capture, options, workers)
        return
    if capture.n_frames < options.frames:
        raise CaptureError(
            f"{capture.path}: wanted at least {options.frames} frames for a clip, the capture has "
            f"{capture.n_frames}; use shorter clips by --frames"
        )
    names = _spread(capture.camera_names, VIEWS)
    last = capture.n_frames - options.frames
    starts = sorted(
        {
            round(start)
            for start in np.linspace(0, min(last, options.frames * (WINDOWS - 1)), WINDOWS)
        }
    )
    plan = prepare_views(
        root, capture, names, range(starts[0], starts[-1] + options.frames), workers
    )
    for start in starts:
        window = range(start, start + options.frames)
        for first in range(0, len(names), VIEWS_OF_TAKE):
            of_take = names[first : first + VIEWS_OF_TAKE]
            make = partial(_views, capture if plan is None else plan.capture, plan, of_take, window)
            yield Draft(
                f"{'+'.join(of_take)} from {start}",
                make,
                _depth_keys([plan.plans[name] for name in of_take] if plan else []),
            )
    if plan is not None and plan.path_images is not None:
        truth = [
            resize(image, *plan.path[0].target.size, "area")
            for image in plan.path_images.frames(0, len(plan.path))
        ]
        yield from _stretches(plan, plan.path, truth, plan.path_frame, options, plan.run.path_depth)


def _spread(names: Sequence[str], count: int) -> list[str]:
    return (
        [names[index * len(names) // count] for index in range(count)]
        if len(names) > count
        else list(names)
    )


def _views(
    capture: Capture, plan: RunPlan | None, names: Sequence[str], window: range
) -> list[Clip]:
    clips = []
    for name in names:
        truth = np.stack(list(capture.frames(name, window.start, window.stop)))
        if plan is None:
            clips.append(Clip(name, truth))
        else:
            sources = _sources(plan, plan.plans[name], window)
            clips.append(
                Clip(
                    name=name,
                    truth=truth,
                    cameras=(capture.camera(name),),
                    depths=None,
                    sources=sources,
                    units_per_metre=capture.units_per_metre,
                )
            )
    return clips


def _sources(plan: RunPlan, planned: SourcePlan, frames: range) -> tuple[SourceClip, ...]:
    """Return the images and depth of the sources of one target over some instants."""
    store, capture = DepthStore(plan.run.depth), plan.capture
    sources = []
    for camera, key in planned.depth_keys.items():
        maps = [store.read(key, frame) for frame in frames]
        images = np.stack(list(capture.frames(camera, frames.start, frames.stop)))
        depths, confidences = (
            np.stack([getattr(depth_map, field) for depth_map in maps])
            for field in ("depth", "confidence")
        )
        sources.append(
            SourceClip(
                camera=capture.camera(camera), images=images, depths=depths, confidences=confidences
            )
        )
    return tuple(sources)


def _hand_held(
    root: Path, capture: Capture, options: StudyOptions, workers: Workers
) -> Iterator[Draft]:
    """Yield a camera that moves through a static scene: every second place is a pose, the others
    are sources.
    """
    needed = 2 * options.frames * STRETCHES
    if len(capture.cameras) < 2 * options.frames:
        raise CaptureError(
            f"{capture.path}: wanted at least {2 * options.frames} images of a camera that moves, "
            f"the capture has {len(capture.cameras)} of one instant; use shorter clips by --frames"
        )
    names = capture.camera_names[:needed]
    poses = names[: len(names) // (2 * options.frames) * 2 * options.frames : 2]
    protocol = study_protocol(capture, poses, range(1), CameraPath(0), names[1::2])
    plan = prepare_run(plan_run(RunRequest(root, capture, protocol)), workers)
    planned = [plan.plans[name] for name in poses]
    folder = plan.run.path_depth
    write_path_depth(
        plan.capture,
        [(view.target, view.depth_keys) for view in planned],
        0,
        DepthStore(plan.run.depth),
        folder,
    )
    yield from _stretches(
        plan, planned, [plan.capture.frame(name, 0) for name in poses], 0, options, folder
    )


def _stretches(
    plan: RunPlan,
    poses: Sequence[SourcePlan],
    truth: Sequence[Image8],
    instant: int,
    options: StudyOptions,
    depths: Path,
) -> Iterator[Draft]:
    """Yield the stretches of a camera path, one after another."""
    for start in range(
        0, min(len(poses), STRETCHES * options.frames) - options.frames + 1, options.frames
    ):
        stretch = range(start, start + options.frames)
        make = partial(_stretch, plan, poses, truth, instant, depths, stretch)
        yield Draft(f"path from {start}", make, _depth_keys([poses[index] for index in stretch]))


def _depth_keys(planned: Sequence[SourcePlan]) -> list[str]:
    return sorted({key for plan in planned for key in plan.depth_keys.values()})


def _stretch(
    plan: RunPlan,
    poses: Sequence[SourcePlan],
    truth: Sequence[Image8],
    instant: int,
    depths: Path,
    stretch: range,
) -> list[Clip]:
    """Return a stretch of a camera path, with the sources of its middle."""
    cameras: tuple[Camera, ...] = tuple(poses[index].target for index in stretch)
    sources = _sources(plan, poses[stretch[len(stretch) // 2]], range(instant, instant + 1))
    frames = np.stack([truth[index] for index in stretch])
    along = np.stack([read_path_depth(depths, index) for index in stretch])
    return [
        Clip(
            name=f"path{stretch.start}",
            truth=frames,
            cameras=cameras,
            depths=along,
            sources=sources,
            units_per_metre=plan.capture.units_per_metre,
        )
    ]
