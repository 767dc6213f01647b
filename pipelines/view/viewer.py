"""The viewer's server: a page for every browser window that opens, and two threads that make their pictures.

`viser` serves the page, draws the scene and tells where the camera is; the pictures lie behind its scene as a background.
"""

import contextlib
import io
import threading
import traceback
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from ggvs_eval.pipelines.play.playback import Playback
from ggvs_eval.pipelines.view.frame_stock import FrameStock
from ggvs_eval.pipelines.view.listener import Listener, start_guarded
from ggvs_eval.pipelines.view.scene import (
    Frusta,
    add_cloud,
    gazed_depth,
    middle_camera,
    up_direction,
    vertical_fov,
)
from ggvs_eval.pipelines.view.session import Session, ViewDefaults

if TYPE_CHECKING:
    import viser

MOVING_PIXELS = 640 * 360
IDLE_SECONDS = 0.02  # between looks at the clock while time plays or a camera comes to rest


class Viewer:
    """A running server; a context that stops it at the end.

    Args:
        playback: what is looked at; its poses are not used.
        listener: where the page is served; its address is the one to open.
    """

    def __init__(self, playback: Playback, defaults: ViewDefaults, listener: Listener, device: str = "cpu") -> None:
        self._playback, self._defaults, self._device = playback, defaults, device
        whole = middle_camera(playback.capture.cameras)
        small_stock = FrameStock(playback, MOVING_PIXELS)
        self._stocks = small_stock, FrameStock(playback, whole.width * whole.height)
        self._sessions: dict[int, Session] = {}
        self._changed, self._stopped = threading.Event(), threading.Event()
        self.server = open_server(listener)
        set_camera(self.server, small_stock, playback.instants[0])
        self.server.on_client_connect(self._open_session)
        self.server.on_client_disconnect(self._close_session)
        self._threads = [threading.Thread(target=work, daemon=True) for work in (self._advance_all, self._refine_all)]
        for thread in self._threads:
            thread.start()

    def wait(self) -> None:
        """Serve until interrupted."""
        while not self._stopped.wait(1.0):
            pass

    def stop(self) -> None:
        """End the threads and the server."""
        self._stopped.set()
        self._changed.set()
        for thread in self._threads:
            thread.join()
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()

    def __enter__(self) -> "Viewer":
        """The viewer itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Stop."""
        self.stop()

    def _open_session(self, client: "viser.ClientHandle") -> None:
        session = Session(client, self._playback, self._stocks, MOVING_PIXELS, self._defaults, self._device, self._changed.set)
        self._sessions[client.client_id] = session
        session.change()

    def _close_session(self, client: "viser.ClientHandle") -> None:
        self._sessions.pop(client.client_id, None)

    def _advance_all(self) -> None:
        """Give each window its next small picture in turn; wait where no window wants one."""
        while not self._stopped.is_set():
            self._changed.clear()
            if not any([_attempt(session, session.advance) for session in list(self._sessions.values())]):
                self._changed.wait(IDLE_SECONDS if self._sessions else None)

    def _refine_all(self) -> None:
        """Make the whole picture of windows at rest, one at a time."""
        while not self._stopped.wait(IDLE_SECONDS):
            for session in list(self._sessions.values()):
                if session.rests():
                    _attempt(session, session.refine)


def _attempt(session: Session, work: Callable[[], bool | None]) -> bool:
    """Work for one window; what goes wrong is said in it and on the terminal, and the other windows go on."""
    try:
        return bool(work())
    except Exception as error:
        traceback.print_exc()
        with contextlib.suppress(Exception):  # its window may be what is gone
            session.complain(f"{type(error).__name__}: {error}")
        return False


def open_server(listener: Listener) -> "viser.ViserServer":
    """A server without a scene, which cannot be made to publish itself."""
    import viser
    from viser import _messages

    start = partial(viser.ViserServer, host="127.0.0.1", port=listener.port, label="ggvs-eval", verbose=False)
    with contextlib.redirect_stdout(io.StringIO()):  # its banner; the command says the address in its own words
        server = start_guarded(listener, start)
    for request in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
        server._websock_server.unregister_handler(request)  # the button alone would hide, a message would do as before
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    server.gui.main_panel.dock_right()
    return server


def set_camera(server: "viser.ViserServer", stock: FrameStock, instant: int) -> None:
    """Let windows open where the middle camera stands, turning around what it looks at."""
    camera = middle_camera(stock.cameras)
    server.scene.set_up_direction(up_direction(stock.cameras))
    server.initial_camera.position = camera.centre
    server.initial_camera.look_at = camera.centre + gazed_depth(stock, instant) * camera.axis
    server.initial_camera.up = -camera.rotation[1]
    server.initial_camera.fov = vertical_fov(camera)
    server.initial_camera.near, server.initial_camera.far = camera.near / 100, camera.far * 10


def export_page(playback: Playback, instants: Sequence[int], file: Path, listener: Listener, pixels: int = MOVING_PIXELS) -> None:
    """Write a page that needs no server: the cameras, and the points of each instant, played one after the other.

    Args:
        listener: of the server that viser makes the page by, for as long as that takes.
        pixels: of the frames that points are made of, at most.

    Reading:
        The method itself cannot run in a page without a server; what is exported is the scene that it looks at.
    """
    from ggvs_eval.files.atomic import write_text

    stock, server = FrameStock(playback, pixels), open_server(listener)
    try:
        set_camera(server, stock, instants[0])
        Frusta(server.scene, stock.cameras)
        serializer = server.get_scene_serializer()
        for instant in instants:
            add_cloud(server.scene, stock, instant)
            serializer.insert_sleep(1 / (playback.capture.fps or 30.0))
        write_text(file, serializer.as_html())
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()
