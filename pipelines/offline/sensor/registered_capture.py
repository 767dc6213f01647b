"""A capture whose sensor depth is brought to its colour before anything is made of it."""

import hashlib
from dataclasses import dataclass, field
from functools import lru_cache

from ggvs_eval.capture import Capture
from ggvs_eval.pipelines.offline.sensor.registration import with_registration
from ggvs_eval.pipelines.offline.sensor.registration_estimate import Displacement, measure_registration
from ggvs_eval.pipelines.offline.sensor.sensor_depth import RegistrationName

SEQUENCE_LAYOUT = "rgbd"  # frames of one camera and one sensor; of a rig every camera has its own sensor


@dataclass(frozen=True)
class ByContent:
    """A capture that is identified by its content, for what is kept of it."""

    digest: str
    capture: Capture = field(compare=False)

    @classmethod
    def of(cls, capture: Capture) -> "ByContent":
        """Return a capture by its pictures, its depth and its cameras."""
        total = hashlib.sha256()
        for camera in capture.cameras:
            source = capture.extras_of(camera.name).depth
            total.update(repr([capture.digest(camera.name), source and source.digest, camera.to_json()]).encode())
        return cls(total.hexdigest(), capture)


def is_sequence(capture: Capture) -> bool:
    """Return whether the cameras of a capture are frames of one moving camera with one depth sensor."""
    return capture.layout == SEQUENCE_LAYOUT


def registered(capture: Capture, registration: RegistrationName | None) -> Capture:
    """Return the capture with its sensor depth registered, where that is asked for and found to be of use.

    Args:
        registration: of sensor depth; None if that is not used.
    """
    if registration != "estimated" or not is_sequence(capture):
        return capture
    measured = displacement(capture)
    return capture if measured is None else with_registration(capture, measured.applied)


def displacement(capture: Capture) -> Displacement | None:
    """`measure_registration` of all frames, kept for the next question about the same sequence: every depth job asks."""
    return _measured(ByContent.of(capture))


@lru_cache(maxsize=4)
def _measured(sequence: ByContent) -> Displacement | None:
    return measure_registration(sequence.capture)
