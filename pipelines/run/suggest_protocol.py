"""The protocol that a capture is evaluated under when none is named."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

from ggvs_eval.capture import Capture
from ggvs_eval.datasets.units import DEMO_NOTES
from ggvs_eval.errors import CameraError, CaptureError, did_you_mean
from ggvs_eval.finding import RIG, SEVERITY, Finding
from ggvs_eval.geometry.sight import LEAST_SHOWN, shown_share
from ggvs_eval.geometry.source_views import choose_sources
from ggvs_eval.protocol import (
    Frames,
    Measurement,
    Protocol,
    Synthesis,
    Views,
    load_protocol,
    packaged_protocols,
)

DEMO = "demo"  # what the names of protocols of demo captures begin with
MOST_VIEWS, MOST_FRAMES = 9, 100
FEWEST_CAMERAS = 2
BY_AUTHORS = "chosen by the authors"  # what `views.chosen_by` of published tables begins with
SAME_SHAPE = 0.01  # of width over height
HAND_HELD = ("rgbd",)  # layouts of one camera that moves


@dataclass(frozen=True)
class Proposal:
    """A protocol for a capture, and why.

    Attributes:
        reasons: of each camera, why it is held out as a test view or stays a source, in the
            capture's order.
    """

    protocol: Protocol
    reasons: Mapping[str, str]


def read_doubts(file: Path) -> dict[str, str]:
    """Doubts that a check has about single cameras, the worst of each.

    Args:
        file: JSON that `check` wrote.

    Returns:
        Camera -> question and answer, for cameras with a verdict of ``warn`` or ``bad``.
    """
    try:
        findings = [
            Finding(**fields) for fields in json.loads(file.read_text(encoding="utf-8"))["findings"]
        ]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CaptureError(
            f"{file}: wanted a file of 'ggvs-eval check', got {error!r:.120}; check the capture "
            f"again"
        ) from error
    doubtful = [
        finding
        for finding in findings
        if finding.subject != RIG and finding.verdict in ("warn", "bad")
    ]
    worst_last = sorted(doubtful, key=lambda finding: SEVERITY[finding.verdict])
    return {finding.subject: f"{finding.question}: {finding.measured}" for finding in worst_last}


def suggest_protocol(capture: Capture) -> Protocol:
    """Return the packaged protocol that fits a capture, or one by rule for a rig of your own.

    See `propose_protocol`.
    """
    return propose_protocol(capture).protocol


def propose_protocol(capture: Capture, doubts: Mapping[str, str] | None = None) -> Proposal:
    """Choose the protocol for a capture, and say of every camera why it is held out or not.

    The rule: every second camera in the capture's order is a test view, of more than nine one in
    each ninth of them; at most 100 frames, the capture's own size; K, filters and metrics of its
    layout's protocol, or DyNeRF's. ``views.chosen_by`` says so. Where the capture names test views
    itself, as NeRF's split files do, these are taken, seen from the others alone. Passed over are
    cameras in doubt, whose frames would be a wrong truth, and views of which their sources can show
    too little; neighbours take their place, and the cameras between them where none is left. Where
    one camera was carried through the scene (`HAND_HELD`), the nearest places may look elsewhere:
    sources are chosen by what they see.

    Args:
        doubts: camera -> what is wrong with it, as `read_doubts` gives it.
    """
    doubts = doubts or {}
    if len(capture.cameras) < FEWEST_CAMERAS:
        raise CaptureError(
            f"{capture.path}: wanted two cameras or more, got {len(capture.cameras)}; add cameras"
        )
    for name in (DEMO, f"{DEMO}-{capture.layout}", capture.layout):
        if name in packaged_protocols() and _fits(capture, load_protocol(name)):
            protocol = load_protocol(name)
            return Proposal(protocol, _packaged_reasons(capture, protocol, doubts))
    base = load_protocol(capture.layout if capture.layout in packaged_protocols() else "dynerf")
    training = [name for name in capture.camera_names if name not in capture.test_views]
    synthesis = Synthesis(
        min(base.synthesis.k, len(training) if capture.test_views else len(capture.cameras) - 1),
        resize_filter=base.synthesis.resize_filter,
        sources="coverage" if capture.layout in HAND_HELD else "nearest",
        calibration=None if capture.units_origin == DEMO_NOTES else "compare",
    )
    views, reasons = (
        _own_split(capture, training, doubts)
        if capture.test_views and training
        else _views(capture, synthesis, doubts)
    )
    protocol = replace(
        base,
        name=f"{capture.scene} by rule",
        dataset=capture.scene,
        views=views,
        frames=Frames(0, min(capture.n_frames, MOST_FRAMES)),
        synthesis=synthesis,
        measurement=_measured_like(base, capture),
    )
    return Proposal(protocol, reasons)


def published_protocols(capture: Capture) -> list[Protocol]:
    """Packaged protocols of published tables whose test views, frames and shape of images a capture
    has.
    """
    width, height = capture.cameras[0].size
    loaded = [load_protocol(name) for name in packaged_protocols()]
    return [
        protocol
        for protocol in loaded
        if protocol.views.chosen_by.startswith(BY_AUTHORS)
        and set(protocol.views.test) <= set(capture.camera_names)
        and _is_of_scene(protocol, capture.scene)
        and protocol.frames.numbers.stop <= capture.n_frames
        and (protocol.frames.count > 1 or capture.n_frames == 1)
        and abs(protocol.synthesis.width * height / (protocol.synthesis.height * width) - 1)
        <= SAME_SHAPE
    ]


def _is_of_scene(protocol: Protocol, scene: str) -> bool:
    """Return whether a packaged protocol can be one of a scene: it lists that, is named after it,
    or is of all scenes.
    """
    listed = [name for entry in protocol.views.of_scenes for name in entry.scenes]
    return (
        scene in listed
        if listed
        else not protocol.name.startswith("llff") or protocol.name.endswith(f"_{scene}")
    )


def _packaged_reasons(
    capture: Capture, protocol: Protocol, doubts: Mapping[str, str]
) -> dict[str, str]:
    reason = f"not a test view of the packaged protocol {protocol.name}"
    reasons = {
        name: protocol.views.chosen_by if name in protocol.views.test else reason
        for name in capture.camera_names
    }
    return {
        name: f"{reason}; but {doubts[name]}" if name in doubts else reason
        for name, reason in reasons.items()
    }


def _own_split(
    capture: Capture, training: Sequence[str], doubts: Mapping[str, str]
) -> tuple[Views, dict[str, str]]:
    """Return the test views that the capture itself names, seen from its training views alone.

    And the reasons.
    """
    reasons = {
        name: f"{'held out' if name in capture.test_views else 'stays a source'}: the capture's "
        f"own split" + (f"; but {doubts[name]}" if name in doubts else "")
        for name in capture.camera_names
    }
    return Views(capture.test_views, "the capture's own split", sources=tuple(training)), reasons


def hold_out(
    proposal: Proposal, capture: Capture, names: Sequence[str], doubts: Mapping[str, str]
) -> Proposal:
    """Return the proposal with test views that the user chose.

    Raises:
        CaptureError: a name that is no camera of the capture.
    """
    if absent := [name for name in names if name not in capture.camera_names]:
        raise CaptureError(
            f"--test: {capture.path} has no camera {' '.join(absent)}; it has "
            f"{', '.join(capture.camera_names)}{did_you_mean(absent[0], capture.camera_names)}"
        )
    synthesis = proposal.protocol.synthesis
    synthesis = replace(synthesis, k=min(synthesis.k, len(capture.cameras) - 1))
    reasons = dict.fromkeys(capture.camera_names, "stays a source") | {
        name: f"held out, as requested: {_classify_view(capture, name, synthesis, doubts)[1]}"
        for name in names
    }
    protocol = replace(
        proposal.protocol, views=Views(tuple(names), "chosen by the user"), synthesis=synthesis
    )
    return Proposal(replace(protocol, name=f"{capture.scene}, {', '.join(names)}"), reasons)


def _views(
    capture: Capture, synthesis: Synthesis, doubts: Mapping[str, str]
) -> tuple[Views, dict[str, str]]:
    """Return every second camera that can serve, else the others that can, else every second one.

    And the reasons.
    """
    names = capture.camera_names
    few = len(names[1::2]) <= MOST_VIEWS
    rule = (
        "every second camera, at most nine"
        if few
        else f"nine of {len(names)} cameras, spread evenly"
    )
    reason = "every second camera is held out, at most nine" if few else f"{rule}, are held out"
    reasons = dict.fromkeys(names, f"stays a source: {reason}")
    for candidates in (names[1::2], names[::2]):
        test: list[str] = []
        stretches = _stretches(candidates)
        for stretch in stretches:
            for name in stretch:
                can_serve, why = _classify_view(capture, name, synthesis, doubts)
                reasons[name] = f"{'held out' if can_serve else 'stays a source'}: {why}"
                if can_serve:
                    test.append(name)
                    break
        if test:
            break
    if not test:
        test = [stretch[0] for stretch in _stretches(names[1::2])]
        reasons |= dict.fromkeys(test, "held out: by rule, although no camera is well covered")
        return Views(tuple(test), f"by rule: {rule}"), reasons
    without = (
        ""
        if len(test) == len(stretches)
        else ", without those in doubt and those that the other cameras hardly show"
    )
    return Views(tuple(test), f"by rule: {rule}{without}"), reasons


def _stretches(names: Sequence[str]) -> list[list[str]]:
    """Divide cameras into at most nine neighbourhoods of equal size, each from its middle
    outwards.
    """
    count = min(len(names), MOST_VIEWS)
    bounds = [len(names) * n // count for n in range(count + 1)]
    return [
        [names[i] for i in sorted(range(a, b), key=lambda i: abs(i - (a + b - 1) // 2))]
        for a, b in pairwise(bounds)
    ]


def _classify_view(
    capture: Capture, name: str, synthesis: Synthesis, doubts: Mapping[str, str]
) -> tuple[bool, str]:
    """Aptitude of a camera as a test view, with the reason."""
    if name in doubts:
        return False, f"the check says {doubts[name]}"
    target = capture.camera(name)
    try:
        choices = choose_sources(target, capture.cameras, synthesis.k, synthesis.sources)
    except CameraError as error:
        return False, str(error)
    sources = [source.camera for source in choices]
    share = shown_share(target, sources, capture.cameras, capture.sensed_cameras)
    coverage = (
        f"{', '.join(camera.name for camera in sources)} cover {100 * share:.0f} % of its view"
    )
    return share >= LEAST_SHOWN, coverage


def _measured_like(base: Protocol, capture: Capture) -> Measurement:
    """Return the measurement of a protocol, at the same fraction of the capture's own size."""
    measurement = base.measurement
    if not measurement.width:
        return measurement
    width, height = capture.cameras[0].size
    fraction = measurement.width / base.synthesis.width
    return replace(measurement, width=round(width * fraction), height=round(height * fraction))


def _fits(capture: Capture, protocol: Protocol) -> bool:
    """Return whether a packaged protocol was made for this capture.

    The demos' are for demo captures alone.
    """
    if protocol.name.startswith(DEMO) != (capture.units_origin == DEMO_NOTES):
        return False
    enough = protocol.frames.numbers.stop <= capture.n_frames
    return enough and set(protocol.views.test) <= set(capture.camera_names)
