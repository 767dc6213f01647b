"""RAFT-Stereo as a matcher: what it starts from, its check, its sizes, its warm start - with
networks whose answer is known.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from ggvs_eval import kernels
from ggvs_eval.contrib.training.stereo_pairs import stereo_sample
from ggvs_eval.contrib.training.stereo_task import VALIDATION_SEED
from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.files.images import quantise
from ggvs_eval.pipelines.offline.depth.camera_depth import FILLED_CONFIDENCE, DepthEstimator
from ggvs_eval.pipelines.offline.depth.depth_choice import find_matcher
from ggvs_eval.pipelines.offline.stereo.raft_matcher import (
    RaftMatcher,
    fill_from_background,
    shipped_weights,
    start_from_disparity,
    start_from_matching,
    weights_digest,
)
from ggvs_eval.pipelines.offline.stereo.raft_stereo import RaftStereo
from ggvs_eval.raft_config import COMPACT
from helpers.seeded_networks import seeded_state
from helpers.stereo_scenes import look_from, random_texture, see_plane

# six of one scene that nothing else uses
OTHER_PAIRS = range(VALIDATION_SEED + 1024, VALIDATION_SEED + 1048, 4)


@pytest.fixture(scope="module")
def moving(tmp_path_factory):
    """Weights of a network that takes steps."""
    path = tmp_path_factory.mktemp("weights") / "moving.safetensors"
    save_file(
        seeded_state(
            {name: tuple(tensor.shape) for name, tensor in RaftStereo(COMPACT).state_dict().items()}
        ),
        path,
    )
    return path


@pytest.fixture(scope="module")
def standing(tmp_path_factory):
    """Weights of a network that never takes a step: its flow is what it starts from."""
    state = seeded_state(
        {name: tuple(tensor.shape) for name, tensor in RaftStereo(COMPACT).state_dict().items()}
    )
    for name in state:
        if name.startswith(("update_block.flow_head.conv2", "update_block.mask.2")):
            state[name] = torch.zeros_like(state[name])
    path = tmp_path_factory.mktemp("weights") / "standing.safetensors"
    save_file(state, path)
    return path


def matcher(path, **changes):
    """The matcher with those weights."""
    return RaftMatcher(path, weights_digest(path), **changes)


def shifted_pair(disparity, height=120, width=200):
    """A textured pair (H, W, 3) of constant integer disparity."""
    rows, columns = np.mgrid[:height, : width + disparity] * (1024 / 300)
    grey = random_texture()[rows.astype(int), columns.astype(int)]
    texture = np.repeat(quantise(cv2.GaussianBlur(grey, (0, 0), 1))[..., None], 3, axis=-1)
    return np.ascontiguousarray(texture[:, disparity:][:, :width]), np.ascontiguousarray(
        texture[:, :width]
    )


@pytest.mark.parametrize("largest_side_px", [pytest.param(1000, marks=pytest.mark.slow), 100])
def test_a_known_shift_is_found(standing, largest_side_px):
    """Disparity of a shifted picture is the shift, sizes that are no multiples of 32 included, at
    full and at half size.
    """
    right, left = shifted_pair(14)
    found, confidence = matcher(standing, largest_side_px=largest_side_px).match(left, right, 2, 40)
    kept = found[:, 40:-8] > 0
    assert kept.mean() > 0.6
    assert np.median(np.abs(found[:, 40:-8][kept] - 14)) < 0.1
    assert found.shape == confidence.shape == left.shape[:2]
    assert ((confidence > 0) == (found > 0)).all()
    assert confidence.max() <= 1


def test_the_range_is_kept(standing):
    """Disparities outside [d_min, d_max] are rejected."""
    right, left = shifted_pair(14, 64, 96)
    found, _ = matcher(standing).match(left, right, 2, 20, np.full(left.shape[:2], 30, np.float32))
    assert (found == 0).all()  # the network stands where the frame before was


def test_a_warm_start_is_where_it_begins(standing):
    """With the disparity of the frame before, gaps filled, the standing network answers that."""
    right, left = shifted_pair(14, 64, 96)
    previous = np.full(left.shape[:2], 14, np.float32)
    previous[40:50, 60:70] = 0
    found = matcher(standing, from_matching=False).disparity(left, right, 2, 40, previous)
    np.testing.assert_allclose(found[8:-8, 8:-8], 14, atol=1e-4)


@pytest.mark.slow
@pytest.mark.usefixtures("kernel_settings", "torch_threads")
def test_equal_inputs_give_equal_bits(moving):
    """Whatever the number of threads, with a network that takes steps."""
    right, left = shifted_pair(14)
    results = []
    for count in (1, 2):
        torch.set_num_threads(count)
        kernels.set_threads(count)
        results.append(matcher(moving).disparity(left, right, 2, 40))
        assert torch.get_num_threads() == count
    assert np.array_equal(results[0], results[1])


@pytest.mark.proof
def test_the_shipped_network_improves_on_what_it_starts_from():
    """On a scene that it was neither trained nor validated on, its error is at least a tenth below
    that of its start.
    """
    shipped = find_matcher("raft")
    errors = []
    for seed in OTHER_PAIRS:
        pair = stereo_sample(seed, 320, 224)
        d_max = int(pair.disparity.max()) + 8
        start = -4 * start_from_matching(pair.left, pair.right, 0, d_max, 4)
        enlarged = cv2.resize(start, (320, 224), interpolation=cv2.INTER_NEAREST)
        found = shipped.disparity(pair.left, pair.right, 0, d_max)
        errors.append([np.abs(each - pair.disparity).mean() for each in (found, enlarged)])
    network, matching = np.mean(errors, axis=0)
    assert network < 0.9 * matching


@pytest.mark.slow
def test_a_dense_matcher_keeps_what_is_not_confirmed(standing):
    """It says what the network says wherever that lies within the search range, all of it
    as sure.
    """
    right, left = shifted_pair(14)
    left[40:80, 60:100] = 255 - left[40:80, 60:100]  # the other image does not show this
    assert not matcher(standing).match(left, right, 2, 40)[0][45:75, 65:95].all()
    dense, confidence = matcher(standing, dense=True).match(left, right, 2, 40)
    whole = matcher(standing).disparity(left, right, 2, 40)
    assert np.array_equal(dense, np.where((whole >= 2) & (whole <= 40), whole, 0))
    assert (dense > 0).mean() > 0.95
    assert np.array_equal(confidence, dense > 0)


@pytest.mark.parametrize("before", [None, pytest.param(64.0, marks=pytest.mark.slow)])
def test_wide_pairs_are_moved_together(moving, before):
    """What the smallest disparity leaves is matched as if it were a narrow pair, and columns
    without a match are told by 0.
    """
    network = matcher(moving, warm_iterations=5)
    right, left = shifted_pair(64)
    previous = [
        None if before is None else np.full((120, 200 - cut), before - cut, np.float32)
        for cut in (0, 48)
    ]
    wide = network.disparity(left, right, 48, 80, previous[0])
    narrow = network.disparity(left[:, 48:], right[:, :-48], 0, 32, previous[1])
    assert np.array_equal(wide[:, 48:], narrow + 48)
    assert not wide[:, :48].any()


@pytest.mark.slow
def test_the_shipped_network_fills_a_rig(tmp_path):
    """`sgbm+raft` takes the network's depth where the pairs do not confirm any; a weights file's
    name may hold a plus.
    """
    camera, others = look_from(0, 0, "camera"), [look_from(x, 0, f"at{x}") for x in (-0.2, 0.2)]
    options = replace(DepthRunOptions("sgbm+raft").options(), filler_share=0.0)
    assert options.filler == replace(find_matcher("raft"), dense=True)
    picture = see_plane(camera)
    picture[60:90, 60:100] = 255 - picture[60:90, 60:100]
    found = DepthEstimator(camera, others, options).estimate(
        picture, [see_plane(each) for each in others]
    )
    guessed = found.confidence == np.float32(FILLED_CONFIDENCE)
    assert guessed[70:80, 70:90].any()
    assert np.array_equal(found.depth[guessed], found.guess[guessed])
    assert (found.guess > 0).all()
    named = tmp_path / "a+raft.safetensors"
    named.write_bytes(shipped_weights().read_bytes())
    assert DepthRunOptions(f"raft:{named}").options().filler is None
    assert DepthRunOptions(f"sgbm+raft:{named}").options().filler.weights == named
    assert DepthRunOptions("sgbm+raft").is_learned


def test_the_start_is_the_match_in_cells():
    """Semi-global matching of a shifted pair, as negative disparity in cells of four pixels."""
    right, left = shifted_pair(16, 128, 192)
    start = start_from_matching(left, right, 0, 40, 4)
    assert start.shape == (32, 48)
    assert np.median(start[:, 12:-4]) == pytest.approx(-4.0, abs=0.1)


def test_gaps_are_filled_from_the_farther_side():
    """A rejected pixel takes the smaller of its row's nearest disparities, an empty row its
    column's; an empty map stays.
    """
    disparity = np.zeros((3, 5), np.float32)
    disparity[0] = [9, 0, 0, 4, 0]
    filled = fill_from_background(disparity)
    assert filled[0].tolist() == [9, 4, 4, 4, 4]
    assert filled[2].tolist() == [9, 4, 4, 4, 4]
    assert (fill_from_background(np.zeros((2, 2), np.float32)) == 0).all()
    assert start_from_disparity(np.full((8, 8), 6, np.float32), 4).tolist() == [
        [-1.5, -1.5],
        [-1.5, -1.5],
    ]
