"""What a plan tries and what it can say without: scoring by one method's frames, a demo that is not rendered yet."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.datasets import open_capture
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.images import write_image
from ggvs_eval.metrics.fetch_lpips import weights_path
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.pipelines.planning import plan as run_plan
from ggvs_eval.pipelines.planning.demo_plan import demo_to_plan
from ggvs_eval.pipelines.planning.estimate import Portion
from ggvs_eval.pipelines.planning.plan import plan_runs
from ggvs_eval.pipelines.planning.run_request import RunRequest
from ggvs_eval.pipelines.planning.score_trial import try_scoring
from ggvs_eval.pipelines.planning.work_left import plan_frames
from ggvs_eval.run_folder import RunFolder, frame_path
from helpers.small_runs import LABELS, small_options, small_protocol, write_small_capture

PROTOCOL = small_protocol(3, 3, ("PSNR", "L1", "PSNR_disoccluded"))


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return write_small_capture(tmp_path_factory.mktemp("capture") / "demo", 3)


def counts(portion: Portion) -> list[int]:
    """How much of each kind is left."""
    left = portion.left
    parts = (left.truth, left.found_depth, left.checked_depth, left.disoccluded, left.renders, left.scores)
    return [sum(part.values()) for part in parts] + [left.path_depth, left.n_rendered, portion.n_pixels]


def test_a_demo_is_planned_before_it_is_filmed(capture, tmp_path, monkeypatch):
    """A demo that is not there yet is planned like the rendered one, without a trial, and says what will be rendered."""
    unfilmed = demo_to_plan(tmp_path / "demo", small_options(3), open_capture)
    rendered = demo_to_plan(capture.path, small_options(3), open_capture)
    same = plan_runs([RunRequest(tmp_path / "run", rendered, PROTOCOL, LABELS)], 1, tmp_path)
    monkeypatch.setattr(run_plan, "PROBED_FROM_PIXELS", 0)
    plan = plan_runs([RunRequest(tmp_path / "run", unfilmed, PROTOCOL, LABELS)], 1, tmp_path)

    assert [counts(each) for each in plan.portions] == [counts(each) for each in same.portions]
    assert plan.rates is None
    assert plan.describe().startswith("film: the demo is rendered first, 6 cameras x 3 frames at 64 x 48, into ")
    assert plan.describe().splitlines()[1] == same.describe().splitlines()[0]
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(CaptureError, match="the demo is not rendered"):
        list(unfilmed.frames("cam00", 0, 1))


@pytest.mark.skipif(not weights_path("alex").is_file(), reason="the weights of LPIPS are not on this machine")
def test_scoring_is_tried_on_one_method(capture, tmp_path):
    """The trial wants the frames of the first method alone, and what it says of an instant includes LPIPS, which dominates."""
    measurement = dataclasses.replace(PROTOCOL.measurement, metrics=("L1", "LPIPS", "TCC"), lpips_net="alex")
    protocol = dataclasses.replace(PROTOCOL, measurement=measurement)
    planned, _ = plan_frames(tmp_path / "run", capture, protocol, DepthOptions())
    scratch, truth = RunFolder(tmp_path / "scratch"), tmp_path / "truth"
    write_frames(truth / "cam00", 1)
    write_frames(scratch.renders(LABELS[0], "cam00"), 2)

    setup_s, instant_s, plain_s = try_scoring(planned, scratch, "cam00", range(3), LABELS, truth)

    assert setup_s > 0
    assert instant_s > len(LABELS) * plain_s > 0
    assert try_scoring(planned, scratch, "cam00", range(3), [], truth) == (0.0, 0.0, 0.0)


def write_frames(folder: Path, seed: int) -> None:
    """Three noisy pictures."""
    random = np.random.default_rng(seed)
    for index in range(3):
        write_image(frame_path(folder, index), random.integers(0, 256, (48, 64, 3), np.uint8))


def test_a_run_that_goes_on_is_tried_as_well(capture, tmp_path, monkeypatch):
    """What the first trial stored is not found again; the second still measures how long depth takes, as long as some is left."""
    requests = [RunRequest(tmp_path / "run", capture, PROTOCOL, LABELS)]
    untried = plan_runs(requests, 1, tmp_path)
    monkeypatch.setattr(run_plan, "PROBED_FROM_PIXELS", 0)
    tried = [plan_runs(requests, 1, tmp_path) for _ in range(2)]

    assert [counts(plan.portions[0]) for plan in tried[1:]] == [counts(tried[0].portions[0])] != [counts(untried.portions[0])]
    for plan in tried:
        assert plan.rates.depth_s > 0


def test_pictures_of_the_inside_count_with_their_frame(capture, tmp_path, monkeypatch):
    """A frame of ours takes what it and the four small pictures behind it take, not the mean of five pictures."""
    monkeypatch.setattr(run_plan, "PROBED_FROM_PIXELS", 0)
    plan = plan_runs([RunRequest(tmp_path / "run", capture, PROTOCOL, ("ours",))], 1, tmp_path)

    assert plan.rates.render_bytes > 1.5 * 64 * 48
