"""Equal inputs give equal bits, for any number of threads and on every instruction set that this
processor has.

Kernels whose inputs take a network or a scene to make are held to the same beside their other
tests: those of stereo, Gaussians, deformation fields and the blending network.
"""

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from ggvs_eval import kernels
from ggvs_eval.geometry.difference_mask import difference_mask
from ggvs_eval.geometry.per_pixel import largest_feature, weighted_mean
from ggvs_eval.geometry.splat import splat
from ggvs_eval.geometry.tsdf import fusion_weights, ray_march
from ggvs_eval.geometry.warp import look_up, warp, warp_change
from ggvs_eval.method import SourceView
from ggvs_eval.metrics.image.ssim import ssim_per_channel
from ggvs_eval.pipelines.online.blending import push_pull
from ggvs_eval.pipelines.online.network_blender import overview
from ggvs_eval.pipelines.online.network_inputs import network_channels
from ggvs_eval.pipelines.online.temporal_filters import filter_depth
from helpers.blender_inputs import random_maps
from helpers.geometry_scenes import (
    TAU,
    columns,
    random_camera,
    random_depth,
    random_previous,
    random_source,
    random_views,
    weighted_views,
)
from helpers.photographs import noisy_pair

Computation = Callable[[], tuple[np.ndarray, ...]]
WIDTH, HEIGHT = 150, 131  # neither is a multiple of a tile


def splatting(random: np.random.Generator) -> Computation:
    sources = [random_source(random, random_camera(random, 150, 110), 4) for _ in range(2)]
    target = random_camera(random, 170, 130)

    def compute() -> tuple[np.ndarray, ...]:
        result = splat(sources, target, near=0.2)
        return result.features, result.alpha, result.depth

    return compute


def marching(random: np.random.Generator) -> Computation:
    views, target = random_views(random, (130, 90), 3), random_camera(random, 121, 93)
    previous = random_previous(random, target)

    def compute() -> tuple[np.ndarray, ...]:
        march = ray_march(target, *columns(views), tau=TAU, previous=previous)
        return march.depth, march.weight, fusion_weights(views[0][1], TAU, 0.001)

    return compute


def warping(random: np.random.Generator) -> Computation:
    target, source = random_camera(random, 90, 70), random_camera(random, 80, 60)
    image = random.random((60, 80, 3), dtype=np.float32)
    depths = random_depth(random, target), random_depth(random, source)
    now, before = random.integers(0, 256, (2, 60, 80, 3)).astype(np.uint8)
    view = SourceView(source, now, depths[1], depths[1])

    def compute() -> tuple[np.ndarray, ...]:
        bilinear, bicubic = (
            warp(target, depths[0], source, image, depths[1], TAU, bicubic=way)
            for way in (False, True)
        )
        changed = warp_change(target, depths[0], view, before, TAU)
        return (
            bilinear.colour,
            bilinear.visibility,
            bicubic.colour,
            changed.colour,
            changed.visibility,
        )

    return compute


def looking_up(random: np.random.Generator) -> Computation:
    target, views = random_camera(random, WIDTH, HEIGHT), weighted_views(random, 3, (121, 97))
    depth, background = (
        random_depth(random, target),
        random.random((HEIGHT, WIDTH, 3), dtype=np.float32),
    )
    return lambda: (look_up(target, depth, *views, background, TAU),)


def mixing(random: np.random.Generator) -> Computation:
    colours = [random.random((HEIGHT, WIDTH, 4), dtype=np.float32) for _ in range(2)]
    maps = [random.random((HEIGHT, WIDTH), dtype=np.float32) for _ in range(2)]
    return lambda: (
        weighted_mean(colours, maps),
        largest_feature(colours, maps, channel=3, least_alpha=0.5, otherwise=1.0),
    )


def filling(random: np.random.Generator) -> Computation:
    image = random.random((HEIGHT, WIDTH, 3), dtype=np.float32)
    known = cv2.GaussianBlur(random.random((HEIGHT, WIDTH)), (0, 0), 2) > 0.5
    return lambda: (push_pull(image, known),)


def filtering(random: np.random.Generator) -> Computation:
    depth = random_depth(random, random_camera(random, WIDTH, HEIGHT))
    weight = random.random((HEIGHT, WIDTH), dtype=np.float32)
    now, before = random.integers(0, 256, (2, HEIGHT, WIDTH, 3)).astype(np.uint8)
    return lambda: (
        difference_mask(now, before),
        filter_depth(depth, depth * np.float32(1.01), weight, 0.05),
    )


def network_inputs(random: np.random.Generator) -> Computation:
    maps = random_maps(random, 130, 90, 4)

    def compute() -> tuple[np.ndarray, ...]:
        seen = overview(maps, 4)
        channels = network_channels(seen.small, "registered", 6)
        return seen.unseen, seen.picture, seen.covered, seen.small.colours, channels

    return compute


def similarity(random: np.random.Generator) -> Computation:
    pair = noisy_pair(300, 260)
    return lambda: (ssim_per_channel(*pair),)


COMPUTATIONS = (
    splatting,
    marching,
    warping,
    looking_up,
    mixing,
    filling,
    filtering,
    network_inputs,
    similarity,
)


@pytest.mark.usefixtures("kernel_settings")
@pytest.mark.parametrize("computation", COMPUTATIONS, ids=lambda computation: computation.__name__)
def test_neither_threads_nor_instruction_set_change_a_bit(computation):
    """1, 2 and 5 threads on every instruction set give the bits of the first."""
    compute = computation(np.random.default_rng(6))
    results = []
    for level in kernels.available_levels():
        kernels.set_simd_level(level)
        for threads in (1, 2, 5):
            kernels.set_threads(threads)
            results.append([array.tobytes() for array in compute()])
    assert all(result == results[0] for result in results[1:])
