"""The stages of a sweep, each over all of its runs at once: one bar, one pool, and what fails stops nothing else."""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypeVar

from ggvs_eval.jobs.engine import Engine
from ggvs_eval.jobs.job import Attempt, Job, attempt_jobs
from ggvs_eval.jobs.ledger import Failure, Ledger
from ggvs_eval.pipelines.methods.network_options import NetworkOptions
from ggvs_eval.pipelines.offline.depth.depth_choice import DepthRunOptions
from ggvs_eval.pipelines.run.import_renders import import_renders
from ggvs_eval.pipelines.run.prepare import prepare_run
from ggvs_eval.pipelines.run.render import needed_fits, note_labels, render_jobs
from ggvs_eval.pipelines.run.run_plan import RunPlan, plan_run
from ggvs_eval.pipelines.run.score import score_jobs
from ggvs_eval.pipelines.sweep.cells import PATH, Cell

Value = TypeVar("Value")
Share = Mapping[str, set[str]]  # name of a cell -> its views, and PATH, that are to be worked on


def attempt(name: str, work: Callable[[], Value]) -> tuple[Value | None, list[Failure]]:
    """Do something, and take its failure for a result."""
    try:
        return work(), []
    except Exception as error:
        return None, [Failure.of(name, error)]


def plan_cells(
    cells: Sequence[Cell], depth: DepthRunOptions | None, networks: NetworkOptions, share: Share
) -> tuple[dict[str, RunPlan], list[Failure]]:
    """Plan every run; nothing is written.

    Returns:
        By the names of the cells, the plans of those that can be prepared; and why others cannot.
    """
    plans, failures = {}, []
    for cell in cells:
        request = cell.request(depth, networks, share.get(cell.name))
        plan, why_not = attempt(f"prepare {cell.name}", partial(plan_run, request))
        failures += why_not
        if plan is not None:
            plans[cell.name] = plan
    return plans, failures


def prepare_cells(
    cells: Sequence[Cell], plans: Mapping[str, RunPlan], engine: Engine
) -> tuple[dict[str, RunPlan], list[Failure]]:
    """Write frames and depth of every planned run, one after the other, each in all processes.

    Returns:
        By the names of the cells, those that are ready; and why others are not.
    """
    ready, failures = {}, []
    for cell in (each for each in cells if each.name in plans):
        cell.share_folders()
        prepared, why_not = attempt(f"prepare {cell.name}", partial(prepare_run, plans[cell.name], engine))
        failures += why_not
        if prepared is not None:
            ready[cell.name] = prepared
    return ready, failures


def import_cells(
    cells: Sequence[Cell], ready: Mapping[str, RunPlan], engine: Engine
) -> tuple[dict[str, list[str]], list[Failure]]:
    """Take in what others rendered for the runs that are ready, and print how; what is there already is left alone.

    Returns:
        Name of a cell -> such methods, whole; and why others are not.
    """
    whole: dict[str, list[str]] = {}
    failures: list[Failure] = []
    for cell in (each for each in cells if each.name in ready):
        for label, path in cell.imported.items():
            taken, why_not = attempt(f"{cell.name}: {label}", partial(import_renders, cell.run, label, path, workers=engine.jobs))
            failures += why_not
            if taken is not None:
                whole.setdefault(cell.name, []).append(label)
                for note in taken["notes"]:
                    print(f"{cell.name}: {label}: {note}", file=sys.stderr)
    return whole, failures


def render_cells(
    cells: Sequence[Cell],
    ready: Mapping[str, RunPlan],
    engine: Engine,
    networks: NetworkOptions,
    share: Share,
    imported: Mapping[str, list[str]],
) -> tuple[dict[str, list[str]], list[Failure]]:
    """Render what is shared out of every run that is ready.

    Args:
        cells: runs.
        ready: by their names, those that can be rendered into.
        engine: where jobs run.
        networks: with which weights and where networks compute.
        share: what of each run is worked on.
        imported: name of a cell -> methods that others rendered.

    Returns:
        Name of a cell -> methods whose views are all there, as far as they are shared out; and what failed.
    """
    failures = _fit_cells(cells, ready, engine, networks, share)
    jobs: dict[tuple[str, str], list[Job]] = {}
    for cell in cells:
        for label in cell.synthesised if cell.name in ready else ():
            made = render_jobs(ready[cell.name], [label], engine, cell.networks(networks))
            mine = [job for job in made if _view_of(job, cell) in share[cell.name]]
            jobs[cell.name, label] = [replace(job, name=f"{cell.name}: {job.name}") for job in mine]
    tried = _attempt_all(cells, "render", [job for some in jobs.values() for job in some], engine, "rendering")
    whole: dict[str, list[str]] = {}
    for cell in cells:
        if cell.name in ready:
            note_labels(cell.run, cell.labels)
            of_view = {
                label: [job for job in jobs[cell.name, label] if _view_of(job, cell) != PATH] for label in cell.synthesised
            }
            whole[cell.name] = [label for label, views in of_view.items() if all(job.is_done() for job in views)]
            whole[cell.name] += imported.get(cell.name, [])
    return whole, [*failures, *tried.failures]


def _fit_cells(
    cells: Sequence[Cell], ready: Mapping[str, RunPlan], engine: Engine, networks: NetworkOptions, share: Share
) -> list[Failure]:
    """Fit what the rendered share needs, for all runs together; variants of a capture have their fits in common."""
    jobs: dict[Path, Job] = {}
    for cell in (each for each in cells if each.name in ready):
        for job in needed_fits(ready[cell.name], cell.synthesised, engine, cell.networks(networks), share[cell.name]):
            jobs.setdefault(job.folder, replace(job, name=f"{cell.folder}: {job.name}" if cell.folder else job.name))
    return list(_attempt_all(cells, "fit", list(jobs.values()), engine, "fitting").failures) if jobs else []


def score_cells(
    cells: Sequence[Cell], whole: Mapping[str, list[str]], engine: Engine, share: Share, device: str = "cpu"
) -> tuple[set[str], list[Failure]]:
    """Measure the views that are shared out of every run, all methods of a view together.

    Returns:
        Names of cells of which nothing failed; and what did.
    """
    jobs: dict[str, list[Job]] = {}
    failures: list[Failure] = []
    for cell in cells:
        views = [view for view in cell.protocol.views.test if view in share.get(cell.name, ())]
        if whole.get(cell.name) and views:
            made, why_not = attempt(f"score {cell.name}", partial(score_jobs, cell.run, whole[cell.name], views, device))
            failures += why_not
            if made is not None:
                jobs[cell.name] = [replace(job, name=f"{cell.name}: {job.name}") for job in made]
    tried = _attempt_all(cells, "score", [job for some in jobs.values() for job in some], engine, "scoring")
    good = {name for name, some in jobs.items() if all(job.is_done() for job in some)}
    return good, [*failures, *tried.failures]


def _attempt_all(cells: Sequence[Cell], stage: str, jobs: Sequence[Job], engine: Engine, doing: str) -> Attempt:
    """Run the jobs of a stage, known to the sweep's ledger."""
    ledger = Ledger(cells[0].root, stage)
    ledger.write([job.entry for job in jobs], keep=True)
    return attempt_jobs(jobs, engine, doing, ledger)


def _view_of(job: Job, cell: Cell) -> str:
    """The test view of a job that renders, or `PATH`."""
    return PATH if job.folder.parent == cell.run.path("") else job.folder.name
