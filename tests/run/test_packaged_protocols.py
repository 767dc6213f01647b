"""The protocols of the three data sets say what the paper says, and what it leaves open is marked as ours."""

from pathlib import Path

import pytest

from ggvs_eval.capture import Capture
from ggvs_eval.pipelines.run.suggest_protocol import suggest_protocol
from ggvs_eval.protocol import load_protocol, packaged_protocols
from ggvs_eval.reports.tables.published import published_terms
from helpers.captures import make_rig

PAPERS = [name for name, terms in published_terms().items() if terms.layouts]
COMMUNITY = [name for name in published_terms() if name not in PAPERS]


def rig_of(layout: str, names: list[str], n_frames: int, size: tuple[int, int] = (64, 48)) -> Capture:
    cameras = tuple(make_rig(names, *size))
    return Capture("scene", layout, Path("scene"), cameras, (), n_frames, 30.0, 1.0, "guess")


@pytest.mark.parametrize(
    ("name", "views", "k", "size", "measured"),
    [
        ("dynerf", 9, 4, (1352, 1014), (0, 0)),
        ("enerf-outdoor", 3, 4, (960, 540), (480, 270)),
        ("d3dmv", 4, 2, (640, 360), (0, 0)),
    ],
)
def test_protocols_are_the_papers(name, views, k, size, measured):
    """Views, K, frames and sizes as in the paper's section on evaluation; metrics of ENeRF-Outdoor at half size."""
    protocol = load_protocol(name)

    assert len(protocol.views.test) == views
    assert protocol.synthesis.k == k
    assert (protocol.frames.start, protocol.frames.count) == (0, 100)
    assert (protocol.synthesis.width, protocol.synthesis.height) == size
    assert (protocol.measurement.width, protocol.measurement.height) == measured


@pytest.mark.parametrize("name", packaged_protocols())
def test_who_chose_the_views_is_said(name):
    """The paper does not say which cameras it tests, so its lists say that they are ours; the others are their authors'."""
    by = "the authors" if name in COMMUNITY else "us"
    assert load_protocol(name).views.chosen_by.startswith(f"chosen by {by}: ")


@pytest.mark.parametrize("name", COMMUNITY)
def test_community_protocols_stand_apart_from_the_papers(name):
    """The authors' cameras are held out, at the published size, under a name of the data set that has no row of the paper."""
    protocol = load_protocol(name)
    assert len(protocol.views.test) == (4 if name.startswith(("panoptic", "llff")) else 1)
    assert protocol.dataset not in {load_protocol(paper).dataset for paper in PAPERS}
    assert protocol.views.keep_unsynced == (name in ("n3v_4dgs", "n3v_stg"))
    if name.startswith("n3v_"):
        assert (protocol.frames.numbers, protocol.views.test) == (range(300), ("cam00",))
        assert (protocol.synthesis.width, protocol.synthesis.height) == (1352, 1014)


@pytest.mark.parametrize(
    ("layout", "names", "wanted"),
    [
        ("dynerf", [f"cam{number:02d}" for number in range(21)], "dynerf"),
        ("enerf-outdoor", [f"{number:02d}" for number in range(18)], "enerf-outdoor"),
        ("d3dmv", [f"cam{number:02d}" for number in range(10)], "d3dmv"),
    ],
)
def test_a_capture_gets_the_protocol_of_its_layout(layout, names, wanted):
    """A whole scene of a data set is evaluated under its packaged protocol."""
    assert suggest_protocol(rig_of(layout, names, 300)).name == wanted


def test_a_small_rig_gets_its_layouts_rules_at_its_own_size():
    """Too short for the packaged protocol: views by rule, K of the layout or the cameras, metrics at that share of the size."""
    suggested = suggest_protocol(rig_of("enerf-outdoor", ["00", "01", "02", "03", "04"], 7, (320, 180)))

    assert suggested.views.test == ("01", "03")
    assert suggested.frames.count == 7
    assert suggested.synthesis.k == load_protocol("enerf-outdoor").synthesis.k
    assert (suggested.measurement.width, suggested.measurement.height) == (160, 90)
    assert suggested.dataset == "scene"
    suggested = suggest_protocol(rig_of("colmap", ["a", "b", "c"], 1))

    assert suggested.synthesis.k == 2
    assert suggested.synthesis.width == 0
