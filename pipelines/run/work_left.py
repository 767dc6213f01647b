"""Work left: what runs still have to do, counted on their plans and what their folders hold; nothing is written."""

import shutil
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from ggvs_eval.depth_store import DepthStore
from ggvs_eval.errors import ProtocolError, ResultsError
from ggvs_eval.pipelines.methods.render_unit import PATH
from ggvs_eval.pipelines.run.disocclusion import mask_files
from ggvs_eval.pipelines.run.frame_cache import frames_left, path_left
from ggvs_eval.pipelines.run.path_depth import path_files, poses_left
from ggvs_eval.pipelines.run.run_plan import RunPlan
from ggvs_eval.progress import counted, duration
from ggvs_eval.run_folder import JOB_FILE, RunFolder, read_json

# Bytes per pixel: depth as it is stored, PNG of frames with and without sensor noise as on the demo.
DEPTH_BYTES, TRUTH_BYTES, RENDER_BYTES, PATH_DEPTH_BYTES = 5.0, 2.1, 1.5, 4.0
PAGE_SHARE = 0.3  # of the renders; a page keeps small copies of them
GB = 1e9
Kind = Literal["truth", "depth", "checked depth", "mask", "path depth", "fit", "render", "path render", "score"]


@dataclass(frozen=True)
class Piece:
    """A part of the remaining work: files that are missing in one folder, or a scene to fit.

    Attributes:
        kind: of what.
        folder: where they will lie; runs that share it have the piece in common.
        count: how many.
        n_bytes: of all of them.
        label: of the method that renders them.
    """

    kind: Kind
    folder: Path
    count: int
    n_bytes: float = 0.0
    label: str = ""


@dataclass(frozen=True)
class Workload:
    """Remaining work of a run, or of several.

    Attributes:
        title: frames, views, methods, size.
        pieces: of all runs, each once.
        folder: where the runs go.
        frame_seconds: method -> seconds of a frame, as its jobs that are done took; methods without one are missing.
        jobs: processes.
    """

    title: str
    pieces: tuple[Piece, ...]
    folder: Path
    frame_seconds: Mapping[str, float] = field(default_factory=dict)
    jobs: int = 1

    def count(self, *kinds: Kind) -> int:
        """Number of pieces left of some kinds."""
        return sum(piece.count for piece in self.pieces if piece.kind in kinds)

    @property
    def disk_bytes(self) -> float:
        """Bytes that the runs will still write."""
        return sum(piece.n_bytes for piece in self.pieces)

    @property
    def free_bytes(self) -> int:
        """Free on the disk they go to."""
        return shutil.disk_usage(_existing(self.folder)).free

    def is_nothing(self) -> bool:
        """Tell whether everything is done."""
        return not self.pieces

    def describe(self) -> str:
        """A few lines; none where everything is done."""
        if self.is_nothing():
            return ""
        parts = [
            f"{self.count('render', 'path render')} frames to render",
            f"{self.count('depth', 'checked depth')} depth maps",
        ]
        views = sum(piece.kind == "score" for piece in self.pieces)
        others = [
            (self.count("truth"), "captured frame", "decode"),
            (self.count("fit"), "scene", "fit"),
            (views, "view", "score"),
        ]
        parts += [f"{counted(count, noun)} to {doing}" for count, noun, doing in others if count]
        lines = [
            f"plan: {self.title}; left are {', '.join(parts)}",
            f"disk: about {_size(self.disk_bytes)} more in {self.folder}, {_size(self.free_bytes)} free",
        ]
        return "\n".join([*lines, *self._time_line()])

    def _time_line(self) -> list[str]:
        """Estimate how long rendering takes, by jobs that are done; nothing where none is."""
        frames: dict[str, int] = defaultdict(int)
        for piece in self.pieces:
            if piece.label:
                frames[piece.label] += piece.count
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
    """
    seconds: dict[str, list[float]] = defaultdict(list)
    for plan in plans:
        for label in plan.request.labels:
            seconds[label] += _frame_seconds(plan, label)
    means = {label: sum(values) / len(values) for label, values in seconds.items() if values}
    pieces = {(piece.kind, piece.folder): piece for plan in plans for piece in work_left(plan)}
    return Workload(_title(plans), tuple(pieces.values()), folder, means, jobs)


def work_left(plan: RunPlan) -> list[Piece]:
    """List what one run lacks."""
    width, height = plan.original.cameras[0].size
    n_pixels, run, of_path = width * height, plan.run, len(plan.path)
    pieces: list[Piece] = []

    def add(kind: Kind, folder: Path, count: int, bytes_per_pixel: float = 0.0, label: str = "") -> None:
        if count:
            pieces.append(Piece(kind, folder, count, count * n_pixels * bytes_per_pixel, label))

    for folder, count in _truth_left(plan).items():
        add("truth", folder, count, TRUTH_BYTES)
    for kind, counts in _depth_left(plan, DepthStore(plan.shared_root / "depth")).items():
        for folder, count in counts.items():
            add(kind, folder, count, DEPTH_BYTES)
    if any(name.endswith("_disoccluded") for name in plan.protocol.measurement.metrics):
        for view in plan.plans:
            add("mask", run.disoccluded(view), _masks_left(plan, view))
    add("path depth", run.path_depth, _poses_left(plan), PATH_DEPTH_BYTES)
    for fit in plan.jobs.needed_fits:
        add("fit", fit.folder, int(not fit.is_done()))
    missing = [job for job in plan.jobs.render if not job.is_done()]
    for job in missing:
        along_path = job.units == (PATH,)
        count = of_path if along_path else len(plan.frames)
        add("path render" if along_path else "render", job.folder, count, RENDER_BYTES * (1 + PAGE_SHARE), job.label)
    stale, views = {unit for job in missing for unit in job.units}, plan.request.views
    for view in plan.plans if plan.methods else ():
        if (views is None or view in views) and (view in stale or not _is_scored(run, view, [*plan.methods])):
            add("score", run.scores(view), len(plan.frames))
    return pieces


def _truth_left(plan: RunPlan) -> dict[Path, int]:
    """Captured frames that are missing or were changed, of each camera and along the path."""
    root, images, folder = plan.shared_root / "truth", plan.path_images, plan.run.path("truth")
    left = {root / name: len(frames) for name, frames in frames_left(plan.original, plan.frames_of_cameras(), root).items()}
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


def _depth_left(plan: RunPlan, store: DepthStore) -> dict[Kind, dict[Path, int]]:
    """Missing depth maps by folder of the store: as found, and held against others."""
    unchecked: dict[Path, int] = {}
    checked: dict[Path, int] = {}
    for jobs, frames in plan.depth_work():
        for job in jobs:
            missing = _count(store, job.key, frames, checked if job.checked_with else unchecked)
            for other in (job.unchecked, *job.checked_with) if job.checked_with and missing else ():
                _count(store, other.key, frames, unchecked)
    return {"depth": unchecked, "checked depth": checked}


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
            seconds += [sum(map(sum, stages)) / len(plan.frames)] if stages else []  # none of a view that it cannot show
        except (ResultsError, KeyError, TypeError, AttributeError):
            continue
    return seconds


def _title(plans: Sequence[RunPlan]) -> str:
    """Describe the runs in one line."""
    first = plans[0]
    width, height = first.original.cameras[0].size
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
