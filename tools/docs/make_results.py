"""Measure what is older than the code, and write its tables: ``make results`` (``ONLY=name,name``,
``PLAN=1``, ``DATA=folder``).

What is killed goes on where it was; what is done is not done again. Each measurement has a log in
out/results/, and progress.log there says when which began and ended.
"""

import argparse
import os
import shlex
import subprocess
import sys
import time
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

import fill_tables
from result_plan import MEASUREMENTS, RECORDS, ROOT, Measurement

from ggvs_eval.run_folder import write_json

INPUTS = ROOT.parent / "shared"  # where real captures and published weights may lie


def main() -> int:
    """Print the plan, then carry it out; ends with 1 where something failed."""
    arguments = _arguments()
    chosen = [MEASUREMENTS[name] for name in arguments.only] or list(MEASUREMENTS.values())
    stale = [
        each for each in in_order(chosen) if state(each, arguments.data) in ("stale", "never made")
    ]
    print(plan_table(in_order(chosen), arguments.data))
    print(f"\n{len(stale)} to make, some {sum(each.minutes for each in stale)} minutes")
    if arguments.plan:
        return 0
    RECORDS.mkdir(parents=True, exist_ok=True)
    failed = [each.name for each in stale if not make(each, arguments.data, arguments.weights)]
    if failed:
        print(
            f"failed: {', '.join(failed)}; their logs are in {RECORDS}, run this again to resume",
            file=sys.stderr,
        )
    return int(bool(failed))


def in_order(measurements: Sequence[Measurement]) -> list[Measurement]:
    """Those whose table in a page is older than the code first, the cheapest first.

    What others read stays before them.
    """
    older = {table.measurement for table in fill_tables.older_tables()}
    return sorted(
        measurements,
        key=lambda each: (
            each.name not in ("demo", "refined_capture"),
            each.name not in older,
            each.minutes,
        ),
    )


def state(measurement: Measurement, data: Path) -> str:
    """A word for the plan."""
    if not measurement.commands:
        return "by hand"
    if lacking := measurement.lacking(data):
        return f"no {', '.join(lacking)} in {data}; give DATA=folder"
    if not measurement.made_from:
        return "never made"
    return "of today" if measurement.made_from == measurement.identity else "stale"


def plan_table(measurements: Sequence[Measurement], data: Path) -> str:
    """Name, state, expected minutes and tables of each measurement, as text."""
    tables = fill_tables.tables_by_measurement()
    lines = [f"{'measurement':28} {'minutes':>7}  {'here':12} fills"]
    for each in measurements:
        fills = ", ".join(f"{table.page.name}#{table.name}" for table in tables.get(each.name, ()))
        lines.append(f"{each.name:28} {each.minutes:7}  {state(each, data):12} {fills}")
    return "\n".join(lines)


def make(measurement: Measurement, data: Path, weights: Path) -> bool:
    """Carry out the commands of one measurement, note which code they ran, fill its tables.

    False where one failed.
    """
    begun, identity = time.monotonic(), measurement.identity
    _note(f"{measurement.name}: begins, some {measurement.minutes} minutes")
    environment = os.environ | {
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}"
    }
    with (RECORDS / f"{measurement.name}.log").open("a", encoding="utf-8") as log:
        for command in measurement.commands:
            words = _without_missing_weights(
                shlex.split(command.format(data=data, weights=weights))
            )
            log.write(f"$ {shlex.join(words)}\n")
            log.flush()
            ended = subprocess.run(
                words, cwd=ROOT, env=environment, stdout=log, stderr=log, check=False
            ).returncode
            if ended != 0:
                _note(f"{measurement.name}: failed with {ended}: {shlex.join(words)}")
                return False
    minutes = (time.monotonic() - begun) / 60
    write_json(
        measurement.record,
        {
            "identity": identity,
            "minutes": round(minutes, 1),
            "commands": list(measurement.commands),
        },
    )
    fill_tables.fill(measurement.name)
    _note(f"{measurement.name}: done in {minutes:.0f} minutes")
    return True


def _without_missing_weights(words: list[str]) -> list[str]:
    """The command without checkpoints that are not there; their methods are left out."""
    if "--weights" not in words:
        return words
    at = words.index("--weights")
    name, _, file = words[at + 1].partition("=")
    return (
        words
        if Path(file).is_file()
        else [word for word in (*words[:at], *words[at + 2 :]) if word != name]
    )


def _note(line: str) -> None:
    told = f"{datetime.now():%Y-%m-%d %H:%M} {line}"
    print(told, flush=True)
    with (RECORDS / "progress.log").open("a", encoding="utf-8") as log:
        log.write(f"{told}\n")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--only",
        default=[],
        type=lambda text: text.split(","),
        help="names of measurements, with commas between",
    )
    parser.add_argument(
        "--plan", action="store_true", help="print what would be made, and what it takes"
    )
    parser.add_argument(
        "--data", type=Path, default=INPUTS / "data", help="folder with the real captures"
    )
    parser.add_argument(
        "--weights", type=Path, default=INPUTS / "weights", help="folder with published checkpoints"
    )
    arguments = parser.parse_args()
    if unknown := [name for name in arguments.only if name not in MEASUREMENTS]:
        parser.error(
            f"unknown measurements {', '.join(unknown)}; there are {', '.join(MEASUREMENTS)}"
        )
    return arguments


if __name__ == "__main__":
    sys.exit(main())
