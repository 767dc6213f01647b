"""Faults of rendered frames undone: of each finding of the doctor the change that takes it back,
and what it costs.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.files.images import round_levels
from ggvs_eval.finding import Finding, Verdict, worst
from ggvs_eval.pipelines.inspection.renders.identity import ViewFrames
from ggvs_eval.pipelines.inspection.renders.undo import change_of
from ggvs_eval.transforms import Transform, at_ends

# What levels lose is known within a factor of two. Renders are hardly sharper than the truth, and
# hardly have a tenth of the squared error of themselves interpolated.
MARGIN, PLAUSIBLE, LEAST_SHARE = 2.0, 1.2, 0.1
# Cubic interpolation loses at most this multiple of what linear interpolation of its result loses.
SHARP = 2.0
Change = Callable[[ViewFrames], ViewFrames]


@dataclass(frozen=True)
class Way:
    """What undoes a fault of one view.

    Attributes:
        words: what is done.
        is_exact: whether no value is interpolated or rounded.
        border_px: width along each side within which pixels are made of pixels outside the picture.
        transform: of the pictures; None where only their order is changed.
        at_ends: the same with each parameter of the fault at an end of its interval; none where
            these are known.
    """

    words: str
    change: Change
    is_exact: bool = True
    border_px: int = 0
    transform: Transform | None = None
    at_ends: tuple[Change, ...] = ()


@dataclass(frozen=True)
class Undo:
    """A fault of some views and its way back.

    Attributes:
        fault: question of the findings.
        verdict: the surest of them.
        ways: name of a view -> what undoes the fault there; other views stay as they are.
        views: how many there are.
    """

    fault: str
    verdict: Verdict
    ways: dict[str, Way]
    views: int

    def words(self) -> str:
        """Return what is done, for a row of a table: one way for all that share it, in how many
        views.
        """
        several = list(dict.fromkeys(way.words for way in self.ways.values()))
        words = " or ".join(several)
        if len(several) > 2:
            words = f"{several[0]} in {next(iter(self.ways))}, others by their own"
        return (
            words
            if len(self.ways) == self.views
            else f"{words}, in {len(self.ways)} of {self.views} views"
        )

    def at_end(self, number: int) -> "Undo":
        """Return the same with one parameter of every view at an end of its interval."""
        ways = {
            name: replace(way, change=way.at_ends[number]) if way.at_ends else way
            for name, way in self.ways.items()
        }
        return replace(self, ways=ways)


def list_undos(
    findings: Sequence[Finding], views: Mapping[str, ViewFrames]
) -> tuple[list[Undo], list[Finding]]:
    """Return what undoes the findings on some views, in the order in which it is applied, and the
    findings that stay.

    Args:
        findings: of `examine`, on the same views.
        views: the frames that the parameters are estimated on.

    Reading:
        In a view that shows another camera, further findings compare with that camera; they stay.
        So does a reversed order of frames some of which are blank: about which instant it turns is
        not known.
    """
    astray = {finding.subject for finding in findings if finding.question == "wrong camera"}
    blank = {finding.subject for finding in findings if finding.question == "blank frames"}
    by_fault: dict[str, dict[str, Way]] = {fault: {} for fault in _FAULTS}
    remaining: list[Finding] = []
    for finding in findings:
        is_unsure = finding.question == "reversed time" and finding.subject in blank
        if finding.question in by_fault and finding.subject not in astray and not is_unsure:
            by_fault[finding.question][finding.subject] = _way(finding, views[finding.subject])
        else:
            remaining.append(finding)
    undos = []
    for fault, ways in by_fault.items():
        if ways:
            verdict = worst([finding for finding in findings if finding.question == fault])
            undos.append(Undo(fault=fault, verdict=verdict, ways=ways, views=len(views)))
    return undos, remaining


def apply(undos: Sequence[Undo], name: str, view: ViewFrames) -> ViewFrames:
    """A view with faults undone."""
    for undo in undos:
        view = undo.ways[name].change(view) if name in undo.ways else view
    return view


def put_back(undos: Sequence[Undo], name: str, undone: Image8, truth: Image8, sign: int) -> Image8:
    """Return an undone frame with more errors (sign 1) or less (-1) by what was lost, or with lost
    detail put back (0).

    Reading:
        What levels lose by rounding and clipping is what the truth loses: a pixel in which the
        truth would have become the undone level may have been the truth, and errors like those of
        the truth, but mirrored, come on top. What interpolation loses is a part of the squared
        error, or lowered it; of soft renders, whose errors look like it, about twice what it loses
        again.
    """
    change = 0.0
    for undo in undos:
        transform = undo.ways[name].transform if name in undo.ways else None
        if transform and transform.soft and not sign:
            undone = round_levels(
                undone + 2 * (undone.astype(np.float32) - transform.inverse(transform.soft(undone)))
            )
        elif transform and transform.soft:
            change += sign * lost_energy(transform, undone, truth)
        elif transform:
            survivor = transform.inverse(transform.apply(truth))
            lost = MARGIN * (truth.astype(np.float32) - survivor)[:, ::-1]
            undone = (
                round_levels(undone + lost)
                if sign > 0
                else np.where(survivor == undone, truth, undone)
            )
    error = undone.astype(np.float32) - truth
    return round_levels(
        truth + error * np.sqrt(max(1 + change / max(np.square(error).mean(), 1e-9), LEAST_SHARE))
    )


def lost_energy(transform: Transform, undone: Image8, truth: Image8) -> float:
    """Estimate the mean squared difference of a frame from the same after interpolation and its
    undoing.

    Reading:
        An undone frame that was interpolated lost the more, the sharper the renders are. How much
        it loses by a second time says how sharp, and the truth says what its like has lost before.
        A frame that is sharper than the undone truth was not interpolated linearly, and lost less.
    """
    soft = transform.soft or transform.apply
    survivor = transform.inverse(soft(truth))
    loss, of_truth = (
        _difference(picture, transform.inverse(soft(picture))) for picture in (undone, survivor)
    )
    if loss > PLAUSIBLE * of_truth:
        return SHARP * loss
    return _difference(truth, survivor) * loss / max(of_truth, 1e-9)


def _difference(first: Image8, second: Image8) -> float:
    return float(np.square(first.astype(np.float32) - second).mean())


def _way(finding: Finding, view: ViewFrames) -> Way:
    if finding.question == "flicker":
        return _undo_flicker()
    if finding.question in _OF_TIME:
        return _OF_TIME[finding.question](round(finding.values["offset_frames"]))
    transform = change_of(finding, view)
    nearby = [
        change_of(replace(finding, values=values), view) for values in at_ends(finding.values)
    ]
    return Way(
        words=transform.words,
        change=_of_pictures(transform.inverse),
        is_exact=transform.is_exact,
        border_px=transform.border_px,
        transform=transform,
        at_ends=()
        if transform.is_exact
        else tuple(_of_pictures(change.inverse) for change in nearby),
    )


def _undo_flicker() -> Way:
    """Return what gives all frames the usual gain against their own truth, which alone knows how
    bright each should be.
    """

    def even(view: ViewFrames) -> ViewFrames:
        gains = {
            frame: view.rendered(frame).mean() / max(view.truth(frame).mean(), 1.0)
            for frame in view.frames
        }
        usual = np.mean([*gains.values()])
        return replace(
            view,
            rendered=lambda frame: round_levels(
                view.rendered(frame) * (usual / max(gains[frame], 0.01))
            ),
        )

    return Way("every frame given the usual gain against its truth", even)


def _of_pictures(change: Callable[[Image8], Image8]) -> Change:
    return lambda view: view.with_rendered(change)


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
    *("channel order", "value range", "tone curve", "gain", "flicker"),
)
