"""Learned depth on a GPU, the compact RAFT-Stereo, checked against the CPU and timed: a part of ``make bench-device``.

The pair is one of the rig that `bench_depth` paints. The network is timed by events of the GPU; what also waits for the host, by
its clock: the matcher (semi-global start, network, check, refinement), and a map of one camera from four partners, whose
rectification, fusion and finish the CPU computes whatever the device.
"""

from collections.abc import Callable, Mapping
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np
import torch

from benchmarks.bench_depth import PLACES, camera_at, look, make_texture
from ggvs_eval.arrays import Image8
from ggvs_eval.camera import Camera
from ggvs_eval.compute_device import rendering_on
from ggvs_eval.geometry.rectification import rectify
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthEstimator, DepthOptions
from ggvs_eval.pipelines.offline.stereo.matcher import StereoMatcher
from ggvs_eval.pipelines.offline.stereo.raft_matcher import (
    DeviceRaftMatcher,
    RaftMatcher,
    load_network,
    shipped_weights,
    weights_digest,
)
from ggvs_eval.pipelines.offline.stereo.raft_stereo import SIZE_MULTIPLE

TARGET_MS = 30.0  # a pair matched, at the larger size
SIZES = ((1345, 1008), (480, 360))
LEAST_SHARE = 0.999  # of pixels within 0.1 px of the CPU's, or rejected by both
CLOSE_PX = 0.1
WARM_UP, TIMED, ENOUGH_MS = 4, 20, 3000.0

Rig = tuple[list[Camera], list[Image8]]


def measure_depth(device: str, shrink: int = 1) -> dict[str, dict[str, float]]:
    """Check and time depth on a device, and print a table of each size; size -> figures.

    Args:
        device: to compare with the CPU, see `compute_device`.
        shrink: divides every side.
    """
    weights = shipped_weights()
    digest = weights_digest(weights)
    matcher, reference = DeviceRaftMatcher(weights, digest, device=device), RaftMatcher(weights, digest)
    figures = {}
    for width, height in SIZES:
        rig = _rig(width // shrink, height // shrink)
        figure = {"within_0.1_px": _share_alike(matcher, reference, rig), **_times_ms(matcher, rig)}
        figures[f"{width // shrink}x{height // shrink}"] = figure
        _print(f"{width // shrink}x{height // shrink}", figure, with_target=shrink == 1)
    return figures


def is_as_the_cpu(figures: Mapping[str, Mapping[str, float]]) -> bool:
    """Whether depth is the CPU's at every size."""
    return min(figure["within_0.1_px"] for figure in figures.values()) >= LEAST_SHARE


def _rig(width: int, height: int) -> Rig:
    """A camera and its four partners, and what they see."""
    texture, cameras = make_texture(), [camera_at(*place).resized(width, height) for place in PLACES]
    return cameras, [look(camera, texture) for camera in cameras]


def _pair(rig: Rig) -> tuple[Image8, Image8, int, int]:
    """The camera and its first partner, rectified, and the range of their disparity."""
    cameras, images = rig
    pair = rectify(cameras[0], cameras[1])
    return pair.warp_left(images[0]), pair.warp_right(images[1]), pair.d_min, pair.d_max


def _share_alike(matcher: StereoMatcher, reference: StereoMatcher, rig: Rig) -> float:
    """Share of the pixels whose disparities are close to each other, or rejected by both."""
    there, here = (each.match(*_pair(rig))[0] for each in (matcher, reference))
    return float((((there > 0) == (here > 0)) & (np.abs(there - here) <= CLOSE_PX)).mean())


def _times_ms(matcher: DeviceRaftMatcher, rig: Rig) -> dict[str, float]:
    """Median milliseconds of each part, warm."""
    pair, (cameras, images) = _pair(rig), rig
    estimator = DepthEstimator(cameras[0], cameras[1:], DepthOptions(matcher=matcher))
    return {
        "network_ms": _network_ms(matcher, pair[0].shape),
        "matcher_ms": _median_ms(partial(matcher.match, *pair)),
        "map_ms": _median_ms(partial(estimator.estimate, images[0], images[1:])),
    }


def _network_ms(matcher: DeviceRaftMatcher, shape: tuple[int, ...]) -> float:
    """Median milliseconds of the network on a pair and its mirror image, by events where there is a GPU."""
    device = torch.device(matcher.device)
    scale = 2 if max(shape) > matcher.largest_side_px else 1
    sides = [-(-side // scale // SIZE_MULTIPLE) * SIZE_MULTIPLE for side in shape[:2]]
    network = load_network(matcher.weights, device)
    with rendering_on(device):
        images = torch.rand(2, 3, *sides, device=device) * 255
        start = torch.zeros(2, 1, *(side // network.config.factor for side in sides), device=device)
        work = partial(network.flow, images, images.flip(3), matcher.iterations, start)
        return _median_event_ms(work) if device.type == "cuda" else _median_ms(work)


def _median_ms(work: Callable[[], object]) -> float:
    """By the host's clock, of fewer runs where they take long; the work itself waits until it is done."""
    times: list[float] = []
    while not times or (len(times) < WARM_UP + TIMED and sum(times) < ENOUGH_MS):
        begun_s = perf_counter()
        work()
        times.append(1e3 * (perf_counter() - begun_s))
    return float(np.median(times[min(WARM_UP, len(times) - 1) :]))


def _median_event_ms(work: Callable[[], object]) -> float:
    """By events of the GPU."""
    times = []
    for _ in range(WARM_UP + TIMED):
        begun, ended = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        begun.record()
        work()
        ended.record()
        ended.synchronize()
        times.append(begun.elapsed_time(ended))
    return float(np.median(times[WARM_UP:]))


def _print(size: str, figure: Mapping[str, Any], with_target: bool) -> None:
    """The table of one size."""
    share = figure["within_0.1_px"]
    print(f"\n{size}, depth by the compact RAFT-Stereo")
    print(f"  {'as the CPU finds it' if share >= LEAST_SHARE else 'NOT AS THE CPU FINDS IT'}: {share:.4%} within {CLOSE_PX} px")
    target = f" (to reach {TARGET_MS:g})" if with_target else ""
    print(f"  {'network, both directions':26s} {figure['network_ms']:8.2f} ms")
    print(f"  {'a pair matched':26s} {figure['matcher_ms']:8.2f} ms{target}")
    print(f"  {'a map, four partners':26s} {figure['map_ms']:8.2f} ms; warps, fusion and finish on the CPU included")
