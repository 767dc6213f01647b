"""Semi-global matching along eight paths and the weighted median, pixel by pixel."""

import numpy as np
from numpy.typing import NDArray

Costs = NDArray[np.int64]
# of both passes, (rows, columns)
DIRECTIONS = (((1, 1), (1, 0), (1, -1), (0, 1)), ((-1, -1), (-1, 0), (-1, 1), (0, -1)))


def aggregate_twin(
    costs, guide, small_step, large_steps
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """What `_stereo.aggregate` computes: the surface in planes and its margin."""
    passes = []
    for directions in DIRECTIONS:
        paths = [
            path_costs(costs.astype(int), guide.astype(int), small_step, large_steps, *each)
            for each in directions
        ]
        passes.append(mean(mean(paths[0], paths[1]), mean(paths[2], paths[3])))
    total = passes[0] + passes[1]
    surface, margin = np.empty(guide.shape, np.float32), np.empty(guide.shape, np.float32)
    for pixel in np.ndindex(guide.shape):
        surface[pixel], margin[pixel] = winner(total[pixel])
    return surface, margin


def mean(first: Costs, second: Costs) -> Costs:
    """Rounded up, as bytes are averaged."""
    return (first + second + 1) // 2


def path_costs(
    costs: Costs, guide: Costs, small_step: int, large_steps, down: int, across: int
) -> Costs:
    """Costs of the paths that come from one direction."""
    height, width, _ = costs.shape
    found = np.zeros_like(costs)
    for row in range(height)[:: -1 if down < 0 else 1]:
        for column in range(width)[:: -1 if across < 0 or (across == 0 and down < 0) else 1]:
            before = row - down, column - across
            found[row, column] = costs[row, column]
            if 0 <= before[0] < height and 0 <= before[1] < width:
                large = int(large_steps[abs(guide[row, column] - guide[before])])
                found[row, column] += cheapest_step(found[before], small_step, large)
    return found


def cheapest_step(before: Costs, small_step: int, large_step: int) -> Costs:
    """What it costs to come to each plane, above the cheapest of the pixel before."""
    beside = np.pad(before, 1, constant_values=10**6)
    near = np.minimum(beside[:-2], beside[2:]) + small_step
    return np.minimum(np.minimum(before, near), before.min() + large_step) - before.min()


def winner(total: Costs) -> tuple[np.float32, np.float32]:
    """The best plane with its fraction, and how much worse the best of the others is."""
    plane = int(total.argmin())
    far = np.abs(np.arange(len(total)) - plane) > 2
    margin = np.float32(0.5) * np.float32(total[far].min() - total[plane])
    if not 0 < plane < len(total) - 1:
        return np.float32(plane), margin
    below, above = (np.float32(total[plane + side] - total[plane]) for side in (-1, 1))
    fraction = (
        np.float32(0.5) * (below - above) / (below + above) if below + above > 0 else np.float32(0)
    )
    return np.float32(plane) + fraction, margin


def median_twin(surface, guide, planes, radius, colour_scale, tolerance) -> NDArray[np.float32]:
    """What `_stereo.weighted_median` computes."""
    filtered = surface.copy()
    for row, column in np.ndindex(surface.shape):
        window = (
            slice(max(row - radius, 0), row + radius + 1),
            slice(max(column - radius, 0), column + radius + 1),
        )
        values = surface[window].ravel()
        difference = (
            np.abs(guide[window].astype(int) - guide[row, column].astype(int)).sum(axis=-1).ravel()
        )
        weights = np.exp(-difference / (3 * colour_scale))
        bins = np.clip((values + 0.5).astype(int), 0, planes - 1)
        below = np.cumsum(np.bincount(bins, weights, planes))
        median = int(np.argmax(2 * below >= below[-1]))
        if np.ptp(values) > tolerance and abs(surface[row, column] - median) > tolerance:
            near = np.abs(bins - median) <= 1
            filtered[row, column] = np.average(values[near], weights=weights[near])
    return filtered
