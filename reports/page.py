"""The page: one HTML file that carries everything it shows and opens without a network."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ggvs_eval.images import Image8
from ggvs_eval.reports.comparison import ERROR_FULL_SCALE, FRAME_BYTES, compare_frames, error_scale
from ggvs_eval.reports.curves import COLOURS, DASHES, MARGIN, SIZE, Panel
from ggvs_eval.reports.data_uri import png_uri, shrink, webp_uri
from ggvs_eval.reports.heat_map import heat_colours, heat_maps
from ggvs_eval.reports.measured import MeasuredRun
from ggvs_eval.reports.method_videos import VIDEO_BYTES, method_videos
from ggvs_eval.reports.path_pictures import PATH_BYTES, path_pictures
from ggvs_eval.reports.published import CAVEATS, published_tables
from ggvs_eval.reports.reproduction import MEANING, Reproduction
from ggvs_eval.reports.reproduction_formats import blocks, count_words
from ggvs_eval.reports.scripts import TEMPLATES, page_script, script_digest
from ggvs_eval.reports.slice_figure import NO_TRUTH
from ggvs_eval.reports.slices import Slices
from ggvs_eval.reports.table import Table
from ggvs_eval.reports.viewer_data import viewer_data
from ggvs_eval.run_folder import JOB_FILE

CONTEXT_WIDTH = 480


@dataclass(frozen=True)
class RunSection:
    """Everything that the page shows of one run.

    Attributes:
        run: the run.
        view_tables: where the error varies, and one per metric.
        timing: time per stage.
        slices: along the path and over time.
        panels: error curves.
    """

    run: MeasuredRun
    view_tables: tuple[Table, ...]
    timing: Table
    slices: Sequence[Slices]
    panels: tuple[Panel, ...]


def render_page(
    sections: Sequence[RunSection], tables: Sequence[Table], provenance: dict[str, Any], reproduced: Sequence[Reproduction] = ()
) -> str:
    """Fill the templates.

    Args:
        sections: one per run.
        tables: quality, consistency and whatever else was measured, over all runs.
        provenance: of the merged results.
        reproduced: every value that the paper publishes, beside ours.

    Returns:
        The whole page; equal inputs give equal text.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(TEMPLATES), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    script = page_script()
    return environment.get_template("page.html.j2").render(
        title=", ".join(dict.fromkeys(section.run.scene for section in sections)),
        n_methods=len({label for section in sections for label in section.run.labels}),
        css=(TEMPLATES / "page.css").read_text(encoding="utf-8"),
        script=script,
        script_digest=script_digest(script),
        sections=[_section(index, section, len(sections)) for index, section in enumerate(sections)],
        tables=tables,
        leaders=leaders(tables),
        provenance=provenance,
        protocol=sections[0].run.protocol,
        metrics=sections[0].run.metrics,
        published=published_tables(),
        caveats=CAVEATS,
        reproduction={
            "blocks": blocks(reproduced),
            "counts": count_words(reproduced),
            "meaning": MEANING,
            "values": len(reproduced),
        },
        has_published_rows=any(row.kind == "published" for table in tables for row in table.rows),
        error_scale=png_uri(error_scale()),
        error_full_scale=int(ERROR_FULL_SCALE),
        heat_scale=png_uri(heat_colours()),
    )


def leaders(tables: Sequence[Table]) -> list[tuple[str, list[str]]]:
    """Who is best in what: name -> metrics, in the order of the rows; ties count for each."""
    best: dict[str, list[str]] = {}
    for table in tables:
        for row in table.rows:
            best.setdefault(row.name, []).extend(c.name for c, cell in zip(table.columns, row.cells, strict=True) if cell.best)
    return [(name, metrics) for name, metrics in best.items() if metrics]


def reproduce(run: MeasuredRun, capture: str) -> list[str]:
    """The commands that make these numbers again; folders by their last name only, so that a page tells nothing of a machine."""
    root = run.folder.root.name
    ours = [label for label in run.labels if (run.folder.renders(label, run.protocol.views.test[0]) / JOB_FILE).is_file()]
    foreign = [f"{label}=RENDERS/{label}" for label in run.labels if label not in ours]
    commands = [["prepare", root, "--capture", Path(capture).name, "--protocol", f"{root}/protocol.toml"]]
    commands += [["render", root, "--methods", *ours]] if ours else []
    commands += [["score", root, *(["--renders", *foreign] if foreign else [])], ["report", root]]
    return [shlex.join(["ggvs-eval", *command]) for command in commands]


def _section(index: int, section: RunSection, n_sections: int) -> dict[str, Any]:
    """What the templates need of one run, pictures as data addresses; runs share the room for pictures equally."""
    run, maps = section.run, heat_maps(section.run)
    comparison = compare_frames(run, FRAME_BYTES // n_sections)
    path = path_pictures(run, PATH_BYTES // n_sections)
    capture = run.folder.capture_record()
    fps = float(capture.get("fps") or 0)
    row = next((slices.row for slices in section.slices if slices.kind == "time"), comparison.full_size[1] // 2)
    return {
        "id": f"run{index}",
        "run": run,
        "capture": _facts(capture),
        "view_tables": section.view_tables,
        "timing": section.timing,
        "comparison": comparison,
        "first_left": _shown_first(run),
        "data": viewer_data(run, comparison, path, maps, row, fps),
        "heat_maps": maps,
        "videos": method_videos(run, fps, VIDEO_BYTES // n_sections),
        "slices": [_slice_pictures(slices) for slices in section.slices],
        "commands": reproduce(run, str(capture.get("path", "CAPTURE"))),
        "has_path": any(slices.kind == "epi" for slices in section.slices),
        "panels": section.panels,
        "plot": {"size": SIZE, "margin": MARGIN, "dashes": DASHES, "colours": len(COLOURS)},
    }


def _shown_first(run: MeasuredRun) -> str:
    """The label that the viewer opens with: ours, rather itself than a variant of it, or whatever has pictures."""
    ours = sorted((label for label in run.pictured if label in run.ours), key=lambda label: "+" in label)  # stable
    return (*ours, *run.pictured, "truth")[0]


def _facts(capture: dict[str, Any]) -> dict[str, str | int | float]:
    """What is said of the capture, notes about what was left out included."""
    facts = {key: value for key, value in capture.items() if key != "path" and isinstance(value, str | int | float)}
    notes = "; ".join(capture.get("notes", ()))
    return facts | ({"notes": notes} if notes else {})


def _slice_pictures(slices: Slices) -> dict[str, Any]:
    height, width = slices.context.shape[:2]
    return {
        "kind": slices.kind,
        "view": slices.view,
        "row": slices.row,
        "chosen_by": slices.chosen_by,
        "title": slices.title,
        "context": webp_uri(shrink(slices.context, CONTEXT_WIDTH)),
        "size": (width, height),
        "strips": [(strip.name, None if strip.image is None else png_uri(_tall(strip.image))) for strip in slices.strips],
        "no_truth": NO_TRUTH,
    }


def _tall(image: Image8, height: int = 96) -> Image8:
    """Repeat samples until a slice is tall enough to look at; no value is changed."""
    return np.repeat(image, max(1, round(height / len(image))), axis=0)
