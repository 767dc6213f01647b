"""RAFT-Stereo: names and shapes of the published checkpoints, equal outputs, every block against
its formula.
"""

import json

import numpy as np
import pytest
import torch
from torch.nn import functional

from ggvs_eval.compute_device import one_thread
from ggvs_eval.errors import WeightsError
from ggvs_eval.pipelines.offline.stereo.raft_matcher import load_network
from ggvs_eval.pipelines.offline.stereo.raft_stereo import RaftStereo
from ggvs_eval.raft_config import COMPACT, PUBLISHED
from ggvs_eval.raft_update import ConvGru, Correlation, upsample_convex
from ggvs_eval.residual_block import ResidualBlock
from helpers.places import DATA_FOLDER
from helpers.refusals import refused
from helpers.seeded_networks import seeded_pair, seeded_state

DATA = DATA_FOLDER
ORACLE_NAMES = {
    "default": "default(middlebury/eth3d/sceneflow)",
    "realtime": "realtime",
    "rvc": "iraftstereo_rvc",
}


@pytest.fixture(autouse=True)
def alone():
    """Small networks are faster with one thread."""
    with one_thread():
        yield


def seeded(network):
    """The network with weights drawn by their names."""
    network.load_state_dict(
        seeded_state({name: tuple(tensor.shape) for name, tensor in network.state_dict().items()})
    )
    return network.eval()


@pytest.fixture(scope="module", params=PUBLISHED)
def published(request):
    """(title, network with seeded weights) of each published configuration."""
    return request.param, seeded(RaftStereo(PUBLISHED[request.param]))


@pytest.mark.parametrize("title", PUBLISHED)
def test_names_and_shapes_are_those_of_the_checkpoints(title):
    """Every parameter and buffer of the authors' three configurations exists under its name with
    its shape, and no other.
    """
    with torch.device("meta"):
        network = RaftStereo(PUBLISHED[title])
    oracle = json.loads((DATA / "raft_stereo_state_dicts.json").read_text())[ORACLE_NAMES[title]]
    assert {name: list(tensor.shape) for name, tensor in network.state_dict().items()} == oracle[
        "keys"
    ]
    assert sum(parameter.numel() for parameter in network.parameters()) == oracle["n_params"]


@pytest.mark.slow
def test_outputs_are_the_authors(published):
    """Flow from zero and from a given flow agrees with the authors' code on the same weights
    (tests/data/ORACLES.md).
    """
    title, network = published
    left, right = seeded_pair(64, 160)
    factor = network.config.factor
    golden = np.load(DATA / "raft_stereo_golden.npz")
    start = torch.linspace(-3, 0, 64 * 160 // factor**2).view(1, 1, 64 // factor, 160 // factor)
    np.testing.assert_allclose(network.flow(left, right, 4)[0][0, 0], golden[title], atol=2e-3)
    np.testing.assert_allclose(
        network.flow(left, right, 4, start)[1][0, 0], golden[f"{title}_warm"], atol=2e-3
    )


def test_training_and_inference_agree():
    """`forward` ends with the flow that `flow` returns, and its last cells are the ones to start
    the next frame from.
    """
    network = seeded(RaftStereo(COMPACT))
    left, right = seeded_pair(64, 96)
    flows, last, (of_left, _) = network(left, right, 3)
    pixels, cells = network.flow(left, right, 3)
    torch.testing.assert_close(last, pixels)
    torch.testing.assert_close(flows[-1], cells)
    assert of_left.shape == (1, COMPACT.feature_width, 16, 24)


def test_a_warm_start_goes_on_where_the_last_call_ended():
    """The flow of a call is where the next one begins: with no update left to make, it comes back
    as it was.
    """
    network = seeded(RaftStereo(COMPACT))
    left, right = seeded_pair(64, 96)
    torch.nn.init.zeros_(network.update_block.flow_head.conv2.weight)
    torch.nn.init.zeros_(network.update_block.flow_head.conv2.bias)
    start = torch.linspace(-5, 0, 16 * 24).view(1, 1, 16, 24)
    torch.testing.assert_close(network.flow(left, right, 2, start)[1], start)


def plain_lookup(left, right, columns, levels, radius):
    """Correlation lookup by loops, from its definition."""
    width = right.shape[-1]
    _, channels, height, _ = left.shape
    found = torch.zeros(1, levels * (2 * radius + 1), height, width)
    for level in range(levels):
        pooled = right
        for _ in range(level):
            pooled = functional.avg_pool2d(pooled, (1, 2), (1, 2))
        for row, column in np.ndindex(height, width):
            products = (left[0, :, row, column] @ pooled[0, :, row]) / channels**0.5
            for offset in range(-radius, radius + 1):
                at = float(columns[0, row, column]) / 2**level + offset
                below = int(np.floor(at))
                ends = [
                    products[i] if 0 <= i < len(products) else torch.tensor(0.0)
                    for i in (below, below + 1)
                ]
                found[0, level * (2 * radius + 1) + offset + radius, row, column] = ends[0] + (
                    at - below
                ) * (ends[1] - ends[0])
    return found


@pytest.mark.parametrize("volume_bytes", [2**30, 1])
def test_lookup_is_linear_and_zero_outside(volume_bytes):
    """Lookups agree with the definition inside, on the border and far outside, from a kept volume
    and from none.
    """
    generator = torch.Generator().manual_seed(1)
    left, right = torch.randn(2, 1, 6, 3, 20, generator=generator)
    columns = torch.rand(1, 3, 20, generator=generator) * 40 - 10
    columns[0, 0, :3] = torch.tensor([-500.0, 19.0, 700.0])
    found = Correlation(left, right, 3, 2, volume_bytes).lookup(columns)
    torch.testing.assert_close(
        found, plain_lookup(left, right, columns, 3, 2), atol=1e-5, rtol=1e-5
    )


def test_upsampling_is_convex():
    """Each fine pixel is the weighted mean of factor times the nine cells around its cell; equal
    weights give their mean.
    """
    generator = torch.Generator().manual_seed(2)
    flow, weights = (
        torch.randn(1, 1, 4, 5, generator=generator),
        torch.randn(1, 9 * 4, 4, 5, generator=generator),
    )
    fine = upsample_convex(flow, weights, 2)[0, 0]
    padded = functional.pad(flow[0, 0], (1, 1, 1, 1))
    shares = torch.softmax(weights.view(9, 2, 2, 4, 5), dim=0)
    for row, column in np.ndindex(8, 10):
        cell = row // 2, column // 2
        around = padded[cell[0] : cell[0] + 3, cell[1] : cell[1] + 3].reshape(9)
        expected = 2 * (shares[:, row % 2, column % 2, cell[0], cell[1]] * around).sum()
        torch.testing.assert_close(fine[row, column], expected)


def test_gru_follows_its_equations():
    """The state becomes (1 - z) h + z q with z, r, q from 3x3 convolutions of [h, x] and [r h, x]
    plus the context.
    """
    torch.manual_seed(3)
    gru = ConvGru(4, 6)
    hidden, first, second = (
        torch.randn(1, 4, 5, 6),
        torch.randn(1, 2, 5, 6),
        torch.randn(1, 4, 5, 6),
    )
    gates, candidate = torch.randn(1, 8, 5, 6), torch.randn(1, 4, 5, 6)
    both = torch.cat([hidden, first, second], 1)
    z = torch.sigmoid(gru.convz(both) + gates[:, :4])
    r = torch.sigmoid(gru.convr(both) + gates[:, 4:])
    q = torch.tanh(gru.convq(torch.cat([r * hidden, first, second], 1)) + candidate)
    torch.testing.assert_close(
        gru(hidden, (gates, candidate), first, second), (1 - z) * hidden + z * q
    )


def test_residual_block_follows_its_definition():
    """ReLU after each normalised convolution, and after the sum with the strided shortcut."""
    torch.manual_seed(4)
    block = ResidualBlock(3, 5, torch.nn.InstanceNorm2d, 2)
    image = torch.randn(1, 3, 8, 8)

    def normal(features):
        return functional.instance_norm(features)

    first = torch.relu(normal(functional.conv2d(image, block.conv1.weight, block.conv1.bias, 2, 1)))
    second = torch.relu(
        normal(functional.conv2d(first, block.conv2.weight, block.conv2.bias, 1, 1))
    )
    shortcut = normal(
        functional.conv2d(image, block.downsample[0].weight, block.downsample[0].bias, 2)
    )
    torch.testing.assert_close(block(image), torch.relu(second + shortcut))


@pytest.mark.slow
def test_published_checkpoints_load_strictly(published, tmp_path):
    """A file in the authors' format, names behind ``module.``, becomes the network of its
    configuration, bit for bit.
    """
    title, network = published
    torch.save(
        {f"module.{name}": tensor for name, tensor in network.state_dict().items()},
        tmp_path / "raftstereo.pth",
    )
    loaded = load_network(tmp_path / "raftstereo.pth")
    assert loaded.config == PUBLISHED[title]
    assert all(
        torch.equal(tensor, network.state_dict()[name])
        for name, tensor in loaded.state_dict().items()
    )


def test_what_is_no_checkpoint_is_refused(tmp_path):
    """Absent, damaged or of another network: each refused in one line."""
    with refused(WeightsError, "nowhere.pth"):
        load_network(tmp_path / "nowhere.pth")
    (tmp_path / "damaged.safetensors").write_bytes(b"\x00" * 20)
    with pytest.raises(WeightsError, match="damaged"):
        load_network(tmp_path / "damaged.safetensors")
    state = RaftStereo(COMPACT).state_dict()
    torch.save({**state, "cnet.conv1.weight": torch.zeros(8, 3, 7, 7)}, tmp_path / "wider.pth")
    with pytest.raises(
        WeightsError, match=r"1 differ from 'compact', first cnet\.conv1\.weight: \(8, 3, 7, 7\)"
    ):
        load_network(tmp_path / "wider.pth")
