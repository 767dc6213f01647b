"""The verb of the command line that measures videos without a reference."""

from pathlib import Path
from typing import Annotated

import tyro

from ggvs_eval.errors import MetricError, RenderError

Videos = Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="NAME=PATH")]


def steadiness(
    videos: Videos,
    depth: bool = False,
    mask: Path | None = None,
    colmap: bool = False,
    out: Path | None = None,
) -> None:
    """Measure stability and sharpness of videos without a reference.

    Args:
        videos: NAME=PATH per method: folder of numbered pictures or of views, .mp4, .mov, .npy or
            .npz.
        depth: paths are depth or disparity maps: .png, .tif, .pfm, .npy, .npz or grey video.
        mask: picture, white in static areas, for a fixed camera; all pixels by default.
        colmap: also test whether COLMAP registers a video of a moving camera (a few seconds each).
        out: file for the table: .md, .csv or .tex.
    """
    from ggvs_eval.pipelines.run.import_renders import named_renders
    from ggvs_eval.pipelines.run.steadiness import measure_steadiness
    from ggvs_eval.reports.tables.steadiness import (
        FORMATS,
        remarks_on,
        steadiness_table,
        write_steadiness,
    )
    from ggvs_eval.reports.tables.table_formats import to_markdown

    if depth and colmap:
        raise MetricError("wanted --depth or --colmap, got both; COLMAP needs pictures, omit one")
    if out is not None and out.suffix not in FORMATS:
        raise RenderError(
            f"{out}: wanted a file name with {', '.join(FORMATS)}, got {out.suffix or 'none'}; "
            f"change it"
        )
    paths = named_renders(videos, in_run=False)
    if not paths:
        raise RenderError(
            "wanted NAME=PATH of a video, got none; run e.g. `ggvs-eval steadiness "
            "ours=renders/cam00 theirs=video.mp4`"
        )
    result = measure_steadiness(paths, depth=depth, mask=mask, with_colmap=colmap)
    where = "in all pixels" if mask is None else f"where {mask.name} is white"
    table = steadiness_table(result.metrics, result.values, result.not_computed, where)
    remarks = remarks_on(result.shapes)
    print(to_markdown([table], remarks), end="")
    if out is not None:
        write_steadiness(out, table, remarks)
