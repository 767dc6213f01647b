"""Time and memory of the metrics on frames of the paper's size, against scikit-image and
scikit-video.

``python -m benchmarks.bench_metrics``. The compared functions are timed by turns in one run, and
the fastest call counts.
"""

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from skimage import data
from skimage.metrics import structural_similarity
from torch.nn import functional

from ggvs_eval.metrics.colour_moments import ColourMoments
from ggvs_eval.metrics.image.corrected import apply_colour_map
from ggvs_eval.metrics.image.lpips import lpips
from ggvs_eval.metrics.image.lpips_network import (
    LAYERS,
    load_heads,
    load_weights,
    network_input,
    tapped_layers,
    weights_path,
)
from ggvs_eval.metrics.image.ssim import masked_ssim, ssim
from ggvs_eval.metrics.stream import score_view, score_views

COMMAND = "python -m benchmarks.bench_metrics"
WIDTH, HEIGHT = 1352, 1014
# SDV, the eighth, is a line over all views' L1
METRICS_OF_A_VIEW = ("PSNR", "SSIM", "LPIPS", "L1", "TCC", "STED", "SDT")
SEVEN = [name for name in METRICS_OF_A_VIEW if name != "LPIPS"]
SHORT, LONG = 4, 24  # frames of the views whose memory is measured
Figure = dict[str, Any]


def measure() -> dict[str, Figure]:
    """Name -> figure; LPIPS is left out where its weights have not been fetched, ST-RRED's peer
    where it is not installed.
    """
    figures = _ssim_figures() | _strred_figures() | _variant_figures() | _memory_figures()
    figures["metrics.seven_without_lpips_ms"] = _figure(
        _view_ms(SEVEN, runs=3), "ms per frame", 250
    )
    if weights_path("vgg").is_file():
        figures |= _lpips_figures(480, 360) | _lpips_figures(WIDTH, HEIGHT)
        figures["metrics.all_eight_ms"] = _figure(
            _view_ms(METRICS_OF_A_VIEW, runs=1), "ms per frame", 8000
        )
        figures["metrics.all_eight_of_two_methods_ms"] = _figure(
            _two_methods_ms(), "ms per frame", 12000
        )
    return figures


def _ssim_figures() -> dict[str, Figure]:
    rendered, truth = _frame_pair()
    options = {
        "gaussian_weights": True,
        "sigma": 1.5,
        "use_sample_covariance": False,
        "data_range": 255,
        "channel_axis": 2,
    }
    ours_ms, peer_ms = np.inf, np.inf
    for _ in range(4):
        ours_ms = min(ours_ms, _fastest_ms(lambda: ssim(rendered, truth), runs=5)[0])
        peer_ms = min(
            peer_ms,
            _fastest_ms(lambda: structural_similarity(rendered, truth, **options), runs=1)[0],
        )
    difference = abs(ssim(rendered, truth) - structural_similarity(rendered, truth, **options))
    return {
        "metrics.ssim_ms": _figure(ours_ms, "ms", 10) | _peer("scikit-image", peer_ms, ours_ms),
        "metrics.ssim_times_faster_than_scikit_image": _speedup(peer_ms / ours_ms, 4),
        "metrics.ssim_minus_scikit_image": _figure(difference, "", 1e-6),
    }


def _strred_figures() -> dict[str, Figure]:
    """Against scikit-video in a separate process; this package alone where it is not installed."""
    run = subprocess.run(
        [sys.executable, "-m", "benchmarks.scikit_video_strred"],
        capture_output=True,
        text=True,
        check=False,
    )
    if run.returncode:
        print(f"metrics.strred: {run.stderr.strip().splitlines()[-1]}", file=sys.stderr)
        return {"metrics.strred_ms": _figure(_view_ms(["STED"], runs=3), "ms per frame", None)}
    figures = json.loads(run.stdout)
    ours_ms, peer_ms = figures["ours_ms"], figures["peer_ms"]
    return {
        "metrics.strred_ms": _figure(ours_ms, "ms per frame", None)
        | _peer("scikit-video, patched to run", peer_ms, ours_ms),
        "metrics.strred_times_faster_than_scikit_video": _speedup(peer_ms / ours_ms, 10),
        "metrics.strred_against_scikit_video": _figure(
            abs(figures["value"] / figures["peer_value"] - 1), "relative", 5e-4
        ),
    }


def _variant_figures() -> dict[str, Figure]:
    """Return the time optional variants that a protocol may request: masked SSIM, colour
    correction.
    """
    rendered, truth = _frame_pair()
    mask = np.zeros(truth.shape[:2], dtype=bool)
    mask[100:600, 200:900] = True
    moments = ColourMoments()
    moments.add(rendered, truth)
    colour_map = moments.map()
    calls: dict[str, Callable[[], object]] = {
        "metrics.masked_ssim_ms": lambda: masked_ssim(rendered, truth, mask),
        "metrics.colour_moments_ms": lambda: moments.add(rendered, truth),
        "metrics.colour_map_applied_ms": lambda: apply_colour_map(colour_map, rendered),
    }
    return {name: _figure(_fastest_ms(call, runs=5)[0], "ms", None) for name, call in calls.items()}


def _memory_figures() -> dict[str, Figure]:
    """Measure by how much scoring short and long views raises a process's memory.

    A pair of frames is 8.2 MB.
    """
    short_mb, long_mb = (_peak_mb(frames, "seven") for frames in (SHORT, LONG))
    figures = {
        "metrics.seven_memory_mb": _figure(short_mb, "MB", None),
        "metrics.seven_memory_per_further_frame_mb": _figure(
            (long_mb - short_mb) / (LONG - SHORT), "MB", 0.5
        ),
    }
    if weights_path("vgg").is_file():
        figures["metrics.all_eight_memory_mb"] = _figure(_peak_mb(2, "all"), "MB", None)
    return figures


def _peak_mb(frames: int, which: str) -> float:
    command = [sys.executable, "-m", "benchmarks.bench_metrics", str(frames), which]
    return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def _score_and_print_peak(frames: int, which: str) -> None:
    """Print the peak memory of scoring, as the child of `_peak_mb`: weights are read and the peak
    is reset before it.
    """
    names = METRICS_OF_A_VIEW if which == "all" else SEVEN
    rendered, truth = _frame_pair()
    score_view([(rendered[:64, :64], truth[:64, :64])] * 2, names)
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    before_mb = _memory_mb("VmRSS")
    score_view(_shifted(rendered, truth, frames), names)
    print(_memory_mb("VmHWM") - before_mb)


def _memory_mb(field: str) -> float:
    """Return a line of this process's status; Linux only."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return next(
        int(line.split()[1]) / 1024 for line in status.splitlines() if line.startswith(field)
    )


def _shifted(
    rendered: NDArray[np.uint8], truth: NDArray[np.uint8], frames: int
) -> Iterator[tuple[NDArray[np.uint8], ...]]:
    """Yield a view whose frames exist one at a time."""
    for t in range(frames):
        yield np.roll(rendered, 3 * t, axis=1), np.roll(truth, 3 * t, axis=1)


def _view_ms(names: tuple[str, ...] | list[str], runs: int) -> float:
    """Return the time per frame of a view of two frames, its metrics in one pass."""
    pairs = [_frame_pair(seed) for seed in range(2)]
    return _fastest_ms(lambda: score_view(pairs, names), runs)[0] / len(pairs)


def _two_methods_ms() -> float:
    """Return the same for two renderings at once; what the truth alone decides is computed once."""
    pairs = [_frame_pair(seed) for seed in range(2)]
    frames = [((rendered, rendered.copy()), truth) for rendered, truth in pairs]
    return _fastest_ms(lambda: score_views(frames, METRICS_OF_A_VIEW), runs=1)[0] / len(pairs)


def _lpips_figures(width: int, height: int) -> dict[str, Figure]:
    """LPIPS of two frames by the compiled kernel and by torch."""
    rendered, truth = (cv2.resize(frame, (width, height)) for frame in _frame_pair())
    ours_ms, peer_ms = np.inf, np.inf
    for _ in range(3):
        ours_ms = min(ours_ms, _fastest_ms(lambda: lpips(rendered, truth, "vgg"), runs=1)[0])
        peer_ms = min(peer_ms, _fastest_ms(lambda: _torch_lpips(rendered, truth), runs=1)[0])
    name = f"metrics.lpips_vgg_{width}x{height}"
    return {
        f"{name}_ms": _figure(ours_ms, "ms", None) | _peer("torch", peer_ms, ours_ms),
        f"{name}_times_faster_than_torch": _speedup(peer_ms / ours_ms, 2),
        f"{name}_minus_torch": _figure(
            abs(lpips(rendered, truth, "vgg") - _torch_lpips(rendered, truth)), "", 1e-5
        ),
    }


def _torch_lpips(rendered: NDArray[np.uint8], truth: NDArray[np.uint8]) -> float:
    weights, total = load_weights("vgg"), 0.0
    with torch.inference_mode():
        frames = [
            network_input(frame)[None].contiguous(memory_format=torch.channels_last)
            for frame in (rendered, truth)
        ]
        layers = zip(
            *(tapped_layers(frame, LAYERS["vgg"], weights) for frame in frames),
            load_heads("vgg", "cpu"),
            strict=True,
        )
        for ours, theirs, heads in layers:
            # which stay in cache
            rows = zip(ours.split(16, dim=2), theirs.split(16, dim=2), strict=True)
            squared = [
                (functional.normalize(one) - functional.normalize(other)).square_()
                for one, other in rows
            ]
            total += sum(float(torch.einsum("nchw,c->", each, heads)) for each in squared) / (
                ours.shape[2] * ours.shape[3]
            )
    return total


def _frame_pair(seed: int = 0) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return a photograph enlarged to the paper's size, with and without noise."""
    truth = cv2.resize(data.astronaut(), (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    noise = np.random.default_rng(seed).normal(0, 5, truth.shape)
    return np.rint(np.clip(truth + noise, 0, 255)).astype(np.uint8), truth


def _fastest_ms(call: Callable[[], Any], runs: int) -> tuple[float, Any]:
    """Return the shortest of `runs` calls, and what the call returns."""
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        result = call()
        times.append(time.perf_counter() - start)
    return min(times) * 1e3, result


def _figure(value: float, unit: str, target: float | None) -> Figure:
    return {
        "value": value,
        "unit": unit,
        "target": target,
        "higher_is_better": False,
        "command": COMMAND,
    }


def _speedup(times: float, target: float) -> Figure:
    return _figure(times, "times", target) | {"higher_is_better": True}


def _peer(name: str, value: float, ours: float) -> Figure:
    return {"peer": name, "peer_value": value, "ratio": value / ours}


if __name__ == "__main__":
    if len(sys.argv) > 1:
        _score_and_print_peak(int(sys.argv[1]), sys.argv[2])
    else:
        for name, figure in measure().items():
            print(
                name,
                *(
                    f"{key}={value}"
                    for key, value in figure.items()
                    if value not in (None, COMMAND)
                ),
                sep="  ",
            )
