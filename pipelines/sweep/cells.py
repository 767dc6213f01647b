"""Cells of a sweep: one run per capture and variant of the protocol, each with its rows."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ggvs_eval.capture import Capture
from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.errors import ProtocolError, RenderError, WeightsError
from ggvs_eval.jobs.shard import Shard
from ggvs_eval.pipelines.methods.network_options import NetworkOptions
from ggvs_eval.pipelines.methods.registry import METHODS, find_method
from ggvs_eval.pipelines.methods.render_unit import PATH
from ggvs_eval.pipelines.run.run_plan import RunRequest
from ggvs_eval.protocol import Protocol
from ggvs_eval.run_folder import RunFolder
from ggvs_eval.sweep import CAPTURE, Sweep, SweepRow

# Folder in the sweep, "" for the sweep's own if there is one capture -> what its variants start
# from.
Captures = Mapping[str, tuple[Capture, Protocol]]


@dataclass(frozen=True)
class Cell:
    """One run of a sweep.

    Attributes:
        folder: of its capture in the sweep; empty if there is one capture.
    """

    folder: str
    variant: str
    request: RunRequest
    rows: tuple[SweepRow, ...]

    @property
    def name(self) -> str:
        """For people, and the run's folder in the sweep."""
        return self.request.name

    @property
    def run(self) -> RunFolder:
        """Its run folder."""
        return RunFolder(self.request.root)

    @property
    def units(self) -> tuple[str, ...]:
        """Units that different machines can work on."""
        return (*self.request.protocol.views.test, PATH)


def sweep_cells(
    root: Path,
    captures: Captures,
    sweep: Sweep,
    depth: DepthRunOptions | None,
    networks: NetworkOptions,
    shared: Path | None = None,
) -> tuple[list[Cell], dict[str, str]]:
    """Return the runs of a sweep, and its rows that cannot be computed: title -> reason.

    Args:
        shared: folder of the frames and the depth that all runs use; that of their capture in the
            sweep where None.
    """
    names = [capture.path.resolve().name for capture, _ in captures.values()]
    absent = {row.title: reason for row in sweep.row if (reason := _why_not(row, names, networks))}
    if all(row.title in absent for row in sweep.row):
        raise ProtocolError(
            f"sweep {sweep.name}: no row has a method of this version; known are "
            f"{', '.join(METHODS)}"
        )
    cells = []
    for folder, (capture, protocol) in captures.items():
        cameras, common = len(capture.cameras), shared or root / folder
        absent |= {
            f"K = {k}": f"the capture has {cameras} cameras, including the synthesised one"
            for k in sweep.k
            if k >= cameras
        }
        for variant, variant_protocol in sweep.protocols(protocol, cameras).items():
            rows = tuple(
                row for row in sweep.rows(variant_protocol, protocol) if row.title not in absent
            )
            if rows:
                blank = RunRequest(
                    root=root / folder / variant,
                    capture=capture,
                    protocol=variant_protocol,
                    labels=(),
                    depth=depth,
                    networks=networks,
                    shared=common,
                )
                named = replace(blank, name=f"{folder}/{variant}" if folder else variant)
                cells.append(
                    Cell(folder=folder, variant=variant, request=_with_rows(named, rows), rows=rows)
                )
    return cells, absent


def shard_cells(cells: Sequence[Cell], shard: Shard) -> list[Cell]:
    """Return the runs that a shard takes part in, with its units of each.

    One that only prepares has none of any.
    """
    if shard.is_whole:
        return list(cells)
    share = {
        cell.name: [unit for owner, unit in shard.pick(units_of(cells)) if owner is cell]
        for cell in cells
    }
    return [
        replace(cell, request=replace(cell.request, views=share[cell.name]))
        for cell in cells
        if share[cell.name] or shard.prepares_only
    ]


def units_of(cells: Sequence[Cell]) -> list[tuple[Cell, str]]:
    """List the units for different machines, in an order that they all agree on."""
    return [(cell, unit) for cell in cells for unit in cell.units]


def _with_rows(request: RunRequest, rows: Sequence[SweepRow]) -> RunRequest:
    """The run with the methods of its rows: those that are rendered here, and what others rendered
    or fitted to its capture.
    """
    name = request.capture.path.resolve().name
    splats = {row.label: path for row in rows if (path := row.splats_of(name)) is not None}
    return replace(
        request,
        labels=list(dict.fromkeys(row.label for row in rows if row.rendered is None)),
        networks=replace(request.networks, splats={**request.networks.splats, **splats}),
        imports={row.label: path for row in rows if (path := row.frames_of(name)) is not None},
    )


def _why_not(row: SweepRow, captures: Sequence[str], networks: NetworkOptions) -> str | None:
    """Return why a row cannot be computed.

    None if it can, as far as is known before it is tried.
    """
    label = row.label
    if row.path is not None and len(captures) > 1 and CAPTURE not in row.path:
        return f"{row.path}: wanted {CAPTURE} in the path, got none, with {len(captures)} captures"
    if row.rendered is not None:
        return None
    if reason := METHODS.why_absent(label):
        return reason
    if row.path is None and label not in METHODS and "=" not in label:
        return f"this version has no method {label!r}"
    try:
        for path in (row.splats_of(capture) for capture in captures):
            options = networks if path is None else replace(networks, splats={label: path})
            find_method(label, options).require()
    except (RenderError, WeightsError) as error:
        return str(error)
    return None
