"""The command line where the terminal, the paths and the machine are not what a desk has."""

import builtins
import codecs
import os
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.errors import ProtocolError
from ggvs_eval.files.video import VideoFrames, write_video
from ggvs_eval.pipelines.commands.main import PLAIN, PLAIN_SIGNS, _plain
from ggvs_eval.protocol import load_protocol
from ggvs_eval.results import MOVING_NUMBERS, describe_machine, installed_versions
from helpers.refusals import refused
from helpers.small_runs import write_small_capture


@pytest.mark.slow
def test_tables_are_printed_in_ascii(tmp_path):
    """Where stdout knows ASCII alone, as under cron, rules are hyphens and the verb ends well."""
    capture = write_small_capture(tmp_path / "room", 2)
    words = ["protocol", str(capture.path), "mine.toml"]
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    ended = subprocess.run(
        [sys.executable, "-m", "ggvs_eval", *words],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
    )
    assert b"UnicodeEncodeError" not in ended.stderr
    assert b"-----" in ended.stdout
    assert ended.stdout.isascii()
    assert ended.returncode == 0


@pytest.mark.slow
def test_a_closed_output_is_no_fault(tmp_path):
    """Started with stdout closed, a verb writes its files and ends well."""
    write_small_capture(tmp_path / "room", 2)
    command = f"{shlex.quote(sys.executable)} -m ggvs_eval protocol room mine.toml >&-"
    ended = subprocess.run(["/bin/sh", "-c", command], cwd=tmp_path, capture_output=True)
    assert ended.returncode == 0, ended.stderr
    assert (tmp_path / "mine.toml").is_file()


def test_signs_have_plain_forms():
    """Rules and signs of tables become their nearest in ASCII, all else a question mark."""
    codecs.register_error(PLAIN, _plain)
    assert "─ 1.0 ± 0.1 × 2 – ä".encode("ascii", PLAIN) == b"- 1.0 ~ 0.1 x 2 - ?"
    assert all(sign > 127 for sign in PLAIN_SIGNS)


def test_a_colon_in_a_relative_path_is_no_protocol(tmp_path, monkeypatch):
    """A video below a folder such as ``data:v1`` is written and read."""
    monkeypatch.chdir(tmp_path)
    frames = np.zeros((3, 16, 16, 3), np.uint8)
    file = Path("data:v1") / "cam00.mp4"
    file.parent.mkdir()
    write_video(file, frames, 30.0)
    assert VideoFrames(file).n_frames == 3
    assert len(list(VideoFrames(file).frames(0, 3))) == 3


def test_a_cut_protocol_says_what_to_do(tmp_path):
    """A protocol of which the end is missing names the file, the place and the way out."""
    whole = load_protocol("demo").to_toml()
    (tmp_path / "protocol.toml").write_text(whole[: whole.index("[views]") + 12])
    with refused(ProtocolError, "protocol.toml: not valid TOML", "restore a complete copy"):
        load_protocol(tmp_path / "protocol.toml")


def test_versions_of_everything_that_measures_are_noted(monkeypatch):
    """Packages of metrics that are extras are noted where they are installed; the machine's
    description imports no torch.
    """
    assert {"flip-evaluator", "imageio-ffmpeg", "cvvdp"} <= set(MOVING_NUMBERS)
    assert set(installed_versions()) <= set(MOVING_NUMBERS)
    assert {"numpy", "torch", "flip-evaluator"} <= set(installed_versions())
    original = builtins.__import__

    def without_torch(name, *arguments, **keywords):
        if name == "torch":
            raise ImportError("libtorch_cpu.so: failed to map segment from shared object")
        return original(name, *arguments, **keywords)

    monkeypatch.setattr(builtins, "__import__", without_torch)
    assert {"processor", "NumPy", "OpenCV"} <= set(describe_machine())
