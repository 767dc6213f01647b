"""Score: the 8-bit frames on disk against the captured ones, wherever they were rendered.

The metrics of all methods in one view are measured together, because what the truth alone decides
is then computed once. Values are in ``RUN/scores/<view>/<method>/<metric>``; one that is there
already, of the same frames, is not measured again.
"""

import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ggvs_eval.coverage import Coverage, read_coverage
from ggvs_eval.errors import RenderError
from ggvs_eval.finding import Finding
from ggvs_eval.jobs.engine import Workers
from ggvs_eval.jobs.machine import estimate
from ggvs_eval.merged_results import join_versions
from ggvs_eval.metrics.registry import (
    METRICS,
    derived_rows,
    metric_notes,
    pooling_records,
    select_metrics,
)
from ggvs_eval.pipelines.methods.registry import METHODS, known_method
from ggvs_eval.pipelines.methods.spec import LEARNED, OnlineMethod, digest_weights
from ggvs_eval.pipelines.methods.stage_costs import STAGES
from ggvs_eval.pipelines.run.score_view import CHECKS, ScoreTask, metric_options, score_tasks
from ggvs_eval.progress import counted, duration
from ggvs_eval.protocol import COSTLIEST, Protocol
from ggvs_eval.results import (
    Absence,
    Fault,
    Results,
    describe_machine,
    installed_versions,
    make_table,
    split_label,
    without_option,
)
from ggvs_eval.run_folder import JOB_FILE, ON_SCREEN, SCREEN_TITLE, RunFolder, read_json, write_json
from ggvs_eval.scoring import (
    QUESTIONS,
    SCORE_PARTS,
    MetricScores,
    ScoredMethod,
    ScorePart,
    ScoreRequest,
    Value,
)
from ggvs_eval.tasks.run_tasks import run_tasks
from ggvs_eval.tasks.task import Task
from ggvs_eval.tasks.task_list import TaskList

GIVEN = "weights that were given"
# labels that differ in one of these alone are a line of a figure or table
FAMILY_OPTIONS = ("scale", "steps")


def write_shown_names(run: RunFolder, protocol: Protocol, labels: Sequence[str]) -> None:
    """Write titles of methods, what differs between them by design, and notes on metrics."""
    rendered = {label: label.removesuffix(ON_SCREEN) for label in labels}
    specs = {label: spec for label, method in rendered.items() if (spec := known_method(method))}
    custom = [
        label
        for label, spec in specs.items()
        if isinstance(spec, OnlineMethod)
        and _has_given_weights(run, protocol, rendered[label], spec)
    ]
    families = {
        without_option(method, option) for method in rendered.values() for option in FAMILY_OPTIONS
    }
    titles = {family: spec.title for family in families if (spec := known_method(family))}
    titles |= {
        label: specs[label].title if label in specs else method
        for label, method in rendered.items()
    }
    titles |= {
        label: spec.title_from
        for label in custom
        if isinstance(spec := specs[label], OnlineMethod) and spec.title_from
    }
    titles |= {
        label: f"{titles[label]}{SCREEN_TITLE}" for label in labels if label.endswith(ON_SCREEN)
    }
    looks = [label for label in specs if not specs[label].online]
    write_json(
        run.root / "methods.json",
        {
            "labels": list(dict.fromkeys(rendered.values())),
            "names": titles,
            "ours": [label for label in specs if specs[label].ours],
            "from_sources": [label for label in specs if isinstance(specs[label], OnlineMethod)],
            "declared": {
                label: spec.declared | ({LEARNED: GIVEN} if label in custom else {})
                for label, spec in specs.items()
            },
            **({"look_ahead": looks} if looks else {}),
        },
    )
    notes = metric_notes(protocol.measurement.metrics, metric_options(protocol.measurement))
    write_json(run.root / "metrics.json", notes)


def _has_given_weights(run: RunFolder, protocol: Protocol, label: str, spec: OnlineMethod) -> bool:
    """Return whether renders are of a file that the user gave, and not of the weights that ship."""
    files = (run.renders(label, view) / JOB_FILE for view in protocol.views.test)
    identities = [read_json(file).get("identity", {}) for file in files if file.is_file()]
    shipped = [digest_weights(file) for file in spec.weights if file.is_file()]
    return any(identity.get("weights", shipped) != shipped for identity in identities)


TOLD_FRAMES = 10  # number to score from which a line gives the expected time
TOLD_S = 60.0  # from which the line also gives a way to shorten it
METRICS_ON_DEVICE = "metrics"  # listed with the renders that are not the CPU's


@dataclass(frozen=True)
class Scores:
    """Scores of a run: tasks, planned once, and their values when they are done.

    Attributes:
        labels: of the methods, and of the rows that parts add.
        view_tasks: of the test views.
        parts: what is scored besides, see `ScorePart`.
        device: where metrics compute that can.
    """

    run: RunFolder
    labels: tuple[str, ...]
    coverage: Coverage
    view_tasks: tuple[ScoreTask, ...]
    parts: tuple[ScorePart, ...]
    device: str

    @property
    def tasks(self) -> tuple[Task, ...]:
        """All, the longest first, so that all workers end at about the same time."""
        return (*self.view_tasks, *(task for part in self.parts for task in part.tasks))

    def time_words(self, workers: int) -> str:
        """State the expected time of the views left to score, and how to shorten it.

        Empty if seconds.
        """
        protocol = self.run.protocol()
        left = [task for task in self.view_tasks if not task.is_done()]
        labels, views = ({getattr(task, name) for task in left} for name in ("label", "view"))
        frames = len(views) * protocol.frames.count
        if frames * len(labels) < TOLD_FRAMES or self.device != "cpu":
            return ""
        seconds = estimate(left).seconds / min(workers, len(views))
        every = protocol.measurement.lpips_every
        of_lpips = (
            f"; {COSTLIEST} of {'every frame' if every == 1 else f'one frame in {every}'}"
            if COSTLIEST in protocol.measurement.metrics
            else ""
        )
        shorter = (
            f": {STAGES['scoring']} shortens it"
            if of_lpips and every == 1 and seconds >= TOLD_S
            else ""
        )
        work = (
            f"scoring {counted(frames, 'frame')} of "
            f"{'each of ' * (len(labels) > 1)}{counted(len(labels), 'method')}"
        )
        return f"{work} takes about {duration(seconds)}{of_lpips}{shorter}"

    def collect(self) -> Results:
        """Collect all values, when every job is done, into the results of the run folder."""
        results = _collect(self)
        for task in self.view_tasks:
            (task.batch / JOB_FILE).unlink(missing_ok=True)  # scores of an earlier version
        if self.device != "cpu":
            from ggvs_eval.compute_device import describe_device

            results.provenance.setdefault("devices", {})[METRICS_ON_DEVICE] = describe_device(
                self.device
            )
        results.write(self.run.root)
        references = [row for part in self.parts for row in part.references()]
        write_json(self.run.root / "references.json", references)
        for part in self.parts:
            part.write()
        write_shown_names(self.run, self.run.protocol(), self.labels)
        return results


def score(
    run: RunFolder, workers: Workers = 1, without: Collection[str] = (), device: str = "cpu"
) -> Results:
    """Measure every method that has renders in the run folder.

    Args:
        run: a folder with truth and renders of the protocol's views and frames.
        without: methods whose renders are known to be incomplete, which are left out.
        device: where metrics compute that can.

    Returns:
        All values, also written to the run folder.

    Raises:
        RenderError: no renders, missing frames (all gaps are listed) or frames of the wrong size.
    """
    scores = plan_scores(
        run, [label for label in run.labels() if label not in without], None, device
    )
    if outlook := scores.time_words(workers if isinstance(workers, int) else 1):
        print(outlook, file=sys.stderr, flush=True)
    task_list = TaskList(run.root, "score")
    task_list.write(scores.tasks)
    run_tasks(scores.tasks, workers, "scoring", task_list)
    return scores.collect()


def require_labels(run: RunFolder, labels: Sequence[str] | None = None) -> None:
    """Refuse a folder that is no run, and a run without any method."""
    run.protocol()
    if not (run.labels() if labels is None else labels):
        raise RenderError(
            f"{run.root}: nothing to score, renders/ is empty; run `ggvs-eval render` or give "
            f"--renders NAME=FOLDER"
        )


def plan_scores(
    run: RunFolder, labels: Sequence[str], units: Collection[str] | None = None, device: str = "cpu"
) -> Scores:
    """List the tasks that measure some methods.

    Args:
        units: test views, or ``path``, of which nothing may be missing; None for all.
    """
    protocol = run.protocol()
    require_labels(run, labels)
    views = [view for view in protocol.views.test if units is None or view in units]
    coverage = read_coverage(run, protocol.frames.numbers, labels)
    coverage.require(run, views, labels)
    request = ScoreRequest(
        run=run, protocol=protocol, coverage=coverage, labels=labels, views=views, units=units
    )
    parts = tuple(plan_part(request) for plan_part in SCORE_PARTS.installed().values())
    rows = {label: frames for part in parts for label, frames in part.partial.items()}
    coverage, labels = replace(coverage, partial={**coverage.partial, **rows}), (*labels, *rows)
    tasks = tuple(
        task
        for view in views
        for task in score_tasks(run, protocol, coverage, labels, view, device)
    )
    return Scores(
        run=run, labels=labels, coverage=coverage, view_tasks=tasks, parts=parts, device=device
    )


def _collect(scores: Scores) -> Results:
    """Return one tidy table of all jobs, with the metrics that are made of the values of several,
    such as SDV.
    """
    run, coverage, labels = scores.run, scores.coverage, scores.labels
    protocol, capture = run.protocol(), run.capture_record()
    questions = QUESTIONS.installed().values()
    records = _read_scores(scores)
    order = _order_of_values(protocol)
    rows: list[tuple[Any, ...]] = []
    absences: list[Absence] = []
    faults: list[Fault] = []
    for label in labels:
        head = (protocol.dataset, capture["scene"], *split_label(label))
        values: dict[str, dict[str, dict[int, float]]] = {}  # metric -> view -> frame -> value
        label_rows: list[tuple[Any, ...]] = []
        reasons: dict[str, str] = {}  # of what belongs to no single view
        findings: dict[str, list[Finding]] = {}
        is_method = not label.endswith(ON_SCREEN)
        for view in protocol.views.test:
            if why := coverage.refused.get(label, {}).get(view):
                absences += [
                    Absence(
                        metric=metric, label=label, scene=capture["scene"], view=view, reason=why
                    )
                    for metric in protocol.measurement.metrics
                ]
            metrics = records.get((label, view), {})  # partial renders may lack a view
            of_view = [value for metric in metrics.values() for value in metric.values]
            for name, frame, value in sorted(of_view, key=order):
                label_rows.append((view, frame, name, value))
                values.setdefault(name, {}).setdefault(view, {})[frame] = value
            if metrics and is_method:
                record = read_json(run.scores(view) / label / CHECKS / JOB_FILE)
                findings[view] = [Finding(**fields) for fields in record["findings"]]
            lacking = {
                name: why
                for metric in metrics.values()
                for name, why in metric.not_computed.items()
            }
            absences += [
                Absence(metric=name, label=label, scene=capture["scene"], view=view, reason=reason)
                for name, reason in lacking.items()
            ]
        method = ScoredMethod(run=run, protocol=protocol, label=label, values=values)
        for question in questions if is_method else ():
            findings = question.of_method(method, findings)
        scene = capture["scene"]
        faults += [
            _fault(label, scene, finding) for of_view in findings.values() for finding in of_view
        ]
        label_rows += _derived(protocol, values, reasons)
        for part in scores.parts:
            if part.rows is not None and is_method:
                part_rows, part_reasons = part.rows(label)
                label_rows += part_rows
                reasons |= part_reasons
        absences += [
            Absence(metric=name, label=label, scene=capture["scene"], view="", reason=reason)
            for name, reason in reasons.items()
        ]
        rows += [(*head, *row) for row in label_rows]
    digests = {f"{task.label}/{task.view}": task.inputs["rendered"] for task in scores.view_tasks}
    named = [f"{label}/{view}" for label in labels for view in protocol.views.test]
    renders = {name: digests[name] for name in named if name in digests}
    provenance = _provenance(protocol, capture, renders) | {
        "imported": coverage.imported,
        "partial": coverage.marks,
    }
    provenance["faults"] = [list(fault) for fault in faults]
    provenance["versions"] = _versions(run, list(renders), records)
    if plugins := METRICS.origins(protocol.measurement.metrics) | METHODS.origins(labels):
        provenance["plugins"] = plugins
    if devices := _devices(run, list(renders)):
        provenance["devices"] = devices
    metric_names = {row[6] for row in rows}
    provenance["absent"] = [list(absence) for absence in absences if absence.metric in metric_names]
    not_computed = {
        absence.metric: absence.reason
        for absence in reversed(absences)
        if absence.metric not in metric_names
    }
    return Results(make_table(rows), provenance, dict(reversed(not_computed.items())))


def _read_scores(scores: Scores) -> dict[tuple[str, str], dict[str, MetricScores]]:
    """Return (label, view) -> metric -> its values."""
    records: dict[tuple[str, str], dict[str, MetricScores]] = {}
    for task in scores.view_tasks:
        if not task.is_done():
            raise RenderError(
                f"{task.folder}: wanted values of {task.label}, got none; score again"
            )
        if task.metric != CHECKS:
            records.setdefault((task.label, task.view), {})[task.metric] = MetricScores.read(
                task.folder
            )
    return records


def _order_of_values(protocol: Protocol) -> Callable[[Value], tuple[Any, ...]]:
    """Return the order of a method's values in a view: by frames, what belongs to none of them
    last.
    """
    options = metric_options(protocol.measurement)
    metrics = select_metrics(protocol.measurement.metrics)
    names = dict.fromkeys(
        name for metric in metrics for name in (*metric.pooling(options).parts, metric.name)
    )
    order = {name: place for place, name in enumerate(names)}

    def place(value: Value) -> tuple[Any, ...]:
        name, frame, _ = value
        return frame < 0, frame, order.get(name, len(order)), name

    return place


def _fault(label: str, scene: str, finding: Finding) -> Fault:
    """Return a finding of the quick checks as the results keep it.

    An offset is called by its direction.
    """
    lag = finding.values.get("offset_frames", 0.0) if finding.question == "frame offset" else 0.0
    called = "late" if lag < 0 else "early" if lag > 0 else ""
    return Fault(
        label=label,
        scene=scene,
        view=finding.subject,
        question=finding.question,
        verdict=finding.verdict,
        measured=finding.measured,
        advice=finding.advice,
        called=called,
    )


def _derived(
    protocol: Protocol, values: dict[str, dict[str, dict[int, float]]], not_computed: dict[str, str]
) -> list[tuple[Any, ...]]:
    """Return the rows (view, frame, metric, value) of what is made of other metrics' values, of any
    views and frames.

    Args:
        values: metric -> view -> frame -> value.
        not_computed: takes the reason if there is none.
    """
    measurement = protocol.measurement
    rows, reasons = derived_rows(
        select_metrics(measurement.metrics), values, metric_options(measurement)
    )
    not_computed |= reasons
    return [
        (view, frame, name, value)
        for name, of_metric in rows.items()
        for view, frame, value in of_metric
    ]


def _provenance(
    protocol: Protocol, capture: dict[str, Any], renders: dict[str, str]
) -> dict[str, Any]:
    return {
        "protocol": protocol.values(),
        "protocol_sha256": protocol.sha256,
        "inputs": {
            f"{capture['scene']}/{name}": digest for name, digest in capture["digests"].items()
        },
        "renders": renders,
        "pooling": pooling_records(
            protocol.measurement.metrics, metric_options(protocol.measurement)
        ),
        "machine": describe_machine(),
    } | ({"truth": capture["truth"]} if "truth" in capture else {})


def _versions(
    run: RunFolder,
    renders: Sequence[str],
    scores: Mapping[tuple[str, str], Mapping[str, MetricScores]],
) -> dict[str, str]:
    """Return package -> versions under which these renders and their values were made, and this
    one.
    """
    versions = [record.get("versions", {}) for record in _render_records(run, renders).values()]
    versions += [
        of_metric.versions for metrics in scores.values() for of_metric in metrics.values()
    ]
    return join_versions([installed_versions(), *versions])


def _devices(run: RunFolder, renders: Sequence[str]) -> dict[str, str]:
    """``method/view`` -> where its networks computed, of renders that are not the CPU's."""
    identities = {
        render: record.get("identity", {})
        for render, record in _render_records(run, renders).items()
    }
    return {
        render: identity["device"]
        for render, identity in identities.items()
        if "device" in identity
    }


def _render_records(run: RunFolder, renders: Sequence[str]) -> dict[str, dict[str, Any]]:
    """``method/view`` -> record of its job; frames that others rendered have none."""
    files = {render: run.renders(*render.rsplit("/", 1)) / JOB_FILE for render in renders}
    return {render: read_json(file) for render, file in files.items() if file.is_file()}
