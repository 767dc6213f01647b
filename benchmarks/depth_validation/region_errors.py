"""Depth of the rendered rooms against exact depth, region by region: what a matcher is good at, and
where it fails.
"""

from collections.abc import Mapping, Sequence

import pandas as pd

from benchmarks.depth_validation.depth_errors import MEASURES, relative_errors, summarise
from benchmarks.depth_validation.figures import Figures, figures_of
from benchmarks.depth_validation.room_regions import REGIONS, Mask, RegionOptions, find_regions
from benchmarks.depth_validation.rooms import DEMO, RenderedRoom
from benchmarks.depth_validation.tables import Column, mean_of_rows, wide_table
from ggvs_eval.arrays import Image8, Map
from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.contrib.worlds.film.film import read_exact_depth
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.pipelines.offline.depth.camera_depth import (
    FILLED_CONFIDENCE,
    DepthEstimator,
    DepthOptions,
)
from ggvs_eval.progress import track

FRAME = 4
WHOLE = "whole picture"
# of the pixels of one region of one picture: relative errors, and which were rejected
Errors = tuple[Map, Mask]


def evaluate_rooms(
    rooms: Sequence[RenderedRoom], options: Mapping[str, DepthOptions]
) -> tuple[pd.DataFrame, Figures]:
    """Return every matcher on some cameras of every room, at one instant.

    Args:
        rooms: with exact depth.
        options: of each matcher, by name.

    Returns:
        A table, rows (room, region) with the region's share of the pixels, columns (matcher,
        measure), and figures: of the demo capture, and of the mean over the validation rooms.
    """
    work = [(room, camera) for room in rooms for camera in room.evaluated_cameras]
    errors: dict[tuple[str, str, str], list[Errors]] = {}
    for room, camera in track(work, f"rooms, {', '.join(options)}"):
        truth, image = (
            read_exact_depth(room.capture.path, camera.name, FRAME),
            room.capture.frame(camera.name, FRAME),
        )
        masks = find_regions(truth, image, RegionOptions()) | {WHOLE: truth > 0}
        for matcher, each in options.items():
            depth_map = estimate_depth(room.capture, camera, image, each)
            for region, (evaluated, rejected) in errors_by_region(
                depth_map, truth, masks, FILLED_CONFIDENCE
            ).items():
                errors.setdefault((room.name, region, matcher), []).append((evaluated, rejected))
    table = _table(rooms, list(options), errors)
    return table, _figures(table)


def estimate_depth(
    capture: Capture, camera: Camera, image: Image8, options: DepthOptions
) -> DepthMap:
    """Return the depth of one camera with partners chosen among all others."""
    partners = options.choose_partners(camera, capture.cameras)
    partner_images = [capture.frame(partner.name, FRAME) for partner in partners]
    return DepthEstimator(camera, partners, options).estimate(image, partner_images)


def errors_by_region(
    depth_map: DepthMap, truth: Map, masks: Mapping[str, Mask], filled_confidence: float
) -> dict[str, Errors]:
    """Relative errors of one depth map and what it rejected, in each region.

    Args:
        depth_map: the depth map, filled or not.
        truth: exact depth, (H, W).
        masks: the regions, (H, W) each, of known depth only.
        filled_confidence: of pixels that were rejected and filled from the background.

    Reading:
        Errors are those of the map as it is used, filled pixels included. Rejected is what has no
        depth, or is trusted no more than what was filled.
    """
    rejected = (depth_map.depth <= 0) | (depth_map.confidence <= filled_confidence)
    return {
        region: (relative_errors(depth_map.depth[mask], truth[mask]), rejected[mask])
        for region, mask in masks.items()
    }


def _table(
    rooms: Sequence[RenderedRoom],
    matchers: Sequence[str],
    errors: Mapping[tuple[str, str, str], list[Errors]],
) -> pd.DataFrame:
    rows: dict[tuple[str, str], dict[Column, float]] = {}
    for room in rooms:
        whole = sum(evaluated.size for evaluated, _ in errors[room.name, WHOLE, matchers[0]])
        for region in (*REGIONS, WHOLE):
            pixels = sum(evaluated.size for evaluated, _ in errors[room.name, region, matchers[0]])
            row = rows[room.name, region] = {("", "pixels_percent"): 100 * pixels / whole}
            for matcher in matchers if pixels else ():
                measured = summarise(*zip(*errors[room.name, region, matcher], strict=True))
                row |= {(matcher, measure): value for measure, value in measured.items()}
    return wide_table(rows).set_axis(
        pd.MultiIndex.from_tuples(list(rows), names=("room", "region")), axis=0
    )


def _figures(table: pd.DataFrame) -> Figures:
    """Return the means over the validation rooms, and the demo capture alone."""
    is_demo = table.index.get_level_values("room") == DEMO
    figures: Figures = {}
    for group, part in (("rooms", table[~is_demo]), (DEMO, table[is_demo])):
        for region, rows in part.groupby(level="region"):
            figures |= figures_of(
                f"{group}.{str(region).replace(' ', '_')}", MEASURES, mean_of_rows(rows)
            )
    return figures
