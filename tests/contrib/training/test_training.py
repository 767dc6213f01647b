"""Training: a killed run goes on as if nothing was, batches depend on the step alone, what is
written is readable.
"""

import csv
import shutil
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file
from torch import nn

from ggvs_eval.baselines.fitted.training_log import TrainingLog, draw_curves
from ggvs_eval.contrib.training import stereo_task
from ggvs_eval.contrib.training.loop import train, write_card
from ggvs_eval.contrib.training.request import TrainingOptions
from ggvs_eval.contrib.training.stereo_pairs import StereoSample
from ggvs_eval.contrib.training.stereo_task import StereoTask, matching_loss, sequence_loss
from ggvs_eval.contrib.training.task import Schedule, freeze_statistics, recompute_statistics
from ggvs_eval.contrib.training.train_one import planned_task
from ggvs_eval.errors import TrainingError, WeightsError
from ggvs_eval.files.images import read_image
from ggvs_eval.files.weights_file import read_notes
from ggvs_eval.raft_config import COMPACT
from helpers.refusals import refused


@dataclass(frozen=True)
class LineTask:
    """Learns y = 2 x - 1 from noisy points; every step draws its own."""

    schedule: Schedule = field(
        default_factory=lambda: Schedule(learning_rate=0.05, warm_up=2, average=0.5)
    )
    name = "line"
    summary = "The training of a line."
    data = "points on a line"
    evaluated_on = "Distance from the line."
    step_pixels = 16

    def network(self):
        torch.manual_seed(0)
        return nn.Linear(1, 1)

    def batch(self, step):
        rng = np.random.default_rng(step)
        x = rng.uniform(-1, 1, (16, 1))
        return {
            "x": torch.from_numpy(x).float(),
            "y": torch.from_numpy(2 * x - 1 + rng.normal(0, 0.01, x.shape)).float(),
        }

    def loss(self, network, batch):
        error = (network(batch["x"]) - batch["y"]).square().mean()
        return error, {"squared": float(error.detach())}

    def settle(self, network):
        """Nothing."""

    def validate(self, network):
        return {"distance": float(network(torch.tensor([[0.5]])).detach().abs())}


OPTIONS = TrainingOptions(
    steps=120, device="cpu", precision="float32", save_every=50, validate_every=40, workers=0
)


def state_of(folder):
    return torch.load(folder / "state.pt", weights_only=True)


def assert_equal_states(one, other):
    if isinstance(one, torch.Tensor):
        assert torch.equal(one, other)
    elif isinstance(one, dict):
        assert one.keys() == other.keys()
        for key in one:
            assert_equal_states(one[key], other[key])
    else:
        assert one == other or isinstance(one, (list, tuple))


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """The folder of a finished training; nobody changes it."""
    return train(LineTask(), tmp_path_factory.mktemp("trained"), OPTIONS).parent


def test_it_learns(trained):
    """The averaged weights end near the line, the validation log says so, and the card names
    command, data, cost and quality.
    """
    weights = load_file(trained / "line.safetensors")
    assert abs(float(weights["weight"]) - 2) < 0.1
    assert abs(float(weights["bias"]) + 1) < 0.1
    with (trained / "validation.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["step"]) for row in rows] == [40, 80, 120]
    assert float(rows[-1]["distance"]) < 0.1
    text = write_card(
        LineTask(), trained, "ggvs-eval train line", device="cuda: NVIDIA H100"
    ).read_text()
    for part in ("`ggvs-eval train line`", "Steps: 120", "points on a line", "| 120 |", "sha256"):
        assert part in text
    assert text.count(", cuda: NVIDIA H100\n") == 1


class Killed(Exception):
    """Stands for a kill in the middle of a step."""


@dataclass(frozen=True)
class DyingTask(LineTask):
    """Dies at step 57, seven steps after the last checkpoint."""

    def batch(self, step):
        if step == 57:
            raise Killed
        return super().batch(step)


@pytest.mark.slow
def test_a_killed_training_goes_on_with_equal_bits(trained, tmp_path):
    """Weights, averages, moments and logs of a killed and resumed training are those of an
    undisturbed one.
    """
    with pytest.raises(Killed):
        train(DyingTask(), tmp_path, OPTIONS)
    train(LineTask(), tmp_path, OPTIONS)
    assert_equal_states(state_of(trained), state_of(tmp_path))
    texts = [(folder / "log.csv").read_text().splitlines() for folder in (trained, tmp_path)]
    logs = [[line.rsplit(",", 2)[0] for line in text] for text in texts]
    assert logs[0] == logs[1]  # but for the seconds, those of the clock and those of the processor


@pytest.mark.slow
def test_trained_weights_can_be_the_beginning(trained, tmp_path):
    """Without a state a training begins with given weights, whose pixels count; those of another
    network are refused.
    """
    weights = trained / "line.safetensors"
    still = LineTask(Schedule(learning_rate=0.0))
    moved = load_file(
        train(still, tmp_path / "still", replace(OPTIONS, steps=1, start_from=weights))
    )
    assert abs(float(moved["weight"]) - 2) < 0.1
    assert abs(float(moved["bias"]) + 1) < 0.1
    further = train(
        LineTask(), tmp_path / "further", replace(OPTIONS, steps=20, start_from=weights)
    )
    assert (read_notes(weights)["pixels"], read_notes(further)["pixels"]) == (
        str(120 * 16),
        str(140 * 16),
    )
    train(LineTask(), tmp_path / "further", replace(OPTIONS, steps=30))
    assert read_notes(further)["pixels"] == str(150 * 16)
    (tmp_path / "no.safetensors").write_bytes(b"no tensors")
    save_file({"weight": torch.zeros(2, 2)}, tmp_path / "wrong.safetensors")
    for name, word in (("no.safetensors", "damaged"), ("wrong.safetensors", "2 tensors")):
        with refused(WeightsError, name, word):
            train(LineTask(), tmp_path / "third", replace(OPTIONS, start_from=tmp_path / name))


def test_statistics_are_those_of_whole_views():
    """Mean and variance over all views, whatever the network remembered; frozen ones do not move
    while it learns.
    """
    network = nn.Sequential(nn.BatchNorm2d(3), nn.Conv2d(3, 1, 1))
    rng = np.random.default_rng(5)
    views = [torch.from_numpy(rng.normal(2 * n, 1 + n, (1, 3, 40, 30))).float() for n in range(4)]
    network(torch.full((1, 3, 8, 8), 100.0))
    recompute_statistics(network, [lambda net, view=view: net(view) for view in views])
    norm = network[0]
    torch.testing.assert_close(
        norm.running_mean, torch.stack([view.mean((0, 2, 3)) for view in views]).mean(0)
    )
    torch.testing.assert_close(
        norm.running_var, torch.stack([view.var((0, 2, 3)) for view in views]).mean(0)
    )
    assert not norm.training
    before = norm.running_mean.clone()
    network.train()
    freeze_statistics(network)
    network(views[3])
    assert torch.equal(norm.running_mean, before)


@pytest.mark.slow
def test_more_steps_go_on_with_a_finished_training(trained, tmp_path):
    """A finished training is not run again; with more steps it goes on, and its picture follows the
    logs, byte for byte.
    """
    folder = Path(shutil.copytree(trained, tmp_path / "more"))
    before = (folder / "state.pt").stat().st_mtime_ns
    train(LineTask(), folder, OPTIONS)
    assert (folder / "state.pt").stat().st_mtime_ns == before
    picture = folder / "line.png"
    drawn = picture.read_bytes()
    assert read_image(picture).std() > 10
    assert draw_curves(folder, "line") == picture
    assert picture.read_bytes() == drawn
    train(LineTask(), folder, replace(OPTIONS, steps=130))
    assert state_of(folder)["step"] == 130
    assert picture.read_bytes() != drawn


def test_a_state_of_another_network_is_refused(tmp_path):
    """A damaged state, and one of other shapes, is an error that names the file; nothing is
    overwritten.
    """
    (tmp_path / "state.pt").write_bytes(b"no zip")
    with refused(TrainingError, "state.pt"):
        train(LineTask(), tmp_path, OPTIONS)
    torch.save({"step": 3, "network": {"weight": torch.zeros(2, 2)}}, tmp_path / "state.pt")
    with refused(TrainingError, "choose another folder"):
        train(LineTask(), tmp_path, OPTIONS)


@dataclass(frozen=True)
class BrokenTask(LineTask):
    """One batch of infinities."""

    def batch(self, step):
        points = super().batch(step)
        return {
            name: tensor * (float("inf") if step == 5 else 1) for name, tensor in points.items()
        }


def test_one_bad_batch_does_not_spoil_the_weights(tmp_path):
    """A gradient that is not finite moves nothing, and the log shows it."""
    weights = load_file(
        train(BrokenTask(), tmp_path, replace(OPTIONS, steps=60, validate_every=60))
    )
    assert abs(float(weights["weight"]) - 2) < 0.2
    assert {"nan", "inf"} & set((tmp_path / "log.csv").read_text().replace("\n", ",").split(","))


def test_a_log_keeps_the_columns_that_it_began_with(tmp_path):
    """A training that an earlier release began goes on with a figure more: the log stays a table,
    the old columns are filled.
    """
    log = TrainingLog(tmp_path, 0)
    log.step(0, {"loss": 0.5, "seconds": 2.0})
    log.step(1, {"loss": 0.25, "passed_over": 3.0, "seconds": 1.0})
    assert (tmp_path / "log.csv").read_text().split() == [
        "step,loss,seconds",
        "0,0.5,2",
        "1,0.25,1",
    ]
    log.validation(2, {"psnr_db": 20.0})
    assert (tmp_path / "validation.csv").read_text().split() == ["step,psnr_db", "2,20"]


SMALL = StereoTask(width=128, height=96, batch_size=1, iterations=2, validation_pairs=1)


def test_weights_that_have_learned_are_moved_more_gently(tmp_path):
    """A stereo training that starts from weights has a lower rate than one from nothing; its card
    says so.
    """
    fresh, tuned = (
        planned_task("stereo", tmp_path, TrainingOptions(start_from=start_from))
        for start_from in (None, tmp_path / "shipped")
    )
    assert tuned.schedule.rate(300, 1000) < 0.5 * fresh.schedule.rate(300, 1000)
    assert fresh.batch_size == tuned.batch_size


def shifted_noise(seed, width, height):
    """A pair that is all of one disparity, of a seed."""
    picture = np.random.default_rng(seed).integers(0, 256, (height, width + 6, 3), np.uint8)
    disparity, visible = np.full((height, width), 6, np.float32), np.ones((height, width), bool)
    return StereoSample(picture[:, :-6], picture[:, 6:], disparity, visible)


@pytest.mark.slow
def test_a_stereo_step_moves_the_weights(monkeypatch):
    """A step gives equal bits again, another one other pairs; gradients reach features, recurrent
    unit and heads.
    """
    monkeypatch.setattr(stereo_task, "stereo_sample", shifted_noise)
    once, again, other = SMALL.batch(3), SMALL.batch(3), SMALL.batch(7)
    assert all(torch.equal(once[name], again[name]) for name in once)
    assert not torch.equal(once["left"], other["left"])
    assert (once["left"].shape, once["initial"].shape) == ((1, 3, 96, 128), (1, 1, 24, 32))
    network = SMALL.network()
    loss, figures = SMALL.loss(network, once)
    loss.backward()
    assert torch.isfinite(loss)
    assert figures["epe_px"] > 0
    for name in (
        "cnet.conv1.weight",
        "update_block.gru08.convz.weight",
        "update_block.mask.2.weight",
        "conv2.1.weight",
    ):
        assert float(network.get_parameter(name).grad.abs().sum()) > 0, name


def test_sequence_loss_is_its_formula():
    """Later iterations weigh more, earlier ones are evaluated at their cells, too large truths are
    left out.
    """
    truth = torch.full((1, 1, 8, 8), -10.0)
    truth[..., 0, 1] = -900.0
    flows = [torch.full((1, 1, 2, 2), -2.0), torch.full((1, 1, 2, 2), -2.5)]
    last = torch.full((1, 1, 8, 8), -9.0)
    weight = 0.9**15
    torch.testing.assert_close(sequence_loss(flows, last, truth), torch.tensor(weight * 2.0 + 1.0))


def test_matching_loss_is_the_cross_entropy():
    """Features that match only at the true disparity have no loss; equal features everywhere have
    log of the width.
    """
    width, factor = 12, 4
    left = torch.eye(width)[None, :, None].repeat(1, 1, 2, 1) * 1000  # (1, C = width, 2, width)
    right = torch.roll(left, -2, dims=3)  # cell x lies at x - 2
    disparity, visible = (
        torch.full((1, 8, width * factor), 8.0),
        torch.ones(1, 8, width * factor, dtype=torch.bool),
    )
    assert float(matching_loss(left, right, disparity, visible, factor)) < 1e-3
    same = torch.ones_like(left)
    torch.testing.assert_close(
        matching_loss(same, same, disparity, visible, factor), torch.log(torch.tensor(12.0))
    )


def test_the_compact_network_ships_small():
    """Half precision keeps it under 12 MB."""
    assert (
        2
        * sum(parameter.numel() for parameter in StereoTask(config=COMPACT).network().parameters())
        < 12e6
    )
