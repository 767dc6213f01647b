"""IterMVS as a choice: its weights and their place, its options; importing it does not import torch."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

PUBLISHED = "https://github.com/FangjinhuaWang/IterMVS, checkpoints/blendedmvs/model_000015.ckpt"


@dataclass(frozen=True)
class IterMvs:
    """IterMVS with all partners at once.

    Attributes:
        weights_sha256: of its content; other weights, other depth.
        partners: how many cameras a camera is matched with at most; they need no common rectification.
        iterations: of the recurrent unit; the authors take four.
        precision: of convolutions; features, projections and the recurrent state are float32 in any case.

    Reading:
        On six pictures of three real captures, 640 pixels wide with four partners, float16 moves the median depth by 5e-5 to
        1.2e-4 of itself, 82 to 92 % of the pixels by less than 1e-3 and 95 to 99 % by less than 1e-2; of those that the network
        is sure of (confidence above 0.5) 98 to 100 % by less than 1e-3.
    """

    weights: Path
    weights_sha256: str
    partners: int = 6
    iterations: int = 4
    device: str = "cpu"
    precision: Literal["float32", "float16"] = "float32"

    @property
    def name(self) -> str:
        """Names the algorithm."""
        return "itermvs"
