"""The plane sweep's costs in a page of numpy."""

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array

COST_LIMIT = 127
UNSEEN_FIT = 0.5


def sweep_twin(reference, guide, partners, window, hidden_weight, planes) -> NDArray[np.uint8]:
    """What `_stereo.sweep_planes` computes where every plane is looked at, (H, W, planes)."""
    first, step, count = planes
    weights = window_weights(guide.astype(np.float64), *window[:3])  # (T, H, W)
    contrast = windows(reference.astype(np.float64), window[0])
    contrast = contrast - (weights * contrast).sum(axis=0)
    contrast = contrast / np.sqrt((weights * contrast**2).sum(axis=0) + window[3])
    costs = np.empty((*reference.shape, count), np.uint8)
    for plane in range(count):
        scores = np.stack(
            [
                score(reference.shape, weights, contrast, each, window, first + step * plane)
                for each in partners
            ]
        )  # (K, H, W)
        fit = (
            trusted_mean(scores, partners, hidden_weight)
            if partners[0][3] is not None
            else better_half(scores)
        )
        fit = np.where(fit <= -2, UNSEEN_FIT, fit.clip(0, 1))
        costs[..., plane] = np.floor(COST_LIMIT * (1 - fit) + 0.5)
    return costs


def windows(values: Array, radius: int) -> Array:
    """Every pixel's window, row by row, with the border repeated, (T, H, W)."""
    padded = np.pad(values, radius, mode="edge")
    side = 2 * radius + 1
    return np.stack(
        [
            padded[j : j + values.shape[0], i : i + values.shape[1]]
            for j in range(side)
            for i in range(side)
        ]
    )


def window_weights(guide: Array, radius: int, colour_scale: float, distance_scale: float) -> Array:
    """How much each pixel of a window counts, (T, H, W); they sum to 1."""
    difference = sum((windows(guide[..., c], radius) - guide[..., c]) ** 2 for c in range(3)) / (
        3 * colour_scale**2
    )
    rows, columns = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    distance = ((rows**2 + columns**2) / distance_scale**2).reshape(-1, 1, 1)
    weights = 1 / ((1 + difference / 2 + difference**2 / 2) * (1 + distance))
    return weights / weights.sum(axis=0)


def score(shape, weights, contrast, partner, window, inverse_depth) -> Array:
    """Correlation with one partner, (H, W); -2 where its image ends: no vote."""
    image, first, last, _, (start_x, start_y, slope_x, slope_y, x, y, along) = partner
    height, width = image.shape
    denominator = 1 - along * inverse_depth
    if denominator < 0.1:
        return np.full(shape, -2.0)
    columns = (np.arange(shape[1]) + start_x + slope_x * inverse_depth) / denominator + x
    rows = (np.arange(shape[0]) + start_y + slope_y * inverse_depth) / denominator + y
    seen = windows(
        interpolate(image.astype(np.float64), rows.clip(0, height - 1), columns.clip(0, width - 1)),
        window[0],
    )
    mean = (weights * seen).sum(axis=0)
    variance = ((weights * seen**2).sum(axis=0) - mean**2).clip(0) + window[3]
    found = (weights * contrast * seen).sum(axis=0) / np.sqrt(variance)
    above = np.floor(rows.clip(0, height - 1)).astype(int)
    below = np.minimum(above + 1, height - 1)
    left, right = (
        np.maximum(first[above], first[below])[:, None],
        np.minimum(last[above], last[below])[:, None],
    )
    inside = (columns >= left) & (columns <= right) & ((rows >= 0) & (rows <= height - 1))[:, None]
    return np.where(inside, found, -2.0)


def interpolate(image: Array, rows: Array, columns: Array) -> Array:
    """Bilinear, at all crossings of rows and columns."""
    top = np.minimum(rows.astype(int), image.shape[0] - 2)
    left = np.minimum(columns.astype(int), image.shape[1] - 2)
    blended = image[top] + (rows - top)[:, None] * (image[top + 1] - image[top])
    return blended[:, left] + (columns - left) * (blended[:, left + 1] - blended[:, left])


def trusted_mean(scores: Array, partners, hidden_weight: float) -> Array:
    """Mean of the votes; those of partners that do not see the pixel count less."""
    trust = np.stack([np.where(partner[3] > 0, 1.0, hidden_weight) for partner in partners]) * (
        scores > -2
    )
    total = trust.sum(axis=0)
    return np.where(total > 0, (trust * scores).sum(axis=0) / np.where(total > 0, total, 1), -2)


def better_half(scores: Array) -> Array:
    """Mean of the better half of the votes."""
    ordered = -np.sort(-scores, axis=0)
    half = np.maximum(((scores > -2).sum(axis=0) + 1) // 2, 1)
    return np.where(np.arange(len(scores))[:, None, None] < half, ordered, 0).sum(axis=0) / half
