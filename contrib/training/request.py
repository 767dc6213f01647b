"""Request to `ggvs-eval train`, for one network or for all, and the words of the command line that make it."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ggvs_eval.contrib.training.options import TrainingOptions
from ggvs_eval.contrib.training.samples.data_options import DataOptions

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
        configuration: baselines: compact, which an hour of one core trains, or full, as the authors publish it.
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
