"""Specification of a method: what the command line, the folders and the tables know of it."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any

from ggvs_eval.method import Method


def shipped(name: str) -> Path:
    """A file of trained weights that ships."""
    return Path(str(resources.files("ggvs_eval.pipelines") / "weights" / name))


@dataclass(frozen=True)
class MethodSpec:
    """One method or variant of it.

    Attributes:
        title: how tables call it.
        describe: one line for the help and the report.
        make: builds a fresh object that renders one sequence; that of a method with networks takes their ``device``.
        modules: where its classes stand; a change there, or in what they import, makes its renders stale.
        ours: whether it is this project's method or an ablation of it.
        online: whether it sees nothing of the future.
        usual: whether it is rendered where nobody names methods; ablations that only a sweep asks for are not.
        weights: files of the trained weights it renders with.
        checkpoint: what the user can give instead of weights that ship, or has to give where none do.
        make_from: builds one with such a checkpoint.
        title_from: how tables call it then, if not by `title`: weights that we trained are labelled so.
        make_with: builds one with other `OnlineOptions`, for labels such as ``ours+beta_temporal=0.6``.
        device: where its networks compute, if it has any.
    """

    title: str
    describe: str
    make: Callable[..., Method]
    modules: tuple[str, ...]
    ours: bool = False
    online: bool = True
    usual: bool = True
    weights: tuple[Path, ...] = ()
    checkpoint: str = ""
    make_from: Callable[..., Method] | None = None
    title_from: str = ""
    make_with: Callable[..., Method] | None = None
    device: str = "cpu"

    @property
    def settings(self) -> dict[str, Any]:
        """Options of its classes that the label fixes, by name; neither files nor the device, which are recorded apart."""
        return _settings(self.make)

    def on(self, device: str) -> "MethodSpec":
        """The method with its networks on a device; one without networks stays as it is."""
        if device == self.device or not (self.weights or self.checkpoint):
            return self
        return replace(self, make=partial(self.make, device=device), device=device)


def _settings(make: Any) -> dict[str, Any]:
    """Keywords of a partial, and of the partials that it is given."""
    if not isinstance(make, partial):
        return {}
    inner = {name: value for each in make.args for name, value in _settings(each).items()}
    return inner | {name: value for name, value in make.keywords.items() if name != "device"}
