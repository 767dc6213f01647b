"""IterMVS as a choice: its weights and where they lie, its options; importing it does not import torch."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

from ggvs_eval.errors import WeightsError
from ggvs_eval.metrics.image.fetch_lpips import cache_folder

PUBLISHED = "https://github.com/FangjinhuaWang/IterMVS, checkpoints/blendedmvs/model_000015.ckpt"


def cached_weights() -> Path:
    """The weights that are taken where a user names none, present or not: itermvs-blendedmvs.ckpt in the cache folder."""
    return cache_folder() / "itermvs-blendedmvs.ckpt"


@dataclass(frozen=True)
class IterMvs:
    """IterMVS with all partners at once.

    Attributes:
        weights: file of the weights.
        weights_sha256: of its content; other weights, other depth.
        partners: how many cameras a camera is matched with at most; they need no common rectification.
        iterations: of the recurrent unit; the authors take four.
        device: where the network computes.
    """

    weights: Path
    weights_sha256: str
    partners: int = 6
    iterations: int = 4
    device: str = "cpu"

    @property
    def name(self) -> str:
        """Names the algorithm."""
        return "itermvs"


def itermvs_of(file: str, device: str = "cpu") -> IterMvs:
    """IterMVS with the weights of a file, or with those in the cache folder where none is named.

    Raises:
        WeightsError: absent, damaged, or not IterMVS's weights.
    """
    from ggvs_eval.pipelines.offline.itermvs.estimator import load_network

    path = Path(file) if file else cached_weights()
    if not path.is_file():
        raise WeightsError(f"{path}: wanted weights of IterMVS, got no file; its authors publish them: {PUBLISHED}")
    load_network(path)  # what is wrong with it is said before hours of work
    return IterMvs(path, hashlib.sha256(path.read_bytes()).hexdigest(), device=device)
