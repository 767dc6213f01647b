"""Left-right check and subpixel refinement by torch, on the CPU or a GPU; `matcher` has those of OpenCV."""

import torch
from torch import Tensor
from torch.nn import functional

from ggvs_eval.pipelines.offline.stereo.matcher import LARGEST_STEP_PX, NOISE_SLOPE


def enlarge(disparity: Tensor, size: tuple[int, int], scale: int) -> Tensor:
    """Disparity, (B, 1, h, w), at the size (width, height) of an image; interpolated within surfaces only."""
    nearest = functional.interpolate(disparity, size[::-1], mode="nearest")
    smooth = functional.interpolate(disparity, size[::-1], mode="bilinear", align_corners=False)
    return scale * torch.where((smooth - nearest).abs() < 1, smooth, nearest)


def left_right_gap(disparity: Tensor, disparity_right: Tensor) -> Tensor:
    """Distance of the right image's disparity from the left one's in pixels, (H, W), see `matcher.left_right_gap`."""
    width = disparity.shape[1]
    columns = torch.round(torch.arange(width, device=disparity.device) - disparity).long()
    matched = disparity_right.gather(1, columns.clamp(0, width - 1))
    return torch.where((matched > 0) & (columns >= 0), (disparity - matched).abs(), torch.inf)


def refine_disparity(left: Tensor, right: Tensor, disparity: Tensor, window: int, iterations: int) -> Tensor:
    """Move each disparity, (H, W), to where the right image fits the left one best, see `matcher.refine_disparity`."""
    slope = _slope(right)
    columns = torch.arange(disparity.shape[1], device=disparity.device)
    valid = disparity > 0
    weight = valid.float()
    share = _window_mean(weight[None], window).clamp_min(1e-6)

    def means(*values: Tensor) -> Tensor:
        return _window_mean(torch.stack(values) * weight, window) / share

    def deviation(values: Tensor) -> Tensor:
        count = weight.sum().clamp_min(1)
        mean = (values * weight).sum() / count
        return (((values - mean) * weight).square().sum() / count).sqrt()

    refined, gain = disparity, None
    for _ in range(iterations):
        matched, there = _at(right, columns - refined), _at(slope, columns - refined)
        gain = deviation(left) / deviation(matched).clamp_min(1) if gain is None else gain
        difference, there = left - gain * matched, gain * there
        mean_slope, mean_difference, product, square = means(there, difference, there * difference, there * there)
        variance = (square - mean_slope * mean_slope).clamp_min(0)
        step = (mean_slope * mean_difference - product) / (variance + NOISE_SLOPE)
        refined = torch.where(valid, refined + step.clamp(-LARGEST_STEP_PX, LARGEST_STEP_PX), 0.0)
    return refined.clamp_min(0)


def _slope(image: Tensor) -> Tensor:
    """Sobel's slope along the rows of an image, (H, W), grey values per pixel."""
    padded = functional.pad(image[None], (1, 1, 1, 1), mode="reflect")[0]
    across = padded[:, 2:] - padded[:, :-2]
    return (across[:-2] + 2 * across[1:-1] + across[2:]) / 8


def _window_mean(values: Tensor, window: int) -> Tensor:
    """Means over windows of (B, H, W), mirrored at the borders; a side at a time."""
    before, after = window // 2, (window - 1) // 2
    padded = functional.pad(values, (before, after, before, after), mode="reflect")[:, None]
    rows = functional.avg_pool2d(padded, (1, window), stride=1)
    return functional.avg_pool2d(rows, (window, 1), stride=1)[:, 0]


def _at(image: Tensor, columns: Tensor) -> Tensor:
    """The image, (H, W), between the columns of its rows, (H, W); its border goes on outside."""
    below, last = torch.floor(columns), image.shape[1] - 1
    values = [image.gather(1, (below + step).clamp(0, last).long()) for step in (0, 1)]
    return torch.lerp(values[0], values[1], columns - below)
