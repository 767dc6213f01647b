"""Published tables of community protocols: grey rows of a run on exactly their terms, and of no other."""

import csv
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources

from ggvs_eval.protocol import Measurement, Protocol, Synthesis, load_protocol, packaged_protocols
from ggvs_eval.reports.model.table import Row
from ggvs_eval.reports.tables.published import published_cell

MEAN = "mean of"  # what the scene of a published value begins with where it is no scene


@dataclass(frozen=True)
class PublishedTerms:
    """Origin and terms of a published table.

    Attributes:
        protocol: packaged protocol that it belongs to.
        checked: where each value was read.
        scenes: names of the scenes of which only the mean is published.
        withheld: why no value is shown beside measured ones; empty where they are.
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
    """All values, in the order of the file."""
    return tuple(PublishedValue(**line) for line in _read("community"))


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
    """Say below a table where its published rows are from, or why it has none though its protocol's name has a table."""
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
    """(method, scene) -> metric -> value of what may be shown beside a run."""
    terms = published_terms().get(protocol.name)
    if terms is None or terms.withheld or _difference(protocol, scenes):
        return {}
    shown: dict[tuple[str, str], dict[str, str]] = {}
    for each in published_values():
        if each.protocol == protocol.name and (each.scene in scenes or each.scene.startswith(MEAN)):
            shown.setdefault((each.method, each.scene), {})[each.metric] = each.value
    return shown


def _difference(protocol: Protocol, scenes: Collection[str]) -> str:
    """Return what a run under a packaged protocol's name does or shows otherwise; empty where values compare."""
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
    """The protocol without what moves no value of a metric: which others there are, and which sources are chosen."""
    synthesis = replace(protocol.synthesis, k=1, sources=Synthesis.sources)
    measurement = replace(protocol.measurement, metrics=(), ceilings=Measurement.ceilings)
    return replace(protocol, synthesis=synthesis, measurement=measurement)


def _read(name: str) -> list[dict[str, str]]:
    text = (resources.files("ggvs_eval.reports.tables") / "data" / f"{name}.csv").read_text(encoding="utf-8")
    return list(csv.DictReader(line for line in text.splitlines() if not line.startswith("#")))
