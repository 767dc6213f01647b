"""What ships is text in tables: it is what its modules hold, loads when it is asked for, and can be
taken away.
"""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from ggvs_eval import built_in
from ggvs_eval.errors import AbsentPartError, ProtocolError
from ggvs_eval.metrics.metric import ViewMetric
from ggvs_eval.metrics.registry import DEPTH_METRICS, METRICS
from ggvs_eval.metrics.stream import score_view
from ggvs_eval.pipelines.run.import_renders import asked_protocol
from ggvs_eval.plugins import Registry
from ggvs_eval.protocol import load_protocol

ABSENT = "ggvs_eval.contrib.wings.flight:FLIGHT"


def test_metrics_are_called_as_the_table_calls_them():
    """Each reference leads to the metric of its name, and what is derived follows from its base."""
    every = METRICS.built_in() | DEPTH_METRICS.built_in()
    assert {name: metric.name for name, metric in every.items()} == {name: name for name in every}
    assert (
        tuple(
            name
            for name, metric in every.items()
            if isinstance(metric, ViewMetric) and metric.inside
        )
        == built_in.IN_PARTS
    )
    assert (
        tuple(
            name
            for name, metric in every.items()
            if isinstance(metric, ViewMetric) and metric.series
        )
        == built_in.METRICS_OF_VIDEOS
    )
    assert (
        tuple(name for name, metric in every.items() if metric.has_ceiling)
        == built_in.METRICS_WITH_CEILING
    )


@pytest.mark.slow
def test_a_name_is_known_before_it_is_loaded():
    """Of an entry's package nothing is imported before it is asked for; scores need no torch,
    scipy, pandas or matplotlib.
    """
    code = (
        "import sys\nimport numpy as np\nfrom ggvs_eval.metrics.registry import "
        "METRICS\nlist(METRICS), 'FLIP' in METRICS\n"
        "loaded = lambda *names: [name for name in sys.modules if name.startswith(names)]\n"
        "print(loaded('ggvs_eval.metrics.image.'))\nMETRICS['PSNR']\nprint(loaded('ggvs_eval.metrics.image.'))\n"
        "from ggvs_eval.metrics.stream import score_view\n"
        "frames = [np.full((96, 128, 3), level, np.uint8) for level in (0, 9)]\n"
        "scores = score_view(list(zip(frames, frames)), ('PSNR', 'SSIM', 'L1', 'TCC', 'STED', "
        "'Flicker'))\n"
        "print(scores.not_computed, loaded('torch', 'scipy', 'pandas', 'matplotlib'))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["[]", "['ggvs_eval.metrics.image.psnr']", "{} []"]


def test_what_is_derived_is_made_once():
    """Whoever asks twice gets the same object, with the root of its base."""
    assert METRICS["PSNR_moving"] is METRICS["PSNR_moving"]
    assert METRICS.root("PSNR_moving") == METRICS.root("PSNR") == "ggvs_eval.metrics.image.psnr"


def test_what_is_not_installed_is_left_out_and_named():
    """It is in no list; asked for, it is a line that says of which package it is."""
    made = Registry("things", {"here": "math:pi", "away": ABSENT})
    assert list(made) == ["here"]
    assert "away" not in made
    with pytest.raises(AbsentPartError) as caught:
        made["away"]
    assert str(caught.value) == (
        "away is part of ggvs_eval.contrib.wings, which is not installed; reinstall ggvs-eval or "
        "omit it"
    )


def test_a_metric_that_is_not_installed_is_not_computed(monkeypatch):
    """The rest is measured, and the reason stands beside it."""
    monkeypatch.setitem(METRICS.shipped, "Flight", ABSENT)
    frame = np.zeros((16, 16, 3), np.uint8)
    scores = score_view([(frame, frame)], ("PSNR", "Flight"))
    assert [name for name, _, _ in scores.values] == ["PSNR"]
    assert scores.not_computed["Flight"].startswith(
        "Flight is part of ggvs_eval.contrib.wings, which is not installed"
    )


def test_a_protocol_of_the_user_may_not_name_what_is_not_installed(tmp_path, monkeypatch):
    """A packaged one may: its other metrics are measured."""
    monkeypatch.setitem(METRICS.shipped, "PSNR_cc", ABSENT)
    packaged = load_protocol("demo")
    assert "PSNR_cc" in packaged.measurement.metrics
    assert asked_protocol("demo") == packaged
    file = tmp_path / "mine.toml"
    file.write_text(replace(packaged, name="mine").to_toml())
    with pytest.raises(
        ProtocolError,
        match=r"mine\.toml: measurement\.metrics: PSNR_cc is part of ggvs_eval\.contrib\.wings",
    ):
        asked_protocol(str(file))


def test_a_folder_of_that_name_is_not_the_module_that_is_needed(tmp_path, monkeypatch):
    """Python takes any folder on its path for a namespace package; what needs a module stays absent
    and says so.
    """
    (tmp_path / "wings").mkdir()
    monkeypatch.syspath_prepend(tmp_path)
    parts = Registry("parts", {"flight": "ggvs_eval.built_in:METRICS"}, needs="wings")
    assert "flight" not in parts
    with pytest.raises(
        AbsentPartError, match="flight wants the module wings, which is not installed"
    ):
        parts["flight"]
    (tmp_path / "wings" / "__init__.py").touch()
    assert "flight" in parts
