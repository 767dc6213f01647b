"""The verb of the command line that looks for faults in renders."""

import sys

from ggvs_eval.coverage import guessed_first
from ggvs_eval.pipelines.commands.renders import RENDERS_DEFAULTS, Renders, RendersFlags


def doctor(
    renders: Renders,
    source: RendersFlags = RENDERS_DEFAULTS,
) -> None:
    """Find faults in rendered frames before they are scored.

    Finds frame offsets, reversed time, wrong cameras, swapped channels, gains, casts, gamma, wrong
    video range, flicker, shifts from a quarter of a pixel, wrong resizing or focal length, black
    borders, JPEG, missing and frozen frames, copied reference frames, and a PSNR above the ceiling
    of noise and codec. Also reports a PSNR that no fault explains, and whether stability is due to
    blur. Exits with 1 if a fault is certain.

    Args:
        renders: frames in any form that `score` accepts, with --capture; or a run folder, for all
            its methods.
        source: capture and protocol of the renders.
    """
    from ggvs_eval.pipelines.inspection.renders.examine import examine, explain_loss, faults_table
    from ggvs_eval.pipelines.inspection.renders.identity import cameras_of_run, views_there
    from ggvs_eval.pipelines.inspection.renders.quick_checks import doubt_numbering
    from ggvs_eval.pipelines.inspection.renders.steadiness import steadiness_line
    from ggvs_eval.pipelines.run.seen_views import find_seen_views

    certain = False
    with source.open(renders, allow_partial=True) as (folder, labels):
        for label in labels:
            views, missing = views_there(folder, label)
            counted_from, start = guessed_first(folder, label), folder.protocol().frames.start
            answers = examine(views, cameras_of_run(folder), with_unknown=True)
            checked = [doubt_numbering(answer, counted_from, start) for answer in answers]
            findings = [*missing, *checked, *([] if missing else find_seen_views(folder, label))]
            certain |= any(finding.verdict == "certain" for finding in findings)
            lines = [faults_table(findings)] if findings else []
            is_clear = all(finding.verdict == "unknown" for finding in findings)
            print(label, *lines, *([explain_loss(views)] if is_clear else []), sep="\n")
            if stability := steadiness_line(views):
                print(stability)
    if certain:
        sys.exit(1)
