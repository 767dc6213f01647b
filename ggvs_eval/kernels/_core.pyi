"""The compiled geometric kernels; ggvs_eval.geometry explains the arguments."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]
Matrix = NDArray[np.float64]  # (4, 4), rigid
Pinhole = tuple[float, float, float, float, int, int]  # fx, fy, cx, cy, width, height

def best_level() -> int: ...
def splat(
    sources: Sequence[tuple[Pinhole, Matrix, Image, Image]],  # camera, to_target, depth, features
    target: Pinhole,
    near: float,
    scale: float,
    channels: int,
    normalised: bool,
    threads: int,
    level: int,
) -> tuple[Image, Image, Image]: ...
def fusion_weights(depth: Image, tau: float, depth_noise: float, threads: int, level: int) -> Image: ...
def ray_march(
    target: Pinhole,
    range: tuple[float, float],
    views: Sequence[tuple[Pinhole, Matrix, Image, Image, Image | None, float]],  # camera, from_target, depth, weight, gain, limit
    tau: float,
    step_fraction: float,
    min_step: float,
    bisections: int,
    skip_empty: bool,
    threads: int,
    level: int,
) -> tuple[Image, Image]: ...
def warp(
    target: Pinhole,
    target_depth: Image,
    source: Pinhole,
    from_target: Matrix,
    image: Image,
    source_depth: Image,
    tolerance: float,
    bicubic: bool,
    threads: int,
) -> tuple[Image, Image]: ...
