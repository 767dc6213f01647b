"""Play: the view of a camera that moves around between the cameras of a rig, synthesised instant by
instant into a video.
"""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter

import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.depth_options import LIVE_MATCHER
from ggvs_eval.errors import RenderError
from ggvs_eval.files.images import quantise
from ggvs_eval.files.video import write_video
from ggvs_eval.pipelines.play.playback import Playback
from ggvs_eval.pipelines.play.synthesizer import (
    DEFAULT_METHOD,
    LEAST_SEEN,
    SEEN_FROM_DEG,
    OnlineSynthesizer,
    seen_share,
)
from ggvs_eval.progress import track

FPS_OF_STILLS = 30.0


@dataclass
class Timing:
    """Seconds of each stage of each frame: reading, the method's own stages, the whole step,
    encoding.

    Attributes:
        rows: stage -> seconds of each frame.
        seen_shares: share of each frame's view that the cameras see, see `seen_share`.
    """

    rows: list[dict[str, float]] = field(default_factory=list)
    seen_shares: list[float] = field(default_factory=list)

    @property
    def outside(self) -> str:
        """Frames of views that the cameras do not see, in words; empty if there is none."""
        count = sum(share < LEAST_SEEN for share in self.seen_shares)
        where = f"from within {SEEN_FROM_DEG:g} degrees"
        return (
            f"{count} of {len(self.seen_shares)} frames are outside the cameras' coverage {where}; "
            f"their borders are unreliable"
            if count
            else ""
        )

    def milliseconds(self) -> dict[str, tuple[float, float]]:
        """Return the median and 95th percentile of each stage, without the first frame where there
        are more.
        """
        warm = self.rows[1:] or self.rows
        return {
            stage: _percentiles([row[stage] for row in warm if stage in row]) for stage in warm[0]
        }

    def table(self) -> str:
        """Return one line per stage, and the frames per second of the median step and of all that
        was done per frame.
        """
        times = self.milliseconds()
        lines = [f"{'ms per frame':14s}{'p50':>9s}{'p95':>9s}"]
        lines += [f"{stage:14s}{median:9.1f}{high:9.1f}" for stage, (median, high) in times.items()]
        total = sum(times[stage][0] for stage in ("read", "synthesis", "encode"))
        rates = (
            f"{1000 / times['synthesis'][0]:.2f} frames per second of synthesis, "
            f"{1000 / total:.2f} with reading and encoding"
        )
        return "\n".join([*lines, rates, *filter(None, [self.outside])])


def record(
    playback: Playback, out: Path, method: str = DEFAULT_METHOD, device: str = "cpu"
) -> Timing:
    """Synthesise every step of a playback into a video.

    Frames and depth are read one instant at a time.

    Args:
        out: MP4 file to write; it appears when it is whole.
    """
    require_writable(out)
    capture, live = playback.capture, playback.live or LIVE_MATCHER
    synthesizer = OnlineSynthesizer(
        cameras=capture.cameras,
        k=playback.k,
        units_per_metre=capture.units_per_metre,
        method=method,
        device=device,
        sources=playback.sources,
        depth=live,
    )
    timing = Timing()
    write_video(out, _views(playback, synthesizer, timing), capture.fps or FPS_OF_STILLS)
    return timing


def require_writable(out: Path) -> None:
    """Refuse a file that cannot be written before hours are spent on its content.

    Raises:
        RenderError: it is no .mp4, a folder, or the system does not permit writing there.
    """
    if out.suffix.lower() != ".mp4" or out.is_dir():
        raise RenderError(
            f"{out}: wanted a video file to write, *.mp4, got "
            f"{'a folder' if out.is_dir() else 'another name'}"
        )
    probe = out.with_suffix(f".{os.getpid()}.probe")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise RenderError(
            f"{out}: cannot be written ({error.strerror}); choose a place where files can be "
            f"written"
        ) from error


def _views(playback: Playback, synthesizer: OnlineSynthesizer, timing: Timing) -> Iterator[Image8]:
    """Yield the video's frames, each made when it is asked for."""
    steps = list(zip(playback.instants, playback.poses, strict=True))
    for instant, pose in track(steps, "playing"):
        timing.seen_shares.append(seen_share(pose, playback.capture.cameras))
        begun = perf_counter()
        depths = None
        if playback.live is None:
            names = [camera.name for camera in synthesizer.sources(pose)]
            depths = {
                name: playback.store.read(playback.depth_keys[name], instant) for name in names
            }
        else:
            names = synthesizer.needed(pose)
        images = {name: playback.capture.frame(name, instant) for name in names}
        read = perf_counter()
        rendering = synthesizer.step(images, depths, pose)
        synthesised = perf_counter()
        yield quantise(rendering.image)
        encoded = perf_counter()
        timing.rows.append(
            {
                "read": read - begun,
                **rendering.seconds,
                "synthesis": synthesised - read,
                "encode": encoded - synthesised,
            }
        )


def _percentiles(seconds: Sequence[float]) -> tuple[float, float]:
    median, high = np.percentile(seconds, [50, 95]) * 1000
    return float(median), float(high)
