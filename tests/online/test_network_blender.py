"""The blending network as a blender: composition, equal bits, its weights and whom it refuses."""

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from ggvs_eval.compute_device import one_thread
from ggvs_eval.contrib.training.loop import pour_weights, write_weights
from ggvs_eval.errors import RenderError, WeightsError
from ggvs_eval.pipelines.online.blend_network import (
    BlendNetwork,
    BlendNetworkShape,
    BlendOutputs,
    compose_tensors,
    load_blend_network,
    read_outputs,
    shipped_blend_weights,
)
from ggvs_eval.pipelines.online.blending import GeometricBlender
from ggvs_eval.pipelines.online.network_blender import NetworkBlender, blend_by, blend_start
from ggvs_eval.pipelines.online.network_inputs import blend_maps, input_channels
from helpers.blender_inputs import inputs_of
from helpers.refusals import refused
from helpers.scenes import camera_at, instant

TARGET = camera_at(0.0, name="target")
SOURCES = [camera_at(-0.15), camera_at(0.3)]
CONFIG = BlendNetworkShape(views=2, guidance="channels", width=4, scale=1, features=3)


@pytest.fixture(autouse=True)
def alone():
    """Small networks are faster with one thread."""
    with one_thread():
        yield


@pytest.fixture
def network() -> BlendNetwork:
    """Seeded, for two views."""
    torch.manual_seed(0)
    return BlendNetwork(CONFIG)


@pytest.fixture
def weights(network, tmp_path):
    """Its weights as they ship."""
    path = tmp_path / "blend.safetensors"
    write_weights(path, network, {})
    return path


def start_of(batch: int, views: int, height: int, width: int) -> dict[str, torch.Tensor]:
    """A start at which all views weigh the same and nothing is unseen."""
    return {
        "weights": torch.ones(batch, views),
        "unseen": torch.full((batch, height, width), 0.5),
        "background": torch.full((batch, 3, height, width), 0.25),
    }


def test_outputs_are_weights():
    """Raw outputs of any size become weights that sum to 1 and a background in [0, 1]; equal logits
    weigh as the start does.
    """
    raw = 20 * torch.randn(2, 7, 4, 5)
    raw[0, :3] = 1.5
    outputs = read_outputs(raw, start_of(2, 3, 4, 5), 3)
    assert outputs.weights.shape == (2, 3, 4, 5)
    assert outputs.background.shape == (2, 3, 4, 5)
    torch.testing.assert_close(outputs.weights.sum(dim=1), torch.ones(2, 4, 5))
    torch.testing.assert_close(outputs.weights[0], torch.full((3, 4, 5), 1 / 3))
    for values in (outputs.weights, outputs.background_weight, outputs.background):
        assert 0 <= float(values.min()) <= float(values.max()) <= 1


def test_zeros_change_nothing():
    """With outputs of zero, enlarged or not, the start comes back: its weights, what is unseen, its
    background.
    """
    start = start_of(1, 2, 5, 7) | {"weights": torch.tensor([[1.0, 0.25]])}
    for size in ((5, 7), (3, 4)):
        outputs = read_outputs(torch.zeros(1, 6, *size), start, 2)
        torch.testing.assert_close(outputs.weights[0, :, 2, 3], torch.tensor([0.8, 0.2]))
        torch.testing.assert_close(outputs.background_weight, start["unseen"])
        torch.testing.assert_close(outputs.background, start["background"])


def test_views_are_composed_over_the_background():
    """Eqs. 4-5: the views' weighted mean, 0 where no view has weight, and the background over it by
    its weight.
    """
    rng = np.random.default_rng(0)
    colours, background = rng.uniform(size=(3, 6, 7, 3)), rng.uniform(size=(6, 7, 3))
    alphas, shares, background_weight = (
        rng.uniform(size=(3, 6, 7)),
        rng.uniform(size=(3, 6, 7)),
        rng.uniform(size=(6, 7)),
    )
    alphas[:, 2:4, 2:4] = 0
    single = [
        array.astype(np.float32)
        for array in (colours, alphas, shares, background, background_weight)
    ]
    colours, alphas, shares, background, background_weight = single
    weights = (alphas * shares)[..., None]
    foreground = (weights * colours).sum(axis=0) / np.maximum(weights.sum(axis=0), 1e-30)
    expected = foreground + background_weight[..., None] * (background - foreground)
    shown = torch.from_numpy(background).permute(2, 0, 1)[None]
    outputs = BlendOutputs(
        torch.from_numpy(shares)[None],
        torch.from_numpy(background_weight)[None],
        shown,
        torch.zeros(1, 0, 6, 7),
    )
    found = compose_tensors(
        outputs, torch.from_numpy(colours).permute(0, 3, 1, 2)[None], torch.from_numpy(alphas)[None]
    )
    np.testing.assert_allclose(found[0].permute(1, 2, 0).numpy(), expected, atol=1e-6)


def decisive(weights, tmp_path, bias: list[float]):
    """Weights of a network that answers the same everywhere: the bias of its last layer."""
    tensors = {
        name: tensor.float() for name, tensor in load_blend_network(weights).state_dict().items()
    }
    tensors["unet.last.weight"] = torch.zeros_like(tensors["unet.last.weight"]).contiguous()
    tensors["unet.last.bias"] = torch.tensor(bias + [0.0] * CONFIG.features)
    path = tmp_path / "decisive.safetensors"
    save_file({name: tensor.contiguous() for name, tensor in tensors.items()}, path)
    return path


def test_the_network_decides(weights, tmp_path):
    """A network that chooses the nearest view shows its splat; one that chooses the background
    shows that.
    """
    inputs = inputs_of(instant(0, TARGET, SOURCES))
    nearest = (
        NetworkBlender(decisive(weights, tmp_path, [40.0, -40.0, -80.0, 0, 0, 0]))
        .blend(inputs)
        .image
    )
    covered = inputs.splats[0].alpha > 0.5
    np.testing.assert_allclose(
        nearest[covered], inputs.splats[0].features[..., :3][covered], atol=1e-4
    )
    (tmp_path / "other").mkdir()
    black = (
        NetworkBlender(decisive(weights, tmp_path / "other", [0.0, 0, 80, -40, -40, -40]))
        .blend(inputs)
        .image
    )
    assert black.max() < 1e-6


def test_weights_of_before_the_condition_serve_on(weights, tmp_path):
    """A file without the refiner's condition gives the picture of one whose condition is zero."""
    tensors = {
        name: tensor.contiguous()
        for name, tensor in load_blend_network(weights).state_dict().items()
    }
    files = tmp_path / "without.safetensors", tmp_path / "zero.safetensors"
    save_file(
        {name: tensor for name, tensor in tensors.items() if "condition" not in name}, files[0]
    )
    save_file(
        {
            name: torch.zeros_like(tensor) if "condition" in name else tensor
            for name, tensor in tensors.items()
        },
        files[1],
    )
    first, second = (
        NetworkBlender(file).blend(inputs_of(instant(0, TARGET, SOURCES))).image for file in files
    )
    np.testing.assert_array_equal(first, second)
    network = load_blend_network(weights)
    torch.nn.init.ones_(network.refiner.condition.weight)
    pour_weights(files[0], network)  # as a training that starts from it does
    assert not network.refiner.condition.weight.any()


def test_another_number_of_views_is_refused(weights):
    """A network for two views says so when it is given three; one view is fine."""
    alone = NetworkBlender(weights).blend(inputs_of(instant(0, TARGET, SOURCES[:1])))
    assert alone.image.shape == (TARGET.height, TARGET.width, 3)
    inputs = inputs_of(instant(0, TARGET, [*SOURCES, camera_at(0.45)]))
    with refused(RenderError, "blend.safetensors", "2 source views", "got 3"):
        NetworkBlender(weights).blend(inputs)


@pytest.mark.parametrize(
    "config",
    [
        CONFIG,
        BlendNetworkShape(3, "none", 6),
        BlendNetworkShape(1, "channels", 4),
        BlendNetworkShape(6, "registered", 4),
    ],
)
def test_the_configuration_is_known_from_the_tensors(config, tmp_path):
    """Views, guidance and width come back from the file, and so do the weights, in half
    precision.
    """
    network = BlendNetwork(config)
    write_weights(tmp_path / "any.safetensors", network, {})
    loaded = load_blend_network(tmp_path / "any.safetensors")
    assert loaded.config == config
    for name, tensor in network.state_dict().items():
        kept = tensor.half().float() if tensor.is_floating_point() else tensor
        torch.testing.assert_close(loaded.state_dict()[name], kept, msg=name)


def test_weights_of_something_else_are_refused(network, tmp_path):
    """Absent, damaged, other tensors, one tensor of another shape: one line each that names the
    file.
    """
    missing = tmp_path / "missing.safetensors"
    with refused(WeightsError, "missing.safetensors", "blending network"):
        load_blend_network(missing)
    for content in (b"no tensors", b"\x80\x04K\x01."):
        (tmp_path / "damaged.safetensors").write_bytes(content)
        with refused(WeightsError, "damaged.safetensors", "not safetensors"):
            load_blend_network(tmp_path / "damaged.safetensors")
    tensors = dict(network.state_dict())
    for name, changed, message in (
        ("other", {"weight": torch.zeros(2, 2)}, "1 tensors of no blending network"),
        (
            "inputs",
            tensors | {"unet.down.0.0.weight": torch.zeros(4, 17, 3, 3)},
            "want 21 inputs, 19 as printed, 16 without TSDF",
        ),
        (
            "shape",
            tensors | {"unet.up.0.0.bias": torch.zeros(7)},
            r"1 tensors differ .*unet\.up\.0\.0\.bias: .*got \(7,\)",
        ),
        ("views", tensors | {"unet.last.weight": torch.zeros(7, 4, 1, 1)}, "7 outputs, 0 views"),
    ):
        path = tmp_path / f"{name}.safetensors"
        save_file({key: value.contiguous() for key, value in changed.items()}, path)
        with pytest.raises(WeightsError, match=message):
            load_blend_network(path)


def test_weights_that_do_not_ship_are_named(monkeypatch, tmp_path):
    """For a guidance nobody trained for, the message says what is there and what to do."""
    monkeypatch.setattr(
        "ggvs_eval.pipelines.online.blend_network.resources.files", lambda package: tmp_path
    )
    with refused(WeightsError, "none guidance", "blend-no-tsdf.safetensors"):
        shipped_blend_weights("none")


@pytest.mark.parametrize("config", [CONFIG, BlendNetworkShape(3, "registered", 4, scale=2)])
def test_an_image_of_a_batch_is_the_blenders_image(config):
    """Training composes by the twin what the blender composes by numpy: the same image within
    rounding, absent views too.
    """
    torch.manual_seed(1)
    network = BlendNetwork(config).eval()
    torch.nn.init.normal_(network.unet.last.weight, std=0.3)
    torch.nn.init.normal_(network.refiner.taps.weight, std=0.1)
    torch.nn.init.normal_(network.refiner.condition.weight, std=0.05)
    maps = blend_maps(inputs_of(instant(0, TARGET, SOURCES)), config.guidance)
    start = {name: torch.from_numpy(array)[None] for name, array in blend_start(maps).items()}
    with torch.inference_mode():
        channels = input_channels(maps.reduced(config.scale), config.guidance, config.views)
        outputs = read_outputs(network(torch.from_numpy(channels)[None]), start, config.views)
        views = {
            "colours": torch.from_numpy(maps.colours).permute(0, 3, 1, 2)[None],
            "coverage": torch.from_numpy(maps.coverage)[None],
            "fused_depth": torch.from_numpy(maps.fused_depth)[None],
        }
        composed = compose_tensors(outputs, views["colours"], views["coverage"])
        twin = network.refine(composed, outputs, views)[0].clamp(0, 1)
    np.testing.assert_allclose(
        blend_by(network, maps).image, twin.permute(1, 2, 0).numpy(), atol=1e-4
    )


def test_an_untrained_network_is_the_geometric_blender():
    """Before the first step the registered views are blended by distance: the geometric blender's
    image, but for the faint.
    """
    inputs = inputs_of(instant(0, TARGET, SOURCES))
    network = BlendNetwork(BlendNetworkShape(2, "registered", 4)).eval()
    image, geometric = (
        blend_by(network, blend_maps(inputs, "registered")).image,
        GeometricBlender().blend(inputs).image,
    )
    assert np.abs(image - geometric).mean() < 0.01
