"""Frames with their faults undone for the page of a run: those that its scores report, and those that `what-if` found there."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

from ggvs_eval.arrays import Image8
from ggvs_eval.contrib.what_if.undo import apply
from ggvs_eval.contrib.what_if.what_if import FEWEST_FRAMES, cell_text, what_if
from ggvs_eval.errors import RenderError
from ggvs_eval.pipelines.inspection.renders.identity import cameras_of_run, middle_of, views_of_run
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.page.pictures import UndoneRenders
from ggvs_eval.run_folder import RunFolder, as_ranges, read_json, write_json

FOUND_FILE: Final = "what_if.json"  # of a run folder: labels of the methods in which `what-if` found faults to undo
# Read to estimate and to score; a page waits for no more. The way back is the same for all frames.
MOST_FRAMES = 24
METRIC = "PSNR"


def keep_for_page(run: RunFolder, found: Mapping[str, bool]) -> None:
    """Remember in which methods of a run faults were found that can be undone, and in which none."""
    write_json(run.root / FOUND_FILE, sorted((_kept(run) - {*found}) | {*filter(found.get, found)}))


def _kept(run: RunFolder) -> set[str]:
    file = run.root / FOUND_FILE
    return set(read_json(file)) if file.is_file() else set()


def undo_faults(run: MeasuredRun) -> dict[str, UndoneRenders]:
    """Undo the faults of a run's renders, those that its scores report and those that `what-if` found.

    Returns:
        Label -> its frames with every fault undone; without methods whose faults cannot be undone, or that have too few frames.
    """
    faulty = _kept(run.folder) | {fault.label for fault in run.results.faults}
    labels = [label for label in run.pictured if label in faulty and len(run.frames) >= FEWEST_FRAMES]
    undone = {label: _undone(run.folder, label) for label in labels}
    return {label: renders for label, renders in undone.items() if renders}


def _undone(run: RunFolder, label: str) -> UndoneRenders | None:
    views = views_of_run(run, label)
    sampled = {
        name: replace(one, frames=middle_of(one.frames, MOST_FRAMES), truth_frames=one.frames) for name, one in views.items()
    }
    try:
        found = what_if(sampled, cameras_of_run(run), run.protocol().measurement, (METRIC,))
    except RenderError:
        return None  # frames that nothing can be estimated on or scored on; the fault itself is reported elsewhere
    if not found.rows or METRIC in found.not_computed:
        return None
    undos = found.best.undos
    words = ", ".join(undo.words() for undo in undos)
    treated = {name: apply(undos, name, view) for name, view in views.items()}

    def read(view: str, frame: int) -> Image8 | None:
        return treated[view].rendered(frame) if frame in treated[view].frames else None

    scores = "; ".join(f"{row.words} {cell_text(METRIC, row.scores[METRIC])} dB" for row in (found.rows[0], found.best))
    where = f"estimated on frames {as_ranges(list(found.estimated_on))}, scored on {as_ranges(list(found.scored_on))}"
    return UndoneRenders(words, f"{METRIC} {scores}; not ranked, {where}", read)
