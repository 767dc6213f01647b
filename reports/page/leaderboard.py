"""The leaderboard: the tables of many scored runs on one static page; numbers alone are read, no frame is looked for."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ggvs_eval.errors import ResultsError
from ggvs_eval.files.atomic import write_text
from ggvs_eval.reports.model.measured import MeasuredRun, read_scores
from ggvs_eval.reports.page.page import TEMPLATES, page_script, script_digest, template_environment
from ggvs_eval.reports.run_groups import runs_by_protocol
from ggvs_eval.reports.tables.report_tables import main_tables
from ggvs_eval.results import merge_results

FIRST_SCRIPTS = ("theme",)
SCRIPTS = ("picture_grid", "sortable_table", "leaderboard")


def write_leaderboard(runs: Sequence[Path], out: Path) -> Path:
    """Write one page with the tables of many runs, a section per protocol.

    Args:
        runs: folders with ``protocol.toml``, ``results.*``, ``methods.json`` and ``metrics.json`` of a run; frames may be absent.
        out: HTML file to write; equal runs give equal bytes.

    Returns:
        The file.

    Raises:
        ResultsError: no run, a run given twice, a folder that is no scored run, or a method that two runs measured on one scene.
    """
    sections = [_section(group) for group in runs_by_protocol(runs, read_scores)]
    scripts = {"first": page_script(FIRST_SCRIPTS), "last": page_script(SCRIPTS)}
    text = (
        template_environment()
        .get_template("leaderboard.html.j2")
        .render(
            sections=sections,
            css=(TEMPLATES / "page.css").read_text(encoding="utf-8"),
            dark_css=(TEMPLATES / "dark.css").read_text(encoding="utf-8"),
            scripts=scripts,
            script_digests=[script_digest(script) for script in scripts.values()],
        )
    )
    write_text(out, text)
    return out


def _section(runs: Sequence[MeasuredRun]) -> dict[str, Any]:
    """The template's context of one protocol."""
    _check_measured_once(runs)
    return {
        "protocol": runs[0].protocol,
        "scenes": list(dict.fromkeys(run.scene for run in runs)),
        "tables": main_tables(runs, merge_results([run.results for run in runs])),
        "missing": _missing_scenes(runs),
        "runs": [run.folder.root.name for run in runs],
    }


def _check_measured_once(runs: Sequence[MeasuredRun]) -> None:
    """Refuse a method that two runs measured on one scene: one of them would be shown, and which is chance."""
    measured = Counter((run.scene, label) for run in runs for label in run.labels)
    for (scene, label), count in measured.items():
        if count > 1:
            roots = [str(run.folder.root) for run in runs if run.scene == scene and label in run.labels]
            raise ResultsError(f"{label} on {scene} is measured in {' and '.join(roots)}; leave out all but one")


def _missing_scenes(runs: Sequence[MeasuredRun]) -> list[str]:
    """Name the methods whose means stand on fewer scenes than others', which do not compare."""
    scenes = list(dict.fromkeys(run.scene for run in runs))
    names = dict.fromkeys(run.name(label) for run in runs for label in run.labels)
    remarks = []
    for name in names:
        there = {run.scene for run in runs if any(run.name(label) == name for label in run.labels)}
        absent = [scene for scene in scenes if scene not in there]
        if absent:
            remarks.append(f"{name} was not measured on {', '.join(absent)}: its means stand on other scenes and do not compare.")
    return remarks
