"""Outlines of the flat things in the stereo scenes: leaves, wheels, lattices, torn cards; where a sheet is solid."""

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.synthetic.room.textures import fractal_noise
from ggvs_eval.synthetic.stereo.stereo_shapes import MASK_SIDE

CANVAS = 4 * MASK_SIDE  # drawn large and reduced, so that the outline is smooth


@lru_cache(maxsize=1)
def mask_bank() -> list[Image8]:
    """64 outlines, always the same; the first quarter has thin bars (lattices and wheels)."""
    makers = [_lattice, _wheel, _polygon, _blob, _leaf, _holes, _frame, _polygon]
    return [_reduced(makers[index // 8](np.random.default_rng([73, index]))) for index in range(64)]


def _reduced(canvas: Image8) -> Image8:
    mask = np.asarray(cv2.resize(canvas, (MASK_SIDE, MASK_SIDE), interpolation=cv2.INTER_AREA), np.uint8)
    mask[[0, -1]], mask[:, [0, -1]] = 0, 0
    return mask


def _polygon(rng: np.random.Generator) -> Image8:
    corners = int(rng.integers(3, 10))
    angles = np.sort(rng.uniform(0, 2 * np.pi, corners)) if rng.random() < 0.5 else np.arange(corners) * 2 * np.pi / corners
    points = 0.5 + 0.48 * np.stack([np.cos(angles), np.sin(angles)], 1) * rng.uniform(0.4, 1, (corners, 1))
    return _filled([points])


def _leaf(rng: np.random.Generator) -> Image8:
    """Several pointed leaves around a stalk."""
    leaves = []
    for angle in np.arange(rng.integers(1, 8)) * rng.uniform(0.6, 1.2):
        along = np.linspace(0, 1, 24)
        half = rng.uniform(0.05, 0.16) * np.sin(np.pi * along ** rng.uniform(0.6, 1.2))
        outline = np.concatenate([np.stack([along, half], 1), np.stack([along[::-1], -half[::-1]], 1)]) * 0.47
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        leaves.append(0.5 + outline @ turn.T)
    return _filled(leaves)


def _blob(rng: np.random.Generator) -> Image8:
    y, x = np.mgrid[:CANVAS, :CANVAS].astype(np.float32) / CANVAS * 2 - 1
    noise = fractal_noise(rng, (CANVAS, CANVAS), (CANVAS / 3, CANVAS / 3), 4)
    return np.asarray((np.hypot(x, y) + 0.15 * noise < 0.75) * 255, np.uint8)


def _holes(rng: np.random.Generator) -> Image8:
    """A card full of holes."""
    canvas = np.full((CANVAS, CANVAS), 255, np.uint8)
    for _ in range(int(rng.integers(3, 25))):
        centre = rng.integers(0, CANVAS, 2).tolist()
        size = np.rint(np.exp(rng.uniform(np.log(0.03), np.log(0.2), 2)) * CANVAS).astype(int).tolist()
        cv2.ellipse(canvas, centre, size, float(rng.uniform(0, 180)), 0, 360, 0, -1)
    return canvas


def _frame(rng: np.random.Generator) -> Image8:
    """A window, a picture frame, a ring or an arch."""
    canvas = np.zeros((CANVAS, CANVAS), np.uint8)
    thickness = int(CANVAS * np.exp(rng.uniform(np.log(0.02), np.log(0.12))))
    inset = thickness // 2 + 8
    if rng.random() < 0.5:
        cv2.circle(canvas, (CANVAS // 2, CANVAS // 2), CANVAS // 2 - inset, 255, thickness)
    else:
        cv2.rectangle(canvas, (inset, inset), (CANVAS - inset, CANVAS - inset), 255, thickness)
        for place in rng.uniform(0.2, 0.8, int(rng.integers(0, 3))) * CANVAS:
            cv2.line(canvas, (int(place), 0), (int(place), CANVAS), 255, thickness // 2 + 1)
    return canvas


def _lattice(rng: np.random.Generator) -> Image8:
    """Bars in one or two directions: a fence, the back of a chair, a grating, blinds."""
    canvas = np.zeros((CANVAS, CANVAS), np.uint8)
    for _ in range(int(rng.integers(1, 3))):
        angle = rng.choice([0, np.pi / 2, rng.uniform(0, np.pi)])
        pitch = CANVAS * np.exp(rng.uniform(np.log(0.06), np.log(0.25)))
        thickness = max(8, int(pitch * rng.uniform(0.08, 0.5)))
        along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        for place in np.arange(-CANVAS, CANVAS, pitch):
            ends = CANVAS / 2 + place * across + np.array([[-1], [1]]) * CANVAS * along
            first, second = np.rint(ends).astype(int).tolist()
            cv2.line(canvas, first, second, 255, thickness)
    return canvas


def _wheel(rng: np.random.Generator) -> Image8:
    canvas = np.zeros((CANVAS, CANVAS), np.uint8)
    middle = (CANVAS // 2, CANVAS // 2)
    rim = int(CANVAS * rng.uniform(0.02, 0.09))
    radius = CANVAS // 2 - rim
    cv2.circle(canvas, middle, radius, 255, rim)
    cv2.circle(canvas, middle, int(CANVAS * rng.uniform(0.03, 0.12)), 255, -1)
    spokes = int(rng.integers(4, 28))
    for angle in np.arange(spokes) * 2 * np.pi / spokes:
        end = (int(middle[0] + radius * np.cos(angle)), int(middle[1] + radius * np.sin(angle)))
        cv2.line(canvas, middle, end, 255, max(7, int(CANVAS * rng.uniform(0.008, 0.02))))
    return canvas


def _filled(outlines: list[NDArray[np.float64]]) -> Image8:
    canvas = np.zeros((CANVAS, CANVAS), np.uint8)
    for outline in outlines:
        cv2.fillPoly(canvas, [np.rint(outline * CANVAS).astype(np.int32)], 255)
    return canvas
