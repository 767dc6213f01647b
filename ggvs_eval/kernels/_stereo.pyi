"""The compiled stereo kernels; the headers of their names explain the arguments."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]
Bytes = NDArray[np.uint8]
Row = NDArray[np.float32]
Motion = NDArray[np.float32]  # (7,): start, slope and origin in x and y each, along
Partner = tuple[Image, Row, Row, Bytes | None, Motion]  # image, first, last, visible, motion

TILE_SIZE: tuple[int, int]  # columns, rows
COST_LIMIT: int

def sweep_planes(
    reference: Image,
    guide: Bytes,
    partners: Sequence[Partner],
    window: tuple[int, float, float, float],  # radius, colour_scale, distance_scale, noise
    hidden_weight: float,
    planes: tuple[float, float, int],  # first, step, count
    ranges: NDArray[np.int32],
    threads: int,
    level: int,
) -> Bytes: ...
def aggregate(
    costs: Bytes, guide: Bytes, small_step: int, large_steps: Bytes, threads: int, level: int
) -> tuple[Image, Image]: ...
def match_blocks(
    left: Bytes,
    right: Bytes,
    count: int,
    radius: int,
    small_step: int,
    large_step: int,
    threads: int,
    level: int,
) -> NDArray[np.int16]: ...
def sample_matches(right: Bytes, disparity: Image) -> Image: ...
def refine_matches(
    left: Bytes,
    right: Bytes,
    slope: Image,
    disparity: Image,
    gain: float,
    window: int,
    iterations: int,
    largest_step: float,
    noise: float,
) -> Image: ...
def weighted_median(
    surface: Image,
    guide: Bytes,
    planes: int,
    radius: int,
    colour_scale: float,
    tolerance: float,
    threads: int,
) -> Image: ...
def enlarge_to_edges(
    depth: Image,
    confidence: Image,
    small_image: Bytes,
    image: Bytes,
    smooth: Image,
    same_surface: float,
    threads: int,
) -> tuple[Image, Image]: ...
