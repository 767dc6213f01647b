"""Frames of a view kept on disk, for metrics of other programs that want the whole video."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.errors import MetricError


class SpooledFrames:
    """Two videos of raw RGB, written frame by frame: memory is bounded, regardless of the length.

    8 MB a pair at 1352x1014.

    Example:
        >>> import numpy as np
        >>> frame = np.full((16, 16, 3), 100, np.uint8)
        >>> with SpooledFrames() as frames:
        ...     frames.add(frame, frame)
        ...     [video.shape for video in frames.videos()]
        [(1, 16, 16, 3), (1, 16, 16, 3)]
    """

    def __init__(self) -> None:
        self._folder = TemporaryDirectory(prefix="ggvs-eval-frames-")
        self.rendered, self.truth = (
            Path(self._folder.name) / name for name in ("rendered.rgb", "truth.rgb")
        )
        self.shape: tuple[int, ...] = ()
        self.count = 0

    def add(self, rendered: Image8, truth: Image8) -> None:
        """Write the next frame of both, (H, W, 3) uint8."""
        if self.count and truth.shape != self.shape:
            raise MetricError(
                f"frame {self.count} is {truth.shape}, the frames before are {self.shape}; a view "
                f"has one size"
            )
        for file, image in ((self.rendered, rendered), (self.truth, truth)):
            with file.open("ab") as video:
                video.write(np.ascontiguousarray(image, dtype=np.uint8).tobytes())
        self.shape = truth.shape
        self.count += 1

    def videos(self) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Rendered and captured frames, (T, H, W, 3), read from disk where they are looked at."""
        shape = (self.count, *self.shape)
        first, second = (
            np.memmap(file, np.uint8, "r", shape=shape) for file in (self.rendered, self.truth)
        )
        return first, second

    def __enter__(self) -> "SpooledFrames":
        return self

    def __exit__(self, *_: object) -> None:
        self._folder.cleanup()
