"""The blending network's samples by a device, Warp's CPU device here: those of the compiled path,
and learned from like them.
"""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from ggvs_eval.compute_device import one_thread
from ggvs_eval.contrib.training import train_all, train_one
from ggvs_eval.contrib.training.blend_task import BlendTask
from ggvs_eval.contrib.training.loop import train
from ggvs_eval.contrib.training.request import TrainingOptions
from ggvs_eval.contrib.training.samples.sample_kinds import (
    OF_VIEWS,
    BlendKind,
    InstantKind,
    rendered_views,
)
from ggvs_eval.contrib.training.samples.samples import SamplePool
from ggvs_eval.contrib.training.samples.training_data import RoomPlan, domain_validation_plan
from ggvs_eval.contrib.worlds.domains import PLAIN
from ggvs_eval.pipelines.online.blend_network import BlendNetworkShape
from helpers.device_scenes import room_instants
from helpers.filled_pools import fill
from helpers.stereo_scenes import HEIGHT, WIDTH, write_capture

pytest.importorskip(
    "warp", reason="samples on a device want NVIDIA Warp: pip install 'ggvs-eval[gpu]'"
)

from ggvs_eval.contrib.warp import sampling

# the CPU as one device of several: Warp's, where a plain ``cpu`` is the compiled path
DEVICE = "cpu:0"
PLAN = RoomPlan(
    rooms=1, targets=2, views=2, other_views=(), other_share=0.0, width=WIDTH, height=HEIGHT
)
VALIDATION = domain_validation_plan(PLAIN, views=2, targets=1, size=(WIDTH, HEIGHT))
# the compiled splat fuses its multiply-adds, and `warp` takes images in [0, 1] where the device
# takes 8 bit
ROUNDING = 1e-5


def shared_out(moment):
    """The instant with sources of unlike shares, the nearest not first."""
    sources = [replace(source, share=1 - 0.2 * k) for k, source in enumerate(moment.sources)]
    return replace(moment, sources=tuple(reversed(sources)))


@pytest.mark.parametrize("pairs", [sampling.PAIRS_PER_GAUSSIAN, 0.1])
def test_views_are_those_of_the_compiled_path(pairs, monkeypatch):
    """Every map of a real room but for rounding, though room for pairs may lack at first; nearest
    views first.

    Where a last bit decides, a pixel may fall to the other side: of a Gaussian's least alpha, of a
    vote on contested depth.
    """
    monkeypatch.setattr(sampling, "PAIRS_PER_GAUSSIAN", pairs)
    moment = shared_out(room_instants()[1])
    (here, picture), (there, same) = (rendered_views(moment, device) for device in ("cpu", DEVICE))
    assert there.target is here.target
    assert there.sources == here.sources
    assert there.shares == here.shares
    for name in (*OF_VIEWS, "fused_depth"):
        ours, theirs = getattr(there, name), getattr(here, name)
        assert ours.dtype == theirs.dtype == np.float32
        assert ours.shape == theirs.shape
        assert (np.abs(ours - theirs) <= ROUNDING * (1 + theirs)).mean() >= 0.999, name
    assert same.dtype == np.float32
    assert (np.abs(same - picture) <= ROUNDING).mean() >= 0.999


@pytest.fixture(scope="module")
def pools(tmp_path_factory):
    """The samples of a training room and of a validation room, a plane before five cameras:
    compiled, and by the device.
    """
    capture, folder = (
        write_capture(tmp_path_factory.mktemp("plane"), n_frames=1),
        tmp_path_factory.mktemp("samples"),
    )
    kinds = BlendKind(), BlendKind(DEVICE)
    return [
        [fill(SamplePool(folder, kind, [plan]), lambda _: capture) for plan in (PLAN, VALIDATION)]
        for kind in kinds
    ]


def test_stored_samples_are_alike(pools):
    """Next to no pixel differs in 8 bit, or by more than rounding in depth; truth and cameras are
    the same.
    """
    here, there = (pool.read(1) for pool, _ in pools)
    for name in ("splats", "alphas", "warps", "visibilities"):
        assert (getattr(there.views, name) != getattr(here.views, name)).mean() < 1e-3
    assert (there.geometric != here.geometric).mean() < 1e-3
    np.testing.assert_array_equal(there.truth, here.truth)
    assert [camera.name for camera in there.views.sources] == [
        camera.name for camera in here.views.sources
    ]
    for name in ("depths", "fused_depth"):
        off = np.abs(getattr(there.views, name) - getattr(here.views, name))
        assert (off > 1e-4 * getattr(here.views, name)).mean() < 1e-3


def test_a_network_learns_from_them(pools, tmp_path):
    """Two steps and a validation; the loss of a batch is that of the compiled path's samples to a
    thousandth.
    """
    config = BlendNetworkShape(views=3, width=4)
    here, there = (
        BlendTask(*each, config, crop_width=64, crop_height=48, batch_size=2) for each in pools
    )
    with one_thread():
        assert train(there, tmp_path, TrainingOptions(steps=2, device="cpu", workers=0)).is_file()
        network = here.network()
        losses = [float(task.loss(network, task.batch(0))[0].detach()) for task in (here, there)]
    assert 0 < losses[1] == pytest.approx(losses[0], rel=1e-3)


def test_samples_of_a_device_lie_apart():
    """In a folder of their own, whichever GPU made them, beside the same rooms; the baselines' are
    not computed there.
    """
    folders = [BlendKind(device).folder(PLAN) for device in ("cpu", "cuda", "cuda:1", DEVICE)]
    assert folders[0] == BlendKind().folder(PLAN)
    assert folders[1] == folders[2]
    assert len(set(folders)) == 3
    assert InstantKind().device == "cpu"


def test_a_training_s_device_reaches_its_samples(tmp_path, monkeypatch):
    """That of the request, of one training and of all, in the worker too; without Warp the compiled
    path is taken.
    """
    prepared = []
    for module in (train_one, train_all):
        monkeypatch.setattr(
            module, "prepare_samples", lambda *samples: prepared.append(samples[1] + samples[0])
        )
    request = TrainingOptions(rooms=1, targets=1, domains=("plain",), views=2, device=DEVICE)
    for options in (request, replace(request, device="cpu")):
        train_one.planned_task("blend", tmp_path, options)
        train_all.prepare_all(tmp_path, options, [("blend", "registered")])
    monkeypatch.setattr(train_one, "DEVICE_PARTS", {})
    train_one.planned_task("blend", tmp_path, request)
    tasks = [[pickle.loads(pickle.dumps(task)) for task in samples.tasks()] for samples in prepared]
    assert [{task.make.args[1].device for task in made} for made in tasks] == [{DEVICE}] * 2 + [
        {"cpu"}
    ] * 3


def test_workers_that_share_a_gpu_fit_into_it(monkeypatch):
    """One per CPU where there is no GPU or memory enough, fewer on a small one, and always one."""
    monkeypatch.setattr(train_one, "usable_cpus", lambda: 16)
    counts = []
    for free in (100, 3, 0.5):
        monkeypatch.setattr(
            train_one.torch.cuda,
            "mem_get_info",
            lambda device, free=free: (int(free * 2**30), 2**37),
        )
        counts.append(train_one.sample_workers("cuda"))
    assert counts == [16, 3, 1]
    assert train_one.sample_workers("cpu") == 16
