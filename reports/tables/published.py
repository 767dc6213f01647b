"""Published values: grey rows with source and caveats, never mixed with measured ones, and the runs
that they compare with.

A value of the paper compares with a run on its data set, on the paper's terms; tables of community
protocols with a run on exactly their terms, and no other.
"""

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from importlib import resources

import pandas as pd

from ggvs_eval.merged_results import merge_results
from ggvs_eval.progress import counted
from ggvs_eval.protocol import Measurement, Protocol, Synthesis, load_protocol
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.model.table import Cell, Row
from ggvs_eval.results import Results

SOURCE = (
    "Ha et al., Geometry-guided Online 3D Video Synthesis with Multi-View Temporal "
    "Consistency, CVPR 2025"
)
CAVEATS = (
    "The paper blends with a trained network and takes depth from RAFT-Stereo; the methods "
    "measured here can differ.",
    "It gives the number of test views (9 on DyNeRF) but does not name them; the choice moves PSNR "
    "by more than 1 dB.",
    "It leaves the backbone of LPIPS and the variants of STED and SSIM open; the protocol states "
    "those used here.",
)
PUBLISHED = "published"  # in the place of a variant
PAPER = " (paper)"  # ends the name of the paper's rows, which are not the only published ones
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


@dataclass(frozen=True)
class Terms:
    """Origin and terms of published values.

    Attributes:
        protocol: packaged protocol that they belong to; the paper's are called as its data sets,
            in small letters.
        checked: where each value was read.
        withheld: why no value is shown next to measured ones; empty if they are.
        scenes: names of the scenes of which only the mean is published; empty if it names none.
        layouts: in which a data set of the paper is on disk; empty for all other sources.
    """

    protocol: str
    source: str
    frames: str
    lpips_net: str
    dssim: str
    checked: str
    withheld: str
    scenes: str
    layouts: str

    @property
    def words(self) -> str:
        """Source and ways of measuring, as one sentence each."""
        ways = f"frames: {self.frames}; LPIPS: {self.lpips_net}; D-SSIM: {self.dssim}"
        return f"{self.source}; {ways}. Values: {self.checked}."

    def differences(self, protocol: Protocol) -> tuple[str, ...]:
        """List in words what a protocol does otherwise than the packaged one.

        Nothing that moves no value counts.
        """
        here_values, packaged_values = (
            _without_choices(protocol),
            _without_choices(load_protocol(self.protocol)),
        )
        parts = ("dataset", "views", "frames", "synthesis", "measurement")
        differing = [
            part for part in parts if getattr(here_values, part) != getattr(packaged_values, part)
        ]
        return (
            (f"this run differs from the packaged protocol in {', '.join(differing)}",)
            if differing
            else ()
        )

    def departures(self, run: MeasuredRun) -> tuple[str, ...]:
        """List in words what a run does otherwise than the paper.

        Empty if it agrees in all that is stated.

        Reading:
            The paper states less than a protocol, of its test views the number alone. Community
            protocols are wanted in full, see `differences`.
        """
        protocol, packaged = run.protocol, load_protocol(self.protocol)
        capture, synthesis, scenes = run.capture, packaged.synthesis, self.scenes.split()
        layout, layouts = capture.get("layout", "unknown"), self.layouts.split()
        size, paper_size = rendered_size(run), (synthesis.width, synthesis.height)
        own_size, paper_measured = (
            _measured_size(protocol, size),
            _measured_size(packaged, paper_size),
        )
        n_views, n_paper_views = len(protocol.views.test), len(packaged.views.test)
        n_frames, n_paper_frames = protocol.frames.count, packaged.frames.count
        departures = {
            f"layout {layout}, not {' or '.join(layouts)}": layout not in layouts,
            f"scene {run.scene}, not {' and '.join(scenes)}": bool(scenes)
            and run.scene not in scenes,
            f"{counted(n_frames, 'frame')}, not {n_paper_frames}": n_frames != n_paper_frames,
            f"{counted(n_views, 'test view')}, not {n_paper_views}": n_views != n_paper_views,
            f"K = {protocol.synthesis.k}, not {synthesis.k}": protocol.synthesis.k != synthesis.k,
            "source views chosen by coverage, not by distance": protocol.synthesis.sources
            != "nearest",
            f"{_size(size)} pixels, not {_size(paper_size)}": size != paper_size,
            f"measured at {_size(own_size)}, not {_size(paper_measured)}": (
                size == paper_size and own_size != paper_measured
            ),
            "a frame held still or noise added": bool(capture.get("edit")),
        }
        return tuple(words for words, applies in departures.items() if applies)


@dataclass(frozen=True)
class PublishedValue:
    """One value, with the digits that are printed.

    Attributes:
        table: ``quality``, ``consistency``, ``ablation`` or ``timing`` of the paper; empty for
            tables of others.
        scene: a folder, or which scenes it is the mean of; the paper's name of its data set.
    """

    protocol: str
    table: str
    scene: str
    method: str
    metric: str
    value: str

    @property
    def row(self) -> str:
        """Name of its row next to measured ones."""
        return f"{self.method}{PAPER}" if self.table else f"{self.method} (published, {self.scene})"


@cache
def published_terms() -> dict[str, Terms]:
    """Protocol -> the terms of its values."""
    return {line["protocol"]: Terms(**line) for line in read_lines("published_terms")}


@cache
def published_values() -> tuple[PublishedValue, ...]:
    """Return all values, in the order of the file."""
    return tuple(PublishedValue(**line) for line in read_lines("published"))


def read_lines(name: str) -> list[dict[str, str]]:
    """Return the lines of a packaged table, by column."""
    text = (resources.files("ggvs_eval.reports.tables") / "data" / f"{name}.csv").read_text(
        encoding="utf-8"
    )
    return list(csv.DictReader(line for line in text.splitlines() if not line.startswith("#")))


def published_rows(values: Iterable[PublishedValue], metrics: Sequence[str]) -> tuple[Row, ...]:
    """Return a grey row per method and scene.

    Of a community, only those with a value in any column.
    """
    by_row: dict[str, dict[str, str]] = {}
    for value in values:
        by_row.setdefault(value.row, {})[value.metric] = value.value
    return tuple(
        Row(name, tuple(published_cell(row.get(metric)) for metric in metrics), "published")
        for name, row in by_row.items()
        if name.endswith(PAPER) or row.keys() & set(metrics)
    )


def published_cell(text: str | None) -> Cell:
    """Return a published value with its own digits, or the word that there is none."""
    return Cell("not reported") if text is None else Cell(text, float(text))


def paper_beside(
    key: str, dataset: str, metrics: Sequence[str], runs: Sequence[MeasuredRun]
) -> tuple[tuple[Row, ...], list[str]]:
    """Return the paper's rows of a table if the runs are on its terms, or else the reason
    in words.
    """
    values = [
        value
        for value in published_values()
        if (value.table, value.protocol) == (key, dataset.lower())
    ]
    if not values:
        return (), []
    comparable = find_comparable_runs(values[0].scene, runs)
    foreign = next((run for run in runs if run not in comparable.runs), None)
    if foreign:
        reason = f"{_name(foreign)} is none of its scenes" if comparable.runs else comparable.words
        return (), [f"The paper's values are not shown here: {reason}."]
    return published_rows(values, metrics), []


def community_values(protocol: Protocol, scenes: Sequence[str]) -> tuple[list[PublishedValue], str]:
    """Return the values of a packaged protocol that compare with runs under it, or else the reason
    in words.

    They are those of the scenes and means over the whole data set; both are empty if nothing is
    published.
    """
    terms = published_terms().get(protocol.name)
    if terms is None or terms.layouts:
        return [], ""
    values = [value for value in published_values() if value.protocol == protocol.name]
    scenes_of_table = {value.scene.lower() for value in values if not value.scene.startswith(MEAN)}
    scenes_of_table.update(terms.scenes.lower().split())
    foreign = [
        scene for scene in scenes if scenes_of_table and scene.lower() not in scenes_of_table
    ]
    not_of_them = f"{', '.join(foreign)} is none of the published scenes" if foreign else ""
    if reason := next(
        filter(None, (*terms.differences(protocol), not_of_them, terms.withheld)), ""
    ):
        return [], reason
    return [value for value in values if value.scene in scenes or value.scene.startswith(MEAN)], ""


def community_beside(
    key: str, dataset: str, metrics: Sequence[str], runs: Sequence[MeasuredRun]
) -> tuple[tuple[Row, ...], list[str]]:
    """Return the rows of the runs' packaged protocol, with their source or the reason why there are
    none.
    """
    protocol, is_first = runs[0].protocol, key == "quality"
    scenes = [f"{run.scene}, a demo capture," if run.is_demo else run.scene for run in runs]
    values, reason = community_values(protocol, scenes)
    if reason:
        return (), [
            f"Published values of {protocol.name} are not shown: {reason}."
        ] if is_first else []
    rows = published_rows(values, metrics)
    if not values or not (rows or is_first):
        return rows, []
    terms = published_terms()[protocol.name]
    source = (
        f"Grey: {terms.words} Methods that fit a scene take all its other cameras as input, not K."
    )
    beyond = [
        f"{value.metric} {value.value} of {value.method} ({value.scene})"
        for value in values
        if value.metric not in protocol.measurement.metrics
    ]
    return rows, [source, *([f"Published too: {', '.join(beyond)}."] if beyond else [])]


def published_lines(
    captures: Mapping[str, tuple[str, Protocol]], metrics: Sequence[str]
) -> tuple[pd.DataFrame, dict[str, None]]:
    """Return published values as lines of a sweep, and their sources or the reasons why there are
    none.

    Args:
        captures: folder in the sweep -> scene and protocol.
        metrics: columns of the sweep's table.
    """
    cells = []
    notes: dict[str, None] = {}
    for folder, (scene, protocol) in captures.items():
        values, reason = community_values(protocol, [scene])
        of_scene = [value for value in values if value.scene == scene and value.metric in metrics]
        cells += [
            (folder, PUBLISHED, value.method, value.metric, float(value.value))
            for value in of_scene
        ]
        if reason or of_scene:
            notes[f"{PUBLISHED}: {reason or published_terms()[protocol.name].words}"] = None
    lines = pd.DataFrame(cells, columns=["capture", "variant", "method", "metric", "value"])
    return lines.pivot(
        index=["capture", "variant", "method"], columns="metric", values="value"
    ), notes


def _without_choices(protocol: Protocol) -> Protocol:
    """Return the protocol without what moves no value of a metric: which others there are, and
    which sources are chosen.
    """
    synthesis = replace(protocol.synthesis, k=1, sources=Synthesis.sources)
    measurement = replace(protocol.measurement, metrics=(), ceilings=Measurement.ceilings)
    return replace(protocol, synthesis=synthesis, measurement=measurement)


def rendered_size(run: MeasuredRun) -> tuple[int, int]:
    """Width and height of the run's images: the protocol's, or those of the capture where it keeps
    these; 0 where unknown.
    """
    synthesis, view = run.protocol.synthesis, run.protocol.views.test[0]
    width, height = run.capture.get("cameras", {}).get(view, {}).get("size", (0, 0))
    return (synthesis.width, synthesis.height) if synthesis.width else (width, height)


def _measured_size(protocol: Protocol, rendered: tuple[int, int]) -> tuple[int, int]:
    measurement = protocol.measurement
    return (measurement.width, measurement.height) if measurement.width else rendered


def _size(size: tuple[int, int]) -> str:
    return f"{size[0]} × {size[1]}" if any(size) else "an unknown number of"


@dataclass(frozen=True)
class ComparableRuns:
    """Runs on one of the paper's data sets, on its terms.

    Attributes:
        words: what was measured on, for the reader, or why there is no such run.
        runs: one per scene, of one protocol.
        near: without such a run, one on part of the data set, or on other terms.
    """

    words: str
    runs: tuple[MeasuredRun, ...] = ()
    near: MeasuredRun | None = None

    @cached_property
    def results(self) -> Results:
        """Of all these runs."""
        return merge_results([run.results for run in self.runs])


def find_comparable_runs(dataset: str, runs: Sequence[MeasuredRun]) -> ComparableRuns:
    """Return the runs that can be checked against one of the paper's data sets.

    Reading:
        Test views are not compared by name, for the paper gives their number alone. Where it names
        scenes, all of them are wanted, because its values are means over them. A run belongs to a
        data set by its name, or to part of it (``DyNeRF, one instant``).
    """
    terms = published_terms()[dataset.lower()]
    captured = [run for run in runs if not run.is_demo]
    related = [
        run for run in captured if run.protocol.dataset.lower().split(",")[0] == terms.protocol
    ]
    complete = [run for run in related if "," not in run.protocol.dataset]
    alike = [run for run in complete if not terms.departures(run)]
    if not related:
        names = dict.fromkeys(
            _name(run) + (", a demo capture" if run.is_demo else "") for run in runs
        )
        instead = f"this report is of {'; '.join(names)}, none of the paper's data sets"
        return ComparableRuns(f"no run on {dataset} here; {instead}")
    if not alike:
        near = related[0]
        why = "; ".join(terms.departures(near)) or "part of it by its name"
        return ComparableRuns(
            f"{_name(near)} is not {dataset} on the paper's terms: {why}", near=near
        )
    alike = [run for run in alike if run.protocol.sha256 == alike[0].protocol.sha256]
    scenes = dict.fromkeys(run.scene for run in alike)
    if missing := [scene for scene in terms.scenes.split() if scene not in scenes]:
        words = f"the paper's means also include {' and '.join(missing)}"
        return ComparableRuns(
            f"{_name(alike[0])} is only part of {dataset}; {words}", near=alike[0]
        )
    unnamed = "" if terms.scenes else ", selected here, since the paper names no scenes"
    return ComparableRuns(f"on {', '.join(scenes)}{unnamed}", tuple(alike))


def _name(run: MeasuredRun) -> str:
    return f"{run.protocol.dataset} ({run.scene})"
