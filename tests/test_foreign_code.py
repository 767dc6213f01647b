"""Metrics, methods and layouts of plug-ins that fail: each costs what it was to give and is named,
and nothing else changes.
"""

import os
import pickle
import sys
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from ggvs_eval import plugins
from ggvs_eval.capture import Capture
from ggvs_eval.datasets import DATASETS, detect_layout, open_capture
from ggvs_eval.errors import CaptureError, PluginError, RenderError, ViewRefusedError
from ggvs_eval.metrics import foreign
from ggvs_eval.metrics.path.rendered_path import PathPose
from ggvs_eval.metrics.path_scores import score_path
from ggvs_eval.metrics.registry import METRICS
from ggvs_eval.metrics.stream import score_view, score_views
from ggvs_eval.pipelines.methods.registry import METHODS
from ggvs_eval.pipelines.run.evaluate import measure, report
from ggvs_eval.pipelines.run.fits import plan_fits
from ggvs_eval.pipelines.run.folds import FoldPlan
from ggvs_eval.pipelines.run.run_plan import RunRequest, plan_run
from ggvs_eval.plugins import FILES, use_file
from helpers.refusals import refused
from helpers.scenes import camera_at, instant
from helpers.small_runs import small_protocol, write_small_capture

FAILS = {
    "raise ValueError('no such luck')": "ValueError: no such luck",
    "import sys; sys.exit(3)": "SystemExit: 3",
    "return 'abc'": "wanted a number, got str",
    "return np.zeros(3)": "",
    "return None": "None",
    "return float('nan')": "nan",
    "measured.n = getattr(measured, 'n', 0) + 1; return 1.0 if measured.n < 3 else 1 / "
    "0": "ZeroDivisionError",
    "raise MemoryError": "MemoryError",
    "raise BaseException('no such luck')": "BaseException: no such luck",
    "raise type('Mute', (Exception,), {'__str__': lambda self: 1 / 0})": "Mute, without a text",
    "import os; os._exit(3)": "its process ended with status 3",
    "import ctypes; ctypes.string_at(0)": "its process ended with signal 11",
}
WRITES = (
    "{0}[...] = 0",
    "{0}.setflags(write=True); {0}[...] = 0",
    "import torch; torch.from_numpy({0}).fill_(0)",
    "import ctypes; ctypes.memset({0}.ctypes.data, 0, {0}.nbytes)",
)
METRIC = """
import numpy as np
from ggvs_eval.metrics.metric import QUALITY, ViewMetric

def measured(r, t):
    {body}

METRICS = {{"X": ViewMetric(name="X", kind="frame", function=measured, higher_is_better=True, group=QUALITY, describe="x",
                           reference="x")}}
"""  # noqa: E501
METHOD = """
import numpy as np
from ggvs_eval.method import Rendering

class Mine:
    '''Mine.'''
    def step(self, instant):
        {body}

METHODS = {{"mine": Mine}}
"""
FITTED = """
from dataclasses import dataclass
import numpy as np
from ggvs_eval.errors import RenderError
from ggvs_eval.method import Rendering
from ggvs_eval.pipelines.methods.fitted import FittedMethod
from ggvs_eval.scene_fitter import FittedScene, SceneFitter

METHODS = globals().get("METHODS", {{}})

def picture(target, **more):
    return Rendering(np.full((target.height, target.width, 3), 0.5, np.float32), **more)

class {name}Scene(FittedScene):
    def render(self, index, target):
        {render}

    @property
    def size_bytes(self):
        {size_bytes}

@dataclass(frozen=True)
class {name}(SceneFitter):
    name = "{name}"
    look_ahead = "none"

    def depth_indices(self, indices):
        {depth}

    def fit(self, footage, folder, progress):
        held_out = sorted({{"cam00", "cam01"}} - set(footage.views))[0]
        {fit}

    def load(self, folder):
        {load}

METHODS["{name}"] = FittedMethod("Mine", "{name}", "foreign_plugin:{name}")
"""
WORKS = {
    "name": "mine",
    "depth": "return [indices[0]]",
    "fit": "pass",
    "load": "return globals()[f'{self.name}Scene']()",
    "size_bytes": "return 1",
    "render": "return picture(target)",
}
PICTURE = "np.full((instant.target.height, instant.target.width, 3), 0.5, np.float32)"
LAYOUT = """
from ggvs_eval.datasets import DatasetSpec

def refuse(path):
    {refuse}

def load(path, units):
    {load}

DATASETS = {{"mine": DatasetSpec("mine", refuse, load)}}
"""


@pytest.fixture(autouse=True)
def forgotten(monkeypatch, tmp_path) -> Iterator[None]:
    """No plug-in of one test is known to another."""
    monkeypatch.setenv(FILES, "")
    path = list(sys.path)
    plugins._offered.cache_clear()
    yield
    plugins._offered.cache_clear()
    sys.path[:] = path
    sys.modules.pop("foreign_plugin", None)
    for registry in (METRICS, METHODS, DATASETS):
        registry._loaded.clear()
    for process in foreign.PROCESSES.values():
        process.end()
    foreign.PROCESSES.clear()


@pytest.fixture(scope="module")
def small_capture(tmp_path_factory) -> Capture:
    return write_small_capture(tmp_path_factory.mktemp("small") / "room", 2)


@pytest.fixture
def offer(tmp_path):
    def write(text: str) -> None:
        (tmp_path / "foreign_plugin.py").write_text(text)
        use_file(tmp_path / "foreign_plugin.py")

    return write


def frames() -> list[tuple[np.ndarray, np.ndarray]]:
    random = np.random.default_rng(0)
    return [tuple(random.integers(0, 255, (2, 64, 64, 3), dtype=np.uint8)) for _ in range(3)]


@pytest.mark.parametrize(("body", "reason"), FAILS.items())
def test_a_metric_that_fails_costs_itself(offer, body, reason):
    """At the first frame or at a later one, also by ending its process: it has a reason, every
    other value stays.
    """
    offer(METRIC.format(body=body))
    names = ["X", "PSNR", "PSNR_moving", "TCC", "STED"]
    with_it, without = score_view(frames(), names), score_view(frames(), names[1:])

    assert with_it.values == without.values
    assert with_it.not_computed == without.not_computed | {"X": with_it.not_computed["X"]}
    assert "foreign_plugin.py: metric X failed" in with_it.not_computed["X"]
    assert reason in with_it.not_computed["X"]


@pytest.mark.parametrize("write", WRITES)
def test_a_metric_that_writes_into_frames_has_copies(offer, write):
    """No other value changes, whatever it goes around."""
    offer(
        METRIC.format(
            body=f"{write.format('t')}; {write.format('r')}; import os; os.chdir('/'); return 1.0"
        )
    )
    names = ["X", "PSNR", "PSNR_moving", "TCC", "STED"]
    with_it, without = score_view(frames(), names), score_view(frames(), names[1:])

    assert [value for value in with_it.values if value[0] != "X"] == without.values
    assert [value for value in with_it.values if value[0] == "X"] == [
        ("X", frame, 1.0) for frame in range(3)
    ]


def test_a_metric_that_hangs_costs_itself(offer, monkeypatch):
    """After a stated time its process is ended, and the reason says so."""
    monkeypatch.setattr(foreign, "LONGEST_ANSWER_S", 3.0)
    offer(METRIC.format(body="import time; time.sleep(100)"))
    scores = score_view(frames(), ["X", "L1"])
    assert "took over 3 s" in scores.not_computed["X"]
    assert {name for name, _, _ in scores.values} == {"L1"}


def test_a_copy_of_the_process_gives_no_answers(offer):
    """A metric that forks has the values of the process that was asked; the copy ends where it
    would answer too.
    """
    offer(METRIC.format(body="import os; return 1.0 if os.fork() else 2.0"))
    assert score_view(frames(), ["X"]).values == [("X", frame, 1.0) for frame in range(3)]


SCORER = """
class Scorer:
    def __init__(self, names, options, colour_map):
        self.names = names
    def add(self, index, rendered, truth):
        return {values}
    def finish(self):
        return []

METRICS["X"] = __import__("dataclasses").replace(METRICS["X"], scorer={scorer})
"""


@pytest.mark.parametrize(("scorer", "lost"), [("Scorer", [0, 1]), ("None", [0])])
def test_a_process_that_ends_costs_what_it_was_measuring(offer, scorer, lost):
    """A metric that gathers frames is lost for all renderings; one of single frames is for the
    rendering that it ended at.
    """
    body = "import os; return os._exit(3) if r.max() == 1 else 1.0"
    offer(
        METRIC.format(body=body)
        + SCORER.format(values="[('X', index, measured(rendered, truth.image))]", scorer=scorer)
    )
    levels = [np.full((8, 8, 3), level, np.uint8) for level in (0, 1, 2)]

    scores = score_views([((level, levels[0]), levels[2]) for level in levels], ["X", "L1"])

    assert [i for i, of_rendering in enumerate(scores) if "X" in of_rendering.not_computed] == lost
    assert "ended with status 3" in scores[0].not_computed["X"]
    assert [value for _, _, value in scores[0].values] == [2, 1, 0]


@pytest.mark.parametrize(
    "values", ["[('PSNR', index, 1.0)]", "[('X', index + 1, 1.0)]", "[('X', 1.0)]"]
)
def test_a_metric_gives_values_of_its_own(offer, values):
    """Values under another's name, of a frame that is not there, or without a place are a
    reason.
    """
    offer(METRIC.format(body="pass") + SCORER.format(values=values, scorer="Scorer"))
    with_it, without = score_view(frames(), ["X", "PSNR"]), score_view(frames(), ["PSNR"])
    assert with_it.values == without.values
    assert "metric X failed" in with_it.not_computed["X"]


TABLE_AND_PATH = """
from ggvs_eval.metrics.metric import TableMetric
from ggvs_eval.metrics.path.rendered_path import PathMetric, PathScorer

about = {{"function": len, "higher_is_better": True, "describe": "x"}}
rows = lambda values, options: {rows}
scorer = PathScorer(names=("P",), measure=lambda path: {values})
METRICS = {{
    "T": TableMetric(name="T", kind="view", part="L1", rows=rows, reference="x", **about),
    "P": PathMetric(name="P", scorer=scorer, **about),
}}
"""


def poses() -> list[PathPose]:
    cameras = [camera_at(0.0), camera_at(0.1)]
    return [
        PathPose(camera, np.zeros((camera.height, camera.width, 3), np.uint8)) for camera in cameras
    ]


def test_a_metric_of_values_or_of_a_path_has_its_process_too(offer):
    """What is no number or ends the process is a reason, every other value stays."""
    offer(
        TABLE_AND_PATH.format(
            rows="[('', -1, len(values['']))]", values="[('P', None, path.rows[0])]"
        )
    )
    assert ("T", None, 3.0) in score_view(frames(), ["L1", "T"]).values
    assert score_path(poses(), ["P"]).values[-1][0] == "P"


def test_a_metric_of_values_or_of_a_path_that_fails_costs_itself(offer):
    """As one of frames."""
    offer(
        TABLE_AND_PATH.format(
            rows="__import__('os')._exit(3)", values="[('reprojection', None, 1.0)]"
        )
    )
    table, along = score_view(frames(), ["L1", "T"]), score_path(poses(), ["P"])
    assert "ended with status 3" in table.not_computed["T"]
    assert len(table.values) == 3
    assert "one of reprojection" in along.not_computed["P"]
    assert along.values == score_path(poses()).values


def test_a_metric_that_works_is_a_number(offer):
    """Numbers of numpy, and of Python, are values."""
    offer(METRIC.format(body="return np.float32(r.mean() - t.mean())"))
    scores = score_view(frames(), ["X"])
    assert len(scores.values) == 3
    assert all(type(value) is float for _, _, value in scores.values)


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        ("raise ValueError('no such luck')", "ValueError: no such luck"),
        ("import sys; sys.exit(3)", "SystemExit: 3"),
        (
            "from ggvs_eval.errors import RenderError; raise RenderError('no such luck')",
            "RenderError: no such luck",
        ),
        ("return 'abc'", "wanted a Rendering with an image, got str"),
        ("return Rendering('abc')", "wanted a Rendering with an image, got str"),
        (f"return Rendering({PICTURE}[:-1])", "wanted an image of floats"),
        (f"return Rendering(np.nan * {PICTURE})", "not all finite"),
        ("raise MemoryError", "MemoryError"),
        ("import os; os.chdir('/'); raise GeneratorExit", "GeneratorExit"),
        *((write.format("instant.sources[0].depth"), "got NoneType") for write in WRITES),
        (WRITES[2].format("instant.target.world_to_camera"), "got NoneType"),
    ],
)
def test_a_method_that_fails_refuses_the_view(offer, body, reason):
    """Whatever goes wrong in a step is a refused view that names method and instant; what it was
    shown is unchanged.
    """
    offer(METHOD.format(body=body))
    seen = instant(7, camera_at(0.0, name="target"), [camera_at(0.1)])
    before, folder = pickle.dumps(seen), os.getcwd()

    with refused(ViewRefusedError, "method mine: failed at instant 7", reason):
        METHODS["mine"].make().step(seen)

    assert pickle.dumps(seen) == before
    assert os.getcwd() == folder


def test_a_method_that_cannot_be_made_is_one_line(offer):
    """Its constructor's exception is a line with its name."""
    offer(
        METHOD.format(body="pass").replace(
            "def step", "def __init__(self):\n        1 / 0\n    def step"
        )
    )
    with refused(RenderError, "method mine: cannot be made", "ZeroDivisionError"):
        METHODS["mine"].require()


# Part of a fitted method -> what it does there, and where the method is shown all the same, and why
# not elsewhere.
IN_RUNS = {
    "fit1": (
        "fit",
        "if held_out == 'cam01': raise ValueError('no such luck')",
        "cam00",
        "fit fit1, fold2 (ValueError",
    ),
    "fit2": (
        "fit",
        "footage.image(held_out, 0)",
        "",
        "fit fit2, fold1 (RenderError: footage: 'cam00' is not",
    ),
    "fit3": ("fit", "import sys; sys.exit(3)", "", "fit fit3, fold1 (SystemExit: 3"),
    "load1": ("load", "return 5", "", "fit load1, fold1 (AttributeError"),
    "size1": ("size_bytes", "return 'big'", "", "fit size1, fold1 (TypeError"),
    "show1": (
        "render",
        "1 / (target.name != 'cam00'); return picture(target)",
        "cam01",
        "failed at instant 0 (Zero",
    ),
    "show2": ("render", "return 'abc'", "", "wanted a Rendering with an image, got str"),
    "show3": (
        "render",
        "return Rendering(np.full((3, 3, 3), 0.5, np.float32))",
        "",
        "wanted an image of floats",
    ),
    "show4": (
        "render",
        "return picture(target, seconds={'a': 'b'})",
        "",
        "failed at instant 0 (TypeError",
    ),
    "show5": (
        "render",
        "return picture(target, diagnostics={'mine': 3})",
        "",
        "its diagnostics of frame 0 are none (KeyError",
    ),
}


@pytest.mark.slow
def test_a_run_goes_on_without_what_failed(offer, tmp_path, small_capture):
    """A metric that fails costs itself, a method, made or fitted, the views that it was to show;
    all others have their values.
    """
    body = (
        f"if instant.target.name == 'cam01': raise ValueError('not this one')\n        return "
        f"Rendering({PICTURE})"
    )
    text = METRIC.format(body="raise KeyError('depth')") + METHOD.format(body=body)
    offer(
        text
        + "".join(
            FITTED.format(**WORKS | {"name": name, where: body})
            for name, (where, body, *_) in IN_RUNS.items()
        )
    )
    protocol = small_protocol(2, 0, ("PSNR", "X"))
    protocol = replace(protocol, views=replace(protocol.views, folds=(("cam00",), ("cam01",))))
    request = RunRequest(
        tmp_path / "run", small_capture, protocol, ("no-blending", "mine", *IN_RUNS)
    )

    results = measure(plan_run(request), 1)

    views = results.table.groupby("method")["view"].unique().map(sorted).to_dict()
    wanted = {"no-blending": ["cam00", "cam01"], "mine": ["cam00"]}
    wanted |= {name: [view] for name, (_, _, view, _) in IN_RUNS.items() if view}
    assert views == wanted
    reasons = results.provenance["partial"]
    assert "not this one" in reasons["mine"]
    for name, (*_, reason) in IN_RUNS.items():
        assert reason in reasons[name]
    assert "KeyError" in results.not_computed["X"]
    assert report([tmp_path / "run"], with_figures=False).is_file()


@pytest.mark.slow
def test_a_method_that_ends_its_process_is_named(offer, tmp_path, small_capture):
    """Also where its view is the only thing that is left to do."""
    offer(METHOD.format(body="import os; os._exit(3)"))
    request = RunRequest(
        tmp_path / "run", small_capture, small_protocol(2, 0, ("PSNR",)), ("mine",)
    )
    with refused(RenderError, "mine in cam00: its process ended", "status 3"):
        measure(plan_run(request), 2)


@pytest.mark.parametrize(
    "depth",
    ["raise ValueError('no such luck')", "return 'abc'", "return [7]", "import sys; sys.exit(3)"],
)
def test_a_fitted_method_that_cannot_be_planned_is_one_line(offer, depth):
    """Instants that it wants depth of and that are none are refused before anything is done."""
    offer(FITTED.format(**WORKS | {"depth": depth}))
    with refused(RenderError, "method Mine: its fits cannot be planned"):
        plan_fits({"mine": METHODS["mine"]}, [FoldPlan("fold1", ("cam00",), ())], range(2), 0)


@pytest.mark.parametrize(
    "refuse", ["raise ValueError('no such luck')", "import sys; sys.exit(3)", "return 5"]
)
def test_a_layout_that_fails_to_look_is_passed_over(offer, tmp_path, refuse):
    """Captures of other layouts are found as before, and where none fits its reason stands among
    the others'.
    """
    offer(LAYOUT.format(refuse=refuse, load="pass"))
    (tmp_path / "capture").mkdir()
    (tmp_path / "capture" / "x").touch()
    with refused(CaptureError, "not mine: plug-in layout mine: failed", "not colmap"):
        detect_layout(tmp_path / "capture")


@pytest.mark.parametrize(
    "load", ["raise ValueError('no such luck')", "import sys; sys.exit(3)", "return 5"]
)
def test_a_layout_that_fails_to_load_is_one_line(offer, tmp_path, load):
    """The capture and the layout are named, with the reason."""
    offer(LAYOUT.format(refuse="return None", load=load))
    (tmp_path / "capture").mkdir()
    (tmp_path / "capture" / "x").touch()
    with refused(CaptureError, "layout mine", "capture cannot be opened"):
        open_capture(tmp_path / "capture")


def test_a_file_that_exits_is_one_line(offer):
    """An exit while a plug-in is imported is named, and ends nothing."""
    with refused(PluginError, "foreign_plugin.py: cannot be imported", "SystemExit"):
        offer("import sys; sys.exit(3)")
