"""The protocol that a capture is evaluated under when nobody names one."""

from dataclasses import replace
from itertools import islice

from ggvs_eval.capture import Capture
from ggvs_eval.datasets.units import DEMO_NOTES
from ggvs_eval.errors import CameraError
from ggvs_eval.geometry.sight import LEAST_SHOWN, shown_share
from ggvs_eval.geometry.source_views import choose_sources
from ggvs_eval.protocol import Frames, Measurement, Protocol, Synthesis, Views, load_protocol, packaged_protocols

DEMO = "demo"  # what the names of protocols of demo captures begin with
MOST_VIEWS, MOST_FRAMES = 9, 100
HAND_HELD = ("rgbd",)  # layouts of one camera that moves


def suggest_protocol(capture: Capture) -> Protocol:
    """The packaged protocol that fits a capture, or one by rule for a rig of one's own.

    The rule: every second camera in the capture's order is a test view (at most nine, from the second on), at most 100 frames,
    the capture's own size; K, filters and metrics of its layout's protocol, or DyNeRF's. ``views.chosen_by`` says so. Where one
    camera was carried through the scene (`HAND_HELD`), the nearest places may look elsewhere: sources are chosen by what they
    see, and views of which they can show too little are passed over.
    """
    for name in (DEMO, f"{DEMO}-{capture.layout}", capture.layout):
        if name in packaged_protocols() and _fits(capture, load_protocol(name)):
            return load_protocol(name)
    base = load_protocol(capture.layout if capture.layout in packaged_protocols() else "dynerf")
    synthesis = Synthesis(
        min(base.synthesis.k, len(capture.cameras) - 1),
        resize_filter=base.synthesis.resize_filter,
        sources="coverage" if capture.layout in HAND_HELD else "nearest",
    )
    return replace(
        base,
        name=f"{capture.scene} by rule",
        dataset=capture.scene,
        views=_views(capture, synthesis),
        frames=Frames(0, min(capture.n_frames, MOST_FRAMES)),
        synthesis=synthesis,
        measurement=_measured_like(base, capture),
    )


def _views(capture: Capture, synthesis: Synthesis) -> Views:
    """Every second camera; of a sequence those that its other frames can show, or all where there are none."""
    names, rule = capture.camera_names[1::2], "by rule: every second camera, at most nine"
    if synthesis.sources == "nearest":
        return Views(names[:MOST_VIEWS], rule)
    shown = tuple(islice((name for name in names if _is_shown(capture, name, synthesis)), MOST_VIEWS))
    if shown in ((), names[:MOST_VIEWS]):
        return Views(names[:MOST_VIEWS], rule)
    return Views(shown, f"{rule}, without those that the other frames hardly show")


def _is_shown(capture: Capture, name: str, synthesis: Synthesis) -> bool:
    target = capture.camera(name)
    try:
        chosen = choose_sources(target, capture.cameras, synthesis.k, synthesis.sources)
    except CameraError:
        return False
    sources = [each.camera for each in chosen]
    return shown_share(target, sources, capture.cameras, capture.sensed_cameras) >= LEAST_SHOWN


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
    enough = protocol.frames.numbers.stop <= capture.n_frames
    return enough and set(protocol.views.test) <= set(capture.camera_names)
