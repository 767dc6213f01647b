"""Cost of the metrics without truth on frames of the paper's size.

``python -m benchmarks.bench_no_reference``. The fastest call counts; next to the wall time is that
of the cores, which other programs on the machine disturb less. COLMAP's is of a path of `VIEWS`
views, per view.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.bench_full_reference import (
    HEIGHT,
    RUNS,
    WIDTH,
    Figure,
    elapsed_ms,
    frame_pair,
    time_figure,
)
from ggvs_eval.camera import Camera, translated_path
from ggvs_eval.contrib.more_metrics.colmap_consistency import colmap_consistency
from ggvs_eval.metrics.image.regions import moving_mask
from ggvs_eval.metrics.image.sharpness import sharpness
from ggvs_eval.metrics.path.view_consistency import warping_error
from ggvs_eval.metrics.series_scores import series_of_depths
from ggvs_eval.metrics.time.temporal_variation import mtv, mtv2

COMMAND = "python -m benchmarks.bench_no_reference"
VIEWS = 8
STEP_PX = 40  # between the views of COLMAP's path


def measure() -> dict[str, Figure]:
    """Return name -> figure, ms per frame."""
    first, second = frame_pair()
    third = np.roll(first, 1, axis=1)
    static = ~moving_mask(first, second)
    depths = list(np.random.default_rng(0).uniform(2, 8, (3, HEIGHT, WIDTH)).astype(np.float32))
    K = np.array([[1000.0, 0, WIDTH / 2], [0, 1000.0, HEIGHT / 2], [0, 0, 1]])
    wall = np.full((HEIGHT, WIDTH), 4.0, np.float32)
    cameras = translated_path(Camera("middle", K, np.eye(4), WIDTH, HEIGHT, 1.0, 9.0), 0.004, 2)
    poses = [(camera, image, wall) for camera, image in zip(cameras, (first, second), strict=True)]
    calls: dict[str, tuple[Callable[[], Any], int, int]] = {  # call, frames in it, times
        "static_mask": (lambda: moving_mask(first, second), 1, RUNS),
        "mtv": (lambda: mtv(first, second, static), 1, RUNS),
        "mtv2": (lambda: mtv2((first, second, third), static), 1, RUNS),
        "sharpness": (lambda: sharpness(first), 1, RUNS),
        "e_warp": (lambda: warping_error(poses), 1, RUNS),
        "colmap": (lambda: colmap_consistency(_views()), VIEWS, 1),
    }
    for name, series in series_of_depths().items():
        calls[name.lower()] = (
            lambda series=series: series.function(depths[: series.n_frames], None),
            1,
            RUNS,
        )
    return {
        f"metrics.{name}_ms": time_figure([elapsed_ms(call) for _ in range(times)], frames)
        | {"command": COMMAND}
        for name, (call, frames, times) in calls.items()
    }


def _views() -> list[NDArray[np.uint8]]:
    """A photograph whose lower half moves twice as fast as its upper one, as a camera that moves
    sideways sees two depths.
    """
    photograph = frame_pair()[1]
    shifts = [STEP_PX * (index - VIEWS // 2) // 4 for index in range(VIEWS)]
    half = HEIGHT // 2
    return [
        np.concatenate(
            [
                np.roll(photograph[:half], shift, axis=1),
                np.roll(photograph[half:], 2 * shift, axis=1),
            ]
        )
        for shift in shifts
    ]


if __name__ == "__main__":
    for name, figure in measure().items():
        print(
            f"{name}: {figure['core_ms']:.2f} ms of the cores per frame, {figure['value']:.2f} by "
            f"the clock"
        )
