"""IterMVS as a choice: its weights and where they lie, its options; importing it does not import torch."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ggvs_eval.metrics.image.fetch_lpips import cache_folder

PUBLISHED = "https://github.com/FangjinhuaWang/IterMVS, checkpoints/blendedmvs/model_000015.ckpt"


def cached_weights() -> Path:
    """The weights that are taken where a user names none, present or not: itermvs-blendedmvs.ckpt in the cache folder."""
    return cache_folder() / "itermvs-blendedmvs.ckpt"


@dataclass(frozen=True)
class IterMvs:
    """IterMVS with all partners at once.

    Attributes:
        weights_sha256: of its content; other weights, other depth.
        partners: how many cameras a camera is matched with at most; they need no common rectification.
        iterations: of the recurrent unit; the authors take four.
        precision: of convolutions; features, projections and the recurrent state are float32 in any case.
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
