"""Training of the baselines: samples that read back, sources cut to what is seen, real steps,
weights that render.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch

from ggvs_eval.compute_device import one_thread
from ggvs_eval.contrib.training.instant_samples import read_instant
from ggvs_eval.contrib.training.loop import train, write_card
from ggvs_eval.contrib.training.recipes.recipe import RECIPES, TRAINED_BASELINES
from ggvs_eval.contrib.training.request import TrainingOptions
from ggvs_eval.contrib.training.samples.sample_kinds import InstantKind
from ggvs_eval.contrib.training.samples.samples import SampleMaker, SamplePool
from ggvs_eval.contrib.training.samples.training_data import (
    RoomPlan,
    choose_views,
    domain_validation_plan,
)
from ggvs_eval.contrib.training.train_one import LEAST_CROP_PX, BaselineTask, baseline_task
from ggvs_eval.contrib.worlds.domains import PLAIN
from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.errors import TrainingError, WeightsError
from ggvs_eval.files.weights_file import configuration_of
from ggvs_eval.pipelines.methods.network_options import NetworkOptions
from ggvs_eval.pipelines.methods.registry import METHODS, find_method
from helpers.filled_pools import fill
from helpers.refusals import refused
from helpers.stereo_scenes import write_capture

WIDTH, HEIGHT = 100, 75
PLAN = RoomPlan(
    rooms=1, targets=2, views=3, other_views=(), other_share=0.0, width=WIDTH, height=HEIGHT
)
VALIDATION = domain_validation_plan(PLAIN, views=3, targets=1, size=(WIDTH, HEIGHT))

# One is slow; that the others are trained in the same way is proved.
DEAREST_LAST = [
    pytest.param(what, marks=pytest.mark.slow if what == "enerf" else pytest.mark.proof)
    for what in TRAINED_BASELINES
]
ONE_CROP = {
    "samples": torch.tensor([0]),
    "places": torch.tensor([[0.5, 0.5]]),
    "colours": torch.arange(3)[None],
    "step": torch.tensor(0),
}


@pytest.fixture(autouse=True)
def alone():
    """Small networks are faster with one thread."""
    with one_thread():
        yield


@pytest.fixture(scope="module")
def plane_capture(tmp_path_factory):
    """Five cameras before a slanted plane."""
    return write_capture(tmp_path_factory.mktemp("plane"), n_frames=1).resized(
        WIDTH, HEIGHT, "area"
    )


@pytest.fixture(scope="module")
def cache(tmp_path_factory, plane_capture):
    """Its samples, with and without depth, as those of a training room and of a validation room."""
    folder = tmp_path_factory.mktemp("samples")
    for plan in (PLAN, VALIDATION):
        for depth in (True, False):
            fill(SamplePool(folder, InstantKind(depth), [plan]), lambda _: plane_capture)
    return folder


def small_task(what, cache):
    baseline = TRAINED_BASELINES[what]
    samples = (
        SamplePool(cache, InstantKind(baseline.takes_depth), [plan]) for plan in (PLAN, VALIDATION)
    )
    return BaselineTask(
        *samples, baseline, replace(RECIPES[what]("compact", 0), crop_width=64, crop_height=48)
    )


@pytest.mark.slow
def test_samples_are_those_of_the_blending_network_and_read_back(cache, plane_capture):
    """Target, sources and depth are what the blending network's samples are made of; without depth,
    only pictures are there.
    """
    maker = SampleMaker(plane_capture, DepthRunOptions(PLAN.matcher).options())
    target, sources = choose_views(plane_capture, PLAN, 1000, 1)
    made = maker.instant(target, sources)
    read = SamplePool(cache, InstantKind(), [PLAN]).read(1)
    assert [view.camera.name for view in read.instant.sources] == [
        source.name for source in sources
    ]
    np.testing.assert_array_equal(read.instant.target.world_to_camera, target.world_to_camera)
    np.testing.assert_array_equal(read.truth, plane_capture.frame(target.name, 0))
    for view, expected in zip(read.instant.sources, made.sources, strict=True):
        np.testing.assert_array_equal(view.image, expected.image)
        np.testing.assert_array_equal(view.depth > 0, expected.depth > 0)
        np.testing.assert_allclose(view.depth, expected.depth, rtol=6e-4)
    bare = SamplePool(cache, InstantKind(depth=False), [PLAN]).read(1)
    assert not any(view.depth.any() for view in bare.instant.sources)
    np.testing.assert_array_equal(bare.instant.sources[0].image, made.sources[0].image)


def test_a_damaged_sample_is_refused(tmp_path):
    """Absent or cut off: one line that names the file and says what to do."""
    (tmp_path / "cut.npz").write_bytes(b"PK\x03\x04 no archive")
    for name in ("cut", "nowhere"):
        with refused(TrainingError, f"{name}.npz", "got none", "prepare again"):
            read_instant(tmp_path / f"{name}.npz")


def test_focused_sources_show_all_that_the_window_can(cache):
    """Every point that the window sees lies in the cut where it lay in the whole image, and shows
    the same colour.
    """
    whole = SamplePool(cache, InstantKind(), [PLAN]).read(0).cropped(30, 20, 48, 32)
    cut = whole.focused(margin_px=4, multiple=8)
    target = whole.instant.target
    uv = np.random.default_rng(3).uniform((0, 0), target.size, (200, 2))
    points = target.unproject(uv, np.random.default_rng(4).uniform(target.near, target.far, 200))
    assert len({view.image.shape for view in cut.instant.sources}) == 1
    seen = 0
    for view, before in zip(cut.instant.sources, whole.instant.sources, strict=True):
        assert view.image.shape[:2] == (view.camera.height, view.camera.width) == view.depth.shape
        where, _ = before.camera.project(points)
        inside = ((where >= 0) & (where < before.camera.size)).all(axis=1)
        column, row = np.floor(where[inside]).astype(int).T
        there, _ = view.camera.project(points[inside])
        assert ((there >= 0) & (there < view.camera.size)).all()
        new_column, new_row = np.floor(there + 1e-9).astype(int).T
        np.testing.assert_array_equal(view.image[new_row, new_column], before.image[row, column])
        seen += int(inside.sum())
    assert seen > 200
    assert cut.instant.sources[0].image.size < whole.instant.sources[0].image.size


@pytest.mark.parametrize("what", DEAREST_LAST)
def test_a_batch_is_learned(what, cache):
    """Some steps on one batch lower its loss; the same step draws the same crops, another one
    others.
    """
    task = small_task(what, cache)
    batch, again, other = task.batch(3), task.batch(3), task.batch(4)
    assert all(torch.equal(batch[name], again[name]) for name in batch)
    assert not torch.equal(batch["places"], other["places"])
    network = task.network()
    optimiser = torch.optim.Adam(network.parameters(), 1e-3)
    losses = []
    for _ in range(3):
        loss, figures = task.loss(network, batch)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    assert min(losses[1:]) < losses[0]
    assert all(np.isfinite(value) for value in figures.values())


@pytest.mark.slow
@pytest.mark.parametrize("what", ["enerf", "fwd"])
def test_trained_weights_learn_under_the_statistics_that_they_are_used_with(what, cache):
    """Those of whole views are settled at the end of a first training, and stay where trained
    weights go on.
    """
    first, further = small_task(what, cache), replace(small_task(what, cache), has_statistics=True)
    network = first.network()
    fresh = statistics_of(network)
    first.settle(network)
    settled = statistics_of(network)
    assert any(not torch.equal(settled[name], fresh[name]) for name in fresh)
    further.loss(network, ONE_CROP)
    further.settle(network)
    assert all(torch.equal(statistics_of(network)[name], settled[name]) for name in settled)


def statistics_of(network):
    return {name: tensor.clone() for name, tensor in network.named_buffers() if "running" in name}


@pytest.mark.parametrize("what", DEAREST_LAST)
def test_what_a_training_writes_renders(what, cache, tmp_path):
    """The file says its configuration and renders by the method's label; its picture is the one
    that was validated.
    """
    task = small_task(what, cache)
    options = TrainingOptions(
        steps=1, device="cpu", precision="float32", validate_every=1, workers=0
    )
    weights = train(task, tmp_path, options)
    assert configuration_of(weights, ("compact",), what) == "compact"
    figures = dict(
        zip(
            *(line.split(",") for line in (tmp_path / "validation.csv").read_text().splitlines()),
            strict=True,
        )
    )
    sample = task.validation.read(0)
    label = "gps-gaussian+given-depth" if what == "gps-gaussian" else what
    rendered = find_method(label, NetworkOptions({what: weights})).make().step(sample.instant).image
    assert rendered.shape == sample.truth.shape
    step = task.recipe.validated_step
    error = np.square(rendered - sample.truth / np.float32(255))[::step, ::step].mean()
    assert -10 * np.log10(error) == pytest.approx(float(figures["psnr_db"]), abs=0.1)
    card = write_card(task, tmp_path, f"ggvs-eval train {what}").read_text()
    assert "procedural rooms" in card
    assert str(tmp_path.parent) not in card


class Walked(SamplePool):
    """The views of the first source, but for their cameras: each stands behind the one before, as
    in a corridor.
    """

    def read(self, index):
        sample = super().read(index)
        if index >= self.sources[0].count:
            return sample
        target, sources = sample.instant.target, []
        for number, source in enumerate(sample.instant.sources):
            pose = target.world_to_camera.copy()
            pose[2, 3] += 0.1 * (number + 1)
            sources.append(replace(source, camera=replace(source.camera, world_to_camera=pose)))
        return replace(sample, instant=replace(sample.instant, sources=tuple(sources)))


class Blind(SamplePool):
    """The views of the first source without any depth, as sensors have them of what is far."""

    def read(self, index):
        sample = super().read(index)
        if index >= self.sources[0].count:
            return sample
        sources = tuple(
            replace(source, depth=np.zeros_like(source.depth)) for source in sample.instant.sources
        )
        return replace(sample, instant=replace(sample.instant, sources=sources))


@pytest.mark.slow
@pytest.mark.parametrize("what", ["fwd", "gps-gaussian"])
def test_a_window_that_no_depth_reaches_teaches_nothing(what, cache):
    """What is made of given depth shows nothing there, so the next view is learned from."""
    task = small_task(what, cache)
    network, kind = task.network(), InstantKind()
    loss, _ = replace(task, training=Blind(cache, kind, [PLAN, PLAN])).loss(network, ONE_CROP)
    loss.backward()
    assert any(
        parameter.grad is not None and parameter.grad.any() for parameter in network.parameters()
    )
    if what == "gps-gaussian":  # FWD's network fills what its points do not reach
        with refused(TrainingError, "got none", "depth"):
            replace(task, training=Blind(cache, kind, [PLAN])).loss(network, ONE_CROP)


@pytest.mark.slow
def test_what_a_method_cannot_render_is_passed_over_and_told(cache):
    """GPS-Gaussian finds no stereo pair in a corridor: it learns from the next view, and the card
    says what is left out.
    """
    task = small_task("gps-gaussian", cache)
    walked = [Walked(cache, InstantKind(), [plan]) for plan in (PLAN, VALIDATION)]
    both = [Walked(cache, InstantKind(), [plan, plan]) for plan in (PLAN, VALIDATION)]
    with_walks = replace(task, training=both[0], validation=both[1])
    network = task.network()
    expected, _ = task.loss(network, ONE_CROP)
    for passed_over in range(len(walked[0]) + 1):
        loss, figures = with_walks.loss(
            network, ONE_CROP | {"samples": torch.tensor([passed_over])}
        )
        assert torch.equal(loss, expected)
        assert figures["passed_over"] == len(walked[0]) - passed_over
    assert with_walks.validate(network) == task.validate(network)
    assert (
        "without 1 of them, as the method cannot render such views: GPS-Gaussian needs"
        in with_walks.evaluated_on
    )
    assert "without" not in task.evaluated_on
    alone = replace(task, training=walked[0], validation=walked[1])
    with refused(TrainingError, "wanted training views", "got none", "wanted a stereo pair"):
        alone.loss(network, ONE_CROP)
    with refused(TrainingError, "wanted validation views", "got none"):
        alone.validate(network)


def test_crops_are_as_large_as_is_asked(tmp_path):
    """Those of the recipe where nothing is; larger ones than the samples are refused."""
    rooms = TrainingOptions(rooms=1, targets=1, domains=(PLAIN,))
    usual = baseline_task("fwd", tmp_path, rooms).recipe
    assert (usual.crop_width, usual.crop_height) == (192, 160)
    assert baseline_task("fwd", tmp_path, rooms, crop=(384, 288)).step_pixels == 384 * 288
    for size, named in (
        ((488, 288), "488 x 288"),
        ((50, 40), "50 x 40"),
        ((24, 40), "24 x 40"),
        ((-8, 0), "--crop"),
    ):
        with refused(TrainingError, named):
            baseline_task("fwd", tmp_path, rooms, crop=size)


@pytest.mark.slow
@pytest.mark.parametrize("what", TRAINED_BASELINES)
def test_the_least_crop_teaches_every_baseline(what, cache):
    """Of the smallest sides that are allowed, which no coarse level divides without rest but the
    coarsest.
    """
    task = small_task(what, cache)
    recipe = replace(task.recipe, crop_width=40, crop_height=LEAST_CROP_PX)
    loss, _ = replace(task, recipe=recipe).loss(task.network(), ONE_CROP)
    assert loss.requires_grad
    assert torch.isfinite(loss)


def test_a_configuration_that_is_not_taught_is_refused(cache):
    """The full GPS-Gaussian finds depth itself, which nothing here would teach it."""
    with refused(TrainingError, "stereo network"):
        baseline_task("gps-gaussian", cache, TrainingOptions(rooms=1), "full")


def test_retrained_methods_are_labelled(tmp_path):
    """Tables tell what we trained from what its authors did; without weights the reason stands
    there.
    """
    for label in ("fwd", "ibrnet", "enerf", "mvsplat", "gps-gaussian+given-depth"):
        method = label.partition("+")[0]
        assert METHODS[label].title.endswith("(retrained, compact)")
        with_own = find_method(label, NetworkOptions({method: tmp_path / "authors.pth"}))
        assert "retrained" not in with_own.title
        assert with_own.weights == (tmp_path / "authors.pth",)
    with refused(WeightsError, "FWD", "--weights fwd=FILE"):
        replace(METHODS["fwd"], weights=()).make()
