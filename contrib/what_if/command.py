"""The verb of the command line that scores frames with their faults undone: what-if."""

from pathlib import Path
from typing import Annotated

import tyro

from ggvs_eval.pipelines.commands.flags import CAPTURE_DEFAULTS, ONE_PER_CORE, CaptureFlags, Jobs
from ggvs_eval.pipelines.commands.renders import Renders, open_renders

FrameMetrics = Annotated[tuple[str, ...], tyro.conf.arg(metavar="METRIC ...")]


def what_if(
    renders: Renders,
    capture: Path | None = None,
    protocol: str | None = None,
    metrics: FrameMetrics = ("PSNR", "SSIM", "LPIPS"),
    out: Path | None = None,
    run: Path | None = None,
    first_frame: int | None = None,
    reading: CaptureFlags = CAPTURE_DEFAULTS,
    jobs: Jobs = ONE_PER_CORE,
) -> None:
    """Score rendered frames again with each fault that doctor finds undone.

    Shift, scale, frame offset, reversed time, gain, tone curve, value range, channel order and flips are estimated on half of the
    frames and undone in the other half. Nothing of it enters results, tables or rankings; the page of RUN shows the frames so.

    Args:
        renders: frames in any form that `score` takes, with --capture; or a run folder, whose methods are all examined.
        capture: what was rendered.
        protocol: a .toml file or a packaged name; by default the packaged one that fits the capture.
        metrics: metrics of single frames.
        out: JSON file to write the rows to.
        run: run folder to make or to continue; a temporary one by default, under the protocol of scores/CAPTURE if any.
        first_frame: number of the protocol's first frame in the names of the frames, as of `score`.
        reading: how the capture is read.
        jobs: processes.
    """
    from ggvs_eval.contrib.what_if.page import keep_for_page
    from ggvs_eval.contrib.what_if.what_if import what_if as undo_and_score
    from ggvs_eval.contrib.what_if.what_if import what_if_text
    from ggvs_eval.pipelines.inspection.renders.identity import cameras_of_run, views_of_run
    from ggvs_eval.run_folder import write_json

    records = {}
    with open_renders(renders, capture, protocol, run, first_frame, reading, jobs) as (folder, labels):
        measurement = folder.protocol().measurement
        for label in labels:
            found = undo_and_score(views_of_run(folder, label), cameras_of_run(folder), measurement, metrics)
            records[label] = found.record()
            print(what_if_text(label, found))
        keep_for_page(folder, {label: bool(record["rows"]) for label, record in records.items()})
    if out is not None:
        write_json(out, records)
