"""The verb of the command line that synthesises live."""

from pathlib import Path
from typing import Annotated

import tyro

from ggvs_eval.geometry.source_views import SourceChoice
from ggvs_eval.jobs.processes import default_workers
from ggvs_eval.pipelines.commands.captures import BY_DEFAULT, FOUND_BY_DEFAULT, Finding, Reading
from ggvs_eval.pipelines.commands.runs import Device
from ggvs_eval.pipelines.methods.network_options import found_device
from ggvs_eval.pipelines.methods.registry import METHODS
from ggvs_eval.pipelines.play.synthesizer import DEFAULT_METHOD, online_method


def play(
    source: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="CAPTURE|RUN")],
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT.mp4")],
    method: Annotated[str, tyro.conf.arg(metavar=f"{{{','.join(METHODS)}}}")] = DEFAULT_METHOD,
    k: int | None = None,
    frames: int | None = None,
    width: int | None = None,
    sources: SourceChoice | None = None,
    device: Device = "cpu",
    reading: Reading = BY_DEFAULT,
    depth: Finding = FOUND_BY_DEFAULT,
    jobs: int = default_workers(),
) -> None:
    """Synthesise the view of a camera that goes round between the cameras of a rig into a video, and tell how fast.

    Args:
        source: a capture, whose frames and depth are kept beside the video (OUT-cache); or a run folder, which has both.
        out: MP4 file to write.
        method: by which method.
        k: source views; those of the run's protocol, or 4, by default.
        frames: instants from the first on, in which the camera goes round once; all, or 90 of a single instant, by default.
        width: of the video in pixels; that of the captured frames by default.
        sources: which cameras are source views: the nearest, or those that see most of the view (coverage); as the run's protocol
            says, or the nearest, by default.
        device: where networks of the method compute.
        reading: how a capture is read.
        depth: how depth of a capture is found.
        jobs: processes that prepare a capture; synthesis takes one instant after the other.
    """
    from ggvs_eval.pipelines.play.play import record, require_writable
    from ggvs_eval.pipelines.play.playback import PlayOptions, playback_of_capture, playback_of_run
    from ggvs_eval.pipelines.run.evaluate import reopen

    device = found_device(device)
    online_method(method, device)
    require_writable(out)
    wanted = PlayOptions(k, frames, width, sources)
    if (source / "protocol.toml").is_file():
        playback = playback_of_run(reopen(source, jobs), wanted)
    else:
        cache = out.with_name(f"{out.stem}-cache")
        playback = playback_of_capture(reading.open(source), wanted, depth.options(), cache, jobs)
    timing = record(playback, out, method, device)
    size = "{} x {}".format(*playback.poses[0].size)
    print(f"{out}: {len(playback.poses)} frames of {size} by {method}, K = {playback.k}", timing.table(), sep="\n")
