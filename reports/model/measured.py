"""A scored run folder as the reports see it: methods, names to show, and the meaning of each
number.

The score step writes the description of each metric into the run folder, so that reports import no
metric.
"""

import dataclasses
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import pandas as pd

from ggvs_eval.capture import Calibration
from ggvs_eval.coverage import read_coverage, read_import
from ggvs_eval.datasets.assemble import listed
from ggvs_eval.datasets.units import DEMO_NOTES
from ggvs_eval.errors import ResultsError
from ggvs_eval.finding import SEVERITY, Finding
from ggvs_eval.merged_results import tell_scenes_apart, with_scenes
from ggvs_eval.protocol import Protocol
from ggvs_eval.reports.model.table import DASH, Cell, Row, RowKind, format_value
from ggvs_eval.results import Results, label_of, without_labels, without_option
from ggvs_eval.run_folder import ON_SCREEN, RunFolder, read_json, require_frames

METRICS_FILE = "metrics.json"
SWEEP_FILE = "sweep.csv"
MEAN_OF_CAPTURES = "mean"  # of the table of a sweep
FURTHER = "further"  # group of the metrics that belong to no other
REFERENCES_FILE = "references.json"
METHODS_FILE = "methods.json"
FAULTY = " (faulty)"  # behind the name of a method whose renders have a certain fault
# behind the name of a method that was measured against the truth that came with its renders
OWN_TRUTH = " (own truth)"
# behind the name of renders made elsewhere, where the run's own have refined cameras
OTHER_CAMERAS = " (other cameras)"
PARTIAL = " (partial)"  # behind the name of a method whose renders lack views or frames


@dataclass(frozen=True)
class MetricNote:
    """A metric as a report knows it.

    Attributes:
        unit: e.g. ``dB``; empty if there is none.
        group: short name of its table.
        group_title: heading of that table.
        decimals: digits after the point; None for four significant ones.
    """

    name: str
    unit: str
    higher_is_better: bool
    describe: str
    reference: str
    group: str
    group_title: str
    decimals: int | None

    @property
    def arrow(self) -> str:
        """Direction in which it gets better."""
        return "↑" if self.higher_is_better else "↓"


def read_metric_notes(run: Path) -> dict[str, MetricNote]:
    """Return metric -> its note, in the order in which the protocol names them."""
    fields = {field.name for field in dataclasses.fields(MetricNote)} - {"name"}
    records = read_json(run / METRICS_FILE)
    for name, record in records.items():
        if set(record) != fields:
            raise ResultsError(
                f"{run / METRICS_FILE}: wanted {', '.join(sorted(fields))} of {name}, got "
                f"{', '.join(sorted(record))}; run `ggvs-eval score {run}` again"
            )
    return {name: MetricNote(name, **record) for name, record in records.items()}


def note_groups(notes: Sequence[MetricNote]) -> dict[str, tuple[MetricNote, ...]]:
    """Short name of a table -> the metrics that are its columns, in the order in which they are
    given; ``further`` comes last.
    """
    # stable
    keys = sorted(dict.fromkeys(note.group for note in notes), key=lambda key: key == FURTHER)
    return {key: tuple(note for note in notes if note.group == key) for key in keys}


@dataclass(frozen=True)
class Reference:
    """Values that were computed on this capture but belong to no method.

    Attributes:
        group: table it belongs to, e.g. ``consistency``.
        note: how it was made, one sentence.
        values: metric -> value, or the reason why there is none.
        bounds: metric -> ``at most`` or ``at least`` where its value is a bound.
    """

    group: str
    name: str
    note: str
    values: Mapping[str, float | str]
    bounds: Mapping[str, str] = field(default_factory=dict)


def reference_rows(
    references: Sequence[Reference], group: str, notes: Sequence[MetricNote]
) -> tuple[Row, ...]:
    """Return the rows of one table.

    A reference without a number in it is left out, see `reference_remarks`.
    """
    return tuple(
        Row(reference.name, tuple(_cell(note, reference) for note in notes), "reference")
        for reference in references
        if reference.group == group
        and any(isinstance(reference.values.get(note.name), float | int) for note in notes)
    )


def reference_remarks(
    references: Sequence[Reference], group: str, notes: Sequence[MetricNote]
) -> list[str]:
    """List the notes below a table: what each row is, and once for all that lack the same why they
    have no number.
    """
    group_references, remarks = (
        [reference for reference in references if reference.group == group],
        [],
    )
    absent: dict[str, tuple[list[str], list[str]]] = {}
    for reference in group_references:
        values = {note.name: reference.values.get(note.name) for note in notes}
        if any(isinstance(value, float | int) for value in values.values()):
            remarks.append(f"{reference.name}: {reference.note}")
        for metric, reason in values.items():
            if isinstance(reason, str):
                names, metrics = absent.setdefault(reason, ([], []))
                names.append(reference.name)
                metrics.append(metric)
    for reason, (names, metrics) in absent.items():
        remarks.append(
            f"Not computed for {', '.join(dict.fromkeys(metrics))}: "
            f"{', '.join(dict.fromkeys(names))} ({reason})."
        )
    return list(dict.fromkeys(remarks))


def limit_by_cameras(runs: Sequence["MeasuredRun"]) -> str:
    """Return a sentence on given cameras that contradict the pictures; empty if none do."""
    limited = [run for run in runs if run.calibration and run.calibration.limits_methods]
    if not limited:
        return ""
    scenes = listed(
        f"{run.scene} ({run.calibration.given_px:.1f} px)" for run in limited if run.calibration
    )
    return (
        f"Poses limit all methods by their epipolar error in {scenes}: refine them in a new run "
        "(--calibration compare); the order of methods is decided by poses."
    )


def shared_references(runs: Sequence["MeasuredRun"]) -> tuple[Reference, ...]:
    """Return the references of a table over several runs: means over the scenes, as its other
    numbers are.
    """
    scenes = dict.fromkeys(run.scene for run in runs)
    by_name: dict[tuple[str, str], dict[str, Reference]] = {}
    for run in runs:
        for reference in run.references:
            by_name.setdefault((reference.group, reference.name), {}).setdefault(
                run.scene, reference
            )
    return tuple(_mean_reference(by_scene, scenes) for by_scene in by_name.values())


def captured_values(references: Sequence[Reference]) -> dict[str, float]:
    """Return the scores of the captured images along the camera path; empty if there are none."""
    along = [reference for reference in references if reference.group == "path"]
    return {
        metric: value
        for reference in along
        for metric, value in reference.values.items()
        if isinstance(value, float | int)
    }


def _mean_reference(by_scene: Mapping[str, Reference], scenes: Collection[str]) -> Reference:
    """Return one reference over all scenes.

    A metric that any of them lacks has the reason instead of a value.
    """
    first = next(iter(by_scene.values()))
    if len(scenes) == 1:
        return first
    values: dict[str, float | str] = {}
    for metric in dict.fromkeys(
        metric for reference in by_scene.values() for metric in reference.values
    ):
        cells = {
            scene: by_scene[scene].values.get(metric) if scene in by_scene else None
            for scene in scenes
        }
        numbers = [value for value in cells.values() if isinstance(value, float | int)]
        lacking = [
            f"{scene}: {value or 'not computed'}"
            for scene, value in cells.items()
            if not isinstance(value, float | int)
        ]
        values[metric] = lacking[0] if lacking else sum(numbers) / len(numbers)
    sides = {side for reference in by_scene.values() for side in reference.bounds.items()}
    unlike = {
        metric for metric, side in sides if (metric, "at most") in sides and side != "at most"
    }
    values |= dict.fromkeys(unlike, "a bound from above in one scene and from below in another")
    return replace(first, values=values, bounds=dict(sides))


def _cell(note: MetricNote, reference: Reference) -> Cell:
    value = reference.values.get(note.name)
    if value is None:
        return Cell(DASH, note="no such reference")
    if isinstance(value, str):
        return Cell("not computed", note=value)
    return Cell(
        format_value(value, note.decimals), value, bound=reference.bounds.get(note.name, "")
    )


@dataclass(frozen=True, eq=False)  # so that what was read of a run can be kept by the run
class MeasuredRun:
    """One run folder that was rendered and scored.

    Attributes:
        labels: folder names of the methods, in the order in which they were asked for.
        names: label -> name to show.
        ours: labels of the paper's method and its variants.
        metrics: metric -> its note.
        references: grey rows that belong to no method.
        replicas: label of a fitted method -> labels of the same by other seeds, which are in no
            table but that of the spread.
        all_results: what came out, with these and the rows of screens; None if there are neither.
        from_sources: labels of the methods that render each instant from the source views of the
            protocol; others are fitted to more, or it is unknown.
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
    from_sources: frozenset[str] = frozenset()

    @property
    def scene(self) -> str:
        """Name of the captured scene."""
        return ", ".join(self.results.scenes)

    @property
    def capture(self) -> dict[str, Any]:
        """Record of the capture; empty in a folder of numbers alone."""
        return self.folder.capture_record() if self.folder.has_capture_record else {}

    @cached_property
    def open_findings(self) -> tuple[Finding, ...] | None:
        """Findings of `check` that call for an action, one subject for all with the same.

        None if the capture was not checked.
        """
        if not self.folder.check_record.is_file():
            return None
        alike: dict[tuple[str, str], list[Finding]] = {}
        for record in read_json(self.folder.check_record)["findings"]:
            finding = Finding(**record)
            if finding.verdict != "ok" and finding.advice:
                alike.setdefault((finding.question, finding.measured), []).append(finding)
        groups = [
            replace(group[0], subject=", ".join(finding.subject for finding in group))
            for group in alike.values()
        ]
        return tuple(sorted(groups, key=lambda finding: -SEVERITY[finding.verdict]))

    @cached_property
    def calibration(self) -> Calibration | None:
        """What is known of the cameras of its methods.

        None if they were used as given, and not examined.
        """
        record = self.capture.get("calibration")
        return Calibration(**record) if record else None

    @property
    def is_demo(self) -> bool:
        """Return whether ``ggvs-eval demo`` wrote a capture, in any layout and under any name."""
        return self.capture.get("units_origin") == DEMO_NOTES

    @property
    def title(self) -> str:
        """Title by which a reader knows the scene.

        Reading:
            A demo capture is called like its folder or file (``demo-capture``, ``scene000``), which
            says nothing to a reader; its data set's name does.
        """
        return self.protocol.dataset if self.is_demo else self.scene

    @property
    def has_own_truth(self) -> bool:
        """True if the truth came with the renders and no capture was read."""
        return "truth" in self.results.provenance

    @property
    def sources_text(self) -> str:
        """Terms in short: whose the truth is, or the number of source views.

        Empty where no method is known to have used them.
        """
        k = "" if self.from_sources.isdisjoint(self.labels) else f"K = {self.protocol.synthesis.k}"
        return "own truth" if self.has_own_truth else k

    @property
    def frames(self) -> range:
        """Numbers of the synthesised frames."""
        return self.protocol.frames.numbers

    @property
    def partial(self) -> Mapping[str, str]:
        """Methods whose renders lack views or frames -> what their numbers are based on."""
        return self.results.partial

    @property
    def pictured(self) -> tuple[str, ...]:
        """Labels of the methods that have every frame, which alone can be compared in pictures."""
        return tuple(label for label in self.labels if label not in self.partial)

    @property
    def ours_first(self) -> tuple[str, ...]:
        """The same, as one method is shown: the paper's first, then its variants.

        Last what is at fault.
        """
        paper, bad = self.ours, self.results.spoilt
        return tuple(
            sorted(
                self.pictured,
                key=lambda label: (
                    label in bad,
                    label not in paper,
                    label in paper and "+" in label,
                ),
            )
        )

    def called(self, scene: str) -> "MeasuredRun":
        """Return the same run with another name of its scene."""
        if self.results.scenes == (scene,):
            return self
        names = dict.fromkeys(self.results.scenes, scene)
        everything = None if self.all_results is None else with_scenes(self.all_results, names)
        return replace(self, results=with_scenes(self.results, names), all_results=everything)

    def name(self, label: str) -> str:
        """Name of a method to show.

        ``truth`` has one too, and renders that are partial or have a certain fault say so.
        """
        name = (
            "Truth"
            if label == "truth"
            else f"{self.names.get(label, label)}{OWN_TRUTH if self.has_own_truth else ''}"
        )
        if (
            self.calibration
            and self.calibration.cameras == "refined"
            and read_import(self.folder, label) is not None
        ):
            name += OTHER_CAMERAS
        if label in self.partial:
            return name + PARTIAL
        return name + FAULTY if label in self.results.spoilt else name

    def row(self, label: str, cells: Sequence[Cell], results: Results | None = None) -> Row:
        """A method's row of a table, of the kind that its name says too.

        `results` are those of a table of several runs.
        """
        marks = self.results if results is None else results
        usual: RowKind = "ours" if label in self.ours else "measured"
        partial = label in marks.partial
        kind: RowKind = "partial" if partial else "faulty" if label in marks.spoilt else usual
        return Row(name=self.name(label), cells=tuple(cells), kind=kind, label=label)

    def frame_folders(self, view: str) -> dict[str, Path]:
        """Folder of the captured frames of a view (key ``truth``, first) and of every method's that
        has all of them.
        """
        return {"truth": self.folder.truth(view)} | {
            label: self.folder.renders(label, view) for label in self.pictured
        }

    def per_frame(self, metric: str, view: str) -> dict[str, "pd.Series[float]"]:
        """Return label -> values of a metric in one view, by frame."""
        table = self.results.per_frame(metric, view)
        return {label_of(*cast(tuple[str, str], names)): table[names] for names in table.columns}

    def path_folders(self, labels: Iterable[str]) -> tuple[dict[str, Path], int]:
        """Find the frames along the camera path: the folders of the truth and of methods, and the
        number of poses.

        Args:
            labels: the methods; those without a path are left out.

        Returns:
            Label -> folder, and the number of poses, 0 if the run has no path.
        """
        counts = {
            label: len(list(self.folder.path(label).glob("*.png"))) for label in ("truth", *labels)
        }
        # none of a path that was refused
        folders = {label: self.folder.path(label) for label, count in counts.items() if count}
        n_poses = max(counts.values())
        require_frames(
            {f"{self.name(label)} on the path": folder for label, folder in folders.items()},
            range(n_poses),
        )
        return folders, n_poses


def read_run(root: Path) -> MeasuredRun:
    """Read everything that a report says about a run, except its frames, which are only checked to
    be there.

    Raises:
        ResultsError: not a run folder, not scored, or scored under another protocol than the one
            that is in it.
        RenderError: frames are missing.
    """
    run = read_scores(root)
    folder = run.folder
    if not folder.labels():
        raise ResultsError(
            f"{folder.root}: no frames under renders/ to report on; run `ggvs-eval render` again"
        )
    hidden = {
        label for labels_of_seeds in run.replicas.values() for label in labels_of_seeds
    } | _left_out(run)
    labels = tuple(label for label in folder.labels() if label not in hidden)
    run = replace(run, labels=labels)
    for view in run.protocol.views.test:
        named = {
            f"{run.name(label)} in {view}": path for label, path in run.frame_folders(view).items()
        }
        require_frames(named, run.frames)
    return run


def _left_out(run: MeasuredRun) -> set[str]:
    """Return the methods that were never scored and do not have every frame: unfinished, partial,
    or refused in a view.
    """
    unscored = [label for label in run.folder.labels() if label not in run.labels]
    if not unscored:
        return set()
    coverage = read_coverage(run.folder, run.frames, unscored)
    return {*coverage.partial} | coverage.unfinished(run.folder, run.protocol.views.test, unscored)


def read_scores(root: Path) -> MeasuredRun:
    """Read the numbers of a run: its methods are those in the results, and no frame is looked for.

    Raises:
        ResultsError: not a run folder, not scored, or scored under another protocol than the one
            that is in it.
    """
    folder = RunFolder(Path(root))
    protocol, results = folder.protocol(), Results.read(folder.root)
    if results.protocol_sha256 != protocol.sha256:
        raise ResultsError(
            f"{folder.root}: results were measured under protocol {results.protocol_sha256[:12]}, "
            f"protocol.toml is {protocol.sha256[:12]}; run `ggvs-eval score` again"
        )
    rows = dict.fromkeys(results.row_labels)
    labels = tuple(label for label in rows if not label.endswith(ON_SCREEN))
    methods = read_json(folder.root / METHODS_FILE)
    notes = read_metric_notes(folder.root)
    replicas = find_replicas(labels)
    hidden = {label for labels_of_seeds in replicas.values() for label in labels_of_seeds}
    visible, own_labels = (
        tuple(label for label in labels if label not in hidden),
        frozenset(methods["ours"]) - hidden,
    )
    results_shown = without_labels(results, rows.keys() - visible)
    everything = None if results_shown is results else results
    # which runs of earlier versions do not say
    sources = frozenset(methods.get("from_sources", ()))
    references = (
        read_json(folder.root / REFERENCES_FILE)
        if (folder.root / REFERENCES_FILE).is_file()
        else []
    )
    return MeasuredRun(
        folder=folder,
        protocol=protocol,
        results=results_shown,
        labels=visible,
        names=methods["names"],
        ours=own_labels,
        metrics=notes,
        references=tuple(Reference(**reference) for reference in references),
        replicas=replicas,
        all_results=everything,
        from_sources=sources,
    )


def is_sweep(root: Path) -> bool:
    """Return whether a folder holds a sweep and its table, and is not a run itself."""
    return (root / SWEEP_FILE).is_file() and not RunFolder(root).protocol_file.is_file()


def sweep_runs(sweep: Path) -> list[Path]:
    """Return the run folders of a sweep that its table has lines of, in their order there."""
    table = pd.read_csv(sweep / SWEEP_FILE, dtype={"capture": str, "variant": str}).fillna(
        {"capture": ""}
    )
    if "capture" not in table:
        return [sweep / variant for variant in dict.fromkeys(table["variant"])]
    names = dict.fromkeys(zip(table["capture"], table["variant"], strict=True))
    return [sweep / capture / variant for capture, variant in names if capture != MEAN_OF_CAPTURES]


def name_scenes(runs: Sequence[MeasuredRun]) -> list[MeasuredRun]:
    """Return the runs with one name for each scene that was captured, see
    `ggvs_eval.merged_results.tell_scenes_apart`.
    """
    named_results = tell_scenes_apart([run.results for run in runs])
    return [
        run.called(", ".join(results.scenes))
        for run, results in zip(runs, named_results, strict=True)
    ]


def find_replicas(labels: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return the label of a fitted method -> labels of the same method by other seeds.

    Examples:
        >>> find_replicas(["ours", "4dgs", "4dgs+seed=1", "4dgs+motion=linear+seed=1"])
        {'4dgs': ('4dgs+seed=1',)}
    """
    replicas: dict[str, tuple[str, ...]] = {}
    for label in labels:
        first = without_option(label, "seed")
        if first != label and first in labels:
            replicas[first] = (*replicas.get(first, ()), label)
    return replicas


def distinct_names(roots: Sequence[Path]) -> list[str]:
    """Return the names of folders by the ends of their paths, as long as needed to distinguish all.

    Examples:
        >>> distinct_names([Path("a/run"), Path("b/run"), Path("b/other")])
        ['a/run', 'b/run', 'b/other']
        >>> distinct_names([Path("a/run"), Path("b/other")])
        ['run', 'other']
    """
    parts = [root.resolve().parts for root in roots]
    lengths = range(1, max(map(len, parts), default=1) + 1)
    ends = ([Path(*path_parts[-length:]).as_posix() for path_parts in parts] for length in lengths)
    return next(
        (names for names in ends if len(set(names)) == len(set(parts))),
        [root.as_posix() for root in roots],
    )
