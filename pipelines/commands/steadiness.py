"""The verb of the command line that measures videos without truth: steadiness."""

from pathlib import Path
from typing import Annotated

import tyro

from ggvs_eval.errors import MetricError, RenderError

Named = Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="NAME=PATH")]


def steadiness(
    videos: Named,
    depth: bool = False,
    mask: Path | None = None,
    colmap: bool = False,
    out: Path | None = None,
) -> None:
    """Measure how steady videos or depth maps are over time, without any truth, and how sharp, since blur is steady too.

    Args:
        videos: NAME=PATH of what each method made: a folder of numbered pictures, an .mp4 or .mov, a .npy or .npz.
        depth: the paths hold depth maps (or disparity, in any unit): .png, .tif, .pfm, .npy, .npz, or a video of grey levels.
        mask: a picture that is white where the scene stands still, for a camera that stands still; all pixels by default.
        colmap: also whether COLMAP finds one scene in a video whose camera moves; takes some seconds per video.
        out: also write the table there, as .md, .csv or .tex.
    """
    from ggvs_eval.pipelines.run.import_renders import named_renders
    from ggvs_eval.pipelines.run.steadiness import measure_steadiness
    from ggvs_eval.reports.tables.steadiness import FORMATS, remarks_on, steadiness_table, write_steadiness
    from ggvs_eval.reports.tables.table_formats import to_markdown

    if depth and colmap:
        raise MetricError("COLMAP finds no features in depth maps; leave out --depth or --colmap")
    if out is not None and out.suffix not in FORMATS:
        raise RenderError(f"{out}: wanted a name that ends in {', '.join(FORMATS)}; change it")
    paths = named_renders(videos)
    if not paths:
        raise RenderError("no videos to measure; name them, e.g. `ggvs-eval steadiness ours=renders/cam00 theirs=video.mp4`")
    measured = measure_steadiness(paths, depth=depth, mask=mask, with_colmap=colmap)
    where = "in all pixels" if mask is None else f"where {mask.name} is white"
    table, remarks = (
        steadiness_table(measured.metrics, measured.values, measured.not_computed, where),
        remarks_on(measured.shapes),
    )
    print(to_markdown([table], remarks), end="")
    if out is not None:
        write_steadiness(out, table, remarks)
