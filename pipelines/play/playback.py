"""Playback: the trajectory of a virtual camera between the cameras of a rig, and the frames and
depth that it needs.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera, SourceChoice
from ggvs_eval.capture import Capture
from ggvs_eval.depth_store import DepthJob, DepthStore
from ggvs_eval.errors import CameraError, RenderError
from ggvs_eval.files.digest import digest_values
from ggvs_eval.geometry.source_views import choose_sources
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.pipelines.offline.depth.fill_store import (
    plan_depth,
    prepare_depth,
    without_unmatched,
)
from ggvs_eval.pipelines.run.derived_files import cache_frames
from ggvs_eval.pipelines.run.run_plan import RunPlan

REACH = 0.6  # of the rig's extent along its two main directions
FRAMES_OF_STILLS = 90


def camera_loop(cameras: Sequence[Camera], count: int, width: int | None = None) -> list[Camera]:
    """Return the poses once around the middle of a rig, evenly spaced in phase.

    The last is followed by the first.

    Each pose is a mean of the cameras around a point that runs along an ellipse in the rig's two
    main directions, weighted by a Gaussian of their distance from it, so that it is between cameras
    and looks where they look, be they in rows, on an arc, on a dome or carried by hand.

    Args:
        cameras: the rig, at least two.
        count: number of poses, called ``pose0000``, ...
        width: of the view in pixels, made even, as videos want it; the size of the middle camera
            when None.
    """
    if len(cameras) < 2 or count < 1:
        raise CameraError(
            f"camera loop: wanted at least 2 cameras and 1 pose, got {len(cameras)} and {count}"
        )
    centres = np.stack([camera.centre for camera in cameras])  # (N, 3)
    rotations = Rotation.from_matrix(np.stack([camera.rotation for camera in cameras]))
    places = _places(centres)  # (N, 2)
    view = _view(cameras, centres, width)
    poses = []
    for index, weights in enumerate(_weights(places, count)):
        world_to_camera = np.eye(4)
        world_to_camera[:3, :3] = rotations.mean(weights).as_matrix()
        world_to_camera[:3, 3] = -world_to_camera[:3, :3] @ (weights @ centres)
        poses.append(replace(view, name=f"pose{index:04d}", world_to_camera=world_to_camera))
    return poses


def _places(centres: Array) -> Array:
    """Return the cameras' places along the two directions in which the rig is widest, from the
    middle of its extent, (N, 2).
    """
    offsets = centres - centres.mean(axis=0)
    directions = np.linalg.svd(offsets, full_matrices=False)[2][:2]
    places = offsets @ directions.T
    return np.asarray(places - (places.max(axis=0) + places.min(axis=0)) / 2)


def _weights(places: Array, count: int) -> Array:
    """Return the weight of each camera in each pose, (count, N), rows of sum 1."""
    phases = 2 * np.pi * np.arange(count) / count
    # (count, 2)
    at = REACH * places.max(axis=0) * np.stack([np.cos(phases), np.sin(phases)], axis=-1)
    apart = np.linalg.norm(places[:, None] - places, axis=-1)
    spacing = max(float(np.median(np.sort(apart, axis=1)[:, 1])), 1e-9 + 0.05 * float(apart.max()))
    logits = -np.square(at[:, None] - places).sum(axis=-1) / (2 * spacing**2)
    weights = np.exp(logits - logits.max(axis=1, keepdims=True))
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def _view(cameras: Sequence[Camera], centres: Array, width: int | None) -> Camera:
    """Return the intrinsics of the camera in the middle, at an even size, with the depth range of
    all.
    """
    middle = cameras[int(np.argmin(np.linalg.norm(centres - centres.mean(axis=0), axis=1)))]
    if width is not None:
        if width < 2:
            raise CameraError(
                f"camera loop: wanted a view of at least 2 pixels across, got {width}"
            )
        middle = middle.resized(width, max(round(middle.height * width / middle.width), 2))
    even = middle.cropped(0, 0, middle.width - middle.width % 2, middle.height - middle.height % 2)
    return replace(
        even, near=min(camera.near for camera in cameras), far=max(camera.far for camera in cameras)
    )


@dataclass(frozen=True)
class PlayOptions:
    """Options of a playback.

    Attributes:
        sources: which cameras are source views, see `choose_sources`; as the run's protocol says,
            or the nearest, when None.
    """

    k: int | None = None
    frames: int | None = None
    width: int | None = None
    sources: SourceChoice | None = None


@dataclass(frozen=True)
class Playback:
    """All that is needed to play: where the camera goes, and frames and depth of the cameras it
    passes.

    Attributes:
        poses: the virtual camera at each step.
        instants: frame number of the capture at each step.
        depth_keys: camera -> key of its depth.
        sources: which cameras are source views.
        live: how depth is found for each picture, by a network on a GPU; None if the store has it.
    """

    capture: Capture
    poses: Sequence[Camera]
    instants: Sequence[int]
    k: int
    store: DepthStore
    depth_keys: Mapping[str, str]
    sources: SourceChoice = "nearest"
    live: DepthOptions | None = None


def make_playback(
    subject: RunPlan | Capture,
    options: PlayOptions,
    depth: DepthOptions,
    cache: Path,
    workers: int = 1,
    anywhere: bool = False,
) -> Playback:
    """Play a prepared run or a capture.

    Arguments and errors as of `playback_of_capture`, of which a run needs the first two.
    """
    if isinstance(subject, RunPlan):
        return playback_of_run(subject, options)
    return playback_of_capture(subject, options, depth, cache, workers, anywhere)


def playback_of_run(prepared: RunPlan, options: PlayOptions) -> Playback:
    """Play a run folder: its frames and the depth that its test views have made it compute, nothing
    new.
    """
    keys: dict[str, str] = {}
    for plan in prepared.plans.values():
        # a camera may have several; that of the first test view is taken
        keys = {**plan.depth_keys, **keys}
    without = [name for name in prepared.capture.camera_names if name not in keys]
    capture = prepared.capture.without(without, "no depth in this run")
    instants = _instants(capture, prepared.frames, options.frames)
    poses = camera_loop(capture.cameras, len(instants), options.width)
    k = _checked_k(capture, prepared.protocol.synthesis.k if options.k is None else options.k)
    sources = options.sources or prepared.protocol.synthesis.sources
    return Playback(
        capture=capture,
        poses=poses,
        instants=instants,
        k=k,
        store=DepthStore(prepared.run.depth),
        depth_keys=keys,
        sources=sources,
    )


def playback_of_capture(
    capture: Capture,
    options: PlayOptions,
    depth: DepthOptions,
    cache: Path,
    workers: int = 1,
    anywhere: bool = False,
) -> Playback:
    """Play a capture: decode the frames and compute the depth that its targets need, into a cache.

    Depth by IterMVS on a GPU is not computed here, except for each picture as it is shown.

    Args:
        capture: what is played; of one instant, the camera moves while time is static.
        cache: folder for frames and depth; what is there, and belongs to these frames, is kept.
        anywhere: make ready what any camera sees, for a target that may be anywhere, instead of one
            that goes round.

    Reading:
        Sources change along the path. Depth of a camera is that of its own stereo, not checked
        against the other sources of a view, so that it does not change when they do.
    """
    capture = without_unmatched(capture, depth)
    instants = _instants(capture, range(capture.n_frames), options.frames)
    k = _checked_k(
        capture, min(4, len(capture.cameras) - anywhere) if options.k is None else options.k
    )
    alone, sources = replace(depth, consistency=False), options.sources or "nearest"
    if anywhere:
        instants = sorted(set(instants))
        poses = [
            replace(camera, name=f"at {camera.name}") for camera in capture.cameras
        ]  # whose first source is the camera itself
        jobs = _jobs(capture, poses, k, alone, "nearest")
        needed = {instant: set(capture.camera_names) for instant in instants}
    else:
        poses = camera_loop(capture.cameras, len(instants), options.width)
        jobs = _jobs(capture, poses, k, alone, sources)
        needed = _needed(capture, poses, instants, k, sources)
    store = DepthStore(cache / _digest(capture) / "depth")
    blocks = list(blocks_of(needed, 2 * max(map(len, needed.values()))))
    capture = cache_frames(
        capture, _frames_by_camera(blocks, jobs, alone), store.root.with_name("frames"), workers
    )
    if depth.matcher.batch and depth.matcher.device != "cpu":
        return Playback(
            capture=capture,
            poses=poses,
            instants=instants,
            k=k,
            store=store,
            depth_keys={},
            sources=sources,
            live=alone,
        )
    for block, names in blocks:
        prepare_depth(capture, [jobs[name] for name in sorted(names)], block, store, alone, workers)
    return Playback(
        capture=capture,
        poses=poses,
        instants=instants,
        k=k,
        store=store,
        depth_keys={name: job.key for name, job in jobs.items()},
        sources=sources,
    )


def blocks_of(needed: Mapping[int, set[str]], most: int) -> Iterator[tuple[range, set[str]]]:
    """Consecutive instants that together need few cameras, so that depth is computed side by side
    and little of it in vain.

    Args:
        needed: instant -> cameras that it needs, in the order of time.
        most: cameras of a block, unless a single instant needs more.
    """
    first, names = next(iter(needed)), set[str]()
    for instant, cameras in needed.items():
        if names and len(names | cameras) > most:
            yield range(first, instant), names
            first, names = instant, set()
        names = names | cameras
    yield range(first, max(needed) + 1), names


def _instants(capture: Capture, frames: range, n_frames: int | None) -> list[int]:
    """Return the frame number of each step; one instant is shown again and again."""
    if n_frames is not None and n_frames < 1:
        raise RenderError(f"{capture.path}: wanted at least 1 frame to play, got {n_frames}")
    if len(frames) == 1:
        return [frames.start] * (n_frames or FRAMES_OF_STILLS)
    if n_frames is not None and n_frames > len(frames):
        raise RenderError(
            f"{capture.path}: wanted {n_frames} frames to play, got {len(frames)}; reduce --frames"
        )
    return list(frames)[:n_frames]


def _checked_k(capture: Capture, k: int) -> int:
    if not 1 <= k <= len(capture.cameras):
        raise RenderError(
            f"{capture.path}: wanted {k} source views, {len(capture.cameras)} cameras have depth; "
            f"set k"
        )
    return k


def _needed(
    capture: Capture,
    poses: Sequence[Camera],
    instants: Sequence[int],
    k: int,
    sources: SourceChoice,
) -> dict[int, set[str]]:
    needed: dict[int, set[str]] = {instant: set() for instant in instants}
    for instant, pose in zip(instants, poses, strict=True):
        needed[instant] |= {
            source.camera.name for source in choose_sources(pose, capture.cameras, k, sources)
        }
    return needed


def _jobs(
    capture: Capture, poses: Sequence[Camera], k: int, options: DepthOptions, sources: SourceChoice
) -> dict[str, DepthJob]:
    """Plan the depth of each source camera: the same for every position of the virtual camera."""
    jobs: dict[str, DepthJob] = {}
    for pose in poses:
        if any(
            source.camera.name not in jobs
            for source in choose_sources(pose, capture.cameras, k, sources)
        ):
            jobs |= plan_depth(capture, [pose], k, options, sources)[pose.name]
    return jobs


def _frames_by_camera(
    blocks: Sequence[tuple[range, set[str]]], jobs: Mapping[str, DepthJob], options: DepthOptions
) -> dict[str, list[int]]:
    """Return the frames of each camera that take part: of sources, and of those that their depth is
    matched with.
    """
    frames_by_camera: dict[str, set[int]] = {}
    for block, names in blocks:
        frames = range(options.first_needed(block.start), block.stop)
        for name in {
            camera for source in names for camera in (source, *jobs[source].partner_names)
        }:
            frames_by_camera.setdefault(name, set()).update(frames)
    return {name: sorted(frames) for name, frames in sorted(frames_by_camera.items())}


def _digest(capture: Capture) -> str:
    sizes = [f"{camera.name} {camera.width} {camera.height}" for camera in capture.cameras]
    return digest_values(*map(capture.digest, capture.camera_names), *sizes, capture.resize_filter)[
        :12
    ]
