"""Depth of a camera by IterMVS: its weights, sizes and cameras as the network counts them."""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor

from ggvs_eval.arrays import Array, Image8
from ggvs_eval.camera import Camera
from ggvs_eval.compute_device import rendering_on
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.files.weights_file import load_strict, read_tensors
from ggvs_eval.geometry.pinhole import rigid_between
from ggvs_eval.pipelines.offline.itermvs.network import SIZE_MULTIPLE, IterMvsNetwork
from ggvs_eval.pipelines.offline.itermvs.options import IterMvs

NETWORK = "IterMVS"  # in messages
CHECKPOINT_KEY = "model"


@lru_cache(maxsize=1)
def load_network(path: Path, device: torch.device | str = "cpu") -> IterMvsNetwork:
    """The network of a weights file, in evaluation mode, on a device.

    Args:
        path: a ``.ckpt`` of the authors, or safetensors with the same names under ``model.``.
    """
    network = IterMvsNetwork()
    load_strict(read_tensors(path, CHECKPOINT_KEY, of=NETWORK), network, path, NETWORK)
    return network.eval().to(device)


class IterMvsEstimator:
    """Depth of one camera by IterMVS; everything that does not depend on the images is prepared once.

    Reading:
        The network counts whole pixels: the middle of the first one is at 0, and feature j of a level lies on pixel j * 2^level.
        Images are stretched to sides that are multiples of 32, each camera's to its own.
    """

    def __init__(self, camera: Camera, partners: Sequence[Camera], options: IterMvs) -> None:
        self._camera, self._options, self._device = camera, options, torch.device(options.device)
        self._cameras = [_stretched(each) for each in (camera, *partners)]
        own, *others = self._cameras
        between = [(other, rigid_between(own, other)) for other in others]
        self._matrices = [_whole_pixels(o) @ motion[:3, :3] @ np.linalg.inv(_whole_pixels(own)) for o, motion in between]
        self._offsets = [_whole_pixels(other) @ motion[:3, 3] for other, motion in between]

    def estimate(self, image: Image8, partner_images: Sequence[Image8]) -> DepthMap:
        """Depth at one instant, everywhere, and the network's own confidence, (H, W)."""
        with rendering_on(self._device):
            network = load_network(self._options.weights, self._device)
            images = [_tensor(each, c) for each, c in zip((image, *partner_images), self._cameras, strict=True)]
            motion = [[torch.as_tensor(each, dtype=torch.float32) for each in of] for of in (self._matrices, self._offsets)]
            found = network(images, *motion, self._camera.near, self._camera.far, self._options.iterations)
            depth, confidence = (each.cpu().numpy() for each in found)
        nearest = cv2.resize(depth, self._camera.size, interpolation=cv2.INTER_NEAREST_EXACT)
        return DepthMap(nearest, cv2.resize(confidence, self._camera.size, interpolation=cv2.INTER_LINEAR))

    def forget(self) -> None:
        """Begin a new sequence; every instant is computed from nothing anyway."""


def _stretched(camera: Camera) -> Camera:
    width, height = (max(round(side / SIZE_MULTIPLE), 1) * SIZE_MULTIPLE for side in camera.size)
    return camera.resized(width, height)


def _whole_pixels(camera: Camera) -> Array:
    """The camera matrix where the first pixel's middle is at 0."""
    return camera.K - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])


def _tensor(image: Image8, camera: Camera) -> Tensor:
    resized = cv2.resize(image, camera.size, interpolation=cv2.INTER_LINEAR)
    return torch.as_tensor(resized).permute(2, 0, 1)[None].float() / 127.5 - 1
