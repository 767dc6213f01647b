"""The page: one HTML file that carries everything it shows and opens without a network."""

import base64
import hashlib
import re
import shlex
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ggvs_eval.files.templates import open_templates
from ggvs_eval.geometry.source_views import CHOSEN_AS
from ggvs_eval.reports.figures.axes import COLOURS, DASHES, MARGIN, SIZE, method_numbers
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.section import Report, RunGroup
from ggvs_eval.reports.tables.report_tables import view_tables
from ggvs_eval.reports.tables.table_formats import copyable
from ggvs_eval.reports.tables.verdict import leaders
from ggvs_eval.run_folder import JOB_FILE, read_json

if TYPE_CHECKING:
    from jinja2 import Environment

TEMPLATES = Path(__file__).parent / "templates"
# run before anything is drawn, so that no page flashes in the wrong colours
FIRST_SCRIPTS = ("theme", "loading")
SCRIPTS = (
    *(
        "zoom_window",
        "pointer_gestures",
        "picture_grid",
        "curve_cursor",
        "row_cutter",
        "linked_slices",
    ),
    *(
        "full_size",
        "crop_picker",
        "heat_map",
        "sortable_table",
        "table_copy",
        "player",
        "methods",
        "viewer",
        "opening",
    ),
    *("tabs", "place", "start"),
)
STILL_FIRST_SCRIPTS = ("theme",)  # of a page in which tables are all that moves
STILL_SCRIPTS = ("picture_grid", "sortable_table", "table_copy", "leaderboard")
FACT_NAMES = {
    "n_frames": "frames captured",
    "fps": "frames per second",
    "units_origin": "scale known from",
}
Part = tuple[str, str, tuple[str, ...]]
# Places of each group after the overview: anchor, title, templates, of which those are shown that
# have something to show.
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
VIEWS = ("views", "Views")  # anchor and title where no heat maps come first
PLOT = {"size": SIZE, "margin": MARGIN, "dashes": DASHES, "colours": len(COLOURS)}


def page_script(names: Sequence[str] = SCRIPTS) -> str:
    """Scripts in the order in which they build on each other; the last one starts the page."""
    parts = [(TEMPLATES / f"{name}.js").read_text(encoding="utf-8") for name in names]
    return "\n".join(['"use strict";', *parts])


def script_digest(script: str) -> str:
    """Return the digest by which the page's policy allows a script: SHA-256 of the text in UTF-8,
    in base64.
    """
    return base64.b64encode(hashlib.sha256(script.encode("utf-8")).digest()).decode("ascii")


def fill_page(
    title: str, sheets: Sequence[Mapping[str, Any]], moves: bool = False, **values: Any
) -> str:
    """Fill the page's template with styles, scripts, and the digests by which its policy allows
    these.

    Args:
        title: of the page.
        sheets: see `SectionContent`.
        moves: whether more than tables moves.
        values: what the templates read besides; without `groups` of runs the sheets are all of it.
    """
    css, dark_css = (
        (TEMPLATES / file).read_text(encoding="utf-8") for file in ("page.css", "dark.css")
    )
    first, last = (FIRST_SCRIPTS, SCRIPTS) if moves else (STILL_FIRST_SCRIPTS, STILL_SCRIPTS)
    scripts = {"first": page_script(first), "last": page_script(last)}
    digests = [*map(script_digest, scripts.values())]
    values |= {"title": title, "sheets": sheets, "css": css, "dark_css": dark_css}
    template = template_environment().get_template("page.html.j2")
    return template.render(scripts=scripts, script_digests=digests, **values)


def render_page(report: Report) -> str:
    """Fill the templates; equal reports give equal text."""
    plot = PLOT | {"numbers": page_numbers(report)}
    contexts = _groups(report, plot)
    return fill_page(
        " · ".join(dict.fromkeys(group.titles for group in report.groups)),
        [sheet for content in report.contents for sheet in content.sheets],
        moves=any(section["data"] for group in contexts for section in group["sections"]),
        groups=contexts,
        plot=plot,
        absent=report.absent,
        **report.values(""),
    )


def page_numbers(report: Report) -> dict[str, int]:
    """Return the number of each method of a page by its name, the same on all tabs and in the
    figures next to the page.
    """
    names = [run.name(label) for run in report.runs.values() for label in run.labels]
    names += [
        row.name
        for group in report.groups
        for table in group.tables
        for row in table.rows
        if row.label
    ]
    return method_numbers(
        [*names, *(name for content in report.contents for name in content.names)]
    )


def template_environment() -> "Environment":
    """Return the page's templates, with its filters."""
    environment = open_templates(TEMPLATES)
    environment.filters |= {"coded": _coded, "copyable": copyable}
    return environment


def _coded(text: str) -> str:
    """Return text for HTML with code between backticks."""
    from markupsafe import Markup, escape

    return Markup(re.sub(r"`([^`]*)`", r"<code>\1</code>", str(escape(text))))


def _groups(report: Report, plot: dict[str, Any]) -> list[dict[str, Any]]:
    """Build the template context of each group.

    Places have the same names in all groups, behind the group's own.
    """
    groups = report.groups
    names = _tab_names(groups)
    tabs = zip(names, _addresses(names), strict=True)
    contexts = []
    for group in groups:
        runs = [*group.runs.values()]
        sections = [
            _section(report, key, run, *next(tabs), plot) for key, run in group.runs.items()
        ]
        values = report.values(group.id)
        filled = {name for of_it in (values, *sections) for name, value in of_it.items() if value}
        context = {
            "id": group.id,
            "place": f"{group.id}-" if len(groups) > 1 else "",
            "level": 3 if len(groups) > 1 else 2,
            "heading": group.heading,
            "titles": group.titles,
            "protocol": group.protocol,
            "provenance": group.results.provenance,
            "metrics": runs[0].metrics,
            "n_methods": len({label for run in runs for label in run.labels}),
            "tables": [*group.tables, *report.tables(group.id)],
            "elsewhere": (),
            "sources": _sources(runs),
            "leaders": leaders(group.tables),
            "verdict": group.verdict,
            "methods": {run.name(label): label for run in runs for label in run.labels},
            "blocks": filled,
            "parts": _parts(filled | {"results", "measured"}),
            "several_datasets": len({table.dataset for table in group.tables}) > 1,
            "has_published_rows": any(
                row.kind == "published" for table in group.tables for row in table.rows
            ),
            "sections": sections,
        }
        contexts.append(context | values)
    return contexts


def _sources(runs: Sequence[MeasuredRun]) -> str:
    """State the source cameras of the pictures, if known for every method."""
    if not all(set(run.labels) <= run.from_sources for run in runs):
        return ""
    synthesis = runs[0].protocol.synthesis
    return f", from {synthesis.k} other cameras, {CHOSEN_AS[synthesis.sources]}"


def _parts(blocks: Collection[str]) -> list[Part]:
    """Return the parts that have something to show."""
    parts = []
    for anchor, title, names in PARTS:
        parts_shown = tuple(name for name in names if name in blocks)
        if parts_shown:
            parts.append((*(VIEWS if parts_shown[0] == "views" else (anchor, title)), parts_shown))
    return parts


def _tab_names(groups: Sequence[RunGroup]) -> list[str]:
    """Name each run in the run selector by its title, and what else distinguishes it."""
    runs = [(group, run) for group in groups for run in group.runs.values()]
    names = [
        [run.title for _, run in runs],
        [f"{run.title}, {run.scene}" for _, run in runs],
        [group.heading for group, _ in runs],
        [f"{group.heading}, {run.scene}" for group, run in runs],
    ]
    return next(
        (candidates for candidates in names if len(set(candidates)) == len(runs)), names[-1]
    )


def _addresses(names: Sequence[str]) -> list[str]:
    """Return the same in words of an address, no two alike."""
    slugs = [re.sub(r"[^\w.-]+", "-", name.lower()).strip("-") for name in names]
    return [
        slug if slug and slugs.count(slug) == 1 else f"{slug}-{at}".strip("-")
        for at, slug in enumerate(slugs)
    ]


def reproduce(run: MeasuredRun, capture: str) -> list[str]:
    """Return the commands that reproduce these numbers.

    Folders by last names only, to reveal nothing of the machine.
    """
    root = run_words(run.folder.root, capture)
    local = [
        label
        for label in run.labels
        if (run.folder.renders(label, run.protocol.views.test[0]) / JOB_FILE).is_file()
    ]
    foreign = [f"{label}=RENDERS/{label}" for label in run.labels if label not in local]
    inputs = ["--with-truth"] if run.has_own_truth else ["--capture", Path(capture).name]
    inputs += ["--protocol", f"{root}/protocol.toml"]
    commands = (
        [
            [
                "prepare",
                root,
                *inputs,
                *(["--matcher", matcher] if (matcher := _matcher(run)) else []),
            ]
        ]
        if local
        else []
    )
    scored = [
        "score",
        *([root] if local else ["--run", root, *inputs]),
        *(["--renders", *foreign] if foreign else []),
    ]
    on_gpu = {render.rsplit("/", 1)[0] for render in run.results.devices}
    for device, flags in ((False, []), (True, ["--device", "cuda"])):
        if labels := [label for label in local if (label in on_gpu) == device]:
            commands.append(["render", root, "--methods", *labels, *flags])
    return [
        shlex.join(["ggvs-eval", *command]) for command in (*commands, scored, ["report", root])
    ]


def run_words(root: Path, capture: str) -> str:
    """Last name of a run folder, after its parent's where the capture has the same."""
    *_, parent, name = ("", *root.resolve().parts[1:])
    return f"{parent}/{name}" if parent and name == Path(capture).name else name


def _section(
    report: Report, key: str, run: MeasuredRun, title: str, address: str, plot: dict[str, Any]
) -> dict[str, Any]:
    """Build the template context of one run."""
    capture = run.folder.capture_record()
    data = report.data(key)
    context = {
        "id": key,
        "run": run,
        "capture": _facts(capture) | ({"depth by": matcher} if (matcher := _matcher(run)) else {}),
        "title": title,
        "address": address if data else "",
        "views": [*report.tables(key, "views"), *view_tables(run)],
        "timing": report.tables(key, "timing"),
        "data": data,
        "commands": reproduce(run, str(capture.get("path", "CAPTURE"))),
        "plot": plot,
    }
    return context | report.values(key)


def _matcher(run: MeasuredRun) -> str:
    """Name of the matcher whose depth the run has, its file without folders.

    Empty if the depth was not computed here.
    """
    record = run.folder.depth_record
    kind, colon, file = str(
        read_json(record).get("matcher", "") if record.is_file() else ""
    ).partition(":")
    return f"{kind}{colon}{Path(file).name}"


def _facts(capture: dict[str, Any]) -> dict[str, str | int | float]:
    """List the facts about the capture, including notes about what was left out."""
    plain = {
        key: value
        for key, value in capture.items()
        if key != "path" and isinstance(value, str | int | float)
    }
    facts = {FACT_NAMES.get(key, key.replace("_", " ")): value for key, value in plain.items()}
    facts |= {"cameras": len(capture["cameras"])} if capture.get("cameras") else {}
    if capture.get("notes"):
        facts["notes"] = "; ".join(capture["notes"])
    return facts
