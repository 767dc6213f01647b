"""Learned depth on a GPU, checked against the CPU and timed: ``python -m
benchmarks.bench_device_depth --weights FILE``.

With IterMVS' weights: the maps of four cameras of a rig of eight as one batch, by events of the GPU
(median and 95th percentile), whole and half precision, recorded and launched one by one, and the
way from the cameras' pictures to the screen by the host's clock: uploads, depth, the online step,
download. Every size is printed, and written, as soon as it is measured.

Without weights, as in ``make bench-device``: the compact RAFT-Stereo on a pair of the rig that
`bench_depth` paints. The network is timed by events of the GPU; what also waits for the host, by
its clock: the matcher (semi-global start, network, check, refinement), and a map of one camera from
four partners, whose rectification, fusion and finish the CPU computes.
"""

import argparse
import json
import traceback
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from benchmarks.bench_depth import PLACES, camera_at, look, make_texture
from ggvs_eval.arrays import Image8
from ggvs_eval.camera import Camera
from ggvs_eval.compute_device import clock_s, compute_device, describe_device, rendering_on
from ggvs_eval.geometry.rectification import rectify
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthEstimator, DepthOptions
from ggvs_eval.pipelines.offline.depth.device_maps import finisher
from ggvs_eval.pipelines.offline.itermvs.estimator import IterMvs, IterMvsRig
from ggvs_eval.pipelines.offline.stereo.pairwise import StereoMatcher
from ggvs_eval.pipelines.offline.stereo.raft_matcher import (
    DeviceRaftMatcher,
    RaftMatcher,
    load_network,
    shipped_weights,
    weights_digest,
)
from ggvs_eval.pipelines.offline.stereo.raft_stereo import SIZE_MULTIPLE
from ggvs_eval.pipelines.play.synthesizer import OnlineSynthesizer

TARGET_MS = 30.0  # a pair matched, at the larger size
SIZES = ((1345, 1008), (480, 360))
LEAST_SHARE = 0.999  # of pixels within 0.1 px of the CPU's, or rejected by both
CLOSE_PX = 0.1
WARM_UP, TIMED, ENOUGH_MS = 4, 20, 2000.0

# four maps; cameras to screen
RIG_TARGETS_MS = {(1024, 768): (60.0, 70.0), (640, 480): (30.0, 40.0)}
MORE_PLACES = ((2.2, 0.0), (0.0, -2.75), (1.1, 1.4))  # the rig of eight
K, PARTNERS, CHECKED_MAPS = 4, 4, 2
TARGET_PLACE = (0.4, 0.3)
CHECKED, LEAST_CLOSE = "against the CPU", 0.99  # share of pixels within 1e-3 of the CPU's depth
LAUNCHED, DEAREST = 4, 14  # runs without a recording; kernels listed
# what cuDNN then chooses may differ from run to run
SEARCHED = torch.backends.cudnn, "benchmark", True
Precision = Literal["float32", "float16"]
PRECISIONS: tuple[Precision, ...] = ("float32", "float16")


@dataclass(frozen=True)
class Rig:
    """Cameras, and what they see."""

    cameras: list[Camera]
    images: list[Image8]

    @classmethod
    def painted(
        cls, width: int, height: int, places: Sequence[tuple[float, float]] = PLACES
    ) -> "Rig":
        """Return a rig before the scene of `bench_depth`."""
        texture, cameras = (
            make_texture(),
            [camera_at(*place).resized(width, height) for place in places],
        )
        cameras = [replace(camera, name=f"cam{index}") for index, camera in enumerate(cameras)]
        return cls(cameras, [look(camera, texture) for camera in cameras])

    def matched(self) -> list[tuple[int, ...]]:
        """Return the first K cameras, each before the nearest of the others."""
        centres = np.stack([camera.centre for camera in self.cameras])
        apart = np.linalg.norm(centres[:, None] - centres, axis=-1)
        return [
            tuple(int(index) for index in np.argsort(apart[k], kind="stable")[: PARTNERS + 1])
            for k in range(K)
        ]


def measure_rig(
    device: str, weights: Path, shrink: int = 1, keep: Callable[[Any], None] = lambda _: None
) -> dict[str, Any]:
    """Check and time depth of four cameras by IterMVS, and cameras to screen.

    Size -> figures, each printed as it comes.

    Args:
        device: to compare with the CPU, see `compute_device`.
        weights: of its authors.
        shrink: divides every side.
        keep: called with all figures after each part.
    """
    figures: dict[str, Any] = {}
    options = {
        each: IterMvs(weights, "", PARTNERS, device=device, precision=each) for each in PRECISIONS
    }
    rigs = {
        size: Rig.painted(size[0] // shrink, size[1] // shrink, (*PLACES, *MORE_PLACES))
        for size in RIG_TARGETS_MS
    }

    def attempt(
        size: tuple[int, int], part: str, target: float | None, work: Callable[[], dict[str, Any]]
    ) -> None:
        """A part that fails leaves the others their turn: a GPU may be had for minutes only."""
        figure = figures.setdefault(f"{size[0] // shrink}x{size[1] // shrink}", {})
        try:
            figure[part] = work()
        except Exception:
            traceback.print_exc()
            figure[part] = {"error": traceback.format_exc(limit=-1)}
        reach = f"to reach {target:g} ms; " if target and shrink == 1 else ""
        words = [
            f"{name} {value:.4g}" if isinstance(value, float) else f"{name} {value}"
            for name, value in figure[part].items()
        ]
        print(
            f"{size[0] // shrink}x{size[1] // shrink} {part}: {reach}{', '.join(words)}", flush=True
        )
        keep(figures)

    for size, (maps_ms, screen_ms) in RIG_TARGETS_MS.items():
        for precision, each in options.items():
            attempt(size, f"{K} maps, {precision}", maps_ms, partial(_time_maps, each, rigs[size]))
        for precision, each in options.items():
            attempt(
                size,
                f"cameras to screen, {precision}",
                screen_ms,
                partial(_time_chain, each, rigs[size]),
            )
    for size, rig in rigs.items():
        reference = _one_by_one(replace(options["float32"], device="cpu"), rig)
        for precision, each in options.items():
            attempt(size, f"{CHECKED}, {precision}", None, partial(_compare, each, rig, reference))
    for size, rig in rigs.items():
        for precision, each in options.items():
            attempt(size, f"dearest kernels, {precision}", None, partial(_time_kernels, each, rig))
            attempt(
                size,
                f"algorithms searched by cuDNN, {precision}",
                None,
                partial(_time_otherwise, each, rig, SEARCHED),
            )
            attempt(
                size,
                f"torch's own lookups, {precision}",
                None,
                partial(_time_otherwise, each, rig, (functional, "grid_sample", _look_up)),
            )
    return figures


def rig_is_as_the_cpu(figures: Mapping[str, Any]) -> bool:
    """Check depth in full precision against the CPU's at every size."""
    return all(
        figure[f"{CHECKED}, float32"].get("within_1e-3", 0) >= LEAST_CLOSE
        for figure in figures.values()
    )


def _time_maps(options: IterMvs, rig: Rig) -> dict[str, float]:
    """Milliseconds of the batch, recorded, with finish and check, launched, by the host's clock.

    Seconds of the first call.
    """
    estimator, device = IterMvsRig(options), torch.device(options.device)
    whole = partial(estimator.estimate, rig.cameras, rig.matched(), rig.images)
    begun_s = clock_s(device)
    whole()
    first_s = clock_s(device) - begun_s
    (batch,) = estimator._batches.values()
    with rendering_on(device):
        figures = _percentiles(_times_of(batch.run, device))
        launched = _median(_times_of(batch._compute, device, LAUNCHED))
    checked = IterMvsRig(options, finisher(DepthOptions()))
    checked.estimate(rig.cameras, rig.matched(), rig.images)
    (batch,) = checked._batches.values()
    with rendering_on(device):
        figures["checked_p50_ms"] = _median(_times_of(batch.run, device))
    return {
        **figures,
        "launched_ms": launched,
        "call_ms": _median(_host_times(whole, device)),
        "first_s": first_s,
    }


def _time_otherwise(
    options: IterMvs, rig: Rig, change: tuple[object, str, object]
) -> dict[str, float]:
    """Milliseconds of the batch recorded while an attribute has another value: a way that is not
    taken, for comparison.
    """
    estimator, device, (owner, name, value) = (
        IterMvsRig(options),
        torch.device(options.device),
        change,
    )
    usual = getattr(owner, name)
    setattr(owner, name, value)
    try:
        estimator.estimate(rig.cameras, rig.matched(), rig.images)
        (batch,) = estimator._batches.values()
        with rendering_on(device):
            return _percentiles(_times_of(batch.run, device))
    finally:
        setattr(owner, name, usual)


def _look_up(features: Tensor, grid: Tensor, align_corners: bool) -> Tensor:
    """`grid_sample` that does not go by cuDNN."""
    return torch.grid_sampler_2d(features, grid, 0, 0, align_corners)


def _time_kernels(options: IterMvs, rig: Rig) -> dict[str, float]:
    """Milliseconds and launches of a batch, finish and check included, by kernel, the dearest
    first; nothing on the CPU.
    """
    estimator, device = IterMvsRig(options, finisher(DepthOptions())), torch.device(options.device)
    estimator.estimate(rig.cameras, rig.matched(), rig.images)
    (batch,) = estimator._batches.values()
    if device.type != "cuda":
        return {}
    with (
        rendering_on(device),
        torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CUDA]) as profile,
    ):
        batch.run()
        torch.cuda.synchronize(device)
    times: dict[str, float] = {}
    launches: Counter[str] = Counter()
    for event in profile.profiler.kineto_results.events():
        if event.device_type() == torch.autograd.DeviceType.CUDA:
            times[event.name()] = times.get(event.name(), 0.0) + event.duration_ns() / 1e6
            launches[event.name()] += 1
    dearest = sorted(times, key=lambda name: -times[name])[:DEAREST]
    total = {"all": sum(times.values()), "launches": float(sum(launches.values()))}
    return total | {f"\n    {launches[name]} x {name[:90]}:": times[name] for name in dearest}


def _time_chain(options: IterMvs, rig: Rig) -> dict[str, Any]:
    """Milliseconds from pictures in memory to a picture in memory: depth, its finish and check, and
    the online step.
    """
    live = OnlineSynthesizer(
        rig.cameras, K, 1.0, "ours", options.device, depth=DepthOptions(matcher=options)
    )
    target = replace(camera_at(*TARGET_PLACE).resized(*rig.cameras[0].size), name="target")
    images = {camera.name: image for camera, image in zip(rig.cameras, rig.images, strict=True)}
    seconds = [live.step(images, None, target).seconds["depth"] for _ in range(WARM_UP)]
    times = _host_times(lambda: live.show(images, None, target), torch.device(options.device))
    return {
        **_percentiles(times),
        "depth_ms": 1e3 * seconds[-1],
        "method": type(live._method).__name__,
    }


def _one_by_one(options: IterMvs, rig: Rig) -> list[Tensor]:
    """Return the depth of the first maps, each by a separate estimate."""
    chosen = rig.matched()[:CHECKED_MAPS]
    views = [
        ([rig.cameras[index] for index in each], [rig.images[index] for index in each])
        for each in chosen
    ]
    return [
        IterMvsRig(options).estimate(cameras, [range(len(cameras))], images)[0][0]
        for cameras, images in views
    ]


def _compare(options: IterMvs, rig: Rig, reference: Sequence[Tensor]) -> dict[str, float]:
    """Relative difference of depth from the reference's."""
    found = IterMvsRig(options).estimate(rig.cameras, rig.matched(), rig.images)
    pairs = zip(found, reference, strict=False)
    off = np.stack([np.abs(depth.cpu().numpy() / other.numpy() - 1) for (depth, _), other in pairs])
    return {
        "within_1e-3": float((off <= 1e-3).mean()),
        "within_1e-2": float((off <= 1e-2).mean()),
        "median": _median(off),
    }


def measure_depth(device: str, shrink: int = 1) -> dict[str, dict[str, float]]:
    """Check and time depth of a pair on a device, and print a table of each size; size -> figures.

    Args:
        device: to compare with the CPU, see `compute_device`.
        shrink: divides every side.
    """
    weights = shipped_weights()
    digest = weights_digest(weights)
    matcher, reference = (
        DeviceRaftMatcher(weights, digest, device=device),
        RaftMatcher(weights, digest),
    )
    figures = {}
    for width, height in SIZES:
        rig = Rig.painted(width // shrink, height // shrink)
        figure = {"within_0.1_px": _share_alike(matcher, reference, rig), **_times_ms(matcher, rig)}
        figures[f"{width // shrink}x{height // shrink}"] = figure
        _print(f"{width // shrink}x{height // shrink}", figure, with_target=shrink == 1)
    return figures


def is_as_the_cpu(figures: Mapping[str, Mapping[str, float]]) -> bool:
    """Check depth against the CPU's at every size."""
    return min(figure["within_0.1_px"] for figure in figures.values()) >= LEAST_SHARE


def _pair(rig: Rig) -> tuple[Image8, Image8, int, int]:
    """Return the camera and its first partner, rectified, and the range of their disparity."""
    pair = rectify(rig.cameras[0], rig.cameras[1])
    return pair.warp_left(rig.images[0]), pair.warp_right(rig.images[1]), pair.d_min, pair.d_max


def _share_alike(matcher: StereoMatcher, reference: StereoMatcher, rig: Rig) -> float:
    """Return the share of the pixels whose disparities are close to each other, or rejected by
    both.
    """
    there, here = (each.match(*_pair(rig))[0] for each in (matcher, reference))
    return float((((there > 0) == (here > 0)) & (np.abs(there - here) <= CLOSE_PX)).mean())


def _times_ms(matcher: DeviceRaftMatcher, rig: Rig) -> dict[str, float]:
    """Return the median milliseconds of each part, warm."""
    pair, cameras, images, device = (
        _pair(rig),
        rig.cameras,
        rig.images,
        torch.device(matcher.device),
    )
    estimator = DepthEstimator(cameras[0], cameras[1:], DepthOptions(matcher=matcher))
    return {
        "network_ms": _network_ms(matcher, pair[0].shape),
        "matcher_ms": _median(_host_times(partial(matcher.match, *pair), device)),
        "map_ms": _median(_host_times(partial(estimator.estimate, images[0], images[1:]), device)),
    }


def _network_ms(matcher: DeviceRaftMatcher, shape: tuple[int, ...]) -> float:
    """Return the median milliseconds of the network on a pair and its mirror image."""
    device = torch.device(matcher.device)
    scale = 2 if max(shape) > matcher.largest_side_px else 1
    sides = [-(-side // scale // SIZE_MULTIPLE) * SIZE_MULTIPLE for side in shape[:2]]
    network = load_network(matcher.weights, device)
    with rendering_on(device):
        images = torch.rand(2, 3, *sides, device=device) * 255
        start = torch.zeros(2, 1, *(side // network.config.factor for side in sides), device=device)
        return _median(
            _times_of(
                partial(network.flow, images, images.flip(3), matcher.iterations, start), device
            )
        )


def _times_of(work: Callable[[], object], device: torch.device, runs: int = TIMED) -> list[float]:
    """Return the milliseconds of warm runs: by events of a GPU, else by the host's clock."""
    if device.type != "cuda":
        return _host_times(work, device)
    times = []
    for _ in range(WARM_UP + runs):
        begun, ended = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        begun.record()
        work()
        ended.record()
        ended.synchronize()
        times.append(begun.elapsed_time(ended))
    return times[WARM_UP:]


def _host_times(work: Callable[[], object], device: torch.device) -> list[float]:
    """Return the milliseconds by the host's clock until the device is done, of fewer runs where
    they take long.
    """
    times: list[float] = []
    while not times or (len(times) < WARM_UP + TIMED and sum(times) < ENOUGH_MS):
        begun_s = clock_s(device)
        work()
        times.append(1e3 * (clock_s(device) - begun_s))
    return times[min(WARM_UP, len(times) - 1) :]


def _median(times: Any) -> float:
    return float(np.median(times))


def _percentiles(times: Sequence[float]) -> dict[str, float]:
    return {"p50_ms": _median(times), "p95_ms": float(np.quantile(times, 0.95))}


def _print(size: str, figure: Mapping[str, Any], with_target: bool) -> None:
    """The table of one size."""
    share = figure["within_0.1_px"]
    print(f"\n{size}, depth by the compact RAFT-Stereo")
    print(
        f"  {'as the CPU finds it' if share >= LEAST_SHARE else 'NOT AS THE CPU FINDS IT'}: "
        f"{share:.4%} within {CLOSE_PX} px"
    )
    target = f" (to reach {TARGET_MS:g})" if with_target else ""
    print(f"  {'network, both directions':26s} {figure['network_ms']:8.2f} ms")
    print(f"  {'a pair matched':26s} {figure['matcher_ms']:8.2f} ms{target}")
    print(
        f"  {'a map, four partners':26s} {figure['map_ms']:8.2f} ms; warps, fusion and finish on "
        f"the CPU included"
    )


def main() -> None:
    """Measure IterMVS and the way to the screen, or the compact network.

    Exit code 1 where depth is not the CPU's.
    """
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--device", default="cuda", help="cuda, cuda:N, or cpu, to try the command")
    parser.add_argument(
        "--weights",
        type=Path,
        help="checkpoint of IterMVS' authors; the compact RAFT-Stereo without it",
    )
    parser.add_argument("--shrink", type=int, default=1, help="divides every side")
    parser.add_argument("--json", type=Path, help="file to write, anew after each part")
    options = parser.parse_args()
    device = compute_device(options.device)
    machine = f"{describe_device(device)}, torch {torch.__version__}"
    print(machine, flush=True)

    def keep(figures: Any) -> None:
        if options.json is not None:
            options.json.write_text(json.dumps({"machine": machine, "figures": figures}, indent=1))

    if options.weights is None:
        figures = measure_depth(str(device), options.shrink)
        is_good = is_as_the_cpu(figures)
    else:
        figures = measure_rig(str(device), options.weights, options.shrink, keep)
        is_good = rig_is_as_the_cpu(figures)
    keep(figures)
    if not is_good:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
