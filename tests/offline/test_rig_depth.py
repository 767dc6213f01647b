"""Depth of the sources of an instant at once: what each matcher finds one by one, and what is taken
from which cameras.
"""

import numpy as np
import pytest

from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.errors import DepthError
from ggvs_eval.pipelines.offline.depth.camera_depth import (
    ERROR_PX,
    DepthEstimator,
    DepthOptions,
    check_depth,
    finish,
)
from ggvs_eval.pipelines.offline.depth.rig_depth import DeviceDepth, RigDepth
from ggvs_eval.pipelines.offline.stereo.live import RigEstimator
from helpers.itermvs_weights import write_checkpoint
from helpers.stereo_scenes import look_from, see_plane

NAMES = ["cam0", "cam1", "cam2"]


@pytest.fixture(scope="module")
def rig():
    """Five cameras, and what they see of a plane."""
    places = (
        (0, 0.03, 0.01),
        (0.43, -0.05, 0.02),
        (-0.37, 0.07, 0.03),
        (0.11, 0.41, 0.02),
        (0.8, 0.1, 0.05),
    )
    cameras = [
        look_from(x, y, f"cam{index}", turn).resized(128, 96)
        for index, (x, y, turn) in enumerate(places)
    ]
    return cameras, {camera.name: see_plane(camera) for camera in cameras}


def one_by_one(rig, options: DepthOptions, finder: RigDepth, maps=None):
    """Each map by an estimator of its own, then checked against the others."""
    cameras, images = {camera.name: camera for camera in rig[0]}, rig[1]
    if maps is None:
        maps = {}
        for name in NAMES:
            partners = finder.partners(name)
            estimator = DepthEstimator(cameras[name], [cameras[each] for each in partners], options)
            maps[name] = estimator.estimate(images[name], [images[each] for each in partners])
    others = {
        name: [(cameras[each], maps[each]) for each in NAMES if each != name] for name in NAMES
    }
    return {name: check_depth(cameras[name], maps[name], others[name], options) for name in NAMES}


@pytest.mark.slow
def test_a_network_finds_all_maps_in_one_batch(rig, tmp_path):
    """Finished and checked on the device: nearly everywhere what the CPU's own way finds map by
    map.
    """
    options = DepthRunOptions(f"itermvs:{write_checkpoint(tmp_path / 'model.ckpt')}").options(
        "cpu:0"
    )
    finder = RigDepth(rig[0], options)
    found, expected = finder.estimate(NAMES, rig[1]), one_by_one(rig, options, finder)
    assert list(found) == NAMES
    for name, each in found.items():
        assert isinstance(each, DeviceDepth)
        depth = each.download()
        assert np.mean(np.abs(depth.depth / expected[name].depth - 1) < 1e-3) > 0.97
        assert np.mean(np.abs(depth.confidence - expected[name].confidence) < 1e-3) > 0.97
    assert finder.clock_s() <= finder.clock_s()


def test_shared_pairs_give_the_bits_of_a_run(rig):
    """Live matching: each pair once, finished and checked as a run's depth is; other sources
    afterwards.
    """
    options = DepthRunOptions("live").options()
    finder = RigDepth(rig[0], options)
    matched = [(name, *finder.partners(name)) for name in NAMES]
    raw = RigEstimator(rig[0], matched, options.matcher, ERROR_PX).estimate(rig[1])
    maps = {name: finish(each, options) for name, each in zip(NAMES, raw, strict=True)}
    found, expected = finder.estimate(NAMES, rig[1]), one_by_one(rig, options, finder, maps)
    for name in NAMES:
        np.testing.assert_array_equal(found[name].depth, expected[name].depth)
        np.testing.assert_array_equal(found[name].confidence, expected[name].confidence)
    assert set(finder.estimate(["cam3"], rig[1])) == {"cam3"}


def test_other_matchers_go_map_by_map(rig):
    """Semi-global matching has the bits of one estimator for each camera."""
    options = DepthRunOptions("sgbm").options()
    finder = RigDepth(rig[0], options)
    found, expected = finder.estimate(NAMES, rig[1]), one_by_one(rig, options, finder)
    for name in NAMES:
        np.testing.assert_array_equal(found[name].depth, expected[name].depth)


def test_partners_are_chosen_or_given(rig):
    """Pictures are needed of the cameras and of their partners, each once; one that is missing is
    named.
    """
    options = DepthRunOptions("live").options()
    chosen = RigDepth(rig[0], options)
    assert set(chosen.needed(["cam0"])) == {"cam0", *chosen.partners("cam0")}
    assert "cam0" not in chosen.partners("cam0")
    given = RigDepth(rig[0], options, {"cam0": ("cam2", "cam1"), "cam1": ("cam0",)})
    assert given.needed(["cam0", "cam1"]) == ["cam0", "cam2", "cam1"]
    with pytest.raises(DepthError, match="cam2"):
        given.estimate(["cam0"], {name: image for name, image in rig[1].items() if name != "cam2"})
