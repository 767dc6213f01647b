"""Instants of a rig: frame t of every camera shows one of them, so that counts and rates must be one."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ggvs_eval.capture import FrameSource, source_chain
from ggvs_eval.datasets.camera_frames import listed
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.video import VideoFrames

# Image folders do not say their rate; every capture published in this layout was recorded at this one.
FOLDER_FPS = 30.0
# Of constant rates that are one: what averages are rounded by, a fifth of what 29.97 is off 30.
LARGEST_DIFFERENCE = 2e-4
LARGEST_LAG = 0.5  # steps between frames of one number, where rates vary: farther off, the next frame is nearer


def common_count(path: Path, sources: Mapping[str, FrameSource]) -> int:
    """The number of frames of every camera."""
    counts = {name: source.n_frames for name, source in sources.items()}
    if len(set(counts.values())) > 1:
        shown = listed([f"{name} {count}" for name, count in counts.items()])
        raise CaptureError(f"{path}: wanted one frame count for all cameras, got {shown}; cut them to a common length")
    return next(iter(counts.values()))


def common_rate(path: Path, sources: Mapping[str, FrameSource]) -> float:
    """The frame rate of a rig whose cameras have equally many frames.

    Raises:
        CaptureError: constant rates that differ; variable ones where frames of one number lie over half a step apart.

    Reading:
        The average of a variable rate says little: phones that are started together keep step while their averages differ. So
        the times of equal frame numbers are compared, each camera's counted from its first frame.
    """
    videos = _videos(sources)
    rates = {name: video.fps if video else FOLDER_FPS for name, video in videos.items()}
    least, greatest = min(rates.values()), max(rates.values())
    if greatest - least <= LARGEST_DIFFERENCE * greatest:
        return round(rates[next(iter(rates))], 2)
    rate, lag_s = float(np.mean(list(rates.values()))), largest_lag_s(sources)
    is_uneven = any(video and video.uneven for video in videos.values())
    if is_uneven and lag_s is not None and lag_s <= LARGEST_LAG / rate:
        return round(rate, 2)
    shown = listed([f"{name} {rate:.2f}".rstrip("0").rstrip(".") for name, rate in rates.items()])
    apart = f" with frames of one number up to {1000 * lag_s:.0f} ms apart" if is_uneven and lag_s is not None else ""
    raise CaptureError(f"{path}: wanted one frame rate for all cameras, got {shown}{apart}; convert them to one rate")


def largest_lag_s(sources: Mapping[str, FrameSource]) -> float | None:
    """The largest distance in time of frames of one number, by the videos' time stamps; None where some are no videos."""
    times = [video.times_s for video in _videos(sources).values() if video]
    if len(times) < len(sources):
        return None
    return float(np.ptp(np.stack(times), axis=0).max())


def uneven_notes(sources: Mapping[str, FrameSource]) -> list[str]:
    """A note about cameras of a variable frame rate, which says how far frames of one number lie apart."""
    steps = [f"{name} ({video.uneven})" for name, video in _videos(sources).items() if video and video.uneven]
    lag_s = largest_lag_s(sources) if steps else None
    apart = f"; their times lie up to {1000 * lag_s:.1f} ms apart" if lag_s is not None else ""
    taken = "frame t of each camera is taken as one instant, whatever its time"
    return [f"variable frame rate in {listed(steps)}: {taken}{apart}"] if steps else []


def _videos(sources: Mapping[str, FrameSource]) -> dict[str, VideoFrames | None]:
    """The video of each camera, which may lie behind an undistortion; None where its frames are images."""
    return {
        name: next((each for each in source_chain(source) if isinstance(each, VideoFrames)), None)
        for name, source in sources.items()
    }
