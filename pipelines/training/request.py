"""Request to `ggvs-eval train`, for one network or for all, and the words of the command line that make it."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

Size = Literal["small", "standard", "large"]
Guidance = Literal["registered", "channels", "none", "naive"]
Configuration = Literal["compact", "full"]
Precision = Literal["auto", "float32", "bfloat16"]

LEARNED = ("steps", "seed")
VIEWED = ("views", "rooms", "targets", "domains", "captures", "hold_back")
OF_BLEND = (*LEARNED, "guidance", "size", *VIEWED, "start_from")
OF_BASELINES = (*LEARNED, "configuration", *VIEWED, "start_from")
HOW = ("device", "precision", "workers", "compile_network")  # change nothing that is learned but by rounding


@dataclass(frozen=True)
class TrainingRequest:
    """Request for the training of one network or of all.

    Attributes:
        steps: of the whole training, those of earlier calls included.
        seed: of the weights and the scenes.
        views: blend, baselines: the most source views of a sample, K; blend takes no more, and learns from two views on.
        size: blend: of the U-Net; its first level has 8, 16 or 32 channels.
        guidance: blend: what it sees of the fused depth: views registered by it, its channels as the paper prints them, none
            of it (ablation), or no depth at all (naive).
        rooms: blend, baselines: rooms to film of each domain, one to four minutes and 50 MB each.
        targets: blend, baselines: target views per room.
        domains: blend, baselines: kinds of captures to learn from and to choose by (plain, narrow, arc, ...); all of them
            unless named.
        configuration: baselines: compact, which an hour of one core trains, or full, as the authors publish it.
        captures: blend, baselines: folders of captures to learn from beside the rooms (RGB-D sequences by ScanNet's rule,
            Spaces, DyNeRF, rigs of your own), never those that you test on.
        hold_back: captures: RGB-D sequences are learned from in their first half, and what is new in the rest validates.
        device: cpu, cuda, or the better one by default; with NVIDIA Warp it computes the blending network's samples too.
        precision: of convolutions; auto takes bfloat16 where the hardware multiplies it faster.
        workers: processes that make batches.
        compile_network: let torch compile it first: some minutes once, a fifth less per step.
        start_from: weights to begin with where the folder holds no state, such as those that ship.
    """

    steps: int = 20000
    seed: int = 0
    views: int = 6
    size: Size = "standard"
    guidance: Guidance = "registered"
    rooms: int = 3
    targets: int = 9
    domains: tuple[str, ...] = ()
    configuration: Configuration = "compact"
    captures: tuple[Path, ...] = ()
    hold_back: bool = False
    device: str = "auto"
    precision: Precision = "auto"
    workers: int = 1
    compile_network: bool = False
    start_from: Path | None = None

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
    """The options that a network has."""
    return (*LEARNED, "start_from") if what == "stereo" else OF_BLEND if what == "blend" else OF_BASELINES


def _name(value: object) -> str:
    return value.name if isinstance(value, Path) else str(value)
