"""Learned baselines as entries of one registry: what is listed, what an entry names, and one that
is added by a line.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from pkgutil import resolve_name
from typing import ClassVar

import numpy as np
import pytest
import torch
from torch import nn

from ggvs_eval import baselines, built_in
from ggvs_eval.baselines.enerf.network import load_enerf
from ggvs_eval.baselines.fitted.optimiser import structural_loss
from ggvs_eval.baselines.fwd.network import load_network as load_fwd
from ggvs_eval.baselines.gps_gaussian.network import load_network as load_gps_gaussian
from ggvs_eval.baselines.ibrnet.network import load_ibrnet
from ggvs_eval.baselines.learned import LearnedBaseline
from ggvs_eval.baselines.registry import LEARNED_BASELINES
from ggvs_eval.contrib import more_baselines
from ggvs_eval.contrib.more_baselines.mvsnerf.network import load_mvsnerf
from ggvs_eval.contrib.more_baselines.mvsplat.network import load_network as load_mvsplat
from ggvs_eval.contrib.training.recipes.recipe import RECIPES, TRAINED_BASELINES, TrainingRecipe
from ggvs_eval.contrib.training.request import TrainingOptions
from ggvs_eval.contrib.training.samples.sample_kinds import InstantKind
from ggvs_eval.contrib.training.samples.training_data import sample_pools
from ggvs_eval.contrib.training.train_one import CACHE, train_one
from ggvs_eval.errors import WeightsError
from ggvs_eval.files.weights_file import load_strict, read_tensors
from ggvs_eval.method import Rendering
from ggvs_eval.pipelines.methods.baselines import learned_method
from ggvs_eval.pipelines.methods.network_options import NetworkOptions
from ggvs_eval.pipelines.methods.registry import METHODS, find_method
from ggvs_eval.pipelines.methods.spec import OnlineMethod, shipped
from helpers.filled_pools import fill
from helpers.hostile import Hostile
from helpers.refusals import refused
from helpers.stereo_scenes import write_capture

WIDTH, HEIGHT = 400, 300  # of domain plain
START = torch.tensor([0.25, 0.5, 0.75])
REQUEST = TrainingOptions(
    steps=1, views=2, rooms=1, targets=1, domains=("plain",), device="cpu", workers=0
)


class ToyNetwork(nn.Module):
    """One colour, in which it paints every view."""

    def __init__(self, configuration="compact"):
        super().__init__()
        self.configuration = configuration
        self.colour = nn.Parameter(START.clone())

    def forward(self, target):
        return self.colour[:, None, None].expand(3, target.height, target.width)


class ToyMethod:
    """Renders that colour, times a gain."""

    def __init__(self, weights, gain=1.0, device="cpu"):
        self.network, self.gain = ToyNetwork().to(device), gain
        load_strict(read_tensors(weights), self.network, weights, "a toy")

    def step(self, instant):
        with torch.inference_mode():
            return Rendering(
                self.gain * self.network(instant.target).permute(1, 2, 0).numpy(force=True)
            )


@dataclass(frozen=True)
class ToyRecipe(TrainingRecipe[ToyNetwork]):
    """Squared error and structure of small crops."""

    crop_width: int = 64
    crop_height: int = 48
    network_class = ToyNetwork
    term_weights: ClassVar = {"squared_loss": 1.0, "ssim_loss": 1.0}

    def terms(self, network, sample, step):
        image, truth = network(sample.instant.target), sample.truth_tensor
        return {
            "squared_loss": (image - truth).square().mean(),
            "ssim_loss": structural_loss(image[None], truth[None]),
        }

    def rendered(self, network, instant):
        return network(instant.target)


TOY = LearnedBaseline(
    name="toy",
    title="Toy",
    source="nobody, nowhere 2020",
    checkpoint="toy.pth of nobody",
    method=f"{__name__}:ToyMethod",
    describe="one colour",
)
DARK = replace(TOY, title="Dark Toy", describe="half of it", options={"gain": 0.5})


@pytest.fixture
def toy(monkeypatch):
    """The toy in the registries, as a line of each table makes it."""
    monkeypatch.setitem(LEARNED_BASELINES.shipped, TOY.name, TOY)
    monkeypatch.setitem(TRAINED_BASELINES, TOY.name, TOY)
    monkeypatch.setitem(RECIPES.shipped, TOY.name, ToyRecipe)
    monkeypatch.setitem(METHODS.shipped, "toy", learned_method(TOY))
    monkeypatch.setitem(METHODS.shipped, "toy+dark", learned_method(DARK))
    return TOY


@pytest.fixture
def cache(tmp_path):
    """Samples of a slanted plane in place of rooms, where the toy's training looks for them."""
    capture = write_capture(tmp_path / "plane", n_frames=1).resized(WIDTH, HEIGHT, "area")
    folder = tmp_path / CACHE
    for pool in sample_pools(folder, REQUEST, InstantKind(depth=False)):
        fill(pool, lambda _: capture)
    return folder


def test_a_new_baseline_is_listed_trained_and_renders(toy, cache):
    """An entry alone: both its labels are methods, a step is trained, its weights render by either
    label, its card is written.
    """
    assert [label for label in METHODS if label not in built_in.METHODS] == ["toy", "toy+dark"]
    assert (find_method("toy").title, find_method("toy+dark").title) == ("Toy", "Dark Toy")
    with refused(WeightsError, "Toy", "toy.pth", "--weights toy=FILE"):
        find_method("toy").make()

    weights, card = train_one("toy", cache.parent / "toy", REQUEST)

    sample = sample_pools(cache, REQUEST, InstantKind(depth=False))[1].read(0)
    plain, dark = (
        find_method(label, NetworkOptions({"toy": weights})).make().step(sample.instant).image
        for label in ("toy", "toy+dark")
    )
    trained = read_tensors(weights)["colour"].float().numpy()
    assert plain.shape == sample.truth.shape
    np.testing.assert_allclose(trained, START, atol=1e-3)
    np.testing.assert_array_equal(plain, np.broadcast_to(trained, plain.shape))
    np.testing.assert_array_equal(dark, plain / 2)
    moved = torch.load(weights.parent / "state.pt", weights_only=True)["network"]["colour"] - START
    assert (moved != 0).all()
    told = card.read_text()
    assert "The training of Toy (nobody, nowhere 2020)." in told
    assert (
        "- recipe: {'configuration': 'compact', 'seed': 0, 'crop_width': 64, 'crop_height': 48}"
        in told
    )
    assert "ToyMethod" not in told
    assert (weights.parent / "validation.csv").read_text().startswith("step,psnr_db,ssim\n1,")


def test_every_folder_is_registered():
    """A folder that the registry forgets would be no method and no training; what is fitted learns
    from the capture alone.
    """
    folders = {root: Path(str(root.__file__)).parent for root in (baselines, more_baselines)}
    there = [
        f"{root.__name__}.{file.parent.name}"
        for root, folder in folders.items()
        for file in folder.glob("*/__init__.py")
    ]

    assert sorted(there) == sorted(
        [*map(LEARNED_BASELINES.root, LEARNED_BASELINES), "ggvs_eval.baselines.fitted"]
    )


def test_a_plug_in_is_given_the_file_that_the_user_names(tmp_path):
    """A method that takes weights, and needs none, is made with those of `--weights`."""
    method = OnlineMethod("Mine", "mine", dict, takes=("weights",))
    assert method.make() == {}
    assert method.rendering_with(tmp_path).make() == {"weights": tmp_path}


LOADERS = {
    "FWD": load_fwd,
    "GPS-Gaussian": load_gps_gaussian,
    "IBRNet": load_ibrnet,
    "ENeRF": load_enerf,
    "MVSNeRF": load_mvsnerf,
    "MVSplat": load_mvsplat,
}


@pytest.mark.parametrize("title", LOADERS)
def test_what_is_no_checkpoint_is_refused(title, tmp_path):
    """Absent, damaged, hostile and of another network: refused in one line that names file and
    method, and no code is run.
    """
    hostile = {"state_dict": Hostile(tmp_path / "touched")}
    for name, content in {
        "nowhere": None,
        "hostile": hostile,
        "other": {"of": {"another": torch.zeros(2)}},
    }.items():
        if content:
            torch.save(content, tmp_path / f"{name}.pth")
        words = {
            "nowhere": title,
            "hostile": "a file of tensors only",
            "other": "wanted a state dict",
        }
        with refused(WeightsError, f"{name}.pth", words[name]) as caught:
            LOADERS[title](tmp_path / f"{name}.pth")
        assert "\n" not in str(caught.value)
    assert not (tmp_path / "touched").exists()


@pytest.mark.parametrize("name", LEARNED_BASELINES)
def test_entries_name_what_there_is(name):
    """The classes exist and take what they are given; every label is a method; weights ship where
    they are said to.
    """
    baseline = LEARNED_BASELINES[name]
    if name in TRAINED_BASELINES:
        recipe = RECIPES[name]("compact", 3)
        assert recipe.seed == 3
        assert isinstance(recipe, TrainingRecipe)
        assert recipe.network().configuration == "compact"
    specs = [
        METHODS[label] for label in METHODS if METHODS.root(label) == LEARNED_BASELINES.root(name)
    ]
    assert specs
    for spec in specs:
        assert baseline.checkpoint in spec.checkpoint
        if spec.weights:
            assert spec.weights == (shipped(baseline.weights),)
            assert isinstance(spec.make(), resolve_name(baseline.method))
