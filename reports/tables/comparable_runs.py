"""Runs that a published value can be compared with: on its data set, on the paper's terms; or why there are none."""

from collections.abc import Sequence
from dataclasses import dataclass

from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.tables.paper_terms import PaperTerms, is_demo, read_terms
from ggvs_eval.results import Results, merge_results


@dataclass(frozen=True)
class ComparableRuns:
    """Runs on one of the paper's data sets, on its terms.

    Attributes:
        runs: one per scene, of one protocol.
        results: theirs in one.
        words: what was measured on, for the reader.
    """

    runs: tuple[MeasuredRun, ...]
    results: Results
    words: str


@dataclass(frozen=True)
class NotComparable:
    """That there is no such run, and why.

    Attributes:
        words: the reason.
        near: a run on part of the data set, or on other terms.
    """

    words: str
    near: MeasuredRun | None = None


def find_ground(dataset: str, runs: Sequence[MeasuredRun]) -> ComparableRuns | NotComparable:
    """The runs that can be held against one of the paper's data sets.

    Reading:
        Test views are not compared by name, for the paper gives their number alone. Where it names scenes, all of them are
        wanted, because its values are means over them.
    """
    terms = read_terms(dataset)
    related = [run for run in runs if terms.relation(run) != "other"]
    whole = [run for run in related if terms.relation(run) == "whole" and not terms.departures(run)]
    if not related:
        return NotComparable(f"no run on {dataset} here; {_what_instead(runs)}")
    if not whole:
        return NotComparable(
            f"{_name(related[0])} is not {dataset} on the paper's terms: {_departures(terms, related[0])}", related[0]
        )
    alike = [run for run in whole if run.protocol.sha256 == whole[0].protocol.sha256]
    missing = terms.missing_scenes({run.scene for run in alike})
    if missing:
        return NotComparable(
            f"{_name(alike[0])} is part of {dataset} alone; the paper's means hold {' and '.join(missing)} too", alike[0]
        )
    return ComparableRuns(tuple(alike), merge_results([run.results for run in alike]), _words(terms, alike))


def _departures(terms: PaperTerms, run: MeasuredRun) -> str:
    return "; ".join(terms.departures(run)) or "part of it by its name"


def _what_instead(runs: Sequence[MeasuredRun]) -> str:
    """What the runs are of."""
    names = dict.fromkeys(_name(run) + (", a demo capture" if is_demo(run.folder.capture_record()) else "") for run in runs)
    return f"this report is of {'; '.join(names)}, none of the paper's data sets"


def _name(run: MeasuredRun) -> str:
    return f"{run.protocol.dataset} ({run.scene})"


def _words(terms: PaperTerms, runs: Sequence[MeasuredRun]) -> str:
    scenes = ", ".join(dict.fromkeys(run.scene for run in runs))
    return f"on {scenes}" + ("" if terms.scenes else ", chosen by us, for the paper names no scenes")
