"""Public captures by name, from a server on the loopback address: resumed, recorded, checked,
unpacked safely.
"""

import json
import zipfile
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread

import pytest

from ggvs_eval.datasets import open_capture, public_captures
from ggvs_eval.datasets.public_captures import (
    PublicDataset,
    find_scene,
    get_capture,
    public_datasets,
)
from ggvs_eval.errors import CaptureError, GgvsError
from ggvs_eval.files import download as downloads
from ggvs_eval.files.download import DownloadError
from ggvs_eval.files.images import write_image
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.protocol import load_protocol, packaged_protocols
from helpers.captures import make_image, make_rig, write_poses
from helpers.refusals import refused
from helpers.small_layouts import write_capture_toml


class Server(ThreadingHTTPServer):
    """Serves `content` under any path, whole or from a byte on; breaks off after `limit` bytes
    where one is set.
    """

    def __init__(self):
        super().__init__(("127.0.0.1", 0), Handler)
        self.content, self.limit, self.tag, self.asked = b"", None, '"one"', []

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_port}/{{archive}}.zip"


class Handler(BaseHTTPRequestHandler):
    """Answers of the server."""

    server: Server

    def do_GET(self):
        begun = 0
        if (wanted := self.headers.get("Range")) and self.headers.get(
            "If-Range"
        ) == self.server.tag:
            begun = int(wanted.removeprefix("bytes=").removesuffix("-"))
        self.server.asked.append((self.path, begun))
        rest = self.server.content[begun:]
        self.send_response(206 if begun else 200)
        self.send_header("Content-Length", str(len(rest)))
        self.send_header("ETag", self.server.tag)
        self.end_headers()
        self.wfile.write(rest[: self.server.limit])

    def log_message(self, *_):
        pass


@pytest.fixture
def server():
    with Server() as served:
        Thread(target=served.serve_forever, daemon=True).start()
        yield served
        served.shutdown()


@pytest.fixture
def dataset(server, tmp_path, monkeypatch) -> PublicDataset:
    """A data set of one scene, whose archive the server has."""
    rig = write_capture_toml(tmp_path / "juggling")
    with zipfile.ZipFile(tmp_path / "juggling.zip", "w") as packed:
        for file in sorted(rig.rglob("*")):
            packed.write(file, file.relative_to(tmp_path))
    server.content = (tmp_path / "juggling.zip").read_bytes()
    monkeypatch.setenv("GGVS_EVAL_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(downloads, "CHUNK_BYTES", 1000)
    own = PublicDataset(
        "own", "Juggling (1994)", "CC0", "https://example.org", server.url, ("juggling",)
    )
    monkeypatch.setattr(public_captures, "public_datasets", lambda: {"own": own})
    return own


def test_a_capture_is_fetched_once_and_opens_by_its_name(dataset, server, tmp_path, capsys):
    """The licence is shown first; the second call asks nobody; `open_capture` takes the name."""
    with pytest.raises(CaptureError, match="ggvs-eval get own:juggling"):
        open_capture("own:juggling")
    run_command(["get", "own:juggling"])
    told = capsys.readouterr()
    assert "CC0" in told.err
    assert told.out.strip() == str(tmp_path / "cache" / "captures" / "own" / "juggling")

    run_command(["get", "own:juggling"])
    assert server.asked == [("/juggling.zip", 0)]
    capture = open_capture("own:juggling")
    assert capture.scene == "juggling"
    assert capture.frame(capture.camera_names[0], 0).any()
    record = json.loads((dataset.folder() / "juggling.json").read_text())
    assert record["n_bytes"] == len(server.content)
    assert not (dataset.folder() / "juggling.zip").exists()


@pytest.mark.parametrize("changed", [False, True])
def test_a_stopped_download_goes_on(dataset, server, tmp_path, changed):
    """From the byte where it stopped; from the first one where the server has another file
    meanwhile.
    """
    server.limit = 2500
    with pytest.raises(DownloadError, match="run the same command to resume"):
        get_capture("own:juggling")
    assert (dataset.folder() / "juggling.zip.part").stat().st_size == 2500
    server.limit = None
    if changed:
        server.tag = '"two"'
    get_capture("own:juggling")
    assert server.asked == [("/juggling.zip", 0), ("/juggling.zip", 0 if changed else 2500)]
    assert open_capture("own:juggling").scene == "juggling"
    assert not list(dataset.folder().glob("*.part")) + list(dataset.folder().glob("*.tag"))


def test_another_file_than_at_the_first_time_is_refused(dataset, server):
    """Names both sizes and what to delete; an archive put there by hand is judged alike."""
    place = get_capture("own:juggling")
    place.rename(place.with_name("moved"))
    (dataset.folder() / "juggling.zip").write_bytes(server.content + b"!")
    with refused(DownloadError, f"{len(server.content)} bytes", f"got {len(server.content) + 1}"):
        get_capture("own:juggling")
    (dataset.folder() / "juggling.zip").write_bytes(server.content)
    assert get_capture("own:juggling") == place
    assert len(server.asked) == 1


def test_without_a_network_one_line_says_what_to_fetch_and_where_to_put_it(dataset, server):
    """Address, reason and place."""
    server.shutdown()
    server.server_close()
    with pytest.raises(DownloadError) as caught:
        get_capture("own:juggling")
    message = str(caught.value)
    assert server.url.format(archive="juggling") in message
    assert f"save it as {dataset.folder() / 'juggling.zip'}" in message
    assert "\n" not in message


def test_what_is_fetched_by_hand_opens_by_its_name_where_it_was_put(tmp_path, monkeypatch, capsys):
    """`get llff` and `get llff:fern` name archive, files and place; a scene put there is a capture
    with the protocol's views.
    """
    monkeypatch.setenv("GGVS_EVAL_CACHE", str(tmp_path))
    place = tmp_path / "captures" / "llff" / "fern"
    for asked, where in (("llff", place.with_name("SCENE")), ("llff:fern", place)):
        with pytest.raises(GgvsError, match=r"nerf_llff_data\.zip") as caught:
            get_capture(asked)
        assert all(
            word in str(caught.value)
            for word in ("poses_bounds.npy and images_4", f"to {where} (http")
        )
    names = [f"image{number:03d}" for number in range(20)]
    write_poses(place, make_rig(names))
    for name in names:
        write_image(place / "images_4" / f"{name}.png", make_image(0, 0))
    run_command(["get", "llff:fern"])
    printed = capsys.readouterr()
    assert all(word in printed.err for word in ("1.8 GB", "none stated", "llff_sparse3_fern, "))
    assert printed.out.strip() == str(place)
    assert set(load_protocol("llff_3view_fern").views.test) < set(
        open_capture("llff:fern").camera_names
    )


@pytest.mark.parametrize(
    ("name", "scene"),
    [(name, scene) for name, dataset in public_datasets().items() for scene in dataset.scenes],
)
def test_every_scene_has_size_terms_and_protocols(name, scene):
    """What is said before anything is fetched; the protocols are packaged, and what names sources
    has them for this scene.
    """
    dataset = public_datasets()[name]
    protocols = dataset.terms(scene).partition("--protocol: ")[2].split(", ")
    assert set(protocols) <= set(packaged_protocols())
    assert dataset.size in dataset.terms(scene)
    for protocol in map(load_protocol, protocols):
        assert protocol.views.sources_of(scene) or not protocol.views.of_scenes


def test_an_archive_that_leads_outside_leaves_nothing(dataset, server, tmp_path):
    """Unpacked as renders are."""
    with zipfile.ZipFile(tmp_path / "evil.zip", "w") as packed:
        packed.writestr("../outside.txt", "x")
    server.content = (tmp_path / "evil.zip").read_bytes()
    with pytest.raises(CaptureError, match="leads outside"):
        get_capture("own:juggling")
    assert not (dataset.folder() / "juggling").exists()
    assert not list(tmp_path.rglob("outside.txt"))


def test_an_answer_that_is_not_secure_is_refused():
    """A redirection from https to http, or http to anywhere but this machine."""
    check = downloads._require_secure
    check("https://example.org/a", "https://cdn.example.org/a")
    check("http://127.0.0.1:8000/a", "http://127.0.0.1:8000/a")
    for asked, answered in (
        ("https://example.org/a", "http://127.0.0.1/a"),
        ("http://example.org/a", "http://example.org/a"),
    ):
        with pytest.raises(ValueError, match="not secure"):
            check(asked, answered)


def test_names_that_there_are_not_are_met_by_those_that_there_are():
    """Of data sets and of scenes; scenes of several parts say how they are joined; a path with a
    colon stays a path.
    """
    with pytest.raises(CaptureError, match="n3v, immersive, panoptic"):
        find_scene("n4v:flame_steak")
    with pytest.raises(CaptureError, match="flame_steak"):
        find_scene("n3v:flame_stake")
    with pytest.raises(DownloadError, match="four parts"):
        get_capture("n3v:flame_salmon_1")
    assert {name: len(each.scenes) for name, each in public_datasets().items()} == {
        "n3v": 6,
        "immersive": 15,
        "panoptic": 6,
        "llff": 8,
    }
    with pytest.raises(CaptureError, match="got no such path"):
        open_capture("C:captures")
