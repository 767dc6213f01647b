"""Sweeps: what is packaged fits the methods and the paper, what runs ends in one table, what cannot
run is named.
"""

import dataclasses
import shutil

import numpy as np
import pytest
import torch

from ggvs_eval.capture import CaptureEdit
from ggvs_eval.capture_edit import perturb_capture
from ggvs_eval.errors import ProtocolError
from ggvs_eval.gaussians import write_ply
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.pipelines.methods.registry import find_method
from ggvs_eval.pipelines.sweep.run_sweep import plan_cells, run_sweep
from ggvs_eval.protocol import CameraPath, Frames, Views, load_protocol
from ggvs_eval.reports.tables.published import published_values
from ggvs_eval.sweep import Sweep, SweepRow, load_sweep, packaged_sweeps
from helpers.gaussian_clouds import random_cloud
from helpers.small_runs import write_small_capture

ROW = "[[row]]\ntitle = '{}'\nmethod = 'rendered:a'\n"


@pytest.fixture(scope="module")
def demo_capture(tmp_path_factory):
    return write_small_capture(tmp_path_factory.mktemp("capture") / "demo", 2)


@pytest.fixture
def protocol():
    base = load_protocol("demo")
    measurement = dataclasses.replace(base.measurement, metrics=("PSNR",))
    few = {"frames": Frames(0, 1), "path": CameraPath(0)}
    return dataclasses.replace(
        base, views=Views(("cam00",), "test"), measurement=measurement, **few
    )


def test_the_ablation_table_has_the_papers_rows():
    """The packaged table of ablations has the rows of the paper's, in their order, then the network
    without depth.
    """
    titles = [row.title for row in load_sweep("ablations").row]
    published = list(
        dict.fromkeys(value.method for value in published_values() if value.table == "ablation")
    )

    # its last row is "Ours"
    assert [title for title in titles if title in published] == published[:-1]
    assert titles[:6] == [*published[:4], "Naive Network (no depth)", "GGVS (online)"]
    short = [row.title for row in load_sweep("ablations_short").row]
    assert short == [
        *titles[:5],
        "GGVS (online), no recurrent output",
        "GGVS (online)",
        "GGVS (online), geometric weights",
    ]


@pytest.mark.parametrize("name", packaged_sweeps())
def test_packaged_sweeps_name_methods_of_here(name):
    """Each packaged sweep has at least two rows, each with a title of its own and a method that is
    known.
    """
    rows = load_sweep(name).row

    assert len(rows) >= 2
    assert len({row.title for row in rows}) == len(rows)
    assert all(find_method(row.method).title for row in rows)


def test_the_ablation_table_stands_at_the_protocols_own_k(protocol):
    """Every row at K = 4, the protocol's own; GGVS (online) alone at 2 to 6 as well."""
    sweep = load_sweep("ablations")
    variants = sweep.protocols(protocol, cameras=10)

    assert list(variants) == ["k2", "k3", "k4", "k5", "k6"]
    assert sweep.rows(variants["k4"], protocol) == sweep.row
    assert {row.title for row in sweep.rows(variants["k6"], protocol)} == {
        "GGVS (online)",
        "GGVS (online), geometric weights",
    }


def test_every_variant_is_a_line_and_absent_methods_are_named(demo_capture, protocol, tmp_path):
    """K = 2 and 3 give two lines that differ, in run folders that share frames and depth; a method
    to come is not computed.
    """
    rows = (
        SweepRow("Distance", "distance-based"),
        SweepRow("Naive network", "ours+no-depth"),
        SweepRow("Typo", "ours-geometric+tau=1"),
    )
    sweep = Sweep("k", "test", rows, k=(2, 3, 8))

    result = run_sweep(
        plan_cells(tmp_path / "sweep", {"": (demo_capture, protocol)}, sweep), workers=1
    )

    assert list(result.table.index) == [("k2", "Distance"), ("k3", "Distance")]
    assert result.table["PSNR"].nunique() == 2
    assert (result.table["s/frame"] > 0).all()
    assert "ours+no-depth" in result.not_computed["Naive network"]
    assert "did you mean tau_m" in result.not_computed["Typo"]
    assert "has 6 cameras" in result.not_computed["K = 8"]
    assert (tmp_path / "sweep" / "k2" / "depth").resolve() == (
        tmp_path / "sweep" / "k3" / "depth"
    ).resolve()
    assert (tmp_path / "sweep" / "sweep.csv").is_file()


def test_frames_rendered_elsewhere_are_a_row(demo_capture, protocol, tmp_path, capsys):
    """``rendered:PATH`` is scored as the method whose frames it holds, without a time; a wrong path
    stops nothing else.

    ``splats:PATH`` is rendered here, and timed.
    """
    sweep = Sweep("one", "test", (SweepRow("Distance", "distance-based"),))
    run_sweep(plan_cells(tmp_path / "theirs", {"": (demo_capture, protocol)}, sweep), workers=1)
    frames = tmp_path / "theirs" / protocol.name / "renders" / "distance-based"
    shutil.copytree(
        frames,
        tmp_path / "Others" / demo_capture.path.name,
        ignore=shutil.ignore_patterns("*.json"),
    )
    file = tmp_path / "sweep.toml"
    file.write_text(
        "name = 'x'\ndescribe = 'x'\n"
        "[[row]]\ntitle = 'Distance'\nmethod = 'distance-based'\n"
        "[[row]]\ntitle = '4DGS (theirs)'\nmethod = 'rendered:Others/{capture}'\n"
        "[[row]]\ntitle = 'Lost'\nmethod = 'rendered:nowhere'\n"
        "[[row]]\ntitle = '3DGS (theirs)'\nmethod = 'splats:{capture}.ply'\n"
        "[[row]]\ntitle = 'No cloud'\nmethod = 'splats:nowhere'\n"
    )
    write_ply(tmp_path / f"{demo_capture.path.name}.ply", random_cloud(20, dtype=torch.float32))

    result = run_sweep(
        plan_cells(tmp_path / "sweep", {"": (demo_capture, protocol)}, load_sweep(str(file))),
        workers=1,
    )

    lines = result.table.loc[protocol.name]
    assert list(lines.index) == ["Distance", "4DGS (theirs)", "3DGS (theirs)"]
    assert lines.loc["3DGS (theirs)", "s/frame"] > 0
    assert "nowhere: wanted a .ply of 3D Gaussian splatting" in result.not_computed["No cloud"]
    assert (
        tmp_path / "sweep" / protocol.name / "renders" / "3dgs-theirs" / "cam00" / "job.json"
    ).is_file()
    assert lines.loc["4DGS (theirs)", "PSNR"] == lines.loc["Distance", "PSNR"]
    assert np.isnan(lines.loc["4DGS (theirs)", "s/frame"])
    assert (
        tmp_path / "sweep" / protocol.name / "renders" / "4dgs-theirs" / "import.json"
    ).is_file()
    # how they are numbered
    assert "4dgs-theirs: frame 0 is used as the instant 0" in capsys.readouterr().err
    (failure,) = result.failures
    assert "nowhere: wanted renders, got no such path" in str(failure)
    assert not failure.traceback


def test_several_captures_are_averaged(demo_capture, protocol, tmp_path):
    """Two captures: a table of each, and the mean of the lines that both have; measured differently
    they have no mean.

    One folder of foreign frames for both is refused before anything is rendered.
    """
    titles = {"Distance": "distance-based", "None": "no-blending", "Theirs": "rendered:frames"}
    sweep = Sweep(
        "pair", "test", tuple(SweepRow(title, method) for title, method in titles.items())
    )
    noisy = perturb_capture(demo_capture, CaptureEdit(hold_frames=2, sensor_noise_255=20.0))
    captures = {"still": (noisy, protocol), "moving": (demo_capture, protocol)}

    result = run_sweep(plan_cells(tmp_path / "s", captures, sweep), workers=1)

    psnr = result.table["PSNR"]
    assert list(psnr.index.unique("capture")) == ["still", "moving", "mean"]
    np.testing.assert_allclose(psnr["mean"], (psnr["still"] + psnr["moving"]) / 2)
    assert (psnr["still"] < psnr["moving"]).all()
    assert (tmp_path / "s" / "sweep.csv").is_file()
    assert (
        "wanted {capture} in the path, got none, with 2 captures" in result.not_computed["Theirs"]
    )
    other = dataclasses.replace(
        protocol, measurement=dataclasses.replace(protocol.measurement, ddof=0)
    )
    with pytest.raises(ProtocolError, match="wanted captures with one protocol"):
        plan_cells(tmp_path / "t", {"a": (noisy, protocol), "b": (demo_capture, other)}, sweep)


def test_a_sweep_without_a_method_is_refused(demo_capture, protocol, tmp_path):
    """Where no row can be computed nothing is prepared."""
    with pytest.raises(ProtocolError, match="no row has a method"):
        plan_cells(
            tmp_path / "s",
            {"": (demo_capture, protocol)},
            Sweep("x", "x", (SweepRow("Naive", "naive-to-come"),)),
        )
    assert not (tmp_path / "s").exists()


def test_captures_of_one_name_are_refused(demo_capture, tmp_path):
    """Their folders would be one."""
    with pytest.raises(SystemExit) as ended:
        run_command(
            [
                "sweep",
                "k",
                str(tmp_path / "s"),
                "--capture",
                str(demo_capture.path),
                str(demo_capture.path),
            ]
        )
    assert "differ in name" in str(ended.value.code)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name = 'x'\ndescribe = 'x'\n", "missing key row"),
        ("name = 'x'\ndescribe = 'x'\nrow = []\n", "at least one"),
        (
            "name = 'x'\ndescribe = 'x'\nk = [0]\n[[row]]\ntitle = 'a'\nmethod = 'b'\n",
            "k of at least 1",
        ),
        (f"name = 'x'\ndescribe = 'x'\n{ROW.format('A b')}{ROW.format('a-B')}", "titles"),
        ("name = 'x'\ndescribe = 'x'\n[[rows]]\ntitle = 'a'\n", "did you mean row"),
        (
            "name = 'x'\ndescribe = 'x'\nk = ['2']\n[[row]]\ntitle = 'a'\nmethod = 'b'\n",
            r"k\[0\] must be a whole number",
        ),
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
    packaged = (
        "ablations, ablations_short, baselines, budget, k, offline, online, readings, "
        "sparse, stream"
    )
    with pytest.raises(ProtocolError, match=rf"{packaged}.*; did you mean ablations\?"):
        load_sweep("ablation")
