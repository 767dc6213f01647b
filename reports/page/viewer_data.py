"""What the scripts of the page read of one run."""

from dataclasses import asdict
from typing import Any

from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.page.comparison import Comparison
from ggvs_eval.reports.page.heat_map import HeatMap, heat_colours
from ggvs_eval.reports.page.path_pictures import PathPictures


def viewer_data(
    run: MeasuredRun, comparison: Comparison, path: PathPictures | None, maps: tuple[HeatMap, ...], row: int, fps: float
) -> dict[str, Any]:
    """Everything that the viewer, the linked slices and the heat maps of one run share.

    Args:
        run: the run.
        comparison: its frames, compressed.
        path: its frames along the camera path, compressed; None where there is none.
        maps: its values per view and frame.
        row: image row that the linked slices start with.
        fps: frames per second of the capture; 0 where unknown.
    """
    return {
        "views": comparison.views,
        "frames": comparison.frames,
        "fps": fps,
        "start": run.frames[0],
        "count": len(run.frames),
        "size": comparison.full_size,
        "row": row,
        "keys": comparison.keys,
        "labels": run.labels,
        "names": {key: run.name(key) for key in run.labels} | dict(zip(comparison.keys, comparison.names, strict=True)),
        "images": comparison.images,
        "errors": comparison.errors,
        "path": None if path is None else asdict(path),
        "colours": ["#" + bytes(colour).hex() for colour in heat_colours()[0]],
        "heat": {heat_map.metric: heat_map.record() for heat_map in maps},
    }
