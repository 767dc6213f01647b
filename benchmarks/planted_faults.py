"""Faults of handling planted in the renders of a run against what the doctor finds.

``python -m benchmarks.planted_faults RUN [METHOD ...]``
Every method is first examined as it is, where each finding is a false alarm; then each fault is
planted in one of its views.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from ggvs_eval.pipelines.inspection.renders.examine import examine
from ggvs_eval.pipelines.inspection.renders.identity import ViewFrames, cameras_of_run, views_of_run
from ggvs_eval.run_folder import RunFolder
from ggvs_eval.scoring import FrameReader

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))  # the faults are the tests' own
from helpers.planted_renders import PLANTED, Fault  # type: ignore[import-not-found]

KEPT_FRAMES = 64


def main(arguments: Sequence[str] | None = None) -> None:
    """Print one table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("methods", nargs="*", help="all of the run by default")
    options = parser.parse_args(arguments)
    run = RunFolder(options.run)
    columns = {label: examine_method(run, label) for label in options.methods or run.labels()}
    print(f"| planted | {' | '.join(columns)} |")
    print(f"| --- | {' | '.join('---' for _ in columns)} |")
    for fault in next(iter(columns.values())):
        print(f"| {fault} | {' | '.join(column[fault] for column in columns.values())} |")


def examine_method(run: RunFolder, label: str) -> dict[str, str]:
    """Print the findings in each spoilt view of a method, and in all views as they are."""
    cameras = {name: _kept(read) for name, read in cameras_of_run(run).items()}
    views = {
        name: replace(view, rendered=_kept(view.rendered), truth=cameras[name])
        for name, view in views_of_run(run, label).items()
    }
    alarms = [f"{one.question} ({one.verdict}) in {one.subject}" for one in examine(views, cameras)]
    answers = {"nothing": ", ".join(alarms) or "nothing"}
    names = list(views)
    for number, (planted, fault) in enumerate(PLANTED.items()):
        name = names[number % len(names)]
        answers[planted] = answer({name: views[name]}, fault, cameras)
    return answers


def answer(view: Mapping[str, ViewFrames], fault: Fault, cameras: Mapping[str, FrameReader]) -> str:
    """Return the verdict on a planted fault, and what else is said."""
    findings = examine(
        {name: replace(one, rendered=_kept(fault.spoil(one))) for name, one in view.items()},
        cameras,
    )
    verdicts = [one.verdict for one in findings if one.question == fault.question]
    others = [
        f"also {one.question} ({one.verdict})" for one in findings if one.question != fault.question
    ]
    return ", ".join([verdicts[0] if verdicts else "not found", *others])


def _kept(read: FrameReader) -> FrameReader:
    return lru_cache(KEPT_FRAMES)(read)


if __name__ == "__main__":
    main()
