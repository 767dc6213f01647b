"""Learned baselines: the registry entry of each."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

FULL = "full"  # the authors' configuration; a file of weights that names none is of it


@dataclass(frozen=True)
class LearnedBaseline:
    """A network that the paper's is compared with: all that the package knows of it outside its
    folder.

    The class is named by ``module:class``, so that a list of baselines loads no network.

    Attributes:
        name: of the baseline in labels, of its training and of its files of weights.
        title: how its authors call it.
        source: authors and venue of its paper.
        checkpoint: the authors' file that it can render with.
        method: class of its `Method`; takes the file of weights and ``device`` besides `options`.
        describe: one line for the help and the report.
        retrained: configuration of the weights that ship; empty if the user has to give a
            checkpoint.
        options: arguments of the method.
        uses_depth: whether it looks at the depth of its sources.
        takes_depth: whether it learns from sources with depth; without, no sample waits for depth.
    """

    name: str
    title: str
    source: str
    checkpoint: str
    method: str
    describe: str
    retrained: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    uses_depth: bool = False
    takes_depth: bool = False

    @property
    def weights(self) -> str:
        """Name of the file of weights that ships, if one does."""
        return f"{self.name}.safetensors"
