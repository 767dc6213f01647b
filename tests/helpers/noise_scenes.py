"""Videos of one fixed camera whose clean frames are known: a still photograph before which a face
moves, and noisy recordings.

Run as a program it prints the tables of benchmarks/RESULTS.md.
"""

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from skimage import data

from ggvs_eval.arrays import Image8
from ggvs_eval.contrib.study.frame_ladders import blur, delay, flicker
from ggvs_eval.files.images import round_levels
from ggvs_eval.files.video import VideoFrames, write_video

FLICKER_SEED = 5
HEIGHT, WIDTH, FACE = 240, 304, 88
# clean frame -> standard deviation of its noise, grey levels
Noise = Callable[[np.ndarray], np.ndarray]


@lru_cache(maxsize=4)
def clean_video(
    frames: int = 24, speed_px: float = 3.3, height: int = HEIGHT, width: int = WIDTH
) -> np.ndarray:
    """A face that goes to and fro before a still photograph, (frames, height, width, 3) uint8;
    nothing else changes.
    """
    photograph = cv2.resize(data.coffee()[:, 40:560], (width, height), interpolation=cv2.INTER_AREA)
    face = cv2.resize(data.astronaut()[20:220, 130:330], (FACE, FACE), interpolation=cv2.INTER_AREA)
    video = np.stack([_place(photograph, face, t, speed_px) for t in range(frames)])
    video.setflags(write=False)
    return video


def panned_video(frames: int = 12, step_px: int = 5, size: int = 160) -> np.ndarray:
    """A moving window on a picture of gravel: every pixel changes in every frame, (frames, size,
    size, 3) uint8.
    """
    gravel = np.stack([data.gravel()] * 3, axis=-1)
    return np.stack(
        [gravel[40 : 40 + size, t * step_px : t * step_px + size] for t in range(frames)]
    )


def noisy(clean: np.ndarray, sigma: float | Noise, seed: int) -> np.ndarray:
    """A recording with Gaussian noise, independent in every pixel, channel and frame, rounded to 8
    bit.
    """
    random = np.random.default_rng(seed)
    return np.stack([_with_noise(frame, sigma, random) for frame in clean])


def shot_noise(level: np.ndarray) -> np.ndarray:
    """Noise of a sensor: its variance rises with brightness, from 1 to 5 grey levels squared."""
    return np.sqrt(1.0 + level * (4.0 / 255.0))


def encoded(frames: np.ndarray, path: Path, crf: float = 18) -> np.ndarray:
    """The frames after H.264, as a camera that stores a video gives them."""
    write_video(path, frames, fps=30, crf=crf)
    return np.stack(list(VideoFrames(path).frames(0, len(frames))))


def frozen(clean: np.ndarray) -> np.ndarray:
    """The middle frame all the time."""
    return np.repeat(clean[len(clean) // 2][None], len(clean), axis=0)


def time_averaged(clean: np.ndarray) -> np.ndarray:
    """Each frame the mean of its neighbours and itself."""
    padded = np.concatenate([clean[:1], clean, clean[-1:]]).astype(np.float64)
    return round_levels((padded[:-2] + padded[1:-1] + padded[2:]) / 3)


def planted(clean: np.ndarray) -> dict[str, np.ndarray]:
    """Renderings with one known defect each."""
    return {
        "flicker 1 %": flicker(clean, 1.0, FLICKER_SEED),
        "flicker 2 %": flicker(clean, 2.0, FLICKER_SEED),
        "noise": noisy(clean, 1.0, seed=9),
        "frozen": frozen(clean),
        "blurred": blur(clean, 1.5),
        "blurred more": blur(clean, 4.0),
        "late": delay(clean, 1),
        "averaged over time": time_averaged(clean),
    }


def _place(photograph: Image8, face: Image8, index: int, speed_px: float) -> Image8:
    """The face at its place in this frame, to a fraction of a pixel."""
    height, width = photograph.shape[:2]
    reach = width - FACE - 8
    way = (speed_px * index) % (2 * reach)
    x, y = 4 + min(way, 2 * reach - way), (height - FACE) / 2 + 20 * np.sin(index / 5)
    shift = np.array([[1.0, 0.0, x], [0.0, 1.0, y]])
    cover = cv2.warpAffine(np.ones((FACE, FACE), np.float32), shift, (width, height))[..., None]
    moved = cv2.warpAffine(face.astype(np.float32), shift, (width, height))
    # away from black and white, where noise is cut off
    return round_levels(20 + 0.85 * (photograph * (1 - cover) + moved))


def _with_noise(frame: Image8, sigma: float | Noise, random: np.random.Generator) -> Image8:
    level = sigma(frame.astype(np.float64)) if callable(sigma) else sigma
    return round_levels(frame + random.normal(size=frame.shape) * level)


def print_tables() -> None:
    """Print what planted renderings score, and the ceilings beside what perfect renderings
    score.
    """
    from ggvs_eval.metrics.ceilings import ceilings
    from ggvs_eval.metrics.registry import ceiling_metrics
    from ggvs_eval.metrics.stream import score_view
    from ggvs_eval.metrics.time.flicker import flicker as measure_flicker
    from ggvs_eval.metrics.time.strred import strred
    from ggvs_eval.metrics.time.tcc import tcc

    clean = clean_video(30)
    captured, second = noisy(clean, 2.0, seed=1), noisy(clean, 2.0, seed=2)
    print("| rendering | TCC | STED | excess | error | with noise |")
    for name, video in {"perfect": clean, "second recording": second, **planted(clean)}.items():
        found = measure_flicker(zip(video, captured, strict=True))
        scores = f"{tcc(video, captured):.3f} | {strred(video, captured).strred:.2f}"
        print(
            f"| {name} | {scores} | {found.excess:+.2f} | {found.error:.2f} | "
            f"{found.with_noise:+.2f} |"
        )
    recordings = {
        f"white, {sigma}": [noisy(clean, sigma, seed) for seed in (1, 2)]
        for sigma in (0.6, 1.3, 2.0, 4.0)
    }
    recordings["shot, 1 to 2.2"] = [noisy(clean, shot_noise, seed) for seed in (1, 2)]
    for label, (captured, second) in recordings.items():
        found = ceilings(lambda captured=captured: iter(captured), ceiling_metrics())
        for kind, video, estimate in (
            ("noise-free", clean, found.noise_free),
            ("second", second, found.second_recording),
        ):
            values = score_view(zip(video, captured, strict=True), ceiling_metrics()).values
            means = {
                name: np.mean([value for other, _, value in values if other == name])
                for name in ceiling_metrics()
            }
            print(
                f"| {label} | {kind} | "
                + " | ".join(f"{means[name]:.3f} / {estimate[name]:.3f}" for name in means)
            )


if __name__ == "__main__":
    print_tables()
