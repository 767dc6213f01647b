"""First points of a fit: estimated depth of the training cameras, fused where cameras agree,
thinned to voxels, coloured.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ggvs_eval.arrays import Array, Array32, Indices, Map, Mask
from ggvs_eval.camera import Camera
from ggvs_eval.errors import DepthError
from ggvs_eval.scene_fitter import Footage

SAMPLES = 400_000  # points of an instant before they are thinned
PARTNERS = 4  # nearest cameras that are asked whether they see the same surface
AGREEING = 2  # of them that must
TOLERANCE = 0.01  # of the depth, between what two cameras say of a point
STEADY_SHARE = 2 / 3  # of the instants in which a voxel of the background holds a point
STEADY_COLOUR = 0.06  # by which its colour differs from their mean, at most
# clips, of a point that is there all the time: nearly as opaque at the ends as in the middle
STEADY_DURATION = 2.0
NEIGHBOURS = 3


@dataclass(frozen=True, eq=False)
class Points:
    """Coloured points with the time they are of.

    Attributes:
        means: in the world, (N, 3), float32.
        colours: (N, 3), in [0, 1].
        times: of the clip, in [0, 1], (N,).
        durations: how long they last, clips, (N,).
        steady: (N,), True for what stays where it is.
    """

    means: Tensor
    colours: Tensor
    times: Tensor
    durations: Tensor
    steady: Tensor

    def select(self, rows: Tensor) -> "Points":
        """Some of the points, by a mask or their indices."""
        return Points(
            means=self.means[rows],
            colours=self.colours[rows],
            times=self.times[rows],
            durations=self.durations[rows],
            steady=self.steady[rows],
        )

    def spacings(self) -> Tensor:
        """Return the root mean square distance of each point to its three nearest neighbours, world
        units, (N,).
        """
        from scipy.spatial import KDTree

        places = self.means.numpy().astype(np.float64)
        count = min(NEIGHBOURS + 1, len(places))
        distances = KDTree(places).query(places, k=count)[0].reshape(len(places), -1)[:, 1:]
        spacing = np.sqrt((distances**2).mean(axis=1)) if count > 1 else np.ones(len(places))
        return torch.from_numpy(spacing.astype(np.float32).clip(1e-6))


def initial_points(footage: Footage, indices: Sequence[int], most: int) -> Points:
    """Return the points of some instants, those of what never moves once.

    Args:
        most: points at most.
    """
    parts = [_fused(footage, index) for index in indices]
    means = np.concatenate([part[0] for part in parts])
    colours = np.concatenate([part[1] for part in parts])
    ordinals = np.repeat(np.arange(len(parts)), [len(part[0]) for part in parts])
    if not len(means):
        raise DepthError(
            f"depth of {len(footage.views)} cameras at {len(indices)} instants: no point on which "
            f"{AGREEING} others agree; check the depth page, or use another --matcher"
        )
    thinned = None
    low, high = 1e-5, 0.2  # voxel, shares of the diagonal of what is there
    diagonal = float(np.linalg.norm(np.ptp(means, axis=0))) or 1.0
    for _ in range(14):
        voxel = float(np.sqrt(low * high))
        trial = _thinned(means, colours, ordinals, len(parts), voxel * diagonal)
        if len(trial[0]) <= most:
            high, thinned = voxel, trial
        else:
            low = voxel
    if thinned is None:
        thinned = _thinned(means, colours, ordinals, len(parts), high * diagonal)
    places, paint, instants, steady = thinned
    times = clip_times(footage, indices)[instants]
    gap = 1 / max(1, len(indices) - 1)
    return Points(
        means=torch.from_numpy(places.astype(np.float32)),
        colours=torch.from_numpy(paint.astype(np.float32)),
        times=torch.from_numpy(np.where(steady, 0.5, times).astype(np.float32)),
        durations=torch.from_numpy(np.where(steady, STEADY_DURATION, gap).astype(np.float32)),
        steady=torch.from_numpy(steady),
    )


def clip_times(footage: Footage, indices: Sequence[int]) -> Array:
    """Return the times of instants in the clip, 0 for its first and 1 for its last one."""
    first, span = footage.indices[0], max(1, len(footage.indices) - 1)
    return (np.array(indices, dtype=np.float64) - first) / span


def _fused(footage: Footage, index: int) -> tuple[Array, Array32]:
    """Return the points of an instant that enough cameras agree on, (N, 3), and their colours, (N,
    3).
    """
    depths = [footage.depth(view, index) for view in footage.views]
    pixels = sum(depth.size for depth in depths)
    stride = max(1, round(np.sqrt(pixels / SAMPLES)))
    partners = min(PARTNERS, len(footage.views) - 1)
    centres = np.stack([camera.centre for camera in footage.cameras])
    means, colours = [], []
    for place, (view, camera) in enumerate(zip(footage.views, footage.cameras, strict=True)):
        mask = np.zeros(depths[place].shape, bool)
        mask[stride // 2 :: stride, stride // 2 :: stride] = True
        mask &= depths[place] > 0
        points = camera.unproject(
            camera.pixel_centres()[mask], depths[place][mask].astype(np.float64)
        )
        nearest = np.argsort(np.linalg.norm(centres - camera.centre, axis=1), kind="stable")[
            1 : partners + 1
        ]
        votes = sum(
            (_agrees(footage.cameras[partner], depths[partner], points) for partner in nearest),
            np.zeros(len(points), int),
        )
        is_agreed = votes >= min(AGREEING, partners)
        means.append(points[is_agreed])
        colours.append(footage.image(view, index)[mask][is_agreed].astype(np.float32) / 255)
    return np.concatenate(means), np.concatenate(colours)


def _agrees(camera: Camera, depth: Map, points: Array) -> Indices:
    """1 for each point at which a camera's depth says the same, 0 elsewhere, (N,)."""
    uv, distance = camera.project(points)
    inside: Mask = (distance > 0) & (uv >= 0).all(axis=1) & (uv < camera.size).all(axis=1)
    column, row = np.where(inside[:, None], uv, 0).astype(int).T
    said = depth[row, column]
    return (inside & (said > 0) & (np.abs(said - distance) <= TOLERANCE * distance)).astype(np.intp)


def _thinned(
    means: Array, colours: Array32, ordinals: Indices, instants: int, voxel: float
) -> tuple[Array, Array, Indices, Mask]:
    """Return one point per voxel and instant, and one for all instants where most of them hold the
    same colour.

    Returns:
        Means and colours (N, 3), ordinal of the instant (N,), and what is the same in most instants
        (N,).
    """
    cells = np.floor((means - means.min(axis=0)) / voxel).astype(np.int64)
    spans = cells.max(axis=0) + 1
    keys = (cells[:, 0] * spans[1] + cells[:, 1]) * spans[2] + cells[:, 2]
    places, of_point = np.unique(keys, return_inverse=True)
    # (voxel, instant)
    pairs, of_pair = np.unique(of_point * instants + ordinals, return_inverse=True)
    cell, instant = pairs // instants, pairs % instants
    mean, paint = _means(of_pair, means, len(pairs)), _means(of_pair, colours, len(pairs))
    overall = _means(cell, paint, len(places))
    differs = np.abs(paint - overall[cell]).max(axis=1) > STEADY_COLOUR
    odd = np.bincount(cell, differs, len(places)) > 0
    steady = (
        (np.bincount(cell, minlength=len(places)) >= STEADY_SHARE * instants)
        & ~odd
        & (instants > 1)
    )
    if instants == 1:
        steady[:] = True
    moving = ~steady[cell]
    together = _means(cell, mean, len(places))
    return (
        np.concatenate([together[steady], mean[moving]]),
        np.concatenate([overall[steady], paint[moving]]),
        np.concatenate([np.zeros(steady.sum(), np.intp), instant[moving]]),
        np.repeat([True, False], [steady.sum(), moving.sum()]),
    )


def _means(groups: Indices, values: Array | Array32, count: int) -> Array:
    """Return the mean of the values (M, 3) of each group, (count, 3)."""
    members = np.maximum(np.bincount(groups, minlength=count), 1)
    return np.stack(
        [np.bincount(groups, column, count) / members for column in values.T.astype(np.float64)],
        axis=1,
    )
