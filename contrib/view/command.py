"""The verb of the command line that opens the live viewer: view."""

import sys
from pathlib import Path

from ggvs_eval.camera import SourceChoice
from ggvs_eval.capture import Capture
from ggvs_eval.pipelines.commands.flags import (
    CAPTURE_DEFAULTS,
    LIVE_DEPTH,
    ONE_PER_CORE,
    CaptureFlags,
    DepthFlags,
    Device,
    Jobs,
    Label,
)
from ggvs_eval.pipelines.commands.play import Source, open_source
from ggvs_eval.pipelines.methods.network_options import checked_device
from ggvs_eval.pipelines.methods.registry import METHODS
from ggvs_eval.pipelines.play.synthesizer import DEFAULT_METHOD, online_method


def view(
    source: Source,
    method: Label = DEFAULT_METHOD,
    k: int = 2,
    frames: int | None = None,
    sources: SourceChoice | None = None,
    host: str = "127.0.0.1",
    port: int = 8080,
    out: Path = Path("view"),
    export: Path | None = None,
    device: Device = "cpu",
    reading: CaptureFlags = CAPTURE_DEFAULTS,
    depth: DepthFlags = LIVE_DEPTH,
    jobs: Jobs = ONE_PER_CORE,
) -> None:
    """View a scene in the browser: drag the camera, play or pause time.

    Needs the package viser: pip install 'ggvs-eval[view]'.

    Args:
        source: capture, with frames and depth cached in OUT/cache; or a run folder.
        method: rendering method; can be changed in the page.
        k: number of source views; can be changed in the page.
        frames: number of instants, from the first; all by default.
        sources: source views: nearest cameras, best coverage, or a triplet; the run's, or nearest,
            by default.
        host: address; 0.0.0.0 accepts remote connections; they need the printed URL, which has a
            token.
        port: port; the next free one if it is in use.
        out: folder of recorded paths, and of a capture's frames and depth.
        export: HTML file of cameras and points, which needs no server; then exit.
        device: device of networks, for the method and a capture's depth (--matcher raft, itermvs).
        reading: capture reading.
        depth: depth estimation of a capture.
        jobs: parallel processes that prepare a capture, at least 1.
    """
    from ggvs_eval.contrib.view.viewer import Listener, require_viser

    require_viser()
    listener = Listener(host, port)
    print(f"reading {source} ...", file=sys.stderr, flush=True)
    from ggvs_eval.contrib.view.session import ViewDefaults
    from ggvs_eval.contrib.view.viewer import Viewer, export_page
    from ggvs_eval.pipelines.play.playback import PlayOptions, make_playback
    from ggvs_eval.pipelines.run.suggest_protocol import suggest_protocol

    device = checked_device(device)
    online_method(method, device)
    scene, options = (
        open_source(source, reading, jobs),
        PlayOptions(k=k, frames=frames, width=None, sources=sources),
    )
    playback = make_playback(scene, options, depth.options(device), out / "cache", jobs, True)
    protocol = suggest_protocol(scene) if isinstance(scene, Capture) else scene.protocol
    if export is not None:
        export_page(playback, sorted(set(playback.instants)), export, listener)
        print(export)
        return
    online = tuple(label for label, spec in METHODS.built_in().items() if spec.online)
    with Viewer(
        playback=playback,
        defaults=ViewDefaults(
            method=method, methods=online, k=k, protocol=protocol, recordings=out
        ),
        listener=listener,
        device=device,
    ) as viewer:
        print(f"{listener.address} - open it in a browser; Ctrl-C stops the server", flush=True)
        viewer.wait()
