"""On a GPU: methods with networks render what they render on the CPU, and samples are what they are
there, but for a little.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch

from ggvs_eval.compute_device import compute_device, describe_device
from ggvs_eval.contrib.training.samples.sample_kinds import OF_VIEWS, rendered_views
from ggvs_eval.pipelines.methods.network_options import NetworkOptions
from ggvs_eval.pipelines.methods.registry import find_method
from helpers.device_scenes import room_instants
from helpers.scenes import camera_at, instant
from helpers.seeded_baselines import turned_rig

pytestmark = [
    pytest.mark.gpu,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="torch finds no GPU here"),
]

LEARNED = (
    "fwd",
    "ibrnet",
    "gps-gaussian+given-depth",
    "enerf",
    "mvsplat",
    "ours",
    "ours+no-tsdf",
    "ours+no-temporal",
    "naive",
)
LEVEL = 1 / 255


@pytest.mark.parametrize("views", [2, 4])
@pytest.mark.parametrize("label", LEARNED)
def test_a_render_is_that_of_the_cpu(label, views):
    """All but a few pixels within a level, and the same stages; the few lie where rounding decides
    between two surfaces.
    """
    moment = turned_rig(views)
    here, there = (
        find_method(label, NetworkOptions(device=device)).make().step(moment)
        for device in ("cpu", "cuda")
    )
    off = np.abs(here.image - there.image).max(axis=-1)
    assert there.image.dtype == np.float32
    assert there.image.shape == here.image.shape
    assert (off > LEVEL).mean() < 0.005
    assert np.median(off) < LEVEL / 20
    assert sum(there.seconds.values()) > 0
    if here.depth is not None:
        assert there.depth is not None
        assert (np.abs(here.depth - there.depth) > 0.01 * here.depth + 1e-6).mean() < 0.01
    assert there.diagnostics.keys() == here.diagnostics.keys()
    for name, found in there.diagnostics.items():
        np.testing.assert_allclose(found, here.diagnostics[name], atol=1e-3)


@pytest.mark.parametrize("label", ["ours", "fwd"])
def test_both_devices_may_take_turns(label):
    """Networks of two devices in one process do not get mixed up, and a sequence stays together."""
    target, sources = (
        camera_at(0.0, name="virtual"),
        [camera_at(x, y) for x, y in ((-0.3, 0.1), (0.3, -0.1), (0.1, 0.3))],
    )
    methods = [
        find_method(label, NetworkOptions(device=device)).make() for device in ("cpu", "cuda")
    ]
    for index in range(3):
        images = [
            method.step(instant(index, target, sources, 0.1 * index)).image for method in methods
        ]
        assert (np.abs(images[0] - images[1]).max(axis=-1) > LEVEL).mean() < 0.005


def test_a_gpu_is_named():
    """Its model stands in what a result says."""
    assert describe_device(compute_device("cuda")).startswith("cuda: ")
    assert compute_device("auto").type == "cuda"


def test_the_whole_step_is_played_from_a_recording():
    """With Warp the room is rendered on the GPU as on the CPU, twice the same, launched or played,
    and by half precision too.
    """
    pytest.importorskip(
        "warp", reason="the online step on a device wants NVIDIA Warp: pip install 'ggvs-eval[gpu]'"
    )
    from ggvs_eval.contrib.warp.step import DeviceGuided

    first = room_instants()
    instants = [
        replace(moment, index=index)
        for index, moment in enumerate([*first, *first[1:], *first[1:]])
    ]
    methods = (
        DeviceGuided(device="cuda"),
        DeviceGuided(device="cuda"),
        DeviceGuided(device="cuda", recorded=False),
    )
    compiled = find_method("ours").make()
    for moment in instants:
        there, again, launched = (method.step(moment) for method in methods)
        here = compiled.step(moment)
        assert (np.abs(there.image - here.image).max(axis=-1) <= LEVEL).mean() >= 0.999
        assert (np.abs(there.depth - here.depth) <= 1e-4 * here.depth).mean() >= 0.999
        np.testing.assert_array_equal(there.image, again.image)
        np.testing.assert_array_equal(there.image, launched.image)
    (program,) = methods[0]._programs.values()
    assert program.is_recorded(0)
    assert program.is_recorded(1)


def test_training_samples_are_those_of_the_cpu():
    """With Warp every map of a sample, and the picture that the network has to beat, is computed on
    the GPU.
    """
    pytest.importorskip(
        "warp", reason="samples on a device want NVIDIA Warp: pip install 'ggvs-eval[gpu]'"
    )
    for moment in room_instants()[:2]:
        (here, picture), (there, same) = (
            rendered_views(moment, device) for device in ("cpu", "cuda")
        )
        assert there.sources == here.sources
        pairs = [(getattr(there, name), getattr(here, name)) for name in (*OF_VIEWS, "fused_depth")]
        for found, expected in (*pairs, (same, picture)):
            assert (np.abs(found - expected) <= 1e-4 * (1 + np.abs(expected))).mean() >= 0.999
