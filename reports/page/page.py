"""The page: one HTML file that carries everything it shows and opens without a network."""

import base64
import hashlib
import os
import re
import shlex
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np

from ggvs_eval.files.templates import open_templates
from ggvs_eval.geometry.source_views import CHOSEN_AS
from ggvs_eval.reports.figures.curves import COLOURS, DASHES, MARGIN, SIZE, method_numbers, round_ticks
from ggvs_eval.reports.figures.regions import ERROR_FULL_SCALE, find_regions
from ggvs_eval.reports.figures.slices import NO_TRUTH, Slices, Strip
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.model.table import Table
from ggvs_eval.reports.page.heat_map import HeatMap, heat_colours, heat_maps
from ggvs_eval.reports.page.pictures import (
    Comparison,
    PathPictures,
    PictureRoom,
    compare_frames,
    diagnostics_legend,
    error_scale,
    method_videos,
    path_pictures,
    png_uri,
    share_room,
    shrink,
    undone_renders,
    webp_uri,
)
from ggvs_eval.reports.page.quality_over_time import QualityOverTime, quality_over_time
from ggvs_eval.reports.page.sweep_section import SweepSection
from ggvs_eval.reports.run_groups import RunGroup, RunSection
from ggvs_eval.reports.tables.published import CAVEATS, PAPER
from ggvs_eval.reports.tables.reproduction import HEADS, MEANING, PAPER_MAP, Reproduction, blocks, count_words, paper_tables
from ggvs_eval.reports.tables.table_formats import copyable
from ggvs_eval.reports.tables.verdict import Verdict, evaluate_verdict, leaders
from ggvs_eval.run_folder import JOB_FILE, read_json

if TYPE_CHECKING:
    from jinja2 import Environment

TEMPLATES = Path(__file__).parent / "templates"
FIRST_SCRIPTS = ("theme", "loading")  # run before anything is drawn, so that no page flashes in the wrong colours
SCRIPTS = (
    *("zoom_window", "pointer_gestures", "picture_grid", "curve_cursor", "row_cutter", "linked_slices"),
    *("full_size", "crop_picker", "heat_map", "sortable_table", "table_copy", "player", "methods", "viewer", "opening"),
    *("tabs", "place", "start"),
)
CONTEXT_WIDTH = 480
SLICE_HEIGHT = 96  # of a picture of few samples
UPS_AT_MOST = 2  # folders from a page up to what holds its run
FACT_NAMES = {"n_frames": "frames captured", "fps": "frames per second", "units_origin": "scale known from"}
Part = tuple[str, str, tuple[str, ...]]
# Sections of each group after the overview: anchor, title, templates.
PARTS: tuple[Part, ...] = (
    ("compare", "Compare", ("comparison", "linked_slices", "errors")),
    ("results", "Scores", ("results",)),
    ("on-time", "On time", ("on_time",)),
    ("heat", "Where and when", ("heat_map", "views", "curves")),
    ("slices", "Slices", ("slices",)),
    ("videos", "Videos", ("videos",)),
    ("timing", "Timing", ("timing",)),
    ("measured", "What was measured", ("measured",)),
)
OF_ONE_FRAME: dict[str, Part | None] = {"heat": ("views", "Views", ("views",)), "videos": None}  # nothing is drawn over time
PLOT = {"size": SIZE, "margin": MARGIN, "dashes": DASHES, "colours": len(COLOURS)}


def page_script(names: Sequence[str] = SCRIPTS) -> str:
    """Scripts in the order in which they build on each other; the last one starts the page."""
    parts = [(TEMPLATES / f"{name}.js").read_text(encoding="utf-8") for name in names]
    return "\n".join(['"use strict";', *parts])


def script_digest(script: str) -> str:
    """Return the digest by which the page's policy allows a script: SHA-256 of the text in UTF-8, in base64."""
    return base64.b64encode(hashlib.sha256(script.encode("utf-8")).digest()).decode("ascii")


def fill_template(name: str, first: Sequence[str], last: Sequence[str], **values: Any) -> str:
    """Fill a template with the styles, the named scripts, the digests by which its policy allows them, and values."""
    css, dark_css = ((TEMPLATES / file).read_text(encoding="utf-8") for file in ("page.css", "dark.css"))
    scripts = {"first": page_script(first), "last": page_script(last)}
    values |= {"css": css, "dark_css": dark_css, "scripts": scripts}
    return template_environment().get_template(name).render(script_digests=[*map(script_digest, scripts.values())], **values)


def viewer_data(
    run: MeasuredRun,
    comparison: Comparison,
    path: PathPictures | None,
    maps: tuple[HeatMap, ...],
    row: int,
    fps: float,
    full: str = "",
) -> dict[str, Any]:
    """Everything that the viewer, the linked slices and the heat maps of one run share.

    Args:
        path: its frames along the camera path, compressed; None if there is none.
        fps: frames per second of the capture; 0 where unknown.
        full: the run folder as an address from the page; empty if the page cannot name it.
    """
    return {
        "run": _run_words(run.folder.root, str(run.capture.get("path", ""))),
        "full": full,
        "width": comparison.width,
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


def render_page(
    groups: Sequence[RunGroup],
    reproduced: Sequence[Reproduction] = (),
    sweeps: Sequence[SweepSection] = (),
    folder: Path | None = None,
) -> str:
    """Fill the templates.

    Args:
        groups: runs by protocol; a single one has no heading.
        sweeps: tables and curves over K; first where their runs follow, else after the groups.
        folder: where the page will be, from which it shows frames at full size; None makes a page that loads nothing.

    Returns:
        The whole page; equal inputs give equal text.
    """
    plot = PLOT | {"numbers": page_numbers(groups, sweeps)}
    contexts = _groups(groups, folder, plot)
    return fill_template(
        "page.html.j2",
        FIRST_SCRIPTS,
        SCRIPTS,
        title=" · ".join(dict.fromkeys(group.titles for group in groups)),
        groups=contexts,
        refers=any(section["data"]["full"] for group in contexts for section in group["sections"]),
        sweeps=[{"id": f"sweep{at}", "title": sweep.title, **vars(sweep)} for at, sweep in enumerate(sweeps)],
        plot=plot,
        caveats=CAVEATS,
        reproduction={
            "heads": HEADS,
            "tables": [_without_empty_rows(table) for table in paper_tables(reproduced)],
            "blocks": blocks(reproduced),
            "counts": count_words(reproduced),
            "meaning": MEANING,
            "values": len(reproduced),
            "speaks": any(entry.status != "data absent" for entry in reproduced),
            "map": PAPER_MAP,
        },
        error_scale=png_uri(error_scale()),
        error_full_scale=int(ERROR_FULL_SCALE),
        heat_scale=png_uri(heat_colours()),
    )


def page_numbers(groups: Sequence[RunGroup], sweeps: Sequence[SweepSection]) -> dict[str, int]:
    """Return the number of each method of a page by its name, the same on all tabs and in the figures next to the page."""
    sections = [section for group in groups for section in group.sections]
    rates = [*(panel for one in sections for panel in one.rate_panels), *(panel for one in sweeps for panel in one.rates)]
    names = [section.run.name(label) for section in sections for label in section.run.labels]
    names += [row.name for group in groups for table in group.tables for row in table.rows if row.label]
    names += [curve.name for sweep in sweeps for panel in sweep.panels for curve in panel.curves]
    return method_numbers([*names, *(family.name for panel in rates for family in panel.families)])


def template_environment() -> "Environment":
    """Return the page's templates, with its filters."""
    made = open_templates(TEMPLATES)
    made.filters |= {"coded": _coded, "copyable": copyable}
    return made


def _coded(text: str) -> str:
    """Return text for HTML with code between backticks."""
    from markupsafe import Markup, escape

    return Markup(re.sub(r"`([^`]*)`", r"<code>\1</code>", str(escape(text))))


def run_address(root: Path, folder: Path | None) -> str:
    """Return a run folder as an address from a page; empty if the page loads nothing, or they are too far apart.

    A page is in its run folder, or in that of a run next to it; a longer address would reveal the machine that made it.
    """
    if folder is None:
        return ""
    parts = Path(os.path.relpath(root.resolve(), folder.resolve())).parts
    return "" if parts.count("..") > UPS_AT_MOST else "/".join(map(quote, parts))


def _groups(groups: Sequence[RunGroup], folder: Path | None, plot: dict[str, Any]) -> list[dict[str, Any]]:
    """Build the template context of each group; places have the same names in all groups, behind the group's own."""
    rooms = enumerate(share_room([section.run for group in groups for section in group.sections]))
    names = _tab_names(groups)
    tabs = zip(names, _addresses(names), strict=True)
    verdicts = [
        evaluate_verdict([one.run for one in group.sections], group.results, group.tables, group.sections[0].view_tables)
        for group in groups
    ]
    return [
        {
            "id": f"group{at}",
            "place": f"group{at}-" if len(groups) > 1 else "",
            "level": 3 if len(groups) > 1 else 2,
            "heading": group.heading,
            "titles": group.titles,
            "protocol": group.protocol,
            "provenance": group.results.provenance,
            "metrics": group.sections[0].run.metrics,
            "n_methods": len({label for section in group.sections for label in section.run.labels}),
            "tables": group.tables,
            "price": group.price,
            "sources": _sources([section.run for section in group.sections]),
            "leaders": leaders(group.tables),
            "verdict": verdicts[at],
            "over_time": _over_time(verdicts[at], group),
            "methods": {run.name(label): label for run in (one.run for one in group.sections) for label in run.labels},
            "parts": _parts(group),
            "several_datasets": len({table.dataset for table in group.tables}) > 1,
            "has_published_rows": any(row.kind == "published" for table in group.tables for row in table.rows),
            "has_paper_rows": any(row.name.endswith(PAPER) for table in group.tables for row in table.rows),
            "sections": [_section(*next(rooms), *next(tabs), section, verdicts[at], folder, plot) for section in group.sections],
        }
        for at, group in enumerate(groups)
    ]


def _over_time(verdict: Verdict, group: RunGroup) -> QualityOverTime | None:
    """Return the headline metric of a group over the time of a frame; None where fewer than two methods have both."""
    if verdict.column is None:
        return None
    values = [(one.name, one.cell.value) for one in (*verdict.contenders, *verdict.parts) if one.cell.value is not None]
    return quality_over_time(verdict.column, values, [section.timing for section in group.sections])


def _sources(runs: Sequence[MeasuredRun]) -> str:
    """State the source cameras of the pictures, if known for every method."""
    if not all(set(run.labels) <= run.from_sources for run in runs):
        return ""
    synthesis = runs[0].protocol.synthesis
    return f", from {synthesis.k} other cameras, {CHOSEN_AS[synthesis.sources]}"


def _parts(group: RunGroup) -> list[Part]:
    """Parts that have something to show."""
    parts = [OF_ONE_FRAME.get(part[0], part) if group.protocol.frames.count == 1 else part for part in PARTS]
    empty = set() if any(section.slices for section in group.sections) else {"slices"}
    empty |= set() if any(section.on_time for section in group.sections) else {"on-time"}
    return [part for part in parts if part and part[0] not in empty]


def _tab_names(groups: Sequence[RunGroup]) -> list[str]:
    """Return the name each run for the run selector: its title, with as much more as needed to distinguish all runs."""
    runs = [(group, section.run) for group in groups for section in group.sections]
    names = [
        [run.title for _, run in runs],
        [f"{run.title}, {run.scene}" for _, run in runs],
        [group.heading for group, _ in runs],
        [f"{group.heading}, {run.scene}" for group, run in runs],
    ]
    return next((each for each in names if len(set(each)) == len(runs)), names[-1])


def _addresses(names: Sequence[str]) -> list[str]:
    """Return the same in words of an address, no two alike."""
    slugs = [re.sub(r"[^\w.-]+", "-", name.lower()).strip("-") for name in names]
    return [slug if slug and slugs.count(slug) == 1 else f"{slug}-{at}".strip("-") for at, slug in enumerate(slugs)]


def _without_empty_rows(table: Table) -> Table:
    """Return the paper's rows, and those of this run that hold a number."""
    return replace(
        table, rows=tuple(row for row in table.rows if row.is_grey or any(cell.value is not None for cell in row.cells))
    )


def reproduce(run: MeasuredRun, capture: str) -> list[str]:
    """Return the commands that reproduce these numbers; folders by last names only, to reveal nothing of the machine."""
    root = _run_words(run.folder.root, capture)
    ours = [label for label in run.labels if (run.folder.renders(label, run.protocol.views.test[0]) / JOB_FILE).is_file()]
    foreign = [f"{label}=RENDERS/{label}" for label in run.labels if label not in ours]
    given = ["--with-truth"] if run.has_own_truth else ["--capture", Path(capture).name]
    given += ["--protocol", f"{root}/protocol.toml"]
    commands = [["prepare", root, *given, *(["--matcher", matcher] if (matcher := _matcher(run)) else [])]] if ours else []
    scored = ["score", *([root] if ours else ["--run", root, *given]), *(["--renders", *foreign] if foreign else [])]
    on_gpu = {render.rsplit("/", 1)[0] for render in run.results.devices}
    for device, flags in ((False, []), (True, ["--device", "cuda"])):
        if labels := [label for label in ours if (label in on_gpu) == device]:
            commands.append(["render", root, "--methods", *labels, *flags])
    return [shlex.join(["ggvs-eval", *command]) for command in (*commands, scored, ["report", root])]


def _run_words(root: Path, capture: str) -> str:
    """Last name of a run folder, after its parent's where the capture has the same."""
    *_, parent, name = ("", *root.resolve().parts[1:])
    return f"{parent}/{name}" if parent and name == Path(capture).name else name


def _section(
    index: int,
    room: PictureRoom,
    title: str,
    address: str,
    section: RunSection,
    verdict: Verdict,
    folder: Path | None,
    plot: dict[str, Any],
) -> dict[str, Any]:
    """Build the template context of one run, pictures as data URIs."""
    run, maps = section.run, heat_maps(section.run)
    undone = undone_renders(run)
    comparison = compare_frames(run, room.frames, undone)
    path = path_pictures(run, room.path)
    capture = run.folder.capture_record()
    fps = float(capture.get("fps") or 0)
    opening = ("truth", *(verdict.shown(run) or run.ours_first[:2]))
    row = next((slices.row for slices in section.slices if slices.kind == "time"), comparison.full_size[1] // 2)
    return {
        "id": f"run{index}",
        "run": run,
        "capture": _facts(capture) | ({"depth by": matcher} if (matcher := _matcher(run)) else {}),
        "title": title,
        "address": address,
        "opening": opening,
        "insets": _insets(run, opening, comparison.full_size[0]),
        "view_tables": section.view_tables,
        "timing": section.timing,
        "costs": section.costs,
        "on_time": section.on_time,
        "rate_panels": section.rate_panels,
        "comparison": comparison,
        "diagnostics": diagnostics_legend(comparison.keys),
        "undone": {run.name(label): one.scores for label, one in undone.items()},
        "first_left": (*run.ours_first, "truth")[0],
        "data": viewer_data(run, comparison, path, maps, row, fps, run_address(run.folder.root, folder)),
        "heat_maps": maps,
        "videos": method_videos(run, fps, room.videos),
        "slices": [_slice_pictures(slices) for slices in section.slices],
        "commands": reproduce(run, str(capture.get("path", "CAPTURE"))),
        "follows_rows": path is not None or len(run.frames) > 1,
        "has_path": any(slices.kind == "epi" for slices in section.slices),
        "panels": section.panels,
        "plot": plot,
    }


def _insets(run: MeasuredRun, keys: Sequence[str], width: int) -> dict[str, dict[str, float]]:
    """View -> place of the square in which the two methods of the first screen differ most, in its sides; none of one method."""
    labels, count = tuple(key for key in keys if key != "truth"), len(run.protocol.views.test)
    if len(labels) < 2:
        return {}
    regions = find_regions(replace(run, labels=labels), "different", labels[0], count, one_per_view=True)
    return {one.view: {"left": one.left / one.side, "top": one.top / one.side, "across": width / one.side} for one in regions}


def _matcher(run: MeasuredRun) -> str:
    """Name of the matcher whose depth the run has, its file without folders; empty if the depth was not computed here."""
    record = run.folder.depth_record
    kind, colon, file = str(read_json(record).get("matcher", "") if record.is_file() else "").partition(":")
    return f"{kind}{colon}{Path(file).name}"


def _facts(capture: dict[str, Any]) -> dict[str, str | int | float]:
    """List the facts about the capture, including notes about what was left out."""
    plain = {key: value for key, value in capture.items() if key != "path" and isinstance(value, str | int | float)}
    facts = {FACT_NAMES.get(key, key.replace("_", " ")): value for key, value in plain.items()}
    facts |= {"cameras": len(capture["cameras"])} if capture.get("cameras") else {}
    if capture.get("notes"):
        facts["notes"] = "; ".join(capture["notes"])
    return facts


def _slice_pictures(slices: Slices) -> dict[str, Any]:
    height, width = slices.context.shape[:2]
    count = next(len(strip.image) for strip in slices.strips if strip.image is not None)
    seconds = {at: f"{at / slices.fps:.2f} s" if slices.fps else "" for at in sorted({0, count // 2, count - 1})}
    return {
        "samples": [(round(100 * (at + 0.5) / count, 2), str(slices.first + at), second) for at, second in seconds.items()],
        "pixels": [(round(100 * value / width, 2), text) for value, text in round_ticks(0, width)],
        "has_seconds": slices.fps > 0,
        "kind": slices.kind,
        "view": slices.view,
        "row": slices.row,
        "chosen_by": slices.chosen_by,
        "title": slices.title,
        "context": webp_uri(shrink(slices.context, CONTEXT_WIDTH)),
        "size": (width, height),
        "strips": [_strip_picture(slices, strip) for strip in slices.strips],
        "no_truth": NO_TRUTH if any(strip.image is None for strip in slices.strips) else "",
    }


def _strip_picture(slices: Slices, strip: Strip) -> dict[str, Any]:
    """A slice as a picture, and its breaks: place in per cent, words, and what of an address leads there (over time alone)."""
    if strip.image is None:
        return {"name": strip.name, "picture": None}
    count, width = strip.image.shape[:2]
    number, breaks = ("frame" if slices.kind == "time" else "pose"), []
    for one in strip.breaks:
        words = f"{number} {slices.first + one.at}, x {one.x}: its change differs by {one.apart:.0f} levels from the reference's"
        place = f"{quote(slices.view, safe='')}/{slices.first + one.at}/{one.x},{slices.row}/{quote(strip.label, safe='')},truth"
        left, top = round(100 * (one.x + 0.5) / width, 2), round(100 * one.at / count, 2)
        breaks.append({"left": left, "top": top, "words": words, "place": place if slices.kind == "time" else ""})
    tall = np.repeat(strip.image, max(1, round(SLICE_HEIGHT / count)), axis=0)  # no value is changed
    return {"name": strip.name, "picture": png_uri(tall), "breaks": breaks}
