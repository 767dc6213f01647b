"""Methods that are fitted to one capture: here, as offline references and frame by frame, or by
others.
"""

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field, fields, replace
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, ClassVar

from ggvs_eval.errors import RenderError, ViewRefusedError
from ggvs_eval.files.digest import digest_files
from ggvs_eval.files.toml_tables import build_table
from ggvs_eval.pipelines.methods.render_unit import RenderUnit
from ggvs_eval.pipelines.methods.spec import SceneMethod, option_values, option_words
from ggvs_eval.pipelines.methods.splats import (
    named_splats,
    open_splats,
    reading_modules,
    require_instants,
    splats_files,
    splats_notes,
    splats_settings,
)
from ggvs_eval.run_folder import JOB_FILE, REFUSED, read_json
from ggvs_eval.scene_fitter import FittedScene, SceneFitter
from ggvs_eval.tasks.task import Made


@dataclass(frozen=True)
class FittedMethod(SceneMethod):
    """A method that is fitted to the capture, by its `SceneFitter`.

    Attributes:
        fitter: the class as ``module:class``: a frozen dataclass of its options.
        options: those that a label such as ``4dgs+motion=linear`` sets.
        seed: of the fit, ``4dgs+seed=1``.
    """

    preparation: ClassVar[str] = "fits"
    fitter: str
    _: KW_ONLY
    online: bool = False
    options: Mapping[str, Any] = field(default_factory=dict)
    seed: int = 0

    @property
    def modules(self) -> tuple[str, ...]:
        """See `MethodSpec.modules`."""
        return (self.fitter.partition(":")[0],)

    @property
    def settings(self) -> dict[str, Any]:
        """Options of the fitter that the label sets."""
        return dict(self.options)

    @property
    def learned_from(self) -> str:
        """The capture, except for what is rendered."""
        return "this capture, without the fold of the test view"

    def make_fitter(self) -> SceneFitter:
        """Make the fitter with the options of the label."""
        device = {} if self.device == "cpu" else {"device": self.device}
        with self.guard("cannot be made", RenderError):
            kind: type[SceneFitter] = resolve_name(self.fitter)
            return build_table(
                kind, {**self.options, **device}, f"method {self.title}", "", RenderError
            )

    def require(self) -> None:
        """Make its fitter."""
        self.make_fitter()

    def identity(self, unit: RenderUnit) -> dict[str, Any]:
        """Return the fit, which has not used the rendered views, and the places of the targets."""
        return {"fit": self._fit(unit).sha256, "shots": unit.identity_of_shots()}

    def scene(self, unit: RenderUnit) -> FittedScene:
        """Load the fit.

        Raises:
            ViewRefusedError: a plug-in failed to fit it.
        """
        fit = self._fit(unit)
        if not fit.is_done():
            raise RenderError(
                f"{fit.name}: wanted its scene in {fit.folder}, got none; render again, which fits "
                f"it first"
            )
        if reason := read_json(fit.folder / JOB_FILE).get(REFUSED):
            raise ViewRefusedError(reason)
        return self.make_fitter().load(fit.folder)

    def configured(self, label: str, variant: str) -> "FittedMethod":
        """Return the method with other options of its fitter, and another seed."""
        values = option_values(variant)
        words = option_words(values)
        seed = values.pop("seed", 0)
        if type(seed) is not int or seed < 0:
            raise RenderError(
                f"method {label}: seed must be a whole number of 0 or more, got {seed!r}"
            )
        configured = replace(self, title=f"{self.title}, {words}", options=values, seed=seed)
        configured.make_fitter()
        return configured

    def on(self, device: str) -> "FittedMethod":
        """Return the method on a device, where its fitter takes one."""
        takes_device = "device" in [option.name for option in fields(resolve_name(self.fitter))]
        return replace(self, device=device) if takes_device else self

    def _fit(self, unit: RenderUnit) -> Made:
        if unit.fit is None:
            raise RenderError(
                f"{self.title} is fitted per scene, got a run planned without it; prepare the run "
                f"with this method"
            )
        return unit.fit


FOUR_D = FittedMethod(
    "4DGS (compact)",
    "a cloud of Gaussians, moved by a HexPlane field or (motion=linear, polynomial) each alone, "
    "fit to the whole clip",
    "ggvs_eval.baselines.fitted.four_d:FourD",
    departs="starts from estimated depth; harmonics of degree 1; a smaller field; one image a "
    "step; black background",
)
PER_INSTANT = FittedMethod(
    "3DGS per Instant",
    "a cloud of Gaussians fitted to each instant alone: no temporal coupling",
    "ggvs_eval.baselines.fitted.per_instant:PerInstant",
    online=True,
    departs="starts from estimated depth; fewer steps; harmonics of degree 1; opacity never reset",
)
STREAM = FittedMethod(
    "3DGStream (compact)",
    "the cloud of the previous instant, moved by a small field and completed, with seconds of "
    "fitting per instant",
    "ggvs_eval.baselines.fitted.stream:Stream",
    online=True,
    departs="starts from estimated depth; dense planes in place of hash grids; harmonics do not "
    "turn",
)


@dataclass(frozen=True)
class StoredSplats(SceneMethod):
    """A method that renders Gaussians which others have fitted.

    Attributes:
        path: of their files, see `splats_files`.
    """

    path: Path

    named = staticmethod(named_splats)

    @property
    def modules(self) -> tuple[str, ...]:
        """See `MethodSpec.modules`."""
        return reading_modules(self.path)

    @property
    def notes(self) -> list[str]:
        """What is passed over in its files, and what is assumed."""
        return splats_notes(self.path)

    @classmethod
    def of(cls, label: str, path: Path) -> "StoredSplats":
        """Return the method of a label, which is its title too."""
        describe = f"fitted 3D Gaussians, {path.name}, rendered by this package"
        return cls(label, describe, path.resolve(), online=False, uses_depth=False)

    @property
    def learned_from(self) -> str:
        """The capture; whether the test views were among it is unknown."""
        return "this capture, by others"

    def require(self) -> None:
        """Open the files."""
        open_splats(self.path)

    def identity(self, unit: RenderUnit) -> dict[str, Any]:
        """Return the files, the settings next to them, the clip that they belong to, and the places
        of the targets.

        Raises:
            RenderError: a sequence that lacks an instant, before anything is prepared.
        """
        instants, settings = [0, unit.capture.n_frames], splats_settings(self.path).files
        require_instants(self.path, [frame for _, frame, _ in unit.shots], unit.capture.n_frames)
        stated = {"settings": digest_files(settings)} if settings else {}
        return {
            "splats": digest_files(splats_files(self.path)),
            "instants": instants,
            "shots": unit.identity_of_shots(),
        } | stated

    def scene(self, unit: RenderUnit) -> FittedScene:
        """Open the files."""
        return open_splats(self.path, range(unit.capture.n_frames))
