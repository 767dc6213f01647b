"""Paired comparison of two runs, or two methods of one run: differences, whether they are
significant, as text and CSV.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd

from ggvs_eval.errors import ResultsError
from ggvs_eval.files.atomic import write_text
from ggvs_eval.merged_results import tell_scenes_apart
from ggvs_eval.reports.model.measured import MeasuredRun, MetricNote, read_scores
from ggvs_eval.reports.model.table import format_value, signed
from ggvs_eval.reports.tables.table_formats import csv_text
from ggvs_eval.reports.tables.verdict import judge_runs
from ggvs_eval.results import Results, without_labels
from ggvs_eval.run_folder import ON_SCREEN, RunFolder
from ggvs_eval.statistics.paired import OUTCOMES, Comparison, Pair, Standings, compare, decide

SIDES = ("first", "second")
HEADS = ("metric", "view", "first", "second", "difference", "95 % interval", "p (Holm)", "verdict")


@dataclass(frozen=True)
class Side:
    """One of the two.

    Attributes:
        label: of its method, in its run.
    """

    name: str
    label: str
    results: Results

    @property
    def frames(self) -> dict[str, str]:
        """Test view -> digest of the frames; empty in results of earlier versions."""
        renders = self.results.renders
        return {
            name: digest
            for key, digest in renders.items()
            for label, _, name in [key.rpartition("/")]
            if label == self.label
        }


@dataclass(frozen=True)
class Difference:
    """One metric of two methods, over all views or in one.

    Attributes:
        view: test view; empty for the mean over all.
        first: number of the first method.
        second: of the second.
        comparison: first minus second, decided together with those in the other metrics, or in the
            other views of one metric.
        set_aside: why either may not be ranked, in words; empty if both may.
        names: what its verdict calls the two.
    """

    note: MetricNote
    view: str
    first: float
    second: float
    comparison: Comparison
    set_aside: str = ""
    names: tuple[str, str] = SIDES

    @property
    def metric(self) -> str:
        """Name of the metric."""
        return self.note.name

    @property
    def is_significant(self) -> bool:
        """True if one is judged better than the other."""
        return not self.set_aside and self.comparison.outcome in ("better", "worse")

    @property
    def verdict(self) -> str:
        """The better method and whether that is more than chance, in words."""
        outcome = self.comparison.outcome
        if self.set_aside:
            return f"not compared: {self.set_aside}"
        ahead = self.names[(self.comparison.difference > 0) != self.note.higher_is_better]
        if self.is_significant:
            return f"{ahead} better"
        if outcome == "untested":
            return f"{ahead} ahead, not tested: {self.comparison.note}"
        return (
            f"{ahead} ahead, {self.comparison.short}"
            if outcome == "too short"
            else OUTCOMES[outcome]
        )


def method_sides(run: Path, first: str, second: str) -> tuple[Side, Side]:
    """Return two methods of one run."""
    results = Results.read(run)
    names = RunFolder(run).shown_names
    for label in (first, second):
        if label not in _labels(results):
            raise ResultsError(
                f"{run}: no values of method {label!r}; it has {', '.join(_labels(results))}"
            )
    if first == second:
        raise ResultsError(f"{run}: wanted two methods, got {first} twice")
    kinds = {label.endswith(ON_SCREEN) for label in (first, second)}  # as in their table
    results = without_labels(
        results, [label for label in _labels(results) if label.endswith(ON_SCREEN) not in kinds]
    )
    first_side, second_side = (
        Side(names.get(label, label), label, results) for label in (first, second)
    )
    return first_side, second_side


def run_sides(first: Path, second: Path) -> tuple[tuple[Side, Side], ...]:
    """Return every method that two runs share.

    Raises:
        ResultsError: not scored runs, different protocols or captured frames, or no method in
            common.
    """
    results = [Results.read(first), Results.read(second)]
    renamed = tell_scenes_apart(results)
    # one scene may be in folders of two names
    results = renamed if renamed[0].scenes == renamed[1].scenes else results
    _require_alike(first, second, *results)
    names = RunFolder(first).shown_names
    labels = _labels(results[0]), _labels(results[1])
    shared = [label for label in labels[0] if label in labels[1]]
    if not shared:
        raise ResultsError(
            f"{first} has {', '.join(labels[0])}, {second} {', '.join(labels[1])}: no method in "
            f"common to compare"
        )
    return tuple(
        (Side(names.get(label, label), label, results[0]), Side(str(second), label, results[1]))
        for label in shared
    )


def differences(first: Side, second: Side, run: Path) -> tuple[Difference, ...]:
    """Return every metric that both have, see `compare_pairs`."""
    return compare_pairs({"": (first, second)}, run)[""]


def compare_pairs(
    pairs: Mapping[str, tuple[Side, Side]],
    run: Path,
    names: Mapping[str, tuple[str, str]] | None = None,
) -> dict[str, tuple[Difference, ...]]:
    """Compare pairs in every metric that both sides have: over all views, and below it in each
    view.

    Args:
        pairs: name of a pair -> its first and second side.
        run: folder whose metrics are compared.
        names: name of a pair -> what verdicts call its sides; `SIDES` by default.

    Reading:
        Two methods of one run are judged as its tables judge them. Means of different runs are one
        family, over all pairs and metrics; single views are another.
    """
    compared: dict[tuple[str, int], Difference] = {}
    for name, sides in pairs.items():
        rows = _compare_sides(*sides, run, (names or {}).get(name, SIDES))
        compared |= {(name, at): row for at, row in enumerate(rows)}
    for is_of_view in (False, True):
        undecided = {
            place: row.comparison
            for place, row in compared.items()
            if bool(row.view) == is_of_view and row.comparison.corrected is None
        }
        for place, comparison in decide(undecided).items():
            compared[place] = replace(compared[place], comparison=comparison)
    return {
        name: tuple(row for place, row in compared.items() if place[0] == name) for name in pairs
    }


def _compare_sides(
    first_side: Side, second_side: Side, run: Path, names: tuple[str, str]
) -> list[Difference]:
    """Return the differences of two sides: those that the tables of a run have decided, and others
    that nobody has yet.
    """
    run_read, is_one_run = read_scores(run), first_side.results is second_side.results
    parts = [
        _renamed(side, name) for side, name in zip((first_side, second_side), SIDES, strict=True)
    ]
    joined = replace(first_side.results, table=pd.concat(parts, ignore_index=True))
    dataset, labels = (
        str(joined.table["dataset"].iloc[0]),
        (first_side.label, second_side.label) if is_one_run else SIDES,
    )
    standings = _standings(run_read, first_side.results if is_one_run else joined, labels, dataset)
    set_aside = _named(
        names, [side.results.set_aside.get(side.label) for side in (first_side, second_side)]
    )
    if not set_aside and first_side.frames and first_side.frames == second_side.frames:
        set_aside = f"{names[0]} and {names[1]} are the same frames, byte by byte"
    means = joined.summary().loc[dataset]
    notes = [
        note
        for metric, note in run_read.metrics.items()
        if joined.table[joined.table["metric"] == metric]["method"].nunique() == len(SIDES)
    ]
    pairs = [Pair(note.name, *labels) for note in notes]
    decided = standings.decide(pairs) if is_one_run else {}  # all metrics of the two together
    rows: list[Difference] = []
    for note, pair in zip(notes, pairs, strict=True):
        unranked = (
            standings.judgements[note.name].unranked if note.name in standings.judgements else {}
        )
        comparison = decided.get(pair) or compare(
            joined, note.name, *SIDES, dataset, note.higher_is_better
        )
        first, second = (float(means[note.name][side, ""]) for side in SIDES)
        why = set_aside or _named(names, map(unranked.get, labels))
        rows.append(
            Difference(
                note=note,
                view="",
                first=first,
                second=second,
                comparison=comparison,
                set_aside=why,
                names=names,
            )
        )
        rows += [
            replace(row, set_aside=why, names=names) for row in _per_view(joined, dataset, note)
        ]
    return rows


def _standings(
    run: MeasuredRun, results: Results, labels: Collection[str], dataset: str
) -> Standings:
    """Return the judgements of the table that two methods are in.

    Those of different runs are in none but their own.
    """
    labels_shown = {*run.labels}
    if {*labels} <= labels_shown:
        return judge_runs([run], without_labels(results, {*results.row_labels} - labels_shown))[
            dataset
        ]
    return judge_runs([replace(run, ours=run.ours & {*results.row_labels})], results)[dataset]


def _named(names: Sequence[str], reasons: Iterable[str | None]) -> str:
    return "; ".join(
        f"{name} {reason}" for name, reason in zip(names, reasons, strict=True) if reason
    )


def _per_view(results: Results, dataset: str, note: MetricNote) -> list[Difference]:
    """Return the same in each test view alone, undecided.

    Nothing for what belongs to the whole rig or to the camera path.
    """
    means = results.per_view(note.name)
    test_views = results.protocol_values.get("views", {}).get("test", means.columns)
    rows = []
    for view in test_views:
        if view in means.columns:
            # The values of one view as if it were the whole rig, so that what is drawn anew is time
            # alone.
            alone = replace(
                results, table=results.table[results.table["view"] == view].assign(view=None)
            )
            comparison = compare(alone, note.name, *SIDES, dataset, note.higher_is_better)
            first, second = means[view].loc[[(side, "") for side in SIDES]].astype(float)
            rows.append(
                Difference(
                    note=note, view=str(view), first=first, second=second, comparison=comparison
                )
            )
    return rows


def what_else_differs(first: Path, second: Path) -> list[str]:
    """Versions, methods and frames that differ between two runs, one line each."""
    first_results, second_results = Results.read(first), Results.read(second)
    versions = _unequal(first_results.versions, second_results.versions)
    lines = [f"version of {name}: {a} in {first}, {b} in {second}" for name, a, b in versions]
    renders = first_results.renders, second_results.renders
    shared = [name for name in renders[0] if name in renders[1]]
    equal_names = [name for name in shared if renders[0][name] == renders[1][name]]
    lines += [f"equal frames: {', '.join(equal_names)}"] if equal_names else []
    labels = _labels(first_results), _labels(second_results)
    alone = [(first, set(labels[0]) - set(labels[1])), (second, set(labels[1]) - set(labels[0]))]
    return lines + [
        f"only in {run}: {', '.join(sorted(labels_alone))}"
        for run, labels_alone in alone
        if labels_alone
    ]


def _renamed(side: Side, name: str) -> pd.DataFrame:
    mask = [label == side.label for label in side.results.row_labels]
    return side.results.table[mask].assign(method=name, variant="")


def _labels(results: Results) -> list[str]:
    return list(dict.fromkeys(results.row_labels))


def _require_alike(
    first: Path, second: Path, first_results: Results, second_results: Results
) -> None:
    """Refuse runs whose numbers do not answer the same question."""
    hashes = first_results.protocol_sha256, second_results.protocol_sha256
    if hashes[0] != hashes[1]:
        terms = _flat(first_results.protocol_values), _flat(second_results.protocol_values)
        terms_text = "; ".join(f"{name} {a} and {b}" for name, a, b in _unequal(*terms))
        raise ResultsError(
            f"{first} and {second} were measured under different protocols ({hashes[0][:12]}, "
            f"{hashes[1][:12]}): {terms_text or 'their values are not recorded'}; score both under "
            "one"
        )
    inputs = [name for name, _, _ in _unequal(first_results.inputs, second_results.inputs)]
    if inputs:
        raise ResultsError(
            f"{first} and {second} are not of the same captured frames: {', '.join(inputs)}"
        )


def _unequal(first: Mapping[str, Any], second: Mapping[str, Any]) -> list[tuple[str, Any, Any]]:
    names = dict.fromkeys([*first, *second])
    return [
        (name, first.get(name, "none"), second.get(name, "none"))
        for name in names
        if first.get(name) != second.get(name)
    ]


def _flat(values: Mapping[str, Any], above: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in values.items():
        flat |= (
            _flat(value, f"{above}{name}.")
            if isinstance(value, dict)
            else {f"{above}{name}": value}
        )
    return flat


def differences_text(differences: Sequence[Difference]) -> str:
    """Columns under each other; a line per metric, and per view where asked for.

    All p values after Holm's correction.
    """
    rows = [HEADS, *map(cells_of, differences)]
    widths = [max(len(row[at]) for row in rows) for at in range(len(HEADS))]
    lines = [
        "  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
    conditions: dict[str, list[str]] = {}
    for row in differences:
        if row.comparison.p_value is not None and not row.view and row.comparison.note:
            conditions.setdefault(row.comparison.note, []).append(row.metric)
    notes = [
        f"Intervals of the means of {', '.join(metrics)}: {note}."
        for note, metrics in conditions.items()
    ]
    return "\n".join(
        [
            *lines,
            *notes,
            *(
                ["Intervals of single views: given the view."]
                if any(row.view for row in differences)
                else []
            ),
        ]
    )


def differences_csv(
    differences: Mapping[str, Sequence[Difference]], sides: Sequence[str] = SIDES
) -> str:
    """Return one line per pair of methods, metric and view, numbers unrounded.

    Args:
        sides: heads of the columns of the two numbers.
    """
    head = ["method", "metric", "unit", "view", *sides, "difference"]
    head += ["lo", "hi", "p_value", "significant", "verdict", "given"]
    rows: list[list[object]] = []
    for name, several in differences.items():
        for row in several:
            comparison = row.comparison
            bounds = (comparison.low, comparison.high, comparison.corrected)
            numbers = [repr(value) for value in (row.first, row.second, comparison.difference)]
            numbers += ["" if value is None else repr(value) for value in bounds]
            words = [row.is_significant, row.verdict, comparison.note]
            rows.append([name, row.metric, row.note.unit, row.view, *numbers, *words])
    return csv_text(head, rows)


def write_comparison(
    first: str, second: str, run: Path | None, views: bool = False, out: Path | None = None
) -> str:
    """Compare two runs, or two methods of one.

    Raises:
        ResultsError: different protocols or captured frames, no such run or method, or nothing in
            common.
    """
    if run is None and not all(
        RunFolder(Path(root)).protocol_file.is_file() for root in (first, second)
    ):
        raise ResultsError(
            f"wanted two run folders, got {first} and {second}; for methods of one run add --run "
            f"RUN, for renders --capture DIR"
        )
    pairs = (
        run_sides(Path(first), Path(second)) if run is None else (method_sides(run, first, second),)
    )
    notes = what_else_differs(Path(first), Path(second)) if run is None else []
    named = {
        left.name if run is None else f"{left.name} against {right.name}": (left, right)
        for left, right in pairs
    }
    by_pair = compare_pairs(named, run or Path(first))
    if out is not None:
        write_text(out, differences_csv(by_pair))
    parts = [
        f"{name}\n{differences_text([row for row in rows if views or not row.view])}"
        for name, rows in by_pair.items()
    ]
    return "\n\n".join([f"first: {first}, second: {second}", *notes, *parts])


def cells_of(row: Difference) -> tuple[str, ...]:
    """Return what the columns `HEADS` say."""
    low, high = row.comparison.low, row.comparison.high
    numbers = [format_value(value, row.note.decimals) for value in (row.first, row.second)]
    digits = row.note.decimals
    interval = (
        "none"
        if low is None or high is None
        else f"{signed(low, digits)} to {signed(high, digits)}"
    )
    corrected = row.comparison.corrected
    p_value = (
        "none" if corrected is None else "< 0.0001" if corrected < 0.0001 else f"{corrected:.4f}"
    )
    name = f"{row.metric} ({row.note.unit})" if row.note.unit else row.metric
    return (
        name,
        row.view or "all",
        *numbers,
        signed(row.comparison.difference, digits),
        interval,
        p_value,
        row.verdict,
    )
