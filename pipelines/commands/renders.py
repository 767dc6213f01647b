"""The verbs of the command line that question frames: doctor and steadiness."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import tyro

from ggvs_eval.coverage import guessed_first
from ggvs_eval.errors import MetricError, RenderError
from ggvs_eval.pipelines.commands.flags import CAPTURE_DEFAULTS, ONE_PER_CORE, CaptureFlags, Jobs
from ggvs_eval.run_folder import RunFolder

Renders = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RENDERS|RUN")]
Videos = Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="NAME=PATH")]


@dataclass(frozen=True)
class RendersOptions:
    """Options of commands that question renders.

    Attributes:
        capture: rendered capture.
        protocol: protocol (.toml or packaged name); fitted to the capture by default.
        run: run folder to create or resume; temporary by default, with the protocol of scores/CAPTURE.
        first_frame: number of the protocol's first frame in the file names, if ambiguous.
        reading: capture reading.
        jobs: parallel processes, at least 1.
    """

    capture: Path | None = None
    protocol: str | None = None
    run: Path | None = None
    first_frame: int | None = None
    reading: CaptureFlags = CAPTURE_DEFAULTS
    jobs: Jobs = ONE_PER_CORE

    @contextmanager
    def open(self, renders: Path, allow_partial: bool = False) -> Iterator[tuple[RunFolder, list[str]]]:
        """A run folder with the frames in question, and what they are called there; it goes where none is named."""
        if (renders / "protocol.toml").is_file():
            folder = RunFolder(renders)
            yield folder, folder.labels()
            return
        from ggvs_eval.pipelines.run.import_renders import SCORES_ROOT, import_renders, named_renders, require_there, run_for

        require_there(named := named_renders((str(renders),)))
        capture, protocol, run = self.capture, self.protocol, self.run
        scored = RunFolder(SCORES_ROOT / capture.resolve().name).protocol_file if capture else Path()
        if run is None and protocol is None and scored.is_file():
            protocol = str(scored)
        with TemporaryDirectory(prefix="ggvs-eval-") as scratch:
            root = Path(scratch) / "run" if run is None and capture else run
            with run_for(root, partial(self.reading.open, capture) if capture else None, protocol, self.jobs) as folder:
                ((label, path),) = named.items()
                record = import_renders(folder, label, path, allow_partial, self.jobs, self.first_frame, link=run is None)
                for note in record["notes"]:
                    print(f"{label}: {note}", file=sys.stderr)
            yield folder, [label]


RendersFlags = tyro.conf.OmitArgPrefixes[RendersOptions]
RENDERS_DEFAULTS = RendersOptions()


def doctor(
    renders: Renders,
    source: RendersFlags = RENDERS_DEFAULTS,
) -> None:
    """Find faults in rendered frames before they are scored.

    Finds frame offsets, reversed time, wrong cameras, swapped channels, gamma, wrong video range, flicker, shifts from a quarter
    of a pixel, wrong resizing or focal length, JPEG, missing and frozen frames, copied reference frames, and a PSNR above the
    ceiling of noise and codec. Also reports the error that IV-PSNR forgives, and whether stability is due to blur. Exits with 1
    if a fault is certain.

    Args:
        renders: frames in any form that `score` accepts, with --capture; or a run folder, for all its methods.
        source: capture and protocol of the renders.
    """
    from ggvs_eval.pipelines.inspection.renders.examine import examine, faults_table, forgiven_error
    from ggvs_eval.pipelines.inspection.renders.identity import cameras_of_run, views_there
    from ggvs_eval.pipelines.inspection.renders.quick_checks import doubt_numbering
    from ggvs_eval.pipelines.inspection.renders.steadiness import steadiness_line
    from ggvs_eval.pipelines.run.seen_views import find_seen_views

    certain = False
    with source.open(renders, allow_partial=True) as (folder, labels):
        for label in labels:
            views, missing = views_there(folder, label)
            counted_from, start = guessed_first(folder, label), folder.protocol().frames.start
            checked = [doubt_numbering(one, counted_from, start) for one in examine(views, cameras_of_run(folder))]
            findings = [*missing, *checked, *([] if missing else find_seen_views(folder, label))]
            certain |= any(finding.verdict == "certain" for finding in findings)
            print(f"{label}\n{faults_table(findings)}")
            is_explained = any(one.verdict == "certain" for one in checked)
            for line in filter(None, ("" if is_explained else forgiven_error(views), steadiness_line(views))):
                print(line)
    if certain:
        sys.exit(1)


def steadiness(
    videos: Videos,
    depth: bool = False,
    mask: Path | None = None,
    colmap: bool = False,
    out: Path | None = None,
) -> None:
    """Measure stability and sharpness of videos without a reference.

    Args:
        videos: NAME=PATH per method: folder of numbered pictures, .mp4, .mov, .npy or .npz.
        depth: paths are depth or disparity maps: .png, .tif, .pfm, .npy, .npz or grey video.
        mask: picture, white in static areas, for a fixed camera; all pixels by default.
        colmap: also test whether COLMAP registers a video of a moving camera (a few seconds each).
        out: file for the table: .md, .csv or .tex.
    """
    from ggvs_eval.pipelines.run.import_renders import named_renders
    from ggvs_eval.pipelines.run.steadiness import measure_steadiness
    from ggvs_eval.reports.tables.steadiness import FORMATS, remarks_on, steadiness_table, write_steadiness
    from ggvs_eval.reports.tables.table_formats import to_markdown

    if depth and colmap:
        raise MetricError("wanted --depth or --colmap, got both; COLMAP needs pictures, omit one")
    if out is not None and out.suffix not in FORMATS:
        raise RenderError(f"{out}: wanted a file name with {', '.join(FORMATS)}, got {out.suffix or 'none'}; change it")
    paths = named_renders(videos)
    if not paths:
        raise RenderError(
            "wanted NAME=PATH of a video, got none; run e.g. `ggvs-eval steadiness ours=renders/cam00 theirs=video.mp4`"
        )
    measured = measure_steadiness(paths, depth=depth, mask=mask, with_colmap=colmap)
    where = "in all pixels" if mask is None else f"where {mask.name} is white"
    table, remarks = (
        steadiness_table(measured.metrics, measured.values, measured.not_computed, where),
        remarks_on(measured.shapes),
    )
    print(to_markdown([table], remarks), end="")
    if out is not None:
        write_steadiness(out, table, remarks)
