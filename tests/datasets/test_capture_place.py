"""A run finds its capture again: from any folder, and where both moved together."""

import dataclasses
import shutil
from pathlib import Path

import pytest

from ggvs_eval.datasets import open_capture
from ggvs_eval.errors import CaptureError
from ggvs_eval.pipelines.run.evaluate import recorded_capture
from ggvs_eval.pipelines.run.prepare import prepare_truth
from ggvs_eval.protocol import CameraPath, Frames, Synthesis, Views, load_protocol
from ggvs_eval.run_folder import RunFolder, read_json, write_json


@pytest.fixture
def place(dynerf, monkeypatch):
    """A folder with a capture and a run, made with relative paths."""
    folder = dynerf.parent / "place"
    folder.mkdir()
    dynerf.rename(folder / "room")
    monkeypatch.chdir(folder)
    choice = {
        "views": Views(("cam00",), "test"),
        "frames": Frames(0, 1),
        "synthesis": Synthesis(2),
        "path": CameraPath(0),
    }
    prepare_truth(
        Path("runs/one"),
        open_capture(Path("room")),
        dataclasses.replace(load_protocol("demo"), **choice),
    )
    return folder


def test_a_run_goes_on_from_any_folder(place, tmp_path, monkeypatch):
    """A capture that was named relative to one folder is found from another, and is the same."""
    before = recorded_capture(RunFolder(Path("runs/one")))
    monkeypatch.chdir(tmp_path)

    after = recorded_capture(RunFolder(place / "runs" / "one"))

    assert [after.digest(name) for name in after.camera_names] == [
        before.digest(name) for name in before.camera_names
    ]
    assert after.scene == "room"
    assert read_json(place / "runs" / "one" / "capture.json")["path"] == "room"


def test_a_run_that_moved_with_its_capture_finds_it(place, tmp_path, monkeypatch):
    """Run and capture moved together still belong together; once the capture is gone, the message
    names where it was.
    """
    monkeypatch.chdir(tmp_path)
    place.rename(tmp_path / "elsewhere")
    run = RunFolder(tmp_path / "elsewhere" / "runs" / "one")
    assert recorded_capture(run).path == tmp_path / "elsewhere" / "room"
    shutil.rmtree(tmp_path / "elsewhere" / "room")
    with pytest.raises(CaptureError, match="room"):
        recorded_capture(run)


def test_a_run_of_an_earlier_version_is_read(place):
    """A record that knows only the path as it was given is still found from the folder where that
    path holds.
    """
    file = Path("runs/one/capture.json")
    write_json(file, {key: value for key, value in read_json(file).items() if key != "place"})
    assert recorded_capture(RunFolder(Path("runs/one"))).scene == "room"
