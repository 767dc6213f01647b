"""Runs that a published value can be compared with: on its data set, on the paper's terms; or why there are none."""

from collections.abc import Sequence
from dataclasses import dataclass

from ggvs_eval.merged_results import merge_results
from ggvs_eval.progress import counted
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.tables.published import read_published
from ggvs_eval.results import Results


@dataclass(frozen=True)
class PaperTerms:
    """The paper's protocol on one data set, as far as it states it.

    Attributes:
        scenes: names of the scenes; empty where it names none.
        layouts: in which the data set lies on disk.
        test_views: how many; it does not say which.
        size: width and height of the rendered images, pixels.
        metric_size: width and height at which is measured.
    """

    dataset: str
    scenes: tuple[str, ...]
    layouts: tuple[str, ...]
    test_views: int
    k: int
    frames: int
    size: tuple[int, int]
    metric_size: tuple[int, int]

    def relation(self, run: MeasuredRun) -> str:
        """Relate a run to this data set: ``whole`` by its name, ``part`` of it (``DyNeRF, one instant``), or ``other``."""
        name, dataset = run.protocol.dataset.lower(), self.dataset.lower()
        if run.is_demo:
            return "other"
        return "whole" if name == dataset else "part" if name.startswith(f"{dataset},") else "other"

    def departures(self, run: MeasuredRun) -> tuple[str, ...]:
        """List a run's departures from the paper's protocol, in words; empty where it agrees in all that the paper states."""
        capture, protocol = run.capture, run.protocol
        size, layout = rendered_size(run), capture.get("layout", "unknown")
        measured = (protocol.measurement.width, protocol.measurement.height) if protocol.measurement.width else size
        views, frames = len(protocol.views.test), protocol.frames.count
        scenes = " and ".join(self.scenes)
        departures = {
            f"layout {layout}, not {' or '.join(self.layouts)}": layout not in self.layouts,
            f"scene {run.scene}, not {scenes}": bool(self.scenes) and run.scene not in self.scenes,
            f"{counted(frames, 'frame')}, not {self.frames}": frames != self.frames,
            f"{counted(views, 'test view')}, not {self.test_views}": views != self.test_views,
            f"K = {protocol.synthesis.k}, not {self.k}": protocol.synthesis.k != self.k,
            "source views chosen by coverage, not the nearest": protocol.synthesis.sources != "nearest",
            f"{_size(size)} pixels, not {_size(self.size)}": size != self.size,
            f"measured at {_size(measured)}, not {_size(self.metric_size)}": size == self.size and measured != self.metric_size,
            "a frame held still or noise added": bool(capture.get("edit")),
        }
        return tuple(words for words, applies in departures.items() if applies)

    def missing_scenes(self, scenes: set[str]) -> tuple[str, ...]:
        """Scenes of the paper that are not among these."""
        return tuple(scene for scene in self.scenes if scene not in scenes)


def read_terms(dataset: str) -> PaperTerms:
    """The terms of one of the paper's data sets, see ``data/protocol.csv``."""
    published = read_published("protocol")
    values = published["all"]["protocol"] | published[dataset]["protocol"]
    width, height = int(values["render_width"]), int(values["render_height"])
    return PaperTerms(
        dataset,
        tuple(values.get("scenes", "").split()),
        tuple(values["layouts"].split()),
        int(values["test_views"]),
        int(values["K"]),
        int(values["frames"]),
        (width, height),
        (int(values.get("metric_width", width)), int(values.get("metric_height", height))),
    )


def rendered_size(run: MeasuredRun) -> tuple[int, int]:
    """Width and height of the run's images: the protocol's, or those of the capture where it keeps these; 0 where unknown."""
    synthesis, view = run.protocol.synthesis, run.protocol.views.test[0]
    width, height = run.capture.get("cameras", {}).get(view, {}).get("size", (0, 0))
    return (synthesis.width, synthesis.height) if synthesis.width else (width, height)


def _size(size: tuple[int, int]) -> str:
    return f"{size[0]} × {size[1]}" if any(size) else "an unknown number of"


@dataclass(frozen=True)
class ComparableRuns:
    """Runs on one of the paper's data sets, on its terms.

    Attributes:
        runs: one per scene, of one protocol.
        words: what was measured on, for the reader.
    """

    runs: tuple[MeasuredRun, ...]
    results: Results
    words: str


@dataclass(frozen=True)
class NotComparable:
    """Absence of such a run, with the reason.

    Attributes:
        near: a run on part of the data set, or on other terms.
    """

    words: str
    near: MeasuredRun | None = None


def find_comparable_runs(dataset: str, runs: Sequence[MeasuredRun]) -> ComparableRuns | NotComparable:
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


def why_not_beside(dataset: str, runs: Sequence[MeasuredRun]) -> str:
    """Say why the paper's values of a data set are not in a table of these runs; empty where they are."""
    found = find_comparable_runs(dataset, runs)
    if isinstance(found, NotComparable):
        return found.words
    others = [run for run in runs if not any(run is one for one in found.runs)]
    return f"{_name(others[0])} is none of its scenes" if others else ""


def _departures(terms: PaperTerms, run: MeasuredRun) -> str:
    return "; ".join(terms.departures(run)) or "part of it by its name"


def _what_instead(runs: Sequence[MeasuredRun]) -> str:
    """Name what the runs are of instead of the paper's data sets."""
    names = dict.fromkeys(_name(run) + (", a demo capture" if run.is_demo else "") for run in runs)
    return f"this report is of {'; '.join(names)}, none of the paper's data sets"


def _name(run: MeasuredRun) -> str:
    return f"{run.protocol.dataset} ({run.scene})"


def _words(terms: PaperTerms, runs: Sequence[MeasuredRun]) -> str:
    scenes = ", ".join(dict.fromkeys(run.scene for run in runs))
    return f"on {scenes}" + ("" if terms.scenes else ", chosen by us, for the paper names no scenes")
