"""The compiled deformation field; ggvs_eval.baselines.fitted.hexplane explains the arguments."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]

def evaluate(
    points: Array,  # (N, 3)
    box: Array,  # (2, 3)
    time: float,
    planes: tuple[Array, ...],  # (1, channels, second axis, first axis) each, level by level
    axes: Sequence[tuple[int, int]],  # of a level's planes
    layers: tuple[Array, ...],  # weights and biases: of the trunk, then of both layers of each head
    threads: int,
    level: int,
) -> tuple[Array, ...]: ...
def gradients(
    points: Array,
    box: Array,
    time: float,
    planes: tuple[Array, ...],
    axes: Sequence[tuple[int, int]],
    layers: tuple[Array, ...],
    by_outputs: tuple[Array, ...],
    threads: int,
    level: int,
) -> tuple[Array, tuple[Array, ...], tuple[Array, ...]]: ...
