"""The protocol that a capture is evaluated under when nobody names one."""

from dataclasses import replace

from ggvs_eval.capture import Capture
from ggvs_eval.datasets.units import DEMO_NOTES
from ggvs_eval.protocol import Frames, Measurement, Protocol, Synthesis, Views, load_protocol, packaged_protocols

DEMO = "demo"  # what the names of protocols of demo captures begin with
MOST_VIEWS, MOST_FRAMES = 9, 100


def suggest_protocol(capture: Capture) -> Protocol:
    """The packaged protocol that fits a capture, or one by rule for a rig of one's own.

    The rule: every second camera in the capture's order is a test view (at most nine, from the second on), at most 100 frames,
    the capture's own size; K, filters and metrics of its layout's protocol, or DyNeRF's. ``views.chosen_by`` says so.
    """
    for name in (DEMO, f"{DEMO}-{capture.layout}", capture.layout):
        if name in packaged_protocols() and _fits(capture, load_protocol(name)):
            return load_protocol(name)
    base = load_protocol(capture.layout if capture.layout in packaged_protocols() else "dynerf")
    return replace(
        base,
        name=f"{capture.scene} by rule",
        dataset=capture.scene,
        views=Views(capture.camera_names[1::2][:MOST_VIEWS], "by rule: every second camera, at most nine"),
        frames=Frames(0, min(capture.n_frames, MOST_FRAMES)),
        synthesis=Synthesis(min(base.synthesis.k, len(capture.cameras) - 1), resize_filter=base.synthesis.resize_filter),
        measurement=_measured_like(base, capture),
    )


def _measured_like(base: Protocol, capture: Capture) -> Measurement:
    """The measurement of a protocol, at the same fraction of the capture's own size."""
    measurement = base.measurement
    if not measurement.width:
        return measurement
    width, height = capture.cameras[0].size
    fraction = measurement.width / base.synthesis.width
    return replace(measurement, width=round(width * fraction), height=round(height * fraction))


def _fits(capture: Capture, protocol: Protocol) -> bool:
    """Whether a packaged protocol was made for this capture; the demos' are for demo captures alone."""
    if protocol.name.startswith(DEMO) != (capture.units_origin == DEMO_NOTES):
        return False
    enough = protocol.frames.start + protocol.frames.count <= capture.n_frames
    return enough and set(protocol.views.test) <= set(capture.camera_names)
