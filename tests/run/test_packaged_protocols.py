"""The protocols of the three data sets say what the paper says, and what it leaves open is marked
as ours.
"""

from pathlib import Path

import pytest

from ggvs_eval.capture import Capture
from ggvs_eval.errors import ProtocolError
from ggvs_eval.pipelines.run.suggest_protocol import suggest_protocol
from ggvs_eval.protocol import load_protocol, packaged_protocols
from ggvs_eval.reports.tables.published import published_terms
from helpers.captures import make_rig
from helpers.refusals import refused

PAPERS = [name for name, terms in published_terms().items() if terms.layouts]
COMMUNITY = [name for name in published_terms() if name not in PAPERS]


def rig_of(
    layout: str, names: list[str], n_frames: int, size: tuple[int, int] = (64, 48)
) -> Capture:
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
    """Views, K, frames and sizes as in the paper's section on evaluation; metrics of ENeRF-Outdoor
    at half size.
    """
    protocol = load_protocol(name)

    assert len(protocol.views.test) == views
    assert protocol.synthesis.k == k
    assert (protocol.frames.start, protocol.frames.count) == (0, 100)
    assert (protocol.synthesis.width, protocol.synthesis.height) == size
    assert (protocol.measurement.width, protocol.measurement.height) == measured


@pytest.mark.parametrize("name", packaged_protocols())
def test_who_chose_the_views_is_said(name):
    """The paper does not say which cameras it tests, so its lists say that they are ours; the
    others are their authors'.
    """
    by = "the authors" if name in COMMUNITY else "us"
    assert load_protocol(name).views.chosen_by.startswith(f"chosen by {by}: ")


@pytest.mark.parametrize("name", COMMUNITY)
def test_community_protocols_stand_apart_from_the_papers(name):
    """The authors' cameras are held out, at the published size, under a name of the data set that
    has no row of the paper.
    """
    protocol = load_protocol(name)
    counts = {"panoptic": {4}, "llff_3view": {4}, "llff_sparse": {3, 4, 5, 6, 7, 8}}
    assert len(protocol.views.test) in next(
        (count for key, count in counts.items() if name.startswith(key)), {1}
    )
    assert protocol.dataset not in {load_protocol(paper).dataset for paper in PAPERS}
    assert protocol.views.keep_unsynced == (name in ("n3v_4dgs", "n3v_stg"))
    if name.startswith("n3v_") and not name.endswith("_instant"):
        assert (protocol.frames.numbers, protocol.views.test) == (range(300), ("cam00",))
        assert (protocol.synthesis.width, protocol.synthesis.height) == (1352, 1014)


@pytest.mark.parametrize(
    ("scene", "sources"),
    [
        ("coffee_martini", "04 09 14"),
        ("cut_roasted_beef", "05 10 15"),
        ("flame_salmon_1", "05 09 14"),
        ("sear_steak", "05 11 16"),
    ],
)
def test_the_sources_of_a_scene_are_part_of_the_protocol(scene, sources):
    """RF-DeRF's three cameras of each scene; the protocol, and so its hash, is the same."""
    views = load_protocol("n3v_sparse3").views
    assert views.sources_of(scene) == tuple(f"cam{number}" for number in sources.split())


def test_a_scene_without_named_sources_is_refused():
    """Its sources are not guessed: the scenes are listed, with the way out."""
    with refused(ProtocolError, "coffee_martini", "got the scene kitchen", "rename its folder"):
        load_protocol("n3v_sparse2").views.sources_of("kitchen")


@pytest.mark.parametrize("name", [name for name in COMMUNITY if "_sparse" in name])
def test_sparse_protocols_show_as_many_cameras_as_they_say(name):
    """No test view is among the sources, and K is their number."""
    views, synthesis = load_protocol(name).views, load_protocol(name).synthesis
    lists = [entry.sources for entry in views.of_scenes] or [views.sources]

    assert {len(sources) for sources in lists} == {synthesis.k}
    assert name.startswith((f"n3v_sparse{synthesis.k}", f"llff_sparse{synthesis.k}"))
    assert not any(set(sources) & set(views.test) for sources in lists)


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
    """Too short for the packaged protocol: views by rule, K of the layout or the cameras, metrics
    at that share of the size.
    """
    suggested = suggest_protocol(
        rig_of("enerf-outdoor", ["00", "01", "02", "03", "04"], 7, (320, 180))
    )

    assert suggested.views.test == ("01", "03")
    assert suggested.frames.count == 7
    assert suggested.synthesis.k == load_protocol("enerf-outdoor").synthesis.k
    assert (suggested.measurement.width, suggested.measurement.height) == (160, 90)
    assert suggested.dataset == "scene"
    suggested = suggest_protocol(rig_of("colmap", ["a", "b", "c"], 1))

    assert suggested.synthesis.k == 2
    assert suggested.synthesis.width == 0
