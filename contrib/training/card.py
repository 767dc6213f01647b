"""The model card of trained weights: data, cost and quality of the training."""

import csv
import hashlib
import platform
from dataclasses import asdict, fields, is_dataclass
from pathlib import Path

from ggvs_eval.contrib.training.checkpoint import PIXELS_NOTE
from ggvs_eval.contrib.training.task import Task
from ggvs_eval.files.weights_file import read_notes

SHOWN_VALIDATIONS = 12


def write_card(task: Task, folder: Path, command: str, note: str = "", device: str = "cpu") -> Path:
    """Write ``<task>.md`` from the logs of a training.

    Args:
        command: that made them.
    """
    weights = folder / f"{task.name}.safetensors"
    notes = read_notes(weights)
    steps, pixels = int(notes["steps"]), int(notes[PIXELS_NOTE])
    rows = _rows(folder / "log.csv")[:steps]
    hours = sum(float(row["seconds"]) for row in rows) / 3600
    on_cpu = sum(float(row.get("cpu_seconds") or 0) for row in rows) / 60
    validations = _rows(folder / "validation.csv")
    shown = validations[:: max(1, len(validations) // SHOWN_VALIDATIONS)]
    cost = f", {on_cpu:.0f} minutes of one core" if on_cpu else ""
    cost += "" if device == "cpu" else f", {device}"
    lines = [
        f"# {task.name}",
        "",
        task.summary,
        "",
        f"- Command: `{command}`",
        f"- Steps: {steps}, {hours:.1f} hours on {platform.machine()} ({platform.system()}){cost}",
        f"- Pixels of target views: {pixels / 1e6:.0f} million, with those of the weights that it began with, as far as they say",
        f"- Weights: `{weights.name}`, {weights.stat().st_size / 2**20:.1f} MB, half precision, averaged over the last steps,",
        f"  sha256 {hashlib.sha256(weights.read_bytes()).hexdigest()}",
        f"- Data: {task.data}",
        "- Licence: that of this package.",
        *([f"- Note: {note}"] if note else []),
        "",
        "## Options",
        "",
        *(f"- {name}: {value}" for name, value in _options(task).items()),
        "",
        "## Validation",
        "",
        f"{task.evaluated_on}",
        "",
        *_table(shown if not validations or shown[-1] == validations[-1] else [*shown, validations[-1]]),
    ]
    card = folder / f"{task.name}.md"
    card.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return card


def _rows(path: Path) -> list[dict[str, str]]:
    if not path.is_file():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def _options(task: Task) -> dict[str, object]:
    """The fields of a task that its repr shows."""
    if not is_dataclass(task) or isinstance(task, type):
        return {}
    values = asdict(task)
    return {each.name: values[each.name] for each in fields(task) if each.repr}


def _table(rows: list[dict[str, str]]) -> list[str]:
    if not rows:
        return ["not computed: the training has not reached its first validation"]
    header = list(rows[0])
    body = ["| " + " | ".join(row[name] for name in header) + " |" for row in rows]
    return ["| " + " | ".join(header) + " |", "| " + " | ".join("---:" for _ in header) + " |", *body]
