"""The verb of the command line that synthesises live into a video: play."""

from pathlib import Path
from typing import Annotated

import tyro

from ggvs_eval.camera import SourceChoice
from ggvs_eval.capture import Capture
from ggvs_eval.pipelines.commands.flags import (
    CAPTURE_DEFAULTS,
    LIVE_DEPTH,
    ONE_PER_CORE,
    CaptureFlags,
    CaptureOptions,
    DepthFlags,
    Device,
    Jobs,
    Label,
)
from ggvs_eval.pipelines.methods.network_options import checked_device
from ggvs_eval.pipelines.play.synthesizer import DEFAULT_METHOD, online_method
from ggvs_eval.pipelines.run.run_plan import RunPlan

Source = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="CAPTURE|RUN")]


def play(
    source: Source,
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT.mp4")],
    method: Label = DEFAULT_METHOD,
    k: int | None = None,
    frames: int | None = None,
    width: int | None = None,
    sources: SourceChoice | None = None,
    device: Device = "cpu",
    reading: CaptureFlags = CAPTURE_DEFAULTS,
    depth: DepthFlags = LIVE_DEPTH,
    jobs: Jobs = ONE_PER_CORE,
) -> None:
    """Render a camera orbit within the rig to a video; print the frame rate.

    Args:
        source: capture, with frames and depth cached next to the video (OUT-cache); or a run
            folder.
        out: MP4 file to write.
        method: rendering method.
        k: number of source views; the run's, or 4, by default.
        frames: instants of one orbit, from the first; all, or 90 of a single instant, by default.
        width: width of the video, pixels; that of the captured frames by default.
        sources: source views: nearest cameras, best coverage, or a triplet; the run's, or nearest,
            by default.
        device: device of networks, for the method and a capture's depth (--matcher raft, itermvs).
        reading: capture reading.
        depth: depth estimation of a capture.
        jobs: parallel processes that prepare a capture, at least 1.
    """
    from ggvs_eval.pipelines.play.play import record, require_writable
    from ggvs_eval.pipelines.play.playback import PlayOptions, make_playback

    device = checked_device(device)
    online_method(method, device)
    require_writable(out)
    cache, options = (
        out.with_name(f"{out.stem}-cache"),
        PlayOptions(k=k, frames=frames, width=width, sources=sources),
    )
    playback = make_playback(
        open_source(source, reading, jobs), options, depth.options(device), cache, jobs
    )
    timing = record(playback, out, method, device)
    size = "{} x {}".format(*playback.poses[0].size)
    print(
        f"{out}: {len(playback.poses)} frames of {size} by {method}, K = {playback.k}",
        timing.table(),
        sep="\n",
    )


def open_source(source: Path, reading: CaptureOptions, jobs: int) -> RunPlan | Capture:
    """Return the prepared run of a run folder, or a capture."""
    from ggvs_eval.pipelines.run.evaluate import reopen

    return reopen(source, jobs) if (source / "protocol.toml").is_file() else reading.open(source)
