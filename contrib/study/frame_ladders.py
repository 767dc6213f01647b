"""Degradations of frames by formula: pure functions (frames, strength, seed) -> frames, equal seeds
equal bits.

Frames are (T, H, W, 3) uint8, consecutive in time at a fixed camera, or in the poses of a camera
that moves. Every result is rounded to 8 bit, as it would be written.
"""

import tempfile
from pathlib import Path

import cv2
import numpy as np

from ggvs_eval.arrays import Array, Image8
from ggvs_eval.files.images import round_levels
from ggvs_eval.files.video import VideoFrames, write_video

WAVE_PX, WAVE_DEG = 48.0, 2.0  # wave lengths of the wobble on the image, and over the angle of view
SPLINE = 3  # order of the interpolation of displaced pixels


def blur(frames: Image8, sigma_px: float, _seed: int = 0) -> Image8:
    """Blurred frames: each convolved with a Gaussian of standard deviation `sigma_px`."""
    return np.stack([cv2.GaussianBlur(frame, (0, 0), sigma_px) for frame in frames])


def noise(frames: Image8, sigma_255: float, seed: int = 0) -> Image8:
    """Noisy frames: I + n, n Gaussian of standard deviation `sigma_255`, independent in every
    pixel, channel and frame.
    """
    random = np.random.default_rng(seed)
    return np.stack(
        [round_levels(frame + random.normal(size=frame.shape) * sigma_255) for frame in frames]
    )


def shift(frames: Image8, shift_px: float, seed: int = 0) -> Image8:
    """Displaced frames: I(x - d), |d| = `shift_px` in a direction that the seed chooses, the same
    in every frame.
    """
    angle = np.random.default_rng(seed).uniform(0.0, 2 * np.pi)
    return np.stack(
        [_displaced(frame, shift_px * np.cos(angle), shift_px * np.sin(angle)) for frame in frames]
    )


def wobble(frames: Image8, amplitude_px: float, seed: int, angles_deg: Array) -> Image8:
    """Frames whose surfaces swim with the view: I(x - d), d = A (sin p(y), sin p(x)), p(s) = 2 pi
    (s / l + a / b) + p0.

    A is `amplitude_px`, l = `WAVE_PX`, b = `WAVE_DEG`, the phases p0 are the seed's, and a is the
    angle of view of each frame, (T,): at one angle the displacement is always the same.
    """
    phases = np.random.default_rng(seed).uniform(0.0, 2 * np.pi, 2)
    height, width = frames.shape[1:3]
    swum = []
    for frame, angle in zip(frames, angles_deg, strict=True):
        across, down = (
            amplitude_px
            * np.sin(2 * np.pi * (np.arange(size) / WAVE_PX + angle / WAVE_DEG) + phase)
            for size, phase in zip((height, width), phases, strict=True)
        )
        swum.append(_displaced(frame, across[:, None], down[None, :]))
    return np.stack(swum)


def flicker(frames: Image8, percent: float, seed: int = 0) -> Image8:
    """Flickering frames: g_t I_t, the gains Gaussian about 1 with a standard deviation of exactly
    `percent`.
    """
    gains = np.random.default_rng(seed).normal(size=len(frames))
    gains = 1.0 + percent / 100 * (gains - gains.mean()) / gains.std()
    return round_levels(frames * gains[:, None, None, None])


def drift(frames: Image8, percent: float, _seed: int = 0) -> Image8:
    """Frames that brighten slowly: g_t I_t, the gains evenly spaced over `percent` about 1, from
    the first frame to the last.
    """
    gains = 1.0 + percent / 100 * np.linspace(-0.5, 0.5, len(frames))
    return round_levels(frames * gains[:, None, None, None])


def freeze(frames: Image8, percent: float, seed: int = 0) -> Image8:
    """Frozen frames: `percent` of all frames but the first, chosen by the seed, repeat what was
    shown before them.
    """
    order = 1 + np.random.default_rng(seed).permutation(len(frames) - 1)
    frozen = {*order[: round(percent / 100 * len(order))].tolist()}
    sources = np.maximum.accumulate([0 if t in frozen else t for t in range(len(frames))])
    return frames[sources]


def delay(frames: Image8, n_frames: float, _seed: int = 0) -> Image8:
    """Late frames: each shown `n_frames` after its time; the first one is shown until then."""
    return frames[np.maximum(np.arange(len(frames)) - round(n_frames), 0)]


def compress(frames: Image8, crf: float, _seed: int = 0) -> Image8:
    """Coded frames: H.264 by x264 at this constant rate factor, 4:2:0, decoded again.

    An odd side is padded for it.
    """
    height, width = frames.shape[1:3]
    even = np.pad(frames, ((0, 0), (0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "coded.mp4"
        write_video(path, even, fps=30, crf=crf)
        return np.stack(list(VideoFrames(path).frames(0, len(even))))[:, :height, :width]


def colour_cast(frames: Image8, percent: float, seed: int = 0) -> Image8:
    """Frames of another white balance: each channel times 1 + `percent` c, c a random direction of
    length sqrt(3), the seed's.
    """
    cast = np.random.default_rng(seed).normal(size=3)
    return round_levels(frames * (1.0 + percent / 100 * np.sqrt(3.0) * cast / np.linalg.norm(cast)))


def _displaced(frame: Image8, across_px: Array | float, down_px: Array | float) -> Image8:
    """Return a frame resampled at x - d by cubic splines.

    Displacements broadcast to (H, W), the border is repeated.

    OpenCV's own resampling knows 32 places between two pixels, too few for the smallest shifts.
    """
    from scipy.ndimage import map_coordinates

    rows, columns = np.mgrid[: frame.shape[0], : frame.shape[1]]
    places = np.broadcast_arrays(rows - down_px, columns - across_px)
    channels = [
        map_coordinates(frame[..., c].astype(np.float64), places, order=SPLINE, mode="nearest")
        for c in range(3)
    ]
    return round_levels(np.stack(channels, axis=-1))
