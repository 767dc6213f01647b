"""``ggvs-eval export``: others' clouds, sequences, 4DGS output as one .glb, and
``splats:FILE.glb``, which reads it.
"""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
import torch

from ggvs_eval.baselines.fitted.hexplane import PUBLISHED, DeformationNetwork
from ggvs_eval.camera import up_direction
from ggvs_eval.capture import Capture
from ggvs_eval.contrib.export.gltf_reading import glb_frames
from ggvs_eval.datasets import open_capture
from ggvs_eval.gaussians import write_ply
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.pipelines.methods.splats import named_splats, open_splats, splats_notes
from helpers.gaussian_clouds import random_cloud
from helpers.small_layouts import write_capture_toml


@pytest.fixture(scope="module")
def capture(tmp_path_factory) -> Capture:
    return open_capture(write_capture_toml(tmp_path_factory.mktemp("rig")))


@pytest.fixture
def folder(tmp_path) -> Path:
    """Clouds of frames 1, 2 and 4."""
    for frame in (1, 2, 4):
        write_ply(
            tmp_path / "clouds" / f"room_{frame:03d}.ply",
            random_cloud(30, seed=frame, dtype=torch.float32),
        )
    return tmp_path / "clouds"


def document(file: Path) -> dict:
    content = file.read_bytes()
    return json.loads(content[20 : 20 + struct.unpack_from("<I", content, 12)[0]])


def refusal(*words) -> str:
    """The one line with which a call ends."""
    with pytest.raises(SystemExit) as ended:
        run_command(["export", *map(str, words)])
    message = str(ended.value)
    assert "\n" not in message
    return message


def test_a_sequence_is_rendered_from_its_one_file(folder, capture, tmp_path, capsys):
    """Frames keep their numbers; frames per second and what is up are those of the capture; it may
    be written once more.
    """
    out, again = tmp_path / "new" / "sequence.glb", tmp_path / "again.glb"
    run_command(["export", str(folder), str(out), "--capture", str(capture.path)])
    assert f"{out}: 3 instants at {capture.fps:g} frames per second" in capsys.readouterr().out
    run_command(["export", str(out), str(again), "--frames", "2", "--degree", "1"])

    assert list(glb_frames(out)) == [1, 2, 4]
    assert list(glb_frames(again)) == [1, 2]
    files, one, flat = open_splats(folder), open_splats(out), open_splats(again)
    for frame in (4, 1, 2):
        expected = files.render(frame, capture.cameras[0])
        np.testing.assert_allclose(
            one.render(frame, capture.cameras[0]).image, expected.image, atol=3e-6
        )
    assert expected.image.max() > 0.1
    assert flat.cloud(2).degree == 1
    x, y, z, w = document(out)["nodes"][0]["rotation"]
    turn, up = np.array([x, y, z]), up_direction(capture.cameras)
    np.testing.assert_allclose(
        up + 2 * np.cross(turn, np.cross(turn, up) + w * up), (0, 1, 0), atol=1e-9
    )
    assert "rotation" not in document(again)["nodes"][0]
    assert splats_notes(out) == []
    assert named_splats([f"splats:{out}"])[0] == ("splats-sequence",)


def test_one_cloud_is_no_animation(folder, tmp_path, capsys):
    run_command(
        ["export", str(folder / "room_002.ply"), str(tmp_path / "one.glb"), "--up", "0", "-1", "0"]
    )

    assert "one instant" in capsys.readouterr().out
    assert "animations" not in document(tmp_path / "one.glb")
    assert document(tmp_path / "one.glb")["nodes"][0]["rotation"] == [1, 0, 0, 0]
    torch.testing.assert_close(
        open_splats(tmp_path / "one.glb").cloud(7).means,
        random_cloud(30, seed=2, dtype=torch.float32).means,
    )


def test_output_of_4dgs_moves_through_its_clip(capture, tmp_path):
    """Its length is that of the capture, without which nothing is written."""
    place = tmp_path / "output" / "point_cloud" / "iteration_14000"
    write_ply(place / "point_cloud.ply", random_cloud(30, dtype=torch.float32))
    field = DeformationNetwork(torch.tensor([[2.0, 2, 6], [-2, -2, 0]]), PUBLISHED)
    torch.save(field.state_dict(), place / "deformation.pth")
    out = tmp_path / "moving.glb"

    assert "--capture" in refusal(tmp_path / "output", out)
    run_command(["export", str(tmp_path / "output"), str(out), "--capture", str(capture.path)])
    published, written = open_splats(tmp_path / "output", range(capture.n_frames)), open_splats(out)
    assert list(written.instants) == list(range(capture.n_frames))
    last = capture.n_frames - 1
    torch.testing.assert_close(
        written.cloud(last).means, published.cloud(last).means.detach(), rtol=0, atol=0
    )


def test_what_is_no_call(folder, tmp_path):
    """Another ending, no speed, no frame, nothing there: one line, and no file."""
    assert "cloud.glb" in refusal(folder, tmp_path / "cloud.ply")
    assert "--fps" in refusal(folder, tmp_path / "out.glb", "--fps", "0")
    assert "--frames" in refusal(folder, tmp_path / "out.glb", "--frames", "0")
    assert "got no such path" in refusal(tmp_path / "absent", tmp_path / "out.glb")
    assert [path.name for path in tmp_path.iterdir()] == ["clouds"]
