"""Savings and cost of `--reuse-static`: the depth of one camera over some frames, with it and
without.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from time import process_time

import numpy as np
import pandas as pd

from benchmarks.depth_validation.depth_errors import WITHIN, relative_errors
from benchmarks.depth_validation.figures import Figures, Measure, figures_of
from benchmarks.depth_validation.rooms import FRAMES, RenderedRoom
from benchmarks.depth_validation.tables import Column, mean_of_rows, wide_table
from benchmarks.depth_validation.temporal_spread import estimate_views
from ggvs_eval.camera import Camera
from ggvs_eval.contrib.worlds.film.film import read_exact_depth
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.pipelines.offline.depth.depth_choice import KEYFRAME_EVERY

MEASURES = (
    Measure("time_saved_percent", "% of CPU seconds", higher_is_better=True),
    Measure("within_2_percent_whole", "% of pixels", higher_is_better=True),
    Measure("within_2_percent_reused", "% of pixels", higher_is_better=True),
)


def evaluate_reuse(
    rooms: Sequence[RenderedRoom], options: Mapping[str, DepthOptions]
) -> tuple[pd.DataFrame, Figures]:
    """Return the first camera of every room over its first frames, the first of which is always
    computed whole.

    Args:
        rooms: with exact depth.
        options: of each matcher, by name; how they use time is replaced.

    Returns:
        A table, one row per room, columns (matcher, measure), and figures of the means over all
        rooms. Time is that of all threads, which does not depend on what else the machine does.
    """
    rows: dict[str, dict[Column, float]] = {}
    for room in rooms:
        camera = room.capture.cameras[0]
        images = {
            name: np.stack(list(room.capture.frames(name, 0, FRAMES)))
            for name in room.capture.camera_names
        }
        truths = np.stack(
            [read_exact_depth(room.capture.path, camera.name, frame) for frame in range(FRAMES)]
        )
        rows[room.name] = {}
        for matcher, each in options.items():
            whole, reused = (replace(each, keyframe_every=every) for every in (1, KEYFRAME_EVERY))
            (seconds, good), (fewer, still_good) = (
                _measured(room, camera, images, truths, way) for way in (whole, reused)
            )
            values = (100 * (1 - fewer / seconds), good, still_good)
            rows[room.name] |= {
                (matcher, measure.name): value
                for measure, value in zip(MEASURES, values, strict=True)
            }
    table = wide_table(rows)
    return table, figures_of("reuse", MEASURES, mean_of_rows(table))


def _measured(
    room: RenderedRoom,
    camera: Camera,
    images: Mapping[str, np.ndarray],
    truths: np.ndarray,
    options: DepthOptions,
) -> tuple[float, float]:
    """CPU seconds for all frames, and the share of their pixels within 2 % of the exact depth, in
    percent.
    """
    start = process_time()
    views = estimate_views(room, camera, images, options)
    seconds = process_time() - start
    has_truth = truths > 0
    errors = relative_errors(np.stack([view.depth for view in views])[has_truth], truths[has_truth])
    return seconds, float(100 * (errors <= WITHIN).mean())
