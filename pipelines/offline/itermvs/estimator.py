"""Depth of cameras by IterMVS, several at once: weights, sizes and cameras as the network counts
them, and its recording.
"""

import gc
import hashlib
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from ggvs_eval.arrays import Array, Image8
from ggvs_eval.camera import Camera
from ggvs_eval.compute_device import rendering_on
from ggvs_eval.depth_options import cached_weights
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.errors import WeightsError
from ggvs_eval.files.weights_file import load_strict, read_tensors
from ggvs_eval.geometry.pinhole import rigid_between
from ggvs_eval.pipelines.offline.depth.matchers import Estimator, Matcher
from ggvs_eval.pipelines.offline.itermvs.network import (
    NEAREST_SHARE,
    SIZE_MULTIPLE,
    IterMvsNetwork,
    MatchedViews,
)

NETWORK = "IterMVS"  # in messages
PUBLISHED = "https://github.com/FangjinhuaWang/IterMVS, checkpoints/blendedmvs/model_000015.ckpt"
CHECKPOINT_KEY = "model"
# kept; a target that moves along a rig alternates between a few numbers of pictures
MOST_RECORDINGS = 4
Matched = Sequence[int]  # index of a camera, then of its partners
Pictures = tuple[int, int, int]  # number, width and height of those of one size
Finish = Callable[[Tensor, Tensor, Tensor], tuple[Tensor, Tensor]]


@dataclass(frozen=True)
class IterMvs(Matcher):
    """IterMVS with all partners at once.

    Attributes:
        weights_sha256: of its content; other weights, other depth.
        partners: how many cameras a camera is matched with at most; they need no common
            rectification.
        iterations: of the recurrent unit; the authors take four.
        precision: of convolutions; features, projections and the recurrent state are float32 in any
            case.

    Reading:
        On six pictures of three real captures, 640 pixels wide with four partners, float16 moves
        the median depth by 5e-5 to 1.2e-4 of itself, 82 to 92 % of the pixels by less than 1e-3 and
        95 to 99 % by less than 1e-2; of those that the network is sure of (confidence above 0.5) 98
        to 100 % by less than 1e-3.
    """

    name = "itermvs"
    weights: Path
    weights_sha256: str
    partners: int = 6
    iterations: int = 4
    device: str = "cpu"
    precision: Literal["float32", "float16"] = "float32"

    @property
    def views(self) -> int:
        """All partners at once."""
        return self.partners

    def estimator(self, camera: Camera, partners: Sequence[Camera], *_: object) -> Estimator:
        """See Matcher.estimator."""
        return IterMvsEstimator(camera, partners, self)

    def batch(self, finish: Finish) -> "IterMvsRig":
        """See Matcher.batch."""
        return IterMvsRig(self, finish)


@lru_cache(maxsize=2)
def load_network(
    path: Path,
    device: torch.device | str = "cpu",
    layout: torch.memory_format = torch.contiguous_format,
) -> IterMvsNetwork:
    """Return the network of a weights file, in evaluation mode, on a device.

    Args:
        path: a ``.ckpt`` of the authors, or safetensors with the same names under ``model.``.
        layout: of the weights, which convolutions follow.
    """
    network = IterMvsNetwork()
    load_strict(read_tensors(path, CHECKPOINT_KEY, model=NETWORK), network, path, NETWORK)
    network.to(memory_format=layout)  # type: ignore[call-overload]  # not in torch's overloads
    return network.eval().to(device)


def matcher_of_weights(checkpoint: str = "", device: str = "cpu", _dense: bool = True) -> IterMvs:
    """Return the matcher with a checkpoint of the authors, by default the one in the cache folder.

    Its maps are always dense.

    Raises:
        WeightsError: what is wrong with the file, before hours of work.
    """
    path = Path(checkpoint) if checkpoint else cached_weights()
    if not path.is_file():
        raise WeightsError(
            f"{path}: wanted weights of {NETWORK}, got no file; its authors publish them: "
            f"{PUBLISHED}"
        )
    load_network(path)
    return IterMvs(path, hashlib.sha256(path.read_bytes()).hexdigest(), device=device)


class IterMvsRig:
    """Depth of several cameras of a rig at once, on the device.

    Features of a picture are computed once for all maps of an instant, and the maps are one batch.
    A GPU records the batch in a CUDA graph, one for each number of maps, partners and pictures and
    each size: other cameras, partners and depth ranges need no other recording. The CPU runs the
    same code on the same buffers.

    Args:
        finish: makes the maps, depth and confidence (K, H, W), of those found and of
            `projections_between` their cameras; it is recorded too.

    Reading:
        The network counts whole pixels: the middle of the first one is at 0, and feature j of a
        level is on pixel j * 2^level. Images are stretched to sides that are multiples of 32, each
        camera's to its own. Where sizes differ within a rig, each map is a separate batch.
    """

    def __init__(self, options: IterMvs, finish: Finish | None = None) -> None:
        self._options, self._finish, self._device = options, finish, torch.device(options.device)
        self._batches: OrderedDict[tuple[object, ...], _Batch] = OrderedDict()

    def estimate(
        self, cameras: Sequence[Camera], matched: Sequence[Matched], images: Sequence[Image8]
    ) -> list[tuple[Tensor, Tensor]]:
        """Return the depth everywhere at one instant, and the network's own confidence.

        Args:
            cameras: of all pictures.
            matched: of each map wanted, the indices of its camera and of at least one partner.
            images: what the cameras saw, RGB, (H, W, 3).

        Returns:
            Depth, world units, and confidence in [0, 1] of each map, float32 tensors (H, W) on the
            device; the caller's own.
        """
        stretched = [_stretched(camera) for camera in cameras]
        alike = len({camera.size for camera in cameras}) == 1
        # sources that change then need fewer recordings
        spare = int(alike and len(matched) > 1 and len(cameras) % 2)
        if not alike and len(matched) > 1:
            return [
                pair for members in matched for pair in self.estimate(cameras, [members], images)
            ]
        groups = [list(range(len(cameras)))] if alike else [[index] for index in matched[0]]
        partners = max(map(len, matched)) - 1
        with rendering_on(self._device):
            sizes = [(len(group) + spare, *stretched[group[0]].size) for group in groups]
            batch = self._batch(len(matched), partners, cameras[matched[0][0]].size, sizes)
            members = [tuple(group) for group in matched] if alike else [(0,) * (1 + partners)]
            batch.match(
                [[stretched[index] for index in group] for group in matched],
                members,
                [cameras[first] for first, *_ in matched],
            )
            batch.show([[images[index] for index in group] for group in groups])
            return [
                (depth.clone(), confidence.clone())
                for depth, confidence in zip(*batch.run(), strict=True)
            ]

    def _batch(
        self, maps: int, partners: int, size: tuple[int, int], pictures: Sequence[Pictures]
    ) -> "_Batch":
        """Return the buffers of these numbers.

        Those that were not used for longest are given up.
        """
        key = (maps, partners, size, *pictures)
        if key not in self._batches:
            if len(self._batches) >= MOST_RECORDINGS:
                self._batches.popitem(last=False)
            self._batches[key] = _Batch(
                options=self._options,
                finish=self._finish,
                maps=maps,
                partners=partners,
                size=size,
                pictures=pictures,
            )
        self._batches.move_to_end(key)
        return self._batches[key]


class _Batch:
    """Static buffers of a batch of K maps from M partners each, and what a GPU has recorded on
    them.

    Args:
        finish: see `IterMvsRig`.
        size: width and height of the maps.
        pictures: those of each size, see `IterMvsNetwork.forward`.
    """

    def __init__(
        self,
        options: IterMvs,
        finish: Finish | None,
        maps: int,
        partners: int,
        size: tuple[int, int],
        pictures: Sequence[Pictures],
    ) -> None:
        self._half, self._iterations, self._finish = (
            options.precision == "float16",
            options.iterations,
            finish,
        )
        self._device = device = torch.device(options.device)
        layout = torch.channels_last if self._half else torch.contiguous_format
        self._network, self._size = load_network(options.weights, device, layout), size
        self._nearest = [
            _nearest(*sides, device) for sides in zip(pictures[0][1:], size, strict=True)
        ]
        self._pictures = [
            torch.zeros((p, high, wide, 3), dtype=torch.uint8, device=device)
            for p, wide, high in pictures
        ]
        self._views = MatchedViews(
            torch.zeros((maps, 1 + partners), dtype=torch.int64, device=device),
            torch.zeros((maps, partners, 13), device=device),
            torch.ones((maps, 3), device=device),
        )
        self._between = torch.zeros((maps, maps, 12), device=device)
        self._host, self._uploaded = self._pictures, None
        if device.type == "cuda":
            self._host = [
                torch.empty(pictures.shape, dtype=pictures.dtype, device="cpu", pin_memory=True)
                for pictures in self._pictures
            ]
            self._uploaded = torch.cuda.Event()
        self._graph: torch.cuda.CUDAGraph | None = None
        self._outcome: tuple[Tensor, Tensor] | None = None
        self._matched: object = None

    def match(
        self,
        matched: Sequence[Sequence[Camera]],
        members: Sequence[tuple[int, ...]],
        cameras: Sequence[Camera],
    ) -> None:
        """Take these cameras and their partners, at the size of their pictures.

        What is there already is not uploaded again.

        Args:
            members: index of each picture in its buffer.
            cameras: the cameras at the size of the maps.
        """
        if self._matched == (matched, members):
            return
        self._matched = matched, members
        views, projections = self._views, np.zeros(self._views.projections.shape, np.float32)
        for k, (camera, *partners) in enumerate(matched):
            numbers = [
                _projection(camera, partner, camera.K_opencv, partner.K_opencv)
                for partner in partners
            ]
            projections[k, : len(partners)] = [[*projection, 1] for projection in numbers]
        padded = [slots + slots[:1] * (views.members.shape[1] - len(slots)) for slots in members]
        ranges = [
            (1 / view.far, 1 / view.near - 1 / view.far, NEAREST_SHARE * view.near)
            for view in cameras
        ]
        between = (
            projections_between(cameras)
            if self._finish is not None
            else np.zeros(self._between.shape)
        )
        buffers = views.members, views.projections, views.ranges, self._between
        for buffer, values in zip(buffers, (padded, projections, ranges, between), strict=True):
            buffer.copy_(torch.as_tensor(np.asarray(values), dtype=buffer.dtype, device="cpu"))

    def show(self, images: Sequence[Sequence[Image8]]) -> None:
        """Take these pictures, of any size.

        The host waits for the upload of the instant before, and not for this one.
        """
        if self._uploaded is not None:
            self._uploaded.synchronize()
        for host, pictures, group in zip(self._host, self._pictures, images, strict=True):
            for slot, image in zip(host.numpy(), group, strict=False):  # one may be spare
                cv2.resize(image, slot.shape[1::-1], dst=slot, interpolation=cv2.INTER_LINEAR)
            pictures.copy_(host, non_blocking=True)
        if self._uploaded is not None:
            self._uploaded.record()

    def run(self) -> tuple[Tensor, Tensor]:
        """Return the depth and confidence, (K, H, W); a later run overwrites them."""
        if self._uploaded is None:
            return self._compute()
        if self._graph is None or self._outcome is None:
            self._graph, self._outcome = self._record()
        self._graph.replay()
        return self._outcome

    def _compute(self) -> tuple[Tensor, Tensor]:
        """Return all that is recorded: it reads the buffers, and neither uploads nor waits."""
        with torch.autocast(
            self._device.type, torch.float16, enabled=self._half, cache_enabled=False
        ):
            depth, confidence = self._network(self._pictures, self._views, self._iterations)
        # depths of two surfaces are not mixed, confidences are
        if self._size != (depth.shape[2], depth.shape[1]):
            columns, rows = self._nearest
            depth = depth.index_select(1, rows).index_select(2, columns)
            confidence = functional.interpolate(
                confidence[:, None], size=self._size[::-1], mode="bilinear"
            )[:, 0]
        return (
            (depth, confidence)
            if self._finish is None
            else self._finish(depth, confidence, self._between)
        )

    def _record(self) -> tuple[torch.cuda.CUDAGraph, tuple[Tensor, Tensor]]:
        """Record the batch, behind two runs in which libraries choose their ways and allocate."""
        stream, graph = torch.cuda.Stream(self._device), torch.cuda.CUDAGraph()
        stream.wait_stream(torch.cuda.current_stream(self._device))
        with torch.cuda.stream(stream):
            for _ in range(2):
                self._compute()
        torch.cuda.synchronize(self._device)
        gc.collect()
        collects = gc.isenabled()
        gc.disable()  # what a collection frees, a stream for one, must not be freed while recording
        try:
            with torch.cuda.graph(graph, stream=stream, capture_error_mode="thread_local"):
                outcome = self._compute()
        finally:
            if collects:
                gc.enable()
        return graph, outcome


class IterMvsEstimator(Estimator):
    """Depth of one camera as `IterMvsRig` finds it for many."""

    def __init__(self, camera: Camera, partners: Sequence[Camera], options: IterMvs) -> None:
        self._cameras, self._rig = (camera, *partners), IterMvsRig(options)

    def estimate(self, image: Image8, partner_images: Sequence[Image8]) -> DepthMap:
        """Return the depth at one instant, everywhere, and the network's own confidence, (H, W)."""
        maps = self._rig.estimate(
            self._cameras, [range(len(self._cameras))], (image, *partner_images)
        )
        return DepthMap(*(values.cpu().numpy() for values in maps[0]))


@lru_cache(maxsize=256)
def _stretched(camera: Camera) -> Camera:
    """Return the camera at the nearest size that the network takes.

    The same object for the same camera.
    """
    width, height = (max(round(side / SIZE_MULTIPLE), 1) * SIZE_MULTIPLE for side in camera.size)
    return camera.resized(width, height)


def projections_between(cameras: Sequence[Camera]) -> Array:
    """Transforms of pixels (u, v, 1) times depth between all cameras: matrix and offset, (K, K,
    12).
    """
    return np.array(
        [[_projection(first, second, first.K, second.K) for second in cameras] for first in cameras]
    )


def _projection(first: Camera, second: Camera, first_matrix: Array, second_matrix: Array) -> Array:
    """Return the matrix and offset from pixels of one camera to another's, by camera matrices in
    any pixels, (12,).
    """
    motion = rigid_between(first, second)
    matrix = second_matrix @ motion[:3, :3] @ np.linalg.inv(first_matrix)
    return np.concatenate([matrix.ravel(), second_matrix @ motion[:3, 3]])


@lru_cache(maxsize=64)
def _nearest(size: int, count: int, device: torch.device) -> Tensor:
    """Return the index of the nearest of some pixels in a line for each of `count`, (count,)."""
    line = np.arange(size, dtype=np.float32)[None]
    nearest = cv2.resize(line, (count, 1), interpolation=cv2.INTER_NEAREST_EXACT)[0]
    return torch.as_tensor(nearest.astype(np.int64), device=device)
