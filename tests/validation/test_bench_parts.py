"""`python -m benchmarks PART ...`: parts beside what was measured before, and a word that
is none.
"""

import numpy as np
import pytest

from benchmarks import __main__ as bench
from benchmarks import bench_growth
from ggvs_eval.run_folder import read_json, write_json


def figure(value):
    """One entry of the file."""
    return {
        "value": value,
        "unit": "ms",
        "target": None,
        "higher_is_better": False,
        "command": "none",
    }


def test_a_part_is_measured_beside_the_others(tmp_path, monkeypatch, capsys):
    """Its figures are written anew, those of other parts stay, nothing else is measured."""
    file = tmp_path / "bench.json"
    write_json(file, {"step": figure(2.0), "decode": figure(3.0)})
    monkeypatch.setattr(
        bench, "PARTS", {"online": lambda: {"step": figure(1.0)}, "decoding": lambda: 1 / 0}
    )
    bench.main(["online", "--json", str(file)])
    assert {name: each["value"] for name, each in read_json(file).items()} == {
        "step": 1.0,
        "decode": 3.0,
    }
    assert capsys.readouterr().out == "step: 1 ms\n"


def test_a_part_that_is_none_is_told(capsys):
    """With the names of those that are, before anything is measured."""
    with pytest.raises(SystemExit):
        bench.main(["onlin"])
    told = capsys.readouterr().err
    for part in ("onlin;", "online"):
        assert part in told


def test_growth_is_an_exponent():
    """Cameras and frames in small numbers: a positive time, and the slope between the two largest
    sizes.
    """
    figures = bench_growth.measure_cameras((6, 8)) | bench_growth.measure_series((20, 40))
    assert figures["growth.cameras.depth_maps"]["value"] >= 4
    for name, each in figures.items():
        assert np.isfinite(each["value"])
        assert each["target"] == (bench_growth.SUPERLINEAR if name.endswith("exponent") else None)
