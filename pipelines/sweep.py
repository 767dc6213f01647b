"""Run a sweep: the whole evaluation once per capture and variant of the protocol, and one table of all of them."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from ggvs_eval.capture import Capture
from ggvs_eval.errors import ProtocolError, RenderError
from ggvs_eval.pipelines.methods import METHODS, find_method, split_label
from ggvs_eval.pipelines.offline.depth_choice import DepthChoice
from ggvs_eval.pipelines.prepare import prepare
from ggvs_eval.pipelines.render import render
from ggvs_eval.pipelines.score import score
from ggvs_eval.protocol import Protocol
from ggvs_eval.results import Results
from ggvs_eval.run_folder import JOB_FILE, RunFolder, read_json
from ggvs_eval.sweep import Sweep, SweepRow

SHARED_FOLDERS = ("truth", "depth")


@dataclass(frozen=True)
class SweepResult:
    """What came out of a sweep.

    Attributes:
        table: one line per variant and row: mean of each metric, and seconds per frame; of several captures per capture too.
        not_computed: title of a row -> reason.
        runs: the run folder of each variant, ``capture/variant`` where there are several captures.
    """

    table: pd.DataFrame
    not_computed: dict[str, str]
    runs: dict[str, Path]


def run_sweeps(
    root: Path,
    captures: Mapping[str, tuple[Capture, Protocol]],
    sweep: Sweep,
    workers: int,
    depth: DepthChoice | None = None,
) -> SweepResult:
    """Run a sweep on several captures, each in a folder of its own, and give their means beside the single tables.

    Args:
        root: folder of the sweeps.
        captures: name of the capture's folder in it -> the capture, and what its variants start from.
        sweep: rows and variants.
        workers: processes.
        depth: how depth is found, see `DepthChoice`.

    Returns:
        The table's first level is the capture; ``mean`` is the mean over the captures, of lines that all of them have.

    Raises:
        GgvsError: as of the single steps.
        ProtocolError: captures whose protocols measure differently, so that a mean of them says nothing.
    """
    kinds = {protocol.measurement for _, protocol in captures.values()}
    if len(kinds) != 1:
        raise ProtocolError(f"{root}: wanted captures that are measured alike, got {len(kinds)} kinds; name one with --protocol")
    results = {
        name: run_sweep(root / name, capture, sweep, protocol, workers, depth) for name, (capture, protocol) in captures.items()
    }
    tables = pd.concat({name: result.table for name, result in results.items()}, names=["capture"])
    lines = tables.groupby(level=["variant", "method"], sort=False)
    means = lines.mean()[lines.size() == len(results)]
    table = pd.concat([tables, pd.concat({"mean": means}, names=["capture"])])
    table.to_csv(root / "sweep.csv")
    absent = {title: reason for result in results.values() for title, reason in result.not_computed.items()}
    runs = {f"{name}/{variant}": run for name, result in results.items() for variant, run in result.runs.items()}
    return SweepResult(table, absent, runs)


def run_sweep(
    root: Path, capture: Capture, sweep: Sweep, protocol: Protocol, workers: int, depth: DepthChoice | None = None
) -> SweepResult:
    """Evaluate every row under every variant; what exists is not computed again.

    Frames and depth are shared between the variants, so that K = 2 finds what K = 6 has computed.

    Args:
        root: folder of the sweep; each variant is a run folder in it.
        capture: what to evaluate on.
        sweep: rows and variants.
        protocol: what the variants start from.
        workers: processes.
        depth: how depth is found, see `DepthChoice`.

    Raises:
        GgvsError: as of the single steps.
    """
    absent = {row.title: reason for row in sweep.row if (reason := _why_not(row.method))}
    cameras = len(capture.cameras)
    absent |= {f"K = {k}": f"the capture has {cameras} cameras, one of them is synthesised" for k in sweep.k if k >= cameras}
    if all(row.title in absent for row in sweep.row):
        raise ProtocolError(f"sweep {sweep.name}: no row has a method of this version; known are {', '.join(METHODS)}")
    runs, parts = {}, []
    for variant, variant_protocol in sweep.protocols(protocol, cameras).items():
        rows = [row for row in sweep.rows(variant_protocol, protocol) if row.title not in absent]
        if not rows:
            continue
        runs[variant] = root / variant
        _share_folders(root, runs[variant])
        render(prepare(runs[variant], capture, variant_protocol, workers, depth), [row.method for row in rows], workers)
        parts.append(_lines(variant, RunFolder(runs[variant]), score(RunFolder(runs[variant]), workers), rows))
    table = pd.concat(parts)
    table.to_csv(root / "sweep.csv")
    return SweepResult(table, absent, runs)


def _why_not(label: str) -> str | None:
    """Why a row's method cannot be rendered; None where it can."""
    if label not in METHODS and "=" not in label:
        return f"this version has no method {label!r}"
    try:
        find_method(label)
    except RenderError as error:
        return str(error)
    return None


def _share_folders(root: Path, run: Path) -> None:
    run.mkdir(parents=True, exist_ok=True)
    for name in SHARED_FOLDERS:
        (root / name).mkdir(exist_ok=True)
        if not (run / name).exists():
            (run / name).symlink_to(Path("..") / name, target_is_directory=True)


def _lines(variant: str, run: RunFolder, results: Results, rows: list[SweepRow]) -> pd.DataFrame:
    """The rows of one variant by their titles, with the time of a frame."""
    summary = results.summary().droplevel("dataset")
    lines = pd.DataFrame([summary.loc[split_label(row.method)] for row in rows], index=[row.title for row in rows])
    lines["s/frame"] = [_seconds_per_frame(run, row.method) for row in rows]
    lines.index = pd.MultiIndex.from_product([[variant], lines.index], names=["variant", "method"])
    return lines


def _seconds_per_frame(run: RunFolder, label: str) -> float:
    """Median over all frames of all views."""
    records = [read_json(run.renders(label, view) / JOB_FILE)["seconds"] for view in run.protocol().views.test]
    return float(np.median([sum(stages) for record in records for stages in zip(*record.values(), strict=True)]))
