"""Work left: what runs still have to do, counted on their plans and what their folders hold; nothing is written."""

import shutil
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ggvs_eval.depth_store import DepthStore
from ggvs_eval.errors import ProtocolError, ResultsError
from ggvs_eval.pipelines.run.disocclusion import mask_files
from ggvs_eval.pipelines.run.frame_cache import frames_left, path_left
from ggvs_eval.pipelines.run.path_depth import path_files, poses_left
from ggvs_eval.pipelines.run.render import needed_fits, render_jobs
from ggvs_eval.pipelines.run.run_plan import RunPlan
from ggvs_eval.progress import duration
from ggvs_eval.run_folder import JOB_FILE, RunFolder, read_json

# Bytes per pixel: depth as it is stored, PNG of frames with and without sensor noise as on the demo.
DEPTH_BYTES, TRUTH_BYTES, RENDER_BYTES, PATH_DEPTH_BYTES = 5.0, 2.1, 1.5, 4.0
PAGE_SHARE = 0.3  # of the renders; a page keeps small copies of them
GB = 1e9


@dataclass(frozen=True)
class WorkLeft:
    """Remaining work of one run: missing frames, by the folders they will lie in.

    Attributes:
        n_pixels: of a frame.
        truth: captured frames of every camera that takes part, and along the path.
        found_depth: depth maps as they are found.
        checked_depth: depth maps that are held against others.
        disoccluded: masks of every test view.
        path_depth: poses.
        renders: (label, folder) -> frames of a test view.
        path_renders: (label, folder) -> poses.
        scores: frames of every test view.
        ceilings: likewise.
        fits: scenes to fit, by their folders.
    """

    n_pixels: int
    truth: Mapping[Path, int]
    found_depth: Mapping[Path, int]
    checked_depth: Mapping[Path, int]
    disoccluded: Mapping[Path, int]
    path_depth: int
    renders: Mapping[tuple[str, Path], int] = field(default_factory=dict)
    path_renders: Mapping[tuple[str, Path], int] = field(default_factory=dict)
    scores: Mapping[Path, int] = field(default_factory=dict)
    ceilings: Mapping[Path, int] = field(default_factory=dict)
    fits: frozenset[Path] = frozenset()

    @property
    def n_depth(self) -> int:
        """Depth maps, both kinds."""
        return sum(self.found_depth.values()) + sum(self.checked_depth.values())

    @property
    def n_rendered(self) -> int:
        """Frames to synthesise."""
        return sum(self.renders.values()) + sum(self.path_renders.values())

    def is_nothing(self) -> bool:
        """Tell whether everything is done."""
        counts = (self.truth, self.disoccluded, self.scores)
        return not (self.n_depth or self.n_rendered or self.path_depth or self.fits or any(sum(each.values()) for each in counts))


@dataclass(frozen=True)
class Workload:
    """Remaining work of a run, or of several that share their frames.

    Attributes:
        title: frames, views, methods, size.
        left: of each run.
        folder: where the runs go.
        frame_seconds: method -> seconds of a frame, as its jobs that are done took; methods without one are missing.
        jobs: processes.
    """

    title: str
    left: tuple[WorkLeft, ...]
    folder: Path
    frame_seconds: Mapping[str, float] = field(default_factory=dict)
    jobs: int = 1

    @property
    def disk_bytes(self) -> float:
        """Bytes that the runs will still write; what they share counts once."""
        shared: dict[Path, float] = {}
        other = 0.0
        for each in self.left:
            depth = {**each.found_depth, **each.checked_depth}
            shared |= {folder: n * each.n_pixels * TRUTH_BYTES for folder, n in each.truth.items()}
            shared |= {folder: n * each.n_pixels * DEPTH_BYTES for folder, n in depth.items()}
            other += each.n_pixels * (each.n_rendered * RENDER_BYTES * (1 + PAGE_SHARE) + each.path_depth * PATH_DEPTH_BYTES)
        return sum(shared.values()) + other

    @property
    def free_bytes(self) -> int:
        """Free on the disk they go to."""
        return shutil.disk_usage(_existing(self.folder)).free

    def is_nothing(self) -> bool:
        """Tell whether everything is done."""
        return all(each.is_nothing() for each in self.left)

    def describe(self) -> str:
        """A few lines; none where everything is done."""
        if self.is_nothing():
            return ""
        depth_maps: dict[Path, int] = {}
        truth: dict[Path, int] = {}
        for each in self.left:
            depth_maps |= {**each.found_depth, **each.checked_depth}
            truth |= each.truth
        rendered = sum(each.n_rendered for each in self.left)
        n_fits = len({folder for each in self.left for folder in each.fits})
        fits = f", {n_fits} scene{'' if n_fits == 1 else 's'} to fit" if n_fits else ""
        n_truth = sum(truth.values())
        decoded = f", {n_truth} captured frame{'' if n_truth == 1 else 's'} to decode" if n_truth else ""
        lines = [
            f"plan: {self.title}; left are {rendered} frames to render, {sum(depth_maps.values())} depth maps{decoded}{fits}",
            f"disk: about {_size(self.disk_bytes)} more in {self.folder}, {_size(self.free_bytes)} free",
        ]
        return "\n".join([*lines, *self._time_line()])

    def _time_line(self) -> list[str]:
        """Estimate how long rendering takes, by jobs that are done; nothing where none is."""
        frames: dict[str, int] = defaultdict(int)
        for each in self.left:
            for (label, _), count in (*each.renders.items(), *each.path_renders.items()):
                frames[label] += count
        timed = {label: count for label, count in frames.items() if count and label in self.frame_seconds}
        if not timed:
            return []
        seconds = sum(count * self.frame_seconds[label] for label, count in timed.items()) / self.jobs
        unknown = sum(1 for label, count in frames.items() if count and label not in timed)
        more = f"; of {unknown} more methods no frame is rendered yet" if unknown else ""
        return [f"time: about {duration(seconds)} to render, as the frames took that are rendered{more}"]

    def require_disk(self) -> None:
        """Refuse what cannot fit.

        Raises:
            ProtocolError: the disk has less room than the runs need.
        """
        needed, free = self.disk_bytes, self.free_bytes
        if needed > free:
            raise ProtocolError(
                f"{self.folder}: this run needs about {_size(needed)}, the disk has {_size(free)} free; free the difference, "
                "choose a folder on another disk, or ask for less (frames.count, views.test, synthesis.width, methods)"
            )


def count_work(plans: Sequence[RunPlan], folder: Path, jobs: int = 1) -> Workload:
    """Count what runs still have to do.

    Args:
        plans: of the runs, which lie below one folder.
        folder: where all of them go.
        jobs: processes.
    """
    seconds: dict[str, list[float]] = defaultdict(list)
    for plan in plans:
        for label in plan.request.labels:
            seconds[label] += _frame_seconds(plan, label)
    means = {label: sum(values) / len(values) for label, values in seconds.items() if values}
    return Workload(_title(plans), tuple(work_left(plan) for plan in plans), folder, means, jobs)


def work_left(plan: RunPlan) -> WorkLeft:
    """Count what one run lacks."""
    run, request, store = plan.run, plan.request, DepthStore(plan.shared_root / "depth")
    masks = plan.plans if any(name.endswith("_disoccluded") for name in plan.protocol.measurement.metrics) else ()
    renders: dict[tuple[str, Path], int] = {}
    path_renders: dict[tuple[str, Path], int] = {}
    for label in request.labels:
        for job in render_jobs(plan, [label], 1, request.networks):
            along_path = job.folder.parent == run.path("")
            unit = "path" if along_path else job.folder.name
            if (request.views is None or unit in request.views) and not job.is_done():
                target = path_renders if along_path else renders
                target[label, job.folder] = len(plan.path) if along_path else len(plan.frames)
    stale = {folder.name for _, folder in renders}
    scored = [view for view in plan.plans if request.labels and (request.views is None or view in request.views)]
    unscored = [view for view in scored if view in stale or not _is_scored(run, view, request.labels)]
    without = [view for view in scored if plan.protocol.measurement.ceilings and not (run.ceilings(view) / JOB_FILE).is_file()]
    width, height = plan.capture.cameras[0].size
    return WorkLeft(
        width * height,
        _truth_left(plan),
        *_depth_left(plan, store),
        {run.disoccluded(view): _masks_left(plan, view) for view in masks},
        _poses_left(plan),
        renders,
        path_renders,
        {run.scores(view): len(plan.frames) for view in unscored},
        {run.ceilings(view): len(plan.frames) for view in without},
        frozenset(
            job.folder for job in needed_fits(plan, request.labels, 1, request.networks, request.views) if not job.is_done()
        ),
    )


def _truth_left(plan: RunPlan) -> dict[Path, int]:
    """Captured frames that are missing or were changed, of each camera and along the path."""
    root, images, folder = plan.shared_root / "truth", plan.path_images, plan.run.path("truth")
    left = {root / name: len(frames) for name, frames in frames_left(plan.capture, plan.frames_of_cameras(), root).items()}
    if images is not None:
        left[folder] = len(path_left(images, plan.path[0].target.size, plan.protocol.synthesis.resize_filter, folder))
    return left


def _masks_left(plan: RunPlan, view: str) -> int:
    """Missing or stale masks of one test view."""
    source_plan = plan.plans[view]
    files = mask_files(plan.run.disoccluded(view), plan.capture, source_plan.target, source_plan.depth_keys)
    return len(files.missing_frames(plan.frames))


def _poses_left(plan: RunPlan) -> int:
    """Missing or stale depth of poses."""
    poses = [(pose.target, pose.depth_keys) for pose in plan.path]
    return len(poses_left(path_files(plan.run.path_depth, plan.capture, poses, plan.path_frame), len(poses)))


def _depth_left(plan: RunPlan, store: DepthStore) -> tuple[dict[Path, int], dict[Path, int]]:
    """Missing depth maps by folder of the store: as found, and held against others."""
    unchecked: dict[Path, int] = {}
    checked: dict[Path, int] = {}
    for jobs, frames in plan.depth_work():
        for job in jobs:
            missing = _count(store, job.key, frames, checked if job.checked_with else unchecked)
            for other in (job.unchecked, *job.checked_with) if job.checked_with and missing else ():
                _count(store, other.key, frames, unchecked)
    return unchecked, checked


def _count(store: DepthStore, key: str, frames: Sequence[int], counts: dict[Path, int]) -> int:
    """Missing instants of a key, noted in `counts`."""
    missing = sum(not store.has(key, frame) for frame in frames)
    counts[store.folder(key)] = max(counts.get(store.folder(key), 0), missing)
    return missing


def _is_scored(run: RunFolder, view: str, labels: Sequence[str]) -> bool:
    """Tell whether a view has values of these methods; whether they are still of the same frames, scoring itself finds out."""
    try:
        return set(labels) <= set(read_json(run.scores(view) / JOB_FILE)["methods"])
    except (ResultsError, KeyError, TypeError):
        return False


def _frame_seconds(plan: RunPlan, label: str) -> list[float]:
    """Mean seconds of a frame in each test view that a method has rendered."""
    seconds = []
    for view in plan.plans:
        try:
            stages = read_json(plan.run.renders(label, view) / JOB_FILE)["seconds"].values()
            seconds.append(sum(map(sum, stages)) / len(plan.frames))
        except (ResultsError, KeyError, TypeError, AttributeError):
            continue
    return seconds


def _title(plans: Sequence[RunPlan]) -> str:
    """Describe the runs in one line."""
    first = plans[0]
    width, height = first.capture.cameras[0].size
    labels = first.request.labels
    methods = f" x {len(labels)} methods" if labels else ""
    many = f"{len(plans)} runs of " if len(plans) > 1 else ""
    ks = ", ".join(map(str, sorted({plan.protocol.synthesis.k for plan in plans})))
    return f"{many}{len(first.plans)} views x {len(first.frames)} frames{methods} at {width} x {height}, K = {ks}"


def _existing(folder: Path) -> Path:
    """The folder, or the nearest one above it that there is."""
    folder = folder.resolve()
    while not folder.is_dir():
        folder = folder.parent
    return folder


def _size(n_bytes: float) -> str:
    return f"{n_bytes / GB:.1f} GB" if n_bytes >= GB / 10 else f"{n_bytes / 1e6:.1f} MB"
