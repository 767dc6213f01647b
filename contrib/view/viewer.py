"""The viewer's server: a page for every browser window that opens, and two threads that make their
pictures.

Its socket accepts requests that know the token, from the viewer's own page.

`viser` serves the page, draws the scene and reports the camera's pose; the pictures are behind its
scene as a background.
"""

import contextlib
import dataclasses
import errno
import http
import importlib.util
import io
import ipaddress
import os
import secrets
import socket
import threading
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from ggvs_eval.camera import up_direction
from ggvs_eval.contrib.view.live_view import FrameStock
from ggvs_eval.contrib.view.scene import (
    Frusta,
    add_cloud,
    gazed_depth,
    middle_camera,
    vertical_fov,
)
from ggvs_eval.contrib.view.session import Session, ViewDefaults
from ggvs_eval.errors import CommandError
from ggvs_eval.pipelines.play.playback import Playback

if TYPE_CHECKING:
    import viser
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

PORTS_TRIED = 100
MISSING = "view: wanted the package viser, got none; run `pip install 'ggvs-eval[view]'`"
# No packet is sent there (RFC 5737): the route that one would take says by which address others
# reach this machine.
ELSEWHERE = ("192.0.2.1", 9)
HEADERS = {"Referrer-Policy": "no-referrer", "X-Frame-Options": "DENY", "Cache-Control": "no-store"}
MOVING_PIXELS = 640 * 360
IDLE_SECONDS = 0.02  # between looks at the clock while time plays or a camera comes to rest


class Listener:
    """A socket that listens already, so that an impossible address shows before anything is
    computed.

    A page of another site can make a browser talk to this machine, and other users of it can
    connect. Both lack the token, a random part of the address. In addition, a browser's page must
    be the viewer's (Origin), and called by an address or a name that is known to be this machine's
    (Host): a foreign name may have been pointed here (DNS rebinding).

    Args:
        host: address or name to listen at; 0.0.0.0 accepts remote connections.
        port: the next free one is taken where it is in use; 0 takes any.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = 8080) -> None:
        self.socket = _listening(host, port)
        self._host, self._token = host, secrets.token_urlsafe(24)
        self._is_open_to_all = ipaddress.ip_address(self.socket.getsockname()[0]).is_unspecified
        self._names = {host.lower(), "localhost"} | (
            {socket.gethostname().lower()} if self._is_open_to_all else set()
        )

    @property
    def port(self) -> int:
        """Port that it listens at."""
        return int(self.socket.getsockname()[1])

    @property
    def address(self) -> str:
        """Address to open in a browser; it ends with the token."""
        host = _own_address(self.socket.family) if self._is_open_to_all else self._host
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}/{self._token}/"

    def refusal(self, request: "Request") -> str:
        """Return why a request is not let in; empty if it is."""
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        if len(hosts) != 1 or not self._is_own(hosts[0]):
            return "unknown host name; use this machine's address, or localhost"
        if any(origin.partition("://")[2].lower() != hosts[0].lower() for origin in origins):
            return "request from another site"
        if not secrets.compare_digest(
            _first_part(request.path).encode(errors="replace"), self._token.encode()
        ):
            return "open the full printed address, including the token"
        return ""

    def _is_own(self, host: str) -> bool:
        """Return whether the Host of a request is a name of this machine or a bare address, which
        no DNS can redirect.
        """
        with suppress(ValueError):
            name = urlsplit(f"//{host}").hostname or ""
            return name in self._names or ipaddress.ip_address(name) is not None
        return False


def require_viser() -> None:
    """Require viser, with the command that installs it, before anything is computed."""
    if importlib.util.find_spec("viser") is None:
        raise CommandError(MISSING)


def start_guarded(
    listener: Listener, start: Callable[[], "viser.ViserServer"]
) -> "viser.ViserServer":
    """Start a server of viser that listens at the given socket, and asks the listener about every
    request.

    Raises:
        CommandError: it was started in another way, and would let anyone in; it is stopped again.
    """
    from websockets.asyncio import server

    serve, is_guarded = server.serve, False

    def serve_guarded(
        handler: Any, _host: str, _port: int, *, process_request: Any, **options: Any
    ) -> Any:
        nonlocal is_guarded
        is_guarded = True
        return serve(
            handler,
            sock=listener.socket,
            process_request=_asking(listener, process_request),
            **options,
        )

    server.serve = serve_guarded  # type: ignore[misc, assignment]  # viser has no other hook
    try:
        started = start()
    finally:
        server.serve = serve  # type: ignore[misc]
    if not is_guarded:
        started.stop()
        raise CommandError(
            "wanted a supported version of viser, got another; run `pip install 'ggvs-eval[view]'`"
        )
    return started


def _asking(
    listener: Listener, process: Callable[["ServerConnection", "Request"], "Response | None"]
) -> Callable[["ServerConnection", "Request"], "Response | None"]:
    """Return a server's own way to answer requests, behind the listener's."""

    def answer(connection: "ServerConnection", request: "Request") -> "Response | None":
        if reason := listener.refusal(request):
            return connection.respond(http.HTTPStatus.FORBIDDEN, f"{reason}\n")
        inner = request.path.removeprefix(f"/{_first_part(request.path)}")
        response = process(connection, dataclasses.replace(request, path=inner))
        if response is not None:
            response.headers.update(HEADERS)
        return response

    return answer


def _first_part(path: str) -> str:
    """Return the first part of the path of a request.

    Examples:
        >>> _first_part("/token/index.html?dark"), _first_part("/token?dark")
        ('token', 'token')
    """
    return path.partition("?")[0].removeprefix("/").partition("/")[0]


def _listening(host: str, port: int) -> socket.socket:
    """Return a socket that listens at the port, or at the next free one."""
    try:
        family, _, _, _, address = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)[0]
        return _first_free(str(address[0]), port, family)
    except (OSError, OverflowError, UnicodeError) as error:
        code = error.errno if isinstance(error, OSError) else None
        reason = os.strerror(code) if code and code > 0 else error
        raise CommandError(
            f"--host {host} --port {port}: cannot listen there ({reason}); use an address of this "
            "machine, such as 127.0.0.1, and a free port from 1024 to 65535"
        ) from error


def _first_free(address: str, port: int, family: int) -> socket.socket:
    for tried in range(port, port + PORTS_TRIED):
        try:
            return socket.create_server((address, tried), family=family)
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise
    raise OSError(errno.EADDRINUSE, "all of them are in use")


def _own_address(family: socket.AddressFamily) -> str:
    """Return the address by which other machines reach this one.

    The loopback's if there is no way to others.
    """
    if family == socket.AF_INET:
        with socket.socket(family, socket.SOCK_DGRAM) as probe, suppress(OSError):
            probe.connect(ELSEWHERE)
            return str(probe.getsockname()[0])
    return "::1" if family == socket.AF_INET6 else "127.0.0.1"


class Viewer:
    """A running server; a context that stops it at the end.

    Args:
        playback: what is looked at; its poses are not used.
        listener: where the page is served; its address is the one to open.
    """

    def __init__(
        self, playback: Playback, defaults: ViewDefaults, listener: Listener, device: str = "cpu"
    ) -> None:
        self._playback, self._defaults, self._device = playback, defaults, device
        middle = middle_camera(playback.capture.cameras)
        small_stock = FrameStock(playback, MOVING_PIXELS)
        self._stocks = small_stock, FrameStock(playback, middle.width * middle.height)
        self._sessions: dict[int, Session] = {}
        self._changed, self._stopped = threading.Event(), threading.Event()
        self.server = open_server(listener)
        set_camera(self.server, small_stock, playback.instants[0])
        self.server.on_client_connect(self._open_session)
        self.server.on_client_disconnect(self._close_session)
        self._threads = [
            threading.Thread(target=work, daemon=True)
            for work in (self._advance_all, self._refine_all)
        ]
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
        """Return the viewer itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop."""
        self.stop()

    def _open_session(self, client: "viser.ClientHandle") -> None:
        session = Session(
            client=client,
            playback=self._playback,
            stocks=self._stocks,
            pixels=MOVING_PIXELS,
            defaults=self._defaults,
            device=self._device,
            changed=self._changed.set,
        )
        self._sessions[client.client_id] = session
        session.change()

    def _close_session(self, client: "viser.ClientHandle") -> None:
        self._sessions.pop(client.client_id, None)

    def _advance_all(self) -> None:
        """Give each window its next small picture in turn; wait where no window wants one."""
        while not self._stopped.is_set():
            self._changed.clear()
            if not any(
                [_attempt(session, session.advance) for session in list(self._sessions.values())]
            ):
                self._changed.wait(IDLE_SECONDS if self._sessions else None)

    def _refine_all(self) -> None:
        """Make the whole picture of windows at rest, one at a time."""
        while not self._stopped.wait(IDLE_SECONDS):
            for session in list(self._sessions.values()):
                if session.rests():
                    _attempt(session, session.refine)


def _attempt(session: Session, work: Callable[[], bool | None]) -> bool:
    """Work for one window; what goes wrong is said in it and on the terminal, and the other windows
    continue.
    """
    try:
        return bool(work())
    except Exception as error:
        traceback.print_exc()
        with contextlib.suppress(Exception):  # its window may be what is gone
            session.complain(f"{type(error).__name__}: {error}")
        return False


def open_server(listener: Listener) -> "viser.ViserServer":
    """Return a server without a scene, which cannot be made to publish itself."""
    import viser
    from viser import _messages

    start = partial(
        viser.ViserServer, host="127.0.0.1", port=listener.port, label="ggvs-eval", verbose=False
    )
    # its banner; the command says the address in its own words
    with contextlib.redirect_stdout(io.StringIO()):
        server = start_guarded(listener, start)
    for request in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
        # the button alone would hide, a message would do as before
        server._websock_server.unregister_handler(request)
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    server.gui.main_panel.dock_right()
    return server


def set_camera(server: "viser.ViserServer", stock: FrameStock, instant: int) -> None:
    """Let windows open at the middle camera, turning around its point of view."""
    camera = middle_camera(stock.cameras)
    server.scene.set_up_direction(up_direction(stock.cameras))
    server.initial_camera.position = camera.centre
    server.initial_camera.look_at = camera.centre + gazed_depth(stock, instant) * camera.axis
    server.initial_camera.up = -camera.rotation[1]
    server.initial_camera.fov = vertical_fov(camera)
    server.initial_camera.near, server.initial_camera.far = camera.near / 100, camera.far * 10


def export_page(
    playback: Playback,
    instants: Sequence[int],
    file: Path,
    listener: Listener,
    pixels: int = MOVING_PIXELS,
) -> None:
    """Write a page that needs no server: the cameras, and the points of each instant, played one
    after the other.

    Args:
        listener: of the server that viser makes the page by, for as long as that takes.
        pixels: of the frames that points are made of, at most.

    Reading:
        The method itself cannot run in a page without a server; what is exported is the scene that
        it looks at.
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
