"""Finish and check of found depth by Warp's kernels: those of torch's own operations, which are
held against the CPU's.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch

from ggvs_eval.pipelines.offline.depth import consistency, device_maps
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.pipelines.offline.itermvs.estimator import projections_between
from helpers.stereo_scenes import look_from, plane_depth

pytest.importorskip(
    "warp", reason="depth by kernels wants NVIDIA Warp: pip install 'ggvs-eval[gpu]'"
)

from ggvs_eval.contrib.warp import depth as kernels

CHECKED = DepthOptions()


@pytest.fixture(scope="module")
def scene():
    """Noisy depth of a plane with a box before it by four cameras, with holes, wrong places and an
    empty row.
    """
    random = np.random.default_rng(0)
    places = ((0, 0.03, 0.01), (0.43, -0.05, 0.02), (-0.37, 0.07, 0.03), (0.11, 0.41, 0.02))
    cameras = [look_from(x, y, f"cam{index}", turn) for index, (x, y, turn) in enumerate(places)]
    depths, confidences = [], []
    for index, camera in enumerate(cameras):
        depth = plane_depth(camera) * (1 + random.normal(0, 0.003, (camera.height, camera.width)))
        depth[40:70, 60 + 5 * index : 100] *= 0.7
        depth[100:120, 30 * index : 30 * index + 25] *= 1.2
        depth[random.random(depth.shape) < 0.02] = 0
        depth[10:12] = 0
        rows, columns = np.indices(depth.shape)
        depths.append(depth)
        confidences.append(0.5 + 0.5 * np.sin(rows / 17 + index) * np.cos(columns / 23))
    depth, confidence, between = (
        torch.from_numpy(np.asarray(each)).float()
        for each in (depths, confidences, projections_between(cameras))
    )
    return depth, confidence, between


@pytest.mark.parametrize(
    ("options", "rules"),
    [
        (CHECKED, {}),
        (replace(CHECKED, consistency=False), {}),
        (CHECKED, {"FILL_SUPPORT": 0, "MIN_SUPPORT": 2}),
    ],
    ids=["checked", "unchecked", "other rules"],
)
@pytest.mark.parametrize("views", [1, 2, 4])
def test_maps_are_those_of_torch(scene, options, rules, views, monkeypatch):
    """Depth and confidence of all but single pixels, where a comparison decides, within 1e-5; known
    in the same places.
    """
    for name, value in rules.items():
        monkeypatch.setattr(consistency, name, value)
    depth, confidence, between = scene
    given = depth[:views], confidence[:views], between[:views, :views]
    here, there = (module.finish_maps(*given, options=options) for module in (device_maps, kernels))
    for one, other in zip(here, there, strict=True):
        assert ((one - other).abs() <= 1e-5 * one.abs().clamp(min=1e-3)).float().mean() > 0.9995
    assert ((here[0] > 0) == (there[0] > 0)).float().mean() > 0.9995


def test_equal_maps_give_equal_bits(scene):
    """From run to run, though points meet in pixels in any order."""
    for one, other in zip(
        *(kernels.finish_maps(*scene, options=CHECKED) for _ in range(2)), strict=True
    ):
        assert torch.equal(one, other)


def test_what_is_unknown_everywhere_stays_so(scene):
    """A map without any depth is filled with nothing, and gives the others none."""
    depth, confidence, between = scene
    found, sure = kernels.finish_maps(torch.zeros_like(depth), confidence, between, options=CHECKED)
    assert not found.any()
    assert not sure.any()
