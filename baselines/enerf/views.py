"""Source views and the target's grid, in the pixels and the units of length that the network was
trained with.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from ggvs_eval.baselines.enerf.network import FeatureNetwork
from ggvs_eval.camera import Camera
from ggvs_eval.method import SourceView

SIZE_MULTIPLE = 32  # sides are padded to it: the volume is at 1/8 and is halved twice
SMALLEST_DEPTH = 1e-6
TRAINED_NEAR = 2.125  # nearest depth in training: DTU's 425 mm in units of 200 mm
Matrix = NDArray[np.float64]


@dataclass(frozen=True)
class SeenView:
    """One source view, ready to be looked up.

    Attributes:
        levels: features (32, H / 4, W / 4) and (16, H / 2, W / 2) for the two volumes.
        maps: features and RGB in [0, 1] for the colours, (8 + 3, H, W).
        K: intrinsics, pixel centres at whole numbers, (3, 3).
        world_to_camera: (4, 4).
    """

    levels: tuple[Tensor, Tensor]
    maps: Tensor
    K: Matrix
    world_to_camera: Matrix

    @property
    def centre(self) -> Tensor:
        """Of the camera in the world, (3,)."""
        return torch.as_tensor(
            -self.world_to_camera[:3, :3].T @ self.world_to_camera[:3, 3]
        ).float()

    def projection(self, scale: float) -> Matrix:
        """Return the transform of world to an image of that scale, (4, 4)."""
        return projection(self.K, self.world_to_camera, scale)

    def look_up(self, points_world: Tensor) -> Tensor:
        """Return the features and colour at points (N, 3), those of the border outside the image,
        (N, 11).
        """
        world_to_image = torch.as_tensor(self.projection(1.0)).float()
        projected = points_world @ world_to_image[:3, :3].T + world_to_image[:3, 3]
        return sample(self.maps, image_places(projected, self.maps)[None], "border")[:, 0].T


def see(network: FeatureNetwork, source: SourceView, unit: float = 1.0) -> SeenView:
    """Return the features of a source view.

    Args:
        unit: the network's units of length per world unit.
    """
    return see_together(network, [source], unit)[0]


def see_together(
    network: FeatureNetwork, sources: Sequence[SourceView], unit: float = 1.0
) -> list[SeenView]:
    """Return the features of source views of one size in one batch, as they are normalised in
    training; arguments as of `see`.
    """
    images = (
        torch.as_tensor(np.stack([source.image for source in sources])).permute(0, 3, 1, 2).float()
        / 255
    )
    height, width = (padded(side) for side in images.shape[2:])
    images = functional.pad(
        images, (0, width - images.shape[3], 0, height - images.shape[2]), mode="replicate"
    )
    quarter, half, full = (level.float() for level in network(2 * images - 1))
    features = torch.cat([full, images], dim=1)
    return [
        SeenView(
            levels=(quarter[k], half[k]),
            maps=features[k],
            K=source.camera.K_opencv,
            world_to_camera=extrinsics(source.camera, unit),
        )
        for k, source in enumerate(sources)
    ]


def padded(side_px: int) -> int:
    """Return the next multiple of 32."""
    return -(-side_px // SIZE_MULTIPLE) * SIZE_MULTIPLE


def extrinsics(camera: Camera, unit: float) -> Matrix:
    """world_to_camera in the network's units of length, (4, 4)."""
    world_to_camera = camera.world_to_camera.copy()
    world_to_camera[:3, 3] *= unit
    return world_to_camera


def projection(K: Matrix, world_to_camera: Matrix, scale: float) -> Matrix:
    """Return the transform of world to (u z, v z, z, 1) of an image of that scale, (4, 4).

    Reading:
        As the authors', the first two rows of K are scaled, so that pixel (0, 0) is the same place
        at every scale.
    """
    scaled = np.eye(4)
    scaled[:3, :3] = np.diag([scale, scale, 1.0]) @ K
    return np.asarray(scaled @ world_to_camera)


def image_places(projected: Tensor, channels: Tensor) -> Tensor:
    """(u z, v z, z) to places in an image (C, H, W) where -1 and 1 are the centres of its outermost
    pixels, (..., 2).
    """
    uv = projected[..., :2] / projected[..., 2:].clamp(min=SMALLEST_DEPTH)
    largest = uv.new_tensor([channels.shape[2] - 1, channels.shape[1] - 1])
    return 2 * uv / largest - 1


def sample(channels: Tensor, places: Tensor, outside: str) -> Tensor:
    """Return the bilinear lookup of (C, H, W) at (h, w, 2) in [-1, 1], (C, h, w).

    `outside` is ``zeros`` or ``border``.
    """
    return functional.grid_sample(
        channels[None], places[None], mode="bilinear", padding_mode=outside, align_corners=True
    )[0]
