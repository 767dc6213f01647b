"""What every adapter does last: cameras and frames must fit each other before they become a `Capture`."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture, FrameSource, guess_units_per_metre
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.errors import CaptureError
from ggvs_eval.video import VideoFrames

# Image folders do not say their rate; every capture published in this layout was filmed at this one.
FOLDER_FPS = 30.0
NOTES = "demo.json"
SizedSource = VideoFrames | ImageFrames


@dataclass(frozen=True)
class Units:
    """World units per metre and where the number comes from."""

    per_metre: float
    origin: str


def assemble_capture(path: Path, layout: str, cameras: Sequence[Camera], sources: Sequence[SizedSource], units: Units) -> Capture:
    """Check that all cameras have the same instants and bring each camera to the size of its frames.

    Raises:
        CaptureError: cameras that differ in frame count or rate, or frames of another shape than the calibration.
    """
    names = [camera.name for camera in cameras]
    n_frames = _common([source.n_frames for source in sources], names, path, "frame count", "cut them to a common length")
    rates = [round(source.fps, 2) if isinstance(source, VideoFrames) else FOLDER_FPS for source in sources]
    fps = _common(rates, names, path, "frame rate", "convert them to one rate")
    return Capture(
        scene=path.resolve().name,
        layout=layout,
        path=path,
        cameras=tuple(_fit_camera(camera, source) for camera, source in zip(cameras, sources, strict=True)),
        sources=tuple[FrameSource, ...](sources),
        n_frames=int(n_frames),
        fps=fps if n_frames > 1 else 0.0,
        units_per_metre=units.per_metre,
        units_origin=units.origin,
    )


def choose_units(
    path: Path, given: float | None, cameras: Sequence[Camera], median_depths: Sequence[float] | None = None
) -> Units:
    """World units per metre: what the user says, else the capture's own ``demo.json``, else a guess from the depth of the scene.

    Raises:
        CaptureError: a number that is not positive, or a damaged ``demo.json``.
    """
    per_metre, origin = (read_note(path, "units_per_metre"), NOTES) if given is None else (given, "given by the user")
    if per_metre is None:
        return Units(guess_units_per_metre(cameras, median_depths), "guess: median scene depth taken for 2 m")
    if not 0 < per_metre < math.inf:
        found = f"{per_metre:g} ({origin})"
        raise CaptureError(f"{path}: wanted a positive number of world units per metre, got {found}; correct or drop it")
    return Units(per_metre, origin)


def read_note(path: Path, key: str) -> float | None:
    """A number that a synthetic capture notes about itself in ``demo.json``; None where there is no such file or note.

    Raises:
        CaptureError: the file is damaged or the note is no number.
    """
    file = path / NOTES
    if not file.is_file():
        return None
    try:
        note = dict(json.loads(file.read_text())).get(key)
        return None if note is None else float(note)
    except (ValueError, TypeError) as error:
        raise CaptureError(f"{file}: wanted a number {key}, got: {error}; write the demo capture again") from error


def _common(values: Sequence[float], names: Sequence[str], path: Path, quantity: str, mend: str) -> float:
    if len(set(values)) > 1:
        listed = ", ".join(f"{name} {value:g}" for name, value in zip(names, values, strict=True))
        raise CaptureError(f"{path}: wanted one {quantity} for all cameras, got {listed}; {mend}")
    return values[0]


def _fit_camera(camera: Camera, source: SizedSource) -> Camera:
    """The camera at the size of its frames, which may be a uniformly scaled one."""
    width, height = source.size
    if abs(camera.height * width / camera.width - height) > 1:
        raise CaptureError(
            f"{source.path}: frames of {width} x {height} have another shape than the {camera.width} x {camera.height} that "
            f"{camera.name} is calibrated for; give the frames this calibration was made for, scaled but not cropped"
        )
    return camera.resized(width, height)
