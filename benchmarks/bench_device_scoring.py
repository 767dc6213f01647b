"""Scoring on a GPU, checked against the CPU and timed: the last part of ``make bench-device``.

All eight metrics of a view, frames decoded. LPIPS takes its weights where they are; else random
ones of the same shapes, with the same time and values that are not compared. STED wants pyrtools,
which has its filters.
"""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from time import perf_counter
from typing import Any

import numpy as np
import torch
from safetensors.torch import save_file

from benchmarks.bench_device import scene
from ggvs_eval.arrays import Image8
from ggvs_eval.metrics.image.lpips_network import LAYERS, weights_path
from ggvs_eval.metrics.metric import MetricOptions
from ggvs_eval.metrics.stream import score_view

# SDV, the eighth, is a line over all views' L1
EIGHT = ("PSNR", "SSIM", "LPIPS", "L1", "TCC", "STED", "SDT")
TARGET_MS = 60.0  # a frame of 1352 x 1014 on a Hopper GPU, all eight
WARM_UP, TIMED = 2, 8  # frames
NOISE_LEVELS = 5
LEAST_CLOSE = 1e-4  # relative, of every value

Pair = tuple[Image8, Image8]


def print_scoring(size: tuple[int, int], device: str) -> dict[str, Any]:
    """Print, and return, how far values differ from the CPU's, and milliseconds of a frame: all,
    and of each metric alone.
    """
    device = "cpu:0" if device == "cpu" else device  # the way of a device, not the CPU's own
    frames = _frames(*size, WARM_UP + TIMED)
    metrics = EIGHT if find_spec("pyrtools") else tuple(name for name in EIGHT if name != "STED")
    title = "all eight" if metrics == EIGHT else "all except STED"
    with _lpips_weights() as genuine:
        compared = metrics if genuine else tuple(name for name in metrics if name != "LPIPS")
        difference = _largest_difference(frames[:2], compared, device)
        figures = {title: _frame_ms(frames, metrics, device)}
        figures |= {name: _frame_ms(frames, (name,), device) for name in metrics}
    verdict = "as the CPU scores it" if difference <= LEAST_CLOSE else "NOT AS THE CPU SCORES IT"
    print(
        f"\nscoring, {size[0]}x{size[1]}\n  {verdict}: values differ by at most {difference:.1e} "
        f"of themselves"
    )
    if metrics != EIGHT:
        print("  STED not computed: pyrtools is missing; install its wheel")
    if not genuine:
        print("  LPIPS by random weights: its time is right, its value is not compared")
    for name, milliseconds in figures.items():
        target = f" (to reach {TARGET_MS:g} at 1352x1014)" if name == title else ""
        print(f"  {name:26s} {milliseconds:8.2f} ms a frame{target}")
    return {"largest_difference": difference, "genuine_lpips": genuine, "frame_ms": figures}


def _frames(width: int, height: int, count: int) -> list[Pair]:
    """Return a wall of waves, as rendered and as captured: the same except for noise."""
    image = scene(width, height)[0].sources[0].image.astype(np.int16)
    random = np.random.default_rng(0)

    def noisy() -> Image8:
        noise = random.normal(0, NOISE_LEVELS, image.shape)
        return np.rint(np.clip(image + noise, 0, 255)).astype(np.uint8)

    return [(noisy(), noisy()) for _ in range(count)]


def _largest_difference(frames: list[Pair], metrics: tuple[str, ...], device: str) -> float:
    """Return the largest relative difference between a value of the device and the CPU's."""
    here, there = (
        score_view(frames, metrics, MetricOptions(device=name)).values for name in ("cpu", device)
    )
    return max(
        abs(other - value) / max(abs(value), 1e-12)
        for (_, _, value), (_, _, other) in zip(here, there, strict=True)
    )


def _frame_ms(frames: list[Pair], metrics: tuple[str, ...], device: str) -> float:
    """Return the milliseconds of a frame of a warm view, by the host's clock: values are numbers on
    the host.
    """
    options = MetricOptions(device=device)
    score_view(frames[:WARM_UP], metrics, options)
    begun_s = perf_counter()
    score_view(frames[WARM_UP:], metrics, options)
    return 1e3 * (perf_counter() - begun_s) / len(frames[WARM_UP:])


@contextmanager
def _lpips_weights() -> Iterator[bool]:
    """Within, LPIPS finds weights; says whether they are the genuine ones."""
    if weights_path("vgg").is_file():
        yield True
        return
    with tempfile.TemporaryDirectory() as folder:
        before, os.environ["GGVS_EVAL_CACHE"] = os.environ.get("GGVS_EVAL_CACHE"), folder
        try:
            save_file(_random_weights(), weights_path("vgg"))
            yield False
        finally:
            del os.environ["GGVS_EVAL_CACHE"]
            if before is not None:
                os.environ["GGVS_EVAL_CACHE"] = before


def _random_weights() -> dict[str, torch.Tensor]:
    """Return the tensors of the shapes of VGG16's convolutions and of the five heads."""
    generator, tensors, channels, heads = torch.Generator().manual_seed(0), {}, 3, 0
    widths = [64] * 2 + [128] * 2 + [256] * 3 + [512] * 6
    for number, (layer, width) in enumerate(zip(LAYERS["vgg"], widths, strict=True)):
        scale = (2 / (9 * channels)) ** 0.5
        tensors[f"conv{number}.weight"] = scale * torch.randn(
            width, channels, 3, 3, generator=generator
        )
        tensors[f"conv{number}.bias"] = torch.zeros(width)
        channels = width
        if layer.tap:
            tensors[f"head{heads}.weight"] = torch.rand(width, generator=generator) / width
            heads += 1
    return tensors
