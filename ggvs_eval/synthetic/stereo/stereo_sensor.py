"""What two real cameras add to a rectified pair: each its own exposure, colours, blur and noise; rows that do not quite agree."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8, Map

NOISE_SIDE = 1024


@dataclass(frozen=True)
class SensorOptions:
    """How far the two cameras may differ.

    Attributes:
        exposure: most often the exposure lies within this factor of the other camera's.
        hard_exposure: in one pair of eight it may lie within this one.
        blur_px: largest standard deviation of the blur in most pictures.
        noise: largest standard deviation of the noise, of 255.
        row_shift_px: standard deviation of the rows' displacement on the right.
        jpeg_share: share of the pictures that pass through JPEG.
    """

    exposure: float = 1.25
    hard_exposure: float = 1.65
    blur_px: float = 1.0
    noise: float = 6.0
    row_shift_px: float = 0.3
    jpeg_share: float = 0.3


def expose_pair(left: Map, right: Map, rng: np.random.Generator, options: SensorOptions) -> tuple[Image8, Image8]:
    """Take a pair of pictures with two cameras that share a style (tone, vignette, noise) but not their settings."""
    gamma = float(np.exp(rng.normal(0, 0.18)))
    noise = rng.uniform(0, options.noise) * rng.uniform(0.2, 1)
    limit = np.log(options.hard_exposure if rng.random() < 0.125 else options.exposure)
    common = rng.uniform(-limit, limit)
    blur = float(rng.choice([0, 0, rng.uniform(0, options.blur_px), rng.uniform(0, 2 * options.blur_px)], p=[0.2, 0.1, 0.6, 0.1]))
    pair = []
    for image in (left, right):
        gain = np.exp(0.5 * common + 0.6 * rng.uniform(-limit, limit)) * np.exp(rng.normal(0, 0.025, 3))
        toned = _tone(image, gain, gamma * float(np.exp(rng.normal(0, 0.03)))) * _vignette(rng, image.shape[:2])
        pair.append(_blurred(toned, blur * float(rng.uniform(0.6, 1.3))))
    pair[1] = _displace_rows(pair[1], rng, options.row_shift_px)
    first, second = (_digitise(image, rng, noise * rng.uniform(0.8, 1.2), options.jpeg_share) for image in pair)
    return first, second


def _tone(image: Map, gain: NDArray[np.float64], gamma: float) -> Map:
    scaled = np.clip(image * (gain / 255).astype(np.float32), np.float32(1e-4), np.float32(1.2))
    return np.asarray(cv2.pow(scaled, gamma), np.float32) * np.float32(255)


def _vignette(rng: np.random.Generator, shape: tuple[int, int]) -> Map:
    strength = rng.uniform(0, 0.25) if rng.random() < 0.5 else 0.0
    y, x = (np.linspace(-1, 1, n, dtype=np.float32) ** 2 for n in shape)
    return np.asarray(1 - np.float32(strength * 0.5) * (y[:, None] + x), np.float32)[..., None]


def _blurred(image: Map, sigma_px: float) -> Map:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px), np.float32) if sigma_px > 0.15 else image


def _displace_rows(image: Map, rng: np.random.Generator, sigma_px: float) -> Map:
    """Shift, turn and bend the rows by fractions of a pixel; columns stay, so that the disparity stays exact."""
    height, width = image.shape[:2]
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j].astype(np.float32)
    shift, turn, stretch, bend = rng.normal(0, sigma_px, 4) * (1, 0.5, 0.4, 0.4)
    offset = np.clip(shift + turn * x + stretch * y + bend * x * x, -5 * sigma_px, 5 * sigma_px).astype(np.float32)
    row = np.arange(height, dtype=np.float32)[:, None] + offset
    column = np.broadcast_to(np.arange(width, dtype=np.float32), row.shape)
    moved = cv2.remap(image, np.ascontiguousarray(column), row, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101)
    return np.asarray(moved, np.float32)


def _digitise(image: Map, rng: np.random.Generator, noise: float, jpeg_share: float) -> Image8:
    """Noise that grows with the light, rounding, and now and then JPEG."""
    grain = _noise(rng, image.shape[:2])
    level = np.sqrt(np.clip(image, 0, 255) * np.float32(0.75 / 255) + np.float32(0.25)) * np.float32(noise)
    coded = np.clip(np.rint(image + level * grain), 0, 255).astype(np.uint8)
    if rng.random() >= jpeg_share:
        return coded
    _, stream = cv2.imencode(".jpg", coded, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(70, 98))])
    return np.asarray(cv2.imdecode(stream, cv2.IMREAD_COLOR), np.uint8)


def _noise(rng: np.random.Generator, shape: tuple[int, int]) -> Map:
    """A piece of a sheet of white noise, per channel, (H, W, 3): far cheaper than new numbers and as good here."""
    sheet = _noise_sheet()
    if max(shape) > NOISE_SIDE:
        return rng.standard_normal((*shape, 3), np.float32)
    row, column = (int(rng.integers(0, NOISE_SIDE - n + 1)) for n in shape)
    piece = sheet[row : row + shape[0], column : column + shape[1]]
    return piece[:: int(rng.choice([-1, 1])), :: int(rng.choice([-1, 1]))]


@lru_cache(maxsize=1)
def _noise_sheet() -> Map:
    return np.random.default_rng(74).standard_normal((NOISE_SIDE, NOISE_SIDE, 3), np.float32)
