"""The whole evaluation on one page: capture -> prepare -> render -> score -> report.

Each step reads a folder and writes one.

Stages run for several runs together, sharing progress bar, pool and job log. A single run is a list
of one.
"""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

from ggvs_eval.capture import Capture, CaptureEdit, GivenDepth
from ggvs_eval.capture_edit import perturb_capture
from ggvs_eval.coverage import lacks_path, read_coverage, require_imported
from ggvs_eval.datasets import DEPTH_FILES, open_capture
from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.errors import Failure, ResultsError
from ggvs_eval.files.atomic import remove_leftovers
from ggvs_eval.jobs.engine import Engine, Workers, as_engine
from ggvs_eval.jobs.processes import kept_workers
from ggvs_eval.pipelines.methods.network_options import AS_SHIPPED, NetworkOptions
from ggvs_eval.pipelines.run.derived_files import digest_folder
from ggvs_eval.pipelines.run.import_renders import import_renders
from ggvs_eval.pipelines.run.prepare import prepare_run
from ggvs_eval.pipelines.run.render import note_labels
from ggvs_eval.pipelines.run.run_plan import RunPlan, RunRequest, plan_run
from ggvs_eval.pipelines.run.score import Scores, plan_scores
from ggvs_eval.protocol import Protocol
from ggvs_eval.results import Results
from ggvs_eval.run_folder import RunFolder
from ggvs_eval.tasks.identity import code_of
from ggvs_eval.tasks.run_tasks import attempt_tasks, run_tasks
from ggvs_eval.tasks.task import Task, left_of
from ggvs_eval.tasks.task_list import TaskList

Value = TypeVar("Value")
AnyTask = TypeVar("AnyTask", bound=Task)


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
        workers: number of processes, or an `Engine`.
        depth: how depth is found, see `DepthRunOptions`.
        networks: with which weights and where networks compute.

    Returns:
        Path of the report's page.
    """
    measure(
        plan_run(
            RunRequest(
                root=root,
                capture=capture,
                protocol=protocol,
                labels=labels,
                depth=depth,
                networks=networks,
            )
        ),
        workers,
    )
    return report([root])


@kept_workers()
def measure(plan: RunPlan, workers: Workers) -> Results:
    """Prepare, render and score what a run lacks: everything of `evaluate` but the report."""
    ((_, scores),) = measure_runs([plan], Stages(plan.run.root, as_engine(workers)))
    return scores.collect()


def render(prepared: RunPlan, workers: Workers = 1) -> int:
    """Synthesise the views and the camera path of a prepared run by its methods.

    Arguments and errors as of `render_runs`.
    """
    return render_runs([prepared], Stages(prepared.run.root, as_engine(workers)))


def reopen(
    root: Path, workers: Workers, labels: Sequence[str] = (), networks: NetworkOptions = AS_SHIPPED
) -> RunPlan:
    """Pick up a run folder that `prepare` has made, from the protocol and capture that it names.

    Args:
        labels: methods that will be rendered: those that are fitted need more depth than others.
    """
    run = RunFolder(root)
    request = RunRequest(
        root=root,
        capture=recorded_capture(run),
        protocol=run.protocol(),
        labels=labels,
        networks=networks,
    )
    return prepare_run(plan_run(request), workers)


def recorded_capture(run: RunFolder) -> Capture:
    """Return the capture of a run folder, with the cameras, units and noise it had when the run was
    prepared.
    """
    record = run.capture_record()
    if "truth" in record:
        raise ResultsError(
            f"{run.root}: wanted a run of a capture, got renders with their own truth; `ggvs-eval "
            f"run OUT --capture CAPTURE`"
        )
    capture = open_capture(
        run.capture_path(), record["layout"], units=record["units_per_metre"], drop_unsynced=False
    )
    capture = capture.without(
        [name for name in capture.camera_names if name not in record["cameras"]], ""
    )
    capture = perturb_capture(capture, CaptureEdit(**(record.get("edit") or {})))
    if "given_depth" in record:
        capture = DEPTH_FILES["maps"](capture, GivenDepth(**record["given_depth"]))
    return replace(capture, units_origin=record["units_origin"], notes=tuple(record["notes"]))


def report(
    roots: Sequence[Path],
    out: Path | None = None,
    tables_of: Sequence[Path] = (),
    with_figures: bool = True,
    standalone: bool = False,
    columns: Sequence[str] = (),
    jobs: int = 1,
) -> Path:
    """Write the page, tables and figures of one or several run folders, see `write_report`.

    One of the same runs is kept.

    Kept is a report of which every file is as it was written.
    """
    from ggvs_eval.reports.report import write_report
    from ggvs_eval.reports.section import section_modules
    from ggvs_eval.reports.tables.table_formats import has_excel

    for run in map(RunFolder, roots):
        require_imported(run, run.labels())
    templates = Path(str(resources.files("ggvs_eval.reports")))
    if not roots:
        # which says that it takes a run
        return write_report(roots, out, tables_of, with_figures, standalone, columns)
    folder = RunFolder(roots[0]).report if out is None else out
    remove_leftovers(folder)
    inputs = {
        "code": [code_of(*section_modules()), digest_folder(templates, without=["__pycache__"])],
        "runs": [digest_folder(root, without=["report", "jobs"]) for root in (*roots, *tables_of)],
        "called": [[Path(root).name for root in folders] for folders in (roots, tables_of)],
        "options": [with_figures, standalone, [*columns]],
        "excel": has_excel(),
    }

    def write(temporary: Path) -> dict[str, Any]:
        write_report(roots, temporary, tables_of, with_figures, standalone, columns, jobs)
        return {}

    task = Task(name="report", folder=folder, inputs=inputs, make=write, joins=True)
    if not task.is_done():
        task.run()
    return folder / "index.html"


@dataclass
class Stages:
    """Place where the stages of some runs are worked through.

    Attributes:
        root: folder of the run, or of the sweep; its lists name all tasks.
        goes_on: note what fails and continue with the rest; otherwise the first stage with a
            failure raises it.
    """

    root: Path
    engine: Engine
    goes_on: bool = False
    failures: list[Failure] = field(default_factory=list)

    def attempt(self, name: str, work: Callable[[], Value]) -> Value | None:
        """Do something; None if it failed."""
        return attempt(name, work, self.failures) if self.goes_on else work()

    def note(self, stage: str, tasks: Sequence[Task]) -> None:
        """Write the tasks of a stage into its list; those of other shards and sweeps stay."""
        TaskList(self.root, stage).write(tasks, keep=self.goes_on)

    def run(self, stage: str, tasks: Sequence[Task], doing: str) -> int:
        """Run the tasks that are not done yet, and return their number."""
        task_list = TaskList(self.root, stage)
        if not self.goes_on:
            return run_tasks(tasks, self.engine, doing, task_list)
        tried = attempt_tasks(tasks, self.engine, doing, task_list)
        self.failures += tried.failures
        return tried.n_done


def attempt(name: str, work: Callable[[], Value], failures: list[Failure]) -> Value | None:
    """Do something; where it fails, note why and give None."""
    try:
        return work()
    except Exception as error:
        failures.append(Failure.of(name, error))
        return None


def measure_runs(plans: Sequence[RunPlan], stages: Stages) -> list[tuple[RunPlan, Scores]]:
    """Prepare, render and score the rest of some runs, as far as their requests name units.

    Returns:
        The runs of which all is measured, with what `Scores.collect` makes their tables of.
    """
    tried = [
        stages.attempt(f"prepare {plan.name}", partial(prepare_run, plan, stages.engine))
        for plan in plans
    ]
    ready = [plan for plan in tried if plan]  # planned again where cameras were refined
    imported = {
        plan.name: [label for label in plan.request.imports if _import(plan, label, stages)]
        for plan in ready
    }
    if all(plan.request.only_prepares for plan in ready):
        return []
    render_runs(ready, stages)
    complete = {plan.name: [*plan.rendered_labels(), *imported[plan.name]] for plan in ready}
    return _score_runs(
        [plan for plan in ready if complete[plan.name] or not stages.goes_on], complete, stages
    )


def render_runs(plans: Sequence[RunPlan], stages: Stages) -> int:
    """Fit and render the rest, first what waits for no fit.

    Returns the number of units that were rendered.

    Raises:
        DeviceError: no such device here.
        RenderError: a method that cannot be made, or tasks that failed; each is listed.
        WeightsError: a method lacks its weights, or they are not its own.
    """
    renders = [_named(task, plan.name) for plan in plans for task in plan.renders]
    stages.note("render", renders)
    count = stages.run("render", [task for task in renders if not task.needs], "rendering")
    from_scenes = [task for task in renders if task.needs]
    left = {task.folder for task in left_of(from_scenes)}
    needs = {
        need.folder: need for task in from_scenes for need in task.needs if isinstance(need, Task)
    }
    fits = [need for need in needs.values() if need.is_done() or need.folder in left]
    if fits:
        stages.note("fit", fits)
        stages.run("fit", fits, "fitting")
    count += stages.run("render", from_scenes, "rendering from fitted scenes")
    for plan in plans:
        note_labels(plan.run, [*plan.methods, *plan.request.imports])
    return count


def _import(plan: RunPlan, label: str, stages: Stages) -> bool:
    """Take in what others rendered, and print how; what is there already is left alone."""
    work = partial(
        import_renders, plan.run, label, plan.request.imports[label], workers=stages.engine.jobs
    )
    record = stages.attempt(f"{plan.name}: {label}", work)
    for note in record["notes"] if record else ():
        print(f"{plan.name}: {label}: {note}", file=sys.stderr)
    return record is not None


def _score_runs(
    plans: Sequence[RunPlan], complete: dict[str, list[str]], stages: Stages
) -> list[tuple[RunPlan, Scores]]:
    """Measure all that is whole in the run folders.

    In a part of a run, which others may work on, its own methods alone.
    """
    planned: list[tuple[RunPlan, Scores]] = []
    for plan in plans:
        lacking = {*plan.methods, *plan.request.imports}.difference(
            complete[plan.name]
        ) | _left_unfinished(plan)
        labels = (
            complete[plan.name]
            if plan.request.views
            else [label for label in plan.run.labels() if label not in lacking]
        )
        work = partial(
            plan_scores, plan.run, labels, plan.request.views, plan.request.networks.device
        )
        scores = stages.attempt(f"score {plan.name}", work)
        planned += [] if scores is None else [(plan, scores)]
    tasks = [_named(task, plan.name) for plan, scores in planned for task in scores.tasks]
    stages.note("score", tasks)
    stages.run("score", tasks, "scoring")
    return [
        (plan, scores) for plan, scores in planned if all(task.is_done() for task in scores.tasks)
    ]


def _left_unfinished(plan: RunPlan) -> set[str]:
    """Partially rendered methods that this call did not request; each is logged."""
    run, numbers, views = plan.run, plan.protocol.frames.numbers, plan.protocol.views.test
    labels = [
        label for label in run.labels() if label not in {*plan.methods, *plan.request.imports}
    ]
    coverage = read_coverage(run, numbers, labels)
    lacking = coverage.unfinished(run, views, labels)
    rendered_here = {*labels}.difference(coverage.partial, coverage.imported)
    lacking |= {label for label in rendered_here if lacks_path(run, label)}
    for label in sorted(lacking):
        words = f"its frames are incomplete; --methods {label} resumes it"
        print(
            f"{run.root}: {label} omitted, an earlier call did not finish it: {words}",
            file=sys.stderr,
        )
    return lacking


def _named(task: AnyTask, run: str) -> AnyTask:
    return replace(task, name=f"{run}: {task.name}") if run else task
