"""Captions of the main tables: the extent of each mean, its images, and values that do not compare."""

from collections.abc import Mapping, Sequence

from ggvs_eval.geometry.source_views import CHOSEN_AS
from ggvs_eval.merged_results import BETWEEN
from ggvs_eval.progress import counted
from ggvs_eval.protocol import Protocol
from ggvs_eval.reports.model.measured import PARTIAL, MeasuredRun
from ggvs_eval.results import Results, without_labels

OWN_PACKAGE = "ggvs-eval"  # what its version changes is measured again
INTERCHANGE = (
    "A test view is left out of its own rendering only and may be a source of others; `views.sources` of a protocol forbids it."
)


def main_captions(
    key: str, runs: Sequence[MeasuredRun], results: Results, names: Mapping[str, str], metrics: Sequence[str]
) -> list[str]:
    """Sentences on the basis of the numbers of a table.

    Args:
        names: label of each row -> name to show.
    """
    protocol = runs[0].protocol
    if key == "path":
        means = "Over the whole camera path, at one instant"
    else:
        frames, views = counted(protocol.frames.count, "frame"), counted(len(protocol.views.test), "view")
        if key == "stream":
            frames = _instants(protocol)
        means = f"Mean over {frames}, then {views}, then scenes"
    sources = _sources(runs, names)
    partial = results.provenance.get("partial", {})
    marks = [f"{names.get(label, label).removesuffix(PARTIAL)} is {mark}; it is not ranked." for label, mark in partial.items()]
    marks += results.fault_lines(names)
    whole = without_labels(results, partial)
    lacking = [*_fewer_frames(whole, metrics, protocol), *_fewer_views(whole, metrics, names)]
    shared = [INTERCHANGE] if sources and may_interchange(protocol) else []
    return [f"{'; '.join(filter(None, (means, sources)))}.", *shared, *lacking, *marks, *_versions(results)]


def _instants(protocol: Protocol) -> str:
    """Those at which a screen is scored."""
    stream, count = protocol.stream, protocol.frames.count
    if stream is None or not stream.warm_up:
        return "the instants from a method's first picture on"
    return f"the last {counted(count - stream.warm_up, 'instant')} of {count}"


def _sources(runs: Sequence[MeasuredRun], names: Mapping[str, str]) -> str:
    """Number of source views of those methods of which it is known; empty where it is of none."""
    known = set().union(*(run.from_sources for run in runs))
    others = [name for label, name in names.items() if label not in known]
    if len(others) == len(names):
        return ""
    synthesis = runs[0].protocol.synthesis
    exempt = f", but for {', '.join(others)}" if others else ""
    chosen = "" if synthesis.sources == "nearest" else f", {CHOSEN_AS[synthesis.sources]}"
    return f"K = {synthesis.k} source views{chosen}{exempt}"


def may_interchange(protocol: Protocol) -> bool:
    """Tell whether a test view can be a source of another one."""
    views = protocol.views
    return len(views.test) > 1 and (not views.sources or bool({*views.sources} & {*views.test}))


def _fewer_views(results: Results, metrics: Sequence[str], names: Mapping[str, str]) -> list[str]:
    """Say which views or scenes a mean lacks; a method that has no value at all says so in its cell."""
    measured = set(zip(results.table["metric"], results.row_labels, strict=True))
    labels = {label for _, label in measured}
    several = len(results.scenes) > 1
    lacking: dict[tuple[str, str, str], list[str]] = {}
    for one in results.absences:
        if one.metric in metrics and (one.metric, one.label) in measured:
            place = " of ".join(filter(None, (one.view, one.scene if several or not one.view else "")))
            lacking.setdefault((one.metric, place, one.reason), []).append(one.label)
    return [
        f"{metric}{'' if labels == set(own) else ' of ' + ', '.join(names.get(label, label) for label in own)} "
        f"is a mean without {place} ({reason})."
        for (metric, place, reason), own in lacking.items()
    ]


def _fewer_frames(results: Results, metrics: Sequence[str], protocol: Protocol) -> list[str]:
    """Say of how many frames a metric has values where that is less than one for each frame, or each pair of them."""
    table, count = results.table, protocol.frames.count
    framed = table[table["metric"].isin(metrics) & (table["frame"] >= 0)]
    keys = ["metric", "scene", "method", "variant", "view"]
    sentences = []
    for metric, counts in framed.groupby(keys, sort=False, dropna=False).size().groupby("metric", sort=False):
        low, high = int(counts.min()), int(counts.max())
        if low < count - 1:
            sentences.append(f"{metric} is of {low if low == high else f'{low} to {high}'} of {count} frames.")
    return sentences


def _versions(results: Results) -> list[str]:
    """Name the packages of which more than one version made these values."""
    versions = results.provenance.get("versions", {})
    mixed = [f"{name} {version}" for name, version in versions.items() if BETWEEN in version and name != OWN_PACKAGE]
    return [f"Values here were made under several versions: {', '.join(mixed)}."] if mixed else []
