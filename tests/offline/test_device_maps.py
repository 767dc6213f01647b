"""Finish and check of depth on a device: what the CPU's own find, by operations that a GPU can
record.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch

from ggvs_eval.compute_device import one_thread
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.pipelines.offline.depth import device_maps
from ggvs_eval.pipelines.offline.depth.camera_depth import (
    FLYING,
    SMOOTH,
    SMOOTH_RADIUS_PX,
    DepthOptions,
    check_depth,
    finish,
)
from ggvs_eval.pipelines.offline.depth.device_maps import finish_maps
from ggvs_eval.pipelines.offline.itermvs.estimator import projections_between
from ggvs_eval.pipelines.offline.stereo import fusion
from helpers.recordable import forbidden_operations
from helpers.stereo_scenes import look_from, plane_depth

CHECKED = DepthOptions()
UNCHECKED = replace(CHECKED, consistency=False)


@pytest.fixture(autouse=True)
def alone():
    """Small maps are faster with one thread."""
    with one_thread():
        yield


@pytest.fixture(scope="module")
def scene():
    """Four cameras, their noisy depth of a plane with a box before it, and confidence that is low
    in places.
    """
    random = np.random.default_rng(0)
    places = ((0, 0.03, 0.01), (0.43, -0.05, 0.02), (-0.37, 0.07, 0.03), (0.11, 0.41, 0.02))
    cameras = [look_from(x, y, f"cam{index}", turn) for index, (x, y, turn) in enumerate(places)]
    maps = []
    for index, camera in enumerate(cameras):
        depth = plane_depth(camera) * (1 + random.normal(0, 0.003, (camera.height, camera.width)))
        depth[40:70, 60 + 5 * index : 100] *= 0.7
        depth[100:120, 30 * index : 30 * index + 25] *= 1.2  # wrong, and no other camera says so
        alone = random.random(depth.shape) < 0.01
        depth[alone] *= 1.5
        rows, columns = np.indices(depth.shape)
        confidence = 0.5 + 0.5 * np.sin(rows / 17 + index) * np.cos(columns / 23)
        maps.append(DepthMap(depth.astype(np.float32), confidence.astype(np.float32)))
    return cameras, maps


def stacked(maps):
    """Depth and confidence of maps, (K, H, W)."""
    return [
        torch.from_numpy(np.stack(each))
        for each in ([m.depth for m in maps], [m.confidence for m in maps])
    ]


def numbers_of(cameras):
    """Projections between cameras as the device takes them."""
    return torch.from_numpy(projections_between(cameras)).float()


def test_steps_of_the_finish_are_the_cpus(scene):
    """Flying pixels and the fill to the last bit, smoothing but for OpenCV's table of weights."""
    _, maps = scene
    depth, confidence = stacked(maps)
    kept = device_maps.drop_flying_pixels(depth, FLYING)
    np.testing.assert_array_equal(
        kept, [fusion.drop_flying_pixels(each.depth, FLYING) for each in maps]
    )
    assert 0 < (kept == 0).float().mean() < 0.1
    smooth = device_maps.smooth_surfaces(kept, SMOOTH, SMOOTH_RADIUS_PX)
    expected = [fusion.smooth_surfaces(each.numpy(), SMOOTH, SMOOTH_RADIUS_PX) for each in kept]
    np.testing.assert_allclose(smooth, expected, rtol=1e-5)
    smooth[1, 30:35], smooth[2] = 0, 0  # whole rows, and a map of which nothing is known
    filled = device_maps.fill_background(smooth, confidence, 0.02)
    by_fusion = [
        fusion.fill_background(*both, 0.02)
        for both in zip(smooth.numpy(), confidence.numpy(), strict=True)
    ]
    for there, here in zip(filled, zip(*by_fusion, strict=True), strict=True):
        np.testing.assert_array_equal(there, np.stack(here))


@pytest.mark.parametrize("options", [CHECKED, UNCHECKED], ids=["checked", "unchecked"])
def test_a_stack_is_what_the_cpu_makes_of_each_map(scene, options):
    """Finished, and held against the three others: within 1e-4 in nearly all pixels."""
    cameras, maps = scene
    finished = [finish(each, options) for each in maps]
    expected = [
        check_depth(
            camera,
            own,
            [both for both in zip(cameras, finished, strict=True) if both[1] is not own],
            options,
        )
        for camera, own in zip(cameras, finished, strict=True)
    ]
    depth, confidence = finish_maps(*stacked(maps), numbers_of(cameras), options=options)
    for k, each in enumerate(expected):
        assert np.mean(np.abs(depth[k].numpy() / each.depth - 1) < 1e-4) > 0.995
        assert np.mean(np.abs(confidence[k].numpy() - each.confidence) < 1e-4) > 0.995
    if options.consistency:
        changed = [
            np.abs(each.depth / own.depth - 1) > 0.05
            for each, own in zip(expected, finished, strict=True)
        ]
        assert np.mean(changed) > 0.02


def test_a_map_alone_is_not_checked(scene):
    """Without another map there is nothing to hold it against."""
    cameras, maps = scene
    between = numbers_of(cameras[:1])
    one, other = (
        finish_maps(*stacked(maps[:1]), between, options=each) for each in (CHECKED, UNCHECKED)
    )
    assert all(torch.equal(*each) for each in zip(one, other, strict=True))


def test_it_can_be_recorded(scene):
    """No number is uploaded, nor read by the host."""
    cameras, maps = scene
    there = [each.to("meta") for each in (*stacked(maps), numbers_of(cameras))]
    with forbidden_operations() as forbidden:
        depth, confidence = finish_maps(*there, options=CHECKED)
    assert depth.shape == confidence.shape == (4, cameras[0].height, cameras[0].width)
    assert not forbidden
