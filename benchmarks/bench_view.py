"""The live viewer over the wire: pictures per second while the camera is dragged, and how soon a
jump of the camera shows.

`python -m benchmarks.bench_view CAPTURE|RUN` speaks with the server as a browser does, by
websocket, and draws nothing: the browser of anyone who looks has its own cores.
"""

import argparse
import json
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import viser
import zstandard
from scipy.spatial.transform import Rotation
from viser._messages import ViewerCameraMessage
from websockets.sync.client import ClientConnection, connect

from ggvs_eval.contrib.view.scene import vertical_fov
from ggvs_eval.contrib.view.session import ViewDefaults
from ggvs_eval.contrib.view.viewer import Listener, Viewer
from ggvs_eval.datasets import open_capture
from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.pipelines.methods.registry import METHODS
from ggvs_eval.pipelines.play.playback import (
    Playback,
    PlayOptions,
    camera_loop,
    playback_of_capture,
)
from ggvs_eval.pipelines.run.suggest_protocol import suggest_protocol

WINDOW = 640, 360
DRAG_SECONDS, JUMPS = 10.0, 12
SENT_PER_SECOND = 30  # messages of a browser whose camera is dragged


def main() -> None:
    """Print rates and latencies as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--cache", type=Path, default=Path("out/bench_view"))
    parser.add_argument("--method", default="ours")
    parser.add_argument("--k", type=int, default=2)
    chosen = parser.parse_args()
    capture = open_capture(chosen.capture)
    playback = playback_of_capture(
        capture,
        PlayOptions(k=chosen.k, frames=1),
        DepthRunOptions().options(),
        chosen.cache,
        2,
        anywhere=True,
    )
    defaults = ViewDefaults(
        chosen.method, tuple(METHODS), chosen.k, suggest_protocol(capture), chosen.cache
    )
    listener = Listener(port=0)
    with Viewer(playback, defaults, listener):
        print(json.dumps(measured(listener.address, playback), indent=1))


def measured(address: str, playback: Playback) -> dict[str, float]:
    """Return the pictures per second of a drag, and the median and the 95th percentile of a jump's
    latency in ms.
    """
    url = address.replace("http", "ws")
    with connect(url, subprotocols=[f"viser-v{viser.__version__}"], max_size=None) as socket:
        poses = list(_poses(playback))
        _jump(socket, poses[0])
        shown = _drag(socket, poses)
        time.sleep(3)  # the picture at full size comes, too
        _drain(socket)
        jumps = [_jump(socket, poses[(37 * index) % len(poses)]) for index in range(1, JUMPS + 1)]
    median, high = np.percentile(jumps, [50, 95]) * 1000
    return {
        "pictures_per_second": shown / DRAG_SECONDS,
        "jump_ms_p50": float(median),
        "jump_ms_p95": float(high),
    }


def _poses(playback: Playback) -> Iterator[bytes]:
    """Yield the messages that a browser sends as its camera goes round."""
    width, height = WINDOW
    for camera in camera_loop(playback.capture.cameras, 300):
        turned = Rotation.from_matrix(camera.rotation.T).as_quat(scalar_first=True)
        message = ViewerCameraMessage(
            wxyz=tuple(turned.tolist()),
            position=tuple(camera.centre.tolist()),
            fov=vertical_fov(camera),
            near=camera.near,
            far=camera.far,
            image_height=height,
            image_width=width,
            look_at=tuple((camera.centre + camera.axis).tolist()),
            up_direction=tuple((-camera.rotation[1]).tolist()),
        )
        yield msgspec.msgpack.encode(message.as_serializable_dict())


def _drag(socket: ClientConnection, poses: list[bytes]) -> int:
    """Send a pose every thirtieth of a second; how many pictures came."""
    begun, shown = time.perf_counter(), 0
    for index in range(int(DRAG_SECONDS * SENT_PER_SECOND)):
        socket.send(poses[index % len(poses)])
        while (left := begun + (index + 1) / SENT_PER_SECOND - time.perf_counter()) > 0:
            shown += _pictures(socket, left)
    return shown


def _jump(socket: ClientConnection, pose: bytes) -> float:
    """Send a pose and wait for its picture; seconds."""
    time.sleep(1.0)
    _drain(socket)
    begun = time.perf_counter()
    socket.send(pose)
    while not _pictures(socket, 10.0):
        pass
    return time.perf_counter() - begun


def _drain(socket: ClientConnection) -> None:
    while _pictures(socket, 0.05) >= 0:
        try:
            socket.recv(timeout=0.05)
        except TimeoutError:
            return


def _pictures(socket: ClientConnection, timeout: float) -> int:
    """Return the pictures in the next message of the server."""
    try:
        raw = socket.recv(timeout=timeout)
    except TimeoutError:
        return 0
    size = int.from_bytes(raw[8:16], "little")
    inner = msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(raw[16 : 16 + size]))
    return sum(message["type"] == "BackgroundImageMessage" for message in inner["messages"])


if __name__ == "__main__":
    main()
