"""The protocol that a capture is evaluated under when nobody names one."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from ggvs_eval.capture import Capture
from ggvs_eval.datasets.units import DEMO_NOTES
from ggvs_eval.errors import CameraError
from ggvs_eval.geometry.sight import LEAST_SHOWN, shown_share
from ggvs_eval.geometry.source_views import choose_sources
from ggvs_eval.protocol import Frames, Measurement, Protocol, Synthesis, Views, load_protocol, packaged_protocols

DEMO = "demo"  # what the names of protocols of demo captures begin with
MOST_VIEWS, MOST_FRAMES = 9, 100
HAND_HELD = ("rgbd",)  # layouts of one camera that moves


@dataclass(frozen=True)
class Proposal:
    """A protocol for a capture, and why.

    Attributes:
        protocol: what is proposed.
        reasons: of each camera, why it is held out as a test view or stays a source, in the capture's order.
    """

    protocol: Protocol
    reasons: Mapping[str, str]


def suggest_protocol(capture: Capture) -> Protocol:
    """The packaged protocol that fits a capture, or one by rule for a rig of one's own; see `propose_protocol`."""
    return propose_protocol(capture).protocol


def propose_protocol(capture: Capture, doubts: Mapping[str, str] | None = None) -> Proposal:
    """Choose the protocol for a capture, and say of every camera why it is held out or not.

    The rule: every second camera in the capture's order is a test view (at most nine, from the second on), at most 100 frames,
    the capture's own size; K, filters and metrics of its layout's protocol, or DyNeRF's. ``views.chosen_by`` says so. Passed over
    are cameras in doubt, whose frames would be a wrong truth, and views of which their sources can show too little; the others
    take their place where none is left. Where one camera was carried through the scene (`HAND_HELD`), the nearest places may look
    elsewhere: sources are chosen by what they see.

    Args:
        capture: what will be evaluated.
        doubts: camera -> what is wrong with it, as `ggvs_eval.pipelines.inspection.capture.check.read_doubts` gives it.
    """
    doubts = doubts or {}
    for name in (DEMO, f"{DEMO}-{capture.layout}", capture.layout):
        if name in packaged_protocols() and _fits(capture, load_protocol(name)):
            protocol = load_protocol(name)
            return Proposal(protocol, _packaged_reasons(capture, protocol, doubts))
    base = load_protocol(capture.layout if capture.layout in packaged_protocols() else "dynerf")
    synthesis = Synthesis(
        min(base.synthesis.k, len(capture.cameras) - 1),
        resize_filter=base.synthesis.resize_filter,
        sources="coverage" if capture.layout in HAND_HELD else "nearest",
    )
    views, reasons = _views(capture, synthesis, doubts)
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


def _packaged_reasons(capture: Capture, protocol: Protocol, doubts: Mapping[str, str]) -> dict[str, str]:
    kept = f"not a test view of the packaged protocol {protocol.name}"
    reasons = {name: protocol.views.chosen_by if name in protocol.views.test else kept for name in capture.camera_names}
    return {name: f"{reason}; but {doubts[name]}" if name in doubts else reason for name, reason in reasons.items()}


def _views(capture: Capture, synthesis: Synthesis, doubts: Mapping[str, str]) -> tuple[Views, dict[str, str]]:
    """Every second camera that can serve, else the others that can, else every second one; and the reasons."""
    names = capture.camera_names
    reasons = dict.fromkeys(names, "stays a source: every second camera is held out, at most nine")
    rule = "by rule: every second camera, at most nine"
    for candidates in (names[1::2], names[::2]):
        test: list[str] = []
        for name in candidates:
            if len(test) == MOST_VIEWS:
                break
            can_serve, why = _judge_view(capture, name, synthesis, doubts)
            reasons[name] = f"{'held out' if can_serve else 'stays a source'}: {why}"
            test += [name] if can_serve else []
        passed_over = len(test) < min(len(candidates), MOST_VIEWS)
        if test:
            break
    if not test:
        reasons |= dict.fromkeys(names[1::2][:MOST_VIEWS], "held out: by rule, though no camera can serve well")
        return Views(names[1::2][:MOST_VIEWS], rule), reasons
    without = ", without those in doubt and those that the other cameras hardly show" if passed_over else ""
    return Views(tuple(test), rule + without), reasons


def _judge_view(capture: Capture, name: str, synthesis: Synthesis, doubts: Mapping[str, str]) -> tuple[bool, str]:
    """Aptitude of a camera as a test view, with the reason."""
    if name in doubts:
        return False, f"the check says {doubts[name]}"
    target = capture.camera(name)
    try:
        chosen = choose_sources(target, capture.cameras, synthesis.k, synthesis.sources)
    except CameraError as error:
        return False, str(error)
    sources = [each.camera for each in chosen]
    share = shown_share(target, sources, capture.cameras, capture.sensed_cameras)
    shown = f"{', '.join(camera.name for camera in sources)} can show {100 * share:.0f} % of its view"
    return share >= LEAST_SHOWN, shown


def _measured_like(base: Protocol, capture: Capture) -> Measurement:
    """The measurement of a protocol, at the same fraction of the capture's own size."""
    measurement = base.measurement
    if not measurement.width:
        return measurement
    width, height = capture.cameras[0].size
    fraction = measurement.width / base.synthesis.width
    return replace(measurement, width=round(width * fraction), height=round(height * fraction))


def _fits(capture: Capture, protocol: Protocol) -> bool:
    """Tell whether a packaged protocol was made for this capture; the demos' are for demo captures alone."""
    if protocol.name.startswith(DEMO) != (capture.units_origin == DEMO_NOTES):
        return False
    enough = protocol.frames.numbers.stop <= capture.n_frames
    return enough and set(protocol.views.test) <= set(capture.camera_names)
