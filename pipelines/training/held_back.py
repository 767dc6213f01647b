"""A sequence in two parts, one to learn from and one by which to choose, none of whose views is a view of both."""

from collections.abc import Collection
from dataclasses import replace

from ggvs_eval.capture import Capture
from ggvs_eval.errors import TrainingError
from ggvs_eval.pipelines.training.capture_views import is_sequence


def held_back_halves(capture: Capture, span: int = 30) -> tuple[Capture, Capture]:
    """The frames to learn from and those held back, with `span` frames between them that belong to neither.

    Args:
        capture: an RGB-D sequence.
        span: how far from its target a source may be: what either half's samples show is at least so far from the other's.

    Raises:
        TrainingError: no sequence, or too short.

    Reading:
        The first half in time is learned from. A camera that comes back sees again what it saw before: apart are the frames,
        and thereby noise, blur and errors of depth and poses, not the place.
    """
    numbers = [int(camera.name) for camera in capture.cameras] if is_sequence(capture) else []
    middle = (numbers[0] + numbers[-1] + 1) // 2 if numbers else 0
    first = {camera.name for camera, number in zip(capture.cameras, numbers, strict=False) if number < middle}
    last = {camera.name for camera, number in zip(capture.cameras, numbers, strict=False) if number >= middle + span}
    if not first or not last:
        raise TrainingError(
            f"{capture.path}: wanted a sequence of one moving camera longer than {2 * span} frames to split, got "
            f"{len(numbers)} frames of layout {capture.layout}; give an RGB-D sequence or a smaller span"
        )
    return restricted(capture, first), restricted(capture, last)


def restricted(capture: Capture, names: Collection[str]) -> Capture:
    """The capture with some of its cameras only, in its own order, without a note of it."""
    kept = [index for index, name in enumerate(capture.camera_names) if name in names]
    return replace(
        capture,
        cameras=tuple(capture.cameras[index] for index in kept),
        sources=tuple(capture.sources[index] for index in kept),
        extras=tuple(capture.extras[index] for index in kept) if capture.extras else (),
    )
