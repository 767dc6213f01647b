"""A sweep: the methods of a table and the numbers of source cameras they are run with.

One TOML file.
"""

import dataclasses
import re
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from ggvs_eval.errors import ProtocolError, did_you_mean
from ggvs_eval.files.toml_tables import build_table, parse_toml, read_toml
from ggvs_eval.protocol import Protocol, Stream

RENDERED, SPLATS = "rendered:", "splats:"
CAPTURE = "{capture}"


@dataclass(frozen=True)
class SweepRow:
    """One row of the table.

    Attributes:
        title: what the paper calls it.
        method: label of the method; one that is not built yet is reported as not computed.
            ``rendered:PATH`` is frames that others rendered, in any form that ``ggvs-eval score``
            takes, ``splats:PATH`` 3D Gaussians that others have fitted; ``{capture}`` in the path
            is the capture's name.
        only_own_k: compute this row at the protocol's own number of source cameras and leave it out
            of the other variants.
    """

    title: str
    method: str
    only_own_k: bool = False

    @property
    def label(self) -> str:
        """Name of its folders: the method, or the title as a plain name where others rendered or
        fitted.
        """
        return (
            self.method
            if self.path is None
            else re.sub(r"[^a-z0-9]+", "-", self.title.lower()).strip("-")
        )

    @property
    def path(self) -> str | None:
        """The path of frames that others rendered, or of what they fitted.

        None for a method of this package.
        """
        prefix = next(
            (prefix for prefix in (RENDERED, SPLATS) if self.method.startswith(prefix)), None
        )
        return None if prefix is None else self.method.removeprefix(prefix)

    @property
    def rendered(self) -> str | None:
        """The path of frames that others rendered; None if they are rendered here."""
        return self.path if self.method.startswith(RENDERED) else None

    def frames_of(self, capture: str) -> Path | None:
        """Return the path of others' frames of a capture, or None for a method that is rendered
        here.
        """
        return None if self.rendered is None else Path(self.rendered.replace(CAPTURE, capture))

    def splats_of(self, capture: str) -> Path | None:
        """Return the path of 3D Gaussians that others have fitted to a capture, or None for any
        other method.
        """
        return (
            Path((self.path or "").replace(CAPTURE, capture))
            if self.method.startswith(SPLATS)
            else None
        )


@dataclass(frozen=True)
class Sweep:
    """Table of methods (rows) to compare, over numbers of source cameras.

    Attributes:
        row: the methods, in the order of the table.
        k: numbers of source cameras; the protocol's own where empty, and in addition to these if a
            row asks for it.
        all_cameras: also with every camera as a source, but the one that is synthesised.
        stream: how pictures reach a screen, where the sweep is of what a viewer sees; a protocol's
            own stays.
    """

    name: str
    describe: str
    row: tuple[SweepRow, ...]
    k: tuple[int, ...] = ()
    all_cameras: bool = False
    stream: Stream | None = None

    def protocols(self, protocol: Protocol, cameras: int) -> dict[str, Protocol]:
        """One protocol per variant, by the name of its run folder: ``k4``, or the protocol's own
        name where only K = its own.

        Args:
            cameras: of the capture; a K of the sweep that it cannot serve has no variant.
        """
        protocol = protocol if self.stream is None else protocol.streamed(self.stream)
        own_k, most = protocol.synthesis.k, cameras - 1
        k_values = {
            *self.k,
            *([own_k] if not self.k or any(row.only_own_k for row in self.row) else []),
        }
        k_values |= {most} if self.all_cameras else set()
        if k_values == {own_k}:
            return {protocol.name: protocol}
        served = sorted(k for k in k_values if k <= most or k == own_k)
        return {
            f"k{k}": dataclasses.replace(
                protocol, synthesis=dataclasses.replace(protocol.synthesis, k=k)
            )
            for k in served
        }

    def rows(self, variant: Protocol, protocol: Protocol) -> tuple[SweepRow, ...]:
        """Return the rows that a variant of a protocol has."""
        return tuple(
            row
            for row in self.row
            if not row.only_own_k or variant.synthesis.k == protocol.synthesis.k
        )


def load_sweep(source: str) -> Sweep:
    """Read a sweep from a TOML file, or one that ships with the package by its name (``ablations``,
    ``k``).

    Paths of what others rendered or fitted are taken from the folder of the file.

    Examples:
        >>> sweep = load_sweep("k")
        >>> sweep.k, [row.method for row in sweep.row]
        ((2, 3, 4, 5, 6), ['distance-based', 'ours'])
    """
    if source.endswith(".toml"):
        values = read_toml(Path(source), ProtocolError)
    elif source in packaged_sweeps():
        file = resources.files("ggvs_eval") / "sweeps" / f"{source}.toml"
        values = parse_toml(file.read_text(encoding="utf-8"), source, ProtocolError)
    else:
        sweep_names = packaged_sweeps()
        choices = (
            f"a .toml file or one of {', '.join(sweep_names)}{did_you_mean(source, sweep_names)}"
        )
        raise ProtocolError(f"sweep {source!r} is not packaged; use {choices}")
    sweep = build_table(Sweep, values, source, "", ProtocolError)
    if not sweep.row or any(k < 1 for k in sweep.k):
        raise ProtocolError(
            f"{source}: wanted at least one [[row]] and k of at least 1, got {len(sweep.row)} "
            f"rows, k {sweep.k}"
        )
    labels = [row.label for row in sweep.row if row.path is not None]
    if "" in labels or len(set(labels)) < len(labels):
        raise ProtocolError(
            f"{source}: wanted titles that differ in letters and digits, got {labels}"
        )
    folder = Path(source).parent
    return dataclasses.replace(sweep, row=tuple(_resolved(row, folder) for row in sweep.row))


def _resolved(row: SweepRow, folder: Path) -> SweepRow:
    if row.path is None:
        return row
    return dataclasses.replace(
        row, method=f"{row.method.removesuffix(row.path)}{folder / row.path}"
    )


def packaged_sweeps() -> list[str]:
    """Return the names of the sweeps that ship with the package."""
    folder = resources.files("ggvs_eval") / "sweeps"
    return sorted(
        item.name.removesuffix(".toml") for item in folder.iterdir() if item.name.endswith(".toml")
    )
