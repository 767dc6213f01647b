"""RAFT-Stereo as a stereo matcher: load its weights, pad, start, walk, check left against right, refine.

It starts from semi-global matching at half size, its gaps filled from the background. From zero, RAFT-Stereo walks the whole
disparity in small steps; from a guess that is right nearly everywhere, a small network with few iterations is left with what
matching cannot do.
"""

import hashlib
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache, partial
from importlib import resources
from pathlib import Path

import cv2
import numpy as np
import torch

from ggvs_eval import kernels
from ggvs_eval.arrays import Image8, Map
from ggvs_eval.compute_device import one_thread
from ggvs_eval.errors import WeightsError
from ggvs_eval.files.weights_file import load_strict, read_tensors
from ggvs_eval.pipelines.offline.stereo.matcher import left_right_gap, refine_disparity
from ggvs_eval.pipelines.offline.stereo.raft_config import COMPACT, PUBLISHED, RaftOptions
from ggvs_eval.pipelines.offline.stereo.raft_stereo import SIZE_MULTIPLE, RaftStereo
from ggvs_eval.pipelines.offline.stereo.sgbm import SgbmMatcher

SHIPPED = "raft-compact.safetensors"
NETWORK = "RAFT-Stereo"  # in messages
HALF = SgbmMatcher(levels=2, refine_iterations=0, speckle_px=40)


def shipped_weights() -> Path:
    """File of the compact network's weights."""
    return Path(str(resources.files("ggvs_eval.pipelines") / "weights" / SHIPPED))


def weights_digest(path: Path) -> str:
    """sha256 of a weights file, part of a depth map's key.

    Raises:
        WeightsError: no such file.
    """
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise WeightsError(f"{path}: wanted weights of {NETWORK}, got no readable file ({error.strerror})") from error


@lru_cache(maxsize=2)
def load_network(path: Path) -> RaftStereo:
    """The network of a weights file, in evaluation mode; its configuration is known from the tensors.

    Args:
        path: safetensors of ours, or a ``.pth`` of the authors: a state dict whose names may begin with ``module.``.

    Raises:
        WeightsError: absent, damaged, more than tensors inside, or tensors of no configuration of RAFT-Stereo.
    """
    tensors = read_tensors(path, of=NETWORK)
    network = RaftStereo(_configuration(tensors, path))
    load_strict(tensors, network, path, NETWORK)
    return network.eval()


def _configuration(tensors: Mapping[str, torch.Tensor], path: Path) -> RaftOptions:
    """The configuration whose parameters these are, by names and shapes."""
    shapes = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
    nearest, fewest = "", len(shapes) + 1
    for title, config in {"compact": COMPACT, **PUBLISHED}.items():
        with torch.device("meta"):
            expected = {name: tuple(tensor.shape) for name, tensor in RaftStereo(config).state_dict().items()}
        different = {name for name in shapes.keys() | expected.keys() if shapes.get(name) != expected.get(name)}
        if not different:
            return config
        if len(different) < fewest:
            name = min(different)
            nearest = f"{len(different)} differ from '{title}', first {name}: {shapes.get(name)}, wanted {expected.get(name)}"
            fewest = len(different)
    raise WeightsError(f"{path}: {len(shapes)} tensors of no known RAFT-Stereo; {nearest or 'none of its names is known'}")


def start_from_matching(left: Image8, right: Image8, d_min: int, d_max: int, factor: int) -> Map:
    """Initial flow of the network.

    Args:
        left: RGB, (H, W, 3), sizes multiples of `factor`.
        right: likewise.
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
    """A disparity map as flow of the network: gaps filled, one value per cell.

    Args:
        disparity: (H, W), pixels, 0 = unknown, sizes multiples of `factor`.
        factor: pixels per cell.

    Returns:
        Negative disparity in cells, (H / factor, W / factor).
    """
    cells = disparity.shape[1] // factor, disparity.shape[0] // factor
    filled = fill_from_background(disparity)
    return np.asarray(-cv2.resize(filled, cells, interpolation=cv2.INTER_NEAREST) / factor, np.float32)


def fill_from_background(disparity: Map) -> Map:
    """Give rejected pixels (0) the smaller of the nearest disparities left and right on their row, else of the rows around."""
    filled = np.where(disparity > 0, disparity, _smaller_neighbour(disparity))
    return np.where(filled > 0, filled, _smaller_neighbour(filled.T).T)


def _smaller_neighbour(disparity: Map) -> Map:
    columns = np.broadcast_to(np.arange(disparity.shape[1]), disparity.shape)
    mask = disparity > 0
    left = np.maximum.accumulate(np.where(mask, columns, 0), axis=1)
    right = np.minimum.accumulate(np.where(mask, columns, disparity.shape[1] - 1)[:, ::-1], axis=1)[:, ::-1]
    sides = np.stack([np.take_along_axis(disparity, side, axis=1) for side in (left, right)])
    smaller = np.where(sides > 0, sides, np.inf).min(axis=0)
    return np.where(np.isfinite(smaller), smaller, 0).astype(np.float32)


@dataclass(frozen=True)
class RaftMatcher:
    """RAFT-Stereo on one rectified pair.

    Attributes:
        weights: file of the weights.
        weights_sha256: of its content; other weights, other depth.
        iterations: updates of the flow.
        warm_iterations: updates when the disparity of the frame before is known.
        from_matching: start from semi-global matching at half size; the authors' networks are made to start from zero.
        largest_side_px: larger pairs are matched at half size and refined at full size.
        check_px: left and right may differ by max(check_px, check_share * disparity).
        check_share: see check_px.
        refine_window: side of the window of the sub-pixel refinement on the images, pixels.
        refine_iterations: its iterations.

    Reading:
        The compact network is trained with 4 iterations. On 40 of its validation scenes 5 and 12 leave 1.52 and 1.42 px, at one
        and 1.8 times the time, 24 no less than 12; 5 are taken.
    """

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

    @property
    def name(self) -> str:
        """See StereoMatcher.name."""
        return "raft-stereo"

    def match(self, left: Image8, right: Image8, d_min: int, d_max: int, previous: Map | None = None) -> tuple[Map, Map]:
        """Match a rectified pair, see StereoMatcher.match."""
        answer = partial(self.disparity, d_min=d_min, d_max=d_max)
        with one_thread(), ThreadPoolExecutor(min(2, kernels.get_threads())) as pool:
            mirrored = pool.submit(answer, _mirror(right), _mirror(left))
            whole = pool.submit(answer, left, right, previous=previous).result()
            of_right = mirrored.result()
        gap = left_right_gap(whole, np.fliplr(of_right))
        allowed = np.maximum(self.check_px, self.check_share * whole)
        inside = (whole >= max(d_min, 0.5)) & (whole <= d_max)
        kept = np.where(inside & (gap <= allowed), whole, np.float32(0))
        grey = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (left, right)]
        refined = refine_disparity(grey[0], grey[1], kept, self.refine_window, self.refine_iterations)
        return refined, np.where(refined > 0, 1 - 0.5 * gap / allowed, np.float32(0)).astype(np.float32)

    def disparity(self, left: Image8, right: Image8, d_min: int, d_max: int, previous: Map | None = None) -> Map:
        """Estimate the disparity of every pixel by the network alone.

        Args:
            left: RGB, (H, W, 3).
            right: RGB, (H, W, 3).
            d_min: smallest disparity, pixels.
            d_max: largest disparity, pixels.
            previous: disparity of the frame before, (H, W), 0 = unknown; the network starts from it.

        Returns:
            Disparity of the left image, pixels, (H, W), rejected nowhere.
        """
        size = left.shape[1], left.shape[0]
        scale = 2 if max(size) > self.largest_side_px else 1
        small = [cv2.resize(image, (size[0] // scale, size[1] // scale), interpolation=cv2.INTER_AREA) for image in (left, right)]
        start = None if previous is None else cv2.resize(previous, small[0].shape[1::-1], interpolation=cv2.INTER_NEAREST) / scale
        disparity = self._at_size(small[0], small[1], d_min // scale, -(-d_max // scale), start)
        return disparity if scale == 1 else _enlarge(disparity, left, scale)

    def _at_size(self, left: Image8, right: Image8, d_min: int, d_max: int, previous: Map | None) -> Map:
        network = load_network(self.weights)
        margins = _margins(left.shape[0], left.shape[1])
        padded = [cv2.copyMakeBorder(image, *margins, cv2.BORDER_REPLICATE) for image in (left, right)]
        factor, initial = network.config.factor, None
        if previous is not None and (previous > 0).mean() > 0.5:
            around = cv2.copyMakeBorder(previous, *margins, cv2.BORDER_REPLICATE)
            initial = start_from_disparity(around, factor)
        elif self.from_matching:
            initial = start_from_matching(padded[0], padded[1], d_min, d_max, factor)
        iterations = self.iterations if previous is None else self.warm_iterations
        tensors = [torch.from_numpy(image).permute(2, 0, 1)[None].float() for image in padded]
        start = None if initial is None else torch.from_numpy(initial)[None, None]
        with one_thread():
            flow, _ = network.flow(tensors[0], tensors[1], iterations, start)
        top, _, first, _ = margins
        return -flow[0, 0, top : top + left.shape[0], first : first + left.shape[1]].numpy()


def _margins(height: int, width: int) -> tuple[int, int, int, int]:
    """Pixels to add above, below, left and right, so that both sides become multiples of 32."""
    tall, wide = -height % SIZE_MULTIPLE, -width % SIZE_MULTIPLE
    return tall // 2, tall - tall // 2, wide // 2, wide - wide // 2


def _mirror(image: Image8) -> Image8:
    return np.ascontiguousarray(image[:, ::-1])


def _enlarge(disparity: Map, like: Image8, scale: int) -> Map:
    """Disparity at the size of an image; interpolated within surfaces only."""
    size = like.shape[1], like.shape[0]
    nearest = cv2.resize(disparity, size, interpolation=cv2.INTER_NEAREST)
    smooth = cv2.resize(disparity, size, interpolation=cv2.INTER_LINEAR)
    return np.asarray(scale * np.where(np.abs(smooth - nearest) < 1, smooth, nearest), np.float32)
