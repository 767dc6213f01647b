"""Options of `ggvs-eval train`, for one network or for all, and the words of the command line that
ask for them.
"""

from collections.abc import Callable
from dataclasses import Field, dataclass, field, fields, make_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

Precision = Literal["auto", "float32", "bfloat16"]
Size = Literal["small", "standard", "large"]
Guidance = Literal["registered", "channels", "none", "naive"]
Configuration = Literal["compact", "full"]
BASELINES = "baselines"  # represents each of them where a field says which trainings use it
STEREO, BLEND, ALL = "stereo", "blend", "all"
EVERY, OF_VIEWS = (STEREO, BLEND, BASELINES, ALL), (BLEND, BASELINES, ALL)
USED_BY, DECIDES = "used by", "decides what is learned"


def _of(*trainings: str, decides: bool = True) -> dict[str, Any]:
    """Metadata of a field: the trainings that use it, and whether it changes the result by more
    than rounding.
    """
    return {USED_BY: trainings, DECIDES: decides}


@dataclass(frozen=True)
class TrainingOptions:
    """Options of the training of one network or of all; a field says which trainings use it.

    Attributes:
        steps: total training steps, earlier calls included.
        seed: seed of the weights and the scenes.
        guidance: network input from fused depth: registered, channels (as in the paper), none, or
            naive.
        size: size of the blending network's U-Net: 8, 16 or 32 channels in its first level.
        configuration: baseline size: compact (about one CPU-hour) or full (the published
            architecture).
        crop: width and height of training crops, multiples of 8 pixels; the recipe's by default.
        views: maximum number of source views per sample, K.
        rooms: rooms per domain, one to four minutes and 50 MB each.
        targets: target views per room.
        domains: kinds of captures for training and validation (plain, narrow, arc, ...).
        captures: captures to train on besides the rooms; never those that you test on.
        hold_back: train on the first half of each RGB-D sequence, validate on new content of the
            rest.
        start_from: initial weights, if the folder has no state; lowers the learning rate.
        device: cpu, cuda or auto.
        precision: precision of convolutions; auto: bfloat16 where it is faster.
        workers: processes that make batches.
        compile_network: compile with torch first: a few minutes once, a fifth less per step.
        save_every: steps between checkpoints; not an option of the command line.
        validate_every: steps between validations.
    """

    steps: int = field(default=20000, metadata=_of(*EVERY))
    seed: int = field(default=0, metadata=_of(*EVERY))
    guidance: Guidance = field(default="registered", metadata=_of(BLEND))
    size: Size = field(default="standard", metadata=_of(BLEND, ALL))
    configuration: Configuration = field(default="compact", metadata=_of(BASELINES, ALL))
    crop: tuple[int, int] | None = field(default=None, metadata=_of(BASELINES))
    views: int = field(default=6, metadata=_of(*OF_VIEWS))
    rooms: int = field(default=3, metadata=_of(*OF_VIEWS))
    targets: int = field(default=9, metadata=_of(*OF_VIEWS))
    domains: Annotated[
        tuple[str, ...], tyro.conf.arg(metavar="DOMAIN ...", help_behavior_hint="(default: all)")
    ] = field(default=(), metadata=_of(*OF_VIEWS))
    captures: Annotated[
        tuple[Path, ...],
        tyro.conf.arg(metavar="CAPTURE ...", help_behavior_hint="(none by default)"),
    ] = field(default=(), metadata=_of(*OF_VIEWS))
    hold_back: bool = field(default=False, metadata=_of(*OF_VIEWS))
    start_from: Path | None = field(default=None, metadata=_of(STEREO, BLEND, BASELINES))
    device: str = field(default="auto", metadata=_of(*EVERY, decides=False))
    precision: Precision = field(default="auto", metadata=_of(*EVERY, decides=False))
    workers: int = field(default=1, metadata=_of(*EVERY, decides=False))
    compile_network: bool = field(default=False, metadata=_of(*EVERY, decides=False))
    save_every: int = field(default=100, metadata=_of(decides=False))
    validate_every: int = field(default=500, metadata=_of(decides=False))

    def words(self, name: str) -> list[str]:
        """Return the options that ask for the training of a network, how it is computed included,
        as `ggvs-eval` takes them.
        """
        return self._options(_used_by(name), str)

    def card_words(self, name: str) -> list[str]:
        """Return the options that decide what the network learns, without the folders that captures
        and weights are in.
        """
        return self._options(
            [option for option in _used_by(name) if option.metadata[DECIDES]], _name
        )

    def _options(self, options: list[Field[Any]], text: Callable[[object], str]) -> list[str]:
        words = []
        for option in options:
            value = getattr(self, option.name)
            if value is None or value is False or value == ():
                continue
            words.append("--" + option.name.replace("_", "-"))
            if value is not True:
                words += [text(part) for part in (value if isinstance(value, tuple) else (value,))]
        return words


def options_class(name: str) -> type:
    """Return the class of those options that the training of a network uses, by which the command
    line shows no others.
    """
    options = [
        (option.name, option.type, field(default=option.default)) for option in _used_by(name)
    ]
    return make_dataclass(
        "UsedOptions", options, namespace={"__doc__": TrainingOptions.__doc__}, frozen=True
    )


def _used_by(name: str) -> list[Field[Any]]:
    training = name if name in EVERY else BASELINES
    return [option for option in fields(TrainingOptions) if training in option.metadata[USED_BY]]


def _name(value: object) -> str:
    return value.name if isinstance(value, Path) else str(value)
