"""RAFT-Stereo on a device: the CPU's disparity, by the way that a GPU takes; keys, runs and
commands that name the device.

``cpu:0`` is the CPU by another name than ``cpu``, so that all of the device's way runs here. What
is compared is the same to 1e-3 pixels in at least 99.9 % of the pixels: the order of sums differs,
and a pixel may pass the check here and fail it there.
"""

import json
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from ggvs_eval.compute_device import rendering_on
from ggvs_eval.contrib.view import viewer
from ggvs_eval.datasets import open_capture
from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.errors import DeviceError
from ggvs_eval.files.images import quantise
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.pipelines.methods.network_options import NetworkOptions
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.pipelines.offline.depth.depth_choice import find_matcher
from ggvs_eval.pipelines.offline.stereo import raft_matcher
from ggvs_eval.pipelines.offline.stereo.matcher import left_right_gap, refine_disparity
from ggvs_eval.pipelines.offline.stereo.raft_matcher import (
    RaftMatcher,
    load_network,
    shipped_weights,
    weights_digest,
)
from ggvs_eval.pipelines.offline.stereo.raft_stereo import RaftStereo
from ggvs_eval.pipelines.play import playback
from ggvs_eval.pipelines.run import outlook
from ggvs_eval.pipelines.run.prepare import prepare_run
from ggvs_eval.pipelines.run.run_plan import RunRequest, plan_run
from helpers.captures import write_dynerf
from helpers.command_line import refusal
from helpers.refusals import refused
from helpers.small_runs import small_protocol
from helpers.stereo_scenes import random_texture

RAFT, SGBM = DepthRunOptions("raft"), DepthRunOptions("sgbm")
ELSEWHERE = NetworkOptions(device="cpu:0")
# operations whose result the host must see
WAITS = ("_local_scalar_dense", "nonzero", "masked_select", "equal", "unique")


@cache
def pair():
    """A pair (96, 141, 3) of a waved surface and a box before it: no side is a multiple of 32, no
    margin even.
    """
    rows, columns = np.indices((96, 141), dtype=np.float32)
    box = (np.abs(columns - 80) < 20) & (np.abs(rows - 50) < 15)
    disparity = (
        12 + 3 * np.sin(columns / 20) + 2 * np.cos(rows / 15) + np.where(box, np.float32(6), 0)
    )
    grey = quantise(cv2.GaussianBlur(random_texture()[::3, ::3], (0, 0), 0.5)[:96, :141])
    right = np.repeat(grey[..., None], 3, axis=-1)
    left = cv2.remap(
        right, columns - disparity, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return left, right, 0, 40


def assert_alike(there, here):
    """Two disparities of a matcher, (H, W), 0 = rejected."""
    assert there.shape == here.shape
    assert there.dtype == here.dtype
    assert (here > 0).mean() > 0.5
    assert (np.abs(there - here) <= 1e-3).mean() >= 0.999


@pytest.mark.parametrize(
    "changes",
    [
        {"largest_side_px": 100},
        pytest.param({"from_matching": False, "refine_window": 6}, marks=pytest.mark.slow),
    ],
    ids=["half", "whole"],
)
def test_a_pair_is_matched_as_on_the_cpu(changes):
    """Disparity and confidence of a pair, at half size from matching and at full size from
    nothing.
    """
    here, there = (
        replace(find_matcher("raft", device), **changes).match(*pair())
        for device in ("cpu", "cpu:0")
    )
    assert_alike(there[0], here[0])
    assert (np.abs(there[1] - here[1]) <= 1e-3).mean() >= 0.999
    assert ((there[0] > 0) == (there[1] > 0)).all()


@pytest.mark.slow
def test_nothing_is_computed_elsewhere_and_nothing_waits():
    """No tensor is made on a default device, the host sees nothing before the end, and uploads are
    one of each kind.
    """
    operations = []

    class Watched(TorchDispatchMode):
        def __torch_dispatch__(self, function, types, args=(), kwargs=None):
            operations.append(str(function))
            return function(*args, **(kwargs or {}))

    matcher = find_matcher("raft", "cpu:0")
    disparity, _ = matcher.match(*pair())
    with torch.device("meta"), Watched():  # what names no device would have no values
        again, _ = matcher.match(*pair())
    np.testing.assert_array_equal(again, disparity)
    assert len(operations) > 100
    assert not [name for name in operations if any(wait in name for wait in WAITS)]


def test_a_pair_without_a_match_is_refined_to_nothing():
    """Where all is rejected, nothing is not a number."""
    grey, nothing = torch.rand(40, 60), torch.zeros(40, 60)
    assert not raft_matcher.refine_disparity(grey, grey, nothing, 7, 2).any()


def test_refinement_finds_what_opencv_finds():
    """On noise, and on disparities that leave the image."""
    random = np.random.default_rng(1)
    left, right = random.integers(0, 256, (2, 50, 70), dtype=np.uint8)
    disparity = np.where(random.random((50, 70)) < 0.8, random.uniform(0, 30, (50, 70)), 0).astype(
        np.float32
    )
    there = raft_matcher.refine_disparity(
        *(torch.from_numpy(each).float() for each in (left, right, disparity)), 7, 2
    )
    np.testing.assert_allclose(
        there.numpy(), refine_disparity(left, right, disparity, 7, 2), atol=1e-3
    )


def test_the_check_is_that_of_opencv():
    """The right image's disparity at the matched column, inf where it has none or does not show the
    point.
    """
    left, right = np.random.default_rng(2).uniform(0, 30, (2, 50, 70)).astype(np.float32)
    right[10:20] = 0
    there = raft_matcher.left_right_gap(torch.from_numpy(left), torch.from_numpy(right)).numpy()
    np.testing.assert_array_equal(there, left_right_gap(left, right))


@pytest.mark.filterwarnings("ignore:for .* to a meta parameter")
def test_a_network_is_loaded_once_for_each_device():
    """The CPU's own stays where it is, also where a device computes already as the file is first
    read.
    """
    load_network.cache_clear()
    with rendering_on(torch.device("meta")):
        there = load_network(shipped_weights(), torch.device("meta"))
    here = load_network(shipped_weights(), torch.device("cpu"))
    assert here is load_network(shipped_weights(), torch.device("cpu"))
    assert [{each.device.type for each in network.parameters()} for network in (here, there)] == [
        {"cpu"},
        {"meta"},
    ]


def test_keys_name_the_device_and_those_of_the_cpu_do_not():
    """What a key is made from tells another device; of the CPU it says what it said before there
    was any other.
    """
    weights = shipped_weights()
    plain = DepthOptions(matcher=RaftMatcher(weights, weights_digest(weights))).describe()
    here, there, other = (RAFT.options(device).describe() for device in ("cpu", "cpu:0", "cuda"))
    assert plain == RAFT.options().describe() == here
    assert "device" not in here["matcher"]
    assert there["matcher"] == here["matcher"] | {"device": "cpu:0"}
    assert other["matcher"]["device"] == "cuda"
    assert json.loads(json.dumps(there)) == there
    for matcher in ("sgbm", "live", "sweep"):
        assert (
            DepthRunOptions(matcher).options("cuda").describe()
            == DepthRunOptions(matcher).options().describe()
        )


def test_a_device_that_is_not_there_is_refused_first(monkeypatch):
    """Before a network is loaded or an image is looked at."""
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 0)
    for name, reason in (("gpu", "wanted cpu, cuda"), ("cuda:1", "finds 0 GPUs")):
        matcher = find_matcher("raft", name)
        for work in (matcher.match, matcher.disparity):
            with pytest.raises(DeviceError, match=reason):
                work(None, None, 0, 16)


@pytest.fixture(scope="module")
def five_cameras(tmp_path_factory):
    return open_capture(
        write_dynerf(tmp_path_factory.mktemp("filmed"), [f"cam{index:02d}" for index in range(5)])
    )


@pytest.fixture
def request_for(five_cameras, tmp_path):
    """Makes requests for one run folder."""
    return lambda depth, networks: RunRequest(
        tmp_path / "run",
        five_cameras,
        small_protocol(1, 0, ("PSNR",)),
        (),
        depth,
        networks=networks,
    )


def test_a_plan_takes_depth_to_the_device(request_for):
    """Learned depth, and no other; its jobs have keys of their own."""
    there, here = (
        plan_run(request_for(RAFT, networks)) for networks in (ELSEWHERE, NetworkOptions())
    )
    assert there.depth.options.matcher.device == "cpu:0"
    assert type(here.depth.options.matcher) is RaftMatcher
    assert not {job.key for job in there.view_jobs} & {job.key for job in here.view_jobs}
    by_matching = [
        plan_run(request_for(SGBM, networks)) for networks in (ELSEWHERE, NetworkOptions())
    ]
    assert by_matching[0].view_jobs == by_matching[1].view_jobs
    assert by_matching[0].depth.device == "cpu"
    with pytest.raises(DeviceError, match="device 'gpu': wanted cpu"):
        plan_run(request_for(RAFT, NetworkOptions(device="gpu")))


@pytest.mark.slow
def test_a_run_goes_on_where_its_depth_was_begun(request_for, monkeypatch):
    """Its record names the device; later calls find its maps from anywhere, and miss the device
    only where a map is missing.
    """
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 0)
    plan = plan_run(request_for(RAFT, ELSEWHERE))
    run = plan.run
    prepare_run(plan)
    assert json.loads(run.depth_record.read_text())["device"] == "cpu:0"
    for depth in (RAFT, None):
        again = plan_run(request_for(depth, NetworkOptions()))
        assert again.view_jobs == plan.view_jobs
    run.depth_record.write_text(json.dumps(RAFT.record("cuda")))
    begun = plan_run(request_for(None, NetworkOptions()))
    assert begun.depth.device == "cuda"
    with refused(DeviceError, "depth.json", "cuda", "new run folder"):
        prepare_run(begun)
    # as it was written before there were devices
    run.depth_record.write_text(json.dumps(RAFT.record()))
    assert "device" not in RAFT.record()
    assert type(plan_run(request_for(None, ELSEWHERE)).depth.options.matcher) is RaftMatcher


def test_the_command_line_takes_depth_to_the_device(five_cameras, tmp_path, monkeypatch):
    """Every verb that finds depth passes `--device` on to the network that finds it; one that is
    not there ends it.
    """
    plans, options = [], []

    def end(_capture, _options, depth, *_rest):
        options.append(depth)
        raise DeviceError("far enough")

    monkeypatch.setattr(outlook, "print_plan", lambda planned, *_: plans.extend(planned))
    monkeypatch.setattr(playback, "playback_of_capture", end)
    monkeypatch.setattr(viewer, "require_viser", lambda: None)
    words = ("--matcher", "raft", "--device", "cpu:0")
    protocol = tmp_path / "small.toml"
    protocol.write_text(small_protocol(1, 0, ("PSNR",)).to_toml())
    of_capture = (
        "--capture",
        str(five_cameras.path),
        "--protocol",
        str(protocol),
        *words,
        "--dry-run",
    )
    for command in (("prepare",), ("run",), ("sweep", "k")):
        run_command([*command, str(tmp_path / "out"), *of_capture])
    for command in (
        ("play", five_cameras.path, tmp_path / "out.mp4"),
        ("view", five_cameras.path, "--out", tmp_path / "view"),
    ):
        assert refusal(*command, *words).endswith("far enough")
    assert {plan.depth.options.matcher.device for plan in plans} == {"cpu:0"}
    assert len(plans) >= 3
    assert [each.matcher.device for each in options] == ["cpu:0", "cpu:0"]
    assert "gpu" in refusal(
        "prepare",
        tmp_path / "run",
        "--capture",
        five_cameras.path,
        "--matcher",
        "raft",
        "--device",
        "gpu",
    )
    assert list(tmp_path.iterdir()) == [protocol]


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="torch finds no GPU here")
def test_a_gpu_finds_what_the_cpu_finds(monkeypatch):
    """Within 0.1 px, twice the same, and the host never waits for the network."""

    def watched(work):
        def without_waiting(*arguments):
            torch.cuda.set_sync_debug_mode("error")
            try:
                return work(*arguments)
            finally:
                torch.cuda.set_sync_debug_mode("default")

        return without_waiting

    here, _ = find_matcher("raft").match(*pair())
    find_matcher("raft", "cuda").match(*pair())
    for name in ("features", "walk"):
        monkeypatch.setattr(RaftStereo, name, watched(getattr(RaftStereo, name)))
    monkeypatch.setattr(raft_matcher, "refine_disparity", watched(raft_matcher.refine_disparity))
    there, again = (find_matcher("raft", "cuda").match(*pair())[0] for _ in range(2))
    assert (((there > 0) == (here > 0)) & (np.abs(there - here) <= 0.1)).mean() >= 0.99
    np.testing.assert_array_equal(there, again)
