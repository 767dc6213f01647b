"""The checks that every scoring carries: cheap ones of a view's frames beside its truth, see `examine` for all that there are."""

from dataclasses import replace

from ggvs_eval.pipelines.inspection.finding import Finding
from ggvs_eval.pipelines.inspection.renders.channel_order import find_channel_order
from ggvs_eval.pipelines.inspection.renders.copied import find_copied
from ggvs_eval.pipelines.inspection.renders.identity import find_identity, remember
from ggvs_eval.pipelines.inspection.renders.offset import find_offset
from ggvs_eval.pipelines.inspection.renders.repeats import scan_frames
from ggvs_eval.pipelines.inspection.renders.tone import find_tone
from ggvs_eval.pipelines.inspection.renders.view_frames import ViewFrames, longest_run, take_sample

SAMPLED_FRAMES = 12
# Copies are looked for at full size, which costs as much as all other checks together.
COPIED_FRAMES = 4


def check_quickly(name: str, view: ViewFrames) -> list[Finding]:
    """Find blank, repeated and mirrored frames, other instants, swapped channels, wrong tone and copies of the truth.

    Every frame is read once, a burst in the middle a few times. What moves a picture by less than a pixel, and whether it shows
    another camera, is left to `examine`.
    """
    scan = scan_frames(name, view)
    usable = longest_run(scan.usable)
    if not usable:
        return scan.findings
    view = replace(view, frames=usable, truth_frames=view.truth_range)
    mirrored, view = find_identity(name, view, {name: remember(view.truth)})
    sampled, view = check_sample(name, view)
    first = view.frames.start + max(len(view.frames) - COPIED_FRAMES, 0) // 2
    middle = replace(view, frames=range(first, min(first + COPIED_FRAMES, view.frames.stop)), truth_frames=view.truth_range)
    return [*scan.findings, *mirrored, *sampled, *find_copied(name, middle)]


def check_sample(name: str, view: ViewFrames, count: int = SAMPLED_FRAMES) -> tuple[list[Finding], ViewFrames]:
    """Ask a burst of neighbouring instants when it is, in which order of channels, and by which tone curve.

    Returns:
        What was found, and the view with time and channels mended.
    """
    sample = take_sample(view, count)
    shifted, view = find_offset(name, view, sample)
    sample = take_sample(view, count) if shifted else sample
    swapped, view = find_channel_order(name, view, sample)
    sample = take_sample(view, count) if swapped else sample
    return [*shifted, *swapped, *find_tone(name, sample)], view
