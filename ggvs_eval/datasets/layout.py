"""Layout of captures: recognition, opening and description."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ggvs_eval.capture import Capture
from ggvs_eval.datasets.units import GivenUnits


@dataclass(frozen=True)
class DatasetSpec:
    """One layout.

    Attributes:
        describe: the layout in one line, for help texts.
        refuse: says why a path is not of this layout, None if it is.
        load: opens a path of this layout; the second argument is what the user knows of its units.
        marks: patterns of names by which a folder shows that it is meant to be of this layout; what
            they name is never noted as unused.
    """

    describe: str
    refuse: Callable[[Path], str | None]
    load: Callable[[Path, GivenUnits], Capture]
    marks: tuple[str, ...] = ()
