"""``make validate`` beside what ``make reports`` has left."""

from pathlib import Path
from typing import Any

import pytest

from ggvs_eval.capture import Capture
from ggvs_eval.contrib.worlds.demo import DEMO_ROOMS, MAIN, write_demo

validate = pytest.importorskip("benchmarks.validate", reason="benchmarks lie beside the package")
rooms = pytest.importorskip(
    "benchmarks.depth_validation.rooms", reason="benchmarks lie beside the package"
)


class Begun(Exception):
    """The demo capture has been taken; what follows is a run like any other."""


@pytest.mark.slow
def test_the_room_of_the_reports_is_validated(tmp_path, monkeypatch):
    """The capture that `make reports` has unpacked is taken as it is: another one in its place
    would be refused.
    """
    shipped = write_demo(tmp_path / "demo-capture", DEMO_ROOMS[MAIN])
    before = {file: file.stat().st_mtime_ns for file in shipped.rglob("*")}

    def begin(_run: Path, capture: Capture, *_: Any) -> None:
        assert capture.path == shipped
        raise Begun

    monkeypatch.setattr(validate, "evaluate", begin)
    with pytest.raises(Begun):
        validate.validate_demo(tmp_path / "demo")
    assert {file: file.stat().st_mtime_ns for file in shipped.rglob("*")} == before


def test_rooms_with_depth_lie_apart(tmp_path, monkeypatch):
    """Depth is validated on rooms of its own, as the one that ships has none."""
    written: dict[Path, Any] = {}
    monkeypatch.setattr(
        rooms, "write_demo", lambda folder, options: written.setdefault(folder, options) and folder
    )
    monkeypatch.setattr(rooms, "open_capture", lambda folder: folder)
    names = [room.name for room in rooms.film_rooms(tmp_path)]
    assert names == ["room 101", "room 102", "room 103", "demo"]
    assert tmp_path / "demo-capture" not in written
    assert all(options.depth_stride > 0 for options in written.values())
