"""The image-based TSDF in numpy and float64: its weights, and its march, which the package has as
it can be read otherwise.
"""

from functools import partial

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array
from ggvs_eval.pipelines.online.printed_march import FieldReading, printed_march


def fusion_weights_twin(depth: NDArray, tau: float, depth_noise: float) -> Array:
    """Eqs. 11-12: omega = min(noise / sqrt(nu / 49), 1), nu = sum of min((D[u, v] - D[p, q])^2,
    tau^2) over 7 x 7 pixels.
    """
    invalid = 1e18  # as far from everything as invalid and outside neighbours count
    D = np.where(depth > 0, depth.astype(np.float64), invalid)
    padded = np.pad(D, 3, constant_values=invalid)
    nu = np.zeros_like(D)
    for dy in range(7):
        for dx in range(7):
            nu += np.minimum((D - padded[dy : dy + D.shape[0], dx : dx + D.shape[1]]) ** 2, tau**2)
    with np.errstate(divide="ignore"):
        return np.where(depth > 0, np.minimum(depth_noise / np.sqrt(nu / 49), 1.0), 0.0)


# What `ggvs_eval.geometry.tsdf.ray_march` computes, without skipping anything.
ray_march_twin = partial(printed_march, reading=FieldReading())
