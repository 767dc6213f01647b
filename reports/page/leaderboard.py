"""The leaderboard: the tables of many scored runs on one static page.

Numbers alone are read, no frame is looked for.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ggvs_eval.files.atomic import write_text
from ggvs_eval.reports.model.measured import distinct_names, read_scores
from ggvs_eval.reports.page.page import fill_page
from ggvs_eval.reports.run_groups import read_groups
from ggvs_eval.reports.section import RunGroup


def write_leaderboard(runs: Sequence[Path], out: Path) -> Path:
    """Write one page with the tables of many runs, a section per protocol.

    Args:
        runs: folders with ``protocol.toml``, ``results.*``, ``methods.json`` and ``metrics.json``
            of a run; frames may be absent.
        out: HTML file to write; equal runs give equal bytes.

    Raises:
        ResultsError: no run, a run given twice, a folder that is no scored run, or a method that
            two runs measured on one scene.
    """
    sheets = list(map(_sheet, read_groups(runs, read_scores)))
    write_text(out, fill_page("Leaderboard", sheets))
    return out


def _sheet(group: RunGroup) -> dict[str, Any]:
    verdict, runs = group.verdict, [*group.runs.values()]
    return {
        "template": "leaderboard",
        "comes_first": True,
        "nothing": "" if verdict.column else f"{verdict.headline}. {verdict.margin}",
        "protocol": group.protocol,
        "scenes": list(dict.fromkeys(run.scene for run in runs)),
        "tables": group.tables,
        "runs": distinct_names([run.folder.root for run in runs]),
    }
