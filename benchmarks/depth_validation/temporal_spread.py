"""Depth flicker of static surfaces, before and after the temporal filter of the online half.

A static pixel shows the same surface in the same light at all instants: its exact depth and its
noise-free colour never change. Changes of its depth over time come from the sensor's noise, the
video's coding, and what moves elsewhere in the pictures.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from benchmarks.depth_validation.figures import Figures, Measure, figures_of
from benchmarks.depth_validation.room_regions import Mask
from benchmarks.depth_validation.rooms import DEMO, FRAMES, RenderedRoom
from benchmarks.depth_validation.tables import Column, mean_of_rows, wide_table
from ggvs_eval.arrays import Image8, Map
from ggvs_eval.camera import Camera
from ggvs_eval.contrib.worlds.film.film import Footage, lit_room
from ggvs_eval.contrib.worlds.film.shots import rig_shots
from ggvs_eval.contrib.worlds.room.lighting import Instant
from ggvs_eval.errors import DepthError
from ggvs_eval.method import SourceView
from ggvs_eval.metrics.series_scores import mean_values, score_depths
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.pipelines.offline.depth.depth_stream import DepthStream
from ggvs_eval.pipelines.online.temporal_filters import TemporalDepthFilter
from ggvs_eval.progress import track

MEASURES = (
    Measure("spread_percent", "% of depth", higher_is_better=False),
    Measure("spread_filtered_percent", "% of depth", higher_is_better=False),
    Measure("share_of_unfiltered", "", higher_is_better=False),
    Measure("flicker_percent", "% of depth", higher_is_better=False),
    Measure("sharpness_percent", "% of depth", higher_is_better=True),
)
STATIC = "static_percent"


def evaluate_temporal(
    rooms: Sequence[RenderedRoom], options: Mapping[str, DepthOptions]
) -> tuple[pd.DataFrame, Figures]:
    """Return the first camera of every room over some frames.

    Args:
        rooms: with exact depth.
        options: of each matcher, by name.

    Returns:
        A table, one row per room, columns (matcher, measure) and the share of static pixels, and
        figures: of the demo capture, and of the mean over the validation rooms.
    """
    rows: dict[str, dict[Column, float]] = {}
    for room in rooms:
        camera = room.capture.cameras[0]
        static = film_static(room, camera)
        rows[room.name] = {("", STATIC): 100 * float(static.mean())}
        names = room.capture.camera_names
        images = {name: np.stack(list(room.capture.frames(name, 0, FRAMES))) for name in names}
        for matcher, each in options.items():
            views = estimate_views(room, camera, images, each)
            rows[room.name] |= {
                (matcher, measure): value
                for measure, value in measure_spread(views, static).items()
            }
    table = wide_table(rows)
    is_demo = table.index == DEMO
    figures: Figures = {}
    for group, part in (("rooms", table[~is_demo]), (DEMO, table[is_demo])):
        if len(part):
            figures |= figures_of(f"{group}.static", MEASURES, mean_of_rows(part))
    return table, figures


def estimate_views(
    room: RenderedRoom, camera: Camera, images: Mapping[str, Image8], options: DepthOptions
) -> list[SourceView]:
    """Estimate the source views of one camera that the online half is given, frame by frame.

    Args:
        room: the room.
        camera: one of its cameras.
        images: the first frames of every camera, (T, H, W, 3) each, by name.
        options: of the matcher.
    """
    partners = options.choose_partners(camera, room.capture.cameras)
    stream = DepthStream(camera, partners, options)
    views = []
    for frame in track(range(FRAMES), f"{room.name} over time"):
        depth_map = stream.step(
            frame, images[camera.name][frame], [images[partner.name][frame] for partner in partners]
        )
        views.append(
            SourceView(camera, images[camera.name][frame], depth_map.depth, depth_map.confidence)
        )
    return views


def measure_spread(views: Sequence[SourceView], static: Mask) -> dict[str, float]:
    """Return the spread over time before and after the temporal filter with its own parameters, and
    the share that remains.

    In addition, what `ggvs-eval steadiness --depth` calls flicker and sharpness, of the unfiltered
    depth.

    Args:
        views: one camera at consecutive instants.
        static: pixels that are static, (H, W).
    """
    temporal_filter = TemporalDepthFilter()
    filtered = [temporal_filter.step(index, view)[0].depth for index, view in enumerate(views)]
    before, after = (
        temporal_spread(np.stack(depths), static)
        for depths in ([view.depth for view in views], filtered)
    )
    steadiness = mean_values(score_depths((view.depth for view in views), static))
    remaining = after / before if before else float("nan")
    values = (
        100 * before,
        100 * after,
        remaining,
        steadiness["depth_mTV"],
        steadiness["depth_Sharpness"],
    )
    return {measure.name: value for measure, value in zip(MEASURES, values, strict=True)}


def temporal_spread(depths: Map, static: Mask) -> float:
    """Return the median over the static pixels of the standard deviation of depth over time, as a
    share of the mean depth.

    Args:
        depths: (T, H, W), world units, 0 = no depth; pixels that miss it at any instant are left
            out.
        static: (H, W).

    Reading:
        The standard deviation of a sample (T - 1 in the denominator), as of the other measures over
        time.

    Raises:
        DepthError: fewer than two instants, another size, or no static pixel with depth throughout.
    """
    if len(depths) < 2 or depths.shape[1:] != static.shape:
        raise DepthError(
            f"temporal spread: wanted two or more maps of {static.shape}, got {depths.shape}; give "
            f"more frames"
        )
    evaluated = static & (depths > 0).all(axis=0)
    if not evaluated.any():
        raise DepthError(
            "temporal spread: wanted static pixels with depth at all instants, got none; choose "
            "another camera"
        )
    values = depths[:, evaluated].astype(np.float64)  # (T, N)
    return float(np.median(values.std(axis=0, ddof=1) / values.mean(axis=0)))


def film_static(room: RenderedRoom, camera: Camera) -> Mask:
    """Return the mask the pixels that do not change over the first frames, (H, W): filmed without
    gain and noise.
    """
    shot = next(shot for shot in rig_shots(room.options) if shot.camera.name == camera.name)
    noise_free = replace(shot, sensor=None, instants=shot.instants[:FRAMES])
    frames = list(
        track(
            Footage(room.options, noise_free, _lit(room)).frames(),
            f"{room.name} without noise",
            FRAMES,
        )
    )
    return find_static(
        np.stack([frame.image for frame in frames]), np.stack([frame.depth for frame in frames])
    )


def find_static(images: Image8, depths: Map) -> Mask:
    """Return the pixels whose noise-free colour and exact depth are the same at all instants.

    Args:
        images: (T, H, W, 3).
        depths: (T, H, W), 0 = unknown.
    """
    same: Mask = (
        (images == images[:1]).all(axis=(0, -1))
        & (depths == depths[:1]).all(axis=0)
        & (depths[0] > 0)
    )
    return same


def _lit(room: RenderedRoom) -> Callable[[int], Instant]:
    seed, fps = room.options.seed, room.options.fps
    return lambda index: lit_room(seed).at(index / fps)
