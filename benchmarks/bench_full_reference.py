"""Cost of the further full-reference metrics on frames of the paper's size.

IV-PSNR against the same definition in numpy.

``python -m benchmarks.bench_full_reference``. The fastest call counts; a metric of whole videos is
measured on `VIDEO_FRAMES`. Next to the wall time is that of the cores, which other programs on the
machine disturb less. What is not installed is left out and named.
"""

import resource
import sys
import time
from collections.abc import Callable, Sequence
from itertools import repeat
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from skimage import data

from ggvs_eval.contrib.more_metrics.colour_video_vdp import colour_video_vdp
from ggvs_eval.contrib.more_metrics.dists import dists
from ggvs_eval.contrib.more_metrics.flip import flip
from ggvs_eval.contrib.more_metrics.iv_psnr import WEIGHTS, iv_psnr
from ggvs_eval.contrib.more_metrics.vmaf import vmaf
from ggvs_eval.errors import MetricError, WeightsError
from ggvs_eval.metrics.image.dssim import dssim
from ggvs_eval.metrics.image.ms_ssim import ms_ssim
from ggvs_eval.metrics.stream import score_view

COMMAND = "python -m benchmarks.bench_full_reference"
WIDTH, HEIGHT = 1352, 1014
VIDEO_FRAMES = 4
RUNS = 5
Figure = dict[str, Any]
BT709 = 0.2126, 0.7152, 0.0722


def measure() -> dict[str, Figure]:
    """Return name -> figure, ms per frame."""
    rendered, truth = frame_pair()
    left = np.arange(WIDTH) < WIDTH // 2
    mask = np.tile(left, (HEIGHT, 1))
    calls: dict[str, tuple[Callable[[], Any], int, int]] = {  # call, frames in it, times
        "iv_psnr_masked": (lambda: iv_psnr(rendered, truth, mask), 1, RUNS),
        "ms_ssim": (lambda: ms_ssim(rendered, truth), 1, 2),
        "dssim1": (lambda: dssim(rendered, truth, 1), 1, 2),
        "dssim2": (lambda: dssim(rendered, truth, 2), 1, 2),
        "flip": (lambda: flip(rendered, truth), 1, 2),
        "vmaf": (lambda: vmaf(repeat((rendered, truth), VIDEO_FRAMES)), VIDEO_FRAMES, 2),
        "dists": (lambda: dists(rendered, truth), 1, 1),
        "cvvdp": (
            lambda: colour_video_vdp(repeat((rendered, truth), VIDEO_FRAMES)),
            VIDEO_FRAMES,
            1,
        ),
    }
    figures = _iv_psnr_figures(rendered, truth)
    for name, (call, frames, times) in calls.items():
        try:
            figures[f"metrics.{name}_ms"] = time_figure(
                [elapsed_ms(call) for _ in range(times)], frames
            )
        except (MetricError, WeightsError) as error:
            print(f"metrics.{name}: not measured: {error}", file=sys.stderr)
    return figures | _parts_figures(rendered, truth)


def _iv_psnr_figures(rendered: NDArray[np.uint8], truth: NDArray[np.uint8]) -> dict[str, Figure]:
    ours, peers = [], []
    for _ in range(3):
        ours += [elapsed_ms(lambda: iv_psnr(rendered, truth)) for _ in range(RUNS)]
        peers.append(elapsed_ms(lambda: numpy_iv_psnr(rendered, truth)))
    figure, peer = time_figure(ours, target=60), min(peers)[0]
    difference = abs(iv_psnr(rendered, truth) - numpy_iv_psnr(rendered, truth))
    return {
        "metrics.iv_psnr_ms": figure
        | {"peer": "numpy", "peer_value": peer, "ratio": peer / figure["value"]},
        "metrics.iv_psnr_minus_numpy": _figure(difference, "dB", 1e-4),
    }


def _parts_figures(rendered: NDArray[np.uint8], truth: NDArray[np.uint8]) -> dict[str, Figure]:
    """Measure the cost of static and moving parts of the quick metrics per frame, mask included."""
    frames = [(rendered, truth), (np.roll(rendered, 3, axis=1), np.roll(truth, 3, axis=1))]
    whole = ("PSNR", "SSIM", "L1", "IV_PSNR")
    parts = [f"{name}_{region}" for region in ("static", "moving") for name in whole]
    elapsed = [elapsed_ms(lambda: score_view(frames, parts)) for _ in range(2)]
    # the first frame has no parts
    return {"metrics.parts_of_psnr_ssim_l1_iv_psnr_ms": time_figure(elapsed)}


def numpy_iv_psnr(rendered: NDArray[np.uint8], truth: NDArray[np.uint8]) -> float:
    """IV-PSNR in whole-array numpy, float32, as one writes it from the definition."""
    x, y = _ycbcr(rendered), _ycbcr(truth)
    shift = np.clip(np.rint((x - y).mean(axis=(1, 2), dtype=np.float64)), -3, 3).astype(np.float32)
    x = x - shift[:, None, None]
    return min(_directed(x, y), _directed(y, x))


def _ycbcr(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    red, green, blue = BT709
    to_blue, to_red = 0.5 / (blue - 1), 0.5 / (red - 1)
    rows = np.array(
        [
            [red, green, blue],
            [to_blue * red, to_blue * green, 0.5],
            [0.5, to_red * green, to_red * blue],
        ]
    )
    levels = np.floor(image.astype(np.float64) @ np.rint(rows * 2**16).T / 2**16 + 0.5) + np.array(
        [0, 128, 128]
    )
    return np.ascontiguousarray(np.clip(levels, 0, 255).transpose(2, 0, 1), dtype=np.float32)


def _directed(image: NDArray[np.float32], candidates: NDArray[np.float32]) -> float:
    height, width = image.shape[1:]
    padded = np.pad(candidates, ((0, 0), (2, 2), (2, 2)), mode="edge")
    least = np.full((height, width), np.inf, np.float32)
    best = np.zeros_like(image)
    for down in range(5):
        for along in range(5):
            squared = np.square(image - padded[:, down : down + height, along : along + width])
            cost = 4 * squared[0] + squared[1] + squared[2]
            is_better = cost < least
            least = np.where(is_better, cost, least)
            best = np.where(is_better, squared, best)
    errors = np.maximum(best.sum(axis=(1, 2), dtype=np.float64), 1)
    return float(10 * np.log10(255**2 * height * width / errors) @ WEIGHTS)


def frame_pair() -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return a photograph enlarged to the paper's size, with and without noise."""
    truth = np.asarray(
        cv2.resize(data.astronaut(), (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC), dtype=np.uint8
    )
    noise = np.random.default_rng(0).normal(0, 5, truth.shape)
    return np.rint(np.clip(truth + noise, 0, 255)).astype(np.uint8), truth


def elapsed_ms(call: Callable[[], Any]) -> tuple[float, float]:
    """Return the time of a call by the clock, and of all cores, those of programs that it
    runs too.
    """
    start, start_of_cores = time.perf_counter(), _core_seconds()
    call()
    return (time.perf_counter() - start) * 1e3, (_core_seconds() - start_of_cores) * 1e3


def _core_seconds() -> float:
    usages = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def time_figure(
    elapsed: Sequence[tuple[float, float]], frames: int = 1, target: float | None = None
) -> Figure:
    """Return the least of some calls by the clock and by the cores, ms per frame.

    See `elapsed_ms`.
    """
    clock, cores = (min(values) / frames for values in zip(*elapsed, strict=True))
    return _figure(clock, target=target) | {"core_ms": cores}


def _figure(value: float, unit: str = "ms per frame", target: float | None = None) -> Figure:
    return {
        "value": value,
        "unit": unit,
        "target": target,
        "higher_is_better": False,
        "command": COMMAND,
    }


if __name__ == "__main__":
    for name, figure in measure().items():
        print(
            name,
            *(f"{key}={value:.4g}" for key, value in figure.items() if isinstance(value, float)),
            figure["unit"],
            sep="  ",
        )
