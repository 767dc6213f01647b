"""Options of the views that networks learn from."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True)
class DataOptions:
    """The views that a network learns from.

    Attributes:
        views: the most source views of a sample, K.
        rooms: rooms to render of each domain, one to four minutes and 50 MB each.
        targets: target views per room.
        domains: kinds of captures to learn from and to choose by (plain, narrow, arc, ...).
        captures: folders of captures to learn from beside the rooms (RGB-D sequences by ScanNet's rule, Spaces, DyNeRF, rigs of
            your own), never those that you test on.
        hold_back: learn from the first half of each RGB-D sequence, and validate on what is new in the rest.
    """

    views: int = 6
    rooms: int = 3
    targets: int = 9
    domains: Annotated[tuple[str, ...], tyro.conf.arg(metavar="DOMAIN ...", help_behavior_hint="(default: all)")] = ()
    captures: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="CAPTURE ...", help_behavior_hint="(none by default)")] = ()
    hold_back: bool = False
