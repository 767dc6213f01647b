"""The compiled features of frames; the headers of their names explain the arguments."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Map = NDArray[np.float32]  # (H, W, C)
Vector = NDArray[np.float32]

def pack_filters(filters: NDArray[np.float32], threads: int) -> Vector: ...  # (after, before, 3, 3)
def feature_maps(
    frame: Map, layers: Sequence[tuple[Vector, Vector, bool]], threads: int, level: int
) -> list[Map]: ...
def compare_banded(
    frames: Sequence[Map],
    layers: Sequence[tuple[Vector, Vector, bool]],
    weights: Sequence[Vector],
    threads: int,
    level: int,
) -> tuple[list[Map], list[list[NDArray[np.float32]]]]: ...
def compare_features(
    ours: Map, theirs: Map, weights: Vector, threads: int, level: int
) -> NDArray[np.float32]: ...
