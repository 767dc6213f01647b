"""Frames of one view as the doctor sees them: rendered beside captured, read when they are wanted."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from ggvs_eval.arrays import Array32, Image8
from ggvs_eval.errors import RenderError
from ggvs_eval.files.images import read_image, resize
from ggvs_eval.protocol import Measurement
from ggvs_eval.run_folder import RunFolder, frame_path, missing_frames, require_frames

FrameReader = Callable[[int], Image8]
# Everything but registration and coding is decided on pictures of this size, so that a dozen of them are a few megabytes.
SMALL_SIDE_PX = 192
LARGEST_OFFSET = 8


@dataclass(frozen=True)
class ViewFrames:
    """One view: rendered and captured frames by their number.

    Attributes:
        rendered: frame number -> rendered frame, (H, W, 3) uint8 RGB.
        truth: frame number -> captured frame of the same view, (H, W, 3) uint8 RGB.
        frames: numbers of the rendered frames, in order.
        truth_frames: numbers that `truth` can give, where these are more than `frames`; offsets at the ends need them.
    """

    rendered: FrameReader
    truth: FrameReader
    frames: range
    truth_frames: range | None = None

    def __post_init__(self) -> None:
        """Refuse a view without frames."""
        if len(self.frames) == 0:
            raise RenderError("a view without frames; render it first")

    @property
    def truth_range(self) -> range:
        """Numbers of the captured frames that can be read."""
        return self.truth_frames or self.frames

    def pairs(self, indices: list[int]) -> Iterator[tuple[Image8, Image8]]:
        """Rendered and captured frame of some instants, one by one."""
        return ((self.rendered(index), self.truth(index)) for index in indices)

    def with_rendered(self, change: Callable[[Image8], Image8]) -> "ViewFrames":
        """The same view with every rendered frame changed."""
        original = self.rendered
        return replace(self, rendered=lambda index: change(original(index)))

    def with_truth(self, truth: FrameReader) -> "ViewFrames":
        """The same renders beside another camera's frames."""
        return replace(self, truth=truth)

    def moved(self, offset: int) -> "ViewFrames":
        """The same renders as frames of the instants `offset` later, as far as the truth has them."""
        original, captured = self.rendered, self.truth_range
        there = [index for index in self.frames if index + offset in captured]
        frames = range(there[0] + offset, there[-1] + offset + 1)
        return replace(self, rendered=lambda index: original(index - offset), frames=frames)

    def reversed(self, offset: int) -> "ViewFrames":
        """The same renders in reversed order, as frames of instants `offset` later, as far as the truth has them."""
        original, turning = self.rendered, self.frames.start + self.frames[-1]
        there = sorted(turning - index + offset for index in self.frames if turning - index + offset in self.truth_range)
        return replace(self, rendered=lambda index: original(turning - index + offset), frames=range(there[0], there[-1] + 1))


@dataclass(frozen=True, eq=False)
class Sample:
    """A burst of neighbouring instants at small size.

    Attributes:
        indices: frame numbers of the rendered frames.
        rendered: small rendered frames, (n, h, w, 3) float32 on the scale 0..255.
        truth_indices: frame numbers of the captured frames, `LARGEST_OFFSET` more at either end where there are any.
        truth: small captured frames, (m, h, w, 3) float32 on the scale 0..255.
    """

    indices: range
    rendered: Array32
    truth_indices: range
    truth: Array32

    @property
    def truth_now(self) -> Array32:
        """The captured frames of the same instants, (n, h, w, 3)."""
        first = self.indices.start - self.truth_indices.start
        return self.truth[first : first + len(self.indices)]


def take_sample(view: ViewFrames, count: int) -> Sample:
    """Read a burst out of the middle of a view, one full-sized frame in memory at a time."""
    indices, captured = middle_of(view.frames, count), view.truth_range
    around = range(max(captured.start, indices.start - LARGEST_OFFSET), min(captured.stop, indices.stop + LARGEST_OFFSET))
    rendered = np.stack([shrink(view.rendered(index)) for index in indices])
    return Sample(indices, rendered, around, np.stack([shrink(view.truth(index)) for index in around]))


def shrink(image: Image8, longest_side_px: int = SMALL_SIDE_PX) -> Array32:
    """A picture reduced by box averages to a longest side, float32 on the scale 0..255; small ones stay as they are."""
    height, width = image.shape[:2]
    factor = longest_side_px / max(height, width)
    pixels = image.astype(np.float32)
    if factor >= 1:
        return pixels
    size = max(round(width * factor), 1), max(round(height * factor), 1)
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), dtype=np.float32)


def spread(indices: range, count: int) -> list[int]:
    """At most `count` numbers, evenly over a range."""
    chosen = np.linspace(0, len(indices) - 1, min(count, len(indices)))
    return [indices[round(position)] for position in chosen]


def middle_of(indices: range, count: int) -> range:
    """At most `count` numbers in a row, from the middle of a range."""
    start = indices.start + max(len(indices) - count, 0) // 2
    return range(start, min(start + count, indices.stop))


def longest_run(indices: list[int]) -> range:
    """The longest run of consecutive numbers, which is what can be compared over time."""
    longest, start = range(0), 0
    for end in range(1, len(indices) + 1):
        if end == len(indices) or indices[end] != indices[end - 1] + 1:
            longest = max(longest, range(indices[start], indices[end - 1] + 1), key=len)
            start = end
    return longest


def views_of_run(run: RunFolder, label: str, as_measured: bool = False) -> dict[str, ViewFrames]:
    """Rendered and captured frames of one method in every test view.

    Args:
        label: ``method`` or ``method+variant``.
        as_measured: at the size at which the protocol measures frames; else as they lie there.
    """
    if label not in run.labels():
        raise RenderError(f"{run.root}: no renders of {label!r}; there are {', '.join(run.labels()) or 'none'}")
    protocol = run.protocol()
    frames = protocol.frames.numbers
    require_frames({f"{label} in {view}": run.renders(label, view) for view in protocol.views.test}, frames)
    require_frames({f"truth of {view}": run.truth(view) for view in protocol.views.test}, frames)
    measurement = protocol.measurement if as_measured else None
    return {
        view: ViewFrames(frame_reader(run.renders(label, view), measurement), frame_reader(run.truth(view), measurement), frames)
        for view in protocol.views.test
    }


def cameras_of_run(run: RunFolder) -> dict[str, FrameReader]:
    """Captured frames of every camera whose truth the run folder holds whole, source cameras among them."""
    protocol = run.protocol()
    frames = protocol.frames.numbers
    root = run.root / "truth"
    folders = sorted(folder for folder in root.iterdir() if folder.is_dir()) if root.is_dir() else []
    return {folder.name: frame_reader(folder) for folder in folders if not missing_frames(folder, frames)}


def frame_reader(folder: Path, measurement: Measurement | None = None) -> FrameReader:
    """Frames of a folder as they lie there, or at the size at which a protocol measures them."""

    def read(index: int) -> Image8:
        image = read_image(frame_path(folder, index))
        if measurement is None or not measurement.width:
            return image
        return resize(image, measurement.width, measurement.height, measurement.resize_filter)

    return read
