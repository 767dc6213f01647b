"""The metric study from top to bottom: takes of captures, every series measured, and the answer of
each metric to each ladder.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd

from ggvs_eval.contrib.study.clips import Take
from ggvs_eval.contrib.study.ladders import Ladder, select_ladders
from ggvs_eval.contrib.study.measure import series_tasks, strengths_of, study_metrics
from ggvs_eval.contrib.study.takes import StudyOptions, make_takes
from ggvs_eval.files.atomic import atomic_file
from ggvs_eval.jobs.engine import Workers
from ggvs_eval.metrics.registry import METRICS
from ggvs_eval.run_folder import JOB_FILE, read_json, write_json
from ggvs_eval.statistics.rank_correlation import answer
from ggvs_eval.tasks.run_tasks import run_tasks
from ggvs_eval.tasks.task import Task

STUDY_FILE, VALUES_FILE = "study.json", "values.csv"
COLUMNS = ("capture", "take", "seed", "ladder", "strength", "metric", "value")


def run_study(
    out: Path, captures: Sequence[Path], options: StudyOptions, workers: Workers = 1
) -> dict[str, Any]:
    """Plant degradations in clips, measure them, and write ``values.csv`` and ``study.json``.

    What is measured stays.

    Args:
        captures: see `make_takes`.

    Returns:
        What ``study.json`` holds.
    """
    metrics, ladders = study_metrics(options.metrics), select_ladders(options.ladders)
    takes = make_takes(out, captures, options, workers)
    undegraded, series, refusals = _plan(out, takes, ladders, metrics, options.seeds)
    tasks = [task for of_series in (*undegraded.values(), *series.values()) for task in of_series]
    run_tasks(tasks, workers, "metric study")
    table = _values(undegraded, series, {ladder.name: strengths_of(ladder) for ladder in ladders})
    with atomic_file(out / VALUES_FILE) as unfinished:
        table.to_csv(unfinished, index=False)
    answers = {ladder.name: _answers(table, ladder, metrics) for ladder in ladders}
    record = {
        "captures": list(dict.fromkeys(table["capture"])),
        "takes": len(takes),
        "options": asdict(options),
        "ladders": {ladder.name: _describe(ladder) for ladder in ladders},
        "metrics": {name: _direction(name) for name in metrics},
        "answers": answers,
        "not_computed": _absences(series, refusals, answers, metrics),
    }
    write_json(out / STUDY_FILE, record)
    return record


Place = tuple[str, str, int]  # ladder, take, seed


def _plan(
    out: Path, takes: Sequence[Take], ladders: Sequence[Ladder], metrics: Sequence[str], seeds: int
) -> tuple[dict[str, list[Task]], dict[Place, list[Task]], dict[str, str]]:
    """Return the tasks of the undegraded takes and of all series, and why ladders are planted in
    none.
    """
    undegraded = {take.name: series_tasks(out, take, None, 0, metrics) for take in takes}
    series: dict[Place, list[Task]] = {}
    refusals: dict[str, str] = {}
    clips = [list(take.clips()) for take in takes]
    for ladder in ladders:
        for number, take in enumerate(takes):
            if why := next(filter(None, map(ladder.refuses, clips[number])), ""):
                refusals.setdefault(ladder.name, why)
                continue
            for repeat in range(seeds):
                seed = number + repeat * len(takes)
                series[ladder.name, take.name, seed] = series_tasks(
                    out, take, ladder, seed, metrics
                )
    planted = {ladder for ladder, _, _ in series}
    return undegraded, series, {name: why for name, why in refusals.items() if name not in planted}


def _values(
    undegraded: Mapping[str, Sequence[Task]],
    series: Mapping[Place, Sequence[Task]],
    strengths: Mapping[str, Sequence[float]],
) -> pd.DataFrame:
    """Return every value, one row each, with the undegraded ones as strength 0 of every ladder."""
    rows = []
    at_rest = {take: _levels(tasks, (0.0,))[0.0] for take, tasks in undegraded.items()}
    for (name, take, seed), tasks in series.items():
        values = {0.0: at_rest[take]} | _levels(tasks, strengths[name])
        capture, _, place = take.partition(", ")
        for strength, of_metrics in values.items():
            rows += [
                (capture, place, seed, name, strength, metric, value)
                for metric, value in of_metrics.items()
            ]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _levels(tasks: Sequence[Task], strengths: Sequence[float]) -> dict[float, dict[str, float]]:
    """Return strength -> metric -> value, of those that have one."""
    levels: dict[float, dict[str, float]] = {strength: {} for strength in strengths}
    for task in tasks:
        values = read_json(task.folder / JOB_FILE)["values"]
        for strength, value in zip(strengths, values, strict=True):
            if value is not None:
                levels[strength][task.folder.name] = value
    return levels


def _answers(
    table: pd.DataFrame, ladder: Ladder, metrics: Sequence[str]
) -> dict[str, dict[str, Any]]:
    """Answers of each metric to a ladder; takes in which it has a value at every strength count.

    A metric that wants some of the degradation (`switch_ratio` wants a switch) has no value at 0,
    and answers to the rest.
    """
    answers = {}
    for metric in metrics:
        rows = table[(table["ladder"] == ladder.name) & (table["metric"] == metric)]
        sign = -1.0 if METRICS[metric].higher_is_better else 1.0
        by_strength = (
            sign
            * rows.pivot_table(
                index=["capture", "take", "seed"], columns="strength", values="value"
            ).dropna()
        )
        strengths = [float(strength) for strength in by_strength.columns]
        if by_strength.empty or len(strengths) < len(ladder.strengths):
            continue
        clips: dict[str, list[list[float]]] = {}
        for (capture, take, _), values in zip(
            by_strength.index, by_strength.to_numpy().tolist(), strict=True
        ):
            clips.setdefault(f"{capture}, {take}", []).append(values)
        result = answer(strengths, clips)
        answers[metric] = asdict(result) | {"verdict": result.verdict}
    return answers


def _absences(
    series: Mapping[Place, Sequence[Task]],
    refusals: Mapping[str, str],
    answers: Mapping[str, Mapping[str, Any]],
    metrics: Sequence[str],
) -> dict[str, dict[str, str]]:
    """Ladder -> metric that has no answer to it -> reason."""
    reasons = {
        ladder: dict.fromkeys(metrics, refusals.get(ladder, "no number in these clips"))
        for ladder in answers
    }
    for (ladder, _, _), tasks in series.items():
        for task in tasks:
            for reason in filter(None, read_json(task.folder / JOB_FILE)["not_computed"]):
                reasons[ladder][task.folder.name] = reason
    return {
        ladder: {
            metric: why
            for metric, why in of_ladder.items()
            if metric in metrics and metric not in answers[ladder]
        }
        for ladder, of_ladder in reasons.items()
    }


def _describe(ladder: Ladder) -> dict[str, Any]:
    return {"unit": ladder.unit, "strengths": list(ladder.strengths), "describe": ladder.describe}


def _direction(name: str) -> dict[str, Any]:
    metric = METRICS[name]
    return {
        "higher_is_better": metric.higher_is_better,
        "unit": metric.unit,
        "group": metric.group.title,
        "kind": metric.kind,
    }
