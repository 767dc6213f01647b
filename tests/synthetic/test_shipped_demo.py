"""The rooms that ship are those that are filmed: unpacked in a moment, with the pictures that
anybody can film again.
"""

from functools import partial
from itertools import islice

import numpy as np
import pytest

from ggvs_eval.contrib.worlds.demo import DEMO_ROOMS, SHIPPED, film_demo, write_demo
from ggvs_eval.contrib.worlds.film.film import Footage, light_instant, stored_instant
from ggvs_eval.contrib.worlds.film.shots import rig_and_path_shots
from ggvs_eval.contrib.worlds.layouts.videos import dynerf_files
from ggvs_eval.datasets import open_capture
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.images import read_image
from ggvs_eval.synthetic import shipped
from ggvs_eval.synthetic.shipped import ROOMS, write_room
from helpers.packing import pack_room
from helpers.refusals import refused

# Of 255 levels: what x264 at crf 12 does to the noisiest picture.
CODED = 3.0


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    return write_room(tmp_path_factory.mktemp("shipped") / "demo")


@pytest.mark.slow
def test_it_is_a_whole_capture(demo):
    """All cameras and frames open, the path has its poses and images, and a second call leaves it
    alone.
    """
    capture = open_capture(demo)
    before = (demo / shipped.DEMO_NOTES).stat().st_mtime_ns

    assert (len(capture.cameras), capture.n_frames, capture.cameras[0].size) == (24, 24, (480, 360))
    assert all((demo / name).is_file() for name in dynerf_files(SHIPPED))
    assert len(sorted((demo / shipped.PATH_IMAGES).iterdir())) == SHIPPED.path_poses
    assert not (demo / shipped.PATH_VIDEO).exists()
    assert write_demo(demo, SHIPPED) == demo
    assert (demo / shipped.DEMO_NOTES).stat().st_mtime_ns == before


@pytest.mark.slow
def test_what_is_lost_is_said(demo, tmp_path):
    """A demo that has lost a camera is refused, like one that was filmed."""
    damaged = write_room(tmp_path / "demo")
    (damaged / "cam05.mp4").unlink()

    with refused(CaptureError, "cam05.mp4"):
        write_room(damaged)


@pytest.mark.slow
def test_another_room_is_refused(demo):
    """A folder that holds the main room is no place for another one."""
    with refused(CaptureError, "holds a demo of other options"):
        write_room(demo, "demo-d3dmv")


def content(folder):
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", [pytest.param(ROOMS[0], marks=pytest.mark.proof), *ROOMS[1:]])
def test_packing_what_was_unpacked_changes_nothing(name, tmp_path, monkeypatch):
    """A camera path and D3DMV's frames go through their videos without loss; what is unpacked is
    the whole room.
    """
    room = write_room(tmp_path / "room", name)
    assert write_demo(room, DEMO_ROOMS[name]) == room
    monkeypatch.setattr(shipped, "FOLDER", tmp_path)
    pack_room(name, room)

    assert content(write_room(tmp_path / "again", name)) == content(room)


@pytest.mark.proof  # lights two rooms and films 28 cameras, 80 s of a core
@pytest.mark.parametrize("name", ROOMS[1:])
def test_small_rooms_are_filmed_to_the_byte(name, tmp_path):
    """Every file of a small room that is unpacked is the one that is filmed."""
    filmed = film_demo(tmp_path / "filmed", DEMO_ROOMS[name])

    assert content(write_room(tmp_path / "unpacked", name)) == content(filmed)


@pytest.mark.proof  # lights the room
def test_it_is_what_is_filmed(demo, tmp_path):
    """The path's images to the bit; a camera's first frames but for what the code takes."""
    shots = rig_and_path_shots(SHIPPED)
    rows = len(SHIPPED.camera_names)
    for index in (0, 1, SHIPPED.path_frame):
        light_instant(tmp_path, SHIPPED, index)
    recall = partial(stored_instant, tmp_path, SHIPPED)
    filmed = [frame.image for frame in islice(Footage(SHIPPED, shots[3], recall).frames(), 2)]
    on_path = next(Footage(SHIPPED, shots[rows + 7], recall).frames()).image

    assert np.array_equal(on_path, read_image(demo / shipped.PATH_IMAGES / "0007.png"))
    for mine, coded in zip(filmed, open_capture(demo).frames("cam03", 0, 2), strict=True):
        assert np.abs(mine.astype(float) - coded).mean() < CODED
