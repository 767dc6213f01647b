"""Plug-ins: packages and files with metrics, methods and layouts of their own run as ours do, and
broken ones are one line.
"""

import json
import os
import re
import subprocess
import sys
import sysconfig
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval import plugins
from ggvs_eval.errors import PluginError
from ggvs_eval.files.images import read_image
from ggvs_eval.files.video import write_video
from ggvs_eval.metrics.registry import METRICS
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.pipelines.methods.registry import METHODS, find_method
from ggvs_eval.plugins import FILES, Registry, use_file
from ggvs_eval.results import Results
from ggvs_eval.run_folder import RunFolder, frame_path, read_json
from ggvs_eval.tasks.identity import code_of
from helpers.command_line import refusal
from helpers.places import ROOT
from helpers.small_runs import small_protocol, write_small_capture

EXAMPLE = ROOT / "examples" / "plugin"
PAGE = ROOT / "docs" / "extending.md"
in_checkout = pytest.mark.skipif(
    not EXAMPLE.is_dir(), reason="no examples/ beside an installed wheel"
)
METRIC = """
import numpy as np
from ggvs_eval.metrics.metric import QUALITY, ViewMetric

def worst(rendered, truth):
    return float(np.abs(rendered.astype(int) - truth).max())

METRICS = {"Worst": ViewMetric(name="Worst", kind="frame", function=worst, higher_is_better=False, group=QUALITY,
                               describe="largest error", reference="a test")}
"""  # noqa: E501


@pytest.fixture(autouse=True)
def forgotten(monkeypatch, tmp_path):
    """No plug-in of one test is known to another."""
    monkeypatch.setenv(FILES, "")
    path = list(sys.path)
    plugins._offered.cache_clear()
    yield
    plugins._offered.cache_clear()
    sys.path[:] = path
    for name, module in list(sys.modules.items()):
        if str(getattr(module, "__file__", None) or "").startswith(str(tmp_path)):
            sys.modules.pop(name)
    for registry in (METRICS, METHODS):
        registry._loaded.clear()


def offer(monkeypatch, kind: str, **entries: str) -> None:
    """Pretend that an installed package has these entry points."""
    group = f"ggvs_eval.{kind}"
    found = [EntryPoint(name, value, group) for name, value in entries.items()]
    monkeypatch.setattr(
        plugins, "entry_points", lambda group: [each for each in found if each.group == group]
    )
    plugins._offered.cache_clear()


def number(name: str, value: object) -> int:
    if not isinstance(value, int):
        raise TypeError(f"wanted an int, got {type(value).__name__}")
    return value


def test_ours_and_theirs_are_one_mapping(monkeypatch, capsys):
    """Names of both, in this order; theirs are imported when they are asked for; a name that is
    taken keeps what it means.
    """
    offer(monkeypatch, "metrics", two="sys:maxsize", broken="no_such_module:x")
    registry = Registry("metrics", {"one": 1}, number)
    assert list(registry) == ["one", "broken", "two"]
    assert "broken" in registry
    assert "no_such_module" not in sys.modules
    assert registry["two"] == sys.maxsize
    with pytest.raises(KeyError):
        registry["three"]
    offer(monkeypatch, "metrics", PSNR="sys:maxsize")
    assert METRICS["PSNR"].unit == "dB"
    assert list(METRICS).count("PSNR") == 1
    assert "'PSNR' is in use" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        ("no_such_module:x", "ModuleNotFoundError"),
        ("os:path", "wanted an int, got module"),
        ("os:nix", "nix"),
    ],
)
def test_a_broken_plugin_is_one_line(monkeypatch, capsys, value, reason):
    """It names where it comes from, the reason and the mend; where all are tried it is passed over,
    and said once.
    """
    offer(monkeypatch, "metrics", broken=value, two="sys:maxsize")
    registry = Registry("metrics", {"one": 1}, number)
    with pytest.raises(PluginError, match=reason) as caught:
        registry["broken"]
    assert "\n" not in str(caught.value)
    assert dict(registry.working()) == {"one": 1, "two": sys.maxsize}
    assert dict(registry.working())
    assert capsys.readouterr().err.count("'broken'") == 1


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("nothing.py", "x = 1", "wanted a table METRICS, METHODS, DATASETS or SECTIONS"),
        ("wrong.py", "1 / 0", "ZeroDivisionError"),
        ("my-file.py", "METRICS = {}", "whose name can be imported"),
        ("json.py", "METRICS = {}", "its name is that of the module"),
    ],
)
def test_a_file_that_is_no_plugin_is_one_line(tmp_path, name, text, reason):
    """No table, an exception, and names that cannot be imported or are those of other modules."""
    (tmp_path / name).write_text(text)
    assert reason in refusal("status", tmp_path, "--plugin", tmp_path / name)
    assert "wanted a Python file" in refusal("status", tmp_path, "--plugin", tmp_path / "absent.py")
    assert "wanted a file after it" in refusal("status", tmp_path, "--plugin")


def test_a_change_of_a_plugin_is_a_change_of_its_jobs(tmp_path):
    """The identity of what it makes follows its source; that of ours does not."""
    (tmp_path / "mine.py").write_text(METRIC)
    use_file(tmp_path / "mine.py")
    ours, before = (
        code_of("ggvs_eval.metrics.image.psnr"),
        code_of("mine", "ggvs_eval.metrics.image.psnr"),
    )
    (tmp_path / "mine.py").write_text(METRIC.replace("max()", "max() + 1"))
    assert code_of("mine", "ggvs_eval.metrics.image.psnr") != before
    assert code_of("ggvs_eval.metrics.image.psnr") == ours


def test_a_method_is_named_by_its_module(tmp_path, monkeypatch):
    """``module:name`` of the working folder is a method; a name that is not there is one line."""
    (tmp_path / "my_method.py").write_text(
        "class Mine:\n    '''Mine, a method.'''\n    def step(self, instant): ...\n"
    )
    monkeypatch.chdir(tmp_path)
    assert find_method("my_method:Mine").describe == "Mine, a method."
    with pytest.raises(PluginError, match="my_method:Other"):
        find_method("my_method:Other")


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
def test_a_metric_of_a_file_is_scored_in_other_processes(tmp_path):
    """It gets its values, the right ones, and its file stands in the record of the results."""
    capture = write_small_capture(tmp_path / "room", 2)
    (tmp_path / "mine.py").write_text(METRIC)
    (tmp_path / "p.toml").write_text(small_protocol(2, 0, ("PSNR", "Worst")).to_toml())
    words = [
        "run",
        str(tmp_path / "run"),
        "--capture",
        str(capture.path),
        "--protocol",
        str(tmp_path / "p.toml"),
    ]
    run_command(
        [*words, "--methods", "no-blending", "--jobs", "2", "--plugin", str(tmp_path / "mine.py")]
    )
    results = Results.read(tmp_path / "run")
    run = RunFolder(tmp_path / "run")
    worst = results.table[results.table.metric == "Worst"].set_index(["view", "frame"]).value
    rendered, truth = (
        read_image(frame_path(folder, 0)).astype(int)
        for folder in (run.renders("no-blending", "cam00"), run.truth("cam00"))
    )
    assert worst["cam00", 0] == np.abs(rendered - truth).max()
    assert results.provenance["plugins"] == {"Worst": str(tmp_path / "mine.py")}


OWN_METHODS = """
import sys

sys.path.insert(0, {folder!r})
from ggvs_eval_example.blender import InverseDistance
from ggvs_eval_example.method import NearestView

METHODS = {{"inverse": InverseDistance, "nearest": NearestView}}
"""


@pytest.mark.slow
@in_checkout
@pytest.mark.usefixtures("no_figures")
def test_the_example_methods_render_and_are_timed(tmp_path):
    """Blending of one's own on GGVS's splats lies between the nearest picture and GGVS; a method
    without times has one.
    """
    capture = write_small_capture(tmp_path / "room", 2)
    (tmp_path / "mine.py").write_text(OWN_METHODS.format(folder=str(EXAMPLE)))
    (tmp_path / "p.toml").write_text(small_protocol(2, 0, ("PSNR",)).to_toml())
    words = [
        "run",
        str(tmp_path / "run"),
        "--capture",
        str(capture.path),
        "--protocol",
        str(tmp_path / "p.toml"),
    ]
    run_command(
        [
            *words,
            "--methods",
            "ours-geometric",
            "inverse",
            "nearest",
            "--jobs",
            "1",
            "--plugin",
            str(tmp_path / "mine.py"),
        ]
    )
    psnr_db = Results.read(tmp_path / "run").table.groupby("method").value.mean()
    run = RunFolder(tmp_path / "run")
    seconds = {
        label: read_json(run.renders(label, "cam00") / "job.json")["seconds"]
        for label in ("inverse", "nearest")
    }

    assert psnr_db["nearest"] < psnr_db["inverse"] < psnr_db["ours-geometric"]
    assert list(seconds["inverse"]) == ["filter", "splat", "tsdf", "blend"]
    assert list(seconds["nearest"]) == ["step"]
    assert all(step_s > 0 for step_s in seconds["nearest"]["step"])


@in_checkout
def test_the_page_shows_the_example():
    """Every file of the package stands on the page as it is."""
    page = PAGE.read_text(encoding="utf-8")
    for file in (EXAMPLE / "pyproject.toml", *(EXAMPLE / "ggvs_eval_example").glob("[a-z]*.py")):
        assert file.read_text(encoding="utf-8").rstrip() in page, file.name
        assert len(file.read_text(encoding="utf-8").splitlines()) <= 40


def write_rig(folder: Path, source: Path) -> None:
    """A capture in the example's layout, of the frames and cameras of another one."""
    from ggvs_eval.datasets import open_capture

    capture = open_capture(source)
    folder.mkdir()
    rig = {}
    for camera in capture.cameras:
        write_video(
            folder / f"{camera.name}.mp4", list(capture.frames(camera.name, 0, 2)), 30.0, crf=0
        )
        pose = {"K": camera.K.tolist(), "world_to_camera": camera.world_to_camera.tolist()}
        rig[camera.name] = pose | {"near": camera.near, "far": camera.far}
    (folder / "rig.json").write_text(json.dumps(rig))


@pytest.mark.proof
@in_checkout
def test_the_example_package_is_installed_and_runs(tmp_path):
    """In an environment of its own: its layout opens, its method renders, its metric has values,
    column, interval and record.
    """
    write_rig(tmp_path / "rig", write_small_capture(tmp_path / "room", 2).path)
    (tmp_path / "p.toml").write_text(small_protocol(2, 0, ("PSNR", "P99")).to_toml())
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", tmp_path / "venv"], check=True)
    (site,) = (tmp_path / "venv" / "lib").glob("python3*/site-packages")
    purelib = sysconfig.get_path("purelib")
    (site / "dependencies.pth").write_text(f"import site; site.addsitedir({purelib!r})\n")
    environment = {name: value for name, value in os.environ.items() if name != FILES}
    pip = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "-q",
        "--no-deps",
        "--no-build-isolation",
        "--target",
        site,
        EXAMPLE,
    ]
    subprocess.run(pip, check=True, env=environment, capture_output=True)

    def called(*words: object) -> str:
        command = [tmp_path / "venv" / "bin" / "python", "-m", "ggvs_eval", *map(str, words)]
        done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout

    run = tmp_path / "run"
    words = (
        "--capture",
        tmp_path / "rig",
        "--protocol",
        tmp_path / "p.toml",
        "--methods",
        "no-blending",
        "nearest-view",
    )
    called("run", run, *words, "--jobs", 1)
    results = Results.read(run)
    values = results.table[
        (results.table.metric == "P99") & (results.table.method == "nearest-view")
    ]
    assert len(values) == 2 * 2
    assert results.provenance["plugins"] == {
        "P99": "ggvs-eval-example 1.0",
        "nearest-view": "ggvs-eval-example 1.0",
    }
    assert read_json(run / "capture.json")["layout"] == "rig-json"
    tables = (run / "report" / "tables.md").read_text(encoding="utf-8")
    assert re.search(r"\| *P99", tables)
    assert "nearest-view" in tables
    assert "P99" in called("score", run, "--jobs", 1)
