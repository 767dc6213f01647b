"""Sweeps: what is packaged fits the methods and the paper, what runs ends in one table, what cannot run is named."""

import dataclasses

import pytest

from ggvs_eval.datasets import open_capture
from ggvs_eval.errors import ProtocolError
from ggvs_eval.pipelines.methods import METHODS
from ggvs_eval.pipelines.sweep import run_sweep
from ggvs_eval.protocol import Frames, Views, load_protocol
from ggvs_eval.reports.published import read_published
from ggvs_eval.sweep import Sweep, SweepRow, load_sweep, packaged_sweeps
from ggvs_eval.synthetic.demo import write_demo
from ggvs_eval.synthetic.options import DemoOptions


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    options = DemoOptions(width=96, height=72, n_frames=2, cameras_per_row=3, path_poses=0, supersampling=1)
    return open_capture(write_demo(tmp_path_factory.mktemp("capture") / "demo", options))


@pytest.fixture
def protocol():
    base = load_protocol("demo")
    measurement = dataclasses.replace(base.measurement, metrics=("PSNR",))
    return dataclasses.replace(base, views=Views(("cam00",), "test"), frames=Frames(0, 2), measurement=measurement)


def test_the_ablation_table_has_the_papers_rows():
    """The packaged table of ablations has the rows of the paper's, in their order."""
    assert [row.title for row in load_sweep("ablations").row] == list(read_published("ablation")["DyNeRF"])


@pytest.mark.parametrize("name", packaged_sweeps())
def test_packaged_sweeps_name_methods_of_here_or_to_come(name):
    """Each packaged sweep has at least two rows that run; a label that does not is one of ours that is still to come."""
    rows = load_sweep(name).row

    assert len([row for row in rows if row.method in METHODS]) >= 2
    assert all(row.method.startswith("ours") for row in rows if row.method not in METHODS)


def test_every_variant_is_a_line_and_absent_methods_are_named(capture, protocol, tmp_path):
    """K = 2 and 3 give two lines that differ, in run folders that share frames and depth; a method to come is not computed."""
    rows = (SweepRow("Distance", "distance-based"), SweepRow("Naive network", "ours+no-depth"))
    sweep = Sweep("k", "test", rows, k=(2, 3))

    result = run_sweep(tmp_path / "sweep", capture, sweep, protocol, workers=1)

    assert list(result.table.index) == [("k2", "Distance"), ("k3", "Distance")]
    assert result.table["PSNR"].nunique() == 2
    assert (result.table["s/frame"] > 0).all()
    assert "ours+no-depth" in result.not_computed["Naive network"]
    assert (tmp_path / "sweep" / "k2" / "depth").resolve() == (tmp_path / "sweep" / "k3" / "depth").resolve()
    assert (tmp_path / "sweep" / "sweep.csv").is_file()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name = 'x'\ndescribe = 'x'\n", "missing key row"),
        ("name = 'x'\ndescribe = 'x'\nrow = []\n", "at least one"),
        ("name = 'x'\ndescribe = 'x'\nk = [0]\n[[row]]\ntitle = 'a'\nmethod = 'b'\n", "k of at least 1"),
        ("name = 'x'\ndescribe = 'x'\n[[rows]]\ntitle = 'a'\n", "did you mean row"),
        ("name = 'x'\ndescribe = 'x'\nk = ['2']\n[[row]]\ntitle = 'a'\nmethod = 'b'\n", r"k\[0\] must be a whole number"),
        ("name = ", "not valid TOML"),
    ],
)
def test_mistakes_are_refused_in_one_line(text, message, tmp_path):
    """A sweep with a mistake is refused with file, key and mend."""
    (tmp_path / "mine.toml").write_text(text)

    with pytest.raises(ProtocolError, match=message) as caught:
        load_sweep(str(tmp_path / "mine.toml"))
    assert "\n" not in str(caught.value)


def test_an_unknown_name_lists_what_is_packaged():
    """A sweep that is not packaged is refused with those that are."""
    with pytest.raises(ProtocolError, match="ablations, k"):
        load_sweep("ablation")
