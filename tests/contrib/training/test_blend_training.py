"""Training of the blending network: losses by hand, samples that read back, batches of a step, a
real training.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch

from ggvs_eval.compute_device import one_thread
from ggvs_eval.contrib.training.blend_task import (
    BlendLossWeights,
    BlendTask,
    blend_loss,
    crop_arrays,
    depth_loss,
    mask_loss,
    mirrored,
    recoloured,
)
from ggvs_eval.contrib.training.loop import train, write_card
from ggvs_eval.contrib.training.request import TrainingOptions
from ggvs_eval.contrib.training.samples.sample_kinds import BlendKind, read_sample
from ggvs_eval.contrib.training.samples.samples import SampleMaker, SamplePool
from ggvs_eval.contrib.training.samples.training_data import (
    RoomPlan,
    choose_views,
    domain_validation_plan,
    room_options,
)
from ggvs_eval.contrib.worlds.domains import PLAIN
from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.errors import TrainingError
from ggvs_eval.pipelines.online.blend_network import (
    WIDTHS,
    BlendNetwork,
    BlendNetworkShape,
    BlendOutputs,
    load_blend_network,
    shipped_blend_weights,
)
from ggvs_eval.pipelines.online.network_inputs import input_channels
from helpers.filled_pools import fill
from helpers.refusals import refused
from helpers.stereo_scenes import HEIGHT, WIDTH, plane_depth, write_capture

PLAN = RoomPlan(
    rooms=1, targets=2, views=2, other_views=(), other_share=0.0, width=WIDTH, height=HEIGHT
)
VALIDATION = domain_validation_plan(PLAIN, views=2, targets=1, size=(WIDTH, HEIGHT))
CONFIG = BlendNetworkShape(views=3, width=4)  # one more than the samples have
WINDOW = (20, 30, 64, 48)


@pytest.fixture(autouse=True)
def alone():
    """Small networks are faster with one thread."""
    with one_thread():
        yield


@pytest.fixture(scope="module")
def plane_capture(tmp_path_factory):
    """Five cameras before a slanted plane."""
    return write_capture(tmp_path_factory.mktemp("plane"), n_frames=1)


@pytest.fixture(scope="module")
def cache(tmp_path_factory, plane_capture):
    """Its samples, as those of a training room and of a validation room."""
    folder = tmp_path_factory.mktemp("samples")
    for plan in (PLAN, VALIDATION):
        fill(SamplePool(folder, BlendKind(), [plan]), lambda _: plane_capture)
    return folder


@pytest.fixture
def task(cache) -> BlendTask:
    samples = (SamplePool(cache, BlendKind(), [plan]) for plan in (PLAN, VALIDATION))
    return BlendTask(*samples, CONFIG, crop_width=64, crop_height=48, batch_size=2)


def test_depth_loss_is_its_formula():
    """|D - sum a w D_k / sum a w| over H W K; pixels without fused depth and views without depth do
    not count.
    """
    depths = torch.tensor([[[[1.0, 2.0, 3.0, 1.0]], [[2.0, 0.0, 3.0, 1.0]]]])  # (1, 2, 1, 4)
    weights = torch.tensor([[[[0.6, 0.5, 0.4, 0.5]], [[0.2, 0.5, 0.4, 0.5]]]])
    fused = torch.tensor([[[1.5, 2.5, 0.0, 1.0]]])
    first = abs((0.6 * 1 + 0.2 * 2) / 0.8 - 1.5)
    torch.testing.assert_close(
        depth_loss(depths, fused, weights), torch.tensor((first + 0.5) / 4 / 2), atol=1e-5, rtol=0
    )


def test_mask_loss_is_its_formula():
    """The background's weight is wanted where no view covers half a pixel, and nowhere else."""
    alphas = torch.tensor([[[[0.4, 0.9]], [[0.3, 0.1]]]])
    torch.testing.assert_close(
        mask_loss(torch.tensor([[[0.7, 0.2]]]), alphas), torch.tensor((0.3 + 0.2) / 2)
    )


@pytest.mark.parametrize(("tsdf_guidance", "perceptual"), [(True, 0.0), (False, 0.0), (True, 0.25)])
def test_the_loss_weighs_its_terms(tsdf_guidance, perceptual):
    """0.8 L1 + 0.2 (1 - SSIM) + 0.1 depth + 0.1 mask, and the perceptual one; without guidance no
    depth term.
    """
    generator = torch.Generator().manual_seed(0)
    image, alphas = (
        torch.rand(1, 3, 40, 48, generator=generator),
        torch.rand(1, 2, 40, 48, generator=generator),
    )
    shares = torch.softmax(torch.rand(1, 2, 40, 48, generator=generator), dim=1)
    background = torch.rand(1, 3, 40, 48, generator=generator)
    outputs = BlendOutputs(
        shares, torch.rand(1, 40, 48, generator=generator), background, torch.zeros(1, 0, 40, 48)
    )
    batch = {
        "alphas": alphas,
        "truth": torch.rand(1, 3, 40, 48, generator=generator),
        "depths": torch.rand(1, 2, 40, 48, generator=generator),
        "fused_depth": torch.rand(1, 40, 48, generator=generator),
    }
    loss, terms = blend_loss(
        image, outputs, batch, BlendLossWeights(perceptual=perceptual), tsdf_guidance
    )
    factors = {
        "l1_loss": 0.8,
        "ssim_loss": 0.2,
        "mask_loss": 0.1,
        "depth_loss": 0.1,
        "perceptual_loss": perceptual,
    }
    absent = {
        name
        for name, used in (("depth_loss", tsdf_guidance), ("perceptual_loss", perceptual))
        if not used
    }
    assert terms.keys() == factors.keys() - absent
    assert float(loss) == pytest.approx(
        sum(factors[name] * term for name, term in terms.items()), rel=1e-5
    )
    assert terms["l1_loss"] == pytest.approx(float((image - batch["truth"]).abs().mean()), rel=1e-5)


def test_a_sample_is_what_the_method_would_see(plane_capture):
    """Depth from stereo without the target, fused to the plane; sources nearest first; the target's
    own picture as truth.
    """
    target, sources = (
        plane_capture.camera("cam00"),
        [plane_capture.camera(name) for name in ("cam01", "cam03")],
    )
    sample = BlendKind().make(
        SampleMaker(plane_capture, DepthRunOptions(PLAN.matcher).options()), target, sources
    )
    exact = plane_depth(target)
    known = sample.views.fused_depth > 0
    error = np.abs(sample.views.fused_depth - exact)[known]
    assert known.mean() > 0.7
    assert np.median(error / exact[known]) < 0.01
    assert error.max() > 0  # from a matcher, not exact
    assert {camera.name for camera in sample.views.sources} == {"cam01", "cam03"}
    np.testing.assert_array_equal(sample.truth, plane_capture.frame("cam00", 0))


@pytest.mark.slow
def test_a_stored_sample_reads_back(plane_capture, cache):
    """Cameras and fused depth exactly, colours and coverage to 8 bit, splatted depth to half
    precision.
    """
    target, sources = choose_views(plane_capture, PLAN, PLAN.first_room, 1)
    made, read = (
        BlendKind().make(
            SampleMaker(plane_capture, DepthRunOptions(PLAN.matcher).options()), target, sources
        ),
        SamplePool(cache, BlendKind(), [PLAN]).read(1),
    )
    for name in ("splats", "warps", "alphas", "visibilities"):
        np.testing.assert_allclose(
            getattr(read.views, name), getattr(made.views, name), atol=0.5001 / 255, err_msg=name
        )
    np.testing.assert_array_equal(read.views.fused_depth, made.views.fused_depth)
    np.testing.assert_allclose(read.views.depths, made.views.depths, rtol=1e-3)
    np.testing.assert_array_equal(read.truth, made.truth)
    np.testing.assert_array_equal(read.geometric, made.geometric)
    cameras = [(views.target, *views.sources) for views in (made.views, read.views)]
    for once, again in zip(*cameras, strict=True):
        assert (once.name, once.size, once.near, once.far) == (
            again.name,
            again.size,
            again.near,
            again.far,
        )
        np.testing.assert_array_equal(once.world_to_camera, again.world_to_camera)
        np.testing.assert_array_equal(once.K, again.K)
    channels = [
        input_channels(each.views.maps("registered"), "registered") for each in (read, made)
    ]
    np.testing.assert_allclose(*channels, atol=3e-3)


def test_a_damaged_sample_is_refused(cache, tmp_path):
    """Absent, cut off or of other content: one line that names the file and says what to do."""
    whole = next(cache.glob("samples-*/room1000-00.npz")).read_bytes()
    for name, content in {
        "cut.npz": whole[:3000],
        "empty.npz": b"",
        "text.npz": b"no archive",
    }.items():
        (tmp_path / name).write_bytes(content)
        with refused(TrainingError, f"{name}: ", "got none", "prepare again"):
            read_sample(tmp_path / name)
    with refused(TrainingError, "room1000-00.npz"):
        SamplePool(tmp_path, BlendKind(), [PLAN]).read(0)


def test_more_targets_change_no_sample(plane_capture):
    """Which views a sample shows depends on room and number alone; every camera is a target before
    one is again.
    """
    first = [choose_views(plane_capture, PLAN, 1000, number) for number in range(5)]
    assert {target.name for target, _ in first} == set(plane_capture.camera_names)
    again = choose_views(plane_capture, replace(PLAN, targets=90), 1000, 3)
    assert again[0] is first[3][0]
    assert [camera.name for camera in again[1]] == [camera.name for camera in first[3][1]]
    for target, sources in first:
        assert target.name not in {source.name for source in sources}
        assert len({source.name for source in sources}) == 2


def test_some_samples_have_other_numbers_of_views(plane_capture):
    """As often as the plan says."""
    plan = replace(PLAN, other_views=(1, 3), other_share=0.4)
    counts = [len(choose_views(plane_capture, plan, 1000, number)[1]) for number in range(300)]
    assert plan.most_views == 3
    assert set(counts) == {1, 2, 3}
    assert 0.3 < np.mean([count != 2 for count in counts]) < 0.5


def test_rooms_of_tests_are_never_learned_from(tmp_path):
    """Seeds of the demo and of validation rooms are no training rooms; a validation plan has these
    alone.
    """
    for first in (0, 99, 102, 999):
        with refused(TrainingError, "seeds", "1000"):
            RoomPlan(first_room=first, rooms=3)
    assert list(domain_validation_plan(PLAIN, seeds=3).seeds) == [101, 102, 103]
    assert room_options(101, PLAN).noise_sigma_255 == 1.5
    assert room_options(1000, PLAN) != room_options(1001, replace(PLAN))
    with refused(TrainingError, "room, target and view"):
        replace(PLAN, targets=0)


def test_batches_depend_on_the_step_alone(task):
    """The same step gives the same bits, another one others, in the shapes that network and loss
    want.
    """
    once, again, other = task.batch(3), task.batch(3), task.batch(4)
    assert all(torch.equal(once[name], again[name]) for name in once)
    assert not torch.equal(once["channels"], other["channels"])
    shapes = {name: tuple(tensor.shape) for name, tensor in once.items()}
    assert shapes == {
        "channels": (2, 31, 12, 16),
        "colours": (2, 3, 3, 48, 64),
        "coverage": (2, 3, 48, 64),
        "alphas": (2, 3, 48, 64),
        "depths": (2, 3, 48, 64),
        "weights": (2, 3),
        "unseen": (2, 48, 64),
        "background": (2, 3, 48, 64),
        "fused_depth": (2, 48, 64),
        "truth": (2, 3, 48, 64),
    }
    assert all(
        tensor.dtype == torch.float32 and torch.isfinite(tensor).all() for tensor in once.values()
    )
    means = once["colours"].reshape(2, 3, 3, 12, 4, 16, 4).mean(dim=(4, 6))
    torch.testing.assert_close(once["channels"][:, :9].reshape(2, 3, 3, 12, 16), means)
    assert not once["coverage"][:, 2].any()  # the view that the samples do not have


def mirrored_camera(camera):
    """The camera whose picture is the mirrored one, in a world that is mirrored at x = 0."""
    mirror = np.diag([-1.0, 1, 1, 1])
    K = camera.K.copy()
    K[0, 2] = camera.width - K[0, 2]
    return replace(camera, K=K, world_to_camera=mirror @ camera.world_to_camera @ mirror)


def test_a_mirrored_crop_is_that_of_a_mirrored_world(task):
    """Mirroring the channels gives what mirrored cameras and pictures would have given."""
    sample = task.training.read(0)
    views, mirror = (
        sample.views,
        {"splats": 2, "warps": 2, "depths": 2, "alphas": 2, "visibilities": 2, "fused_depth": 1},
    )
    other = replace(
        views,
        target=mirrored_camera(views.target),
        sources=tuple(mirrored_camera(source) for source in views.sources),
        **{name: np.flip(getattr(views, name), axis) for name, axis in mirror.items()},
    )
    window, config = (0, 0, WIDTH, HEIGHT), replace(CONFIG, scale=1)
    expected = crop_arrays(
        replace(sample, views=other, truth=sample.truth[:, ::-1]), window, config
    )
    found = mirrored(crop_arrays(sample, window, config), True)
    for name, values in expected.items():
        np.testing.assert_allclose(found[name], values, atol=2e-4, err_msg=name)
    assert not np.array_equal(mirrored(found, True)["channels"], found["channels"])


def test_recoloured_crops_are_those_of_recoloured_pictures(task):
    """Exchanging colours changes channels, views, background and truth alike."""
    sample, order, tint = (
        task.training.read(0),
        np.array([2, 0, 1]),
        np.array([1, 0.7, 0.4], np.float32),
    )
    tinted = {name: getattr(sample.views, name) * tint for name in ("splats", "warps")}
    sample = replace(sample, views=replace(sample.views, **tinted))
    turned = {name: picture[..., order] for name, picture in tinted.items()}
    other = replace(sample, views=replace(sample.views, **turned), truth=sample.truth[..., order])
    expected, arrays = crop_arrays(other, WINDOW, CONFIG), crop_arrays(sample, WINDOW, CONFIG)
    found = recoloured(arrays, order)
    for name, values in expected.items():
        np.testing.assert_allclose(found[name], values, atol=1e-6, err_msg=name)
    assert not np.array_equal(found["channels"], arrays["channels"])


@pytest.mark.slow
def test_a_real_training_learns(task, tmp_path):
    """Twenty steps move every tensor and lower the loss; the validation stands beside the geometric
    blender; the file loads.
    """
    options = TrainingOptions(
        steps=20, device="cpu", precision="float32", validate_every=20, workers=0
    )
    quick = replace(
        task, schedule=replace(task.schedule, learning_rate=5e-3, warm_up=3, average=0.5)
    )
    batch, fresh = quick.batch(1000), quick.network()
    weights = train(quick, tmp_path, options)
    trained = load_blend_network(weights)
    assert trained.config == CONFIG
    assert weights.name == "blend.safetensors"
    with torch.inference_mode():
        before, after = (float(quick.loss(network, batch)[0]) for network in (fresh, trained))
    assert after < before
    for name, tensor in fresh.unet.named_parameters():
        assert not torch.equal(trained.unet.get_parameter(name), tensor.half().float()), name
    header, figures = (
        line.split(",") for line in (tmp_path / "validation.csv").read_text().splitlines()
    )
    assert header == ["step", "psnr_db", "ssim", "geometric_psnr_db", "geometric_ssim"]
    assert float(figures[1]) > 10
    card = write_card(quick, tmp_path, "ggvs-eval train blend").read_text()
    assert "procedural rooms" in card
    assert str(tmp_path.parent) not in card  # where samples lie is not told


def test_named_sizes():
    """The standard one is what ships and fits 10 MB in half precision; the others are smaller and
    larger.
    """
    megabytes = {
        size: 2
        * sum(
            values.numel() for values in BlendNetwork(BlendNetworkShape(width=width)).parameters()
        )
        / 2**20
        for size, width in WIDTHS.items()
    }
    assert megabytes["small"] < megabytes["standard"] < 10 < megabytes["large"]
    assert load_blend_network(shipped_blend_weights()).config == BlendNetworkShape(
        width=WIDTHS["standard"]
    )


def test_what_does_not_fit_is_refused(task):
    """Another number of views than the samples have, and crops larger than they are, are errors
    before the first step.
    """
    with refused(TrainingError, "1 views", "2 views"):
        replace(task, config=BlendNetworkShape(views=1))
    with refused(TrainingError, "512 x 48", "200 x 150"):
        replace(task, crop_width=512)
