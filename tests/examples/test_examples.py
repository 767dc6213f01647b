"""The examples: each is run by the command in its header, on the quick demo capture and little of
it.
"""

import re
import runpy
import shlex
import shutil
import subprocess
import sys
from dataclasses import replace

import pandas as pd
import pytest

from ggvs_eval.files.images import read_image
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.protocol import Frames, Synthesis, Views, load_protocol
from ggvs_eval.results import Results
from helpers.places import ROOT
from helpers.small_runs import leave_out_figures

EXAMPLES = ROOT / "examples"
LIVE_RIG, SCORE_FOLDER, SWEEP = (
    EXAMPLES / "live_rig.py",
    EXAMPLES / "score_folder.py",
    EXAMPLES / "sweep.toml",
)
pytestmark = [
    pytest.mark.skipif(not EXAMPLES.is_dir(), reason="no examples/ beside an installed wheel")
]


@pytest.fixture(scope="module")
def folder(quick_demo, tmp_path_factory):
    """A working folder as the headers want it: the quick demo, its protocol cut to two views and
    metrics.
    """
    folder = tmp_path_factory.mktemp("examples")
    shutil.copytree(quick_demo, folder / "quick")
    protocol = load_protocol(folder / "quick" / "quick.toml")
    measurement = replace(protocol.measurement, metrics=("PSNR", "SSIM"), ceilings=False)
    cut = replace(protocol, views=Views(("cam00", "cam03"), "test"), measurement=measurement)
    for renders in ("fixed", "late"):
        shutil.rmtree(folder / "quick" / renders / "cam07")
    (folder / "quick" / "quick.toml").write_text(cut.to_toml(), encoding="utf-8")
    small = replace(
        cut,
        views=Views(("cam03",), "test"),
        frames=Frames(1, 2),
        synthesis=Synthesis(2, width=120, height=90),
    )
    (folder / "small.toml").write_text(small.to_toml(), encoding="utf-8")
    return folder


def command_of(example, beginning):
    """The words of the command in an example's header, its own path the one of the checkout."""
    line = re.search(
        rf"^[# ]+{beginning} (.*?)(?:  #.*)?$", example.read_text(encoding="utf-8"), re.MULTILINE
    )[1]
    return [
        str(ROOT / word) if word.startswith("examples/") else word for word in shlex.split(line)
    ]


def ran(folder, example):
    """What a script prints, called in a process of its own."""
    done = subprocess.run(
        [sys.executable, *command_of(example, "python")],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_a_live_rig_gives_a_picture(folder):
    """A line for each picture, and the last one in a file."""
    assert len(ran(folder, LIVE_RIG).splitlines()) == 3
    assert read_image(folder / "view.png").shape == (240, 320, 3)


def test_the_page_shows_the_live_rig():
    """docs/live_rig.md has the script as it stands, but for its header."""
    code = LIVE_RIG.read_text(encoding="utf-8").split('"""\n\n', 1)[1]
    assert f"```python\n{code}```" in (ROOT / "docs" / "live_rig.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_folders_are_scored(folder, monkeypatch, capsys):
    """Both folders have their numbers and intervals, the late one its fault, and the page
    is there.
    """
    leave_out_figures(monkeypatch)
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "argv", command_of(SCORE_FOLDER, "python"))
    runpy.run_path(str(SCORE_FOLDER), run_name="__main__")
    out = capsys.readouterr().out
    values = {
        line.split()[1]: float(line.split()[2])
        for line in out.splitlines()
        if line.startswith("PSNR")
    }
    summary = (
        Results.read(folder / "out" / "scores").summary().droplevel(["dataset", "variant"])["PSNR"]
    )
    assert values == pytest.approx(summary.round(4).to_dict(), abs=1e-9)
    assert values["fixed"] > values["late"] + 2
    assert re.search(r"^SSIM +fixed +0\.\d+ \+- \d\S* +given this scene", out, re.MULTILINE), out
    assert "late shows every frame one instant late, so it is not ranked" in out
    assert (folder / out.splitlines()[-1]).is_file()


@pytest.mark.slow
def test_a_sweep_has_a_line_for_each_k_and_row(folder, monkeypatch):
    """One table of two methods at two K, every cell measured."""
    monkeypatch.chdir(folder)
    words = command_of(SWEEP, "ggvs-eval sweep")
    words[words.index("quick/quick.toml")] = "small.toml"
    run_command(["sweep", *words, "--jobs", "1"])
    table = pd.read_csv(folder / "out" / "sweep" / "sweep.csv")
    assert sorted(zip(table["variant"], table["method"], strict=True)) == [
        (f"k{k}", title)
        for k in (2, 3)
        for title in ("GGVS (online)", "GGVS (online), no temporal filtering")
    ]
    assert table["PSNR"].between(20, 50).all()
