"""Request to `ggvs-eval train`, for one network or for all, the words of the command line that make it, and its options."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

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


Precision = Literal["auto", "float32", "bfloat16"]


@dataclass(frozen=True)
class LoopOptions:
    """Options of the training loop; none changes the result but `steps`, `seed`, `precision` and the device.

    Attributes:
        steps: of the whole training, those of earlier calls included.
        seed: of the weights and the scenes.
        device: cpu, cuda, or the better one by default.
        precision: of convolutions; auto takes bfloat16 where the hardware multiplies it faster.
        workers: processes that make batches.
        compile_network: let torch compile it first: some minutes once, a fifth less per step.
    """

    steps: int = 20000
    seed: int = 0
    device: str = "auto"
    precision: Precision = "auto"
    workers: int = 1
    compile_network: bool = False


@dataclass(frozen=True)
class TrainingOptions(LoopOptions):
    """Options of a training, those that the command line does not show included.

    Attributes:
        start_from: weights that a training without a state begins with, such as those that ship.
        save_every: steps between checkpoints.
        validate_every: steps between validations.
    """

    start_from: Path | None = None
    save_every: int = 100
    validate_every: int = 500


Size = Literal["small", "standard", "large"]
Guidance = Literal["registered", "channels", "none", "naive"]
Configuration = Literal["compact", "full"]

LEARNED = ("steps", "seed")
VIEWED = ("views", "rooms", "targets", "domains", "captures", "hold_back")
OF_BLEND = (*LEARNED, "guidance", "size", *VIEWED, "start_from")
OF_BASELINES = (*LEARNED, "configuration", "crop", *VIEWED, "start_from")
HOW = ("device", "precision", "workers", "compile_network")  # change nothing that is learned but by rounding


@dataclass(frozen=True)
class TrainingRequest(TrainingOptions, DataOptions):
    """Request for the training of one network or of all.

    Attributes:
        size: blend: of the U-Net; its first level has 8, 16 or 32 channels.
        guidance: blend: what it sees of the fused depth: views registered by it, its channels as the paper prints them, none
            of it (ablation), or no depth at all (naive).
        configuration: baselines: compact (about one CPU-hour) or full (the published architecture).
        crop: baselines: width and height of the target's crops, pixels; empty takes those of the recipe, for an hour of one core.
    """

    size: Size = "standard"
    guidance: Guidance = "registered"
    configuration: Configuration = "compact"
    crop: tuple[int, int] | tuple[()] = ()

    def words(self, what: str) -> list[str]:
        """The options that ask for the training of a network, how it is computed included, as `ggvs-eval` takes them."""
        return self._options((*_named(what), *HOW), str)

    def card_words(self, what: str) -> list[str]:
        """The options that decide what the network learns, without the folders that captures and weights lie in."""
        return self._options(_named(what), _name)

    def _options(self, fields: tuple[str, ...], text: Callable[[object], str]) -> list[str]:
        words = []
        for field in fields:
            value = getattr(self, field)
            if value is None or value is False or value == ():
                continue
            words.append("--" + field.replace("_", "-"))
            if value is not True:
                words += [text(each) for each in (value if isinstance(value, tuple) else (value,))]
        return words


def _named(what: str) -> tuple[str, ...]:
    return (*LEARNED, "start_from") if what == "stereo" else OF_BLEND if what == "blend" else OF_BASELINES


def _name(value: object) -> str:
    return value.name if isinstance(value, Path) else str(value)
