"""Outputs of `ggvs-eval prepare` besides the depth store: the depth page, a fused instant, a COLMAP
workspace.
"""

from pathlib import Path

from ggvs_eval.depth_store import DepthJob, DepthStore
from ggvs_eval.errors import DepthError
from ggvs_eval.pipelines.offline.depth.camera_depth import FILLED_CONFIDENCE
from ggvs_eval.pipelines.offline.export.dense_workspace import write_dense_workspace
from ggvs_eval.pipelines.offline.export.surfaces import FusedFiles, fuse_instant
from ggvs_eval.pipelines.run.run_plan import RunPlan
from ggvs_eval.reports.depth_page.record import StoredDepth
from ggvs_eval.reports.depth_page.section import write_depth_page


def write_prepared_page(prepared: RunPlan, workers: int = 1) -> Path:
    """Write ``RUN/depth_page/`` of the first, middle and last instant."""
    frames = prepared.frames
    instants = tuple(sorted({frames[0], frames[len(frames) // 2], frames[-1]}))
    stored = [StoredDepth(job, instants) for job in prepared.view_jobs]
    # cameras of the path alone were prepared at its instant alone
    of_views = {job.camera_name for job in prepared.view_jobs}
    alone = [job for job in prepared.path_jobs if job.camera_name not in of_views]
    stored += [StoredDepth(job, (prepared.path_frame,)) for job in alone]
    store = DepthStore(prepared.run.depth)
    return write_depth_page(
        prepared.run.root / "depth_page",
        prepared.capture,
        stored,
        store,
        FILLED_CONFIDENCE,
        workers,
    )


def fuse_prepared(prepared: RunPlan, frame: int | None = None) -> FusedFiles:
    """Write ``RUN/fused/<frame>/points.ply`` and ``mesh.ply`` of all cameras with depth at one
    instant.

    Args:
        frame: the instant; the protocol's first by default.
    """
    frame = prepared.frames[0] if frame is None else frame
    jobs, store = _one_per_camera(prepared, frame), DepthStore(prepared.run.depth)
    capture, names = prepared.capture, [job.camera_name for job in jobs]
    return fuse_instant(
        [capture.camera(name) for name in names],
        [capture.frame(name, frame) for name in names],
        [store.read(job.key, frame) for job in jobs],
        prepared.run.root / "fused" / f"{frame:04d}",
    )


def export_prepared(prepared: RunPlan, folder: Path, frame: int | None = None) -> Path:
    """Write all cameras with depth at one instant as a COLMAP dense workspace.

    Args:
        folder: where to; absent or empty.
        frame: the instant; the protocol's first by default.
    """
    frame = prepared.frames[0] if frame is None else frame
    jobs, store = _one_per_camera(prepared, frame), DepthStore(prepared.run.depth)
    capture, names = prepared.capture, [job.camera_name for job in jobs]
    return write_dense_workspace(
        [capture.camera(name) for name in names],
        [capture.frame(name, frame) for name in names],
        [store.read(job.key, frame) for job in jobs],
        {job.camera_name: job.partner_names for job in jobs},
        folder,
    )


def _one_per_camera(prepared: RunPlan, frame: int) -> list[DepthJob]:
    """Of each camera with depth at an instant the job with most partners, in the order of the
    capture.
    """
    jobs = {
        *(prepared.view_jobs if frame in prepared.frames else ()),
        *(prepared.path_jobs if frame == prepared.path_frame else ()),
    }
    best: dict[str, DepthJob] = {}
    for job in sorted(jobs, key=lambda candidate: (-len(candidate.partner_names), candidate)):
        best.setdefault(job.camera_name, job)
    if not best:
        frames = prepared.frames
        raise DepthError(
            f"{prepared.run.root}: wanted depth of frame {frame}, got frames "
            f"{frames[0]}..{frames[-1]}; choose one of these"
        )
    return [best[name] for name in prepared.capture.camera_names if name in best]
