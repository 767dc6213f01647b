"""A scored run folder as the reports see it: who was measured, under what name, and what each number means."""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from ggvs_eval.datasets.units import DEMO_NOTES
from ggvs_eval.errors import ResultsError
from ggvs_eval.protocol import Protocol
from ggvs_eval.reports.model.metric_note import MetricNote, read_metric_notes
from ggvs_eval.reports.model.table import Cell, Row, format_value
from ggvs_eval.results import Results
from ggvs_eval.run_folder import RunFolder, read_json, require_frames

REFERENCES_FILE = "references.json"
METHODS_FILE = "methods.json"


@dataclass(frozen=True)
class Reference:
    """Values that were computed on this capture but belong to no method.

    Attributes:
        group: table it stands in, e.g. ``consistency``.
        name: what it is.
        note: how it was made, one sentence.
        values: metric -> value, or the reason why there is none.
        bounds: metric -> ``at most`` or ``at least`` where its value is a bound.
    """

    group: str
    name: str
    note: str
    values: Mapping[str, float | str]
    bounds: Mapping[str, str] = field(default_factory=dict)


def read_references(folder: RunFolder) -> tuple[Reference, ...]:
    """Read what the score step wrote beside the results; nothing where it wrote none."""
    file = folder.root / REFERENCES_FILE
    return tuple(Reference(**entry) for entry in read_json(file)) if file.is_file() else ()


def reference_rows(references: Sequence[Reference], group: str, notes: Sequence[MetricNote]) -> tuple[Row, ...]:
    """The rows of one table; a reference without a number in it is left out, see `reference_remarks`."""
    return tuple(
        Row(reference.name, tuple(_cell(note, reference) for note in notes), "reference")
        for reference in references
        if reference.group == group and any(isinstance(reference.values.get(note.name), float | int) for note in notes)
    )


def reference_remarks(references: Sequence[Reference], group: str, notes: Sequence[MetricNote]) -> list[str]:
    """List the notes below a table: what each row is, and once for all that lack the same why they have no number."""
    mine, remarks = [reference for reference in references if reference.group == group], []
    absent: dict[str, tuple[list[str], list[str]]] = {}
    for reference in mine:
        values = {note.name: reference.values.get(note.name) for note in notes}
        if any(isinstance(value, float | int) for value in values.values()):
            remarks.append(f"{reference.name}: {reference.note}")
        for metric, reason in values.items():
            if isinstance(reason, str):
                names, metrics = absent.setdefault(reason, ([], []))
                names.append(reference.name)
                metrics.append(metric)
    for reason, (names, metrics) in absent.items():
        remarks.append(f"Not computed for {', '.join(dict.fromkeys(metrics))}: {', '.join(dict.fromkeys(names))} ({reason}).")
    return list(dict.fromkeys(remarks))


def _cell(note: MetricNote, reference: Reference) -> Cell:
    value = reference.values.get(note.name)
    if value is None:
        return Cell("no such reference")
    if isinstance(value, str):
        return Cell("not computed", note=value)
    text, bound = format_value(value, note.decimals), reference.bounds.get(note.name)
    return Cell(f"{bound} {text}" if bound else text, value)


@dataclass(frozen=True)
class MeasuredRun:
    """One run folder that was rendered and scored.

    Attributes:
        folder: where it lies.
        protocol: what was asked for.
        results: what came out.
        labels: folder names of the methods, in the order in which they were asked for.
        names: label -> name to show.
        ours: labels of the paper's method and its variants.
        metrics: metric -> its note.
        references: grey rows that belong to no method.
        replicas: label of a fitted method -> labels of the same by other seeds, which stand in no table but that of the spread.
        all_results: what came out, with these; None where there are none.
    """

    folder: RunFolder
    protocol: Protocol
    results: Results
    labels: tuple[str, ...]
    names: Mapping[str, str]
    ours: frozenset[str]
    metrics: Mapping[str, MetricNote]
    references: tuple[Reference, ...] = ()
    replicas: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    all_results: Results | None = None

    @property
    def scene(self) -> str:
        """Name of the captured scene."""
        return ", ".join(dict.fromkeys(self.results.table["scene"].astype(str)))

    @property
    def title(self) -> str:
        """Title by which a reader knows the scene.

        Reading:
            A demo capture is called like its folder or file (``demo-capture``, ``scene000``), which says nothing to a reader; its
            data set's name does.
        """
        is_demo = self.folder.capture_record().get("units_origin") == DEMO_NOTES
        return self.protocol.dataset if is_demo else self.scene

    @property
    def frames(self) -> range:
        """Numbers of the synthesised frames."""
        return self.protocol.frames.numbers

    @property
    def partial(self) -> Mapping[str, str]:
        """Methods whose renders lack views or frames -> what their numbers stand on."""
        marks: dict[str, str] = self.results.provenance.get("partial", {})
        return marks

    @property
    def pictured(self) -> tuple[str, ...]:
        """Labels of the methods that have every frame, which alone can stand beside each other in pictures."""
        return tuple(label for label in self.labels if label not in self.partial)

    @property
    def ours_first(self) -> tuple[str, ...]:
        """The same with the paper's method before its variants, and these before all others: whom to show where one is shown."""
        ours = sorted((label for label in self.pictured if label in self.ours), key=lambda label: "+" in label)  # stable
        return (*ours, *(label for label in self.pictured if label not in self.ours))

    def name(self, label: str) -> str:
        """Name of a method to show; ``truth`` has one too, and partial renders say that they are."""
        name = "Truth" if label == "truth" else self.names.get(label, label)
        return f"{name} (partial)" if label in self.partial else name

    def frame_folders(self, view: str) -> dict[str, Path]:
        """Folder of the captured frames of a view (key ``truth``, first) and of every method's that has all of them."""
        return {"truth": self.folder.truth(view)} | {label: self.folder.renders(label, view) for label in self.pictured}


def read_run(root: Path) -> MeasuredRun:
    """Read everything that a report says about a run, except its frames, which are only checked to be there.

    Raises:
        ResultsError: not a run folder, not scored, or scored under another protocol than the one that lies in it.
        RenderError: frames are missing.
    """
    run = read_scores(root)
    folder = run.folder
    if not folder.labels():
        raise ResultsError(f"{folder.root}: no frames under renders/ to report on; run `ggvs-eval render` again")
    hidden = {label for others in run.replicas.values() for label in others}
    labels = tuple(label for label in folder.labels() if label not in hidden)
    run = replace(run, labels=labels, references=read_references(folder))
    for view in run.protocol.views.test:
        named = {f"{run.name(label)} in {view}": path for label, path in run.frame_folders(view).items()}
        require_frames(named, run.frames)
    return run


def read_scores(root: Path) -> MeasuredRun:
    """Read the numbers of a run: its methods are those in the results, and no frame is looked for.

    Raises:
        ResultsError: not a run folder, not scored, or scored under another protocol than the one that lies in it.
    """
    folder = RunFolder(Path(root))
    protocol, results = folder.protocol(), Results.read(folder.root)
    if results.provenance["protocol_sha256"] != protocol.sha256:
        raise ResultsError(
            f"{folder.root}: results were measured under protocol {results.provenance['protocol_sha256'][:12]}, "
            f"protocol.toml is {protocol.sha256[:12]}; run `ggvs-eval score` again"
        )
    named = zip(results.table["method"], results.table["variant"], strict=True)
    labels = tuple(dict.fromkeys(label_of(*names) for names in dict.fromkeys(named)))
    methods = read_json(folder.root / METHODS_FILE)
    notes = read_metric_notes(folder.root)
    replicas = find_replicas(labels)
    hidden = {label for others in replicas.values() for label in others}
    shown, ours = tuple(label for label in labels if label not in hidden), frozenset(methods["ours"]) - hidden
    run = MeasuredRun(folder, protocol, without_labels(results, hidden), shown, methods["names"], ours, notes, replicas=replicas)
    return replace(run, all_results=results) if replicas else run


def find_replicas(labels: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Label of a fitted method -> labels of the same method by other seeds.

    Examples:
        >>> find_replicas(["ours", "4dgs", "4dgs+seed=1", "4dgs+motion=linear+seed=1"])
        {'4dgs': ('4dgs+seed=1',)}
    """
    replicas: dict[str, tuple[str, ...]] = {}
    for label in labels:
        first = re.sub(r"\+seed=\d+(?=\+|$)", "", label)
        if first != label and first in labels:
            replicas[first] = (*replicas.get(first, ()), label)
    return replicas


def without_labels(results: Results, labels: Collection[str]) -> Results:
    """The results without some methods."""
    if not labels:
        return results
    own = [label_of(*names) for names in zip(results.table["method"], results.table["variant"], strict=True)]
    return replace(results, table=results.table[[label not in labels for label in own]])


def label_of(method: str, variant: str) -> str:
    """Folder name of a method and variant, as the rows of the results name them."""
    return f"{method}+{variant}" if variant else method
