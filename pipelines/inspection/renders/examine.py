"""The examination of renders: each question in turn, its finding corrected before the next."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from ggvs_eval.pipelines.inspection.finding import Finding
from ggvs_eval.pipelines.inspection.renders.copied import find_copied
from ggvs_eval.pipelines.inspection.renders.flicker import find_flicker
from ggvs_eval.pipelines.inspection.renders.identity import CameraPictures, find_identity, remember
from ggvs_eval.pipelines.inspection.renders.jpeg import find_jpeg
from ggvs_eval.pipelines.inspection.renders.placement import find_placement, shared_shift
from ggvs_eval.pipelines.inspection.renders.quick_checks import SAMPLED_FRAMES, check_sample
from ggvs_eval.pipelines.inspection.renders.repeats import resized, scan_frames
from ggvs_eval.pipelines.inspection.renders.tone import of_all_views
from ggvs_eval.pipelines.inspection.renders.upscaling import find_upscaling
from ggvs_eval.pipelines.inspection.renders.view_frames import FrameReader, ViewFrames, longest_run
from ggvs_eval.pipelines.inspection.table import WIDTH, findings_table


def examine(
    views: Mapping[str, ViewFrames], cameras: Mapping[str, FrameReader] | None = None, sampled_frames: int = SAMPLED_FRAMES
) -> list[Finding]:
    """Find what went wrong between a method and the folder of its renders.

    An honest rendering, blurred, ghosted, off in colour as it may be, gets no finding: a fault is reported only where it explains
    the pictures better than no fault does, by a margin, at every instant looked at.

    Args:
        views: name -> rendered and captured frames.
        cameras: captured frames of further cameras, which a view may be mistaken for; the views' own are known.
        sampled_frames: neighbouring instants to look at per view; besides, every rendered frame is read once.

    Returns:
        Findings by view, in the order of the views.
    """
    readers = dict(cameras or {}) | {name: view.truth for name, view in views.items()}
    pictures = {name: remember(read) for name, read in readers.items()}
    examined = {name: _examine_view(name, view, pictures, sampled_frames) for name, view in views.items()}
    shared = shared_shift({name: one.shift_px for name, one in examined.items() if one.shift_px is not None})
    findings: list[Finding] = []
    for name, one in examined.items():
        is_told = any(finding.question == "shift" for finding in one.findings)
        findings += [*one.findings, *(extra for extra in shared if extra.subject == name and not is_told)]
    return of_all_views(findings, len(views))


def faults_table(findings: Sequence[Finding], width: int = WIDTH) -> str:
    """Write the findings as text; views with word for word the same finding share a line."""
    if not findings:
        return "nothing found: no sign of any of the known faults"
    return findings_table(findings, width, ("fault", "view"), most_lines=len(findings))


@dataclass(frozen=True)
class _Examined:
    """Findings of one view, and its shift where it could be measured."""

    findings: list[Finding]
    shift_px: tuple[float, float] | None = None


def _examine_view(name: str, view: ViewFrames, cameras: Mapping[str, CameraPictures], count: int) -> _Examined:
    scan = scan_frames(name, view)
    usable = longest_run(scan.usable)
    if not usable:
        return _Examined(scan.findings)
    view = replace(view, frames=usable, truth_frames=view.truth_range)
    has_size = all(finding.question != "wrong size" for finding in scan.findings)
    if not has_size:
        height, width = view.truth(usable[0]).shape[:2]
        view = view.with_rendered(lambda image: resized(image, width, height))
    # Traces in the pixels as they lie on disk. JPEG has a period of its own, and so has what was cropped and enlarged.
    jpeg = find_jpeg(name, view) if has_size else []
    enlarged = find_upscaling(name, view) if has_size and not jpeg else []
    picture = _examine_picture(name, view, cameras, count)
    enlarged = [] if any(finding.question == "wrong resize" for finding in picture.findings) else enlarged
    return _Examined([*scan.findings, *picture.findings, *enlarged, *jpeg], picture.shift_px)


def _examine_picture(name: str, view: ViewFrames, cameras: Mapping[str, CameraPictures], count: int) -> _Examined:
    """Examine a picture: its view, instant, colours and placement."""
    findings, view = find_identity(name, view, cameras)
    placed = find_placement(name, view)
    sampled, view = check_sample(name, placed.view, count)
    copied = find_copied(name, view)
    # Copies among renders of another exposure flicker, too.
    flicker = [] if copied else find_flicker(name, view)
    return _Examined([*findings, *sampled, *flicker, *copied, *placed.findings], placed.shift_px)
