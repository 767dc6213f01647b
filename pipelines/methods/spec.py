"""Specification of a method: what the command line, the folders and the tables know of it."""

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import partial
from importlib import resources
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from ggvs_eval.errors import RenderError
from ggvs_eval.files.toml_tables import build_table
from ggvs_eval.method import Method
from ggvs_eval.scene_fitter import SceneFitter


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
        device_modules: what it renders with besides on a device that is not the CPU.
        fitter: of a method that is fitted to the capture, the class of its `SceneFitter` as ``module:class``: a frozen dataclass
            of its options. Such a method makes no step; `make` says so.
        fitter_options: the options that a label such as ``4dgs+motion=linear`` sets.
        seed: of the fit, ``4dgs+seed=1``.
        splats: of Gaussians that others have fitted, their files; such a method makes no step either.
        uses_depth: whether it looks at the depth of its sources, or learns a scene from it.
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
    device_modules: tuple[str, ...] = ()
    fitter: str = ""
    fitter_options: Mapping[str, Any] = field(default_factory=dict)
    seed: int = 0
    splats: Path | None = None
    uses_depth: bool = True

    @property
    def settings(self) -> dict[str, Any]:
        """Options of its classes that the label fixes, by name; neither files nor the device, which are recorded apart."""
        return {**_settings(self.make), **self.fitter_options}

    @property
    def is_fitted(self) -> bool:
        """Tell whether it is fitted to a capture before it renders."""
        return bool(self.fitter)

    def require(self) -> None:
        """Find out whether it can be made here: its weights, its options.

        Raises:
            GgvsError: why not.
        """
        from ggvs_eval.pipelines.methods.splats import open_splats

        if self.splats:
            open_splats(self.splats)
        elif self.is_fitted:
            self.make_fitter()
        else:
            self.make()

    def make_fitter(self) -> SceneFitter:
        """Make the fitter with the options of the label.

        Raises:
            RenderError: an option that it has not.
        """
        kind: type[SceneFitter] = resolve_name(self.fitter)
        values = dict(self.fitter_options)
        if self.device != "cpu":
            values["device"] = self.device
        return build_table(kind, values, f"method {self.title}", "", RenderError)

    def on(self, device: str) -> "MethodSpec":
        """The method with its networks on a device; one without networks stays as it is."""
        if device == self.device or not (self.weights or self.checkpoint or "device" in self._fitter_fields()):
            return self
        if self.is_fitted:
            return replace(self, device=device)
        return replace(self, make=partial(self.make, device=device), device=device, modules=(*self.modules, *self.device_modules))

    def _fitter_fields(self) -> list[str]:
        """Names of the options of its fitter; none where it is not fitted."""
        return [each.name for each in fields(resolve_name(self.fitter))] if self.is_fitted else []


def _settings(make: Any) -> dict[str, Any]:
    """Keywords of a partial, and of the partials that it is given."""
    if not isinstance(make, partial):
        return {}
    inner = {name: value for each in make.args for name, value in _settings(each).items()}
    return inner | {name: value for name, value in make.keywords.items() if name != "device"}


def option_values(variant: str) -> dict[str, Any]:
    """Options of a variant such as ``motion=linear+seed=1``: numbers and truth values as such, anything else a word.

    Examples:
        >>> option_values("motion=linear+seed=1")
        {'motion': 'linear', 'seed': 1}
    """
    return {name: _option_value(text) for name, _, text in (part.partition("=") for part in variant.split("+"))}


def option_words(values: Mapping[str, Any]) -> str:
    """Options as titles say them, in their order: what counts something is named in the plural.

    Examples:
        >>> option_words({"motion": "linear", "steps": 3000, "seed": 1, "save_every": 100, "background": False})
        'linear motion, 3,000 steps, seed 1, save every 100, no background'
    """
    return ", ".join(_words_of(name.replace("_", " "), value) for name, value in values.items())


def _words_of(name: str, value: Any) -> str:
    if isinstance(value, bool):
        return name if value else f"no {name}"
    if isinstance(value, str):
        return f"{value} {name}"
    return f"{value:,} {name}" if isinstance(value, int) and name.endswith("s") else f"{name} {value}"


def _option_value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
