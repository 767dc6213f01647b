"""What the target remembers, on the device: the recurrent output and the remembered background."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera
from ggvs_eval.geometry.splat import COVERED_ALPHA
from ggvs_eval.pipelines.online import recurrent_output, remembered_background
from ggvs_eval.pipelines.online.device.order_statistics import quantile
from ggvs_eval.pipelines.online.device.splats import DeviceSplats
from ggvs_eval.pipelines.online.device.views import to_device

REDUCTION = recurrent_output.REDUCTION


def stillness(splats: DeviceSplats, beta_mask: float, lambda_t: float) -> Tensor:
    """Rate how sure it is that nothing moves, (h, w), see `splatted_change` and `stillness`."""
    masks = splats.features[:, ::REDUCTION, ::REDUCTION, 3]
    covered = torch.where(splats.alphas[:, ::REDUCTION, ::REDUCTION] >= COVERED_ALPHA, masks, 0.0).amax(dim=0)
    widest = functional.max_pool2d(covered[None, None], 2 * recurrent_output.REACH + 1, 1, recurrent_output.REACH)[0, 0]
    change = (widest - beta_mask).clamp(min=0) * lambda_t
    noise = quantile(change, recurrent_output.QUIET_QUANTILE).clamp(*recurrent_output.QUIET_RANGE)
    still, moving = recurrent_output.STILL, recurrent_output.MOVING
    return ((moving - change / noise) / (moving - still)).clamp(0, 1)


@dataclass(frozen=True, eq=False)
class Shown:
    """Output of an instant, (3, H, W), its camera, and for how many instants each cell has stood still, (h, w)."""

    index: int
    target: Camera
    picture: Tensor
    age: Tensor


def recur(index: int, target: Camera, picture: Tensor, still: Tensor, before: Shown | None, limit: float) -> Shown:
    """The output of an instant, see `RecurrentOutput.step`; its picture is (3, H, W)."""
    age = torch.ones_like(still)
    if before is not None and before.index == index - 1 and before.target.shows_the_same_rays(target):
        age = age + still * before.age
        picture = _mixed(picture, before.picture, still * (1 - 1 / age).clamp(max=limit))
    return Shown(index, target, picture, age)


def _mixed(picture: Tensor, past: Tensor, weight: Tensor) -> Tensor:
    """The past mixed in where it has weight, but for what changed over wide areas, see `recurrent_output.mixed`."""
    difference = (past - picture)[:, ::REDUCTION, ::REDUCTION]
    parts = torch.cat([difference * weight, weight[None]])
    down, across = (_widened(size, picture.device) for size in weight.shape)
    sums = down @ parts @ across.T
    light = weight * _enlarged(sums[:3] / (sums[3:] + 1e-3), weight.shape)
    fine = _enlarged(weight[None], picture.shape[1:])
    return past * fine + picture * (1 - fine) - _enlarged(light, picture.shape[1:])


def _enlarged(maps: Tensor, size: tuple[int, ...]) -> Tensor:
    return functional.interpolate(maps[None], size=tuple(size), mode="bilinear", align_corners=False)[0]


@lru_cache(maxsize=16)
def _widened(size: int, device: torch.device) -> Tensor:
    """Matrix that averages a line of cells over wide areas: what `recurrent_output` makes by cv2's resize and blur."""
    cells = recurrent_output.LIGHT_PX // REDUCTION
    small = -(-size // cells)
    lines: Array = np.eye(size, dtype=np.float64)
    averaged = cv2.resize(lines, (size, small), interpolation=cv2.INTER_AREA)
    return to_device(cv2.GaussianBlur(averaged, (1, 9), sigmaX=1, sigmaY=1), device)


@dataclass(frozen=True, eq=False)
class Background:
    """The farthest that the target saw at each pixel: colour (3, H, W) and depth (H, W), 0 where it is but a filling."""

    index: int
    target: Camera
    picture: Tensor
    depth: Tensor


def remember(
    index: int, target: Camera, picture: Tensor, depth: Tensor, splats: DeviceSplats, still: Tensor, before: Background | None
) -> tuple[Tensor, Background]:
    """The picture with its holes filled from memory, and the memory, see `RememberedBackground.step`."""
    alpha = splats.alphas.amax(dim=0)
    hole = alpha < COVERED_ALPHA
    if before is None or before.index != index - 1 or not before.target.shows_the_same_rays(target):
        return picture, Background(index, target, picture, torch.where(hole, 0.0, depth))
    faded = before.depth * remembered_background.FORGETTING
    new = (depth >= faded * remembered_background.BEHIND) & (depth > 0) & ~hole
    quiet = (still >= remembered_background.SURE_STILL).float()
    quiet = functional.interpolate(quiet[None, None], size=depth.shape, mode="nearest")[0, 0] > 0
    colours = torch.where(new, picture, before.picture)
    depths = torch.where(new, torch.where(quiet, depth, 0.0), faded)
    colours = torch.where(hole & (depths <= 0), colours + remembered_background.RENEWAL * (picture - colours), colours)
    weight = ((COVERED_ALPHA - alpha) / (COVERED_ALPHA * (1 - remembered_background.FEATHER))).clamp(0, 1)
    filled = torch.where(hole, picture + weight * (colours - picture), picture)
    return filled, Background(index, target, colours, depths)
