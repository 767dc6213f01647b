"""``corrections.toml`` in a capture: cameras that are out of step or too bright, and the
corrections of their frames.

`ggvs-eval check CAPTURE --repair` writes the file; every reader of the capture applies it.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.capture import Capture, Extras, FrameSource
from ggvs_eval.capture_edit import picked, picked_extras
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.atomic import atomic_file
from ggvs_eval.files.digest import digest_values
from ggvs_eval.files.images import round_levels
from ggvs_eval.files.toml_tables import build_table, read_toml

FILE = "corrections.toml"
LARGEST_OFFSET = 100_000
NO_GAIN = (1.0, 1.0, 1.0)
HEAD = """\
# Corrections that every command applies when it reads this capture; without this file frames stay
# unchanged.
# offset_frames: frame t of the camera shows the instant t + offset_frames of the others; it is
# shifted back.
# gain: brightness of red, green and blue relative to the others; frames are divided by it.
"""


@dataclass(frozen=True)
class Correction:
    """Corrections of one camera; one ``[[camera]]`` of the file.

    Attributes:
        offset_frames: frame t of the camera shows the instant of the others' frame t + offset;
            positive for one that is ahead.
        gain: factor on its sRGB values, red, green, blue.
    """

    name: str
    offset_frames: int = 0
    gain: tuple[float, ...] = NO_GAIN


@dataclass(frozen=True)
class CorrectionsTable:
    """The whole file."""

    camera: tuple[Correction, ...] = ()


@dataclass(frozen=True)
class CorrectedFrames:
    """Frames of one camera divided by its gain, a `FrameSource`.

    Attributes:
        gain: of red, green and blue.
    """

    source: FrameSource
    gain: tuple[float, ...]

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return self.source.n_frames

    @property
    def digest(self) -> str:
        """Identifies the content."""
        return digest_values(self.source.digest, "corrected", *map(repr, self.gain))

    def frames(self, start: int, stop: int) -> Iterator[Image8]:
        """Yield the frames start <= t < stop one by one, RGB uint8 (H, W, 3)."""
        levels = np.arange(256)[:, None] / np.array(self.gain)
        table = round_levels(levels)[:, None]  # (256, 1, 3)
        for image in self.source.frames(start, stop):
            yield np.asarray(cv2.LUT(image, table), np.uint8)


def corrections_file(path: Path) -> Path:
    """Return the file of a capture's corrections, in its folder."""
    return (path if path.is_dir() else path.parent) / FILE


def read_corrections(file: Path) -> dict[str, Correction]:
    """Return the corrections by camera; none if there is no file.

    Raises:
        CaptureError: a damaged file, a camera named twice, a gain that is no gain.
    """
    if not file.exists():
        return {}
    table = build_table(
        CorrectionsTable, read_toml(file, CaptureError), str(file), "", CaptureError
    )
    for row in table.camera:
        if len(row.gain) != 3 or not all(0.01 <= value <= 100 for value in row.gain):
            raise CaptureError(
                f"{file}: {row.name}: wanted a gain of red, green and blue, got {list(row.gain)}; "
                f"correct it"
            )
        if abs(row.offset_frames) > LARGEST_OFFSET:
            raise CaptureError(
                f"{file}: {row.name}: wanted an offset in frames, got {row.offset_frames}; correct "
                f"it"
            )
    corrections = {row.name: row for row in table.camera}
    if len(corrections) < len(table.camera):
        raise CaptureError(
            f"{file}: wanted each camera once, got {', '.join(row.name for row in table.camera)}; "
            f"keep one"
        )
    return corrections


def write_corrections(file: Path, corrections: Mapping[str, Correction]) -> None:
    """Write corrections so that `read_corrections` reads them back.

    Cameras that need none are left out.
    """
    lines = [HEAD]
    for name, correction in sorted(corrections.items()):
        if correction == Correction(name):
            continue
        quoted = name.replace("\\", "\\\\").replace('"', '\\"')
        lines += ["[[camera]]", f'name = "{quoted}"']
        lines += [f"offset_frames = {correction.offset_frames}"] if correction.offset_frames else []
        lines += (
            [f"gain = [{', '.join(map(repr, correction.gain))}]"]
            if correction.gain != NO_GAIN
            else []
        )
        lines.append("")
    with atomic_file(file) as unfinished:
        unfinished.write_text("\n".join(lines), encoding="utf-8")


def apply_corrections(
    capture: Capture, corrections: Mapping[str, Correction], file: Path
) -> Capture:
    """Return the capture with its cameras in step and of one brightness; a note says what was done.

    Raises:
        CaptureError: a camera that the capture does not have, or offsets that leave no instant.

    Reading:
        Instants that not all cameras saw are dropped at both ends. Values are divided as they are
        stored, in sRGB, and rounded to 8 bit; what was clipped stays so. Truth is corrected like
        everything else, or one camera's gain would be every method's error. Masks and measured
        depth are shifted, backgrounds divided.
    """
    if not corrections:
        return capture
    unknown = [name for name in corrections if name not in capture.camera_names]
    if unknown:
        names = ", ".join(capture.camera_names)
        raise CaptureError(
            f"{file}: wanted cameras of the capture, got {', '.join(unknown)}; there are {names}"
        )
    per_camera = [corrections.get(name, Correction(name)) for name in capture.camera_names]
    latest = max(correction.offset_frames for correction in per_camera)
    n_frames = (
        capture.n_frames - latest + min(correction.offset_frames for correction in per_camera)
    )
    if n_frames < 1:
        raise CaptureError(
            f"{file}: the offsets leave none of {capture.n_frames} frames that all cameras saw; "
            f"correct them"
        )
    instants = [
        tuple(range(start, start + n_frames))
        for start in (latest - correction.offset_frames for correction in per_camera)
    ]
    sources = [
        _corrected(picked(source, frames), correction.gain)
        for source, frames, correction in zip(capture.sources, instants, per_camera, strict=True)
    ]
    extras = [
        _corrected_extras(picked_extras(extra, frames), correction.gain)
        for extra, frames, correction in zip(capture.extras, instants, per_camera, strict=False)
    ]
    note = f"corrected by {file.name}: {describe_corrections(corrections)}"
    return replace(
        capture,
        sources=tuple(sources),
        extras=tuple(extras),
        n_frames=n_frames,
        fps=capture.fps if n_frames > 1 else 0.0,
        notes=(*capture.notes, note),
    )


def _corrected(source: FrameSource, gain: tuple[float, ...]) -> FrameSource:
    """Return a source divided by a gain; the source itself where that changes nothing."""
    return source if gain == NO_GAIN else CorrectedFrames(source, gain)


def _corrected_extras(extras: Extras, gain: tuple[float, ...]) -> Extras:
    return replace(extras, background=extras.background and _corrected(extras.background, gain))


def describe_corrections(corrections: Mapping[str, Correction]) -> str:
    """Describe the corrections in words.

    Examples:
        >>> describe_corrections({"cam03": Correction("cam03", offset_frames=-2)})
        'cam03 2 frames behind, shifted'
    """
    return "; ".join(map(_describe, corrections.values())) or "nothing"


def _describe(correction: Correction) -> str:
    offset, parts = correction.offset_frames, []
    if offset:
        parts.append(
            f"{abs(offset)} frame{'s' * (abs(offset) > 1)} {'ahead' if offset > 0 else 'behind'}, "
            f"shifted"
        )
    if correction.gain != NO_GAIN:
        parts.append(f"divided by {' '.join(f'{value:.3f}' for value in correction.gain)}")
    return f"{correction.name} {' and '.join(parts) or 'as it is'}"
