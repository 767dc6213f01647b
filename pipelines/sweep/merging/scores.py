"""Values of different methods in the same view, measured on different machines, become one record."""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ggvs_eval.errors import ResultsError
from ggvs_eval.pipelines.sweep.merging.units import same_values
from ggvs_eval.run_folder import JOB_FILE, RunFolder, read_json, write_json


def merge_scores(runs: Sequence[RunFolder], folder: Path) -> None:
    """Write ``scores/<view>/job.json`` with the methods of all runs.

    Args:
        runs: of one protocol and capture.
        folder: of the merged run.

    Raises:
        ResultsError: one method has different values in two runs, or was measured from different frames.
    """
    records: dict[str, list[tuple[Path, dict[str, Any]]]] = {}
    for run in runs:
        for file in sorted(run.scores("").glob(f"*/{JOB_FILE}")):
            records.setdefault(file.parent.name, []).append((file, read_json(file)))
    for view, found in records.items():
        methods = _union(found)
        identity = {label: method["identity"] for label, method in methods.items()}
        sha256 = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()
        write_json(RunFolder(folder).scores(view) / JOB_FILE, {"sha256": sha256, "identity": identity, "methods": methods})


def _union(found: Sequence[tuple[Path, dict[str, Any]]]) -> dict[str, Any]:
    """Every method of one view once."""
    methods: dict[str, Any] = {}
    origin: dict[str, Path] = {}
    for file, record in found:
        for label, method in record["methods"].items():
            known = methods.setdefault(label, method)
            if not same_values(known, method):
                kind = "values" if known["identity"] == method["identity"] else "frames or metrics"
                raise ResultsError(f"{origin[label]} and {file} differ in the {kind} of {label}; keep one of them")
            origin.setdefault(label, file)
    return methods
