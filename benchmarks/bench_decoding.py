"""Decoding a video as a stream: speed against OpenCV's reader, memory over the number of frames.

``python -m benchmarks.bench_decoding``
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ggvs_eval.files.images import resize
from ggvs_eval.files.video import VideoFrames, write_video

COMMAND = "python -m benchmarks.bench_decoding"
# DyNeRF's videos, and the size at which the paper uses them.
WIDTH, HEIGHT = 2704, 2028
SHORT, LONG = 50, 500
Figure = dict[str, Any]


def measure() -> dict[str, Figure]:
    """Return name -> figure: milliseconds per frame, and how much more memory ten times the frames
    take.
    """
    with tempfile.TemporaryDirectory() as folder:
        large, short, long = (
            Path(folder) / name for name in ("large.mp4", "short.mp4", "long.mp4")
        )
        _film(large, 24, WIDTH, HEIGHT)
        _film(short, SHORT, WIDTH // 2, HEIGHT // 2)
        _film(long, LONG, WIDTH // 2, HEIGHT // 2)
        ours_ms, peer_ms = _decode_ms(large, 24), _opencv_ms(large, 24)
        peaks_mb = {path: _peak_mb(path) for path in (short, long)}
        resize_ms = _resize_ms()
    return {
        "decoding.frame_2704x2028_ms": _figure(ours_ms, "ms")
        | {
            "peer": "OpenCV VideoCapture (converts with rounding errors)",
            "peer_value": peer_ms,
            "ratio": peer_ms / ours_ms,
        },
        "decoding.lanczos_to_1352x1014_ms": _figure(resize_ms, "ms"),
        f"decoding.peak_memory_{SHORT}_frames_mb": _figure(peaks_mb[short], "MB"),
        f"decoding.peak_memory_{LONG}_frames_mb": _figure(peaks_mb[long], "MB"),
        "decoding.memory_per_further_frame_mb": _figure(
            (peaks_mb[long] - peaks_mb[short]) / (LONG - SHORT), "MB", 0.02
        ),
    }


def _film(path: Path, n_frames: int, width: int, height: int) -> None:
    """A photograph-like texture that moves by four pixels per frame."""
    rng = np.random.default_rng(0)
    texture = cv2.resize(
        rng.integers(0, 255, (height // 8, width // 8, 3)).astype(np.uint8), (width, height)
    )
    write_video(
        path, (np.roll(texture, 4 * index, axis=1) for index in range(n_frames)), 30.0, crf=18
    )


def _decode_ms(path: Path, n_frames: int) -> float:
    start = time.perf_counter()
    count = sum(1 for _ in VideoFrames(path).frames(0, n_frames))
    return (time.perf_counter() - start) / count * 1e3


def _opencv_ms(path: Path, n_frames: int) -> float:
    start = time.perf_counter()
    video = cv2.VideoCapture(str(path))
    for _ in range(n_frames):
        _, image = video.read()
        cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
    return (time.perf_counter() - start) / n_frames * 1e3


def _resize_ms() -> float:
    image = np.random.default_rng(0).integers(0, 255, (HEIGHT, WIDTH, 3)).astype(np.uint8)
    start = time.perf_counter()
    resize(image, WIDTH // 2, HEIGHT // 2, "lanczos")
    return (time.perf_counter() - start) * 1e3


def _peak_mb(path: Path) -> float:
    """Return the largest resident memory of a separate process that decodes the whole video."""
    command = [sys.executable, "-m", "benchmarks.bench_decoding", str(path)]
    return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def _figure(value: float, unit: str, target: float | None = None) -> Figure:
    return {
        "value": value,
        "unit": unit,
        "target": target,
        "higher_is_better": False,
        "command": COMMAND,
    }


if __name__ == "__main__":
    if len(sys.argv) > 1:
        video = VideoFrames(Path(sys.argv[1]))
        checksum = sum(int(image[0, 0, 0]) for image in video.frames(0, video.n_frames))
        # Not ru_maxrss, which starts from what the calling process had.
        status = Path("/proc/self/status").read_text(encoding="ascii")
        print(
            next(
                int(line.split()[1]) / 1024
                for line in status.splitlines()
                if line.startswith("VmHWM")
            )
        )
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
