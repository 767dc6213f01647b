"""Cells of a sweep: one run per capture and variant of the protocol, each with the rows that stand in it."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ggvs_eval.capture import Capture
from ggvs_eval.errors import ProtocolError, RenderError, WeightsError
from ggvs_eval.jobs.shard import Shard
from ggvs_eval.pipelines.methods.network_options import NetworkOptions
from ggvs_eval.pipelines.methods.registry import METHODS, find_method
from ggvs_eval.pipelines.offline.depth.depth_choice import DepthRunOptions
from ggvs_eval.pipelines.run.run_plan import RunRequest
from ggvs_eval.protocol import Protocol
from ggvs_eval.run_folder import RunFolder
from ggvs_eval.sweep import CAPTURE, Sweep, SweepRow

SHARED_FOLDERS = ("truth", "depth")
PATH = "path"  # the unit of the camera path, beside the test views
Captures = Mapping[
    str, tuple[Capture, Protocol]
]  # folder in the sweep, "" where there is one capture -> what its variants start from


@dataclass(frozen=True)
class Cell:
    """One run of a sweep.

    Attributes:
        folder: of its capture in the sweep; empty where there is one capture.
        variant: name of the variant.
        root: folder of the sweep.
        capture: what is evaluated on.
        protocol: of the variant.
        rows: that can be computed.
    """

    folder: str
    variant: str
    root: Path
    capture: Capture
    protocol: Protocol
    rows: tuple[SweepRow, ...]

    @property
    def name(self) -> str:
        """For people, and the run's folder in the sweep."""
        return f"{self.folder}/{self.variant}" if self.folder else self.variant

    @property
    def run(self) -> RunFolder:
        """Its run folder."""
        return RunFolder(self.root / self.folder / self.variant)

    @property
    def labels(self) -> list[str]:
        """Its methods, by the names of their folders."""
        return list(dict.fromkeys(row.label for row in self.rows))

    @property
    def synthesised(self) -> list[str]:
        """Those that are rendered here."""
        return list(dict.fromkeys(row.label for row in self.rows if row.rendered is None))

    @property
    def imported(self) -> dict[str, Path]:
        """Those that others rendered, and where their frames lie."""
        name = self.capture.path.resolve().name
        return {row.label: path for row in self.rows if (path := row.frames_of(name)) is not None}

    def networks(self, networks: NetworkOptions) -> NetworkOptions:
        """The same networks, and the Gaussians that others have fitted to its capture."""
        name = self.capture.path.resolve().name
        splats = {row.label: path for row in self.rows if (path := row.splats_of(name)) is not None}
        return replace(networks, splats={**networks.splats, **splats})

    def request(self, depth: DepthRunOptions | None, networks: NetworkOptions, views: Collection[str] | None) -> RunRequest:
        """The run to plan.

        Args:
            depth: how depth is found.
            networks: with which weights and where networks compute.
            views: units that are worked on; none where the run is only prepared.
        """
        shared = self.root / self.folder
        labels, networks = self.synthesised, self.networks(networks)
        return RunRequest(self.run.root, self.capture, self.protocol, labels, depth, networks, shared, views or ())

    def share_folders(self) -> None:
        """Let all variants of a capture have their frames and depth in common, so that K = 2 finds what K = 6 has computed."""
        run, common = self.run.root, self.root / self.folder
        run.mkdir(parents=True, exist_ok=True)
        for name in SHARED_FOLDERS:
            (common / name).mkdir(exist_ok=True)
            if not (run / name).exists():
                (run / name).symlink_to(Path("..") / name, target_is_directory=True)


def sweep_cells(root: Path, captures: Captures, sweep: Sweep, networks: NetworkOptions) -> tuple[list[Cell], dict[str, str]]:
    """The runs of a sweep, and what of it cannot be computed: title -> reason.

    Raises:
        ProtocolError: no row has a method that can be rendered.
    """
    names = [capture.path.resolve().name for capture, _ in captures.values()]
    absent = {row.title: reason for row in sweep.row if (reason := _why_not(row, names, networks))}
    if all(row.title in absent for row in sweep.row):
        raise ProtocolError(f"sweep {sweep.name}: no row has a method of this version; known are {', '.join(METHODS)}")
    cells = []
    for folder, (capture, protocol) in captures.items():
        cameras = len(capture.cameras)
        absent |= {f"K = {k}": f"the capture has {cameras} cameras, one of them is synthesised" for k in sweep.k if k >= cameras}
        for variant, variant_protocol in sweep.protocols(protocol, cameras).items():
            rows = tuple(row for row in sweep.rows(variant_protocol, protocol) if row.title not in absent)
            if rows:
                cells.append(Cell(folder, variant, root, capture, variant_protocol, rows))
    return cells, absent


def units_of(cells: list[Cell]) -> list[tuple[Cell, str]]:
    """List the units for different machines: (run, test view or `PATH`), in an order that they all agree on."""
    return [(cell, view) for cell in cells for view in (*cell.protocol.views.test, PATH)]


def share_of(cells: list[Cell], shard: Shard) -> dict[str, set[str]]:
    """Name of a cell -> its views, and `PATH`, that a shard works on."""
    share: dict[str, set[str]] = {}
    for cell, view in shard.pick(units_of(cells)):
        share.setdefault(cell.name, set()).add(view)
    return share


def _why_not(row: SweepRow, captures: Sequence[str], networks: NetworkOptions) -> str | None:
    """Return why a row cannot be computed; None where it can, as far as can be told before it is tried."""
    label = row.label
    if row.path is not None and len(captures) > 1 and CAPTURE not in row.path:
        return f"{row.path}: wanted {CAPTURE} in the path, as there are {len(captures)} captures"
    if row.rendered is not None:
        return None
    if row.path is None and label not in METHODS and "=" not in label:
        return f"this version has no method {label!r}"
    try:
        for path in (row.splats_of(capture) for capture in captures):
            given = networks if path is None else replace(networks, splats={label: path})
            find_method(label, given).require()
    except (RenderError, WeightsError) as error:
        return str(error)
    return None
