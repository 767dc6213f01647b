"""Exact depth beside the demo's videos: one HDF5 file per camera."""

from pathlib import Path
from types import TracebackType

import numpy as np

from ggvs_eval.arrays import Array32
from ggvs_eval.errors import CaptureError


class DepthWriter:
    """Writes ``depth`` (T, H, W), float32, world units, and ``frames`` (T,), the video frames they belong to.

    Args:
        path: file to write; nothing is written where no frames are wanted.
        frames: video frames to keep, ascending.
        height: of an image, pixels.
        width: of an image, pixels.
    """

    def __init__(self, path: Path, frames: list[int], height: int, width: int) -> None:
        import h5py

        self._row = {frame: row for row, frame in enumerate(frames)}
        self._file = None
        if frames:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = h5py.File(path, "w", track_order=False)
            self._file.create_dataset("frames", data=np.array(frames, np.int64), track_times=False)
            size = (len(frames), height, width)
            # Not LZF, whose bytes depend on what was compressed before.
            packed = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
            self._depth = self._file.create_dataset(
                "depth", size, np.float32, chunks=(1, height, width), track_times=False, **packed
            )

    def add(self, frame: int, depth: Array32) -> None:
        """Keep the depth of a video frame, (H, W), if it is one of those wanted."""
        if frame in self._row:
            self._depth[self._row[frame]] = depth

    def __enter__(self) -> "DepthWriter":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._file is not None:
            self._file.close()


def depth_path(folder: Path, camera: str) -> Path:
    """Where a demo keeps the exact depth of a camera."""
    return folder / "depth" / f"{camera}.h5"


def read_exact_depth(folder: Path, camera: str, frame: int) -> Array32:
    """Exact depth of one video frame of a demo, world units, (H, W).

    Raises:
        CaptureError: the demo keeps no depth, or not of this frame.
    """
    import h5py

    path = depth_path(folder, camera)
    if not path.is_file():
        raise CaptureError(f"{path}: no exact depth here; only a demo capture has it, written with depth_stride > 0")
    with h5py.File(path) as file:
        frames = file["frames"][:].tolist()
        if frame not in frames:
            raise CaptureError(f"{path}: wanted frame {frame}, depth is kept of {frames}; change depth_stride")
        return np.asarray(file["depth"][frames.index(frame)])
