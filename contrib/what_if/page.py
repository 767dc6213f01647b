"""Frames with their faults undone for the page of a run: those that its scores report, and those
that `what-if` found there.
"""

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

# of a run folder: labels of the methods in which `what-if` found faults to undo
FOUND_FILE: Final = "what_if.json"
# Read to estimate and to score; a page waits for no more. The way back is the same for all frames.
MOST_FRAMES = 24
METRIC = "PSNR"


def keep_for_page(run: RunFolder, is_undoable: Mapping[str, bool]) -> None:
    """Remember in which methods of a run faults were found that can be undone, and in which
    none.
    """
    write_json(
        run.root / FOUND_FILE,
        sorted((_kept(run) - {*is_undoable}) | {*filter(is_undoable.get, is_undoable)}),
    )


def _kept(run: RunFolder) -> set[str]:
    file = run.root / FOUND_FILE
    return set(read_json(file)) if file.is_file() else set()


def undo_faults(run: MeasuredRun) -> dict[str, UndoneRenders]:
    """Undo the faults of a run's renders, those that its scores report and those that `what-if`
    found.

    Returns:
        Label -> its frames with every fault undone; without methods whose faults cannot be undone,
        or that have too few frames.
    """
    faulty = _kept(run.folder) | {fault.label for fault in run.results.faults}
    labels = [
        label for label in run.pictured if label in faulty and len(run.frames) >= FEWEST_FRAMES
    ]
    undone = {label: _undone(run.folder, label) for label in labels}
    return {label: renders for label, renders in undone.items() if renders}


def _undone(run: RunFolder, label: str) -> UndoneRenders | None:
    views = views_of_run(run, label)
    sampled = {
        name: replace(view, frames=middle_of(view.frames, MOST_FRAMES), truth_frames=view.frames)
        for name, view in views.items()
    }
    try:
        outcome = what_if(sampled, cameras_of_run(run), run.protocol().measurement, (METRIC,))
    except RenderError:
        # frames that nothing can be estimated on or scored on; the fault itself is reported
        # elsewhere
        return None
    if not outcome.rows or METRIC in outcome.not_computed:
        return None
    undos = outcome.best.undos
    words = ", ".join(undo.words() for undo in undos)
    treated = {name: apply(undos, name, view) for name, view in views.items()}

    def read(view: str, frame: int) -> Image8 | None:
        return treated[view].rendered(frame) if frame in treated[view].frames else None

    scores = "; ".join(
        f"{row.words} {cell_text(METRIC, row.scores[METRIC])} dB"
        for row in (outcome.rows[0], outcome.best)
    )
    where = (
        f"estimated on frames {as_ranges(list(outcome.estimated_on))}, scored on "
        f"{as_ranges(list(outcome.scored_on))}"
    )
    return UndoneRenders(words, f"{METRIC} {scores}; not ranked, {where}", read)
