"""The verb of the command line that scores frames with their faults undone: what-if."""

from pathlib import Path
from typing import Annotated

import tyro

from ggvs_eval.pipelines.commands.renders import RENDERS_DEFAULTS, Renders, RendersFlags

FrameMetrics = Annotated[tuple[str, ...], tyro.conf.arg(metavar="METRIC ...")]


def what_if(
    renders: Renders,
    metrics: FrameMetrics = ("PSNR", "SSIM", "LPIPS"),
    out: Path | None = None,
    source: RendersFlags = RENDERS_DEFAULTS,
) -> None:
    """Score rendered frames again with each fault that doctor finds undone.

    Shift, scale, frame offset, reversed time, gain, tone curve, value range, channel order and
    flips are estimated on half of the frames and undone in the other half; flicker is undone by the
    gain of each frame. Nothing of it enters results, tables or rankings; the page of RUN shows the
    frames so.

    Args:
        renders: frames in any form that `score` takes, with --capture; or a run folder, whose
            methods are all examined.
        metrics: metrics of single frames.
        out: JSON file to write the rows to.
        source: capture and protocol of the renders.
    """
    from ggvs_eval.contrib.what_if.page import keep_for_page
    from ggvs_eval.contrib.what_if.what_if import what_if as undo_and_score
    from ggvs_eval.contrib.what_if.what_if import what_if_text
    from ggvs_eval.pipelines.inspection.renders.identity import cameras_of_run, views_of_run
    from ggvs_eval.run_folder import write_json

    records = {}
    with source.open(renders) as (folder, labels):
        measurement = folder.protocol().measurement
        for label in labels:
            outcome = undo_and_score(
                views_of_run(folder, label), cameras_of_run(folder), measurement, metrics
            )
            records[label] = outcome.record()
            print(what_if_text(label, outcome))
        keep_for_page(folder, {label: bool(record["rows"]) for label, record in records.items()})
    if out is not None:
        write_json(out, records)
