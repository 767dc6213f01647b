"""The choice of sources goes through a whole run: the same for all methods, and along the path with shares that follow it."""

from dataclasses import replace

import pytest

from ggvs_eval.datasets import open_capture
from ggvs_eval.errors import CameraError
from ggvs_eval.geometry.source_views import choose_sources
from ggvs_eval.pipelines.evaluate import measure, reopen
from ggvs_eval.pipelines.offline.depth_choice import DepthChoice
from ggvs_eval.pipelines.render import render_jobs
from ggvs_eval.pipelines.suggest_protocol import suggest_protocol
from ggvs_eval.pipelines.synthesizer import OnlineSynthesizer
from ggvs_eval.results import Results
from ggvs_eval.run_folder import RunFolder, read_json
from ggvs_eval.synthetic.demo import write_demo
from scenes import camera_at, look
from small_runs import LABELS, small_protocol, write_small_capture
from small_runs import small_options as rig_options


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return write_small_capture(tmp_path_factory.mktemp("rig") / "room", 2)


def chosen_protocol(sources: str):
    base = small_protocol(2, 6, ("PSNR", "switch_ratio"))
    return replace(base, synthesis=replace(base.synthesis, sources=sources))


def test_a_run_takes_the_chosen_sources(capture, tmp_path):
    """Views and path are synthesised from what `choose_sources` gives; the record of the path says so; scores come out."""
    protocol = chosen_protocol("coverage")
    measure(tmp_path, capture, protocol, LABELS, 1, DepthChoice("sgbm"))
    prepared = reopen(tmp_path, 1)
    for view, plan in prepared.plans.items():
        chosen = choose_sources(plan.target, prepared.capture.cameras, 2, "coverage")
        assert [*plan.depth_keys] == [*plan.shares] == [each.camera.name for each in chosen], view
        assert set(plan.shares.values()) == {1.0}  # a view that stands still
    for plan, recorded in zip(prepared.path, read_json(RunFolder(tmp_path).path_record)["sources"], strict=True):
        chosen = choose_sources(plan.target, prepared.capture.cameras, 2, "coverage")
        assert plan.shares == {each.camera.name: each.share for each in chosen}
        assert recorded == [*plan.shares]
    assert not Results.read(tmp_path).per_view("PSNR").isna().any(axis=None)


def test_shares_are_part_of_what_a_rendering_depends_on(capture, tmp_path):
    """Other shares, another job; equal ones, the same."""
    measure(tmp_path, capture, chosen_protocol("nearest"), LABELS[:1], 1, DepthChoice("sgbm"))
    prepared = reopen(tmp_path, 1)
    assert all(job.is_done() for job in render_jobs(prepared, LABELS[:1]))
    halved = tuple(replace(plan, shares=dict.fromkeys(plan.shares, 0.5)) for plan in prepared.path)
    *views, path = render_jobs(replace(prepared, path=halved), LABELS[:1])
    assert all(job.is_done() for job in views)
    assert not path.is_done()


@pytest.mark.parametrize("sources", ["nearest", "coverage"])
def test_a_live_method_is_told_the_shares(sources):
    """Each step's views carry the share of their choice; near an exchange one of them has hardly any."""
    rig, told = [camera_at(x) for x in (-0.45, -0.15, 0.15, 0.45)], []

    class Watching:
        def step(self, instant):
            told.append({view.camera.name: view.share for view in instant.sources})
            return None

    live = OnlineSynthesizer(rig, 2, 2.5, Watching, sources=sources)
    looks = {camera.name: look(camera) for camera in rig}
    images, depths = ({name: each[index] for name, each in looks.items()} for index in (0, 1))
    targets = [camera_at(x, name="virtual") for x in (-0.33, 0.0, 0.01)]
    for target in targets:
        live.step(images, depths, target)
        chosen = choose_sources(target, rig, 2, sources)
        assert told[-1] == {each.camera.name: each.share for each in chosen}
        assert [camera.name for camera in live.sources(target)] == [*told[-1]]
    assert min(min(shares.values()) for shares in told) < 1


def test_an_unknown_choice_is_one_line():
    """Said when the synthesizer is made."""
    with pytest.raises(CameraError, match="wanted sources to be one of nearest, coverage, got 'covrage'"):
        OnlineSynthesizer([camera_at(0.0), camera_at(0.3)], 1, sources="covrage")  # type: ignore[arg-type]


def test_a_hand_held_sequence_is_suggested_coverage(tmp_path, capture):
    """Nearest places of a camera that was carried may look elsewhere; a rig keeps the paper's choice."""
    options = replace(rig_options(6), layout="rgbd", fps=3.0)
    sequence = open_capture(write_demo(tmp_path / "walk", options, workers=1))
    assert suggest_protocol(replace(sequence, units_origin="metric")).synthesis.sources == "coverage"
    assert suggest_protocol(replace(capture, units_origin="by hand")).synthesis.sources == "nearest"
