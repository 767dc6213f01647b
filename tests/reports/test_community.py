"""Published tables of community protocols: whole, from somewhere, and beside runs on their own
terms alone.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ggvs_eval.protocol import Frames, load_protocol, packaged_protocols
from ggvs_eval.reports.model.measured import read_run
from ggvs_eval.reports.tables.published import community_beside, published_terms, published_values
from ggvs_eval.reports.tables.report_tables import main_tables
from helpers.run_folders import RunShape, write_run

QUALITY = ("PSNR", "SSIM", "LPIPS")


def beside(protocol, scenes=("flame_steak",), metrics=QUALITY, is_demo=False):
    runs = [SimpleNamespace(protocol=protocol, scene=scene, is_demo=is_demo) for scene in scenes]
    return community_beside("quality", protocol.dataset, metrics, runs)


def rows_of(*arguments, **named):
    rows, _ = beside(*arguments, **named)
    return {row.name: [cell.text for cell in row.cells] for row in rows}


def words_of(*arguments):
    return beside(*arguments)[1]


def test_every_value_has_terms_and_a_protocol():
    """Each table is of a packaged protocol, says where it is from, and holds numbers."""
    assert (
        {each.protocol for each in published_values()}
        == set(published_terms())
        <= set(packaged_protocols())
    )
    assert all(
        terms.source and terms.lpips_net and terms.frames and terms.checked
        for terms in published_terms().values()
    )
    assert all(float(each.value) > 0 for each in published_values())
    keys = [replace(value, value="") for value in published_values()]
    assert len(set(keys)) == len(keys)


@pytest.mark.parametrize("name", packaged_protocols())
def test_a_run_under_a_protocol_shows_its_row_and_no_other_run_does(name):
    """4DGS's value stands in runs under n3v_4dgs, and in those of no other packaged protocol."""
    rows = rows_of(load_protocol(name))
    assert ("4DGS (published, mean of 6 scenes)" in rows) == (name == "n3v_4dgs")
    if name == "n3v_4dgs":
        assert rows["4DGS (published, mean of 6 scenes)"] == ["31.15", "0.940", "0.049"]


@pytest.mark.parametrize(
    ("protocol", "method"),
    [("n3v_4dgs", "4DGS"), ("n3v_stg", "HyperReel"), ("n3v_3dgstream", "3DGStream")],
)
def test_scenes_have_the_published_mean(protocol, method):
    """PSNR of the six scenes, which a later paper quotes, averages to what the authors print."""
    values = {
        each.scene: float(each.value)
        for each in published_values()
        if (each.protocol, each.method, each.metric) == (protocol, method, "PSNR")
    }
    mean = values.pop("mean of 6 scenes")
    assert len(values) == 6
    assert np.mean(list(values.values())) == pytest.approx(mean, abs=0.005)


def test_values_of_a_scene_stand_beside_that_scene():
    """QUEEN's values are given by scene, an unknown one has none; those of fisheye images are
    withheld, for a stated reason.
    """
    protocol = load_protocol("n3v_queen")
    assert rows_of(protocol) == {"QUEEN (published, flame_steak)": ["34.16", "0.962", "0.125"]}
    assert list(rows_of(protocol, ("sear_steak", "flame_steak"))) == [
        "QUEEN (published, sear_steak)",
        "QUEEN (published, flame_steak)",
    ]
    assert rows_of(protocol, ("kitchen",)) == {}
    assert "kitchen is none of the published scenes" in words_of(protocol, ("kitchen",))[0]
    protocol = load_protocol("immersive_stg")
    assert rows_of(protocol, ("02_Flames",)) == {}
    (said,) = words_of(protocol, ("02_Flames",))
    assert said.endswith(
        "not shown: they are of the fisheye images, and frames are undistorted here."
    )


def test_sparse_values_are_those_of_the_authors_files():
    """RF-DeRF's flame_steak from three cameras over 300 frames and in its first, and SimpleNeRF's
    fern from two pictures.
    """
    rows = rows_of(load_protocol("n3v_sparse3"))
    assert rows["RF-DeRF (published, flame_steak)"] == ["27.95", "0.898", "0.286"]
    rows = rows_of(load_protocol("n3v_sparse3_instant"))
    assert rows == {"RF-DeRF (published, flame_steak)": ["28.04", "0.896", "0.288"]}
    rows = rows_of(load_protocol("llff_sparse2_fern"), scenes=("fern",))
    assert rows["SimpleNeRF (published, fern)"][0] == "17.01"


@pytest.mark.parametrize("run", [{"scenes": ("kitchen",)}, {"is_demo": True}])
@pytest.mark.parametrize("name", ["n3v_4dgs", "technicolor_stg"])
def test_a_mean_over_scenes_stands_beside_none_but_those(name, run):
    """A capture of one's own under a community's protocol has no published row, not that of the
    mean either.
    """
    assert rows_of(load_protocol(name), **run) == {}


@pytest.mark.parametrize(
    ("change", "differing"),
    [
        (lambda protocol: replace(protocol, frames=Frames(0, 100)), "frames"),
        (
            lambda protocol: replace(protocol, views=replace(protocol.views, test=("cam01",))),
            "views",
        ),
        (
            lambda protocol: replace(protocol, views=replace(protocol.views, keep_unsynced=False)),
            "views",
        ),
        (
            lambda protocol: replace(
                protocol, synthesis=replace(protocol.synthesis, width=676, height=507)
            ),
            "synthesis",
        ),
        (
            lambda protocol: replace(
                protocol, measurement=replace(protocol.measurement, lpips_net="vgg")
            ),
            "measurement",
        ),
        (lambda protocol: replace(protocol, dataset="DyNeRF"), "dataset"),
    ],
)
def test_other_terms_have_no_published_row(change, differing):
    """What is measured otherwise under the same name does not compare, and the caption says in what
    it differs.
    """
    protocol = change(load_protocol("n3v_4dgs"))
    assert rows_of(protocol) == {}
    (said,) = words_of(protocol, ("flame_steak",))
    assert (
        said == f"Published values of n3v_4dgs are not shown: this run differs from the packaged "
        f"protocol in {differing}."
    )


def test_more_metrics_and_sources_change_no_published_value():
    """K, further metrics and ceilings are the run's own; what is published beyond the columns is
    told.
    """
    protocol = load_protocol("n3v_4dgs")
    measurement = replace(protocol.measurement, metrics=("PSNR", "TCC"), ceilings=False)
    protocol = replace(
        protocol,
        synthesis=replace(protocol.synthesis, k=8, sources="coverage"),
        measurement=measurement,
    )
    rows = rows_of(protocol, metrics=("PSNR", "TCC"))
    assert rows == {
        "4DGS (published, mean of 6 scenes)": ["31.15", "not reported"],
        "4DGS (published, flame_steak)": ["32.51", "not reported"],
    }
    told, beyond = words_of(protocol, ("flame_steak",))
    assert "LPIPS: alex; D-SSIM: (1 - MS-SSIM) / 2." in told
    assert (
        beyond
        == "Published too: SSIM 0.940 of 4DGS (mean of 6 scenes), LPIPS 0.049 of 4DGS (mean of 6 "
        "scenes), " + ("D-SSIM 0.016 of 4DGS (mean of 6 scenes).")
    )


def test_the_row_stands_in_the_quality_table(tmp_path):
    """In a report the row is grey, takes no part in the ranking, and the caption names its
    source.
    """
    shape = RunShape(views=("cam00",), metrics=("PSNR", "LPIPS"), poses=0, scene="flame_steak")
    run = read_run(write_run(tmp_path / "run", shape))
    protocol = load_protocol("n3v_4dgs")
    protocol = replace(protocol, measurement=replace(protocol.measurement, metrics=("PSNR",)))
    (table, *_) = main_tables([replace(run, protocol=protocol)], run.results)
    assert [row.name for row in table.rows[-2:]] == [
        "4DGS (published, mean of 6 scenes)",
        "4DGS (published, flame_steak)",
    ]
    assert table.rows[-1].is_grey
    assert not table.rows[-1].cells[0].best
    assert "Grey: Wu et al." in " ".join(table.notes)
    assert all("published" not in row.name for row in main_tables([run], run.results)[0].rows)
