"""Captured frames, decoded, undistorted and resized once: every later step of a run reads these."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from ggvs_eval.arrays import Image8
from ggvs_eval.capture import Capture, FrameSource
from ggvs_eval.files.atomic import sweep_files
from ggvs_eval.files.images import read_image, write_image
from ggvs_eval.jobs.engine import Workers
from ggvs_eval.jobs.run_all import run_all
from ggvs_eval.run_folder import frame_path, missing_frames


@dataclass(frozen=True)
class CachedFrames:
    """Some frames of one camera in a run folder, a `FrameSource`.

    Attributes:
        folder: holds ``<frame>.png``.
        n_frames: frames of the camera in the capture, whether they are here or not.
        digest: of the frames in the capture.
    """

    folder: Path
    n_frames: int
    digest: str

    def frames(self, start: int, stop: int) -> Iterator[Image8]:
        """Read frames start <= t < stop one by one, RGB uint8 (H, W, 3).

        Raises:
            CaptureError: a frame that is not here.
        """
        for index in range(start, stop):
            yield read_image(frame_path(self.folder, index))


def cache_frames(capture: Capture, numbers: Mapping[str, Sequence[int]], root: Path, workers: Workers) -> Capture:
    """Write frames of some cameras, at the size of these cameras, that are not there yet.

    Cameras are decoded side by side, each video once and as a stream.

    Args:
        capture: at the wanted size.
        numbers: camera -> frames, in any order.
        root: folder to write ``<camera>/<frame>.png`` into.
        workers: where the work is done.

    Returns:
        The capture with these cameras read from there.

    Raises:
        CaptureError: frames that cannot be read.
    """
    absent = {
        name: [t for t in sorted(set(frames)) if not frame_path(root / name, t).is_file()] for name, frames in numbers.items()
    }
    missing = [(name, frames) for name, frames in absent.items() if frames]
    run_all(partial(_write, capture, root), missing, workers, "frames per camera")
    sources: list[FrameSource] = [
        CachedFrames(root / name, capture.n_frames, source.digest) if name in numbers else source
        for name, source in zip(capture.camera_names, capture.sources, strict=True)
    ]
    return replace(capture, sources=tuple(sources))


def _write(capture: Capture, root: Path, camera: tuple[str, Sequence[int]]) -> None:
    """Decode one camera from its first missing frame to its last; runs in a worker."""
    name, frames = camera
    folder, start = root / name, frames[0]
    sweep_files(folder)
    for index, image in enumerate(capture.frames(name, start, frames[-1] + 1), start):
        if missing_frames(folder, range(index, index + 1)):
            write_image(frame_path(folder, index), image)
