"""The verbs of the command line that question frames: doctor, explain and steadiness."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import tyro

from ggvs_eval.built_in import CONVENTIONS
from ggvs_eval.errors import MetricError, RenderError
from ggvs_eval.pipelines.commands.flags import CAPTURE_DEFAULTS, ONE_PER_CORE, CaptureFlags, CaptureOptions, Jobs
from ggvs_eval.run_folder import RunFolder

Renders = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RENDERS|RUN")]
Videos = Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="NAME=PATH")]
Quoted = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="VALUE")]
Metric = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar=f"{{{','.join(CONVENTIONS)}}}")]


def doctor(
    renders: Renders,
    capture: Path | None = None,
    protocol: str | None = None,
    run: Path | None = None,
    first_frame: int | None = None,
    reading: CaptureFlags = CAPTURE_DEFAULTS,
    jobs: Jobs = ONE_PER_CORE,
) -> None:
    """Find what is wrong with rendered frames before their numbers are believed.

    Frame offset, reversed time, wrong camera, exchanged colour channels, gamma, range of video levels, flicker, shifts down to a
    quarter of a pixel, wrong resize or focal length, JPEG, frozen frames, truth copied into some frames or blended into all, a
    PSNR beyond what noise and codec leave a perfect rendering. The last lines say how much of the error IV-PSNR forgives, and
    whether blur is what makes the renders steady. Ends with 1 where something is certain.

    Args:
        renders: frames in any form that `score` takes, with --capture; or a run folder, whose methods are all examined.
        capture: what was rendered.
        protocol: a .toml file or a packaged name; by default the packaged one that fits the capture.
        run: run folder to make or to go on with; a temporary one by default, under the protocol of scores/CAPTURE if any.
        first_frame: number of the protocol's first frame in the names of the frames, as of `score`.
        reading: how the capture is read.
        jobs: processes.
    """
    from ggvs_eval.pipelines.inspection.renders.examine import examine, faults_table
    from ggvs_eval.pipelines.inspection.renders.explain import forgiven_error
    from ggvs_eval.pipelines.inspection.renders.identity import cameras_of_run, views_of_run
    from ggvs_eval.pipelines.inspection.renders.steadiness import steadiness_line
    from ggvs_eval.pipelines.run.references import find_seen_views

    certain = False
    with open_renders(renders, capture, protocol, run, first_frame, reading, jobs) as (folder, labels):
        for label in labels:
            views = views_of_run(folder, label)
            findings = [*examine(views, cameras_of_run(folder)), *find_seen_views(folder, label)]
            certain |= any(finding.verdict == "certain" for finding in findings)
            print(f"{label}\n{faults_table(findings)}")
            for line in filter(None, (forgiven_error(views), steadiness_line(views))):
                print(line)
    if certain:
        sys.exit(1)


def explain(
    renders: Renders,
    metric: Metric,
    quoted: Quoted,
    method: str | None = None,
    capture: Path | None = None,
    protocol: str | None = None,
    run: Path | None = None,
    first_frame: int | None = None,
    reading: CaptureFlags = CAPTURE_DEFAULTS,
    jobs: Jobs = ONE_PER_CORE,
) -> None:
    """Recompute a number under every convention in use and say which one gives a quoted value, if any does.

    Args:
        renders: frames in any form that `score` takes, with --capture; or a run folder.
        metric: family of the number.
        quoted: the value as it is printed, with its digits.
        method: which method of a run folder; needed where it has several.
        capture: what was rendered.
        protocol: a .toml file or a packaged name; by default the packaged one that fits the capture.
        run: run folder to make or to go on with; a temporary one by default, under the protocol of scores/CAPTURE if any.
        first_frame: number of the protocol's first frame in the names of the frames, as of `score`.
        reading: how the capture is read.
        jobs: processes.
    """
    from ggvs_eval.pipelines.inspection.renders.explain import explain as recompute
    from ggvs_eval.pipelines.inspection.renders.explain import explanation_table, metric_family, printed
    from ggvs_eval.pipelines.inspection.renders.identity import views_of_run

    metric_family(metric)  # a mistyped name or number shows before anything is read
    printed(quoted)
    with open_renders(renders, capture, protocol, run, first_frame, reading, jobs) as (folder, labels):
        if method is None and len(labels) != 1:
            raise RenderError(f"{folder.root}: has {', '.join(labels)}; say which with --method")
        views = views_of_run(folder, method or labels[0], as_measured=True)
        print(explanation_table(metric, quoted, recompute(metric, quoted, views)))


def steadiness(
    videos: Videos,
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


@contextmanager
def open_renders(
    renders: Path,
    capture: Path | None,
    protocol: str | None,
    run: Path | None,
    first_frame: int | None,
    reading: CaptureOptions,
    jobs: int,
) -> Iterator[tuple[RunFolder, list[str]]]:
    """A run folder with the frames in question, and what they are called there; it goes where none is named."""
    if (renders / "protocol.toml").is_file():
        folder = RunFolder(renders)
        yield folder, folder.labels()
        return
    from ggvs_eval.pipelines.run.import_renders import SCORES_ROOT, import_renders, named_renders, run_for

    scored = RunFolder(SCORES_ROOT / capture.resolve().name).protocol_file if capture else Path()
    if run is None and protocol is None and scored.is_file():
        protocol = str(scored)
    with TemporaryDirectory(prefix="ggvs-eval-") as scratch:
        root = Path(scratch) / "run" if run is None and capture else run
        with run_for(root, partial(reading.open, capture) if capture else None, protocol, jobs) as folder:
            ((label, path),) = named_renders((str(renders),)).items()
            for note in import_renders(folder, label, path, workers=jobs, first_frame=first_frame, link=run is None)["notes"]:
                print(f"{label}: {note}", file=sys.stderr)
        yield folder, [label]
