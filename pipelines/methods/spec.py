"""Specification of a method: its name, options, identity and rendering, also at a fraction of the
size.
"""

import hashlib
import tomllib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, nullcontext
from copy import deepcopy
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cache, partial
from importlib import resources
from pathlib import Path
from pkgutil import resolve_name
from time import perf_counter
from typing import TYPE_CHECKING, Any, ClassVar

import cv2
import numpy as np

from ggvs_eval.arrays import Map
from ggvs_eval.camera import Camera
from ggvs_eval.errors import GgvsError, RenderError, ViewRefusedError, WeightsError
from ggvs_eval.files.toml_tables import build_table
from ggvs_eval.method import Instant, LookaheadMethod, Method, Rendering, SourceView
from ggvs_eval.pipelines.methods.render_unit import RenderUnit
from ggvs_eval.plugins import foreign

if TYPE_CHECKING:
    from ggvs_eval.scene_fitter import FittedScene

SMALLEST_PX = 16  # of the shorter side


class AtScale:
    """A method that renders small pictures for a large screen.

    Both changes of size are stages of its time.

    Args:
        method: a fresh one.
        scale: of both sides, in (0, 1).

    Reading:
        Sources are averaged over areas; their depth is that of the nearest pixel, since means of
        two surfaces are on none. The picture is enlarged by cubic interpolation, as screens do.
    """

    def __init__(self, method: Method, scale: float) -> None:
        self._method, self._scale = method, scale

    def step(self, instant: Instant) -> Rendering:
        """See `ggvs_eval.method.Method.step`."""
        begun = perf_counter()
        target = instant.target
        small_target = target.resized(*self._small(*target.size))
        small = replace(
            instant, target=small_target, sources=tuple(map(self._shrunk, instant.sources))
        )
        shrunk = perf_counter()
        rendering = self._method.step(small)
        rendered = perf_counter()
        image = np.clip(
            cv2.resize(rendering.image, target.size, interpolation=cv2.INTER_CUBIC), 0.0, 1.0
        )
        depth = None if rendering.depth is None else _nearest(rendering.depth, target.size)
        seconds = {
            "shrink": shrunk - begun,
            **rendering.seconds,
            "enlarge": perf_counter() - rendered,
        }
        return replace(rendering, image=np.asarray(image, np.float32), depth=depth, seconds=seconds)

    def _small(self, width: int, height: int) -> tuple[int, int]:
        scale = max(self._scale, min(SMALLEST_PX / min(width, height), 1.0))
        return round(width * scale), round(height * scale)

    def _shrunk(self, source: SourceView) -> SourceView:
        size = self._small(*source.camera.size)
        image = np.asarray(cv2.resize(source.image, size, interpolation=cv2.INTER_AREA), np.uint8)
        depth, confidence = _nearest(source.depth, size), _nearest(source.confidence, size)
        return replace(
            source,
            camera=source.camera.resized(*size),
            image=image,
            depth=depth,
            confidence=confidence,
        )


def _nearest(values: Map, size: tuple[int, int]) -> Map:
    return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_NEAREST), np.float32)


LEARNED = "learned from"  # column of what methods declare
TAKEN = ("options", "weights", "device")  # keywords that are in a label, or recorded apart


def shipped(name: str) -> Path:
    """Return a file of trained weights that ships."""
    return Path(str(resources.files("ggvs_eval.pipelines") / "weights" / name))


@dataclass(frozen=True)
class MethodSpec(ABC):
    """One method or variant of it.

    Attributes:
        title: how tables call it.
        describe: one line for the help and the report.
        ours: whether it is this project's method or an ablation of it.
        online: whether it sees nothing of the future.
        uses_depth: whether it looks at the depth of its sources, or learns a scene from it.
        device: where its networks compute, if it has any.
        departs: what is not as its authors published it.
        foreign: whether a plug-in offers it: what goes wrong in it refuses the view.
        preparation: a run's preparation that it cannot be rendered without; see
            `built_in.PREPARATIONS`.
    """

    preparation: ClassVar[str] = ""
    title: str
    describe: str
    _: KW_ONLY
    ours: bool = False
    online: bool = True
    uses_depth: bool = True
    device: str = "cpu"
    departs: str = ""
    foreign: bool = False

    @property
    @abstractmethod
    def modules(self) -> tuple[str, ...]:
        """Of its classes; a change in their rooms makes its renders stale."""

    @property
    @abstractmethod
    def learned_from(self) -> str:
        """Training data of its weights or its scene."""

    @property
    def declared(self) -> dict[str, str]:
        """Differences from other methods by design, which no protocol removes: head of a column ->
        text.
        """
        return {
            "depth": "given" if self.uses_depth else "none",
            LEARNED: self.learned_from,
            "not as published": self.departs or "-",
        }

    @property
    def settings(self) -> dict[str, Any]:
        """Options of its classes that the label fixes, by name.

        Neither files nor the device, which are recorded apart.
        """
        return {}

    @property
    def notes(self) -> list[str]:
        """What a user of it should know about its files, a line each."""
        return []

    @abstractmethod
    def make(self) -> Method:
        """Make a fresh object that renders one sequence.

        Raises:
            GgvsError: it cannot be made here, or makes no step.
        """

    @abstractmethod
    def require(self) -> None:
        """Find out whether it can be made here: its weights, its options.

        Raises:
            GgvsError: why not.
        """

    @abstractmethod
    def identity(self, unit: RenderUnit) -> dict[str, Any]:
        """Everything that the pixels of a unit depend on, besides the label, the code and the
        device.
        """

    @abstractmethod
    def renderings(self, unit: RenderUnit) -> Iterator[Rendering]:
        """Render the shots of a unit, one by one."""

    def guard(
        self, event: str, kind: type[GgvsError] = ViewRefusedError
    ) -> AbstractContextManager[None]:
        """Turn what its code raises in a block into an error that says what it did, where a plug-in
        offers it.
        """
        return foreign(f"method {self.title}: {event}", kind) if self.foreign else nullcontext()

    def configured(self, label: str, variant: str) -> "MethodSpec":
        """Return the method with the options that its label names.

        Raises:
            RenderError: options that it does not have.
        """
        raise RenderError(f"method {label}: {self.title} has no options to set, got {variant}")

    def on(self, _device: str) -> "MethodSpec":
        """Return the method with its networks on a device; one without networks stays as it is."""
        return self


@dataclass(frozen=True)
class OnlineMethod(MethodSpec):
    """A method that is shown one instant after the other.

    Attributes:
        maker: class of what renders one sequence, or its ``module:class``, which is imported only
            then.
        given: keywords of `maker` that the label, the user's weights and the device set, and
            ``scale``: a label such as ``enerf+scale=0.5`` has any method render at a fraction of
            the size.
        takes: keywords that may be set besides: ``device`` of its networks, ``weights`` for a
            checkpoint, and ``options``, which are `OnlineOptions`, for labels such as
            ``ours+beta_temporal=0.6``.
        weights: files of the trained weights it renders with.
        checkpoint: what the user has to give where none ship, and how; empty if `maker` takes no
            file.
        title_from: how tables call it then, if not by `title`: weights trained here are labelled
            so.
        options_type: dataclass of its ``options``, as ``module:class``.
        device_modules: what it renders with besides on a device that is not the CPU.
    """

    maker: str | Callable[..., Method]
    _: KW_ONLY
    given: Mapping[str, Any] = field(default_factory=dict)
    takes: tuple[str, ...] = ()
    weights: tuple[Path, ...] = ()
    checkpoint: str = ""
    title_from: str = ""
    options_type: str = "ggvs_eval.pipelines.online.geometry_guided:OnlineOptions"
    device_modules: tuple[str, ...] = ()

    @property
    def modules(self) -> tuple[str, ...]:
        """See `MethodSpec.modules`."""
        module = (
            self.maker.partition(":")[0] if isinstance(self.maker, str) else self.maker.__module__
        )
        return (module, *(self.device_modules if self.device != "cpu" else ()))

    @property
    def learned_from(self) -> str:
        """Other captures, and how many pixels of them where the weights say so."""
        # late, for the sake of a fast command line
        from ggvs_eval.files.weights_file import read_notes

        if not self.weights:
            return "nothing"
        pixels = [
            int(notes["pixels"]) for notes in map(read_notes, self.weights) if "pixels" in notes
        ]
        return "other captures" + "".join(
            f", {count / 1e6:,.0f} million pixels" for count in pixels
        )

    @property
    def settings(self) -> dict[str, Any]:
        """Options in `given` that the label fixes."""
        return {name: value for name, value in self.given.items() if name not in TAKEN}

    def make(self) -> Method:
        """Make a fresh object that renders one sequence."""
        arguments = dict(self.given)
        scale = arguments.pop("scale", None)
        if self.checkpoint and not self.weights:
            raise WeightsError(f"{self.title_from or self.title}: wanted weights {self.checkpoint}")
        if self.checkpoint:
            arguments.setdefault("weights", self.weights[0])
        maker = resolve_name(self.maker) if isinstance(self.maker, str) else self.maker
        make = partial(maker, **arguments)
        method = ForeignMethod(self.title, make) if self.foreign else make()
        return method if scale is None else AtScale(method, scale)

    def require(self) -> None:
        """Make one."""
        self.make()

    def identity(self, unit: RenderUnit) -> dict[str, Any]:
        """Return the settings, weights and inputs."""
        return {
            "settings": self.settings,
            "weights": [digest_weights(file) for file in self.weights],
            **unit.identity(),
        }

    def renderings(self, unit: RenderUnit) -> Iterator[Rendering]:
        """Yield the step through the instants; only the frames of one are in memory."""
        method = self.make()
        return map(method.step, unit.instants(method))

    def configured(self, label: str, variant: str) -> "OnlineMethod":
        """Return the method with other `OnlineOptions`, at a fraction of the size, or both.

        Raises:
            RenderError: unknown options, or an invalid scale.
        """
        values, arguments, departs = option_values(variant), dict(self.given), self.departs
        if "scale" in values:
            arguments["scale"] = scale = values.pop("scale")
            if type(scale) is not float or not 0 < scale < 1 or not self.online:
                raise RenderError(
                    f"method {label}: wanted a scale between 0 and 1 of a method that is online, "
                    f"got {scale!r}"
                )
        if values and "options" not in self.takes:
            raise RenderError(
                f"method {label}: {self.title} has no option but scale, got {', '.join(values)}"
            )
        if values:
            arguments["options"] = build_table(
                resolve_name(self.options_type), values, f"method {label}", "", RenderError
            )
            departs = f"{departs}, except for {', '.join(values)}" if departs else ""
        title = f"{self.title}, {variant.replace('+', ', ')}"
        return replace(self, title=title, given=arguments, departs=departs)

    def on(self, device: str) -> "OnlineMethod":
        """Return the method with its networks on a device."""
        if device == self.device or "device" not in self.takes:
            return self
        return replace(self, given={**self.given, "device": device}, device=device)

    def rendering_with(self, checkpoint: Path) -> "OnlineMethod":
        """Return the method with a file of weights that the user gave."""
        arguments, takes = (
            {**self.given, "weights": checkpoint},
            tuple(name for name in self.takes if name != "weights"),
        )
        return replace(
            self,
            title=self.title_from or self.title,
            given=arguments,
            takes=takes,
            weights=(checkpoint,),
        )


class ForeignMethod:
    """A method of a plug-in: a view that it fails in is one that it refuses, and it is shown
    copies.

    To copy four sources of 1352 x 1014 pixels with their depth takes 35 ms of a step, which no
    table counts. A method that does not time its stages has one, the whole step.
    """

    def __init__(self, title: str, factory: Callable[[], Method]) -> None:
        self._title = title
        with foreign(f"method {title}: cannot be made", RenderError):
            self._method = factory()
        if isinstance(self._method, LookaheadMethod):
            self.look_ahead = self._looked_ahead

    def step(self, instant: Instant) -> Rendering:
        """See `Method`.

        Raises:
            ViewRefusedError: any exception of the method, or no picture of numbers of the target's
                size.
        """
        with foreign(f"method {self._title}: failed at instant {instant.index}", ViewRefusedError):
            instant_copy = deepcopy(instant)
            begun = perf_counter()
            output = self._method.step(instant_copy)
            seconds = perf_counter() - begun
            rendering = _checked(output, instant.target)
            return rendering if rendering.seconds else replace(rendering, seconds={"step": seconds})

    def _looked_ahead(self, instants: Iterable[Instant]) -> None:
        with foreign(f"method {self._title}: failed to look ahead", ViewRefusedError):
            self._method.look_ahead(map(deepcopy, instants))  # type: ignore[attr-defined]


def _checked(output: Any, target: Camera) -> Rendering:
    shape = target.height, target.width, 3
    if not isinstance(output, Rendering) or not isinstance(output.image, np.ndarray):
        raise TypeError(
            "wanted a Rendering with an image, got "
            f"{type(getattr(output, 'image', output)).__name__}"
        )
    if (
        output.image.shape != shape
        or output.image.dtype.kind != "f"
        or not np.isfinite(output.image).all()
    ):
        got = f"{output.image.dtype} {output.image.shape}" + (
            ", not all finite" if output.image.shape == shape else ""
        )
        raise ValueError(f"wanted an image of floats in [0, 1], {shape}, got {got}")
    sum(output.seconds.values())  # numbers, or it raises
    return output


@dataclass(frozen=True)
class SceneMethod(MethodSpec):
    """A method that renders from a scene, which was made of a whole capture before.

    It makes no step.
    """

    @abstractmethod
    def scene(self, unit: RenderUnit) -> "FittedScene":
        """Open the scene of a unit."""

    def make(self) -> Method:
        """Refuse.

        Raises:
            RenderError: always.
        """
        raise RenderError(
            f"{self.title} is fitted to a whole capture and cannot be shown frame by frame; render "
            f"it with `ggvs-eval run`"
        )

    def renderings(self, unit: RenderUnit) -> Iterator[Rendering]:
        """Open the scene once and render every shot of it."""
        with self.guard("its scene cannot be opened"):
            scene = self.scene(unit)
        for _, frame, target in unit.shots:
            with self.guard(f"failed at instant {frame}"):
                output = scene.render(frame, deepcopy(target))
                rendering = _checked(output, target) if self.foreign else output
            yield rendering


def digest_weights(file: Path) -> str:
    """SHA-256 of a file's bytes, which are read once for as long as the file stays as it is."""
    stat = file.stat()
    return _digest_of(file, stat.st_size, stat.st_mtime_ns)


@cache
def _digest_of(file: Path, _size: int, _mtime_ns: int) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def option_values(variant: str) -> dict[str, Any]:
    """Return the options of a variant such as ``motion=linear+seed=1``: numbers and truth values as
    such, anything else a word.

    Examples:
        >>> option_values("motion=linear+seed=1")
        {'motion': 'linear', 'seed': 1}
    """
    return {
        name: _option_value(text)
        for name, _, text in (part.partition("=") for part in variant.split("+"))
    }


def option_words(values: Mapping[str, Any]) -> str:
    """Return the options as titles say them, in their order: what counts something is named in the
    plural.

    Examples:
        >>> option_words(
        ...     {
        ...         "motion": "linear",
        ...         "steps": 3000,
        ...         "seed": 1,
        ...         "save_every": 100,
        ...         "background": False,
        ...     }
        ... )
        'linear motion, 3,000 steps, seed 1, save every 100, no background'
    """
    return ", ".join(_words_of(name.replace("_", " "), value) for name, value in values.items())


def _words_of(name: str, value: Any) -> str:
    if isinstance(value, bool):
        return name if value else f"no {name}"
    if isinstance(value, str):
        return f"{value} {name}"
    return (
        f"{value:,} {name}" if isinstance(value, int) and name.endswith("s") else f"{name} {value}"
    )


def _option_value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
