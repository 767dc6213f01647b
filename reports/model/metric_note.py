"""Description of a metric in reports: the score step writes it into the run folder, so that reports import no metric."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ggvs_eval.errors import ResultsError
from ggvs_eval.run_folder import read_json

METRICS_FILE = "metrics.json"
FURTHER = "further"  # group of the metrics that belong to no other


@dataclass(frozen=True)
class MetricNote:
    """A metric as a report knows it.

    Attributes:
        unit: e.g. ``dB``; empty where there is none.
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
    """Metric -> its note, in the order in which the protocol names them."""
    fields = {field.name for field in dataclasses.fields(MetricNote)} - {"name"}
    records = read_json(run / METRICS_FILE)
    for name, record in records.items():
        if set(record) != fields:
            raise ResultsError(
                f"{run / METRICS_FILE}: wanted {', '.join(sorted(fields))} of {name}, got {', '.join(sorted(record))}; "
                f"run `ggvs-eval score {run}` again"
            )
    return {name: MetricNote(name, **record) for name, record in records.items()}


def note_groups(notes: Sequence[MetricNote]) -> dict[str, tuple[MetricNote, ...]]:
    """Short name of a table -> the metrics that are its columns, in the order in which they are given; ``further`` comes last."""
    keys = sorted(dict.fromkeys(note.group for note in notes), key=lambda key: key == FURTHER)  # stable
    return {key: tuple(note for note in notes if note.group == key) for key in keys}
