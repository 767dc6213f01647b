"""Coding of a camera's frames, whatever they lie in."""

from pathlib import Path

from ggvs_eval.capture import FrameSource
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.files.coding import Coding, read_coding
from ggvs_eval.files.video import VideoFrames

JPEG = (".jpg", ".jpeg")


def coding_of(source: FrameSource, frames: range) -> Coding | None:
    """Say how frames were coded.

    Returns:
        None where every pixel is as it was given; `Coding.unknown` where it is not and nothing more is known.
    """
    stored = source
    while hasattr(stored, "source"):  # undistorted, held still, or with noise added
        stored = stored.source
    if isinstance(stored, VideoFrames):
        changed = Coding(unknown="frames were changed after they were coded")
        return read_coding(stored.path, frames) if stored is source else changed
    if isinstance(stored, ImageFrames) and Path(stored.files[0]).suffix.lower() in JPEG:
        return Coding(unknown="frames are JPEG images")
    return None
