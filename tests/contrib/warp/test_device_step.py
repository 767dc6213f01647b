"""The online step on a device, by Warp's CPU device: what the compiled path renders, stage by stage
and as a whole.
"""

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
from ggvs_eval.errors import GgvsWarning, RenderError
from ggvs_eval.files.images import quantise, round_levels
from ggvs_eval.geometry.difference_mask import difference_mask
from ggvs_eval.geometry.splat import splat
from ggvs_eval.geometry.tsdf import PreviousDepth, fusion_weights, ray_march
from ggvs_eval.method import Instant
from ggvs_eval.pipelines.methods.network_options import NetworkOptions
from ggvs_eval.pipelines.methods.registry import find_method
from ggvs_eval.pipelines.online import network_blender, online_methods
from ggvs_eval.pipelines.online.exposure_compensation import (
    ExposureCompensation,
    fallen_off,
    squared_tangents,
)
from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided, OnlineOptions
from ggvs_eval.pipelines.online.network_blender import NetworkBlender
from ggvs_eval.pipelines.online.temporal_filters import filter_depth
from ggvs_eval.pipelines.play.synthesizer import OnlineSynthesizer
from helpers.device_scenes import room_instants
from helpers.geometry_scenes import TAU, random_camera, random_depth, view_of
from helpers.refusals import refused
from helpers.scenes import texture

pytest.importorskip(
    "warp", reason="the online step on a device wants NVIDIA Warp: pip install 'ggvs-eval[gpu]'"
)

import warp as wp

from ggvs_eval.contrib.warp import exposure, march, picture, registration, step
from ggvs_eval.contrib.warp import filter as device_filter
from ggvs_eval.contrib.warp import splat as device_splat
from ggvs_eval.contrib.warp.constants import Remembered
from ggvs_eval.contrib.warp.step import DeviceGuided, Program
from ggvs_eval.contrib.warp.tables import Sizes, masked_median

CPU = torch.device("cpu")
LEVEL = 1 / 255
VIEWS = ((40, 30), (33, 26), (40, 30))  # sizes of sources beside each other
OPTIONS = OnlineOptions(tau_m=TAU, depth_noise_m=0.001)
ROOM = 20.0  # pairs of a Gaussian and a tile; Gaussians are large in pictures so small


def tensor(array: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(array))


def program_of(
    target: Camera, sources: list, before: Remembered | None = None, scale: int = 4, index: int = 0
) -> Program:
    """The place of a step of these views, their numbers filled in and their pictures uploaded."""
    program = Program(
        Sizes(tuple(source.camera.size for source in sources), target.size, scale), 64, CPU
    )
    instant = Instant(index, target, tuple(sources), 1.0)
    rows = list(range(1, 1 + program.sizes.pairs))
    program.constants.fill(instant, sources, OPTIONS, target.far, before, rows)
    program.upload(sources, 0)
    return program


@pytest.fixture(scope="module")
def rig() -> SimpleNamespace:
    """Three views of a rough surface from around a target, of two sizes, on the host and on the
    device, and their splats.
    """
    random = np.random.default_rng(4)
    target = random_camera(random, 45, 37, "target")
    cameras = [random_camera(random, *size, f"cam{number}") for number, size in enumerate(VIEWS)]
    sources = []
    for camera in cameras:
        depth = random_depth(random, camera)
        sources.append(
            view_of(
                camera,
                depth,
                quantise(texture(camera.centre + depth[..., None] * camera.rays(), 0.0)),
            )
        )
    program = program_of(target, sources)
    masks = torch.from_numpy(random.random(program.depths.shape, dtype=np.float32))
    host_masks = [
        masks[k, : camera.height, : camera.width].numpy() for k, camera in enumerate(cameras)
    ]
    here = [
        splat([source], target, near=0.2, extras=[mask])
        for source, mask in zip(sources, host_masks, strict=True)
    ]
    images, depths = program.states[0].images, program.depths
    there = device_splat.splat_views(images, depths, masks, program.constants, program.tables, ROOM)
    return SimpleNamespace(
        target=target,
        sources=sources,
        program=program,
        images=images,
        depths=depths,
        masks=masks,
        splats=here,
        there=there,
    )


@pytest.mark.parametrize(("width", "height"), [(40, 32), (37, 29), (5, 3)])
@pytest.mark.parametrize("channels", ["largest", "mean"])
def test_masks_are_those_of_the_compiled_path(width, height, channels):
    """Eq. 1 to a millionth, whether cells are whole pixels or not; Eq. 2 from equal masks and Eqs.
    11-12 bit for bit.
    """
    random = np.random.default_rng(width)
    now, before = random.integers(0, 256, (2, height, width, 3), np.uint8)
    camera = random_camera(random, width, height)
    depth, history = random_depth(random, camera), random_depth(random, camera, noise=0.05)
    program = program_of(camera, [view_of(camera, depth, now)], Remembered(-1, camera, (camera,)))
    options, c, t = (
        OnlineOptions(lambda_t=0.9, mask_channels=channels, history_tolerance=0.02),
        program.constants,
        program.tables,
    )
    out, past = torch.empty_like(program.depths), (tensor(before)[None], tensor(history)[None])
    there, _ = device_filter.filter_views(
        program.states[0].images, program.depths, past, c, t, options, out
    )
    mask = difference_mask(now, before, channels=channels, lambda_t=0.9)
    assert np.ptp(mask) > 0
    np.testing.assert_allclose(there[0].numpy(), mask, atol=1e-6)
    np.testing.assert_array_equal(
        out[0].numpy(), filter_depth(depth, history, there[0].numpy(), 0.02)
    )
    weights = device_filter.weigh_depths(program.depths, c, t)
    np.testing.assert_array_equal(weights[0].numpy(), fusion_weights(depth, TAU, 0.001))


def test_pairs_without_room_are_counted(rig, monkeypatch):
    """What is too much is lost, how crowded it is is told, and views that are sorted in groups have
    the same bits.
    """
    given = rig.images, rig.depths, rig.masks, rig.program.constants, rig.program.tables
    needed = float(rig.there.crowding)
    enough, tight = (device_splat.splat_views(*given, room) for room in (needed, needed / 3))
    assert float(enough.crowding) == float(tight.crowding) == needed
    assert torch.equal(enough.features, rig.there.features)
    assert not torch.equal(tight.features, rig.there.features)
    monkeypatch.setattr(device_splat, "SHORT_KEYS", 70)  # two views of 30 tiles
    grouped = device_splat.splat_views(*given, ROOM)
    assert torch.equal(grouped.features, rig.there.features)
    assert torch.equal(grouped.alphas, rig.there.alphas)
    assert float(grouped.crowding) >= needed


@pytest.mark.parametrize("skip_empty", [True, False])
def test_marches_have_the_bits_of_the_compiled_path(rig, skip_empty):
    """Depth and weight of every ray, with and without the depth of the instant before, whatever is
    skipped.
    """
    cameras, depths = (
        [source.camera for source in rig.sources],
        [source.depth for source in rig.sources],
    )
    weights = [fusion_weights(depth, TAU, 0.001) for depth in depths]
    stack = device_filter.weigh_depths(rig.depths, rig.program.constants, rig.program.tables)
    for k, weight in enumerate(weights):
        np.testing.assert_array_equal(
            stack[k, : weight.shape[0], : weight.shape[1]].numpy(), weight
        )
    here = ray_march(rig.target, cameras, depths, weights, tau=TAU)
    assert (here.depth > 0).mean() > 0.8
    gain = np.random.default_rng(1).random(here.depth.shape, dtype=np.float32)
    moved = replace(rig.target, world_to_camera=cameras[0].world_to_camera)
    later = ray_march(
        rig.target,
        cameras,
        depths,
        weights,
        tau=TAU,
        previous=PreviousDepth(moved, here.depth, here.weight, gain, 0.7),
    )
    assert not np.array_equal(here.depth, later.depth)
    second = program_of(rig.target, rig.sources, Remembered(0, moved, tuple(cameras)), index=1)
    nothing, out = (
        torch.full(here.depth.shape, -1.0),
        (torch.empty(here.depth.shape), torch.empty(here.depth.shape)),
    )
    for program, past, gains, found in (
        (rig.program, (nothing, nothing), nothing, here),
        (second, (tensor(here.depth), tensor(here.weight)), tensor(gain), later),
    ):
        march.march(
            rig.depths,
            stack,
            past,
            gains,
            program.constants,
            program.tables,
            (0.1, 0.7),
            out,
            skip_empty,
        )
        np.testing.assert_array_equal(out[0].numpy(), found.depth)
        np.testing.assert_array_equal(out[1].numpy(), found.weight)


def darkened(image: Image8, camera: Camera, gain: float) -> Image8:
    """What a camera with a gain and a lens that darkens its corners sees."""
    down, across = squared_tangents(camera)
    return round_levels(image * (gain * np.exp(-0.9 * (down[:, None] + across)))[..., None])


def test_gains_and_fall_off():
    """Both are those of the compiled path, at first and from memory, and there is a fall-off to be
    found.
    """
    compensation, before = ExposureCompensation(), None
    state = None
    for instant in room_instants():
        dark = [
            darkened(view.image, view.camera, 1.06 - 0.03 * k)
            for k, view in enumerate(instant.sources)
        ]
        instant = replace(
            instant,
            sources=tuple(replace(v, image=d) for v, d in zip(instant.sources, dark, strict=True)),
        )
        tau = 0.05 * instant.units_per_metre
        program = program_of(instant.target, list(instant.sources), before, index=instant.index)
        options = OnlineOptions(tau_m=0.05)
        program.constants.fill(
            instant, instant.sources, options, instant.target.far, before, range(1, 7)
        )
        seen, out = compensation.step(instant, tau), program.states[0].exposure
        given = program.constants, program.tables
        state = state or program.states[1].exposure
        found = exposure.estimate_exposure(
            program.states[0].images, program.depths, state, *given, out
        )
        state, before = (
            out,
            Remembered(
                instant.index, instant.target, tuple(view.camera for view in instant.sources)
            ),
        )
        assert float(out.lens[1]) == pytest.approx(compensation.slope, abs=1e-4)
        images = exposure.compensate(program.states[0].images, found).numpy()
        off = np.abs(images.astype(int) - np.stack([view.image for view in seen.sources]))
        assert off.max() <= 1
        assert (off > 0).mean() < 1e-3
    assert compensation.slope < -0.1
    assert np.ptp(found.gains.numpy()) > 0.02
    assert not found.odd.any()
    image = np.random.default_rng(0).random(
        (instant.target.height, instant.target.width, 3), dtype=np.float32
    )
    shown = exposure.show_fall_off(tensor(np.moveaxis(image, 2, 0)), found).permute(1, 2, 0)
    corner = float(program.constants.lens[0])
    np.testing.assert_allclose(
        shown.numpy(), fallen_off(image, instant.target, compensation.slope, corner), atol=1e-3
    )


def rendered(method, instants):
    return [method.step(instant) for instant in instants]


def compiled_path(options=None):
    return GeometryGuided(options, NetworkBlender())


@pytest.fixture(scope="module")
def compiled():
    return rendered(compiled_path(), room_instants())


@pytest.fixture(scope="module")
def on_device():
    return rendered(DeviceGuided(), room_instants())


def assert_alike(there, here, share=0.999):
    """At least 99.9 % of the pixels within a level, of the depths within 1e-4 of the depth; the
    same diagnostics.

    Ten times as many may differ of the diagnostics: their cells are coarse, and the network's
    weights feel a depth far around it.
    """
    assert there.image.dtype == here.image.dtype == np.float32
    assert (np.abs(there.image - here.image).max(axis=-1) <= LEVEL).mean() >= share
    assert (np.abs(there.depth - here.depth) <= 1e-4 * here.depth).mean() >= share
    assert list(there.seconds) == ["upload", "step", "download"]
    assert there.diagnostics.keys() == here.diagnostics.keys()
    for name, values in there.diagnostics.items():
        if values.shape == here.diagnostics[name].shape:
            assert (
                np.abs(values - here.diagnostics[name]) <= 1e-3 * (1 + np.abs(values))
            ).mean() >= 1 - 10 * (1 - share), name


def test_the_demo_room_is_rendered_alike(on_device, compiled):
    """Every instant of the sequence, with all memories at work."""
    for there, here in zip(on_device, compiled, strict=True):
        assert_alike(there, here)
    assert not np.array_equal(on_device[0].image, on_device[1].image)


def test_half_precision_is_within_a_tenth_of_a_level(on_device):
    """What a GPU computes by default, in the network alone; depth is not touched."""
    for half, single in zip(
        rendered(DeviceGuided(precision="half"), room_instants()), on_device, strict=True
    ):
        assert 0 < 255 * np.abs(half.image - single.image).max() < 0.1
        np.testing.assert_array_equal(half.depth, single.depth)


def test_equal_inputs_give_equal_bits(on_device):
    """From run to run, where there was not room enough for the pairs at first, and of the picture
    alone, in 8 bit.
    """
    tight = DeviceGuided()
    tight._per_gaussian = 0.1
    for method in (DeviceGuided(), tight):
        for again, before in zip(rendered(method, room_instants()), on_device, strict=True):
            np.testing.assert_array_equal(again.image, before.image)
            np.testing.assert_array_equal(again.depth, before.depth)
    assert tight._per_gaussian > 1
    method = DeviceGuided()
    for instant, before in zip(room_instants(), on_device, strict=True):
        np.testing.assert_array_equal(method.show(instant), quantise(before.image))


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
    for there, here in zip(
        rendered(DeviceGuided(options), instants),
        rendered(compiled_path(options), instants),
        strict=True,
    ):
        assert_alike(there, here)


def walks() -> dict[str, list[Instant]]:
    """Sequences in which something changes between the instants."""
    first, second, third = room_instants()
    pose = third.target.world_to_camera.copy()
    pose[0, 3] += 0.2 * third.units_per_metre
    moved = replace(second.target, world_to_camera=pose)
    swapped = (second.sources[3], *second.sources[:2])

    def numbered(*instants: Instant) -> list[Instant]:
        return [replace(instant, index=index) for index, instant in enumerate(instants)]

    return {
        "a gap": [first, third, replace(third, index=3)],
        "a target that moves": numbered(first, replace(second, target=moved), third),
        "another size": numbered(
            first, replace(second, target=second.target.resized(75, 50)), third
        ),
        "a lost source": numbered(first, replace(second, sources=second.sources[:3]), third),
        "another source": numbered(
            replace(first, sources=first.sources[:3]),
            replace(second, sources=swapped),
            replace(third, sources=third.sources[1:]),
        ),
        "a source of another size": numbered(
            first, replace(second, sources=(small_view(second.sources[0]), *second.sources[1:]))
        ),
    }


def small_view(view):
    """What a camera of the same name and half the pixels sees."""
    camera = view.camera.resized(56, 42)
    return replace(
        view,
        camera=camera,
        image=view.image[::2, ::2],
        depth=view.depth[::2, ::2],
        confidence=view.confidence[::2, ::2],
    )


@pytest.mark.parametrize("name", list(walks()))
def test_a_walk_is_that_of_the_compiled_path(name):
    """After a gap nothing shows through, a target or a source that is new has no past, and all
    others keep theirs.
    """
    # Four depths that a last bit decides are a thousandth of the smaller picture, and the network
    # looks at what surrounds them.
    instants = walks()[name]
    for there, here in zip(
        rendered(DeviceGuided(), instants), rendered(compiled_path(), instants), strict=True
    ):
        assert_alike(there, here, share=0.99)


def test_two_synthesizers_do_not_mix(on_device):
    """Side by side, one a step ahead of the other, each shows what it shows alone."""
    ahead, behind, instants = DeviceGuided(), DeviceGuided(), room_instants()
    ahead.step(instants[0])
    for index, instant in enumerate(instants):
        if index + 1 < len(instants):
            np.testing.assert_array_equal(
                ahead.step(instants[index + 1]).image, on_device[index + 1].image
            )
        np.testing.assert_array_equal(behind.step(instant).image, on_device[index].image)


def test_a_source_that_is_black_is_left_out():
    """For an instant, by the rule of the compiled path; it stays within a level of what that shows
    in nine of ten pixels.
    """
    first, second, _ = room_instants()
    black = replace(second.sources[1], image=np.zeros_like(second.sources[1].image))
    instants = [first, replace(second, sources=(second.sources[0], black, *second.sources[2:]))]
    there, here = (rendered(method, instants)[1] for method in (DeviceGuided(), compiled_path()))
    naive = rendered(DeviceGuided(OnlineOptions(compensated=False)), instants)[1]
    assert np.abs(naive.image - here.image).mean() > 10 * np.abs(there.image - here.image).mean()
    assert (np.abs(there.image - here.image).max(axis=-1) <= LEVEL).mean() > 0.9


def test_a_past_that_is_no_number_is_forgotten(on_device):
    """Planted in what was shown, it is gone after one step."""
    method, instants = DeviceGuided(), room_instants()
    method.step(instants[0])
    program, number, _ = method._latest
    with torch.inference_mode():
        program.states[number].output.picture[:, 10:20, 10:20] = torch.nan
    assert np.isfinite(method.step(instants[1]).image).all()


def test_depth_beyond_the_march_is_told():
    """Once, where a sequence begins."""
    instant = room_instants()[0]
    far = replace(instant, target=replace(instant.target, far=1e6), units_per_metre=6e-3)
    with pytest.warns(GgvsWarning, match="is unreachable by steps"):
        DeviceGuided().step(far)


def test_medians_are_those_of_numpy():
    """Of what counts, even or odd in number, one or none."""
    random = np.random.default_rng(3)
    values = random.random((3, 9), dtype=np.float32)
    for count in (27, 8, 5, 1, 0):
        mask = np.arange(27).reshape(3, 9) < count
        found = float(masked_median(tensor(values), tensor(mask)))
        assert found == (np.median(values[mask]) if count else 0)


@pytest.mark.parametrize("kernels", [device_filter, march, picture, registration, device_splat])
def test_kernels_compile_for_a_gpu(kernels, tmp_path):
    """To code for a Hopper GPU that rounds as the CPU does: each product before it is added;
    nothing is atomic.
    """
    wp.compile_aot_module(kernels, arch=90, module_dir=tmp_path, use_ptx=True)
    (file,) = tmp_path.glob("*.ptx")
    instructions = [
        line.split()[0]
        for line in file.read_text("latin-1").splitlines()
        if line.startswith("\t") and line.strip()
    ]
    assert "mul.rn.f32" in instructions
    # that one has exponentials
    wrong = re.compile(
        "atom|red\\." if kernels is picture else r"fma|.*\.approx|.*\.f64|atom|red\."
    )
    assert [each for each in instructions if wrong.match(each)] == []


class HostReads(TorchDispatchMode):
    """Notes every operation that a GPU could not begin before the host has read what it
    computed.
    """

    def __init__(self):
        super().__init__()
        self.names = []

    def __torch_dispatch__(self, function, types, arguments=(), keywords=None):
        name = function.overloadpacket.__name__
        masked = name in ("index", "index_put") and any(
            each is not None and each.dtype in (torch.bool, torch.uint8) for each in arguments[1]
        )
        if masked or name in (
            "_local_scalar_dense",
            "nonzero",
            "masked_select",
            "_unique2",
            "unique_dim",
        ):
            self.names.append(name)
        return function(*arguments, **(keywords or {}))


def test_nothing_is_read_back_before_the_picture(monkeypatch):
    """Between upload and picture no value and no array goes to the host, nor comes from it, once
    the tables are made.
    """
    method, reads = DeviceGuided(), HostReads()
    compute = DeviceGuided._compute

    def watched(*arguments):
        _, program, before, after, _ = arguments
        warm = program.warm and before is program.states[1 - after]  # what a GPU records
        with monkeypatch.context() as patch, reads:
            for name in ("numpy", "cpu", "tolist", "item", "__bool__", "__int__", "__float__"):
                patch.setattr(
                    torch.Tensor, name, lambda *_, name=name, **__: reads.names.append(name)
                )
            if warm:
                patch.setattr(torch, "from_numpy", lambda _: reads.names.append("from_numpy"))
                patch.setattr(torch, "tensor", lambda *_, **__: reads.names.append("tensor"))
            return compute(*arguments)

    monkeypatch.setattr(DeviceGuided, "_compute", watched)
    for instant in [*room_instants(), *walks()["another size"], *walks()["a lost source"]]:
        method.step(instant)
    for index, instant in enumerate(room_instants(), 3):
        method.step(replace(instant, index=index, target=instant.target.resized(75, 50)))
    assert reads.names == []
    with reads:  # it would have been seen
        values = torch.arange(3)
        assert values[values > 1].item() == 2
    assert reads.names == ["index", "_local_scalar_dense"]


def test_warp_allocates_nothing_in_a_warm_step(monkeypatch):
    """What it allocates within a recording would be freed there; torch's tensors lie in the
    recording's own memory.
    """
    from warp._src import context

    method, found = DeviceGuided(), []
    rendered(method, room_instants()[:2])
    allocate = context.CpuDefaultAllocator.allocate
    monkeypatch.setattr(
        context.CpuDefaultAllocator,
        "allocate",
        lambda *given, **named: found.append(1) or allocate(*given, **named),
    )
    method.step(room_instants()[2])
    assert found == []


def test_too_many_views_and_readings_that_were_dropped_are_refused():
    """In one line, before anything is computed."""
    instant = room_instants()[0]
    for count in (7, 8):
        with refused(RenderError, "6 source views", f"got {count}"):
            DeviceGuided().step(replace(instant, sources=(instant.sources * 2)[:count]))
    with refused(RenderError, "splatted_as='points'"):
        DeviceGuided(OnlineOptions(splatted_as="points"))


@pytest.fixture
def gpu_is_the_cpu(monkeypatch):
    """A GPU named cuda that is Warp's and torch's CPU device: what is chosen for it can be made and
    run.
    """
    for module in (step, network_blender):
        monkeypatch.setattr(module, "compute_device", lambda name: CPU)
    # what the command line asks
    monkeypatch.setattr(compute_device, "compute_device", torch.device)


def test_a_gpu_is_given_the_whole_step(gpu_is_the_cpu, monkeypatch, on_device):
    """`--device cuda` chooses it by the method's label, for runs and live; without Warp the network
    alone computes there.
    """
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
        images, depths = (
            {view.camera.name: getattr(view, what) for view in instant.sources}
            for what in ("image", "depth")
        )
        shown = synthesizer.step(images, depths, instant.target)
        np.testing.assert_array_equal(shown.image, there.image)
    synthesizer.restart()
    for instant, there in zip(instants, on_device, strict=True):
        images, depths = (
            {view.camera.name: getattr(view, what) for view in instant.sources}
            for what in ("image", "depth")
        )
        np.testing.assert_array_equal(
            synthesizer.show(images, depths, instant.target), quantise(there.image)
        )
    monkeypatch.setattr(online_methods, "DEVICE_PARTS", {})  # Warp or contrib/warp was taken away
    assert isinstance(find_method("ours", on_gpu).make(), GeometryGuided)
