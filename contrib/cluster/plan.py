"""A sweep as commands that wait for each other, for schedulers from outside the package: Slurm
arrays, Make, Snakemake.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ggvs_eval.pipelines.methods.network_options import NetworkOptions
from ggvs_eval.pipelines.methods.render_unit import PATH
from ggvs_eval.pipelines.sweep.cells import Captures, Cell, sweep_cells, units_of
from ggvs_eval.run_folder import write_json
from ggvs_eval.sweep import Sweep

PREPARE, TABLE = "prepare", "table"


def write_commands(
    file: Path,
    root: Path,
    captures: Captures,
    sweep: Sweep,
    networks: NetworkOptions,
    command: Sequence[str],
) -> Path:
    """Write a JSON plan: a job that prepares, one per run and view, and one that makes the table.

    Each job is a command that can be given to any machine which sees the captures and the sweep's
    folder; given twice it finds its results and does nothing.

    Args:
        captures: as of `plan_cells`.
    """
    cells, _ = sweep_cells(root, captures, sweep, None, networks)
    units = units_of(cells)
    ids = [f"{cell.name}/{view}" for cell, view in units]
    views = [
        _job(name, [*command, "--shard", f"{number}/{len(units)}"], [PREPARE], _folders(cell, view))
        for number, (name, (cell, view)) in enumerate(zip(ids, units, strict=True), start=1)
    ]
    first = _job(
        PREPARE,
        [*command, "--shard", f"0/{len(units)}"],
        [],
        [str(cell.run.root) for cell in cells],
    )
    last = _job(TABLE, [*command], ids, [str(root / "sweep.csv")])
    write_json(file, {"jobs": [first, *views, last]})
    return file


def _job(
    name: str, command: Sequence[str], after: Sequence[str], makes: Sequence[str]
) -> dict[str, Any]:
    return {"id": name, "command": list(command), "after": list(after), "makes": list(makes)}


def _folders(cell: Cell, view: str) -> list[str]:
    """List the folders that a unit's results go into."""
    renders = [
        cell.run.path(label) if view == PATH else cell.run.renders(label, view)
        for label in cell.request.labels
    ]
    return [
        str(folder) for folder in (renders if view == PATH else [*renders, cell.run.scores(view)])
    ]
