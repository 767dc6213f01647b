"""Depth from elsewhere: maps of each kind are read, aligned with the calibration, and rendered
from; wrong ones show.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from ggvs_eval.capture import GivenDepth
from ggvs_eval.contrib.given_depth.attach import attach_depth
from ggvs_eval.contrib.given_depth.depth_files import find_maps, read_map, z_per_distance
from ggvs_eval.contrib.worlds.film.film import read_exact_depth
from ggvs_eval.datasets import open_capture
from ggvs_eval.errors import CaptureError
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.pipelines.offline.export.dense_workspace import write_array
from ggvs_eval.results import Results
from helpers.packed_films import unpack_film
from helpers.refusals import refused

pytestmark = pytest.mark.usefixtures("no_figures")
FRAMES = 2


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """A small room, and the exact z of every camera and frame."""
    return open_capture(unpack_film("deep", tmp_path_factory.mktemp("room") / "demo"))


@pytest.fixture(scope="module")
def exact(room):
    """Camera -> its exact depth, (T, H, W), as `film` writes it beside the capture."""
    depth = {
        name: np.stack(
            [read_exact_depth(room.path, name, frame).astype(np.float32) for frame in range(FRAMES)]
        )
        for name in room.camera_names
    }
    return depth


def written(folder, exact, factor=1.0, change=lambda camera, values: values, room=None):
    """A folder of stacks, ``CAM.npy``."""
    folder.mkdir()
    for name, values in exact.items():
        np.save(folder / f"{name}.npy", change(room and room.camera(name), values) * factor)
    return folder


def notes_of(room, folder, **given):
    return attach_depth(room, GivenDepth(str(folder), **given)).notes[len(room.notes) :]


def test_a_factor_is_fitted_to_shared_points(room, exact, tmp_path):
    """Maps that are true up to a factor of 3.7 come back in world units, within half a percent of
    the exact depth.
    """
    capture = attach_depth(room, GivenDepth(str(written(tmp_path / "d", exact, 3.7))))
    for name in room.camera_names[:2]:
        depth = next(capture.extras_of(name).depth.depths(1, 2))
        known = exact[name][1] > 0
        assert np.median(np.abs(depth[known] / exact[name][1][known] - 1)) < 0.005
    assert "0.27" in capture.notes[-1]


def test_a_planted_error_of_scale_shows(room, exact, tmp_path):
    """Numbers that are 2 % too large, taken as they are, are said to be 2 % off."""
    (note,) = notes_of(room, written(tmp_path / "d", exact, 1.02), scale=1.0)
    told = float(note.rpartition(", ")[2].removesuffix(" %"))
    assert told == pytest.approx(2.0, abs=0.5)
    (note,) = notes_of(room, written(tmp_path / "e", exact), scale=1.0)
    assert abs(float(note.rpartition(", ")[2].removesuffix(" %"))) < 0.5


@pytest.mark.slow
def test_more_maps_than_frames_are_said(room, exact, tmp_path):
    """Which maps are used is named where there are more than frames; equal numbers need no word."""
    longer = {name: np.concatenate([values, values]) for name, values in exact.items()}
    assert any(
        f"{2 * FRAMES} depth maps" in note and "first ones" in note
        for note in notes_of(room, written(tmp_path / "l", longer))
    )
    assert not any("first ones" in note for note in notes_of(room, written(tmp_path / "d", exact)))


def test_lengths_of_rays_are_told_from_z(room, exact, tmp_path):
    """Distances taken for z are named with the option that mends it, which gives exact z; z is not
    suspected.
    """

    def as_distance(camera, values):
        return values / z_per_distance(camera, values.shape[1:])

    folder = written(tmp_path / "d", exact, 1.0, as_distance, room)
    assert any("--depth-is distance" in note for note in notes_of(room, folder))
    right = attach_depth(room, GivenDepth(str(folder), is_distance=True))
    assert not any("try --depth-is" in note for note in right.notes)
    name = room.camera_names[0]
    known = exact[name][0] > 0
    assert (
        np.median(
            np.abs(
                next(right.extras_of(name).depth.depths(0, 1))[known] / exact[name][0][known] - 1
            )
        )
        < 0.005
    )
    assert not any(
        "try --depth-is" in note for note in notes_of(room, written(tmp_path / "z", exact))
    )


@pytest.mark.parametrize("kind", ["npy", "npz", "png", "pfm", "exr", "bin", "geometric.bin"])
def test_every_kind_is_read(room, exact, tmp_path, kind):
    """One file per frame or camera; numbers come back, of 16-bit steps within half a step."""
    name = room.camera_names[0]
    for each in room.camera_names:
        (tmp_path / each).mkdir()
        for frame, values in enumerate(exact[each]):
            file = tmp_path / each / f"{frame:04d}.{kind}"
            if kind == "npy":
                np.save(file, values)
            elif kind == "npz":
                np.savez(file, depth=values, other=np.zeros(3))
            elif kind.endswith("bin"):
                write_array(file, values)
            else:
                monitor = (values * 1000).round().astype(np.uint16) if kind == "png" else values
                try:
                    assert cv2.imwrite(str(file), monitor)
                except cv2.error:
                    pytest.skip("this OpenCV writes no EXR")
    maps = find_maps(tmp_path, room.camera_names)[name]
    assert [file.stem.partition(".")[0] for file in maps] == ["0000", "0001"]
    scale = 0.001 if kind == "png" else 1.0
    assert np.allclose(
        read_map(maps[1]) * scale, exact[name][1], atol=0.0006 if kind == "png" else 1e-5
    )


def test_what_cannot_be_used_is_refused(room, exact, tmp_path):
    """No folder, names of no camera, too few frames, a text, two kinds at once: each is one line
    that says what to do.
    """
    with refused(CaptureError, "check --depth"):
        notes_of(room, tmp_path / "none")
    (tmp_path / "other").mkdir()
    np.save(tmp_path / "other" / "left.npy", exact[room.camera_names[0]])
    with refused(CaptureError, "name files after the cameras", "left.npy"):
        notes_of(room, tmp_path / "other")
    short = written(tmp_path / "short", {name: values[:1] for name, values in exact.items()})
    with refused(CaptureError, "one per frame, got 1"):
        notes_of(room, short)
    both = written(tmp_path / "both", exact)
    np.savez(both / f"{room.camera_names[0]}.npz", exact[room.camera_names[0]])
    with refused(CaptureError, "one kind of depth maps"):
        notes_of(room, both)
    text = written(tmp_path / "text", exact)
    (text / f"{room.camera_names[0]}.npy").write_text("z = 3")
    with refused(CaptureError, "wanted a depth map"):
        notes_of(room, text)


@pytest.mark.slow
def test_a_run_renders_from_it_and_is_resumed(room, exact, tmp_path, capsys):
    """With exact depth a run is better than by stereo, its folder knows where the depth is, and a
    later verb uses it again.
    """
    folder = written(tmp_path / "d", exact, 2.0)
    protocol = tmp_path / "p.toml"
    protocol.write_text(
        f'[views]\ntest = ["{room.camera_names[1]}"]\n[measurement]\nmetrics = '
        f'["PSNR"]\n[path]\nposes = 0\n'
    )
    words = [
        "--capture",
        str(room.path),
        "--protocol",
        str(protocol),
        "--methods",
        "ours-geometric",
        "--jobs",
        "1",
    ]
    run_command(["run", str(tmp_path / "given"), *words, "--depth", str(folder)])
    assert "factor of 0.5" in capsys.readouterr().err
    run_command(["run", str(tmp_path / "stereo"), *words])
    psnr = {
        run: Results.read(tmp_path / run).summary()["PSNR"].item() for run in ("given", "stereo")
    }
    assert psnr["given"] > psnr["stereo"] + 0.2
    before = {folder.name for folder in (tmp_path / "given" / "depth").iterdir()}
    run_command(["render", str(tmp_path / "given"), "--methods", "distance-based", "--jobs", "1"])
    assert {folder.name for folder in (tmp_path / "given" / "depth").iterdir()} == before
    record = (tmp_path / "given" / "capture.json").read_text()
    assert str(folder) in record


def test_depth_of_some_cameras_alone_is_said(room, exact, tmp_path):
    """Cameras without maps keep theirs by stereo, and are named."""
    some = written(tmp_path / "d", dict(list(exact.items())[:3]))
    capture = attach_depth(room, GivenDepth(str(some)))
    assert capture.sensed_cameras == set(room.camera_names[:3])
    assert room.camera_names[3] in capture.notes[-1]
    assert replace(capture, given_depth=None).given_depth is None
