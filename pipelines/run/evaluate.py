"""The whole evaluation on one page: capture -> prepare -> render -> score -> report. Each step reads a folder and writes one."""

from collections.abc import Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path

from ggvs_eval.capture import Capture, CaptureEdit
from ggvs_eval.datasets import open_capture
from ggvs_eval.datasets.capture_edit import perturb_capture
from ggvs_eval.jobs.code_identity import code_identity
from ggvs_eval.jobs.engine import Workers, as_engine
from ggvs_eval.jobs.processes import kept_workers
from ggvs_eval.pipelines.methods.network_options import AS_SHIPPED, NetworkOptions
from ggvs_eval.pipelines.offline.depth.depth_choice import DepthRunOptions
from ggvs_eval.pipelines.run.coverage import require_imported
from ggvs_eval.pipelines.run.derived_files import DIGESTS, MadeFiles, digest_folder
from ggvs_eval.pipelines.run.prepare import prepare_run
from ggvs_eval.pipelines.run.run_plan import RunPlan, RunRequest, plan_run
from ggvs_eval.pipelines.run.stages import Stages, measure_runs, render_runs
from ggvs_eval.protocol import Protocol
from ggvs_eval.results import Results
from ggvs_eval.run_folder import RunFolder


def evaluate(
    root: Path,
    capture: Capture,
    protocol: Protocol,
    labels: Sequence[str],
    workers: Workers,
    depth: DepthRunOptions | None = None,
    networks: NetworkOptions = AS_SHIPPED,
) -> Path:
    """Evaluate methods on a capture; a second call computes only missing results.

    Args:
        root: run folder, see `ggvs_eval.run_folder`.
        capture: what to evaluate on.
        protocol: views, frames, sizes, metrics.
        labels: methods, see `ggvs_eval.pipelines.methods.registry.METHODS`.
        workers: where jobs run: so many processes, or an `Engine`.
        depth: how depth is found, see `DepthRunOptions`.
        networks: with which weights and where networks compute.

    Returns:
        Path of the report's page.
    """
    measure(plan_run(RunRequest(root, capture, protocol, labels, depth, networks)), workers)
    return report([root])


@kept_workers()
def measure(plan: RunPlan, workers: Workers) -> Results:
    """Prepare, render and score what a run lacks: everything of `evaluate` but the report."""
    ((_, scores),) = measure_runs([plan], Stages(plan.run.root, as_engine(workers)))
    return scores.collect()


def render(prepared: RunPlan, workers: Workers = 1) -> int:
    """Synthesise the views and the camera path of a prepared run by its methods; arguments and errors as of `render_runs`."""
    return render_runs([prepared], Stages(prepared.run.root, as_engine(workers)))


def reopen(root: Path, workers: Workers, labels: Sequence[str] = (), networks: NetworkOptions = AS_SHIPPED) -> RunPlan:
    """Pick up a run folder that `prepare` has made, from the protocol and capture that it names.

    Args:
        labels: methods that will be rendered: those that are fitted need more depth than others.
    """
    run = RunFolder(root)
    request = RunRequest(root, recorded_capture(run), run.protocol(), labels, networks=networks)
    return prepare_run(plan_run(request), workers)


def recorded_capture(run: RunFolder) -> Capture:
    """The capture of a run folder, with the cameras, units and noise it had when the run was prepared."""
    record = run.capture_record()
    capture = open_capture(run.capture_path(), record["layout"], units=record["units_per_metre"], drop_unsynced=False)
    capture = capture.without([name for name in capture.camera_names if name not in record["cameras"]], "")
    capture = perturb_capture(capture, CaptureEdit(**(record.get("edit") or {})))
    return replace(capture, units_origin=record["units_origin"], notes=tuple(record["notes"]))


def report(
    roots: Sequence[Path],
    out: Path | None = None,
    tables_of: Sequence[Path] = (),
    with_figures: bool = True,
    standalone: bool = False,
    columns: Sequence[str] = (),
) -> Path:
    """Write the page, tables and figures of one or several run folders, see `write_report`; one of the same runs is kept.

    Kept is a report of which every file is as it was written.
    """
    from ggvs_eval.reports.report import write_report
    from ggvs_eval.reports.tables.table_formats import has_excel

    for run in map(RunFolder, roots):
        require_imported(run, run.labels())
    templates = Path(str(resources.files("ggvs_eval.reports")))
    made_from = {
        "code": [code_identity(write_report.__module__), digest_folder(templates, without=["__pycache__"])],
        "runs": [digest_folder(root, without=["report", "jobs"]) for root in (*roots, *tables_of)],
        "called": [[Path(root).name for root in each] for each in (roots, tables_of)],
        "options": [with_figures, standalone, [*columns]],
        "excel": has_excel(),
    }
    if not roots:
        return write_report(roots, out, tables_of, with_figures, standalone, columns)  # which says that it takes a run
    folder = RunFolder(roots[0]).report if out is None else out
    written = MadeFiles(folder, made_from)
    if written.are_whole():
        return folder / "index.html"
    page = write_report(roots, out, tables_of, with_figures, standalone, columns)
    written.note(file.relative_to(folder).as_posix() for file in folder.rglob("*") if file.is_file() and file.name != DIGESTS)
    return page
