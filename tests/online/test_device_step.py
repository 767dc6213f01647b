"""The online step on a device, by Warp's CPU device: what the compiled path renders, stage by stage and as a whole."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from ggvs_eval import compute_device
from ggvs_eval.arrays import Image8
from ggvs_eval.camera import Camera
from ggvs_eval.errors import RenderError
from ggvs_eval.files.images import quantise
from ggvs_eval.geometry.contested_depth import settle_depth
from ggvs_eval.geometry.difference_mask import difference_mask
from ggvs_eval.geometry.splat import splat
from ggvs_eval.geometry.tsdf import PreviousDepth, fusion_weights, ray_march
from ggvs_eval.geometry.warp import register_views, warp
from ggvs_eval.pipelines.methods import ours
from ggvs_eval.pipelines.methods.network_options import NetworkOptions
from ggvs_eval.pipelines.methods.registry import find_method
from ggvs_eval.pipelines.online import network_blender
from ggvs_eval.pipelines.online.blend_maps import BlendMaps
from ggvs_eval.pipelines.online.blending import push_pull
from ggvs_eval.pipelines.online.depth_filter import filter_depth
from ggvs_eval.pipelines.online.exposure_compensation import ExposureCompensation
from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided, OnlineOptions
from ggvs_eval.pipelines.online.lens_falloff import corner_of, fallen_off, squared_tangents
from ggvs_eval.pipelines.online.network_blender import NetworkBlender
from ggvs_eval.pipelines.online.network_inputs import input_channels
from ggvs_eval.pipelines.play.synthesizer import OnlineSynthesizer
from helpers.device_scenes import room_instants
from helpers.geometry_scenes import TAU, random_camera, random_depth, view_of
from helpers.refusals import refused
from helpers.scenes import camera_at, texture

pytest.importorskip("warp", reason="the online step on a device wants NVIDIA Warp: pip install 'ggvs-eval[gpu]'")

import warp as wp

from ggvs_eval.pipelines.online.device import (
    blend_kernels,
    depth_stages,
    exposure,
    filter_kernels,
    march_kernels,
    picture,
    sampling,
    splat_kernels,
    splats,
    step,
    views,
)
from ggvs_eval.pipelines.online.device.order_statistics import masked_median
from ggvs_eval.pipelines.online.device.step import DeviceGuided

pytestmark = pytest.mark.slow

CPU = torch.device("cpu")
LEVEL = 1 / 255
SIZES = ((40, 30), (33, 26), (40, 30))  # of sources beside each other


def tensor(array: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(array))


@pytest.fixture(scope="module")
def rig() -> SimpleNamespace:
    """Three views of a rough surface from around a target, of two sizes, on the host and on the device, and their splats."""
    random = np.random.default_rng(4)
    target = random_camera(random, 45, 37, "target")
    cameras = [random_camera(random, *size, f"cam{number}") for number, size in enumerate(SIZES)]
    sources = []
    for camera in cameras:
        depth = random_depth(random, camera)
        sources.append(view_of(camera, depth, quantise(texture(camera.centre + depth[..., None] * camera.rays(), 0.0))))
    there = views.upload(sources, CPU)
    masks = torch.from_numpy(random.random(there.depths.shape, dtype=np.float32))
    host_masks = [there.layer(masks, k).numpy() for k in range(len(sources))]
    near = [splat([source], target, near=0.2, extras=[mask]) for source, mask in zip(sources, host_masks, strict=True)]
    far = splats.splat_views(target, there, there.depths, masks, near=0.2, scale=0.5, capacity=4 * there.depths.numel())
    return SimpleNamespace(target=target, sources=sources, views=there, masks=masks, splats=near, device_splats=far)


@pytest.mark.parametrize(("width", "height"), [(40, 32), (37, 29), (5, 3)])
@pytest.mark.parametrize("channels", ["largest", "mean"])
def test_masks_are_those_of_the_compiled_path(width, height, channels):
    """Eq. 1 to a millionth, whether cells are whole pixels or not; Eq. 2 and Eqs. 11-12 bit for bit."""
    random = np.random.default_rng(width)
    now, before = random.integers(0, 256, (2, height, width, 3), np.uint8)
    mask = difference_mask(now, before, channels=channels, lambda_t=0.9)
    there = depth_stages.change_between(tensor(now), tensor(before), lambda_t=0.9, beta=0.6, mean=channels == "mean").mask
    assert np.ptp(mask) > 0
    np.testing.assert_allclose(there.numpy(), mask, atol=1e-6)
    camera = random_camera(random, width, height)
    depth, history = random_depth(random, camera), random_depth(random, camera, noise=0.05)
    mixed = depth_stages.filter_depth(tensor(depth), tensor(history), tensor(mask), 0.02)
    np.testing.assert_array_equal(mixed.numpy(), filter_depth(depth, history, mask, 0.02))
    weights = depth_stages.fusion_weights(tensor(depth), TAU, 0.001)
    np.testing.assert_array_equal(weights.numpy(), fusion_weights(depth, TAU, 0.001))


def test_splats_are_those_of_the_compiled_path(rig):
    """Colour, mask, coverage and depth of every view, whatever its size, but for rounding: the CPU fuses its multiply-adds.

    Where a Gaussian's alpha rounds to the other side of 1/255, a pixel may differ by that.
    """
    for k, view in enumerate(rig.splats):
        assert 0.5 < (view.alpha > 0.5).mean() < 1
        found = rig.device_splats.features[k], rig.device_splats.alphas[k], rig.device_splats.depths[k]
        for there, here in zip(found, (view.features, view.alpha, view.depth), strict=True):
            off = np.abs(there.numpy() - here)
            assert (off <= 1e-5 * (1 + here)).mean() >= 0.999
            assert off.max() < 0.02


def test_equal_depths_keep_their_order():
    """A wall that is parallel to both cameras: all Gaussians tie, and reading order decides, as it does there."""
    cameras = [replace(camera_at(x, name=f"x{x}"), width=40, height=30) for x in (0.0, 0.3)]
    random = np.random.default_rng(0)
    source = view_of(cameras[1], np.full((30, 40), 4.0, np.float32), random.integers(0, 256, (30, 40, 3), np.uint8))
    there, mask = views.upload([source], CPU), torch.ones(1, 30, 40)
    found = splats.splat_views(cameras[0], there, there.depths, mask, near=0.2, scale=0.5, capacity=5000)
    here = splat([source], cameras[0], near=0.2, extras=[np.ones((30, 40), np.float32)]).features
    np.testing.assert_allclose(found.features[0].numpy(), here, atol=1e-5)


def test_pairs_without_room_are_counted(rig):
    """What is too much is lost, and how much there was is told, so that it can be done again."""
    needed = int(rig.device_splats.pairs)
    again = [
        splats.splat_views(rig.target, rig.views, rig.views.depths, rig.masks, near=0.2, scale=0.5, capacity=capacity)
        for capacity in (needed, needed // 3)
    ]
    assert [int(each.pairs) for each in again] == [needed, needed]
    assert torch.equal(again[0].features, rig.device_splats.features)
    assert not torch.equal(again[1].features, rig.device_splats.features)


@pytest.mark.parametrize("skip_empty", [True, False])
def test_marches_have_the_bits_of_the_compiled_path(rig, skip_empty):
    """Depth and weight of every ray, with and without the depth of the instant before, whatever is skipped."""
    cameras, depths = [source.camera for source in rig.sources], [source.depth for source in rig.sources]
    weights = [fusion_weights(depth, TAU, 0.001) for depth in depths]
    stack = torch.zeros_like(rig.views.depths)
    for k, weight in enumerate(weights):
        rig.views.layer(stack, k).copy_(torch.from_numpy(weight))
    options = depth_stages.MarchOptions(TAU, skip_empty=skip_empty)
    here = ray_march(rig.target, cameras, depths, weights, tau=TAU)
    there = depth_stages.ray_march(rig.target, rig.views, rig.views.depths, stack, options)
    assert (here.depth > 0).mean() > 0.8
    gain = np.random.default_rng(1).random(here.depth.shape, dtype=np.float32)
    moved = replace(rig.target, world_to_camera=cameras[0].world_to_camera)
    before = PreviousDepth(moved, here.depth, here.weight, gain, 0.7)
    past = depth_stages.PastDepth(replace(there, target=moved), tensor(gain), 0.7)
    later = ray_march(rig.target, cameras, depths, weights, tau=TAU, previous=before)
    later_there = depth_stages.ray_march(rig.target, rig.views, rig.views.depths, stack, options, past)
    assert not np.array_equal(here.depth, later.depth)
    for one, other in ((here, there), (later, later_there)):
        np.testing.assert_array_equal(other.depth.numpy(), one.depth)
        np.testing.assert_array_equal(other.weight.numpy(), one.weight)


def test_contested_depth_and_registration(rig):
    """From equal splats a fused depth that views contradict is settled by the same votes; registered views have the same bits."""
    stacks = (np.stack([getattr(view, name) for view in rig.splats]) for name in ("features", "alpha", "depth"))
    same_splats = splats.DeviceSplats(*map(tensor, stacks), rig.device_splats.pairs)
    fused = np.abs(random_depth(np.random.default_rng(7), rig.target, noise=0.1))
    here = settle_depth(rig.target, fused, rig.sources, rig.splats, 0.05)
    there = depth_stages.settle_depth(rig.target, tensor(fused), rig.views, same_splats, 0.05)
    assert 0.05 < (here != fused).mean() < 0.95
    np.testing.assert_array_equal(there.numpy(), here)
    colours, coverage, visibilities = register_views(rig.target, here, rig.sources, rig.splats, 0.1, 0.02)
    found = picture.register_views(rig.target, there, rig.views, same_splats, 0.1)
    assert 0.1 < (visibilities > 0).mean() < 1
    np.testing.assert_allclose(found.colours.permute(0, 2, 3, 1).numpy(), colours, atol=1e-6)  # fused sums, row by row, here
    np.testing.assert_array_equal(found.coverage.numpy(), coverage)
    np.testing.assert_array_equal(found.visibilities.numpy(), visibilities)


def test_warps_are_those_of_the_compiled_path(rig):
    """Colours wherever the surface lies in an image, seen or not, but for rounding; visibilities are equal."""
    fused = random_depth(np.random.default_rng(9), rig.target, noise=0.02)
    colours, visibilities = sampling.warp_views(rig.target, tensor(fused), rig.views, TAU)
    for k, source in enumerate(rig.sources):
        image = source.image.astype(np.float32) / np.float32(255)
        here = warp(rig.target, fused, source.camera, image, source.depth, TAU, bicubic=True)
        assert 0.02 < ((here.visibility == 0) & here.colour.any(axis=-1)).mean() < 0.98
        np.testing.assert_array_equal(visibilities[k].numpy(), here.visibility)
        np.testing.assert_allclose(colours[k].permute(1, 2, 0).numpy(), here.colour, atol=1e-6)


@pytest.mark.parametrize("scale", [1, 4])
def test_what_the_network_sees(rig, scale):
    """Its channels, of reduced maps whose size the scale does not divide; and push-pull, from much and from nothing."""
    fused = random_depth(np.random.default_rng(8), rig.target)
    found = picture.register_views(rig.target, tensor(fused), rig.views, rig.device_splats, TAU)
    cameras = tuple(source.camera for source in rig.sources)
    maps = BlendMaps(
        rig.target,
        cameras,
        *(each.numpy() for each in (found.colours.permute(0, 2, 3, 1).contiguous(), found.coverage, found.visibilities)),
        *(each.numpy() for each in (found.alphas, found.depths)),
        fused,
    ).reduced(scale)
    for guidance in ("registered", "channels"):
        channels = picture.network_channels(found.reduced(scale), guidance == "registered", 5)
        np.testing.assert_allclose(channels.numpy(), input_channels(maps, guidance, 5), atol=2e-5, rtol=2e-5)
    image = found.colours[0]
    for known in (found.alphas[0] > 0.5, torch.zeros_like(found.alphas[0], dtype=torch.bool), found.alphas[0] > 2 * scale - 9):
        filled = push_pull(image.permute(1, 2, 0).contiguous().numpy(), known.numpy())
        np.testing.assert_allclose(picture.push_pull(image, known).permute(1, 2, 0).numpy(), filled, atol=1e-5)


def darkened(image: Image8, camera: Camera, gain: float) -> Image8:
    """What a camera with a gain and a lens that darkens its corners sees."""
    down, across = squared_tangents(camera)
    return np.rint(image * (gain * np.exp(-0.9 * (down[:, None] + across)))[..., None]).clip(0, 255).astype(np.uint8)


def test_gains_and_fall_off():
    """Both are those of the compiled path, at first and from memory, and there is a fall-off to be found."""
    compensation, state = ExposureCompensation(), None
    for instant in room_instants():
        dark = [darkened(view.image, view.camera, 1.06 - 0.03 * k) for k, view in enumerate(instant.sources)]
        instant = replace(instant, sources=tuple(replace(v, image=d) for v, d in zip(instant.sources, dark, strict=True)))
        there, tau = views.upload(instant.sources, CPU), 0.05 * instant.units_per_metre
        seen = compensation.step(instant, tau)
        found, state = exposure.estimate_exposure(instant.index, instant.target, there, there.depths, tau, state, 10)
        assert float(found.slope) == pytest.approx(compensation.slope, abs=1e-4)
        images = exposure.compensate(there, found).numpy()
        off = np.abs(images.astype(int) - np.stack([view.image for view in seen.sources]))
        assert off.max() <= 1
        assert (off > 0).mean() < 1e-3
    assert compensation.slope < -0.1
    assert np.ptp(found.gains.numpy()) > 0.02
    image = np.random.default_rng(0).random((instant.target.height, instant.target.width, 3), dtype=np.float32)
    shown = exposure.show_fall_off(tensor(np.moveaxis(image, 2, 0)), instant.target, found).permute(1, 2, 0)
    corner = corner_of([instant.target, *there.cameras])
    np.testing.assert_allclose(shown.numpy(), fallen_off(image, instant.target, compensation.slope, corner), atol=1e-3)


def rendered(method, instants):
    return [method.step(instant) for instant in instants]


@pytest.fixture(scope="module")
def compiled():
    """Renderings of the demo room by the compiled path."""
    return rendered(GeometryGuided(blender=NetworkBlender()), room_instants())


@pytest.fixture(scope="module")
def on_device():
    """The same by the device's."""
    return rendered(DeviceGuided(), room_instants())


def assert_alike(there, here, share=0.999):
    """At least 99.9 % of the pixels within a level, of the depths within 1e-4 of the depth; the same stages and diagnostics.

    Ten times as many may differ of the diagnostics: their cells are coarse, and the network's weights feel a depth far around it.
    """
    assert there.image.dtype == here.image.dtype == np.float32
    assert (np.abs(there.image - here.image).max(axis=-1) <= LEVEL).mean() >= share
    assert (np.abs(there.depth - here.depth) <= 1e-4 * here.depth).mean() >= share
    assert there.seconds.keys() == here.seconds.keys()
    assert there.diagnostics.keys() == here.diagnostics.keys()
    for name, values in there.diagnostics.items():
        assert (np.abs(values - here.diagnostics[name]) <= 1e-3 * (1 + np.abs(values))).mean() >= 1 - 10 * (1 - share), name


def test_the_demo_room_is_rendered_alike(on_device, compiled):
    """Every instant of the sequence, with all memories at work."""
    for there, here in zip(on_device, compiled, strict=True):
        assert_alike(there, here)
    assert not np.array_equal(on_device[0].image, on_device[1].image)


def test_equal_inputs_give_equal_bits(on_device):
    """From run to run, and where there was not room enough for the pairs at first."""
    tight = DeviceGuided()
    tight._room.per_gaussian = 0.1
    for method in (DeviceGuided(), tight):
        for again, before in zip(rendered(method, room_instants()), on_device, strict=True):
            np.testing.assert_array_equal(again.image, before.image)
            np.testing.assert_array_equal(again.depth, before.depth)
    assert tight._room.per_gaussian > 1


@pytest.mark.parametrize(
    "changed",
    [
        {"temporal": False},
        {"splatted_depth": "filtered", "mask_channels": "mean", "compensated": False},
        {"settled": False, "remembered": True, "recurrent_limit": 0.0},
    ],
)
def test_options_mean_the_same(changed):
    """What the options switch off, or read otherwise, is switched off on the device too."""
    instants = room_instants()[:2]
    options = OnlineOptions(**changed)
    found = rendered(DeviceGuided(options), instants)
    for there, here in zip(found, rendered(GeometryGuided(options, NetworkBlender()), instants), strict=True):
        assert_alike(there, here)


def test_a_gap_and_a_moving_target_forget():
    """After an instant that was left out, from another pose and at another size, nothing of the picture before shows through."""
    first, second, third = room_instants()
    pose = third.target.world_to_camera.copy()
    pose[0, 3] += 0.2 * third.units_per_metre
    moved = replace(second, target=replace(second.target, world_to_camera=pose))
    smaller = replace(second, target=second.target.resized(75, 50))
    # Four depths that a last bit decides are a thousandth of the smaller picture, and the network looks at what surrounds them.
    for sequence in ((first, third), (first, moved), (first, smaller)):
        both = [rendered(method, sequence)[1] for method in (DeviceGuided(), GeometryGuided(blender=NetworkBlender()))]
        assert_alike(*both, share=0.99)


def test_medians_are_those_of_numpy():
    """Of what counts, even or odd in number, one or none."""
    random = np.random.default_rng(3)
    values = random.random((4, 9, 2), dtype=np.float32)
    mask = np.arange(9) < np.array([[8], [5], [1], [0]])
    found = masked_median(tensor(values), tensor(mask[..., None])).numpy()
    for row, chosen, median in zip(values, mask, found, strict=True):
        np.testing.assert_array_equal(median, np.median(row[chosen], axis=0) if chosen.any() else [0, 0])


@pytest.mark.parametrize("kernels", [blend_kernels, filter_kernels, march_kernels, splat_kernels])
def test_kernels_compile_for_a_gpu(kernels, tmp_path):
    """To code for a Hopper GPU that rounds as the CPU does: in float32, each product before it is added; nothing is atomic."""
    wp.compile_aot_module(kernels, arch=90, module_dir=tmp_path, use_ptx=True)
    (file,) = tmp_path.glob("*.ptx")
    instructions = [line.split()[0] for line in file.read_text("latin-1").splitlines() if line.startswith("\t") and line.strip()]
    assert "mul.rn.f32" in instructions
    wrong = re.compile(r"fma|.*\.approx|.*\.f64|atom|red\.")
    assert [each for each in instructions if wrong.match(each)] == []


class HostReads(TorchDispatchMode):
    """Notes every operation that a GPU could not begin before the host has read what it computed."""

    def __init__(self):
        super().__init__()
        self.names = []

    def __torch_dispatch__(self, function, types, arguments=(), keywords=None):
        name = function.overloadpacket.__name__
        masked = name in ("index", "index_put") and any(
            each is not None and each.dtype in (torch.bool, torch.uint8) for each in arguments[1]
        )
        if masked or name in ("_local_scalar_dense", "nonzero", "masked_select", "_unique2", "unique_dim"):
            self.names.append(name)
        return function(*arguments, **(keywords or {}))


def test_nothing_is_read_back_before_the_picture(monkeypatch):
    """Between upload and picture no value and no array goes to the host, and no array's shape depends on values."""
    method, reads = DeviceGuided(), HostReads()
    render = DeviceGuided._render

    def watched(*arguments):
        with monkeypatch.context() as patch, reads:
            for name in ("numpy", "cpu", "tolist", "item", "__bool__", "__int__", "__float__"):
                patch.setattr(torch.Tensor, name, lambda *_, name=name, **__: reads.names.append(name))
            return render(*arguments)

    monkeypatch.setattr(DeviceGuided, "_render", watched)
    rendered(method, room_instants()[:2])
    assert reads.names == []
    with reads:  # it would have been seen
        values = torch.arange(3)
        assert values[values > 1].item() == 2
    assert reads.names == ["index", "_local_scalar_dense"]


def test_too_many_views_and_readings_that_were_dropped_are_refused():
    """In one line, before anything is computed."""
    instant = room_instants()[0]
    many = replace(instant, sources=instant.sources * 2)
    with refused(RenderError, "6 source views", "got 8"):
        DeviceGuided().step(many)
    with refused(RenderError, "splatted_as='points'"):
        DeviceGuided(OnlineOptions(splatted_as="points"))


@pytest.fixture
def gpu_is_the_cpu(monkeypatch):
    """A GPU named cuda that is Warp's and torch's CPU device: what is chosen for it can be made and run."""
    for module in (step, network_blender):
        monkeypatch.setattr(module, "compute_device", lambda name: CPU)
    monkeypatch.setattr(compute_device, "compute_device", torch.device)  # what the command line asks


def test_a_gpu_is_given_the_whole_step(gpu_is_the_cpu, monkeypatch, on_device):
    """`--device cuda` chooses it by the method's label, for runs and live; without Warp the network alone computes there."""
    on_gpu = NetworkOptions(device="cuda")
    for label in ("ours", "ours+no-temporal", "ours+beta_temporal=0.6"):
        assert isinstance(find_method(label, on_gpu).make(), DeviceGuided)
    for label in ("ours+no-tsdf", "naive", "ours+splatted_as=points"):
        assert isinstance(find_method(label, on_gpu).make(), GeometryGuided)
    assert isinstance(find_method("ours").make(), GeometryGuided)
    instants = room_instants()
    cameras = [view.camera for view in instants[0].sources]
    synthesizer = OnlineSynthesizer(cameras, 4, instants[0].units_per_metre, "ours", "cuda")
    for instant, there in zip(instants, on_device, strict=True):
        images, depths = ({view.camera.name: getattr(view, what) for view in instant.sources} for what in ("image", "depth"))
        shown = synthesizer.step(images, depths, instant.target)
        np.testing.assert_array_equal(shown.image, there.image)
    monkeypatch.setattr(ours, "find_spec", lambda name: None)
    assert isinstance(find_method("ours", on_gpu).make(), GeometryGuided)
