"""The viewer of the page: frames of all methods to compare, their errors, slices through a row, and
videos.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

from ggvs_eval.reports.figures.data_uris import LOSSLESS, webp_uri
from ggvs_eval.reports.figures.regions import ERROR_FULL_SCALE, find_regions
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.page.page import run_words
from ggvs_eval.reports.page.pictures import (
    Comparison,
    PathPictures,
    PictureRoom,
    UndoneRenders,
    compare_frames,
    diagnostics_legend,
    error_scale,
    method_videos,
    path_pictures,
    share_room,
)
from ggvs_eval.reports.section import Report, SectionContent
from ggvs_eval.reports.tables.verdict import Verdict

UPS_AT_MOST = 2  # folders from a page up to what holds its run


def viewer_section(report: Report) -> SectionContent:
    """Return the pictures of each run, compressed into the bytes that the page has for them."""
    runs = report.runs
    rooms = dict(zip(runs, share_room([*runs.values()]), strict=True))
    values: dict[str, dict[str, Any]] = {}
    data = {}
    for group in report.groups:
        for key, run in group.runs.items():
            undone = report.values(key).get("undone_frames", {})
            values[key], data[key] = _of_run(run, rooms[key], group.verdict, undone, report.folder)
    scale = {
        "error_scale": webp_uri(error_scale(), LOSSLESS),
        "error_full_scale": int(ERROR_FULL_SCALE),
    }
    values[""] = scale | {"refers": any(of_run["full"] for of_run in data.values())}
    return SectionContent(values=values, data=data)


def _of_run(
    run: MeasuredRun,
    room: PictureRoom,
    verdict: Verdict,
    undone: Mapping[str, UndoneRenders],
    folder: Path | None,
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return what the templates and the scripts read of a run, pictures as data URIs."""
    comparison = compare_frames(run, room.frames, undone)
    path = path_pictures(run, room.path)
    fps = float(run.folder.capture_record().get("fps") or 0)
    opening = ("truth", *(verdict.shown(run) or run.ours_first[:2]))
    values = {
        "opening": opening,
        "insets": _insets(run, opening, comparison.full_size[0]),
        "comparison": comparison,
        "diagnostics": diagnostics_legend(comparison.keys),
        "undone": {run.name(label): frames.scores for label, frames in undone.items()},
        "first_left": (*run.ours_first, "truth")[0],
        "videos": method_videos(run, fps, room.videos),
        "linked_slices": path is not None or len(run.frames) > 1,
        "errors": True,
    }
    return values, _viewer_data(run, comparison, path, fps, _run_address(run.folder.root, folder))


def _viewer_data(
    run: MeasuredRun,
    comparison: Comparison,
    path: PathPictures | None,
    fps: float,
    full: str = "",
) -> dict[str, Any]:
    """Everything that the viewer and the linked slices of one run share.

    Other sections choose the row and give heat maps.

    Args:
        path: its frames along the camera path, compressed; None if there is none.
        fps: frames per second of the capture; 0 where unknown.
        full: the run folder as an address from the page; empty if the page cannot name it.
    """
    return {
        "run": run_words(run.folder.root, str(run.capture.get("path", ""))),
        "full": full,
        "width": comparison.width,
        "views": comparison.views,
        "frames": comparison.frames,
        "fps": fps,
        "start": run.frames[0],
        "count": len(run.frames),
        "size": comparison.full_size,
        "row": comparison.full_size[1] // 2,
        "keys": comparison.keys,
        "labels": run.labels,
        "names": {key: run.name(key) for key in run.labels}
        | dict(zip(comparison.keys, comparison.names, strict=True)),
        "images": comparison.images,
        "errors": comparison.errors,
        "path": None if path is None else asdict(path),
        "colours": [],
        "heat": {},
    }


def _insets(run: MeasuredRun, keys: Sequence[str], width: int) -> dict[str, dict[str, float]]:
    """View -> place of the square in which the two methods of the first screen differ most, in its
    sides; none of one method.
    """
    labels, count = tuple(key for key in keys if key != "truth"), len(run.protocol.views.test)
    if len(labels) < 2:
        return {}
    regions = find_regions(
        replace(run, labels=labels), "different", labels[0], count, one_per_view=True
    )
    return {
        box.view: {
            "left": box.left / box.side,
            "top": box.top / box.side,
            "across": width / box.side,
        }
        for box in regions
    }


def _run_address(root: Path, folder: Path | None) -> str:
    """Return a run folder as an address from a page.

    Empty if the page loads nothing, or they are too far apart.

    A page is in its run folder, or in that of a run next to it; a longer address would reveal the
    machine that made it.
    """
    if folder is None:
        return ""
    parts = Path(os.path.relpath(root.resolve(), folder.resolve())).parts
    return "" if parts.count("..") > UPS_AT_MOST else "/".join(map(quote, parts))
