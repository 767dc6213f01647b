"""The whole online step, stage by stage, decoding excluded: ``python -m benchmarks.bench_online``.

At 1352 x 1014 with K = 4, and at 640 x 360 with K = 2, where it should keep up with a slow camera.
The learned blender is measured alone at the full size, in CPU time, next to the torch code that
training uses for the same picture.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from time import process_time
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from benchmarks.bench_geometry import HEIGHT, WIDTH, Scene, make_scene
from ggvs_eval.arrays import Image8
from ggvs_eval.camera import Camera
from ggvs_eval.compute_device import one_thread
from ggvs_eval.contrib.training.samples.sample_kinds import raw_views
from ggvs_eval.files.images import quantise
from ggvs_eval.kernels import get_threads
from ggvs_eval.method import Instant, SourceView
from ggvs_eval.pipelines.online.blend_network import (
    WIDTHS,
    BlendNetwork,
    BlendNetworkShape,
    compose_tensors,
    read_outputs,
)
from ggvs_eval.pipelines.online.blending import Blended, BlendingInputs, GeometricBlender
from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided
from ggvs_eval.pipelines.online.network_blender import NetworkBlender, blend_by, blend_start
from ggvs_eval.pipelines.online.network_inputs import blend_maps, input_channels

COMMAND = "python -m benchmarks.bench_online"
NOISE_LEVELS = 3  # of 255, drawn anew for every other frame: masks are then not all alike


@dataclass(frozen=True)
class Setting:
    """One size to measure at.

    Attributes:
        name: first part of the figures' names.
        width: pixels of images and target.
        height: pixels of images and target; the field of view of the full width is cut to it.
        views: K.
        steps: measured, after warm-up.
        target_ms: wanted median of the whole step; None if frames per second are wanted.
        target_hz: wanted frames per second, from the median.
        learned: blend by the network that ships, or by geometric weights.
    """

    name: str
    width: int
    height: int
    views: int
    steps: int
    target_ms: float | None = None
    target_hz: float | None = None
    learned: bool = True


WARM_UP = 2
SETTINGS = (
    Setting("online_step", WIDTH, HEIGHT, 4, 12, target_ms=420.0),
    Setting("online_geometric_step", WIDTH, HEIGHT, 4, 12, learned=False),
    Setting("online_small_step", 640, 360, 2, 40, target_hz=16.0),
)


def measure() -> dict[str, dict[str, Any]]:
    """Return the median and 95th percentile of the step and of its stages after warm-up, in every
    setting, name -> figure.
    """
    figures = {
        name: figure for setting in SETTINGS for name, figure in measure_setting(setting).items()
    }
    return figures | measure_network_blender(SETTINGS[0])


def measure_setting(setting: Setting) -> dict[str, dict[str, Any]]:
    """Return the figures of one setting.

    Geometry is static, which costs the same, and colours are noisy.
    """
    scene, method = (
        _scene(setting),
        GeometryGuided(blender=NetworkBlender() if setting.learned else GeometricBlender()),
    )
    images = _images(scene)
    instants = [
        _instant(scene, images[index % 2], index, setting.views)
        for index in range(WARM_UP + setting.steps)
    ]
    seconds = [method.step(instant).seconds for instant in instants][WARM_UP:]
    totals = [sum(frame.values()) for frame in seconds]
    figures = _quantiles(setting.name, totals, setting.target_ms)
    for stage in seconds[0]:
        figures |= _quantiles(f"{setting.name}_{stage}", [frame[stage] for frame in seconds], None)
    rate = _figure(1.0 / float(np.median(totals)), "Hz", setting.target_hz, higher_is_better=True)
    return figures | {f"{setting.name}_rate": rate}


@dataclass
class _Recorder:
    """The geometric blender, which keeps what it was given."""

    inputs: list[BlendingInputs] = field(default_factory=list)

    def blend(self, inputs: BlendingInputs) -> Blended:
        """Keep the inputs, and return the geometric blender's result."""
        self.inputs.append(inputs)
        return GeometricBlender().blend(inputs)


def measure_network_blender(setting: Setting, repeats: int = 5) -> dict[str, dict[str, Any]]:
    """CPU time of the learned blender at a setting in its sizes, and of the torch code in place of
    the one that ships.
    """
    scene, recorder = _scene(setting), _Recorder()
    GeometryGuided(blender=recorder).step(_instant(scene, _images(scene)[0], 0, setting.views))
    networks = {size: _random_network(width) for size, width in WIDTHS.items()}
    inputs, shipped = recorder.inputs[0], networks["standard"]
    guidance = shipped.config.guidance
    times_ms = {
        size: _cpu_ms(lambda network=each: blend_by(network, blend_maps(inputs, guidance)), repeats)
        for size, each in networks.items()
    }
    torch_ms = _cpu_ms(lambda: torch_blend(shipped, inputs), repeats)
    name = f"{setting.name}_network_blend"
    return {
        name: _figure(times_ms["standard"], "CPU ms", 400.0),
        f"{name}_torch": _figure(torch_ms, "CPU ms", None),
        f"{name}_speedup": _figure(
            torch_ms / times_ms["standard"], "x", None, higher_is_better=True
        ),
        **{
            f"{name}_{size}": _figure(times_ms[size], "CPU ms", None) for size in ("small", "large")
        },
    }


def _random_network(width: int) -> BlendNetwork:
    torch.manual_seed(0)
    network: BlendNetwork = (
        BlendNetwork(BlendNetworkShape(width=width)).eval().to(memory_format=torch.channels_last)
    )  # type: ignore[call-overload]
    return network


def torch_blend(network: BlendNetwork, inputs: BlendingInputs) -> NDArray[np.float32]:
    """Return the learned blender's image as training makes it, (H, W, 3)."""
    config, maps = network.config, raw_views(inputs).maps(network.config.guidance)
    arrays = {
        "colours": np.moveaxis(maps.colours, 3, 1),
        "coverage": maps.coverage,
        "fused_depth": maps.fused_depth,
    }
    views = {name: torch.from_numpy(array)[None] for name, array in arrays.items()}
    start = {name: torch.from_numpy(array)[None] for name, array in blend_start(maps).items()}
    channels = torch.from_numpy(
        input_channels(maps.reduced(config.scale), config.guidance, config.views)
    )[None]
    with one_thread(), torch.inference_mode():
        raw = network(channels.to(memory_format=torch.channels_last))
        outputs = read_outputs(raw, start, config.views)
        image = network.refine(
            compose_tensors(outputs, views["colours"], views["coverage"]), outputs, views
        )
    return image[0].clamp(0, 1).permute(1, 2, 0).numpy()


def _cpu_ms(work: Callable[[], object], repeats: int) -> float:
    """Return the median processor time of all threads: what a loaded machine does to the clock on
    the wall does not count.
    """
    times_ms = []
    for _ in range(repeats + 1):
        begin = process_time()
        work()
        times_ms.append(1e3 * (process_time() - begin))
    return float(np.median(times_ms[1:]))


def _quantiles(
    name: str, seconds: list[float], target_ms: float | None
) -> dict[str, dict[str, Any]]:
    median_ms, late_ms = (float(value) for value in np.quantile(seconds, (0.5, 0.95)) * 1e3)
    return {name: _figure(median_ms, "ms", target_ms), f"{name}_p95": _figure(late_ms, "ms", None)}


def _scene(setting: Setting) -> Scene:
    """Return the scene of `bench_geometry` at the setting's width, the middle rows of it."""
    scene = make_scene(setting.width)
    height = scene.image.shape[0]
    top = (height - setting.height) // 2
    rows = slice(top, top + setting.height)

    def cut(camera: Camera) -> Camera:
        return camera.cropped(0, top, setting.width, setting.height)

    depths = [np.ascontiguousarray(depth[rows]) for depth in scene.depths]
    return Scene(
        cut(scene.target),
        [cut(camera) for camera in scene.cameras],
        depths,
        np.ascontiguousarray(scene.image[rows]),
    )


def _images(scene: Scene) -> list[Image8]:
    """Return two noisy copies of the scene's image, which frames take in turn."""
    random, image = np.random.default_rng(0), quantise(scene.image)
    noises: list[NDArray[np.int64]] = [
        random.integers(-NOISE_LEVELS, NOISE_LEVELS + 1, image.shape) for _ in range(2)
    ]
    return [np.clip(image + noise, 0, 255).astype(np.uint8) for noise in noises]


def _instant(scene: Scene, image: Image8, index: int, views: int) -> Instant:
    """Return an instant of the `views` cameras nearest to the target."""
    order = np.argsort(
        [float(np.linalg.norm(camera.centre - scene.target.centre)) for camera in scene.cameras]
    )[:views]
    sources = tuple(
        SourceView(scene.cameras[k], image, scene.depths[k], np.ones_like(scene.depths[k]))
        for k in (int(each) for each in order)
    )
    return Instant(index, scene.target, sources, units_per_metre=1.0)


def _figure(
    value: float, unit: str, target: float | None, higher_is_better: bool = False
) -> dict[str, Any]:
    command = f"{COMMAND} ({get_threads()} threads)"
    return {
        "value": value,
        "unit": unit,
        "target": target,
        "higher_is_better": higher_is_better,
        "command": command,
    }


if __name__ == "__main__":
    for name, figure in measure().items():
        target = f"  (target {figure['target']:g})" if figure["target"] is not None else ""
        print(f"{name}: {figure['value']:.1f} {figure['unit']}{target}")
