"""The leaderboard: the tables of many scored runs on one static page; numbers alone are read, no frame is looked for."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ggvs_eval.files.atomic import write_text
from ggvs_eval.merged_results import merge_results
from ggvs_eval.reports.model.measured import MeasuredRun, distinct_names, read_scores
from ggvs_eval.reports.page.page import STILL_FIRST_SCRIPTS, STILL_SCRIPTS, fill_template
from ggvs_eval.reports.run_groups import runs_by_protocol
from ggvs_eval.reports.tables.report_tables import main_tables
from ggvs_eval.reports.tables.verdict import evaluate_verdict


def write_leaderboard(runs: Sequence[Path], out: Path) -> Path:
    """Write one page with the tables of many runs, a section per protocol.

    Args:
        runs: folders with ``protocol.toml``, ``results.*``, ``methods.json`` and ``metrics.json`` of a run; frames may be absent.
        out: HTML file to write; equal runs give equal bytes.

    Raises:
        ResultsError: no run, a run given twice, a folder that is no scored run, or a method that two runs measured on one scene.
    """
    sections = [_section(group) for group in runs_by_protocol(runs, read_scores)]
    write_text(out, fill_template("leaderboard.html.j2", STILL_FIRST_SCRIPTS, STILL_SCRIPTS, sections=sections))
    return out


def _section(runs: Sequence[MeasuredRun]) -> dict[str, Any]:
    results = merge_results([run.results for run in runs])
    tables = main_tables(runs, results)
    verdict = evaluate_verdict(runs, results, tables)
    return {
        "nothing": "" if verdict.column else f"{verdict.headline}. {verdict.margin}",
        "protocol": runs[0].protocol,
        "scenes": list(dict.fromkeys(run.scene for run in runs)),
        "tables": tables,
        "runs": distinct_names([run.folder.root for run in runs]),
    }
