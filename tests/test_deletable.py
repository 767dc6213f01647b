"""Each package of contrib can be deleted: the rest starts, scores, and says in one line what is not there."""

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import ggvs_eval
import ggvs_eval.contrib
from ggvs_eval.jobs.code_identity import ROOMS_APART

CONTRIB = Path(str(ggvs_eval.contrib.__file__)).parent
PACKAGES = sorted(file.parent.name for file in CONTRIB.glob("*/__init__.py"))
# What asks for something of a package, and how the line begins.
ASKED = {
    "cluster": ("run OUT --capture ROOM --protocol QUICK --methods no-blending --engine dask", "dask is part of"),
    "export": ("export splats out.glb", "export is part of"),
    "more_baselines": ("run OUT --capture ROOM --protocol QUICK --methods mvsplat", "mvsplat is part of"),
    "more_metrics": ("explain OUT vmaf 90", "vmaf is part of"),
    "study": ("metric-study OUT", "metric-study is part of"),
    "explain": ("explain OUT psnr 30", "explain is part of"),
    "view": ("view ROOM", "view is part of"),
    "training": ("train blend OUT", "train is part of"),
    "what_if": ("what-if MINE --capture ROOM", "what-if is part of"),
    "worlds": ("demo OUT --seed 3", "film is part of"),
}
# In a checkout an editable install would find again what was taken away.
STARTED = """
import runpy, sys
sys.meta_path[:] = [finder for finder in sys.meta_path if not getattr(finder, "__module__", "").startswith("__editable__")]
"""
COMMAND = "runpy.run_module('ggvs_eval', run_name='__main__')"
SCORES = """
import numpy as np
from ggvs_eval.metrics import score_view
frame = np.zeros((48, 64, 3), np.uint8)
scores = score_view([(frame, frame)], ("PSNR", "FLIP", "L1"))
print(sorted({name for name, _, _ in scores.values}), scores.not_computed.get("FLIP", ""))
import ggvs_eval.pipelines.run.evaluate, ggvs_eval.pipelines.commands.runs, ggvs_eval.pipelines.methods.registry
print(len(ggvs_eval.pipelines.methods.registry.METHODS))
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> Path:
    """The installed package in one folder, linked but for contrib, which is copied."""
    root = tmp_path_factory.mktemp("site") / "ggvs_eval"
    root.mkdir()
    for entry in Path(str(ggvs_eval.__file__)).parent.iterdir():
        if entry.name not in (*ROOMS_APART, "__pycache__"):
            (root / entry.name).symlink_to(entry)
    for room in ROOMS_APART:
        spec = importlib.util.find_spec(f"ggvs_eval.{room}")
        assert spec is not None
        folder = Path(str(spec.origin)).parent
        if room == "contrib":
            shutil.copytree(folder, root / room, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            (root / room).symlink_to(folder)
    return root


@pytest.fixture(params=[*PACKAGES, "all of it"])
def without(request, installed):
    """The package without one part of contrib; its name, and what calls Python there."""
    gone = installed / "contrib" if request.param == "all of it" else installed / "contrib" / request.param
    kept = gone.rename(installed.parent / "kept")
    environment = os.environ | {"PYTHONPATH": str(installed.parent), "PYTHONSAFEPATH": "1"}

    def called(code: str, *words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-c", STARTED + code, *words],
            capture_output=True,
            text=True,
            env=environment,
            check=False,
            cwd=installed.parent,
        )

    yield request.param, called
    kept.rename(gone)


@pytest.mark.slow
def test_the_rest_starts_and_scores(without):
    """Help, a score and a plan of the demo; a metric that is not there says so and the others are measured."""
    name, called = without
    overview = called(COMMAND, "--help")
    assert overview.returncode == 0, overview.stderr
    assert ("export" in overview.stdout.split()) == (name not in ("export", "all of it"))
    scored = called(SCORES)
    assert scored.returncode == 0, scored.stderr
    assert "'L1', 'PSNR'" in scored.stdout
    is_gone = name in ("more_metrics", "all of it")
    assert ("FLIP is part of ggvs_eval.contrib" in scored.stdout) == is_gone

    if name in ("worlds", "all of it"):
        planned = called(COMMAND, "run", "OUT", "--dry-run")
        assert planned.stdout.count("plan: ") == 4, planned.stderr


@pytest.mark.slow
def test_what_is_asked_for_is_one_line(without):
    """Exit code 1, the package, and what to do."""
    name, called = without
    for package in ASKED if name == "all of it" else [name] if name in ASKED else []:
        words, begins = ASKED[package]
        if (name, package) == ("all of it", "more_metrics"):
            begins = ASKED["explain"][1]  # which asks for it
        quick = str(Path(str(ggvs_eval.__file__)).parent / "protocols" / "demo.toml")
        asked = called(COMMAND, *words.replace("QUICK", quick).split())
        assert asked.returncode == 1, asked.stderr
        (line,) = asked.stderr.strip().splitlines()
        assert line.startswith(f"ggvs-eval: {begins} ggvs_eval.contrib"), line
        assert line.endswith("which is not installed; reinstall ggvs-eval or omit it")
        if package == "worlds":  # and what builds on it
            asked = called(COMMAND, "train", "stereo", "OUT")
            begins = "train: wanted" if name == "worlds" else "train is part of"
            assert asked.stderr.startswith(f"ggvs-eval: {begins} ggvs_eval.contrib"), asked.stderr
