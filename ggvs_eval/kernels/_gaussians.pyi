"""The compiled splat of 3D Gaussians; ggvs_eval.gaussians explains the arguments."""

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.float32]
# means (N, 3), log_scales (N, 3), quaternions (N, 4), opacity_logits (N,), sh (N, terms, 3), screen
# offsets (N, 2) or None
Cloud = tuple[Rows | None, ...]
TILE: int

class Frame: ...

def render(
    cloud: Cloud,
    camera: tuple[float, float, float, float, int, int],  # fx, fy, cx, cy, width, height
    world_to_camera: NDArray[np.float64],
    centre: NDArray[np.float64],
    near: float,
    slope_margin: float,
    threads: int,
    level: int,
) -> tuple[Rows, Rows, Rows, NDArray[np.int32], Frame]: ...
def gradients(
    frame: Frame,
    cloud: Cloud,
    by_colour: Rows,
    by_transmittance: Rows,
    by_depth: Rows,
    threads: int,
    level: int,
) -> tuple[Rows, Rows, Rows, Rows, Rows, Rows]: ...
