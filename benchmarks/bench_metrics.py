"""Time of the metrics on one frame of the paper's size, against scikit-image: ``python benchmarks/bench_metrics.py``."""

import time
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from skimage import data
from skimage.metrics import structural_similarity

from ggvs_eval.metrics.fetch_lpips import weights_path
from ggvs_eval.metrics.image import ssim
from ggvs_eval.metrics.lpips import lpips
from ggvs_eval.metrics.stream import score_view

COMMAND = "python benchmarks/bench_metrics.py"
WIDTH, HEIGHT = 1352, 1014
METRICS_OF_A_VIEW = ("PSNR", "SSIM", "LPIPS", "L1", "TCC", "STED", "SDT")  # SDV, the eighth, is a line over all views' L1
Figure = dict[str, Any]


def measure() -> dict[str, Figure]:
    """Name -> figure; LPIPS is left out where its weights have not been fetched."""
    figures = _ssim_figures() | {"metrics.seven_without_lpips_ms": _view_figure(without="LPIPS", target=250)}
    if weights_path("vgg").is_file():
        figures["metrics.lpips_vgg_480x360_ms"] = _lpips_figure(480, 360)
        figures["metrics.lpips_vgg_1352x1014_ms"] = _lpips_figure(WIDTH, HEIGHT)
        figures["metrics.all_eight_ms"] = _view_figure(without="", target=8000)
    return figures


def _ssim_figures() -> dict[str, Figure]:
    rendered, truth = _frame_pair()
    options = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False, "data_range": 255, "channel_axis": 2}
    ours_ms, value = _fastest_ms(lambda: ssim(rendered, truth), runs=20)
    peer_ms, peer_value = _fastest_ms(lambda: structural_similarity(rendered, truth, **options), runs=3)
    return {
        "metrics.ssim_ms": _figure(ours_ms, "ms", 10)
        | {"peer": "scikit-image", "peer_value": peer_ms, "ratio": peer_ms / ours_ms},
        "metrics.ssim_minus_scikit_image": _figure(abs(value - peer_value), "", 1e-6),
    }


def _view_figure(without: str, target: float) -> Figure:
    """Time per frame of a view of two frames, its metrics in one pass."""
    pairs = [_frame_pair(seed) for seed in range(2)]
    names = [name for name in METRICS_OF_A_VIEW if name != without]
    total_ms, _ = _fastest_ms(lambda: score_view(pairs, names), runs=3 if without else 1)
    return _figure(total_ms / len(pairs), "ms per frame", target)


def _lpips_figure(width: int, height: int) -> Figure:
    rendered, truth = (cv2.resize(frame, (width, height)) for frame in _frame_pair())
    fastest_ms, _ = _fastest_ms(lambda: lpips(rendered, truth, "vgg"), runs=2)
    return _figure(fastest_ms, "ms", None)


def _frame_pair(seed: int = 0) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """A photograph enlarged to the paper's size, with and without noise."""
    truth = cv2.resize(data.astronaut(), (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    noise = np.random.default_rng(seed).normal(0, 5, truth.shape)
    return np.rint(np.clip(truth + noise, 0, 255)).astype(np.uint8), truth


def _fastest_ms(call: Callable[[], Any], runs: int) -> tuple[float, Any]:
    """Shortest of `runs` calls, and what the call returns."""
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        result = call()
        times.append(time.perf_counter() - start)
    return min(times) * 1e3, result


def _figure(value: float, unit: str, target: float | None) -> Figure:
    return {"value": value, "unit": unit, "target": target, "higher_is_better": False, "command": COMMAND}


if __name__ == "__main__":
    for name, figure in measure().items():
        print(name, *(f"{key}={value}" for key, value in figure.items() if value not in (None, COMMAND)), sep="  ")
