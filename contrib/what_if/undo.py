"""Faults of rendered frames undone: of each finding of the doctor the change that takes it back, and what it costs."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import ceil
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.finding import Finding, Verdict, worst
from ggvs_eval.pipelines.inspection.renders.identity import ViewFrames, take_sample
from ggvs_eval.pipelines.inspection.renders.quick_checks import CHANNELS, SAMPLED_FRAMES
from ggvs_eval.pipelines.inspection.renders.tone import VIDEO_BLACK, VIDEO_SLOPE, tone_curves

Change = Callable[[ViewFrames], ViewFrames]
LANCZOS_REACH_PX = 4
# A shift that is measured this near to whole pixels is undone by whole pixels, which loses nothing.
NEAR_WHOLE_PX = 0.1
# Parameters of a fault that the views differ in by less have one cause, and differ by what they were measured with.
SAME_WITHIN = {"shift_x_px": 0.1, "shift_y_px": 0.1, "scale_x": 0.004, "scale_y": 0.004, "power": 0.05}
# One gain for everything: smaller ones are within what exposure and rounding leave; honest methods have another in each view or
# channel, and haze adds light. With fewer views it could be the exposure of the test camera.
LEAST_GAIN, GAIN_SPREAD, LARGEST_HAZE_255 = 0.015, 0.01, 1.5
FEWEST_VIEWS, FEWEST_LEVELS = 2, 8
GAIN = "gain"


@dataclass(frozen=True)
class Undo:
    """A fault of some views and its way back.

    Attributes:
        fault: question of the findings.
        verdict: the surest of them.
        words: what is done, for a row of a table.
        exact: whether no value is interpolated or rounded.
        changes: view -> what undoes the fault there; other views stay as they are.
        of_truth: view -> the inverse change of the truth instead, where the renders would be interpolated.
        words_of_truth: that, for another row; empty if there is none.
        border_px: width along each side within which pixels are made of what lies outside of the picture.
    """

    fault: str
    verdict: Verdict
    words: str
    exact: bool
    changes: Mapping[str, Change]
    of_truth: Mapping[str, Change]
    words_of_truth: str = ""
    border_px: int = 0


def list_undos(findings: Sequence[Finding], views: Mapping[str, ViewFrames]) -> tuple[list[Undo], list[Finding]]:
    """Return what undoes the findings on some views, in the order in which it is applied, and the findings that stay.

    Args:
        findings: of `examine`, on the same views.
        views: the frames that the parameters are estimated on.

    Reading:
        In a view that shows another camera, further findings compare with that camera; they stay. So does a reversed order of
        frames some of which are blank: about which instant it turns is not known.
    """
    other = {finding.subject for finding in findings if finding.question == "wrong camera"}
    blank = {finding.subject for finding in findings if finding.question == "blank frames"}
    undone = [
        one
        for one in findings
        if one.question in _WAYS and one.subject not in other and not (one.question == "reversed time" and one.subject in blank)
    ]
    grouped = {fault: [one for one in undone if one.question == fault] for fault in _WAYS}
    undos = [_undo(fault, found, views) for fault, found in grouped.items() if found]
    if not any(one.fault in ("tone curve", "value range") for one in undos) and not other:
        undos += _gain_undos({name: apply(undos, name, view) for name, view in views.items()})
    return undos, [one for one in findings if one not in undone]


def apply(undos: Sequence[Undo], name: str, view: ViewFrames, on_truth: bool = False) -> ViewFrames:
    """A view with faults undone, those of its geometry on the truth's side if wanted."""
    for undo in undos:
        changes = undo.of_truth if on_truth and undo.of_truth else undo.changes
        view = changes[name](view) if name in changes else view
    return view


def _undo(fault: str, found: Sequence[Finding], views: Mapping[str, ViewFrames]) -> Undo:
    ways = {}
    for finding in found:
        view = views[finding.subject]
        height, width = view.truth(view.frames[0]).shape[:2]
        ways[finding.subject] = _WAYS[fault](dict(finding.values) | _alike(found), (width, height))
    return _joined(fault, worst(found), ways, len(views))


def _alike(found: Sequence[Finding]) -> dict[str, float]:
    """Parameters that all views have alike, as their median, which is surer than that of one view."""
    of_views = {key: [one.values[key] for one in found] for key in SAME_WITHIN if key in found[0].values}
    return {key: float(np.median(each)) for key, each in of_views.items() if np.ptp(each) < SAME_WITHIN[key]}


@dataclass(frozen=True)
class _Way:
    """The way back in one view; see `Undo`."""

    words: str
    change: Change
    exact: bool = True
    of_truth: Change | None = None
    words_of_truth: str = ""
    border_px: int = 0


def _joined(fault: str, verdict: Verdict, ways: Mapping[str, _Way], views: int) -> Undo:
    return Undo(
        fault,
        verdict,
        _words({name: way.words for name, way in ways.items()}, views),
        all(way.exact for way in ways.values()),
        {name: way.change for name, way in ways.items()},
        {name: way.of_truth for name, way in ways.items() if way.of_truth},
        _words({name: way.words_of_truth for name, way in ways.items() if way.of_truth}, views),
        max(way.border_px for way in ways.values()),
    )


def _words(of_views: Mapping[str, str], views: int) -> str:
    """One way for all that share it, and how many views that are."""
    several = list(dict.fromkeys(of_views.values()))
    words = " or ".join(several) if len(several) < 3 else f"{several[0]} in {next(iter(of_views))}, others by their own"
    return f"{words}, in {len(of_views)} of {views} views" if 0 < len(of_views) < views else words


Values = Mapping[str, Any]
Size = tuple[int, int]  # width and height


def _undo_mirror(values: Values, _: Size) -> _Way:
    axes = tuple(values["axes"])
    words = {(1,): "flipped left to right", (0,): "flipped upside down"}.get(axes, "turned by 180 degrees")
    return _Way(words, lambda view: view.with_rendered(lambda image: np.ascontiguousarray(np.flip(image, axes))))


def _undo_scale(values: Values, size: Size) -> _Way:
    scale = np.array([values["scale_x"], values["scale_y"]])
    centre = (np.array(size) - 1) / 2
    outside_px = float((np.abs(np.maximum(scale, 1 / scale) - 1) * size / 2).max())
    words, of_truth = (f"scaled to ({x:.2%}, {y:.2%})" for x, y in (1 / scale, scale))
    return _interpolated(words, f"the truth {of_truth} instead", scale, centre * (1 - scale), outside_px)


def _undo_shift(values: Values, _: Size) -> _Way:
    shift_px = np.array([values["shift_x_px"], values["shift_y_px"]])
    whole_px = np.rint(shift_px)
    if np.abs(shift_px - whole_px).max() > NEAR_WHOLE_PX:
        words, of_truth = (f"moved by ({x:+.2f}, {y:+.2f}) px" for x, y in (-shift_px, shift_px))
        return _interpolated(words, f"the truth {of_truth} instead", np.ones(2), shift_px, float(np.abs(shift_px).max()))
    words = f"moved by ({-whole_px[0]:+.0f}, {-whole_px[1]:+.0f}) px"
    change = _warp(np.ones(2), whole_px, cv2.INTER_NEAREST)
    return _Way(words, lambda view: view.with_rendered(change), border_px=int(np.abs(whole_px).max()))


def _interpolated(
    words: str, of_truth: str, scale: NDArray[np.float64], offset_px: NDArray[np.float64], outside_px: float
) -> _Way:
    """Take pixel x of the renders from scale * x + offset_px; or of the truth from the inverse of that."""
    there, back = _warp(scale, offset_px), _warp(1 / scale, -offset_px / scale)
    return _Way(
        words,
        lambda view: view.with_rendered(there),
        exact=False,
        of_truth=lambda view: view.with_truth(lambda index: back(view.truth(index))),
        words_of_truth=of_truth,
        border_px=ceil(outside_px) + LANCZOS_REACH_PX,
    )


def _warp(
    scale: NDArray[np.float64], offset_px: NDArray[np.float64], flag: int = cv2.INTER_LANCZOS4
) -> Callable[[Image8], Image8]:
    matrix = np.array([[scale[0], 0, offset_px[0]], [0, scale[1], offset_px[1]]])

    def warp(image: Image8) -> Image8:
        size, flags = (image.shape[1], image.shape[0]), flag | cv2.WARP_INVERSE_MAP
        moved = cv2.warpAffine(image.astype(np.float32), matrix, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
        return rounded(np.asarray(moved))

    return warp


def _undo_offset(values: Values, _: Size) -> _Way:
    lag = round(values["offset_frames"])
    return _Way(f"frames renumbered by {lag:+d}", lambda view: view.moved(lag))


def _undo_reversal(values: Values, _: Size) -> _Way:
    lag = round(values["offset_frames"])
    words = "frames in reversed order" + (f", renumbered by {lag:+d}" if lag else "")
    return _Way(words, lambda view: view.reversed(lag))


def _undo_order(values: Values, _: Size) -> _Way:
    order = list(values["order"])
    came = "".join(CHANNELS[order.index(channel)] for channel in range(3))
    return _Way(
        f"channels read as {came}", lambda view: view.with_rendered(lambda image: np.ascontiguousarray(image[..., order]))
    )


def _undo_range(values: Values, _: Size) -> _Way:
    levels = np.arange(256.0)
    if values["slope"] < 1:
        return _by_table("levels expanded from 16..235", (levels - VIDEO_BLACK) / VIDEO_SLOPE)
    return _by_table("levels squeezed into 16..235", levels * VIDEO_SLOPE + VIDEO_BLACK)


def _undo_power(values: Values, _: Size) -> _Way:
    power = values["power"]
    return _by_table(f"levels to the power of {1 / power:.2f}", 255 * (np.arange(256) / 255) ** (1 / power))


def _by_table(words: str, levels: NDArray[np.float64]) -> _Way:
    table = rounded(levels)
    return _Way(words, lambda view: view.with_rendered(lambda image: table[image]), exact=False)


_WAYS: Mapping[str, Callable[[Values, Size], _Way]] = {
    "mirrored": _undo_mirror,
    "wrong resize": _undo_scale,
    "focal length": _undo_scale,
    "shift": _undo_shift,
    "reversed time": _undo_reversal,
    "frame offset": _undo_offset,
    "channel order": _undo_order,
    "value range": _undo_range,
    "tone curve": _undo_power,
}


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
    way = _by_table(f"levels divided by {gain:.3f}", np.arange(256) / gain)
    return [_joined(GAIN, "likely", dict.fromkeys(views, way), len(views))]


def rounded(levels: NDArray[Any]) -> Image8:
    """Levels on the scale 0..255 as they are written."""
    return np.rint(np.clip(levels, 0, 255)).astype(np.uint8)
