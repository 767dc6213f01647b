"""What is played: the way of a virtual camera between the cameras of a rig, and the frames and depth that it needs."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.depth_store import DepthJob, DepthStore
from ggvs_eval.errors import RenderError
from ggvs_eval.files.digest import digest_values
from ggvs_eval.geometry.source_views import SourceChoice, choose_sources
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.pipelines.offline.depth.fill_store import plan_depth, prepare_depth
from ggvs_eval.pipelines.play.trajectory import camera_loop
from ggvs_eval.pipelines.run.frame_cache import cache_frames
from ggvs_eval.pipelines.run.run_plan import RunPlan

FRAMES_OF_STILLS = 90


@dataclass(frozen=True)
class PlayOptions:
    """What is played.

    Attributes:
        k: source views; those of the run's protocol, or 4, when None.
        frames: instants from the first on, in which the camera goes round once; all, or 90 of a single instant, when None.
        width: of the video in pixels; that of the rig's images when None.
        sources: which cameras are source views, see `choose_sources`; as the run's protocol says, or the nearest, when None.
    """

    k: int | None = None
    frames: int | None = None
    width: int | None = None
    sources: SourceChoice | None = None


@dataclass(frozen=True)
class Playback:
    """All that is needed to play: where the camera goes, and frames and depth of the cameras it passes.

    Attributes:
        capture: cameras that have depth.
        poses: the virtual camera at each step.
        instants: frame number of the capture at each step.
        k: source views.
        store: holds the depth.
        depth_keys: camera -> key of its depth.
        sources: which cameras are source views.
    """

    capture: Capture
    poses: Sequence[Camera]
    instants: Sequence[int]
    k: int
    store: DepthStore
    depth_keys: Mapping[str, str]
    sources: SourceChoice = "nearest"


def playback_of_run(prepared: RunPlan, options: PlayOptions) -> Playback:
    """Play a run folder: its frames and the depth that its test views have made it compute, nothing new.

    Raises:
        RenderError: more frames or sources than there are.
    """
    keys: dict[str, str] = {}
    for plan in prepared.plans.values():
        keys = {**plan.depth_keys, **keys}  # a camera may have several; that of the first test view is taken
    without = [name for name in prepared.capture.camera_names if name not in keys]
    capture = prepared.capture.without(without, "no depth in this run")
    instants = _instants(capture, prepared.frames, options.frames)
    poses = camera_loop(capture.cameras, len(instants), options.width)
    k = _checked_k(capture, prepared.protocol.synthesis.k if options.k is None else options.k)
    sources = options.sources or prepared.protocol.synthesis.sources
    return Playback(capture, poses, instants, k, DepthStore(prepared.run.depth), keys, sources)


def playback_of_capture(capture: Capture, options: PlayOptions, depth: DepthOptions, cache: Path, workers: int = 1) -> Playback:
    """Play a capture: decode the frames and compute the depth that the way of the camera needs, into a cache.

    Args:
        capture: what is played; of one instant, the camera moves while time stands still.
        options: what is played of it.
        depth: how depth is computed.
        cache: folder for frames and depth; what is there, and belongs to these frames, is kept.
        workers: processes.

    Raises:
        CaptureError: frames that cannot be read.
        DepthError: depth that cannot be computed.
        RenderError: more frames or sources than there are.

    Reading:
        Sources change along the way. Depth of a camera is that of its own stereo, not held against the other sources of a view,
        so that it does not change when they do.
    """
    instants = _instants(capture, range(capture.n_frames), options.frames)
    poses = camera_loop(capture.cameras, len(instants), options.width)
    k = _checked_k(capture, min(4, len(capture.cameras)) if options.k is None else options.k)
    alone = replace(depth, consistency=None)
    sources = options.sources or "nearest"
    needed = _needed(capture, poses, instants, k, sources)
    jobs = _jobs(capture, poses, k, alone, sources)
    root = cache / _digest(capture)
    store, blocks = DepthStore(root / "depth"), list(blocks_of(needed, 2 * k))
    capture = cache_frames(capture, _wanted(blocks, jobs, alone), root / "frames", workers)
    for block, names in blocks:
        prepare_depth(capture, [jobs[name] for name in sorted(names)], block, store, alone, workers)
    keys = {name: job.key for name, job in jobs.items()}
    return Playback(capture, poses, instants, k, store, keys, sources)


def blocks_of(needed: Mapping[int, set[str]], most: int) -> Iterator[tuple[range, set[str]]]:
    """Consecutive instants that together need few cameras, so that depth is computed side by side and little of it in vain.

    Args:
        needed: instant -> cameras that it needs, in the order of time.
        most: cameras of a block, unless a single instant needs more.
    """
    first, names = next(iter(needed)), set[str]()
    for instant, wanted in needed.items():
        if names and len(names | wanted) > most:
            yield range(first, instant), names
            first, names = instant, set()
        names = names | wanted
    yield range(first, max(needed) + 1), names


def _instants(capture: Capture, frames: range, wanted: int | None) -> list[int]:
    """The frame number of each step; one instant is shown again and again."""
    if wanted is not None and wanted < 1:
        raise RenderError(f"{capture.path}: wanted at least 1 frame to play, got {wanted}")
    if len(frames) == 1:
        return [frames.start] * (wanted or FRAMES_OF_STILLS)
    if wanted is not None and wanted > len(frames):
        raise RenderError(f"{capture.path}: wanted {wanted} frames to play, there are {len(frames)}; ask for fewer")
    return list(frames)[:wanted]


def _checked_k(capture: Capture, k: int) -> int:
    if not 1 <= k <= len(capture.cameras):
        raise RenderError(f"{capture.path}: wanted {k} source views, {len(capture.cameras)} cameras have depth; set k")
    return k


def _needed(
    capture: Capture, poses: Sequence[Camera], instants: Sequence[int], k: int, sources: SourceChoice
) -> dict[int, set[str]]:
    """Instant -> the source cameras of its poses."""
    needed: dict[int, set[str]] = {instant: set() for instant in instants}
    for instant, pose in zip(instants, poses, strict=True):
        needed[instant] |= {each.camera.name for each in choose_sources(pose, capture.cameras, k, sources)}
    return needed


def _jobs(capture: Capture, poses: Sequence[Camera], k: int, options: DepthOptions, sources: SourceChoice) -> dict[str, DepthJob]:
    """How the depth of each source camera is computed: the same wherever the virtual camera stands."""
    jobs: dict[str, DepthJob] = {}
    for pose in poses:
        if any(each.camera.name not in jobs for each in choose_sources(pose, capture.cameras, k, sources)):
            jobs |= plan_depth(capture, [pose], k, options, sources)[pose.name]
    return jobs


def _wanted(
    blocks: Sequence[tuple[range, set[str]]], jobs: Mapping[str, DepthJob], options: DepthOptions
) -> dict[str, list[int]]:
    """Which frames of which cameras take part: of sources, and of those that their depth is matched with."""
    wanted: dict[str, set[int]] = {}
    for block, names in blocks:
        frames = range(options.time.first_needed(block.start), block.stop)
        for name in {each for source in names for each in (source, *jobs[source].partner_names)}:
            wanted.setdefault(name, set()).update(frames)
    return {name: sorted(frames) for name, frames in sorted(wanted.items())}


def _digest(capture: Capture) -> str:
    """Names a folder by the frames in it."""
    sizes = [f"{camera.name} {camera.width} {camera.height}" for camera in capture.cameras]
    return digest_values(*map(capture.digest, capture.camera_names), *sizes, capture.resize_filter)[:12]
