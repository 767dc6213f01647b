"""The compiled geometric kernels; ggvs_eval.geometry explains the arguments."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]
Image8 = NDArray[np.uint8]
Matrix = NDArray[np.float64]  # (4, 4), rigid
Pinhole = tuple[float, float, float, float, int, int]  # fx, fy, cx, cy, width, height
Forgiven = tuple[float, float]  # slack and far, as blend.hpp has them

def best_level() -> int: ...
def idle_bytes() -> int: ...
def forget_idle() -> None: ...
def empty(shape: Sequence[int]) -> Image: ...
def splat(
    sources: Sequence[
        tuple[Pinhole, Matrix, Image, Image | Image8, Image | None]
    ],  # camera, to_target, depth, features, extra
    target: Pinhole,
    near: float,
    scale: float,
    channels: int,
    normalised: bool,
    threads: int,
    level: int,
) -> tuple[Image, Image, Image]: ...
def fusion_weights(
    depth: Image, tau: float, depth_noise: float, threads: int, level: int
) -> Image: ...
def ray_march(
    target: Pinhole,
    range: tuple[float, float],
    views: Sequence[
        tuple[Pinhole, Matrix, Image, Image, Image | None, float]
    ],  # camera, from_target, depth, weight, gain, limit
    tau: float,
    step_fraction: float,
    min_step: float,
    skip_empty: bool,
    threads: int,
    level: int,
) -> tuple[Image, Image]: ...
def warp(
    target: Pinhole,
    target_depth: Image,
    source: Pinhole,
    from_target: Matrix,
    image: Image
    | tuple[Image8, Image8],  # or now and before, whose difference over 255 is looked up
    source_depth: Image,
    forgiven: Forgiven,
    tolerance: float,
    bicubic: bool,
    threads: int,
    level: int,
) -> tuple[Image, Image]: ...
def colour_change(now: Image8, before: Image8, cells: tuple[int, int], threads: int) -> Image: ...
def mix_depth(
    depth: Image, history: Image, mask: Image, tolerance: float, threads: int
) -> Image: ...
def weighted_mean(
    views: Sequence[tuple[Image, Image, float]],  # colour, weight, factor
    size: tuple[int, ...],
    threads: int,
) -> Image: ...
def largest_feature(
    views: Sequence[tuple[Image, Image]],  # features, alpha
    channel: int,
    size: tuple[int, ...],
    least_alpha: float,
    otherwise: float,
    threads: int,
) -> Image: ...
def look_up(
    target: Pinhole,
    depth: Image,
    views: Sequence[
        tuple[Pinhole, Matrix, Image8, Image, Forgiven, float]
    ],  # camera, from_target, image, depth, .., factor
    background: Image,
    tolerance: float,
    threads: int,
    level: int,
) -> Image: ...
def settle_depth(
    target: Pinhole,
    fused: Image,
    views: Sequence[
        tuple[Pinhole, Matrix, Image8, Image, Image, float]
    ],  # camera, from_target, image, alpha, depth, weight
    tolerance: float,
    least_alpha: float,
    least_share: float,
    ratio: float,
    threads: int,
) -> Image: ...
def shade(image: Image8, gain: Image, down: Image, across: Image, threads: int) -> Image8: ...
def remember(
    depth: Image,
    still: Image,
    alphas: Sequence[Image],
    rules: tuple[float, float, float, float, float, float],  # as remember.hpp has them
    image: Image,
    past: Image,
    past_depth: Image,
    threads: int,
) -> None: ...
def recur(
    now: Image, past: Image, cells: Image, threads: int
) -> Image: ...  # cells as recur.hpp has them
def push_pull(colour: Image, known: NDArray[np.bool_], out: Image, threads: int) -> None: ...
def register_views(
    target: Pinhole,
    depth: Image,
    views: Sequence[
        tuple[Pinhole, Matrix, Image8, Image, Forgiven, Image, Image]
    ],  # as look_up has them, splat, its alpha
    tolerance: float,
    faint: float,
    threads: int,
    level: int,
) -> tuple[Image, Image, Image]: ...
def overview(
    colours: Image,
    coverage: Image,
    seen: Image,
    alphas: Sequence[Image],
    depths: Sequence[Image],
    weights: Image,
    scale: int,
    covered_alpha: float,
    threads: int,
    level: int,
) -> tuple[Image, Image, NDArray[np.bool_], tuple[Image, Image, Image, Image], Image]: ...
def register_and_overview(
    target: Pinhole,
    depth: Image,
    views: Sequence[
        tuple[Pinhole, Matrix, Image8, Image, Forgiven, Image, Image]
    ],  # as register_views takes them
    tolerance: float,
    faint: float,
    depths: Sequence[Image],
    weights: Image,
    scale: int,
    covered_alpha: float,
    threads: int,
    level: int,
) -> tuple[
    tuple[Image, Image, Image],
    tuple[Image, Image, NDArray[np.bool_], tuple[Image, Image, Image, Image], Image],
]: ...  # what register_views gives, and what overview does
def network_inputs(
    colours: Image,
    depths: Image,
    alphas: Image,
    seen: Image | None,
    fused: Image,
    rays: tuple[Image, Image],  # slopes across, slopes down
    cameras: tuple[Image, Image, Image],  # centres (K, 3), distances, cosines of the axes
    far: float,
    unit: float,
    most_views: int,
    threads: int,
) -> Image: ...
def compose(
    colours: Image,
    coverage: Image,
    unseen: Image,
    background: Image,
    small: Image,
    scale: int,
    sure: float,
    threads: int,
    level: int,
) -> tuple[Image, Image, Image]: ...
def read_outputs(
    raw: Image,
    logarithms: Image,
    coverage: Image,
    seen: Image,
    most_views: int,
    sure: float,
    threads: int,
    level: int,
) -> tuple[Image, Image]: ...
def refine(
    picture: Image,
    spread: Image,
    shown: Image,
    depth: Image,
    small: Image,
    scale: int,
    first_feature: int,
    layers: Sequence[
        tuple[Image, Image, int]
    ],  # packed filters, bias, after; last weights (before, filled up), bias, after
    threads: int,
    level: int,
) -> Image: ...
def pack_filters(
    weights: Image, bias: Image
) -> tuple[Image, Image]: ...  # (after, before, 3, 3), (after), for refine and unet
def unet(
    channels: Image,
    layers: Sequence[
        tuple[Image, Image, Image, Image]
    ],  # packed filters, bias, gain, shift, in order of use
    last: tuple[Image, Image],  # weights (outputs, width), bias
    epsilon: float,
    threads: int,
    level: int,
) -> Image: ...
def pool_views(
    layers: Sequence[
        tuple[Image, Image]
    ],  # weights (before, padded), bias (padded), see pooling_kernel.packed_layers
    norm: Image,  # (2, 16)
    closeness: float,
    views: Sequence[
        tuple[Image, Image, Image, Image]
    ],  # image (H, W, 3), features (h, w, 32), projection (3, 4), centre (3)
    centre: Image,  # (3,)
    rays: Image,  # (R, 3)
    depths: Image,  # (R, S)
    places: Image,  # (S, 16)
    level: int,
) -> tuple[Image, Image]: ...  # colours (R, S, 3), density (R, S)
