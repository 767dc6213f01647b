"""A metric study as it is on disk, for its tables and its figure."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ggvs_eval.errors import ResultsError
from ggvs_eval.run_folder import read_json

STUDY_FILE = "study.json"
Study = Mapping[str, Any]  # see `ggvs_eval.contrib.study.study.run_study`


def read_study(folder: Path) -> Study:
    """Read a study of ``ggvs-eval metric-study``."""
    file = folder / STUDY_FILE
    if not file.is_file():
        raise ResultsError(
            f"{folder}: wanted the folder of a metric study, got no {STUDY_FILE}; run `ggvs-eval "
            f"metric-study`"
        )
    record: Study = read_json(file)
    return record


def answered_metrics(studies: Sequence[Study]) -> list[str]:
    """Return the metrics that at least one study has measured, in their order."""
    answered = {
        metric
        for study in studies
        for of_ladder in study["answers"].values()
        for metric in of_ladder
    }
    return [
        metric
        for metric in dict.fromkeys(name for study in studies for name in study["metrics"])
        if metric in answered
    ]
