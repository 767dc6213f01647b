"""RAFT-Stereo as a stereo matcher: load its weights, pad, start, walk, check left against right,
refine.

From zero, RAFT-Stereo walks the whole disparity in small steps; from a guess that is right nearly
everywhere, a small network with few iterations is left with what matching cannot do.

Small images and what the network starts from are made by OpenCV on the CPU. Network, left-right
check and refinement compute where the matcher does: on a GPU a pair and its mirror image in one
batch without waiting for the host, and one download returns disparity and confidence; on the CPU
each in a separate thread.
"""

import hashlib
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache, partial
from importlib import resources
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
from ggvs_eval.errors import WeightsError
from ggvs_eval.files.weights_file import load_strict, read_tensors
from ggvs_eval.pipelines.offline.stereo.matcher import LARGEST_STEP_PX, NOISE_SLOPE
from ggvs_eval.pipelines.offline.stereo.pairwise import StereoMatcher
from ggvs_eval.pipelines.offline.stereo.raft_stereo import SIZE_MULTIPLE, RaftStereo
from ggvs_eval.pipelines.offline.stereo.sgbm import SgbmMatcher
from ggvs_eval.raft_config import COMPACT, PUBLISHED, RaftShape
from ggvs_eval.raft_update import upsample_convex

HALF = SgbmMatcher(levels=2, refine_iterations=0, speckle_px=40)


def enlarge(disparity: Tensor, size: tuple[int, int], scale: int) -> Tensor:
    """Return the disparity, (B, 1, h, w), at the size (width, height) of an image.

    Interpolated within surfaces only.
    """
    nearest = functional.interpolate(disparity, size[::-1], mode="nearest")
    smooth = functional.interpolate(disparity, size[::-1], mode="bilinear", align_corners=False)
    return scale * torch.where((smooth - nearest).abs() < 1, smooth, nearest)


def left_right_gap(disparity: Tensor, disparity_right: Tensor) -> Tensor:
    """Return the distance of the right image's disparity from the left one's in pixels, (H, W), see
    `matcher.left_right_gap`.
    """
    width = disparity.shape[1]
    columns = torch.round(torch.arange(width, device=disparity.device) - disparity).long()
    matched = disparity_right.gather(1, columns.clamp(0, width - 1))
    return torch.where((matched > 0) & (columns >= 0), (disparity - matched).abs(), torch.inf)


def refine_disparity(
    left: Tensor, right: Tensor, disparity: Tensor, window: int, iterations: int
) -> Tensor:
    """Move each disparity, (H, W), to where the right image fits the left one best, see
    `matcher.refine_disparity`.
    """
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
        matched, slope_there = _at(right, columns - refined), _at(slope, columns - refined)
        gain = deviation(left) / deviation(matched).clamp_min(1) if gain is None else gain
        difference, slope_there = left - gain * matched, gain * slope_there
        mean_slope, mean_difference, product, square = means(
            slope_there, difference, slope_there * difference, slope_there * slope_there
        )
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
    """Return the means over windows of (B, H, W), mirrored at the borders; a side at a time."""
    before, after = window // 2, (window - 1) // 2
    padded = functional.pad(values, (before, after, before, after), mode="reflect")[:, None]
    rows = functional.avg_pool2d(padded, (1, window), stride=1)
    return functional.avg_pool2d(rows, (window, 1), stride=1)[:, 0]


def _at(image: Tensor, columns: Tensor) -> Tensor:
    """Return the image, (H, W), between the columns of its rows, (H, W).

    Its border continues outside.
    """
    below, last = torch.floor(columns), image.shape[1] - 1
    values = [image.gather(1, (below + step).clamp(0, last).long()) for step in (0, 1)]
    return torch.lerp(values[0], values[1], columns - below)


SHIPPED = "raft-compact.safetensors"
NETWORK = "RAFT-Stereo"  # in messages
PUBLISHED_ITERATIONS = 32  # what the authors' networks are made for


def shipped_weights() -> Path:
    """Return the file of the compact network's weights."""
    return Path(str(resources.files("ggvs_eval.pipelines") / "weights" / SHIPPED))


def weights_digest(path: Path) -> str:
    """sha256 of a weights file, part of a depth map's key."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise WeightsError(
            f"{path}: wanted weights of {NETWORK}, got no readable file ({error.strerror})"
        ) from error


@lru_cache(maxsize=2)
def load_network(path: Path, device: torch.device | str = "cpu") -> RaftStereo:
    """Return the network of a weights file, in evaluation mode, on a device.

    Its configuration is known from the tensors.

    Args:
        path: safetensors of this package, or a ``.pth`` of the authors: a state dict whose names
            may begin with ``module.``.

    Raises:
        WeightsError: absent, damaged, more than tensors inside, or tensors of no configuration of
            RAFT-Stereo.
    """
    tensors = read_tensors(path, model=NETWORK)
    network = RaftStereo(_configuration(tensors, path))
    load_strict(tensors, network, path, NETWORK)
    return network.eval().to(device)


def _configuration(tensors: Mapping[str, torch.Tensor], path: Path) -> RaftShape:
    """Return the configuration whose parameters these are, by names and shapes."""
    shapes = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
    nearest, fewest = "", len(shapes) + 1
    for title, config in {"compact": COMPACT, **PUBLISHED}.items():
        with torch.device("meta"):
            expected = {
                name: tuple(tensor.shape)
                for name, tensor in RaftStereo(config).state_dict().items()
            }
        different = {
            name
            for name in shapes.keys() | expected.keys()
            if shapes.get(name) != expected.get(name)
        }
        if not different:
            return config
        if len(different) < fewest:
            name = min(different)
            nearest = (
                f"{len(different)} differ from '{title}', first {name}: {shapes.get(name)}, "
                f"wanted {expected.get(name)}"
            )
            fewest = len(different)
    raise WeightsError(
        f"{path}: {len(shapes)} tensors of no known RAFT-Stereo; "
        f"{nearest or 'none of its names is known'}"
    )


@dataclass(frozen=True)
class RaftMatcher(StereoMatcher):
    """RAFT-Stereo on one rectified pair.

    Attributes:
        weights_sha256: of its content; other weights, other depth.
        warm_iterations: updates when the disparity of the frame before is known.
        from_matching: start from semi-global matching at half size; the authors' networks are made
            to start from zero.
        largest_side_px: larger pairs are matched at half size and refined at full size.
        check_px: left and right may differ by max(check_px, check_share * disparity).
        check_share: see check_px.
        refine_window: side of the window of the sub-pixel refinement on the images, pixels.
        dense: what the network says of every pixel, neither checked nor refined: for gaps that have
            nothing better, at half the time.

    Reading:
        The compact network is trained with 4 iterations. On 40 of its validation scenes 5 and 12
        leave 1.52 and 1.42 px, at one and 1.8 times the time, 24 no less than 12; 5 are taken.
    """

    name = "raft-stereo"
    weights: Path
    weights_sha256: str
    iterations: int = 5
    warm_iterations: int = 3
    from_matching: bool = True
    largest_side_px: int = 1000
    check_px: float = 1.0
    check_share: float = 0.03
    refine_window: int = 7
    refine_iterations: int = 2
    dense: bool = False

    def match(
        self, left: Image8, right: Image8, d_min: int, d_max: int, previous: Map | None = None
    ) -> tuple[Map, Map]:
        """Match a rectified pair, see StereoMatcher.match."""
        if self.dense:
            disparity = self.disparity(left, right, d_min, d_max, previous)
            inside = (disparity >= max(d_min, 0.5)) & (disparity <= d_max)
            return np.where(inside, disparity, np.float32(0)), inside.astype(np.float32)
        device = compute_device(self.device)
        with rendering_on(device):
            full, of_right = self._disparities(left, right, d_min, d_max, previous, sides=2)
            gap = left_right_gap(full, of_right.flip(1))
            allowed = (self.check_share * full).clamp_min(self.check_px)
            inside = (full >= max(d_min, 0.5)) & (full <= d_max)
            checked = torch.where(inside & (gap <= allowed), full, 0.0)
            grey = [
                torch.from_numpy(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)).to(device).float()
                for image in (left, right)
            ]
            refined = refine_disparity(
                grey[0], grey[1], checked, self.refine_window, self.refine_iterations
            )
            confidence = torch.where(refined > 0, 1 - 0.5 * gap / allowed, 0.0)
            disparity, share = torch.stack([refined, confidence]).cpu().numpy()
        return disparity, share

    def disparity(
        self, left: Image8, right: Image8, d_min: int, d_max: int, previous: Map | None = None
    ) -> Map:
        """Estimate the disparity of every pixel by the network alone.

        Args:
            left: RGB, (H, W, 3).
            right: RGB, (H, W, 3).
            d_min: smallest disparity, pixels.
            d_max: largest disparity, pixels.
            previous: disparity of the frame before, (H, W), 0 = unknown; the network starts from
                it.

        Returns:
            Disparity of the left image, pixels, (H, W), rejected nowhere; 0 in the first `d_min`
            columns, which the right image cannot show.
        """
        with rendering_on(compute_device(self.device)):
            return self._disparities(left, right, d_min, d_max, previous, sides=1)[0].cpu().numpy()

    def _disparities(
        self, left: Image8, right: Image8, d_min: int, d_max: int, previous: Map | None, sides: int
    ) -> Tensor:
        """Return the disparity of the pair and, with two sides, of its mirror image, (sides, H, W),
        on the device.

        The network is shown what both may show, moved by the smallest disparity: wide pairs then
        look like those it has learned.
        """
        left, right, d_max = left[:, d_min:], right[:, : right.shape[1] - d_min], d_max - d_min
        if previous is not None:
            previous = np.where(previous > d_min, previous - np.float32(d_min), np.float32(0))[
                :, d_min:
            ]
        device, size = compute_device(self.device), (left.shape[1], left.shape[0])
        network, scale = (
            load_network(self.weights, device),
            2 if max(size) > self.largest_side_px else 1,
        )
        across, down = size[0] // scale, size[1] // scale

        def small(image: NDArray[Any], by: int = cv2.INTER_AREA) -> NDArray[Any]:
            return _padded(cv2.resize(image, (across, down), interpolation=by))

        pairs = [
            (small(left), small(right)),
            (small(cv2.flip(right, 1)), small(cv2.flip(left, 1))),
        ][:sides]
        before = None if previous is None else small(previous, cv2.INTER_NEAREST) / scale
        start = partial(self._start, -(-d_max // scale), network.config.factor)
        images = torch.from_numpy(np.stack(pairs)).to(device)  # (sides, 2, H, W, 3)
        lefts, rights = images.permute(1, 0, 4, 2, 3).float().unbind(0)
        first = self.iterations if previous is None else self.warm_iterations
        together = (
            self.device != "cpu" and first == self.iterations
        )  # a pair that takes fewer updates than its mirror is no batch
        step = sides if together else 1
        with ThreadPoolExecutor(min(2, kernels.get_threads())) as pool:
            starts = [
                pool.submit(start, pair, prior)
                for pair, prior in zip(pairs, (before, None), strict=False)
            ]
            batches = zip(
                lefts.split(step), rights.split(step), (first, self.iterations), strict=False
            )
            begun = [starts[k : k + step] for k in range(0, sides, step)]
            # a GPU is fed by this thread alone
            run_batches = map if self.device != "cpu" else pool.map
            flow = torch.cat(list(run_batches(partial(_flow, network, device), batches, begun)))
        top, left_margin = ((-side % SIZE_MULTIPLE) // 2 for side in (down, across))
        disparity = -flow[:, :, top : top + down, left_margin : left_margin + across]
        full = (disparity if scale == 1 else enlarge(disparity, size, scale))[:, 0]
        return functional.pad(full + d_min, (d_min, 0))

    def _start(
        self, d_max: int, factor: int, pair: tuple[Image8, Image8], previous: Map | None
    ) -> Map:
        """Return the flow that the network starts from, in cells of a padded pair, (H / factor, W /
        factor), by the CPU.
        """
        if previous is not None and (previous > 0).mean() > 0.5:
            return start_from_disparity(previous, factor)
        if self.from_matching:
            return start_from_matching(*pair, 0, d_max, factor)
        return np.zeros([side // factor for side in pair[0].shape[:2]], np.float32)


@dataclass(frozen=True)
class DeviceRaftMatcher(RaftMatcher):
    """RAFT-Stereo on one rectified pair, computed on a device.

    Attributes:
        device: ``cuda`` or ``cuda:N``. Tests say ``cpu:0``, another name of the CPU, and come this
            way without a GPU.

    Reading:
        A device rounds otherwise than the CPU, so that its name is part of a depth map's key: maps
        of both are never mixed.
    """

    # no field of its base: what a key says of the CPU, it said before there was any other
    device: str = "cuda"


def matcher_of_weights(
    checkpoint: str = "", device: str = "cpu", dense: bool = False
) -> RaftMatcher:
    """Return the matcher with a checkpoint of the authors, or with the compact network that ships.

    Raises:
        WeightsError: what is wrong with the file, before hours of work.
    """
    path = Path(checkpoint) if checkpoint else shipped_weights()
    digest = weights_digest(path)
    load_network(path)
    make = partial(
        RaftMatcher if device == "cpu" else partial(DeviceRaftMatcher, device=device), dense=dense
    )
    if checkpoint:
        return make(path, digest, iterations=PUBLISHED_ITERATIONS, from_matching=False)
    return make(path, digest)


def _flow(
    network: RaftStereo,
    device: torch.device,
    batch: tuple[Tensor, Tensor, int],
    starts: Sequence[Future[Map]],
) -> Tensor:
    """Return the flow in pixels of a batch, (B, 1, H, W).

    What it starts from is asked for once its features are under way.
    """
    left, right, iterations = batch
    # each the faster one there
    layout = torch.channels_last if device == torch.device("cpu") else torch.contiguous_format
    with rendering_on(device):
        features = network.features(
            left.contiguous(memory_format=layout), right.contiguous(memory_format=layout)
        )
        initial = torch.from_numpy(np.stack([start.result() for start in starts])[:, None]).to(
            device
        )
        flows, weights = network.walk(*features, iterations, initial)
        return upsample_convex(flows[-1], weights, network.config.factor)


def _padded(image: NDArray[Any]) -> NDArray[Any]:
    """Return the image with its border repeated, so that both sides become multiples of 32."""
    tall, wide = (-side % SIZE_MULTIPLE for side in image.shape[:2])
    margins = tall // 2, tall - tall // 2, wide // 2, wide - wide // 2
    return cv2.copyMakeBorder(image, *margins, cv2.BORDER_REPLICATE)


def start_from_matching(left: Image8, right: Image8, d_min: int, d_max: int, factor: int) -> Map:
    """Return the initial flow of the network.

    Args:
        left: RGB, (H, W, 3), sizes multiples of `factor`.
        d_min: smallest disparity, pixels.
        d_max: largest disparity, pixels.
        factor: pixels per cell of the flow.

    Returns:
        Negative disparity in cells, (H / factor, W / factor).
    """
    half_size = left.shape[1] // 2, left.shape[0] // 2
    halves = [cv2.resize(image, half_size, interpolation=cv2.INTER_AREA) for image in (left, right)]
    disparity, _ = HALF.match(halves[0], halves[1], d_min // 2, -(-d_max // 2))
    return start_from_disparity(disparity, factor // 2)


def start_from_disparity(disparity: Map, factor: int) -> Map:
    """Return a disparity map as flow of the network: gaps filled, one value per cell.

    Args:
        disparity: (H, W), pixels, 0 = unknown, sizes multiples of `factor`.
        factor: pixels per cell.

    Returns:
        Negative disparity in cells, (H / factor, W / factor).
    """
    cells = disparity.shape[1] // factor, disparity.shape[0] // factor
    filled = fill_from_background(disparity)
    return np.asarray(
        -cv2.resize(filled, cells, interpolation=cv2.INTER_NEAREST) / factor, np.float32
    )


def fill_from_background(disparity: Map) -> Map:
    """Give rejected pixels (0) the smaller of the nearest disparities left and right on their row,
    else of the rows around.
    """
    filled = np.where(disparity > 0, disparity, _smaller_neighbour(disparity))
    return np.where(filled > 0, filled, _smaller_neighbour(filled.T).T)


def _smaller_neighbour(disparity: Map) -> Map:
    columns = np.broadcast_to(np.arange(disparity.shape[1]), disparity.shape)
    mask = disparity > 0
    left = np.maximum.accumulate(np.where(mask, columns, 0), axis=1)
    right = np.minimum.accumulate(np.where(mask, columns, disparity.shape[1] - 1)[:, ::-1], axis=1)[
        :, ::-1
    ]
    sides = np.stack([np.take_along_axis(disparity, side, axis=1) for side in (left, right)])
    smaller = np.where(sides > 0, sides, np.inf).min(axis=0)
    return np.where(np.isfinite(smaller), smaller, 0).astype(np.float32)
