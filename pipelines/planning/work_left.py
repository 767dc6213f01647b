"""What a run still has to do, counted from its protocol and what its folder holds; nothing is written."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ggvs_eval.capture import Capture
from ggvs_eval.depth_store import DepthStore
from ggvs_eval.errors import ResultsError
from ggvs_eval.pipelines.methods.network_options import AS_SHIPPED, NetworkOptions
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.pipelines.offline.depth.fill_store import depth_spec
from ggvs_eval.pipelines.run.path_depth import pose_file
from ggvs_eval.pipelines.run.prepare import Prepared, fit_capture, plan, wanted_frames
from ggvs_eval.pipelines.run.render import render_jobs
from ggvs_eval.protocol import Protocol
from ggvs_eval.run_folder import JOB_FILE, RunFolder, missing_frames, read_json


@dataclass(frozen=True)
class WorkLeft:
    """Frames that are missing, by the folders they will lie in.

    Attributes:
        truth: captured frames of every camera that takes part.
        found_depth: depth maps as they are found.
        checked_depth: depth maps that are held against others.
        disoccluded: masks of every test view.
        path_depth: poses.
        renders: (label, folder) -> frames of a test view.
        path_renders: (label, folder) -> poses.
        scores: frames of every test view.
        ceilings: likewise.
    """

    truth: Mapping[Path, int]
    found_depth: Mapping[Path, int]
    checked_depth: Mapping[Path, int]
    disoccluded: Mapping[Path, int]
    path_depth: int
    renders: Mapping[tuple[str, Path], int] = field(default_factory=dict)
    path_renders: Mapping[tuple[str, Path], int] = field(default_factory=dict)
    scores: Mapping[Path, int] = field(default_factory=dict)
    ceilings: Mapping[Path, int] = field(default_factory=dict)

    @property
    def n_depth(self) -> int:
        """Depth maps, both kinds."""
        return sum(self.found_depth.values()) + sum(self.checked_depth.values())

    @property
    def n_rendered(self) -> int:
        """Frames to synthesise."""
        return sum(self.renders.values()) + sum(self.path_renders.values())

    @property
    def rendered(self) -> set[str]:
        """Methods that have frames to synthesise."""
        return {label for counts in (self.renders, self.path_renders) for (label, _), n in counts.items() if n}

    def is_nothing(self) -> bool:
        """Whether everything is done."""
        counts = (
            self.truth,
            self.found_depth,
            self.checked_depth,
            self.disoccluded,
            self.renders,
            self.path_renders,
            self.scores,
        )
        return not self.path_depth and not any(sum(each.values()) for each in counts)


def plan_frames(
    root: Path, capture: Capture, protocol: Protocol, options: DepthOptions, shared: Path | None = None
) -> tuple[Prepared, dict[Path, int]]:
    """The plan of a run as `prepare` will make it, and the captured frames that it lacks, by folder of their camera.

    Args:
        root: the run folder, whether it exists or not.
        capture: at its own size.
        protocol: what is evaluated.
        options: how depth is found.
        shared: folder whose truth/ and depth/ the run uses; its own where None.

    Raises:
        CaptureError: the capture lacks what the protocol asks for.
    """
    planned = plan(RunFolder(root), protocol, fit_capture(capture, protocol), options)
    wanted = wanted_frames(planned, options)
    truth = (shared or root) / "truth"
    return planned, {truth / name: _n_missing(truth / name, frames) for name, frames in wanted.items()}


def work_left(
    planned: Prepared,
    truth: Mapping[Path, int],
    options: DepthOptions,
    labels: Sequence[str],
    networks: NetworkOptions = AS_SHIPPED,
    shared: Path | None = None,
    views: Collection[str] | None = None,
) -> WorkLeft:
    """Count what is missing.

    Args:
        planned: the plan of the run, see `plan_frames`.
        truth: missing truth frames.
        options: how depth is found.
        labels: methods; none where a run is only prepared.
        networks: with which weights and where networks compute.
        shared: as of `plan_frames`.
        views: units of a shard, test views or ``path``; None for all.
    """
    run = planned.run
    found, checked = _depth_left(planned, options, DepthStore((shared or run.root) / "depth"))
    metrics = planned.protocol.measurement.metrics
    masks = planned.plans if any(name.endswith("_disoccluded") for name in metrics) else ()
    disoccluded = {run.disoccluded(view): len(missing_frames(run.disoccluded(view), planned.frames)) for view in masks}
    path_depth = sum(not pose_file(run.path_depth, pose).is_file() for pose in range(len(planned.path)))
    renders: dict[tuple[str, Path], int] = {}
    path_renders: dict[tuple[str, Path], int] = {}
    for label in labels:
        for job in render_jobs(planned, [label], 1, networks):
            along_path = job.folder.parent == run.path("")
            unit = "path" if along_path else job.folder.name
            if (views is None or unit in views) and not job.is_done():
                target = path_renders if along_path else renders
                target[label, job.folder] = len(planned.path) if along_path else len(planned.frames)
    scored = [view for view in planned.plans if labels and (views is None or view in views)]
    stale = {folder.name for _, folder in renders}
    scores = {run.scores(v): len(planned.frames) for v in scored if v in stale or not _is_scored(run, v, labels)}
    without = [v for v in scored if planned.protocol.measurement.ceilings and not (run.ceilings(v) / JOB_FILE).is_file()]
    ceilings = {run.ceilings(v): len(planned.frames) for v in without}
    return WorkLeft(truth, found, checked, disoccluded, path_depth, renders, path_renders, scores, ceilings)


def _depth_left(planned: Prepared, options: DepthOptions, store: DepthStore) -> tuple[dict[Path, int], dict[Path, int]]:
    """Missing depth maps by folder of the store: as found, and held against others."""
    found: dict[Path, int] = {}
    checked: dict[Path, int] = {}
    for plans, frames in (
        (planned.plans.values(), planned.frames),
        (planned.path, range(planned.path_frame, planned.path_frame + 1)),
    ):
        for job in dict.fromkeys(job for each in plans for job in each.jobs):
            key = DepthStore.key(depth_spec(planned.capture, job, options))
            missing = sum(not store.has(key, frame) for frame in frames)
            target = checked if job.checked_with else found
            target[store.folder(key)] = max(target.get(store.folder(key), 0), missing)
            for other in (job.unchecked, *job.checked_with) if job.checked_with and missing else ():
                other_key = DepthStore.key(depth_spec(planned.capture, other, options))
                n_missing = sum(not store.has(other_key, frame) for frame in frames)
                found[store.folder(other_key)] = max(found.get(store.folder(other_key), 0), n_missing)
    return found, checked


def _n_missing(folder: Path, frames: Sequence[int]) -> int:
    return sum(len(missing_frames(folder, range(frame, frame + 1))) for frame in frames)


def _is_scored(run: RunFolder, view: str, labels: Sequence[str]) -> bool:
    """Whether a view has values of these methods; whether they are still of the same frames, scoring itself finds out."""
    try:
        return set(labels) <= set(read_json(run.scores(view) / JOB_FILE)["methods"])
    except (ResultsError, KeyError, TypeError):
        return False
