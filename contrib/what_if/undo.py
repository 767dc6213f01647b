"""Faults of rendered frames undone: of each finding of the doctor the change that takes it back, and what it costs."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ggvs_eval.finding import Finding, Verdict, worst
from ggvs_eval.pipelines.inspection.renders.identity import ViewFrames, take_sample
from ggvs_eval.pipelines.inspection.renders.quick_checks import SAMPLED_FRAMES
from ggvs_eval.pipelines.inspection.renders.tone import tone_curves
from ggvs_eval.transforms import TRANSFORMS, Transform

# Parameters of a fault that the views differ in by less have one cause, and differ by what they were measured with.
SAME_WITHIN = {"shift_x_px": 0.1, "shift_y_px": 0.1, "scale_x": 0.004, "scale_y": 0.004, "power": 0.05}
# One gain for everything: smaller ones are within what exposure and rounding leave; honest methods have another in each view or
# channel, and haze adds light. With fewer views it could be the exposure of the test camera.
LEAST_GAIN, GAIN_SPREAD, LARGEST_HAZE_255 = 0.015, 0.01, 1.5
FEWEST_VIEWS, FEWEST_LEVELS = 2, 8
GAIN = "gain"


@dataclass(frozen=True)
class Way:
    """What undoes a fault of one view.

    Attributes:
        words: what is done.
        is_exact: whether no value is interpolated or rounded.
        border_px: width along each side within which pixels are made of pixels outside the picture.
    """

    words: str
    change: Callable[[ViewFrames], ViewFrames]
    is_exact: bool = True
    border_px: int = 0


@dataclass(frozen=True)
class Undo:
    """A fault of some views and its way back.

    Attributes:
        fault: question of the findings.
        verdict: the surest of them.
        ways: name of a view -> what undoes the fault there; other views stay as they are.
        of_truth: the same by changes of the truth instead, where the renders would be interpolated.
        views: how many there are.
    """

    fault: str
    verdict: Verdict
    ways: dict[str, Way]
    of_truth: dict[str, Way]
    views: int

    def words(self, on_truth: bool = False) -> str:
        """Return what is done, for a row of a table: one way for all that share it, in how many views."""
        ways = self.of_truth if on_truth else self.ways
        several = list(dict.fromkeys(way.words for way in ways.values()))
        words = " or ".join(several)
        if len(several) > 2:
            words = f"{several[0]} in {next(iter(ways))}, others by their own"
        return words if len(ways) == self.views else f"{words}, in {len(ways)} of {self.views} views"


def list_undos(findings: Sequence[Finding], views: Mapping[str, ViewFrames]) -> tuple[list[Undo], list[Finding]]:
    """Return what undoes the findings on some views, in the order in which it is applied, and the findings that stay.

    Args:
        findings: of `examine`, on the same views.
        views: the frames that the parameters are estimated on.

    Reading:
        In a view that shows another camera, further findings compare with that camera; they stay. So does a reversed order of
        frames some of which are blank: about which instant it turns is not known.
    """
    astray = {finding.subject for finding in findings if finding.question == "wrong camera"}
    blank = {finding.subject for finding in findings if finding.question == "blank frames"}
    by_fault: dict[str, list[Finding]] = {fault: [] for fault in _FAULTS}
    rest: list[Finding] = []
    for finding in findings:
        is_unsure = finding.question == "reversed time" and finding.subject in blank
        is_undone = finding.question in by_fault and finding.subject not in astray and not is_unsure
        (by_fault[finding.question] if is_undone else rest).append(finding)
    undos = [_undo(fault, of_fault, views) for fault, of_fault in by_fault.items() if of_fault]
    if not by_fault["tone curve"] and not by_fault["value range"] and not astray:
        undos += _gain_undos({name: apply(undos, name, view) for name, view in views.items()})
    return undos, rest


def apply(undos: Sequence[Undo], name: str, view: ViewFrames, on_truth: bool = False) -> ViewFrames:
    """A view with faults undone, those of its geometry on the truth's side if wanted."""
    for undo in undos:
        ways = undo.of_truth if on_truth and undo.of_truth else undo.ways
        view = ways[name].change(view) if name in ways else view
    return view


def _undo(fault: str, findings: Sequence[Finding], views: Mapping[str, ViewFrames]) -> Undo:
    undo = Undo(fault, worst(findings), {}, {}, len(views))
    for finding in findings:
        name, values = finding.subject, dict(finding.values) | _alike(findings)
        if fault in _OF_TIME:
            undo.ways[name] = _OF_TIME[fault](round(values["offset_frames"]))
            continue
        height, width = views[name].truth(views[name].frames[0]).shape[:2]
        transform = TRANSFORMS[fault](values, (width, height))
        undo.ways[name] = _of_renders(transform)
        if transform.truth_words:
            undo.of_truth[name] = _of_truth(transform)
    return undo


def _alike(findings: Sequence[Finding]) -> dict[str, float]:
    """Parameters that all views have alike, as their median, which is surer than that of one view."""
    alike = {}
    for key, largest in SAME_WITHIN.items():
        of_views = [finding.values[key] for finding in findings if key in finding.values]
        if of_views and np.ptp(of_views) < largest:
            alike[key] = float(np.median(of_views))
    return alike


def _of_renders(transform: Transform) -> Way:
    return Way(
        transform.words,
        lambda view: view.with_rendered(transform.inverse),
        transform.is_exact,
        transform.border_px,
    )


def _of_truth(transform: Transform) -> Way:
    return Way(
        f"the truth {transform.truth_words} instead",
        lambda view: view.with_truth(lambda index: transform.apply(view.truth(index))),
    )


def _undo_offset(lag: int) -> Way:
    return Way(f"frames renumbered by {lag:+d}", lambda view: view.moved(lag))


def _undo_reversal(lag: int) -> Way:
    words = "frames in reversed order" + (f", renumbered by {lag:+d}" if lag else "")
    return Way(words, lambda view: view.reversed(lag))


_OF_TIME = {"reversed time": _undo_reversal, "frame offset": _undo_offset}
# Faults in the order in which they are undone.
_FAULTS = (
    *("mirrored", "wrong resize", "focal length", "shift"),
    *_OF_TIME,
    *("channel order", "value range", "tone curve"),
)


def find_gain(views: Mapping[str, ViewFrames]) -> float | None:
    """Return the gain that all channels of all views have alike; None if there is none to speak of.

    Reading:
        The doctor asks for no gain, since the exposure of cameras differs and methods blend them. One number for every channel of
        every view, and no haze with it, is hardly the cameras': it is undone as "likely".
    """
    curves = [curve for view in views.values() for curve in tone_curves(take_sample(view, SAMPLED_FRAMES))]
    if len(views) < FEWEST_VIEWS or min(len(curve) for curve in curves) < FEWEST_LEVELS:
        return None
    gains = np.array([float(np.median(curve[:, 1] / curve[:, 0])) for curve in curves])
    haze_255 = float(np.median([np.polyfit(curve[:, 0], curve[:, 1], 1)[1] for curve in curves]))
    gain = float(np.median(gains))
    if abs(gain - 1) < LEAST_GAIN or np.ptp(gains) > GAIN_SPREAD or abs(haze_255) > LARGEST_HAZE_255:
        return None
    return gain


def _gain_undos(views: Mapping[str, ViewFrames]) -> list[Undo]:
    gain = find_gain(views)
    if gain is None:
        return []
    way = _of_renders(TRANSFORMS[GAIN]({"gain": gain}, (1, 1)))
    return [Undo(GAIN, "likely", dict.fromkeys(views, way), {}, len(views))]
