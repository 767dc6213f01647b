"""A sequence in two parts, one to learn from and one by which to choose, none of whose views is a view of both."""

from collections.abc import Collection
from dataclasses import replace

from ggvs_eval.capture import Capture
from ggvs_eval.errors import TrainingError
from ggvs_eval.pipelines.training.samples.capture_views import is_sequence, overlap


def held_back_halves(capture: Capture, span: int = 30, most_overlap: float = 0.5) -> tuple[Capture, Capture]:
    """The frames to learn from and those held back, with `span` frames between them that belong to neither.

    Args:
        capture: an RGB-D sequence.
        span: how far from its target a source may be: what either part's samples show is at least so far from the other's.
        most_overlap: frames of whose view a learned frame sees a larger share belong to neither, see `capture_views.overlap`.

    Raises:
        TrainingError: no sequence, or too short, or all of it comes back to what is learned.

    Reading:
        The first half in time is learned from. A camera that comes back sees again what it saw before: such frames of the second
        half are left out, so that apart are the places as well as noise, blur and the errors of depth and poses.
    """
    numbers = [int(camera.name) for camera in capture.cameras] if is_sequence(capture) else []
    middle = (numbers[0] + numbers[-1] + 1) // 2 if numbers else 0
    learned = [camera for camera, number in zip(capture.cameras, numbers, strict=False) if number < middle]
    later = [camera for camera, number in zip(capture.cameras, numbers, strict=False) if number >= middle + span]
    apart = [camera for camera in later if all(overlap(camera, other) <= most_overlap for other in learned)]
    if not learned or not apart:
        raise TrainingError(
            f"{capture.path}: wanted a sequence of one moving camera, longer than {2 * span} frames, whose second half sees "
            f"what is new, got {len(numbers)} frames of layout {capture.layout}, {len(later)} after the gap, {len(apart)} "
            "of them new; give another RGB-D sequence or a smaller span"
        )
    return restricted(capture, {camera.name for camera in learned}), restricted(capture, {camera.name for camera in apart})


def restricted(capture: Capture, names: Collection[str]) -> Capture:
    """The capture with some of its cameras only, in its own order, without a note of it."""
    kept = [index for index, name in enumerate(capture.camera_names) if name in names]
    return replace(
        capture,
        cameras=tuple(capture.cameras[index] for index in kept),
        sources=tuple(capture.sources[index] for index in kept),
        extras=tuple(capture.extras[index] for index in kept) if capture.extras else (),
    )
