"""Learned baselines: the registry entry of each."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from ggvs_eval.method import Method

FULL = "full"  # the authors' configuration; a file of weights that names none is of it


@dataclass(frozen=True)
class Rendition:
    """One way of rendering by a learned baseline, with its own label.

    Attributes:
        describe: one line for the help and the report.
        retrained: configuration of the weights that ship for it; empty if the user has to give a checkpoint.
        variant: suffix of its label, after the baseline's name and a ``+``.
        options: arguments of the baseline's method.
        uses_depth: whether it looks at the depth of its sources.
    """

    title: str
    describe: str
    retrained: str = ""
    variant: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    uses_depth: bool = False


@dataclass(frozen=True)
class LearnedBaseline:
    """A network that the paper's is compared with: all that the package knows of it outside its folder.

    Classes are named by ``module:class``, so that a list of baselines loads no network.

    Attributes:
        name: of the baseline in labels, of its training and of its files of weights.
        title: how its authors call it.
        source: authors and venue of its paper.
        checkpoint: the authors' file that it can render with.
        method: class of its `Method`; takes the file of weights and ``device`` besides the options of a rendition.
        renditions: the ways in which it renders.
        takes_depth: whether it learns from sources with depth; without, no sample waits for depth.
    """

    name: str
    title: str
    source: str
    checkpoint: str
    method: str
    renditions: tuple[Rendition, ...]
    takes_depth: bool = False

    @property
    def weights(self) -> str:
        """Name of the file of weights that ships, if one does."""
        return f"{self.name}.safetensors"

    def label(self, rendition: Rendition) -> str:
        """Return the label of a rendition, on the command line and in folders."""
        return f"{self.name}+{rendition.variant}" if rendition.variant else self.name

    def make_method(self, weights: Path, **options: Any) -> Method:
        """Return a fresh object that renders one sequence.

        Args:
            weights: the authors' checkpoint, or the output of `ggvs-eval train`.
            options: ``device``, and others of the method.
        """
        method: Callable[..., Method] = resolve_name(self.method)
        return method(weights, **options)
