"""Steadiness of videos and depth videos that stand alone: no capture, no cameras, no run folder."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ggvs_eval.arrays import Mask
from ggvs_eval.errors import MetricError
from ggvs_eval.files.atomic import write_text
from ggvs_eval.files.images import read_image
from ggvs_eval.metrics.metric import NO_REFERENCE, Metric
from ggvs_eval.metrics.path.colmap_consistency import NAMES as COLMAP_NAMES
from ggvs_eval.metrics.path.colmap_consistency import colmap_consistency
from ggvs_eval.metrics.registry import DEPTH_METRICS, METRICS
from ggvs_eval.metrics.series_scores import OF_FRAMES, mean_values, score_depths, score_frames
from ggvs_eval.renders.sequences import read_depths, read_frames
from ggvs_eval.reports.model.table import Column, Row, Table, measured_cell, rank
from ggvs_eval.reports.tables.table_formats import to_csv, to_latex, to_markdown


@dataclass
class _Counted:
    """Passes frames on, and knows how many there were and how large."""

    frames: Iterable[Any]
    count: int = 0
    size: tuple[int, int] = (0, 0)

    def __iter__(self) -> Iterator[Any]:
        for frame in self.frames:
            self.count, self.size = self.count + 1, (frame.shape[1], frame.shape[0])
            yield frame


def measure_steadiness(
    videos: Mapping[str, Path], *, depth: bool = False, mask: Path | None = None, with_colmap: bool = False
) -> tuple[Table, list[str]]:
    """Measure each video and put them into one table, the sharpness beside.

    Args:
        videos: name -> folder, video or array, see `renders.sequences`.
        depth: whether they hold depth.
        mask: picture that is white where the scene stands still; all pixels where None.
        with_colmap: also `colmap_consistency` of each, which is of frames alone.

    Returns:
        The table, a row per video, and what to know of it.

    Raises:
        MetricError: frames that do not fit each other or the mask.
        RenderError: a path that holds none.
        CaptureError: a damaged picture or video.
    """
    static = None if mask is None else read_image(mask)[..., 0] > 127
    metrics: dict[str, Metric] = dict(DEPTH_METRICS) if depth else {name: METRICS[name] for name in OF_FRAMES}
    if with_colmap:
        metrics |= {name: METRICS[name] for name in COLMAP_NAMES}
    columns = tuple(Column(name, one.unit, one.higher_is_better, one.describe) for name, one in metrics.items())
    rows, shapes = [], {}
    for name, path in videos.items():
        values, reasons, shapes[name] = _measured(path, depth, static, with_colmap)
        cells = [measured_cell(values.get(key), reasons.get(key, ""), None, one.decimals) for key, one in metrics.items()]
        rows.append(Row(name, tuple(cells)))
    where = "in all pixels" if mask is None else f"where {mask.name} is white"
    caption = (
        f"Mean over the frames, {where}, without truth. What is blurred is steady too: read each value beside the sharpness."
    )
    notes = [f"{name}: {text}" for name, text in shapes.items()]
    if len(set(shapes.values())) > 1:
        notes.append("Not alike in number or size of their frames: the values do not compare")
    return Table("steadiness", NO_REFERENCE.title, caption, columns, rank(columns, rows)), notes


def _measured(path: Path, depth: bool, static: Mask | None, with_colmap: bool) -> tuple[dict[str, float], dict[str, str], str]:
    """Metric -> value, metric -> reason for its absence, and how many frames of which size there were."""
    counted = _Counted(read_depths(path) if depth else read_frames(path))
    try:
        scores = score_depths(counted, static) if depth else score_frames(counted, static)
        values, reasons = mean_values(scores), dict(scores.not_computed)
    except MetricError as error:
        raise MetricError(f"{path}: frame {counted.count - 1}: {error}" if counted.count else f"{path}: {error}") from error
    if with_colmap:
        try:
            found = colmap_consistency(read_frames(path))
            values |= dict(zip(COLMAP_NAMES, (found.registered, found.track_length, found.matches), strict=True))
        except MetricError as error:
            reasons |= dict.fromkeys(COLMAP_NAMES, str(error))
    return values, reasons, f"{counted.count} frames of {counted.size[0]} x {counted.size[1]}"


def write_steadiness(out: Path, table: Table, notes: Sequence[str]) -> None:
    """Write the table in the format that the file's name asks for: .md, .csv or .tex."""
    texts = {
        ".md": lambda: to_markdown([table], notes),
        ".csv": lambda: to_csv([(None, [table])]),
        ".tex": lambda: to_latex([table], notes),
    }
    out.parent.mkdir(parents=True, exist_ok=True)
    write_text(out, texts[out.suffix]())
