"""Pace of this machine: how long known work takes here, by a probe of a fraction of a second."""

from functools import cache
from time import perf_counter

import cv2
import numpy as np

REFERENCE_S = 0.40  # of the probe on the machine for which times are given: two quiet cores of a Xeon with AVX-512
SIZE, PRODUCTS, MATCHES = 768, 60, 10


@cache
def pace() -> float:
    """Seconds that work takes here for each second on the reference machine; cores that are busy now count as slow ones."""
    return probe_s() / REFERENCE_S


def probe_s() -> float:
    """Seconds of the work that evaluations mostly do: products of matrices, as of convolutions, and semi-global matching."""
    random = np.random.default_rng(0)
    matrix = random.random((SIZE, SIZE), np.float32)
    image = random.integers(0, 256, (360, 480), np.uint8)
    matcher = cv2.StereoSGBM.create(0, 64, 3)
    started = perf_counter()
    for _ in range(PRODUCTS):
        matrix @ matrix
    for _ in range(MATCHES):
        matcher.compute(image, image)
    return perf_counter() - started
