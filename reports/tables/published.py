"""Published values: grey rows with source and caveats, never mixed with measured ones, and the runs that they compare with.

A value of the paper compares with a run on its data set, on the paper's terms; tables of community protocols with a run on
exactly their terms, and no other.
"""

import csv
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources

from ggvs_eval.merged_results import merge_results
from ggvs_eval.progress import counted
from ggvs_eval.protocol import Measurement, Protocol, Synthesis, load_protocol, packaged_protocols
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.model.table import Cell, Row
from ggvs_eval.results import Results

SOURCE = "Ha et al., Geometry-guided Online 3D Video Synthesis with Multi-View Temporal Consistency, CVPR 2025"
CAVEATS = (
    "The paper blends with a trained network and takes depth from RAFT-Stereo; the methods measured here can differ.",
    "It gives the number of test views (9 on DyNeRF) but does not name them; the choice moves PSNR by more than 1 dB.",
    "It leaves the backbone of LPIPS and the variants of STED and SSIM open; the protocol states those used here.",
)
PAPER = " (paper)"  # ends the name of the paper's rows, which are not the only published ones
PAPER_TABLES = ("quality", "consistency")
UNITS = {"PSNR": "dB"}
HIGHER_IS_BETTER = ("PSNR", "SSIM", "TCC")
TIMING_WORDS = {
    "forward_splatting_ms": "forward splatting",
    "tsdf_ms": "TSDF",
    "blending_tensorrt_ms": "blending, TensorRT",
    "blending_no_tensorrt_ms": "blending, no TensorRT",
    "total_no_tensorrt_ms_text": "total, no TensorRT (as its text says)",
    "total_ms_text": "total (as its text says)",
}
MEAN = "mean of"  # what the scene of a published value begins with where it is no scene


@cache
def read_published(name: str) -> dict[str, dict[str, dict[str, str]]]:
    """Return one of the paper's tables.

    Args:
        name: ``quality``, ``consistency``, ``ablation`` or ``timing``.

    Returns:
        dataset -> method -> metric -> value, with the digits that the paper prints.
    """
    text = (resources.files("ggvs_eval.reports.tables") / "data" / f"{name}.csv").read_text(encoding="utf-8")
    values: dict[str, dict[str, dict[str, str]]] = {}
    for line in csv.DictReader(line for line in text.splitlines() if not line.startswith("#")):
        values.setdefault(line["dataset"], {}).setdefault(line["method"], {})[line["metric"]] = line["value"]
    return values


def is_higher_better(metric: str) -> bool:
    """Return the direction of one of the paper's metrics."""
    return metric in HIGHER_IS_BETTER


def paper_dataset(name: str) -> str:
    """Return the paper's own name of a data set; empty if it has none of that name."""
    return next((dataset for dataset in read_published("quality") if dataset.lower() == name.lower()), "")


def paper_beside(
    key: str, dataset: str, metrics: Sequence[str], runs: Sequence[MeasuredRun]
) -> tuple[tuple[Row, ...], list[str]]:
    """Return the paper's rows of a table if the runs are on its terms, or else the reason in words."""
    if key not in PAPER_TABLES or not paper_dataset(dataset):
        return (), []
    comparable = find_comparable_runs(paper_dataset(dataset), runs)
    if isinstance(comparable, NotComparable):
        return (), [f"The paper's values are not shown here: {comparable.words}."]
    for run in runs:
        if run not in comparable.runs:
            return (), [f"The paper's values are not shown here: {_name(run)} is none of its scenes."]
    return published_rows(key, dataset, metrics), []


def published_rows(name: str, dataset: str, metrics: Sequence[str]) -> tuple[Row, ...]:
    """Return the paper's rows for one dataset, shown in grey below what was measured on its terms, see `paper_beside`."""
    methods = read_published(name).get(paper_dataset(dataset), {})
    return tuple(
        Row(f"{method}{PAPER}", tuple(published_cell(values.get(metric)) for metric in metrics), "published")
        for method, values in methods.items()
    )


def published_cell(text: str | None) -> Cell:
    """Return a published value with its own digits, or the word that there is none."""
    return Cell("not reported") if text is None else Cell(text, float(text))


@dataclass(frozen=True)
class PublishedTerms:
    """Origin and terms of a published table.

    Attributes:
        protocol: packaged protocol that it belongs to.
        checked: where each value was read.
        scenes: names of the scenes of which only the mean is published.
        withheld: why no value is shown next to measured ones; empty if they are.
    """

    protocol: str
    source: str
    frames: str
    lpips_net: str
    dssim: str
    checked: str
    withheld: str
    scenes: str


@dataclass(frozen=True)
class PublishedValue:
    """One value, with the digits that are printed; `scene` is a folder, or says which scenes it is the mean of."""

    protocol: str
    scene: str
    method: str
    metric: str
    value: str


@cache
def published_terms() -> dict[str, PublishedTerms]:
    """Protocol -> the terms of its table."""
    return {line["protocol"]: PublishedTerms(**line) for line in _read("community_terms")}


@cache
def published_values() -> tuple[PublishedValue, ...]:
    """Return all values, in the order of the file."""
    return tuple(PublishedValue(**line) for line in _read("community"))


def community_beside(
    key: str, dataset: str, metrics: Sequence[str], runs: Sequence[MeasuredRun]
) -> tuple[tuple[Row, ...], list[str]]:
    """Return the rows of the runs' packaged protocol, with their source or the reason why there are none."""
    protocol = runs[0].protocol
    scenes = [f"{run.scene}, a demo capture," if run.is_demo else run.scene for run in runs]
    rows = community_rows(protocol, scenes, metrics)
    return rows, describe_published(protocol, scenes) if rows or key == PAPER_TABLES[0] else []


def community_rows(protocol: Protocol, scenes: Collection[str], metrics: Sequence[str]) -> tuple[Row, ...]:
    """Make the grey rows below what a run measured.

    Returns:
        A row per method and scene with a value in any column: of these scenes, and means over the whole data set. None for a run
        on other terms than a packaged protocol with a published table, see `describe_published`.
    """
    rows = []
    for (method, scene), values in _shown(protocol, scenes).items():
        if values.keys() & set(metrics):
            cells = tuple(published_cell(values.get(metric)) for metric in metrics)
            rows.append(Row(f"{method} (published, {scene})", cells, "published"))
    return tuple(rows)


def describe_published(protocol: Protocol, scenes: Collection[str]) -> list[str]:
    """State the source of a table's published rows, or why it has none."""
    terms = published_terms().get(protocol.name)
    if terms is None:
        return []
    if reason := _difference(protocol, scenes) or terms.withheld:
        return [f"Published values of {protocol.name} are not shown: {reason}."]
    shown = _shown(protocol, scenes)
    beyond = [
        f"{metric} {value} of {method} ({scene})"
        for (method, scene), values in shown.items()
        for metric, value in values.items()
        if metric not in protocol.measurement.metrics
    ]
    told = (
        f"Grey: {terms.source}; frames: {terms.frames}; LPIPS: {terms.lpips_net}; D-SSIM: {terms.dssim}. "
        f"Values: {terms.checked}. Methods that fit a scene take all its other cameras as input, not K."
    )
    return [told, *([f"Published too: {', '.join(beyond)}."] if beyond else [])] if shown else []


def _shown(protocol: Protocol, scenes: Collection[str]) -> dict[tuple[str, str], dict[str, str]]:
    """(method, scene) -> metric -> value that can be shown next to a run."""
    terms = published_terms().get(protocol.name)
    if terms is None or terms.withheld or _difference(protocol, scenes):
        return {}
    shown: dict[tuple[str, str], dict[str, str]] = {}
    for each in published_values():
        if each.protocol == protocol.name and (each.scene in scenes or each.scene.startswith(MEAN)):
            shown.setdefault((each.method, each.scene), {})[each.metric] = each.value
    return shown


def _difference(protocol: Protocol, scenes: Collection[str]) -> str:
    """Return what a run under a packaged protocol's name does or shows otherwise; empty if values compare."""
    if protocol.name not in packaged_protocols():
        return f"no packaged protocol is called {protocol.name}"
    ours, theirs = _terms(protocol), _terms(load_protocol(protocol.name))
    parts = ("dataset", "views", "frames", "synthesis", "measurement")
    if differing := [part for part in parts if getattr(ours, part) != getattr(theirs, part)]:
        return f"this run differs from the packaged protocol in {', '.join(differing)}"
    of_values = {each.scene.lower() for each in published_values() if each.protocol == protocol.name}
    of_means = published_terms()[protocol.name].scenes.lower().split()
    known = {scene for scene in of_values if not scene.startswith(MEAN)}.union(of_means)
    foreign = [scene for scene in scenes if known and scene.lower() not in known]
    return f"{', '.join(foreign)} is none of the published scenes" if foreign else ""


def _terms(protocol: Protocol) -> Protocol:
    """Return the protocol without what moves no value of a metric: which others there are, and which sources are chosen."""
    synthesis = replace(protocol.synthesis, k=1, sources=Synthesis.sources)
    measurement = replace(protocol.measurement, metrics=(), ceilings=Measurement.ceilings)
    return replace(protocol, synthesis=synthesis, measurement=measurement)


def _read(name: str) -> list[dict[str, str]]:
    text = (resources.files("ggvs_eval.reports.tables") / "data" / f"{name}.csv").read_text(encoding="utf-8")
    return list(csv.DictReader(line for line in text.splitlines() if not line.startswith("#")))


@dataclass(frozen=True)
class PaperTerms:
    """The paper's protocol on one data set, as far as it states it.

    Attributes:
        scenes: names of the scenes; empty if it names none.
        layouts: in which the data set is on disk.
        test_views: how many; it does not say which.
        size: width and height of the rendered images, pixels.
        metric_size: measured width and height, pixels.
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
        """List a run's departures from the paper's protocol, in words; empty if it agrees in all that the paper states."""
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
            "source views chosen by coverage, not by distance": protocol.synthesis.sources != "nearest",
            f"{_size(size)} pixels, not {_size(self.size)}": size != self.size,
            f"measured at {_size(measured)}, not {_size(self.metric_size)}": size == self.size and measured != self.metric_size,
            "a frame held still or noise added": bool(capture.get("edit")),
        }
        return tuple(words for words, applies in departures.items() if applies)


def read_terms(dataset: str) -> PaperTerms:
    """Return the terms of one of the paper's data sets, see ``data/protocol.csv``."""
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
    """Return the runs that can be checked against one of the paper's data sets.

    Reading:
        Test views are not compared by name, for the paper gives their number alone. Where it names scenes, all of them are
        wanted, because its values are means over them.
    """
    terms = read_terms(dataset)
    related = [run for run in runs if terms.relation(run) != "other"]
    whole = [run for run in related if terms.relation(run) == "whole" and not terms.departures(run)]
    if not related:
        names = dict.fromkeys(_name(run) + (", a demo capture" if run.is_demo else "") for run in runs)
        instead = f"this report is of {'; '.join(names)}, none of the paper's data sets"
        return NotComparable(f"no run on {dataset} here; {instead}")
    if not whole:
        why = "; ".join(terms.departures(related[0])) or "part of it by its name"
        return NotComparable(f"{_name(related[0])} is not {dataset} on the paper's terms: {why}", related[0])
    alike = [run for run in whole if run.protocol.sha256 == whole[0].protocol.sha256]
    missing = [scene for scene in terms.scenes if scene not in {run.scene for run in alike}]
    if missing:
        return NotComparable(
            f"{_name(alike[0])} is only part of {dataset}; the paper's means also include {' and '.join(missing)}", alike[0]
        )
    words = f"on {', '.join(dict.fromkeys(run.scene for run in alike))}"
    words += "" if terms.scenes else ", selected here, since the paper names no scenes"
    return ComparableRuns(tuple(alike), merge_results([run.results for run in alike]), words)


def _name(run: MeasuredRun) -> str:
    return f"{run.protocol.dataset} ({run.scene})"
