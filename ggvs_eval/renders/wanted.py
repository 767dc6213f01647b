"""What renders must hold to be scored in a run: views, frames and sizes, and the captured frames they stand beside."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from ggvs_eval.arrays import Image8
from ggvs_eval.errors import RenderError
from ggvs_eval.files.images import read_image
from ggvs_eval.renders.picture import read_header
from ggvs_eval.run_folder import RunFolder, frame_path


@dataclass(frozen=True)
class Wanted:
    """Everything that a run asks of a method's frames.

    Attributes:
        label: what the method will be called.
        views: names of the test views, in the protocol's order.
        frames: frame numbers of the protocol.
        n_frames: frames of the whole capture; renders of all of them hold the protocol's too.
        sizes: view -> (width, height) in pixels.
        cameras: names of all cameras, in the capture's order.
        truth_root: folder of the captured frames, ``<view>/<frame>.png``.
    """

    label: str
    views: tuple[str, ...]
    frames: range
    n_frames: int
    sizes: Mapping[str, tuple[int, int]]
    cameras: tuple[str, ...]
    truth_root: Path

    def truth(self, view: str, frame: int) -> Image8:
        """The captured frame, (H, W, 3) uint8 RGB."""
        return read_image(frame_path(self.truth_root / view, frame))


class RenderedView(Protocol):
    """The frames of one view, wherever and however they lie."""

    @property
    def numbers(self) -> tuple[int, ...]:
        """Frame numbers that there are, rising."""

    def faults(self, size: tuple[int, int]) -> dict[int, str]:
        """Frame number -> why this frame cannot be used at (width, height), e.g. ``64 x 48 instead of 128 x 96``."""

    def write(self, folder: Path, numbers: tuple[int, ...]) -> list[str]:
        """Put these frames into a folder as ``<frame>.png``; gives back what people should know of it."""


@dataclass(frozen=True)
class Found:
    """What a source of renders holds.

    Attributes:
        views: test view -> its frames; a view that is not there has no entry.
        extras: names of pictures, videos or arrays that belong to no view or frame of the protocol.
        notes: how names and numbers were understood.
    """

    views: Mapping[str, RenderedView]
    extras: tuple[str, ...] = ()
    notes: tuple[str, ...] = field(default=())


def wanted_of(run: RunFolder, label: str) -> Wanted:
    """What a run asks of a method.

    Raises:
        ResultsError: not a run folder.
        RenderError: a run folder without captured frames.
    """
    protocol, record = run.protocol(), run.capture_record()
    frames = protocol.frames.numbers
    views = protocol.views.test
    sizes = {}
    for view in views:
        file = frame_path(run.truth(view), frames.start)
        if not file.is_file():
            raise RenderError(f"{file}: wanted a captured frame to compare with, there is none; run `ggvs-eval prepare`")
        header = read_header(file)
        sizes[view] = (header.width, header.height)
    return Wanted(label, views, frames, record["n_frames"], sizes, tuple(record["cameras"]), run.root / "truth")
