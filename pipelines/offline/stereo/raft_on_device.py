"""RAFT-Stereo as a matcher on a device: a pair and its mirror image in one batch, checked and refined where they lie.

The CPU's matcher, `raft_matcher`, is the reference, and stands apart: what is changed here renews no depth map of the CPU. The
small images and what the network starts from are made by OpenCV on the CPU as there; network, left-right check and refinement
compute on the device without a word from the host, and one download brings disparity and confidence back.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from ggvs_eval import kernels
from ggvs_eval.arrays import Image8, Map
from ggvs_eval.compute_device import compute_device, rendering_on
from ggvs_eval.pipelines.offline.stereo.matcher import LARGEST_STEP_PX, NOISE_SLOPE
from ggvs_eval.pipelines.offline.stereo.raft_matcher import (
    RaftMatcher,
    load_network,
    start_from_disparity,
    start_from_matching,
)
from ggvs_eval.pipelines.offline.stereo.raft_stereo import SIZE_MULTIPLE, RaftStereo
from ggvs_eval.pipelines.offline.stereo.raft_update import upsample_convex


class StagedRaftStereo(RaftStereo):
    """RAFT-Stereo whose start may come late: a device finds features meanwhile."""

    @torch.inference_mode()
    def flow_from(self, left: Tensor, right: Tensor, iterations: int, start: Callable[[], Tensor]) -> Tensor:
        """Flow in pixels, (B, 1, H, W); arguments as of `forward`, but that `start` is asked once the features are under way."""
        features = self.features(left, right)
        flows, weights = self._walk(*features, iterations, start())
        return upsample_convex(flows[-1], weights, self.config.factor)


@lru_cache(maxsize=2)
def network_on(path: Path, device: torch.device) -> StagedRaftStereo:
    """The network of a weights file on a device, see `load_network`."""
    network = load_network(path)
    staged = StagedRaftStereo(network.config)
    staged.load_state_dict(network.state_dict())
    return staged.eval().to(device)


@dataclass(frozen=True)
class DeviceRaftMatcher(RaftMatcher):
    """RAFT-Stereo on one rectified pair, computed on a device; of its parts only the start is the CPU's.

    Attributes:
        device: ``cuda`` or ``cuda:N``. Tests say ``cpu:0``, another name of the CPU, and come this way without a GPU.

    Reading:
        A device rounds otherwise than the CPU, so that its name is part of a depth map's key: maps of both are never mixed.
    """

    device: str = "cuda"

    def match(self, left: Image8, right: Image8, d_min: int, d_max: int, previous: Map | None = None) -> tuple[Map, Map]:
        """Match a rectified pair, see StereoMatcher.match.

        Raises:
            DeviceError: no such device here, or its memory is out.
        """
        device = compute_device(self.device)
        with rendering_on(device):
            whole, of_right = self._disparities(left, right, d_min, d_max, previous, sides=2)
            gap = _left_right_gap(whole, of_right.flip(1))
            allowed = (self.check_share * whole).clamp_min(self.check_px)
            inside = (whole >= max(d_min, 0.5)) & (whole <= d_max)
            kept = torch.where(inside & (gap <= allowed), whole, 0.0)
            grey = [torch.from_numpy(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)).to(device).float() for image in (left, right)]
            refined = _refine_disparity(grey[0], grey[1], kept, self.refine_window, self.refine_iterations)
            confidence = torch.where(refined > 0, 1 - 0.5 * gap / allowed, 0.0)
            disparity, share = torch.stack([refined, confidence]).cpu().numpy()
        return disparity, share

    def disparity(self, left: Image8, right: Image8, d_min: int, d_max: int, previous: Map | None = None) -> Map:
        """Estimate the disparity of every pixel by the network alone, see RaftMatcher.disparity.

        Raises:
            DeviceError: no such device here, or its memory is out.
        """
        with rendering_on(compute_device(self.device)):
            return self._disparities(left, right, d_min, d_max, previous, sides=1)[0].cpu().numpy()

    def _disparities(self, left: Image8, right: Image8, d_min: int, d_max: int, previous: Map | None, sides: int) -> Tensor:
        """Disparity of the pair and, with two sides, of its mirror image, (sides, H, W), on the device."""
        device, size = compute_device(self.device), (left.shape[1], left.shape[0])
        network, scale = network_on(self.weights, device), 2 if max(size) > self.largest_side_px else 1
        across, down = size[0] // scale, size[1] // scale

        def small(image: NDArray[Any], by: int = cv2.INTER_AREA) -> NDArray[Any]:
            return _padded(cv2.resize(image, (across, down), interpolation=by))

        pairs = [(small(left), small(right)), (small(cv2.flip(right, 1)), small(cv2.flip(left, 1)))][:sides]
        before = None if previous is None else small(previous, cv2.INTER_NEAREST) / scale
        start = partial(self._start, d_min // scale, -(-d_max // scale), network.config.factor)
        with ThreadPoolExecutor(min(2, kernels.get_threads())) as pool:
            starts = [pool.submit(start, pair, prior) for pair, prior in zip(pairs, (before, None), strict=False)]
            images = torch.from_numpy(np.stack(pairs)).to(device)  # (sides, 2, H, W, 3)
            lefts, rights = images.permute(1, 0, 4, 2, 3).float().contiguous().unbind(0)
            if previous is None:
                flow = network.flow_from(lefts, rights, self.iterations, partial(_uploaded, starts, device))
            else:  # the pair takes fewer updates than its mirror image, so that they are no batch
                counts = (self.warm_iterations, self.iterations)
                each = zip(lefts.split(1), rights.split(1), counts, starts, strict=False)
                flow = torch.cat(
                    [
                        network.flow_from(one, other, count, partial(_uploaded, [begun], device))
                        for one, other, count, begun in each
                    ]
                )
        top, first = ((-side % SIZE_MULTIPLE) // 2 for side in (down, across))
        disparity = -flow[:, :, top : top + down, first : first + across]
        return (disparity if scale == 1 else _enlarge(disparity, size, scale))[:, 0]

    def _start(self, d_min: int, d_max: int, factor: int, pair: tuple[Image8, Image8], previous: Map | None) -> Map:
        """Flow that the network starts from, in cells of a padded pair, (H / factor, W / factor), by the CPU."""
        if previous is not None and (previous > 0).mean() > 0.5:
            return start_from_disparity(previous, factor)
        if self.from_matching:
            return start_from_matching(*pair, d_min, d_max, factor)
        return np.zeros([side // factor for side in pair[0].shape[:2]], np.float32)


def _uploaded(starts: Sequence[Future[Map]], device: torch.device) -> Tensor:
    """What the CPU has found by then, (B, 1, h, w)."""
    return torch.from_numpy(np.stack([each.result() for each in starts])[:, None]).to(device)


def _padded(image: NDArray[Any]) -> NDArray[Any]:
    """The image with its border repeated, so that both sides become multiples of 32."""
    tall, wide = (-side % SIZE_MULTIPLE for side in image.shape[:2])
    margins = tall // 2, tall - tall // 2, wide // 2, wide - wide // 2
    return cv2.copyMakeBorder(image, *margins, cv2.BORDER_REPLICATE)


def _enlarge(disparity: Tensor, size: tuple[int, int], scale: int) -> Tensor:
    """Disparity, (B, 1, h, w), at the size (width, height) of an image; interpolated within surfaces only."""
    nearest = functional.interpolate(disparity, size[::-1], mode="nearest")
    smooth = functional.interpolate(disparity, size[::-1], mode="bilinear", align_corners=False)
    return scale * torch.where((smooth - nearest).abs() < 1, smooth, nearest)


def _left_right_gap(disparity: Tensor, disparity_right: Tensor) -> Tensor:
    """Distance of the right image's disparity from the left one's in pixels, (H, W), see `left_right_gap`."""
    width = disparity.shape[1]
    columns = torch.round(torch.arange(width, device=disparity.device) - disparity).long()
    matched = disparity_right.gather(1, columns.clamp(0, width - 1))
    return torch.where((matched > 0) & (columns >= 0), (disparity - matched).abs(), torch.inf)


def _refine_disparity(left: Tensor, right: Tensor, disparity: Tensor, window: int, iterations: int) -> Tensor:
    """Move each disparity, (H, W), to where the right image fits the left one best, see `refine_disparity`."""
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
