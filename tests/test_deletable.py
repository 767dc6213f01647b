"""Each package of contrib can be deleted: the rest starts, scores, and says in one line what is not
there.
"""

import importlib.util
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import ggvs_eval
import ggvs_eval.contrib
from ggvs_eval.tasks.identity import TOP_ROOMS
from helpers.deleted_parts import RUN_COMMANDS

CONTRIB = Path(str(ggvs_eval.contrib.__file__)).parent
PACKAGES = sorted(file.parent.name for file in CONTRIB.glob("*/__init__.py"))
# Parts that others build on are taken away while these are there, see
# test_parts_of_contrib_know_no_other.
GONE = [
    ["worlds", "explain", "cluster", "given_depth"],
    ["more_baselines", "export", "study", "view", "what_if", "warp"],
    ["more_metrics", "training"],
    PACKAGES,
]
# What asks for something of a package, and how the line begins.
ASKED = {
    "cluster": (
        "run OUT --capture ROOM --protocol demo --methods no-blending --engine dask",
        "dask is part of",
    ),
    "export": ("export splats out.glb", "export is part of"),
    "more_baselines": (
        "run OUT --capture ROOM --protocol demo --methods mvsplat",
        "mvsplat is part of",
    ),
    "more_metrics": ("explain OUT vmaf 90", "vmaf is part of"),
    "study": ("metric-study OUT", "metric-study is part of"),
    "explain": ("explain OUT psnr 30", "explain is part of"),
    "view": ("view ROOM", "view is part of"),
    "training": ("train blend OUT", "train is part of"),
    "what_if": ("what-if MINE --capture ROOM", "what-if is part of"),
    "worlds": ("film OUT --seed 3", "film is part of"),
}
DONE = f"""
{RUN_COMMANDS}
import numpy as np
from ggvs_eval.metrics import score_view
frame = np.zeros((48, 64, 3), np.uint8)
scores = score_view([(frame, frame)], ("PSNR", "FLIP", "L1"))
done = {{"scores": sorted({{name for name, _, _ in scores.values}}), "not computed": scores.not_computed}}
print(json.dumps(done | run_commands(json.loads(sys.argv[1]))))
"""  # noqa: E501


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> Path:
    """The installed package in one folder, linked but for contrib, which is copied."""
    root = tmp_path_factory.mktemp("site") / "ggvs_eval"
    root.mkdir()
    for entry in Path(str(ggvs_eval.__file__)).parent.iterdir():
        if entry.name not in (*TOP_ROOMS, "__pycache__"):
            (root / entry.name).symlink_to(entry)
    for room in TOP_ROOMS:
        spec = importlib.util.find_spec(f"ggvs_eval.{room}")
        assert spec is not None
        folder = Path(str(spec.origin)).parent
        if room == "contrib":
            shutil.copytree(folder, root / room, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            (root / room).symlink_to(folder)
    return root


@pytest.mark.slow
@pytest.mark.parametrize(
    "gone", GONE, ids=lambda gone: gone[0] if len(gone) < len(PACKAGES) else "all of it"
)
def test_the_rest_starts_and_scores(gone, installed, tmp_path):
    """What remains has its help and scores, and a demo unpacks; what is asked for and gone is one
    line that names it.
    """
    wanted = {ASKED[name][0]: ASKED[name][1] for name in gone if name in ASKED}
    if "worlds" in gone:
        wanted["train stereo OUT"] = "train is part of" if "training" in gone else "train: wanted"
    if {"explain", "more_metrics"} <= {*gone}:
        wanted["explain OUT vmaf 90"] = "explain is part of"
    for name in gone:
        (installed / "contrib" / name).rename(tmp_path / name)
    environment = os.environ | {"PYTHONPATH": str(installed.parent), "PYTHONSAFEPATH": "1"}
    commands = json.dumps(["--help", *wanted, f"demo --quick {tmp_path / 'quick'}"])
    ended = subprocess.run(
        [sys.executable, "-c", DONE, commands],
        capture_output=True,
        text=True,
        env=environment,
        check=False,
        cwd=tmp_path,
    )
    for name in gone:
        (tmp_path / name).rename(installed / "contrib" / name)

    assert ended.returncode == 0, ended.stderr
    done = json.loads(ended.stdout)
    assert done["scores"] == (["L1", "PSNR"] if "more_metrics" in gone else ["FLIP", "L1", "PSNR"])
    assert ("FLIP is part of ggvs_eval.contrib" in done["not computed"].get("FLIP", "")) == (
        "more_metrics" in gone
    )
    help_code, overview = done["--help"]
    assert not help_code
    assert ("export" in overview.split()) == ("export" not in gone)
    assert done[f"demo --quick {tmp_path / 'quick'}"][0] == 0
    for command, begins in wanted.items():
        line = done[command][0]
        assert line.startswith(f"ggvs-eval: {begins} ggvs_eval.contrib"), line
        assert "; reinstall ggvs-eval" in line
        assert "\n" not in line
