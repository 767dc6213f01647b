"""Who is let in to the viewer: whoever has the printed address, on its own page; and where it
cannot listen at all.
"""

import socket
import time
import urllib.error
import urllib.request
from types import SimpleNamespace
from urllib.parse import urlsplit

import pytest

from ggvs_eval.contrib.view.viewer import Listener, start_guarded
from ggvs_eval.errors import CommandError
from ggvs_eval.pipelines.commands.main import run_command

viser = pytest.importorskip("viser")
EVIL = "evil.example"


@pytest.fixture(scope="module")
def served():
    """A server with one button; its listener, and how often the button was pressed."""
    from ggvs_eval.contrib.view.viewer import open_server

    listener, clicks = Listener(port=0), []
    server = open_server(listener)
    button = server.gui.add_button("write video")
    button.on_click(lambda _: clicks.append(1))
    yield SimpleNamespace(listener=listener, server=server, clicks=clicks, button=button)
    server.stop()


def status_of(url: str, **headers: str) -> int:
    """The status of the answer to a GET."""
    try:
        with urllib.request.urlopen(
            urllib.request.Request(url, headers=headers), timeout=20
        ) as answer:
            return answer.status
    except urllib.error.HTTPError as error:
        return error.code


def talk(url: str, messages=(), origin: str | None = None, **headers: str) -> int:
    """Open a websocket as viser's page does, send some messages, and count what comes within a
    second.
    """
    import msgspec
    from websockets.sync.client import connect

    protocol = [f"viser-v{viser.__version__}"]
    with connect(
        url, subprotocols=protocol, origin=origin, additional_headers=headers, max_size=None
    ) as client:
        for message in messages:
            client.send(msgspec.msgpack.encode(message.as_serializable_dict()))
            time.sleep(0.2)
        came, end = 0, time.monotonic() + 1
        while (left := end - time.monotonic()) > 0:
            try:
                client.recv(timeout=left)
                came += 1
            except TimeoutError:
                break
        return came


def without_token(address: str) -> str:
    parts = urlsplit(address)
    return f"{parts.scheme}://{parts.netloc}/"


def test_the_printed_address_opens_the_page_and_its_socket(served):
    """By http and by websocket, as our own page and as a program that sends no origin; the page may
    not be framed.
    """
    address = served.listener.address
    with urllib.request.urlopen(address, timeout=20) as answer:
        assert b"<title>Viser" in answer.read()
        assert answer.headers["X-Frame-Options"] == "DENY"
        assert answer.headers["Referrer-Policy"] == "no-referrer"
    origin = without_token(address).rstrip("/")
    assert status_of(address, Origin=origin) == 200
    assert talk(address.replace("http", "ws")) > 0
    assert talk(address.replace("http", "ws"), origin=origin) > 0


@pytest.mark.parametrize("path", ["", "index.html", "x" * 32, "x/", "%2e%2e/", "ü/"])
def test_nobody_comes_in_without_the_token(path, served):
    """Neither to the page nor to the socket."""
    from websockets.exceptions import InvalidStatus

    address = without_token(served.listener.address) + urllib.request.quote(path, safe="%/")
    assert status_of(address) == 403
    with pytest.raises(InvalidStatus, match="403"):
        talk(address.replace("http", "ws"))


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": f"https://{EVIL}"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:1"},
        {"Origin": "http://["},
        {"Host": EVIL},
        {"Host": f"127.0.0.1.{EVIL}:8080"},
        {"Host": f"{EVIL}:8080", "Origin": f"http://{EVIL}:8080"},
        {"Host": "["},
    ],
    ids=str,
)
def test_other_pages_and_other_names_are_refused(headers, served):
    """Even with the token: a page of another site, another port of this machine, and a name that
    was pointed here.
    """
    assert status_of(served.listener.address, **headers) == 403
    if "Host" in headers:
        return
    from websockets.exceptions import InvalidStatus

    with pytest.raises(InvalidStatus, match="403"):
        talk(served.listener.address.replace("http", "ws"), origin=headers["Origin"])


def test_a_refused_page_presses_no_button(served):
    """What a foreign page sends does not arrive; the same message from ours does."""
    from viser._messages import GuiUpdateMessage, ViewerCameraMessage
    from websockets.exceptions import InvalidStatus

    # a window's first one
    camera = ViewerCameraMessage(
        (1, 0, 0, 0), (0, 0, 0), 1.0, 0.1, 9.0, 48, 64, (0, 0, 1), (0, -1, 0)
    )
    url, press = (
        served.listener.address.replace("http", "ws"),
        GuiUpdateMessage(served.button._impl.uuid, {"value": True}),
    )
    with pytest.raises(InvalidStatus):
        talk(url, [camera, press], origin=f"https://{EVIL}")
    assert served.clicks == []
    talk(url, [camera, press])
    assert served.clicks == [1]


def test_no_message_opens_a_tunnel(served, monkeypatch, capsys):
    """The server has no way to be published, hidden or not."""
    from viser import _messages, _viser

    opened = []
    monkeypatch.setattr(_viser, "ViserTunnel", lambda *arguments: opened.append(arguments))
    talk(served.listener.address.replace("http", "ws"), [_messages.ShareUrlRequest()])
    assert opened == []
    assert "hare" not in capsys.readouterr().out


def test_a_forwarded_port_and_this_machines_names_are_let_in(served):
    """Through `ssh -L 9999:localhost:8080` the browser says localhost:9999."""
    for host in ("localhost:9999", "127.0.0.1", "[::1]:8080", "192.168.1.7:8080"):
        assert status_of(served.listener.address, Host=host, Origin=f"http://{host}") == 200


@pytest.mark.parametrize(
    ("host", "port", "reason"),
    [
        ("10.254.253.252", 8080, "assign"),
        ("127.0.0.1", 70000, "70000"),
        ("127.0.0.1", -5, "-5"),
        ("no.such.host.invalid", 0, "host"),
    ],
)
def test_an_impossible_address_ends_at_once(host, port, reason, capsys, tmp_path):
    """Before anything is read or computed, in one line that says what cannot be."""
    with pytest.raises(SystemExit) as ended:
        run_command(["view", str(tmp_path / "absent"), "--host", host, "--port", str(port)])
    (line,) = str(ended.value.code).splitlines()
    assert f"--host {host} --port {port}" in line
    assert reason in line
    assert capsys.readouterr() == ("", "")


def test_a_port_in_use_gives_the_next(served):
    """And the address says so."""
    listener = Listener(port=served.listener.port)
    assert served.listener.port < listener.port
    assert urlsplit(listener.address).port == listener.port
    listener.socket.close()


def test_an_address_for_all_can_be_opened():
    """What is printed for 0.0.0.0 is an address of this machine that answers."""
    listener = Listener("0.0.0.0", 0)
    parts = urlsplit(listener.address)
    assert parts.hostname not in ("0.0.0.0", "::")
    socket.create_connection((parts.hostname, parts.port), timeout=5).close()
    assert listener._is_own(f"{socket.gethostname()}:{listener.port}")
    listener.socket.close()


def test_a_server_that_would_not_ask_is_refused():
    """Where viser starts its server in some other way, nothing is served unguarded."""
    stopped, listener = [], Listener(port=0)
    with pytest.raises(CommandError, match="wanted a supported version of viser"):
        start_guarded(listener, lambda: SimpleNamespace(stop=lambda: stopped.append(1)))
    assert stopped == [1]
    listener.socket.close()
