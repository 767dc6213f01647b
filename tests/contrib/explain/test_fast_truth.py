"""A number measured against the truth as OpenCV decodes it is explained as that, through the
command line.
"""

import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from ggvs_eval.files.images import read_image
from ggvs_eval.pipelines.run.decoding import fast_truth
from ggvs_eval.protocol import Frames, Views, load_protocol
from ggvs_eval.run_folder import RunFolder, frame_path, read_json
from helpers.command_line import run_command

VIEW, FRAMES = "cam03", range(1, 4)


@pytest.fixture(scope="module")
def scored(quick_demo, tmp_path_factory) -> Path:
    """A scored run of three frames of one view of the quick demo, which is captured as video."""
    folder = tmp_path_factory.mktemp("fast")
    shutil.copytree(quick_demo, folder / "quick")
    protocol = load_protocol(folder / "quick" / "quick.toml")
    measurement = replace(protocol.measurement, metrics=("PSNR",), ceilings=False)
    frames = Frames(FRAMES.start, len(FRAMES))
    short = replace(protocol, views=Views((VIEW,), "test"), frames=frames, measurement=measurement)
    (folder / "short.toml").write_text(short.to_toml(), encoding="utf-8")
    renders = folder / "renders" / VIEW
    renders.mkdir(parents=True)
    for index, file in enumerate(sorted((folder / "quick" / "fixed" / VIEW).iterdir())):
        if index + 1 in FRAMES:
            shutil.copy(file, renders)
    place = ("--capture", folder / "quick" / "room", "--protocol", folder / "short.toml")
    run = folder / "run"
    words = ("score", "--renders", f"base={renders.parent}", *place, "--run", run, "--jobs", "1")
    run_command([*map(str, words)])
    return folder


def opencv_frames(video: Path) -> dict[int, np.ndarray]:
    """Frames of `FRAMES` as a student's script reads them."""
    stream = cv2.VideoCapture(str(video))
    images = [stream.read()[1][..., ::-1] for _ in range(FRAMES.stop)]
    return {index: images[index] for index in FRAMES}


@pytest.mark.slow
def test_psnr_against_opencvs_frames_is_explained(scored, capsys):
    """Frames of the fast conversion are OpenCV's to the last bit, and `explain` names them."""
    run = RunFolder(scored / "run")
    decoded = opencv_frames(scored / "quick" / "room" / f"{VIEW}.mp4")
    fast = fast_truth(run)[VIEW]
    psnrs_db = []
    for index in FRAMES:
        np.testing.assert_array_equal(fast(index), decoded[index])
        rendered = read_image(frame_path(run.renders("base", VIEW), index))
        squared_error = np.square(rendered.astype(float) - decoded[index]).mean()
        psnrs_db.append(10 * np.log10(255**2 / squared_error))

    run_command(["explain", str(run.root), "psnr", f"{np.mean(psnrs_db):.4f}"])

    sentence = " ".join(capsys.readouterr().out.split())
    assert "is as this tool, truth decoded by OpenCV, imageio or plain ffmpeg" in sentence
    assert "OpenCV" in read_json(run.root / "capture.json")["truth_decoding"]
