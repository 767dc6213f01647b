"""The verb of the command line that checks a capture."""

import sys
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro

from ggvs_eval.datasets.assemble import Crop, write_crop
from ggvs_eval.datasets.public_captures import locate
from ggvs_eval.errors import CaptureError, CommandError, no_such_path
from ggvs_eval.pipelines.commands.flags import (
    ONE_PER_CORE,
    CaptureFolder,
    Jobs,
    Layout,
    given_units,
)


def check(
    capture: CaptureFolder,
    layout: Layout = None,
    units: str | None = None,
    out: Path | None = None,
    repair: bool = False,
    crop: Annotated[tuple[int, int] | None, tyro.conf.arg(metavar="COLUMN ROW")] = None,
    jobs: Jobs = ONE_PER_CORE,
    watch: Annotated[float | None, tyro.conf.arg(metavar="SECONDS")] = None,
    rig: Path | None = None,
    page: Path | None = None,
    json: bool = False,
) -> None:
    """Check a capture for faults in frames, poses, timing and colour.

    Prints one verdict per question, writes them as JSON, and exits with 1 if a verdict is bad.
    Videos without poses get the checks that need none.

    Args:
        capture: capture, or videos without poses.
        layout: layout on disk; detected by default.
        units: world units per metre, or a TOML file with a known distance (docs/captures.md).
        out: JSON file; CAPTURE.check.json in the current folder by default.
        repair: write CAPTURE/corrections.toml (whole-frame delays, colour gains), and pair frames
            by time where lengths or rates differ; all commands apply both.
        crop: first column and row of cropped frames; written to CAPTURE/crop.toml, which all
            commands apply.
        jobs: parallel processes, at least 1.
        watch: seconds between checks of a folder during capture; prints changes of a camera's
            state.
        rig: with --watch: calibrated capture of the same cameras, for time offsets and colours.
        page: with --watch: HTML file of the state, which refreshes itself.
        json: with --watch: print every round as JSON lines.
    """
    if watch is not None:
        _watch(capture, watch, rig, page, json)
        return
    from ggvs_eval.pipelines.inspection.capture.check import pair_by_time, run_check
    from ggvs_eval.pipelines.inspection.capture.colour import describe_repair, repair_capture

    capture = locate(capture)
    if not capture.exists():
        raise CaptureError(no_such_path(capture, "a folder or a file with a capture"))
    out = out or Path(f"{capture.resolve().name}.check.json")
    if crop is not None:
        print(write_crop(capture if capture.is_dir() else capture.parent, Crop(*crop)))
    look = partial(run_check, capture, out, layout=layout, units=given_units(units), workers=jobs)
    if repair and (paired := pair_by_time(capture)):
        print(paired)
    inspected, table = look()
    if repair and (report := repair_capture(capture, inspected.findings)):
        print(report)
        before = inspected.findings
        inspected, table = look()
        print(*describe_repair(before, inspected.findings), sep="\n")
    print(table)
    print(out)
    if not inspected.is_usable:
        sys.exit(1)


def _watch(
    frames: Path, every_s: float, rig: Path | None, page: Path | None, as_json: bool
) -> None:
    from ggvs_eval.pipelines.inspection.capture.watch import watch

    if not every_s > 0:
        raise CommandError(f"--watch {every_s:g}: wanted a positive number of seconds")
    try:
        for line in watch(frames, every_s, rig=rig and locate(rig), page=page, as_json=as_json):
            print(line, flush=True)
    except KeyboardInterrupt:
        return
