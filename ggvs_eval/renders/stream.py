"""Rendered frames that lie one behind the other, in a video or an array: written to PNG as a stream, one frame in memory."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from ggvs_eval.arrays import Image8
from ggvs_eval.files.images import write_image
from ggvs_eval.run_folder import frame_path


class FrameStream(Protocol):
    """Frames in order, at one size."""

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""

    def frames(self, start: int, stop: int) -> Iterator[Image8]:
        """Frames start <= t < stop one by one, RGB uint8 (H, W, 3)."""


@dataclass(frozen=True)
class StreamView:
    """Frames of one view out of a stream, a `RenderedView`.

    Attributes:
        stream: where they come from.
        indices: frame number -> place in the stream, both rising in steps of one.
        note: what people should know of the source, e.g. that it is a lossy video.
    """

    stream: FrameStream
    indices: Mapping[int, int]
    note: str

    @property
    def numbers(self) -> tuple[int, ...]:
        """Frame numbers that there are, rising."""
        return tuple(sorted(self.indices))

    def faults(self, size: tuple[int, int]) -> dict[int, str]:
        """All frames where the stream has another size."""
        width, height = self.stream.size
        if (width, height) == size:
            return {}
        return dict.fromkeys(self.numbers, f"{width} x {height} instead of {size[0]} x {size[1]}")

    def write(self, folder: Path, numbers: tuple[int, ...]) -> list[str]:
        """Write these frames as PNG files."""
        folder.mkdir(parents=True, exist_ok=True)
        first, last = self.indices[numbers[0]], self.indices[numbers[-1]]
        numbered = {index: number for number, index in self.indices.items() if number in set(numbers)}
        for index, image in enumerate(self.stream.frames(first, last + 1), first):
            if index in numbered:
                write_image(frame_path(folder, numbered[index]), image)
        return [self.note]
