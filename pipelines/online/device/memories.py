"""Memories of the target, on the device: the recurrent output and the remembered background."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from ggvs_eval.camera import Camera
from ggvs_eval.geometry.splat import COVERED_ALPHA
from ggvs_eval.pipelines.online import recurrent_output, remembered_background
from ggvs_eval.pipelines.online.device.splats import DeviceSplats
from ggvs_eval.pipelines.online.device.stillness import cells, enlarged, falling, light, mean_square, pooled
from ggvs_eval.pipelines.online.stillness import LEAST_NOISE


@dataclass(frozen=True, eq=False)
class Shown:
    """An instant: its output (3, H, W), the new image at each cell, (3, h, w), and for how long that has stood still, (h, w)."""

    index: int
    target: Camera
    picture: Tensor
    new: Tensor
    age: Tensor


def recur(index: int, target: Camera, picture: Tensor, still: Tensor, before: Shown | None, limit: float) -> Shown:
    """The output of an instant, see `RecurrentOutput.step`; its picture is (3, H, W)."""
    age, new = torch.ones_like(still), cells(picture)
    if before is not None and before.index == index - 1 and before.target.shows_the_same_rays(target):
        most = (1 + limit) / (1 - limit)
        still = still * _agreement(new, cells(before.picture), before.new, before.age.clamp(max=most))
        age = age + still * before.age
        picture = _mixed(picture, before.picture, still * (1 - 1 / age).clamp(max=limit))
    return Shown(index, target, picture.clamp(0, 1), new, age)


def _agreement(new: Tensor, mean: Tensor, last: Tensor, count: Tensor) -> Tensor:
    """Rate how well a mean of past images agrees with the new one, see `agreement`; images are (3, h, w)."""
    everywhere = torch.ones_like(count)
    changes = [new - other for other in (mean, last)]
    dragged, doubled = pooled(torch.stack([mean_square(change - light(change, everywhere)) for change in changes]))
    excess = 2 * dragged / doubled.clamp(min=2 * LEAST_NOISE**2) - (1 + 1 / count)
    return falling(excess, recurrent_output.DRAGGED)


def _mixed(picture: Tensor, past: Tensor, weight: Tensor) -> Tensor:
    """The past mixed in where it has weight, but for what changed over wide areas, see `recurrent_output.mixed`."""
    change = weight * light(cells(past) - cells(picture), weight)
    fine = enlarged(weight[None], picture.shape[1:])
    return past * fine + picture * (1 - fine) - enlarged(change, picture.shape[1:])


@dataclass(frozen=True, eq=False)
class Background:
    """The farthest that the target saw at each pixel: colour (3, H, W) and depth (H, W), 0 of a filling, -1 of what moved."""

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
    depths = torch.where(new, torch.where(quiet, depth, -1.0), faded)
    begins = hole & (depths < 0)
    colours, depths = torch.where(begins, picture, colours), torch.where(begins, 0.0, depths)
    colours = torch.where(hole & (depths <= 0), colours + remembered_background.RENEWAL * (picture - colours), colours)
    weight = ((COVERED_ALPHA - alpha) / (COVERED_ALPHA * (1 - remembered_background.FEATHER))).clamp(0, 1)
    filled = torch.where(hole, picture + weight * (colours - picture), picture)
    return filled, Background(index, target, colours, depths)
